"""An inbox of scene folders: what is new in it is inspected, what is broken is put aside with the reason beside it.

Running it again does nothing that is done already: the store says which scenes were inspected with the same settings,
limits and rig. Killed in the middle, the next run goes on where it stopped.
"""

from __future__ import annotations

import contextlib
import fcntl
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, as_completed
from functools import cache
from pathlib import Path

from flows.inbox_job import InboxJob, Outcome, Plan
from flows.inspect_scene import Job, inspect_scene
from flows.memory import share_heap
from metrology.errors import FlushlineError, RigError, SceneError, UsageError
from storage.archive import Store
from storage.archive.bundle import document_hash
from storage.archive.compaction import compact
from storage.panel_spec import PanelSpecification, load_panel_spec
from storage.review import ReviewLog
from storage.rig import load_rig, rig_document
from storage.scene import MANIFEST, load_manifest
from tasks import steps
from tasks.settings import load_settings

QUARANTINE = "quarantine"
_DEPTH = 4


@contextlib.contextmanager
def only_run(inbox: Path) -> Iterator[None]:
    """Refuse a second run in the same inbox while one is at work."""
    if not inbox.is_dir():
        raise UsageError(f"{inbox}: found no such folder, expected an inbox of scene folders")
    descriptor = os.open(inbox, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise UsageError(f"{inbox}: found another run at work in it, expected to be the only one") from None
    finally:
        os.close(descriptor)


def plan(job: InboxJob) -> Plan:
    """Look at every scene folder and decide; broken ones are put aside. Nothing is decoded."""
    _check_apart(job.inbox, job.store)
    store = Store(job.store)
    store.check_usable()
    if job.rig:
        load_rig(job.rig)  # a bad rig file is one complaint, and no scene's fault
    if store.layout.marker.exists():
        store.recover()  # a scene whose run was cut short just before the index is finished, too
    config_hash = _config_hashes(job, store)
    rig_hash = _rig_hashes(job, store)
    known, signed = _known(store), ReviewLog(job.store).read().sign_offs()
    ready: list[Path] = []
    settled: list[Outcome] = []
    for folder in scene_folders(job.inbox):
        if not _is_settled(folder, job.settle_s):
            settled.append(Outcome(folder, "copying"))
            continue
        scene_id = None
        try:
            manifest = load_manifest(folder / MANIFEST)
            key = manifest.key
            scene_id = key.scene_id
            if job.rig is None and not store.has_rig(manifest.rig):
                settled.append(Outcome(folder, "waiting", scene_id, f"rig {manifest.rig!r} is not in the store"))
                continue
            if known.get(scene_id) == (config_hash(key.panel), rig_hash(manifest.rig)):
                settled.append(Outcome(folder, "known", scene_id))
                continue
            if entry := signed.get(scene_id):
                settled.append(
                    Outcome(folder, "signed off", scene_id, f"signed off by {entry.who} on run {entry.run_id}")
                )
                continue
            steps.load(folder, job.rig, store)
        except (SceneError, RigError) as problem:
            settled.append(put_aside(job.inbox, folder, str(problem), scene_id))
        else:
            ready.append(folder)
    return Plan(ready, settled)


def inspect_folder(job: InboxJob, folder: Path) -> Outcome:
    """Inspect one scene folder of an inbox from its files to its published result: the unit of work. Never raises."""
    share_heap()
    start = time.perf_counter()
    store = Store(job.store)
    scene_id = None
    try:
        scene_id = load_manifest(folder / MANIFEST).key.scene_id
        inspected = inspect_scene(
            Job(folder, store, job.rig, load_settings(job.settings), load_panel_spec(job.panel_spec))
        )
    except (SceneError, RigError) as problem:
        return put_aside(job.inbox, folder, str(problem), scene_id)
    except FlushlineError as problem:
        return Outcome(folder, "failed", scene_id, str(problem))
    except Exception as problem:  # one scene's bug or bad luck must not stop the others
        return Outcome(folder, "failed", scene_id, f"unexpected {type(problem).__name__}: {problem}")
    found = f"{len(inspected.rivets)} rivets, {len({s.seam_id for s in inspected.stations})} seams"
    return Outcome(folder, "inspected", scene_id, found, time.perf_counter() - start)


def write_parquet(job: InboxJob, outcomes: Iterable[Outcome]) -> str | None:
    """Compact the store's tables if the job asks for it and something new is in them; returns where they lie."""
    if not job.compact or not any(outcome.state == "inspected" for outcome in outcomes):
        return None
    return str(compact(Store(job.store).existing()))


def scene_folders(inbox: Path) -> list[Path]:
    """Folders that are, or should be, scenes: those with a scene.json, and top ones without any below."""

    def below(folder: Path, depth: int) -> list[Path]:
        if os.path.lexists(folder / MANIFEST) or depth == 0:
            return [folder]
        try:
            inner = sorted(entry for entry in folder.iterdir() if entry.is_dir() and not entry.name.startswith("."))
        except OSError:
            return [folder]
        found = [scene for entry in inner for scene in below(entry, depth - 1)]
        with_manifest = [scene for scene in found if os.path.lexists(scene / MANIFEST)]
        return with_manifest or [folder]

    top = sorted(
        entry
        for entry in inbox.iterdir()
        if entry.name != QUARANTINE and not entry.name.startswith(".") and (entry.is_dir() or entry.is_symlink())
    )
    return [scene for entry in top for scene in below(entry, _DEPTH)]


def put_aside(inbox: Path, folder: Path, reason: str, scene_id: str | None) -> Outcome:
    """Move a broken scene folder to the inbox's quarantine and write the reason beside it."""
    quarantine = inbox / QUARANTINE
    name = "__".join(folder.relative_to(inbox).parts)
    try:
        quarantine.mkdir(exist_ok=True)
        target, number = quarantine / name, 1
        while os.path.lexists(target) or target.with_name(f"{target.name}.reason.txt").exists():
            number += 1
            target = quarantine / f"{name}.{number}"
        target.with_name(f"{target.name}.reason.txt").write_text(f"{reason}\n", encoding="utf-8")
        folder.rename(target)
    except OSError as problem:
        return Outcome(folder, "failed", scene_id, f"{reason}; it could not be put aside: {problem.strerror}")
    return Outcome(folder, "quarantined", scene_id, reason)


def run_here(job: InboxJob, folders: Iterable[Path], workers: int, on_outcome: Callable[[Outcome], None]) -> None:
    """Inspect scene folders in this process, or in several of its own; each outcome is told as it comes."""
    if workers == 1:
        for folder in folders:
            on_outcome(inspect_folder(job, folder))
        return
    with worker_processes(workers) as processes:
        running = {processes.submit(inspect_folder, job, folder): folder for folder in folders}
        for future in as_completed(running):
            on_outcome(_outcome(future, running[future]))


@contextlib.contextmanager
def worker_processes(workers: int) -> Iterator[Executor]:
    """Processes that inspect scenes. A run that is stopped waits for those at work and leaves the others."""
    context = multiprocessing.get_context("spawn")  # threads of numerical libraries do not survive a fork
    processes = ProcessPoolExecutor(workers, context, initializer=_follow_the_run)
    try:
        yield processes
    except KeyboardInterrupt:
        print("stopping as soon as the scenes at work are stored", file=sys.stderr)
        raise
    finally:
        processes.shutdown(cancel_futures=True)


def inspect_in(processes: Executor, job: InboxJob, folder: Path) -> Outcome:
    """Inspect one scene folder in one of `processes`, and wait for it."""
    return _outcome(processes.submit(inspect_folder, job, folder), folder)


def _outcome(future: Future[Outcome], folder: Path) -> Outcome:
    try:
        return future.result()
    except BrokenExecutor:
        return Outcome(folder, "failed", text=f"{folder}: its process died")


def _follow_the_run() -> None:
    """Ctrl-C reaches all processes of a terminal: leave it to the run. Where the run itself is killed, go with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    run = multiprocessing.parent_process()

    def leave() -> None:
        if run:
            run.join()
            os._exit(1)

    threading.Thread(target=leave, daemon=True).start()


def _check_apart(inbox: Path, store: Path) -> None:
    """Refuse an inbox that holds the store, or lies in it: what is no scene would be put aside, the store included."""
    inside, outside = sorted((inbox.resolve(), store.resolve()), key=lambda path: len(path.parts), reverse=True)
    if inside.is_relative_to(outside):
        raise UsageError(f"{inbox}: found an inbox that shares a folder with {store}, expected both apart")


def _is_settled(folder: Path, settle_s: float) -> bool:
    """Whether nothing in a folder changed lately, by the time the file system itself keeps.

    Copying tools set the modification time back to the original's, but not the time of the last change of the inode.
    """
    newest = 0.0
    for path in (folder, *folder.rglob("*")):
        try:
            newest = max(newest, path.lstat().st_ctime)
        except FileNotFoundError:
            return False
    return time.time() - newest >= settle_s


def _known(store: Store) -> dict[str, tuple[str, str]]:
    """Settings and rig that each scene of the store was inspected with."""
    if not store.layout.archive.exists():
        return {}
    with contextlib.closing(store.connect()) as connection:
        rows = connection.execute("SELECT scene_id, config_hash, rig_hash FROM scenes").fetchall()
    return {scene_id: (config, rig) for scene_id, config, rig in rows}


def _config_hashes(job: InboxJob, store: Store) -> Callable[[str], str]:
    settings = load_settings(job.settings)
    given: PanelSpecification = load_panel_spec(job.panel_spec)

    @cache
    def of_panel(panel: str) -> str:
        return steps.config_hash(settings, steps.specification(given, panel, store))

    return of_panel


def _rig_hashes(job: InboxJob, store: Store) -> Callable[[str], str]:
    @cache
    def of_rig(rig_id: str) -> str:
        return document_hash(rig_document(load_rig(job.rig) if job.rig else store.find_rig(rig_id)))

    return of_rig
