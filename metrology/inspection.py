"""What the inspection of one scene leaves behind, complete, as the archive takes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.overlay import Overlay
from metrology.panel import PanelLayout
from metrology.results import Features, SceneKey


@dataclass(frozen=True)
class InspectionResult:
    """All that the inspection of one scene leaves behind."""

    key: SceneKey
    reconstruction: Reconstruction
    """With the rig that was used."""
    features: Features
    """Judged, by kind."""
    overlay: Overlay
    """What to project."""
    preview: NDArray[np.uint8]
    """(h, w) uint8: the texture as the left camera sees it."""
    rig_document: Mapping[str, Any]
    """The rig file's content as it was used, for traceability."""
    settings: Mapping[str, Any]
    """Every setting of every step, as plain values."""
    config_hash: str
    """Names settings and panel specification together: equal hashes were inspected alike."""
    panel_spec: Mapping[str, Any]
    """The panel specification as it was used, as plain values."""
    seconds: Mapping[str, float]
    """Wall time of each step."""
    warnings: tuple[str, ...]
    versions: Mapping[str, str]
    """Of Flushline and of what it computes with."""
    operator: str | None = None
    """Who scanned."""
    registration: Mapping[str, Any] = field(default_factory=dict)
    """How the scan was recognised in its panel's pattern, as plain values."""
    epipolar_rms_px: float | None = None
    projector_rms_px: float | None = None
    """epipolar_rms_px, projector_rms_px: how well the rig fits the scan: RMS distance of features seen by both cameras
    from their epipolar lines, and of the decoded projector coordinates from where the rig projects the points."""
    rig_verdict: str | None = None
    """Whether the rig fits the scan: ok, warning, or unjudged."""
    encoded: Mapping[str, bytes] = field(default_factory=dict)
    """Content of files of the bundle that are encoded already, by their names."""
    pattern: PanelLayout | None = None
    """The pattern that this scan, the first of its station, enrols."""
    files_state: str | None = None
    """Names the scene folder's files as they lay on disk when they were read."""
