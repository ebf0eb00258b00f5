"""What a simulated panel is made of. Panel frame: x to the right and y up along the skin, z its outward normal; mm."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

from simulator.clutter import Bead, Cable, Cleco, Patch, Scratch, Speck
from simulator.defects import Dent, Gouge, Hail
from simulator.marks import Stencil, Stroke
from simulator.require import Point
from simulator.require import require as _require


@dataclass(frozen=True)
class Skin:
    """The undisturbed skin: a torus patch, optionally wavy."""

    radius_1_mm: float = math.inf
    radius_2_mm: float = math.inf
    """radius_1_mm, radius_2_mm: radii of curvature along `direction_deg` and across it; positive is convex towards the
    rig, inf is flat. Equal radii make a sphere, one infinite radius a cylinder."""
    direction_deg: float = 0.0
    """Direction of the first radius from +x towards +y."""
    waviness_mm: float = 0.0
    wavelength_mm: float = 150.0
    wave_direction_deg: float = 0.0
    wave_phase_deg: float = 0.0
    """waviness_mm, wavelength_mm, wave_direction_deg, wave_phase_deg: amplitude and course of a sine wave on top (0:
    none)."""

    def __post_init__(self) -> None:
        for name in ("radius_1_mm", "radius_2_mm"):
            _require(abs(getattr(self, name)) >= 300, name, getattr(self, name), "at least 300 mm, either sign, or inf")
        _require(self.wavelength_mm > 0, "wavelength_mm", self.wavelength_mm, "a positive length")
        _require(abs(self.waviness_mm) <= 1, "waviness_mm", self.waviness_mm, "at most 1 mm")


@dataclass(frozen=True)
class Slot:
    """Recess of a head."""

    length_mm: float
    width_mm: float
    """length_mm, width_mm: of a slot; over all and of the wings of a cross or a Torq-set; across the flats, both, of a
    hexagon."""
    depth_mm: float = 0.5
    angle_deg: float = 0.0
    cross: bool = False
    """Short for the shape "cross"."""
    shape: Literal["slot", "cross", "torq-set", "hex"] = "slot"
    """A Torq-set's wings are set off sideways by half their width."""

    def __post_init__(self) -> None:
        shapes = ("slot", "cross", "torq-set", "hex")
        _require(self.shape in shapes, "slot shape", self.shape, "slot, cross, torq-set or hex")
        for name in ("length_mm", "width_mm", "depth_mm"):
            _require(getattr(self, name) > 0, f"slot {name}", getattr(self, name), "a positive length")


@dataclass(frozen=True)
class Rivet:
    """A countersunk head in its hole."""

    id: str
    x_mm: float
    y_mm: float
    """x_mm, y_mm: where the skin point under the head's centre lies."""
    diameter_mm: float
    height_mm: float = 0.0
    """Mean of the head's distance to the skin's tangent plane at its centre, + proud."""
    tilt_deg: float = 0.0
    tilt_azimuth_deg: float = 0.0
    """tilt_deg, tilt_azimuth_deg: angle between the head's and the skin's normal, and the direction in which the head's
    normal leans."""
    crown_mm: float = 0.0
    """How far the middle of a domed head stands above its rim."""
    ring_width_mm: float = 0.15
    ring_depth_mm: float = 0.3
    """ring_width_mm, ring_depth_mm: the gap around the head."""
    ring_reflectance: float = 0.35
    head_reflectance: float = 1.0
    """ring_reflectance, head_reflectance: relative to the skin's."""
    arcs_deg: tuple[Point, ...] | None = None
    """tuple of (start, end), or None: where the ring is open; elsewhere it is filled flush, as under paint. None: all
    around."""
    slot: Slot | None = None

    def __post_init__(self) -> None:
        where = f"rivet {self.id}"
        _require(1 <= self.diameter_mm <= 40, f"{where} diameter_mm", self.diameter_mm, "1 to 40 mm")
        _require(abs(self.height_mm) <= 5, f"{where} height_mm", self.height_mm, "at most 5 mm either way")
        _require(0 <= self.tilt_deg <= 15, f"{where} tilt_deg", self.tilt_deg, "0 to 15 degrees")
        _require(abs(self.crown_mm) <= self.diameter_mm / 4, f"{where} crown_mm", self.crown_mm, "at most d/4")
        _require(0 < self.ring_width_mm <= 3, f"{where} ring_width_mm", self.ring_width_mm, "above 0, up to 3 mm")
        _require(0 <= self.ring_depth_mm <= 5, f"{where} ring_depth_mm", self.ring_depth_mm, "0 to 5 mm")
        for name in ("ring_reflectance", "head_reflectance"):
            _require(0 <= getattr(self, name) <= 3, f"{where} {name}", getattr(self, name), "0 to 3")
        for start, end in self.arcs_deg or ():
            _require(0 < end - start <= 360, f"{where} arcs_deg", (start, end), "start < end, at most a full turn")
        if self.slot is not None:
            _require(self.slot.length_mm <= self.diameter_mm, f"{where} slot", self.slot.length_mm, "within the head")


@dataclass(frozen=True)
class Hole:
    """A hole without a rivet."""

    x_mm: float
    y_mm: float
    diameter_mm: float
    """x_mm, y_mm, diameter_mm: of the bore."""
    depth_mm: float = 4.0
    """Of its ground: the sheet's thickness where it goes through, less where something fills it."""
    reflectance: float = 0.1
    """Of its ground, relative to the skin's; 0 where nothing lies behind the sheet."""
    id: str = ""
    """By its number if left out."""
    countersink_mm: float = 0.0
    countersink_deg: float = 100.0
    """countersink_mm, countersink_deg: outer diameter (0: none) and full angle of a countersink."""
    filled: bool = False
    """Closed with sealant up to its ground."""

    def __post_init__(self) -> None:
        _require(0 < self.diameter_mm <= 40, "hole diameter_mm", self.diameter_mm, "above 0, up to 40 mm")
        _require(0 < self.depth_mm <= 20, "hole depth_mm", self.depth_mm, "above 0, up to 20 mm")
        if self.countersink_mm:
            _require(self.diameter_mm < self.countersink_mm <= 40, "hole countersink_mm", self.countersink_mm,
                     "wider than the bore, up to 40 mm")  # fmt: skip
            _require(60 <= self.countersink_deg <= 150, "hole countersink_deg", self.countersink_deg, "60 to 150")
            _require(self.countersink_depth_mm <= self.depth_mm, "hole depth_mm", self.depth_mm,
                     f"at least the countersink's depth of {self.countersink_depth_mm:.2f} mm")  # fmt: skip

    @property
    def countersink_depth_mm(self) -> float:
        """How deep the cone reaches."""
        if not self.countersink_mm:
            return 0.0
        return 0.5 * (self.countersink_mm - self.diameter_mm) / math.tan(math.radians(self.countersink_deg / 2))


@dataclass(frozen=True)
class Seam:
    """A joint between two plates."""

    id: str
    points_mm: tuple[Point, ...]
    """tuple of (x, y): its course, at least two points that advance along the line from the first to the last."""
    width_mm: tuple[float, ...]
    """Distance between the two walls at equal intervals along the course, smoothly interpolated."""
    step_mm: tuple[float, ...] = (0.0,)
    """Height of the plate to the left of the course above the one to its right, likewise."""
    course: Literal["smooth", "polyline"] = "smooth"
    """A cubic spline through the points, or straight pieces with corners rounded over ±`CORNER_MM`."""
    chamfer_mm: float = 0.0
    chamfer_deg: float = 45.0
    """chamfer_mm, chamfer_deg: width of the broken edges and their slope against the skin."""
    depth_mm: float = 3.0
    """Floor below the skin; for a filled seam how far the sealant lies below both edges."""
    filled: bool = False
    """Sealant that joins both edges, instead of an open gap."""
    floor_reflectance: float = 0.3
    edge_reflectance: float = 0.85
    """floor_reflectance, edge_reflectance: of the gap's floor and of the chamfers, relative to the skin's."""
    starts_at: str | None = None
    ends_at: str | None = None
    """starts_at, ends_at: another seam's id where this one begins or ends (a T joint). None: at the panel's border."""
    joint: Literal["butt", "lap"] = "butt"
    """A lap's higher plate ends at the course on top of the lower one: no gap, so its width is 0, and only the higher
    plate's edge is broken."""
    edge_radius_mm: float = 0.0
    """Edges rounded with that radius in place of a chamfer (0: not)."""

    def __post_init__(self) -> None:
        where = f"seam {self.id}"
        _require(len(self.points_mm) >= 2, f"{where} points_mm", self.points_mm, "at least two points")
        _require(self.course in ("smooth", "polyline"), f"{where} course", self.course, "smooth or polyline")
        _require(self.joint in ("butt", "lap"), f"{where} joint", self.joint, "butt or lap")
        if self.joint == "lap":
            _require(not any(self.width_mm), f"{where} width_mm", self.width_mm, "0 in a lap joint")
            _require(not self.filled, f"{where} filled", self.filled, "false in a lap joint; lay a bead over it")
        else:
            _require(all(0.05 <= w <= 30 for w in self.width_mm), f"{where} width_mm", self.width_mm,
                     "0.05 to 30 mm each")  # fmt: skip
        _require(0 <= self.edge_radius_mm <= 3, f"{where} edge_radius_mm", self.edge_radius_mm, "0 to 3 mm")
        _require(not (self.chamfer_mm and self.edge_radius_mm), f"{where} edge_radius_mm", self.edge_radius_mm,
                 "0 beside a chamfer")  # fmt: skip
        _require(all(abs(s) <= 10 for s in self.step_mm), f"{where} step_mm", self.step_mm, "at most 10 mm each")
        _require(bool(self.width_mm and self.step_mm), where, "no width or step", "at least one value of each")
        _require(0 <= self.chamfer_mm <= 3, f"{where} chamfer_mm", self.chamfer_mm, "0 to 3 mm")
        _require(0 < self.chamfer_deg <= 75, f"{where} chamfer_deg", self.chamfer_deg, "above 0, up to 75 degrees")
        _require(0 <= self.depth_mm <= 20, f"{where} depth_mm", self.depth_mm, "0 to 20 mm")
        _require(self.filled or self.depth_mm > 0, f"{where} depth_mm", self.depth_mm, "above 0 in an open gap")
        chord = (self.points_mm[-1][0] - self.points_mm[0][0], self.points_mm[-1][1] - self.points_mm[0][1])
        advance = [
            (b[0] - a[0]) * chord[0] + (b[1] - a[1]) * chord[1]
            for a, b in zip(self.points_mm, self.points_mm[1:], strict=False)
        ]
        _require(
            all(a > 0 for a in advance), f"{where} points_mm", self.points_mm, "points that advance along its chord"
        )


@dataclass(frozen=True)
class Surface:
    """How the skin reflects."""

    reflectance: float = 0.5
    """Matt reflectance of the skin."""
    specular: float = 0.0
    roughness: float = 0.35
    """specular, roughness: weight of the mirror-like lobe relative to the matt part (1: aluminium about as it comes)
    and GGX width α."""
    brushing: float = 0.02
    """Standard deviation of the fine streaks, relative."""
    brushing_deg: float = 0.0
    streak_mm: float = 2.0
    grain_mm: float = 0.25
    """brushing_deg, streak_mm, grain_mm: their direction, length and width."""
    blotches: float = 0.08
    blotch_mm: float = 35.0
    """blotches, blotch_mm: standard deviation and size of slow changes."""
    scratches: tuple[Scratch, ...] = ()
    patches: tuple[Patch, ...] = ()
    random_scratches: int = 0
    """That many more, drawn at random."""
    stencils: tuple[Stencil, ...] = ()
    strokes: tuple[Stroke, ...] = ()

    def __post_init__(self) -> None:
        _require(0 < self.reflectance <= 1, "reflectance", self.reflectance, "above 0, up to 1")
        _require(self.specular >= 0, "specular", self.specular, "0 or more")
        _require(0.02 <= self.roughness <= 1, "roughness", self.roughness, "0.02 to 1")
        for name in ("brushing", "blotches"):
            _require(0 <= getattr(self, name) <= 0.5, name, getattr(self, name), "0 to 0.5")
        for name in ("streak_mm", "grain_mm", "blotch_mm"):
            _require(getattr(self, name) > 0, name, getattr(self, name), "a positive length")
        _require(self.random_scratches >= 0, "random_scratches", self.random_scratches, "0 or more")


@dataclass(frozen=True)
class Panel:
    """A rectangular panel centred on the origin, with a dull plane `background_mm` behind it."""

    width_mm: float = 300.0
    height_mm: float = 205.0
    skin: Skin = field(default_factory=Skin)
    rivets: tuple[Rivet, ...] = ()
    seams: tuple[Seam, ...] = ()
    holes: tuple[Hole, ...] = ()
    cables: tuple[Cable, ...] = ()
    surface: Surface = field(default_factory=Surface)
    background_mm: float = 40.0
    background_reflectance: float = 0.05
    dents: tuple[Dent, ...] = ()
    gouges: tuple[Gouge, ...] = ()
    hail: tuple[Hail, ...] = ()
    clecos: tuple[Cleco, ...] = ()
    specks: tuple[Speck, ...] = ()
    beads: tuple[Bead, ...] = ()

    def __post_init__(self) -> None:
        _require(min(self.width_mm, self.height_mm) > 10, "panel size", (self.width_mm, self.height_mm), "above 10 mm")
        _require(self.background_mm >= 25, "background_mm", self.background_mm, "at least 25 mm")
        round_ones = len(self.rivets) + len(self.holes) + 2 * len(self.clecos) + len(self.specks)
        _require(round_ones <= 500, "rivets", round_ones, "at most 500 with holes, specks and twice the clecos")
        lines = len(self.seams) + len(self.cables) + len(self.beads)
        _require(lines <= 20, "seams", lines, "at most 20 with cables and beads")
        for kind, ids in (
            ("rivet", [r.id for r in self.rivets]),
            ("seam", [s.id for s in self.seams]),
            ("dent", [d.id for d in self.all_dents] + [g.id for g in self.gouges]),
        ):
            _require(len(set(ids)) == len(ids), f"{kind} ids", ids, "each only once")
        names = {s.id for s in self.seams}
        for seam in self.seams:
            for other in (seam.starts_at, seam.ends_at):
                _require(other is None or (other in names and other != seam.id), f"seam {seam.id}", other,
                         "the id of another seam")  # fmt: skip
        places = [(r.id, r.x_mm, r.y_mm) for r in self.rivets] + [("a hole", h.x_mm, h.y_mm) for h in self.holes]
        places += [("a cleco", c.x_mm, c.y_mm) for c in self.clecos] + [
            ("a speck", k.x_mm, k.y_mm) for k in self.specks
        ]
        for name, x, y in places:
            inside = abs(x) < self.width_mm / 2 and abs(y) < self.height_mm / 2
            _require(inside, f"position of {name}", (x, y), "on the panel")

    @property
    def all_dents(self) -> tuple[Dent, ...]:
        """The dents that are given, and those of the hail."""
        numbered = [
            replace(dent, id=f"{dent.id}-{k + 1}") if k else dent
            for k, hail in enumerate(self.hail)
            for dent in hail.dents()
        ]
        return (*self.dents, *numbered)
