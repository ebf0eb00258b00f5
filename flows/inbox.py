"""An inbox of scene folders: what is new in it is inspected, what is broken is put aside with the reason beside it.

Running it again does nothing that is done already: the store says which scenes were inspected with the same settings,
limits and rig. Killed in the middle, the next run goes on where it stopped.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, as_completed
from functools import cache
from pathlib import Path

from flows.inbox_folders import check_is_inbox, is_settled, name_problem, put_aside, scene_folders
from flows.inbox_job import InboxJob, Outcome, Plan
from flows.inspect_scene import Job, inspect_scene
from flows.memory import do_without_pandas, share_heap
from flows.workers import ProcessDied, worker_processes
from metrology.errors import FlushlineError, RigError, SceneError, SpecError, StoreError, UsageError
from metrology.kinds import KINDS
from metrology.rig import Rig
from storage.archive import Store
from storage.archive.bundle import document_hash
from storage.archive.compaction import compact
from storage.archive.files import hold
from storage.documents import printable
from storage.panel_spec import PanelSpecification, load_panel_spec
from storage.review import ReviewLog
from storage.rig import load_rig, rig_document
from storage.scan_identity import files_state
from storage.scene_folder import SceneDocument, load_any_manifest
from storage.scene_models import MANIFEST
from tasks import steps
from tasks.result import config_hash
from tasks.settings import load_settings


@contextlib.contextmanager
def only_run(inbox: Path) -> Iterator[None]:
    """Refuse a second run in the same inbox while one is at work."""
    if not inbox.is_dir():
        raise UsageError(f"{inbox}: found no such folder, expected an inbox of scene folders")
    descriptor = hold(inbox)
    if descriptor is None:
        raise UsageError(f"{inbox}: found another run at work in it, expected to be the only one")
    try:
        yield
    finally:
        os.close(descriptor)


def plan(job: InboxJob) -> Plan:
    """Look at every scene folder and decide; broken ones are put aside. Nothing is decoded."""
    _check_apart(job.inbox, job.store)
    store = Store(job.store)
    store.check_usable()
    if job.rig:
        load_rig(job.rig)  # a bad rig file is one complaint, and no scene's fault
    folders = scene_folders(job.inbox)
    check_is_inbox(job.inbox, folders, job.settle_s)
    if store.layout.marker.exists():
        store.recover()  # a scene whose run was cut short just before the index is finished, too
    planned, look = Plan([], []), _Look(job, store)
    for folder in folders:
        try:
            outcome = look.at(folder)
        except (StoreError, SpecError) as problem:
            outcome = Outcome(folder, "failed", text=printable(f"{folder}: {problem}"))
        except Exception as problem:  # nothing but this folder was looked at: whatever it is, the others go on
            said = str(problem) if isinstance(problem, FlushlineError) else f"found {_in_words(problem)}"
            outcome = put_aside(job.inbox, folder, said, None)
        if outcome is None:
            planned.ready.append(folder)
        else:
            planned.settled.append(outcome)
    return planned


class _Look:
    """Looks at the scene folders of an inbox, one after the other."""

    def __init__(self, job: InboxJob, store: Store) -> None:
        self._job, self._store = job, store
        self._config_hash, self._rig_hash = _config_hashes(job, store), _rig_hashes(job, store)
        self._known, self._signed = store.known_scenes(), ReviewLog(job.store).sign_offs().sign_offs()
        self._ready: dict[str, tuple[Path, SceneDocument]] = {}

    def at(self, folder: Path) -> Outcome | None:
        """What becomes of a folder without inspecting it; None where it is to be inspected."""
        if not is_settled(folder, self._job.settle_s):
            return Outcome(folder, "copying")
        if problem := name_problem(self._job.inbox, folder):
            return put_aside(self._job.inbox, folder, problem, None)
        manifest = load_any_manifest(folder / MANIFEST)
        try:
            return self._at_scene(folder, manifest)
        except (SceneError, RigError) as problem:
            return put_aside(self._job.inbox, folder, str(problem), manifest.key.scene_id)

    def _at_scene(self, folder: Path, manifest: SceneDocument) -> Outcome | None:
        key = manifest.key
        scene_id = key.scene_id
        own = manifest.own_rig(folder)
        if self._job.rig is None and own is None and not self._store.has_rig(manifest.rig):
            return Outcome(folder, "waiting", scene_id, f"rig {manifest.rig!r} is not in the store")
        if known := self._known.get(scene_id):
            if known.frames_digest and known.files_state != files_state(folder, [MANIFEST, *manifest.files]):
                known.refuse_other(scene_id, manifest.digest(folder), folder)
            wanted = self._config_hash(key.panel), self._rig_hash(manifest.rig, own)
            if (known.config_hash, known.rig_hash) == wanted:
                return Outcome(folder, "known", scene_id)
        if entry := self._signed.get(scene_id):
            return Outcome(folder, "signed off", scene_id, f"signed off by {entry.who} on run {entry.run_id}")
        steps.load(folder, self._job.rig, self._store)
        if self._is_ready_elsewhere(folder, manifest):
            return Outcome(folder, "known", scene_id)
        return None

    def _is_ready_elsewhere(self, folder: Path, manifest: SceneDocument) -> bool:
        """Whether the same scan lies in another folder that is to be inspected in this run."""
        first = self._ready.setdefault(manifest.key.scene_id, (folder, manifest))
        if first[0] == folder:
            return False
        here, there = (model.digest(place) for place, model in (first, (folder, manifest)))
        return here == there  # another scan is put aside when the first one is stored


def inspect_folder(job: InboxJob, folder: Path) -> Outcome:
    """Inspect one scene folder of an inbox from its files to its published result: the unit of work. Never raises."""
    share_heap()
    do_without_pandas()
    start = time.perf_counter()
    store = Store(job.store)
    scene_id = None
    try:
        scene_id = load_any_manifest(folder / MANIFEST).key.scene_id
        inspected = inspect_scene(
            Job(folder, store, job.rig, load_settings(job.settings), load_panel_spec(job.panel_spec))
        )
    except (SceneError, RigError) as problem:
        return put_aside(job.inbox, folder, str(problem), scene_id)
    except FlushlineError as problem:
        return Outcome(folder, "failed", scene_id, printable(str(problem)))
    except Exception as problem:  # one scene's bug or bad luck must not stop the others
        return Outcome(folder, "failed", scene_id, printable(f"{folder}: found {_in_words(problem)}"))
    found = ", ".join(
        f"{len(kind.names(rows))} {kind.subject}s"
        for kind in KINDS
        if kind.counts_in(rows := inspected.features.get(kind.name, ()))
    )
    return Outcome(folder, "inspected", scene_id, found, time.perf_counter() - start)


def inspected_scenes(outcomes: Iterable[Outcome]) -> list[str]:
    """Ids of the scenes that were inspected just now."""
    return [outcome.scene_id for outcome in outcomes if outcome.state == "inspected" and outcome.scene_id]


def write_parquet(job: InboxJob, outcomes: Iterable[Outcome]) -> str | None:
    """Compact the store's tables if the job asks for it and something new is in them; returns where they lie."""
    if not job.compact or not any(outcome.state == "inspected" for outcome in outcomes):
        return None
    return str(compact(Store(job.store).existing()))


def run_here(job: InboxJob, folders: Iterable[Path], workers: int, on_outcome: Callable[[Outcome], None]) -> None:
    """Inspect scene folders in this process, or in several of its own; each outcome is reported as it comes."""
    if workers == 1:
        for folder in folders:
            on_outcome(inspect_folder(job, folder))
        return
    with worker_processes(workers) as processes:
        running = {processes.submit(inspect_folder, job, folder): folder for folder in folders}
        for future in as_completed(running):
            on_outcome(_outcome(job, running[future], future))


def inspect_in(processes: Executor, job: InboxJob, folder: Path) -> Outcome:
    """Inspect one scene folder in one of `processes`, and wait for it."""
    return _outcome(job, folder, processes.submit(inspect_folder, job, folder))


def _outcome(job: InboxJob, folder: Path, future: Future[Outcome]) -> Outcome:
    try:
        return future.result()
    except ProcessDied as problem:
        return put_aside(job.inbox, folder, f"found that {problem}, expected it to be inspected", None)


def _in_words(problem: Exception) -> str:
    """A surprise, in one line."""
    if isinstance(problem, OSError) and problem.strerror:
        found = f'"{problem.strerror}"'
    else:
        found = f"an unexpected {type(problem).__name__} ({' '.join(str(problem).split())})"
    return f"{found}, expected a scene folder that can be inspected"


def _check_apart(inbox: Path, store: Path) -> None:
    """Refuse an inbox that holds the store, or lies in it: what is no scene would be put aside, the store included."""
    inside, outside = sorted((inbox.resolve(), store.resolve()), key=lambda path: len(path.parts), reverse=True)
    if inside.is_relative_to(outside):
        raise UsageError(f"{inbox}: found an inbox that shares a folder with {store}, expected both apart")


def _config_hashes(job: InboxJob, store: Store) -> Callable[[str], str]:
    settings = load_settings(job.settings)
    given: PanelSpecification = load_panel_spec(job.panel_spec)

    @cache
    def of_panel(panel: str) -> str:
        return config_hash(settings, steps.specification(given, panel, store))

    return of_panel


def _rig_hashes(job: InboxJob, store: Store) -> Callable[[str, Rig | None], str]:
    @cache
    def of_rig(rig_id: str) -> str:
        return document_hash(rig_document(load_rig(job.rig) if job.rig else store.find_rig(rig_id)))

    return lambda rig_id, own: document_hash(rig_document(own)) if own and not job.rig else of_rig(rig_id)
