"""Doing something as another user of this machine, which only root can."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable
from pathlib import Path

import pytest

only_root = pytest.mark.skipif(os.getuid() != 0, reason="becomes another user, which only root can")


def as_user(user: int, work: Callable[[], object], groups: tuple[int, ...] = ()) -> None:
    """Do something in a child process that belongs to a user, a group of the user's own, and other groups."""
    child = os.fork()
    if child == 0:
        try:
            os.setgroups([*groups])
            os.setgid(user)
            os.setuid(user)
            work()
            os._exit(0)
        except BaseException:
            traceback.print_exc()
            sys.stderr.flush()
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def open_to_all(folder: Path) -> None:
    """Let other users reach a folder of pytest's."""
    for parent in (folder, *folder.parents):
        if str(parent).startswith("/tmp/"):
            parent.chmod(parent.stat().st_mode | 0o011)
