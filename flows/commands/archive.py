"""flushline archive: check, head, rebuild, compact, prune, export; a scene's cloud as PLY."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

Run = Callable[[argparse.Namespace], int]
_MOST_SHOWN = 1000


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `archive` and its actions."""
    parser = commands.add_parser("archive", help="check, rebuild, compact, prune or export a store's archive")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)

    def add(name: str, run: Run, text: str) -> argparse.ArgumentParser:
        action = actions.add_parser(name, parents=[common], help=text, description=f"{text[:1].upper()}{text[1:]}.")
        action.add_argument("--store", type=Path, required=True, metavar="DIR")
        action.set_defaults(run=run)
        return action

    creating = add("create", create, "make an empty store, with its bundles on object storage if you like")
    creating.add_argument("--bundles", metavar="URI", help="where bundles lie, such as s3://bucket/prefix")
    creating.add_argument(
        "--reviews", metavar="URL", help="where decisions are kept, such as postgresql+psycopg://host/name"
    )
    checking = add(
        "check",
        check,
        "compare every bundle with its checksums and the index with the bundles; exit code 1 names damage",
    )
    checking.add_argument(
        "--fast", action="store_true", help="compare the index with its digests and the bundles' names; open no bundle"
    )
    checking.add_argument(
        "--head",
        metavar="NUMBER:CHECKSUM",
        action="append",
        default=[],
        help="of the review log, as 'archive head' or a report gave it",
    )
    add("head", head, "print number and checksum of the review log's last entry, to be kept elsewhere")
    add("rebuild", rebuild, "make the index again from the bundles alone")
    add("compact", compact, "write the tables as Parquet partitioned by aircraft, for other engines")
    pruning = add("prune", prune, "remove runs that newer runs of the same scene have replaced")
    pruning.add_argument("--keep", type=int, default=1, metavar="N", help="runs to keep of each scene (default 1)")
    pruning.add_argument("--older-than", type=float, metavar="DAYS", help="only runs stored longer ago than this")
    exporting = add("export", export, "copy the current bundles to a folder or to object storage")
    exporting.add_argument("--to", required=True, metavar="TARGET", help="folder, or a URI such as s3://bucket/prefix")
    exporting.add_argument("--aircraft", metavar="SERIAL", help="only this aircraft")
    exporting.add_argument("--panel", metavar="PANEL", help="only this panel")
    cloud = add("ply", ply, "write a scene's point cloud as PLY")
    cloud.add_argument("scene_id", metavar="SCENE_ID")
    cloud.add_argument("--out", type=Path, required=True, metavar="FILE")


def create(options: argparse.Namespace) -> int:
    """Make an empty store."""
    from storage.archive import Store

    Store(options.store).create(options.bundles, options.reviews)
    print(options.store)
    return 0


def check(options: argparse.Namespace) -> int:
    """Check bundles and index."""
    from flows.cli import EXIT_DONE, EXIT_SOME_FAILED, counted, print_error
    from flows.progress import progress_bar
    from storage.archive import Store, maintenance
    from storage.review_head import Head

    store = Store(options.store)
    layout = store.existing()
    heads = [Head.parse(text) for text in options.head]
    if options.fast:
        found = maintenance.check_fast(layout, heads)
    else:
        with progress_bar() as progress:
            bar = progress.add_task("checking runs", total=len(store.bundles.runs()))
            found = maintenance.check(layout, lambda: progress.advance(bar), heads)
    for problem in found.problems[:_MOST_SHOWN]:
        print_error(problem)
    if len(found.problems) > _MOST_SHOWN:
        print_error(f"{len(found.problems) - _MOST_SHOWN} more problems like these")
    print(
        f"{counted(found.runs, 'run')} {'looked up' if options.fast else 'checked'}, "
        f"{counted(len(found.problems), 'problem')}"
    )
    return EXIT_SOME_FAILED if found.problems else EXIT_DONE


def head(options: argparse.Namespace) -> int:
    """Print the head of the review log."""
    from storage.archive import Store
    from storage.review import ReviewLog

    print(ReviewLog(Store(options.store).existing().root).head())
    return 0


def rebuild(options: argparse.Namespace) -> int:
    """Make the index again."""
    from flows.cli import EXIT_DONE, EXIT_SOME_FAILED, counted, print_error
    from storage.archive import Store, maintenance

    store = Store(options.store)
    problems = maintenance.rebuild(store.existing())
    for problem in problems:
        print_error(problem)
    scenes = store.query("SELECT count(*) FROM scenes").column(0)[0].as_py()
    print(f"index of {counted(scenes, 'scene')} made from the bundles")
    return EXIT_SOME_FAILED if problems else EXIT_DONE


def compact(options: argparse.Namespace) -> int:
    """Write Parquet for other engines."""
    from storage.archive import Store
    from storage.archive.compaction import compact as write_parquet

    print(write_parquet(Store(options.store).existing()))
    return 0


def prune(options: argparse.Namespace) -> int:
    """Remove replaced runs."""
    from datetime import timedelta

    from flows.cli import counted
    from metrology.errors import UsageError
    from storage.archive import Store, maintenance

    if options.older_than is not None and not options.older_than >= 0:
        raise UsageError(f"--older-than: found {options.older_than:g} days, expected 0 or more")
    older_than = None if options.older_than is None else timedelta(days=options.older_than)
    removed = maintenance.prune(Store(options.store).existing(), options.keep, older_than)
    print(f"{counted(len(removed), 'replaced run')} removed")
    return 0


def export(options: argparse.Namespace) -> int:
    """Copy current bundles elsewhere."""
    from flows.cli import counted
    from metrology.errors import StoreError
    from storage.archive import Store, maintenance

    layout = Store(options.store).existing()
    copied, present = maintenance.export(layout, options.to, options.aircraft, options.panel)
    if not copied + present:
        asked = " ".join(part for part in (options.aircraft, options.panel) if part)
        raise StoreError(f"{options.store}: found no scene{f' of {asked}' if asked else ''}, expected at least one")
    print(f"{counted(copied, 'run')} copied to {options.to}, {present} were there")
    return 0


def ply(options: argparse.Namespace) -> int:
    """Write a scene's cloud as PLY."""

    from storage.archive import Store
    from storage.cloud import read_cloud
    from storage.frames import read_preview
    from storage.point_cloud import write_point_cloud

    paths = Store(options.store).paths(options.scene_id)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    points = write_point_cloud(options.out, read_cloud(paths.cloud), read_preview(paths.preview))
    print(f"{points} points in {options.out}")
    return 0
