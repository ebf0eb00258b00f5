"""Does an archive hold what it should? Bundles are held against their checksums, and the index against the bundles.

Each index keeps a digest of every run's rows, made when they came in. The rows as they are now have to give the same
digest, and so have the rows of the bundle.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import duckdb

from metrology.errors import StoreError
from storage.archive import bookkeeping, generations, index, snapshot, views
from storage.archive.anchors import named_verifications, review_problems
from storage.archive.bundle import MANIFEST, BundleModel, check_bundle
from storage.archive.bundles import Bundles
from storage.archive.files import companions
from storage.archive.kept_checking import kept_problems
from storage.archive.layout import Layout
from storage.archive.loading import Loader
from storage.archive.signed import by_preference, signed_runs
from storage.review_head import Head

_CHECKING_THREADS = 4


@dataclass(frozen=True)
class Check:
    """What a check of an archive found."""

    runs: int
    """Bundles looked at."""
    problems: tuple[str, ...]
    """One line each; empty where all is well."""


def check(layout: Layout, on_run: Callable[[], None] = lambda: None, heads: Sequence[Head] = ()) -> Check:
    """Compare every bundle with its checksums, every row of the index with the bundles, and the review log with both.

    Verifications of rigs are held against the checksums that later ones and the bundles name.

    Parameters
    ----------
    heads : sequence of Head
        Of the review log, as they were kept elsewhere.
    """
    from storage.evidence.verification_checking import verification_problems

    bundles = Bundles(layout)
    runs = bundles.runs()
    damaged: dict[Path, str] = {}
    sound: list[BundleModel] = []

    def look(run: Path) -> None:
        try:
            with bundles.as_stored(run) as folder:
                sound.append(check_bundle(folder))
        except StoreError as problem:
            damaged[run] = str(problem)
        on_run()

    with ThreadPoolExecutor(_CHECKING_THREADS) as threads:
        for _ in threads.map(look, runs):
            pass
    expected = _rows_of_bundles(layout)
    problems = [text for _, text in sorted({**expected.refused, **damaged}.items())]
    problems += incomplete(bundles)
    shown = {run.parent.name: run.name for run in expected.loaded}
    other_runs = _run_problems(layout, shown)
    digests = {run.parent.name: digest for run, digest in expected.loaded.items() if run.parent.name not in other_runs}
    problems += [*other_runs.values(), *_rows_problems(layout, digests)]
    problems += verification_problems(layout, named_verifications(bundles, runs))
    problems += kept_problems(layout, sound)
    return Check(len(runs), (*problems, *review_problems(bundles, runs, heads)))


def check_fast(layout: Layout, heads: Sequence[Head] = ()) -> Check:
    """Compare the rows of the index with their digests, and its runs with the names of the bundles, opening none.

    A run that has its folder and has lost its manifest is found by `check` only.

    Of the review log the chain is looked at, and the runs that were signed off.
    """
    from storage.evidence.verification_checking import verification_problems

    bundles = Bundles(layout)
    with ThreadPoolExecutor(1) as thread:
        rows = thread.submit(list, _rows_problems(layout))  # while the folders are walked
        runs = bundles.named()
    signed = signed_runs(layout.root)
    other_runs = _run_problems(layout, _preferred(runs, signed))
    if other_runs:  # a folder without a manifest is no run
        scenes = {run.parent for run in runs if run.parent.name in other_runs}
        runs = [run for run in runs if run.parent not in scenes]
        runs += [run for scene in sorted(scenes) for run in bundles.runs_of(scene)]
        other_runs = _run_problems(layout, _preferred(runs, signed))
    problems = (
        *other_runs.values(),
        *rows.result(),
        *verification_problems(layout),
        *review_problems(bundles, (), heads),
    )
    return Check(len(runs), problems)


def _preferred(runs: Sequence[Path], signed: dict[str, str]) -> dict[str, str]:
    """The run that is to be shown of each scene, by the scene's id."""
    return {run.parent.name: run.name for run in reversed(by_preference(runs, signed))}


def incomplete(bundles: Bundles) -> list[str]:
    """Folders in place of a run that have no manifest."""
    return [f"{run}: found no {MANIFEST}, expected a complete run" for run in bundles.incomplete()]


def _rows_of_bundles(layout: Layout) -> index.Outcome:
    """What an index made from the bundles would show, with digests as the published index has them."""
    with duckdb.connect() as connection:
        connection.execute("SET TimeZone = 'UTC'")
        if layout.archive.exists():
            with contextlib.closing(snapshot.connect(layout)) as published:
                bookkeeping.imitate(connection, published)
        else:
            bookkeeping.start(connection)
        return index.preferred(Loader(connection, layout), layout, {}, keep=False)


def _run_problems(layout: Layout, expected: Mapping[str, str]) -> dict[str, str]:
    """Scenes of which the published index shows another run than the undamaged bundles; `expected` is by scene."""
    if not layout.archive.exists():
        wanted = f"one of {len(expected)} scenes ('flushline archive rebuild')"
        return dict.fromkeys(list(expected)[:1], f"{layout.archive}: found no index, expected {wanted}")
    with contextlib.closing(snapshot.connect(layout)) as connection:
        shown = bookkeeping.shown_runs(connection)
    found = {
        scene_id: f"{layout.archive}: found scene {scene_id} without an undamaged run, expected its bundle"
        for scene_id in sorted(shown.keys() - expected.keys())
    }
    for scene_id, run in sorted(expected.items()):
        if shown.get(scene_id) != run:
            found[scene_id] = f"{layout.archive}: found run {shown.get(scene_id)} of {scene_id}, expected {run}"
    return found


def _rows_problems(layout: Layout, digests: Mapping[str, int] | None = None) -> Iterator[str]:
    """Where the rows of the index are not those that came in, or not those of the bundles.

    Parameters
    ----------
    digests : mapping of str to int, optional
        Of the rows of a scene's run in its bundle.
    """
    last = generations.newest(layout) if layout.archive.exists() else None
    if last is None:
        return
    for generation in generations.all_of(layout):
        for beside in companions(generation):
            yield f"{beside}: found it beside a generation of the index, expected nothing there"
        if generation != last and generations.is_noted(last):  # it may be made into the next one
            yield from _own_problems(generation, {})
    yield from _own_problems(last, digests or {})


def _own_problems(generation: Path, digests: Mapping[str, int]) -> Iterator[str]:
    """Where the rows of a generation are not those that came in, or not those of the bundles."""
    try:
        with contextlib.closing(snapshot.open_generation(generation)) as connection:
            kept = bookkeeping.kept_digests(connection)
            found = bookkeeping.row_digests(connection)
            altered_views = _altered_views(connection)
    except (duckdb.Error, snapshot.LogBesideError, StoreError) as problem:
        yield f"{generation}: found {str(problem).splitlines()[0]}, expected a readable index"
        return
    if kept is None and not digests:
        yield (
            f"{generation}: found an index of an earlier version, which keeps no digests; expected one with them: the "
            "next result brings it up to date, 'flushline archive check' compares it with the bundles"
        )
    for name in altered_views:
        yield f"{generation}: found view {name} altered, expected it as Flushline makes it"
    for scene_id, digest in sorted((found if kept is None else {**found, **kept}).items()):
        now, then, bundle = found.get(scene_id), (kept or found).get(scene_id), digests.get(scene_id, digest)
        if now != then:
            yield f"{generation}: found other rows of {scene_id} than those that were stored, expected them unchanged"
        elif now != bundle:
            yield f"{generation}: found other rows of {scene_id} than in its bundle, expected the same"


def _altered_views(connection: duckdb.DuckDBPyConnection) -> list[str]:
    """Views that do something else than what they were made for."""
    with duckdb.connect() as other:
        bookkeeping.imitate(other, connection)
        names = bookkeeping.make_kept_views(other, connection)
        asked = "SELECT view_name, sql FROM duckdb_views() WHERE NOT internal AND NOT temporary"
        made, found = (dict(each.execute(asked).fetchall()) for each in (other, connection))
    own = {view.name: view.create_sql for view in views.VIEWS} if bookkeeping.is_only_own(connection) else {}
    altered = {name for name in made if found.get(name) != made[name]}
    return sorted(altered | {name for name, sql in own.items() if names and names.get(name) != sql})
