"""What a person had before them when they decided: a decision is about that, and about nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from storage.review_entries import POSITIONS, Feature


@dataclass(frozen=True)
class ShownFinding:
    """A finding as a person had it before them."""

    scene_id: str
    run_id: str
    feature: Feature
    values: Mapping[str, Any] = field(default_factory=dict)
    """What was shown, as JSON knows it."""
    last_entry: int = 0
    """Number of the last entry about the feature that was shown; 0 for none."""

    @property
    def features(self) -> tuple[Feature, ...]:
        """What a decision about it is about: each position of a stretch, else the feature itself."""
        if not self.feature.is_stretch:
            return (self.feature,)
        return tuple(Feature(self.feature.kind, each["feature_id"]) for each in self.values.get(POSITIONS, ()))


@dataclass(frozen=True)
class ShownScene:
    """A scene with its decisions as a person had them before them."""

    scene_id: str
    run_id: str
    values: Mapping[str, Any] = field(default_factory=dict)
    last_entry: int = 0
    """Number of the last entry about the scene or one of its features that was shown; 0 for none."""
