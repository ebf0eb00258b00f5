"""What an inspection finds, as it is stored: one frozen dataclass per table row (docs/formats.md names the columns).

Angles in degrees, lengths in mm, pixels of the raw left image. A value that could not be measured is None and `reason`
says why.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Severity = Literal["green", "blue", "red"]
Decision = Literal["pass", "conditional pass", "conditional fail", "fail", "not measured", "unconfirmed", "no limit"]
FoundBy = Literal["image", "relief"]

# From a standard deviation to U95: two-sided 95 % of a normal distribution.
COVERAGE_95 = 1.96


@dataclass(frozen=True)
class RivetDetection:
    """An ellipse in the left image that is taken for a rivet head's rim.

    Attributes
    ----------
    u_px, v_px : float
        Centre of the ellipse.
    major_px, minor_px : float
        Full lengths of the axes (diameters) of the ridge of the dark ring.
    angle_deg : float
        Direction of the major axis from +u towards +v, in [0, 180).
    confidence : float
        0 … 1.
    covariance : (5, 5) ndarray
        Of (u_px, v_px, major_px, minor_px, angle_deg).
    u_right_px, v_right_px : float or None
        Where the right camera sees the head's centre.
    rim_sigma_px : float or None
        Half-width of the rim's image (standard deviation of gap and blur together).
    doubt : str or None
        Why it may be no fastener; None where it is one.
    found_by : "image" or "relief"
        What showed it: the ring in the image, or the deviation of the cloud from the skin.
    """

    u_px: float
    v_px: float
    major_px: float
    minor_px: float
    angle_deg: float
    confidence: float
    covariance: NDArray[np.float64] = field(default_factory=lambda: np.full((5, 5), np.nan))
    u_right_px: float | None = None
    v_right_px: float | None = None
    rim_sigma_px: float | None = None
    doubt: str | None = None
    found_by: FoundBy = "image"


@dataclass(frozen=True)
class Rivet:
    """One row of `rivets`."""

    rivet_id: str
    x_mm: float | None
    y_mm: float | None
    z_mm: float | None
    u_px: float
    v_px: float
    u_right_px: float | None
    v_right_px: float | None
    diameter_mm: float | None
    major_px: float
    minor_px: float
    angle_deg: float
    confidence: float
    height_mean_mm: float | None = None
    height_min_mm: float | None = None
    height_max_mm: float | None = None
    height_u95_mm: float | None = None
    tilt_deg: float | None = None
    tilt_u95_deg: float | None = None
    crown_mm: float | None = None
    n_inner: int = 0
    n_outer: int = 0
    rms_inner_mm: float | None = None
    rms_outer_mm: float | None = None
    severity: Severity | None = None
    decision: Decision = "no limit"
    reason: str | None = None
    x_panel_mm: float | None = None
    y_panel_mm: float | None = None
    z_panel_mm: float | None = None
    zone: str | None = None
    diameter_u95_mm: float | None = None
    diameter_nominal_mm: float | None = None
    found_by: FoundBy | None = None


@dataclass(frozen=True)
class SeamLine:
    """The centre line of a seam in the left image: what detection hands to measurement.

    One seam is one line, across rivet heads, highlights and other seams. It ends where its band of brightness does:
    with the gap, at the border of the seam that it runs into (a T joint), with the lit skin, or with the image. Its
    course is smooth; its points are in order, from either end.

    Attributes
    ----------
    seam_id : str
        S01, S02 …: seams from left to right and top to bottom, lines without relief after them.
    centre_px : (n, 2) ndarray
        u, v of the middle between the band's borders, n ≥ 2, about every pixel along the line (raw left image). It is
        the middle of what is dark or bright there, chamfers and the walls that this camera sees included: not of the
        ideal edges D′ and G′.
    width_px : (n,) ndarray
        Distance of the band's borders across its direction; NaN where it could not be told.
    confidence : float
        0 … 1; at most 0.2 where the 3-D data show neither a groove nor a step.
    relief : bool
        Whether the 3-D data show a groove or a step. A line without is no seam (paint, a long scratch) or a flush
        sealed one; it is shown and not measured.
    """

    seam_id: str
    centre_px: NDArray[np.float64]
    width_px: NDArray[np.float64]
    confidence: float
    relief: bool


@dataclass(frozen=True)
class SeamStation:
    """One row of `seam_stations`."""

    seam_id: str
    s_mm: float
    x_mm: float | None
    y_mm: float | None
    z_mm: float | None
    u_px: float
    v_px: float
    step_mm: float | None = None
    step_u95_mm: float | None = None
    width_mm: float | None = None
    width_u95_mm: float | None = None
    n_left: int = 0
    n_right: int = 0
    severity: Severity | None = None
    decision: Decision = "no limit"
    reason: str | None = None
    step_into_wind_mm: float | None = None
    x_panel_mm: float | None = None
    y_panel_mm: float | None = None
    z_panel_mm: float | None = None
    zone: str | None = None


@dataclass(frozen=True)
class SceneKey:
    """What names a scene: one placement of the rig (station) before a panel of an aircraft, at one moment."""

    aircraft_serial: str
    panel: str
    station: str
    captured_at: datetime

    @property
    def scene_id(self) -> str:
        """The key as one word, such as ``MSN-0421~LH-F12~S3~20261120T081500Z``.

        ``~`` cannot occur in the parts, so different keys have different ids.
        """
        moment = self.captured_at.astimezone(UTC)
        text = f"{moment:%Y%m%dT%H%M%S}" + (f".{moment.microsecond:06d}" if moment.microsecond else "")
        return "~".join((self.aircraft_serial, self.panel, self.station, f"{text}Z"))

    def __str__(self) -> str:
        return (
            f"{self.aircraft_serial} {self.panel} {self.station} {self.captured_at.astimezone(UTC):%Y-%m-%d %H:%M:%SZ}"
        )
