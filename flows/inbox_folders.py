"""The folders of an inbox: which are scenes, which are nobody's, and whether it is an inbox at all."""

from __future__ import annotations

import os
import re
import stat
import time
import unicodedata
from collections.abc import Iterable
from pathlib import Path
from urllib.parse import quote_from_bytes

from flows.inbox_job import Outcome
from metrology.errors import UsageError
from storage.documents import printable
from storage.scene_models import MANIFEST

QUARANTINE = "quarantine"
_DEPTH = 4
_MOST_BYTES = 200  # of a name in the quarantine; file systems take 255, and ".reason.txt" is added

# What operating systems, network storage and file managers put into every folder they serve.
_NOBODYS = re.compile(
    r"lost\+found|\$recycle\.bin|recycler|system volume information|found\.\d{3}|#recycle|#snapshot"
    r"|@eadir|@recycle|@recently-snapshot|@tmp|@sharebin|@sharesnap|@syno.*|@__thumb|@upload_cache"
    r"|thumbs\.db|desktop\.ini|__macosx|network trash folder|temporary items|\..*",
    re.IGNORECASE,
)
_SYSTEM = (
    "/", "/bin", "/boot", "/dev", "/etc", "/home", "/lib", "/lib64", "/proc", "/root", "/run", "/sbin", "/sys", "/tmp",
    "/usr", "/var", "/var/lib", "/var/tmp", "/Users", "/Volumes",
)  # fmt: skip
_HOMES = ("/home", "/Users")
_PROJECT = (
    ".git", ".hg", ".svn", "pyproject.toml", "setup.py", "package.json", "CMakeLists.txt", "Makefile", "Cargo.toml",
)  # fmt: skip
_FRAMES = (".png", ".tif", ".tiff", ".bmp", ".npy")
_FEW = 3


def scene_folders(inbox: Path) -> list[Path]:
    """Folders that are, or should be, scenes: those with a scene.json, and top ones without any below."""

    def below(folder: Path, depth: int) -> list[Path]:
        if os.path.lexists(folder / MANIFEST) or depth == 0:
            return [folder]
        try:
            inner = [entry for entry in sorted(folder.iterdir()) if _is_folder(entry) and not is_nobodys(entry.name)]
        except OSError:
            return [folder]
        found = [scene for entry in inner for scene in below(entry, depth - 1)]
        with_manifest = [scene for scene in found if os.path.lexists(scene / MANIFEST)]
        return with_manifest or [folder]

    top = sorted(
        entry
        for entry in inbox.iterdir()
        if entry.name != QUARANTINE and not is_nobodys(entry.name) and (entry.is_symlink() or _is_folder(entry))
    )
    return [scene for entry in top for scene in below(entry, _DEPTH)]


def is_nobodys(name: str) -> bool:
    """Whether a name is one that the system gives: hidden, a recycle bin, snapshots, thumbnails."""
    return _NOBODYS.fullmatch(name) is not None


def is_settled(folder: Path, settle_s: float) -> bool:
    """Whether nothing in a folder changed lately, by the time the file system itself keeps.

    Copying tools set the modification time back to the original's, but not the time of the last change of the inode.
    """
    newest = 0.0
    try:
        for path in (folder, *folder.rglob("*")):
            newest = max(newest, path.lstat().st_ctime)
    except FileNotFoundError:
        return False
    except OSError:  # what cannot be looked into is not being written either; reading it says what is wrong
        pass
    return time.time() - newest >= settle_s


def name_problem(inbox: Path, folder: Path) -> str | None:
    """What is wrong with the name of a folder; None where nothing is."""
    name = str(folder.relative_to(inbox))
    if any(unicodedata.category(character) in ("Cc", "Cs", "Zl", "Zp") for character in name):
        return (
            f"{folder}: found a name with control characters or bytes that are not UTF-8, expected one that can be "
            "printed; rename it and move it back"
        )
    return None


def put_aside(inbox: Path, folder: Path, reason: str, scene_id: str | None) -> Outcome:
    """Move a broken scene folder to the inbox's quarantine and write the reason beside it."""
    said = printable(reason if str(folder) in reason else f"{folder}: {reason}")
    try:
        target, note = _free_place(inbox / QUARANTINE, "__".join(folder.relative_to(inbox).parts))
        note.write_text(f"{said}\n", encoding="utf-8")
        try:
            _move(folder, target)
        except OSError:
            note.unlink(missing_ok=True)
            raise
    except OSError as problem:
        return Outcome(folder, "failed", scene_id, f"{said}; it could not be put aside: {problem.strerror}")
    return Outcome(folder, "quarantined", scene_id, said)


def check_is_inbox(inbox: Path, folders: Iterable[Path], settle_s: float) -> None:
    """Refuse a folder that is somebody's home, a system's, a project, or mostly something else than scenes.

    Whatever is no scene would be put aside. An inbox in which something was put aside before is one.

    Parameters
    ----------
    folders : iterable of Path
        As `scene_folders` found them.
    """
    place = inbox.resolve()
    own = "expected a folder that is for scans alone"
    if str(place) in _SYSTEM:
        raise UsageError(f"{inbox}: found a folder of the system ({place}), {own}; nothing was moved")
    home = Path(os.path.expanduser("~")).resolve()
    if home.is_relative_to(place) or str(place.parent) in _HOMES:
        raise UsageError(f"{inbox}: found a home folder, or one with home folders in it, {own}; nothing was moved")
    if marks := [name for name in _PROJECT if os.path.lexists(place / name)]:
        raise UsageError(f"{inbox}: found a project's folder ({marks[0]} is in it), {own}; nothing was moved")
    if (inbox / QUARANTINE).is_dir():
        return
    folders = list(folders)
    scenes = [folder for folder in folders if os.path.lexists(folder / MANIFEST)]
    strange = [folder for folder in folders if _is_strange(folder) and is_settled(folder, settle_s)]
    files = [entry for entry in inbox.iterdir() if entry.is_file() and not is_nobodys(entry.name)]
    if strange and len(strange) + len(files) >= max(_FEW, len(scenes) + 1):
        raise UsageError(
            f"{inbox}: found {len(strange)} folders (such as {strange[0].name}) and {len(files)} files that are no "
            f"scans, and {len(scenes)} scenes, {own}; nothing was moved. If it is an inbox all the same, make the "
            f"folder {inbox / QUARANTINE}"
        )


def _is_strange(folder: Path) -> bool:
    """Whether a folder has something in it, but neither a manifest nor frames."""
    try:
        if os.path.lexists(folder / MANIFEST) or not folder.is_dir():
            return False
        entries = [*folder.iterdir(), *folder.glob("*/*")]
    except OSError:
        return False
    return bool(entries) and not any(entry.suffix.lower() in _FRAMES for entry in entries)


def _is_folder(path: Path) -> bool:
    """Whether it is a folder, or cannot be looked at: reading it says what is wrong."""
    try:
        return path.is_dir()
    except OSError:
        return True


def _free_place(quarantine: Path, name: str) -> tuple[Path, Path]:
    """Where a folder goes, and its note: a name that is free, printable, and not too long."""
    quarantine.mkdir(exist_ok=True)
    safe = "".join(c if printable(c) == c else quote_from_bytes(os.fsencode(c)) for c in name)
    while len(os.fsencode(safe)) > _MOST_BYTES:
        safe = safe[:-1]
    target, number = quarantine / safe, 1
    while os.path.lexists(target) or os.path.lexists(_note(target)):
        number += 1
        target = quarantine / f"{safe}.{number}"
    return target, _note(target)


def _note(target: Path) -> Path:
    return target.with_name(f"{target.name}.reason.txt")


def _move(folder: Path, target: Path) -> None:
    try:
        folder.rename(target)
    except PermissionError:
        # Moving a folder changes where its ".." points: it must be writable, which its owner can see to.
        folder.chmod(folder.lstat().st_mode | stat.S_IRWXU)
        folder.rename(target)
