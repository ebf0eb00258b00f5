"""Writing files so that a crash leaves the old state or the new one, and locks between processes."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import re
import shutil
import stat
from collections.abc import Iterator
from glob import escape
from pathlib import Path
from uuid import uuid4

from metrology.errors import StoreError

# Linux: lets two files share their blocks until one of them changes (XFS, Btrfs).
_FICLONE = 0x40049409
# What file systems without locks, or without their lock service, answer.
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EINVAL, errno.EBADF)


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold a lock file exclusively; the kernel lets go of it when a process dies."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)  # less the umask, as every file of a shared store
    try:
        _lock(descriptor, path, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def hold(path: Path) -> int | None:
    """A descriptor that holds `path` exclusively until it is closed; None where another process holds it."""
    try:
        descriptor = os.open(path, os.O_RDWR)  # network file systems lock only what may be written
    except (PermissionError, IsADirectoryError):
        descriptor = os.open(path, os.O_RDONLY)
    try:
        _lock(descriptor, path, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        return None
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _lock(descriptor: int, path: Path, how: int) -> None:
    try:
        fcntl.flock(descriptor, how)
    except BlockingIOError:
        raise
    except OSError as problem:
        if problem.errno not in _NO_LOCKS:
            raise
        raise StoreError(
            f'{path}: found "{problem.strerror}", expected a file system with file locks (flock): a local disk, or '
            "NFS 4 with its lock service at work"
        ) from None


@contextlib.contextmanager
def disk_trouble(root: Path, consequence: str) -> Iterator[None]:
    """Say in one line what the disk would not do, and what follows from it for a store."""
    try:
        yield
    except OSError as problem:
        reason = problem.strerror or problem
        found = f'{problem.filename or root}: found "{reason}", expected a store that can be written'
        if problem.errno == errno.ENOSPC:
            found = f"{root}: found the disk full, expected room for a result"
        raise StoreError(f"{found}; {consequence}") from problem


def sync(path: Path) -> None:
    """Bring a file's content, or a folder's list of names, onto the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_durably(path: Path, content: bytes) -> None:
    """Write a new file and its name onto the disk; a disk that cannot take it all is left without it."""
    try:
        path.write_bytes(content)
        sync(path)
    except OSError:
        path.unlink(missing_ok=True)
        raise
    sync(path.parent)


@contextlib.contextmanager
def replacing(target: Path, durable: bool = True) -> Iterator[Path]:
    """A file to write to, beside the target; it takes the target's place whole, or not at all.

    Parameters
    ----------
    durable : bool
        Whether it is on the disk before it does. What can be had again need not wait for that.
    """
    partial = target.with_name(f".{uuid4().hex}.{target.name}")
    try:
        yield partial
        if durable:
            sync(partial)
        partial.replace(target)
        if durable:
            sync(target.parent)
    finally:
        partial.unlink(missing_ok=True)


def write_first(target: Path, content: bytes) -> bool:
    """Write a file that does not exist yet, whole or not at all; False where another was first."""
    partial = target.with_name(f".{target.name}.{uuid4().hex}")
    try:
        write_durably(partial, content)
        protect(partial)
        return link_first(partial, target)
    finally:
        partial.unlink(missing_ok=True)


def protect(path: Path) -> None:
    """Let nobody write a file any more; who may read it stays as the umask had it."""
    path.chmod(stat.S_IMODE(path.stat().st_mode) & 0o444)


def allow_writing(path: Path) -> None:
    """Let the owner write a file again."""
    path.chmod(stat.S_IMODE(path.stat().st_mode) | 0o200)


def link_first(source: Path, target: Path) -> bool:
    """Give a file a second name that does not exist yet; False where another was first."""
    try:
        os.link(source, target)
    except FileExistsError:
        return False
    sync(target.parent)
    return True


def make_folders(folder: Path, root: Path) -> None:
    """Make `folder` and its parents below `root`, each durable in the one above it."""
    missing = []
    while folder != root and not folder.is_dir():
        missing.append(folder)
        folder = folder.parent
    for new in reversed(missing):
        new.mkdir(exist_ok=True)
        sync(new.parent)


def clone(source: Path, target: Path) -> None:
    """Copy a file to be changed further, sharing its blocks where the file system can."""
    with source.open("rb") as reader, target.open("wb") as writer:
        try:
            fcntl.ioctl(writer.fileno(), _FICLONE, reader.fileno())
        except OSError:
            shutil.copyfile(source, target)


def companions(database: Path) -> list[Path]:
    """What lies beside a DuckDB file under its name: logs that DuckDB would replay, and its temporary files."""
    return sorted(database.parent.glob(f"{escape(database.name)}.*"))


def remove_database(path: Path) -> None:
    """Remove a DuckDB file and whatever lies beside it under its name."""
    for file in (path, *companions(path)):
        if file.is_dir() and not file.is_symlink():
            shutil.rmtree(file)
        else:
            file.unlink(missing_ok=True)


def next_number(folder: Path, pattern: str) -> int:
    """A number greater than every one that the names matching `pattern` in a folder end in; the clock plays no part."""
    found = (re.search(r"(\d+)(\.\w+)?$", path.name) for path in folder.glob(pattern))
    return 1 + max((int(match[1]) for match in found if match), default=0)


def point_to(link: Path, target: Path) -> None:
    """Let the symbolic link `link` point to `target` from one moment to the next."""
    fresh = link.with_name(f".{link.name}.{os.getpid()}")
    fresh.unlink(missing_ok=True)
    fresh.symlink_to(os.path.relpath(target, link.parent))
    fresh.replace(link)
    sync(link.parent)


def sha256(path: Path) -> str:
    """Checksum of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
