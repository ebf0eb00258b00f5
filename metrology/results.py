"""What an inspection finds, as it is stored: one frozen dataclass per table row; its fields say what the columns mean.

Angles in degrees, lengths in mm, pixels of the raw left image. A value that could not be measured is None and `reason`
says why.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from datetime import UTC, datetime
from typing import Annotated, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

Severity = Literal["green", "blue", "red"]
Decision = Literal["pass", "conditional pass", "conditional fail", "fail", "not measured", "unconfirmed", "no limit"]
FoundBy = Literal["image", "relief"]
HoleKind = Literal["open hole", "filled hole", "missing fastener", "temporary fastener"]
# A gap between two sheets, open or filled with sealant; or the edge of one sheet on another: a step without a gap.
Joint = Literal["butt", "butt sealed", "lap"]

MISSING = "missing"
"""How the reason of a row begins that stands for something which the panel's pattern has and which was not found."""

# From a standard deviation to U95: two-sided 95 % of a normal distribution.
COVERAGE_95 = 1.96


@dataclass(frozen=True)
class RivetDetection:
    """An ellipse in the left image that is taken for a rivet head's rim."""

    u_px: float
    v_px: float
    """u_px, v_px: centre of the ellipse."""
    major_px: float
    minor_px: float
    """major_px, minor_px: full lengths of the axes (diameters) of the ridge of the dark ring."""
    angle_deg: float
    """Direction of the major axis from +u towards +v, in [0, 180)."""
    confidence: float
    """0 … 1."""
    covariance: NDArray[np.float64] = field(default_factory=lambda: np.full((5, 5), np.nan))
    """(5, 5): of (u_px, v_px, major_px, minor_px, angle_deg)."""
    u_right_px: float | None = None
    v_right_px: float | None = None
    """u_right_px, v_right_px: where the right camera sees the head's centre."""
    rim_sigma_px: float | None = None
    """Half-width of the rim's image (standard deviation of gap and blur together)."""
    doubt: str | None = None
    """Why it may be no fastener; None where it is one."""
    found_by: FoundBy = "image"
    """What showed it: the ring in the image, or the deviation of the cloud from the skin."""


@dataclass(frozen=True, kw_only=True)
class Feature:
    """What the rows of all kinds of features hold beside their names and values (see `metrology.kinds`).

    Each field says what its column means; `{point}` is what the kind says its place is, `{pixel}` that in the image.
    """

    x_mm: Annotated[float | None, "{point} in the rig frame (left camera), to the right, mm"]
    y_mm: Annotated[float | None, "{point} in the rig frame, down, mm"]
    z_mm: Annotated[float | None, "{point} in the rig frame, away from the rig, mm"]
    u_px: Annotated[float, "column of {pixel} in the raw left image, px"]
    v_px: Annotated[float, "row of {pixel} in the raw left image, px"]
    x_panel_mm: Annotated[
        float | None, "the same point in the panel's frame, mm; NULL where the panel's pattern was not recognised"
    ] = None
    y_panel_mm: Annotated[float | None, "the same point in the panel's frame, mm"] = None
    z_panel_mm: Annotated[float | None, "the same point in the panel's frame, mm"] = None
    zone: Annotated[str | None, "tolerance zone of the panel specification"] = None
    severity: Annotated[Severity | None, "green meets the limits, blue slightly outside, red seriously outside"] = None
    decision: Annotated[
        Decision, "pass, conditional pass, conditional fail, fail, not measured, unconfirmed (a person must), no limit"
    ] = "no limit"
    reason: Annotated[str | None, "why there is no value, or why the decision is not a pass"] = None

    @property
    def is_missing(self) -> bool:
        """Whether the row stands for something that the panel's pattern has and that was not found."""
        return (self.reason or "").startswith(MISSING)

    @property
    def is_found(self) -> bool:
        """Whether the row is a feature that was found, beyond doubt."""
        return not self.is_missing and self.decision != "unconfirmed"

    def changed(self, **values: object) -> Self:
        """The row with other values in some columns: as `dataclasses.replace`, in a fifth of its time.

        A scan's rows pass through this some thousand times. Rows check nothing when they are made.
        """
        if unknown := values.keys() - self.__dict__.keys():
            raise TypeError(f"{type(self).__name__}: found no field {sorted(unknown)[0]!r}, expected one of the row's")
        row = object.__new__(type(self))
        row.__dict__.update(self.__dict__, **values)
        return row


@dataclass(frozen=True, kw_only=True)
class Course(Feature):
    """What the rows of kinds hold beside that whose rows are positions along something (`Kind.is_course`)."""

    stretch: Annotated[
        str | None,
        "what the position is a finding with: consecutive positions that do not pass, COURSE@FROM-TO; NULL where it is "
        "alone, or in order",
    ] = None
    beyond_mm: Annotated[
        float | None, "how far its worst quantity lies beyond the limits, mm; negative inside; NULL without limits"
    ] = None


Features = Mapping[str, Sequence[Feature]]
"""What was found on a scan, by the names of the kinds."""

Row = TypeVar("Row", bound=Feature)


def of_type(features: Features, row_type: type[Row]) -> list[Row]:
    """What was found of the kind that has rows of a type."""
    return [row for rows in features.values() for row in rows if isinstance(row, row_type)]


@dataclass(frozen=True)
class Rivet(Feature):
    """One row of `rivets`."""

    rivet_id: Annotated[
        str, "name of the rivet in the panel's pattern, the same on every scan of the station; X… is in no pattern"
    ]
    _: KW_ONLY
    u_right_px: Annotated[float | None, "column of the head's centre in the raw right image, px"]
    v_right_px: Annotated[float | None, "row of the head's centre in the raw right image, px"]
    diameter_mm: Annotated[float | None, "diameter of the head, mm"]
    major_px: Annotated[float, "major axis (whole length) of the head's ellipse in the left image, px"]
    minor_px: Annotated[float, "minor axis (whole length) of the head's ellipse in the left image, px"]
    angle_deg: Annotated[float, "direction of the major axis from +u towards +v, degrees"]
    confidence: Annotated[float, "of the detection, 0 to 1"]
    height_mean_mm: Annotated[float | None, "mean height of the head above the skin, mm; positive stands proud"] = None
    height_min_mm: Annotated[float | None, "least height of the head above the skin, mm"] = None
    height_max_mm: Annotated[float | None, "greatest height of the head above the skin, mm"] = None
    height_u95_mm: Annotated[float | None, "expanded uncertainty (95 %) of height_mean_mm, mm"] = None
    tilt_deg: Annotated[float | None, "angle between the head and the skin, degrees"] = None
    tilt_u95_deg: Annotated[float | None, "expanded uncertainty (95 %) of tilt_deg, degrees"] = None
    crown_mm: Annotated[float | None, "how far a domed head's middle stands above its rim, mm"] = None
    n_inner: Annotated[int, "points on the head that were used"] = 0
    n_outer: Annotated[int, "points on the skin around it that were used"] = 0
    rms_inner_mm: Annotated[float | None, "scatter of the head's points about its plane, mm"] = None
    rms_outer_mm: Annotated[float | None, "scatter of the skin's points about the reference surface, mm"] = None
    diameter_u95_mm: Annotated[float | None, "expanded uncertainty (95 %) of diameter_mm, mm"] = None
    diameter_nominal_mm: Annotated[
        float | None, "diameter of the head by the panel's pattern, mm; NULL where it names none"
    ] = None
    found_by: Annotated[
        FoundBy | None,
        "what showed it: image (its ring) or relief (the cloud's deviation from the skin); NULL in older runs",
    ] = None


@dataclass(frozen=True)
class Hole(Feature):
    """One row of `holes`."""

    hole_id: Annotated[str, "name of the hole in its scene, from the top of the left image down"]
    _: KW_ONLY
    kind: Annotated[
        HoleKind,
        "open hole, filled hole (sealant), missing fastener (the panel's pattern has one here), temporary fastener",
    ]
    diameter_mm: Annotated[float | None, "diameter of the hole; below a countersink, where it ends, mm"] = None
    diameter_u95_mm: Annotated[float | None, "expanded uncertainty (95 %) of diameter_mm, mm"] = None
    depth_mm: Annotated[float | None, "how far what is seen inside lies below the skin, mm; NULL where nothing is"] = (
        None
    )
    countersink_diameter_mm: Annotated[
        float | None, "diameter of the countersink at the skin, mm; NULL without one"
    ] = None
    countersink_diameter_u95_mm: Annotated[
        float | None, "expanded uncertainty (95 %) of countersink_diameter_mm, mm"
    ] = None
    countersink_depth_mm: Annotated[float | None, "depth of the countersink, mm"] = None
    countersink_angle_deg: Annotated[float | None, "whole angle of the countersink's cone, degrees"] = None
    fastener_id: Annotated[str | None, "rivet of the panel's pattern that belongs here"] = None


@dataclass(frozen=True)
class SeamLine:
    """The centre line of a seam in the left image: what detection hands to measurement.

    One seam is one line, across rivet heads, highlights and other seams. It ends where its band of brightness does:
    with the gap, at the border of the seam that it runs into (a T joint), with the lit skin, or with the image. Its
    course is smooth; its points are in order, from either end.
    """

    seam_id: str
    """S01, S02 …: seams from left to right and top to bottom, lines without relief after them."""
    centre_px: NDArray[np.float64]
    """(n, 2): u, v of the middle between the band's borders, n ≥ 2, about every pixel along the line (raw left image).
    It is the middle of what is dark or bright there, chamfers and the walls that this camera sees included: not of
    the ideal edges D′ and G′."""
    width_px: NDArray[np.float64]
    """(n,): distance of the band's borders across its direction; NaN where it could not be told."""
    confidence: float
    """0 … 1; at most 0.2 where the 3-D data show neither a groove nor a step."""
    relief: bool
    """Whether the 3-D data show a groove or a step. A line without is no seam (paint, a long scratch) or a flush sealed
    one; it is shown and not measured."""
    joint: Joint | None = None


@dataclass(frozen=True)
class SeamStation(Course):
    """One row of `seam_stations`."""

    seam_id: Annotated[
        str, "name of the seam in the panel's pattern, the same on every scan of the station; XS… is in no pattern"
    ]
    s_mm: Annotated[float, "position along the seam (arc length from the nominal seam's start), mm"]
    _: KW_ONLY
    step_mm: Annotated[
        float | None,
        "height of side B minus side A, mm; A is the side at smaller u (seam nearer to vertical) or smaller v",
    ] = None
    step_u95_mm: Annotated[float | None, "expanded uncertainty (95 %) of step_mm, mm"] = None
    width_mm: Annotated[float | None, "width of the gap between the ideal edges, mm"] = None
    width_u95_mm: Annotated[float | None, "expanded uncertainty (95 %) of width_mm, mm"] = None
    joint: Annotated[
        Joint | None,
        "butt (a gap), butt sealed, or lap (the edge of one sheet on another: a step, no gap); NULL where not told",
    ] = None
    n_left: Annotated[int, "points used on side A"] = 0
    n_right: Annotated[int, "points used on side B"] = 0
    step_into_wind_mm: Annotated[
        float | None,
        "step that the air runs against (positive) or falls from (negative), mm; NULL without an airflow",
    ] = None


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


@dataclass(frozen=True)
class PanelKey:
    """What names an assembled panel."""

    aircraft_serial: str
    panel: str

    @property
    def panel_id(self) -> str:
        """The key as one word, such as ``MSN-0421~LH-F12``: the first two parts of its scenes' ids."""
        return f"{self.aircraft_serial}~{self.panel}"

    def __str__(self) -> str:
        return f"{self.aircraft_serial} {self.panel}"
