"""What a process gives up before it runs a query that somebody typed: writing, the network, and life after its server.

DuckDB's own settings close files and extensions. The kernel closes them once more, since a reader's index file opens
its companions (`.wal` and others) for writing: Landlock (Linux 5.13 and newer, no rights needed) lets the process write
in one folder only.
"""

from __future__ import annotations

import ctypes
import os
import signal
import struct
import sys
from pathlib import Path

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446  # system calls, the same on every architecture
_ASK_VERSION = 1
_PATH_BENEATH = 1
_SET_PARENT_DEATH_SIGNAL, _SET_NO_NEW_PRIVILEGES = 1, 38  # prctl

# Rights of the file system by the version of Landlock that knows them first: write a file, remove a folder or file,
# make entries of seven kinds; then move between folders; then truncate.
_WRITE_RIGHTS = {1: (1 << 1) | sum(1 << bit for bit in range(4, 13)), 2: 1 << 13, 3: 1 << 14}
_NETWORK_VERSION, _NETWORK_RIGHTS = 4, 0b11  # bind and connect TCP


def die_with(parent: int) -> None:
    """End this process when `parent`, which started it, ends in whatever way."""
    if not sys.platform.startswith("linux"):
        return
    _libc().prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:  # it ended before the signal was asked for
        os._exit(1)


def write_only_in(folder: Path) -> bool:
    """Take from this process, for good, every right to write outside of `folder` and to use the network.

    Returns
    -------
    bool
        False where the kernel has no Landlock; nothing is changed then.
    """
    if not sys.platform.startswith("linux"):
        return False
    libc = _libc()
    version = int(libc.syscall(_CREATE_RULESET, None, ctypes.c_size_t(0), ctypes.c_uint32(_ASK_VERSION)))
    if version < 1:
        return False
    rights = sum(bits for first, bits in _WRITE_RIGHTS.items() if version >= first)
    attributes = struct.pack("=Q", rights)
    if version >= _NETWORK_VERSION:
        attributes += struct.pack("=Q", _NETWORK_RIGHTS)
    ruleset = int(libc.syscall(_CREATE_RULESET, attributes, ctypes.c_size_t(len(attributes)), ctypes.c_uint32(0)))
    if ruleset < 0:
        return False
    beneath = os.open(folder, os.O_PATH | os.O_CLOEXEC)
    try:
        rule = struct.pack("=Qi", rights, beneath)
        return (
            libc.syscall(_ADD_RULE, ruleset, _PATH_BENEATH, rule, ctypes.c_uint32(0)) == 0
            and libc.prctl(_SET_NO_NEW_PRIVILEGES, 1, 0, 0, 0) == 0
            and libc.syscall(_RESTRICT_SELF, ruleset, ctypes.c_uint32(0)) == 0
        )
    finally:
        os.close(beneath)
        os.close(ruleset)


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)
