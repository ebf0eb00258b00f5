"""A scene that is signed off keeps the run it was signed off on: no other run takes its place.

What was signed off is in the review log and, where that is damaged or out of reach, by marks beside the bundles.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from metrology.errors import StoreError
from storage.archive.layout import Layout
from storage.documents import utc_text
from storage.review import ReviewLog
from storage.review_marks import SignOffMarks


def signed_runs(root: Path, scenes: Sequence[str] | None = None) -> dict[str, str]:
    """The run that each signed-off scene was signed off on.

    Parameters
    ----------
    scenes : sequence of str, optional
        Only these.
    """
    log, marks = ReviewLog(root), SignOffMarks(root)
    review = log.sign_offs() if scenes is None else log.of_scenes(scenes)
    marked = marks.all() if scenes is None else {scene: run for scene in scenes if (run := marks.of_scene(scene))}
    return marked | {scene: entry.run_id for scene, entry in review.sign_offs().items()}


def by_preference(runs: Iterable[Path], signed: dict[str, str]) -> list[Path]:
    """A store's runs, the newest first, but before them those that were signed off."""
    return sorted(runs, key=lambda run: (run.name == signed.get(run.parent.name), run.name), reverse=True)


def refuse_signed_off(root: Path, scene_id: str, run_id: str | None = None) -> None:
    """Refuse to inspect a scene that is signed off on another run than `run_id`.

    Where the review log cannot tell, a scene that has other runs is refused, too. The log is not asked about a scene
    that has none: there is nothing that could be replaced.
    """
    if marked := SignOffMarks(root).of_scene(scene_id):
        if marked == run_id:
            return
    elif not _has_other_runs(root, scene_id, run_id):
        return
    review = ReviewLog(root).of_scenes([scene_id])
    entry = review.sign_offs().get(scene_id)
    signed = entry.run_id if entry else marked
    if signed not in (None, run_id):
        by = f" by {entry.who} at {utc_text(entry.at)}" if entry else ""
        raise StoreError(
            f"{scene_id}: found it signed off{by}, expected an open scene; the result that was signed off stays "
            f"(run {signed})"
        )
    if review.problem:
        raise StoreError(f"{review.problem}; {scene_id} is not inspected again until that is cleared up")


def _has_other_runs(root: Path, scene_id: str, run_id: str | None) -> bool:
    return any(run.name != run_id for run in Layout(root).scene_folder(scene_id).glob("[!.]*"))
