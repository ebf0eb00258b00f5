"""A scene that is signed off keeps the run it was signed off on: no other run takes its place."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from metrology.errors import StoreError
from storage.documents import utc_text
from storage.review import Review, ReviewLog


def signed_runs(review: Review) -> dict[str, str]:
    """The run that each signed-off scene was signed off on."""
    return {scene_id: entry.run_id for scene_id, entry in review.sign_offs().items()}


def by_preference(runs: Iterable[Path], signed: dict[str, str]) -> list[Path]:
    """A store's runs, the newest first, but before them those that were signed off."""
    return sorted(runs, key=lambda run: (run.name == signed.get(run.parent.name), run.name), reverse=True)


def refuse_signed_off(root: Path, scene_id: str, run_id: str | None = None) -> None:
    """Refuse to inspect a scene that is signed off on another run than `run_id`."""
    entry = ReviewLog(root).read().sign_offs().get(scene_id)
    if entry and entry.run_id != run_id:
        raise StoreError(
            f"{scene_id}: found it signed off by {entry.who} at {utc_text(entry.at)}, expected an open scene; the "
            f"result that was signed off stays (run {entry.run_id})"
        )
