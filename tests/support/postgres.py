"""A PostgreSQL server of the tests' own: on a socket in a temporary folder, reachable from this machine only."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from dashboard.confinement import die_with

_DEBIAN = Path("/usr/lib/postgresql")
_SECONDS_TO_START = 30


def programs() -> Path | None:
    """Folder with the server's programs; None where there are none."""
    found = sorted(_DEBIAN.glob("*/bin/postgres"), key=lambda path: int(path.parts[-3]))
    if found:
        return found[-1].parent
    on_path = shutil.which("postgres")
    return Path(on_path).parent if on_path else None


@contextmanager
def running_server(folder: Path) -> Iterator[str]:
    """A server with its data, which ends with this process; yields the beginning of URLs of its database."""
    # A path of pytest's may be too long for a socket; the server refuses to run as root.
    run_by = {"user": "nobody", "group": "nogroup"} if os.getuid() == 0 else {}
    with tempfile.TemporaryDirectory(prefix="flushline-pg-") as name:
        place = Path(name)
        if run_by:
            shutil.chown(place, "nobody", "nogroup")
            place.chmod(0o755)
        data, binaries = place / "data", programs()
        assert binaries is not None
        with (folder / "postgres.log").open("wb") as log:
            common = {"stdout": log, "stderr": log, "cwd": place, **run_by}
            initialise = [binaries / "initdb", "-D", data, "-U", "flushline", "-A", "trust", "--no-sync", "-E", "UTF8"]
            subprocess.run(initialise, check=True, **common)  # type: ignore[call-overload]
            settings = ("listen_addresses=", f"unix_socket_directories={place}", "fsync=off", "max_connections=40")
            options = [part for setting in settings for part in ("-c", setting)]
            server = subprocess.Popen(  # type: ignore[call-overload]
                [binaries / "postgres", "-D", data, *options], **common, preexec_fn=partial(die_with, os.getpid())
            )
            try:
                _wait(server, place / ".s.PGSQL.5432", folder / "postgres.log")
                yield f"postgresql+psycopg://flushline@/postgres?host={place}"
            finally:
                server.send_signal(signal.SIGQUIT)
                server.wait(_SECONDS_TO_START)


def _wait(server: subprocess.Popen[bytes], socket: Path, log: Path) -> None:
    end = time.monotonic() + _SECONDS_TO_START
    while not (socket.exists() and b"ready to accept connections" in log.read_bytes()):
        if server.poll() is not None or time.monotonic() > end:
            raise RuntimeError(f"PostgreSQL did not start: {log.read_text(errors='replace')[-800:]}")
        time.sleep(0.05)
