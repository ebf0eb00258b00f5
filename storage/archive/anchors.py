"""The review log and the bundles hold each other: every run names the log's head, every sign-off its run's manifest."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrology.errors import FlushlineError, StoreError
from storage.archive.bundle import MANIFEST
from storage.archive.bundles import Bundles
from storage.archive.files import sha256
from storage.documents import read_json
from storage.review import ReviewLog
from storage.review_checking import CheckedLog, check_log
from storage.review_head import Head

if TYPE_CHECKING:
    from storage.evidence.verifications import Mark

REVIEW_HEAD = "review_head"
"""Key of a manifest: the head of the review log when the run was stored."""
VERIFICATION = "verification"
"""Key of a manifest: the rig's last verification when the run was stored."""
SIGNED_MANIFEST = "manifest_sha256"
"""Key of what a sign-off was shown: the checksum of the run's manifest, which has those of its tables."""


def head_to_name(root: Path) -> str | None:
    """The head of a store's review log; None where it cannot be read, which holds up no result."""
    with contextlib.suppress(StoreError):
        return str(ReviewLog(root).head())
    return None


def manifest_checksum(bundles: Bundles, scene_id: str, run_id: str) -> str:
    """The checksum of a run's manifest."""
    manifest = bundles.layout.scene_folder(scene_id) / run_id / MANIFEST
    bundles.bring_file(manifest)
    if not manifest.is_file():
        raise StoreError(f"{manifest}: found no such file, expected the run that is signed off")
    return sha256(manifest)


def review_problems(bundles: Bundles, runs: Iterable[Path], heads: Iterable[Head] = ()) -> list[str]:
    """Where the review log is not what it was, or not what bundles say.

    Parameters
    ----------
    runs : paths
        Whose manifests are looked at.
    heads : heads
        Kept elsewhere.
    """
    log = check_log(bundles.layout.root)
    found = [log.contradiction(head, "the head that was kept elsewhere") for head in heads]
    found += [log.contradiction(head, str(manifest)) for manifest, head in _named_heads(bundles, runs)]
    return [*log.problems, *dict.fromkeys(text for text in found if text), *_signed_problems(bundles, log)]


def _named_heads(bundles: Bundles, runs: Iterable[Path]) -> Iterator[tuple[Path, Head]]:
    """Heads of the review log that manifests name, each with its manifest."""
    for manifest, named in _named(bundles, runs, REVIEW_HEAD):
        with contextlib.suppress(FlushlineError):
            yield manifest, Head.parse(named)


def named_verifications(bundles: Bundles, runs: Iterable[Path]) -> Iterator[tuple[str, Mark]]:
    """Verifications of rigs that manifests name, each with its manifest."""
    from storage.evidence.verifications import Mark

    for manifest, named in _named(bundles, runs, VERIFICATION):
        with contextlib.suppress(ValueError):
            yield str(manifest), Mark.model_validate(named)


def _named(bundles: Bundles, runs: Iterable[Path], key: str) -> Iterator[tuple[Path, Any]]:
    """What manifests say under a key; damaged ones are named by whoever checks the bundles."""
    for manifest in (run / MANIFEST for run in runs):
        with contextlib.suppress(FlushlineError):
            bundles.bring_file(manifest)
            if named := read_json(manifest, StoreError).get(key):
                yield manifest, named


def _signed_problems(bundles: Bundles, log: CheckedLog) -> Iterator[str]:
    """Runs that are not there as they were signed off."""
    for entry in log.sign_offs:
        expected = entry.shown.get(SIGNED_MANIFEST)
        if expected is None:  # signed off with an earlier version
            continue
        try:
            found = manifest_checksum(bundles, entry.scene_id, entry.run_id)
        except StoreError as problem:
            yield str(problem)
            continue
        if found != expected:
            yield (
                f"{bundles.layout.scene_folder(entry.scene_id) / entry.run_id / MANIFEST}: found checksum "
                f"{found[:12]}…, expected {str(expected)[:12]}… as it was {entry.said}"
            )
