"""A panel is recognised on every scan, wherever the rig stands and whatever the detector missed or made up."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from metrology.arrays import Array
from metrology.cloud import DecodedView, Reconstruction
from metrology.errors import SpecError
from metrology.kinds import RIVET
from metrology.panel import NominalRivet, NominalSeam, PanelLayout, Placement, course_length, foot_on, points_along
from metrology.registration import Registration, enrol, register
from metrology.registration.hypothesis import Matcher
from metrology.results import Rivet, SeamStation
from metrology.rig import Device, Rig
from metrology.tolerance import PanelSpec, judge
from tests.support.rows import rivet_at, station_at

SIZE = (203, 154)
DISTANCE = 700.0


def device(width: int, height: int, f: float, yaw: float, centre: tuple[float, float, float]) -> Device:
    K = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1.0]])
    R = Rotation.from_rotvec([0, yaw, 0]).as_matrix()
    return Device(width, height, K, np.array([-0.05, 0.02, 1e-4, -1e-4]), R, -R @ np.array(centre))


RIG = Rig(
    "r", "",
    device(*SIZE, 415.0, 0.0, (0, 0, 0)),
    device(*SIZE, 415.0, 0.40, (290, 0, 60)),
    device(1280, 800, 2500.0, 0.21, (150, -20, 20)),
)  # fmt: skip

RAYS = RIG.left.rays(np.stack(np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])), -1).astype(float))

# The left camera looks at the panel from outside: x to the right, y up, z towards the rig.
FACING = np.diag([1.0, -1.0, -1.0])
NOMINAL = Placement(FACING, np.array([0.0, 0.0, DISTANCE]))


@dataclass(frozen=True)
class Panel:
    """A skin z(x, y) = −x²/2rx − y²/2ry with rivets at (n, 2) and seams, each (m, 2)."""

    rivets: Array
    diameters: Array
    seams: tuple[Array, ...] = ()
    curvature: tuple[float, float] = (0.0, 0.0)

    def lift(self, xy: Array) -> Array:
        xy = np.asarray(xy, float)
        z = -0.5 * (self.curvature[0] * xy[..., 0] ** 2 + self.curvature[1] * xy[..., 1] ** 2)
        return np.concatenate([xy, z[..., None]], axis=-1)

    def layout(self, stations: dict[str, Placement] | None = None, normals: bool = False) -> PanelLayout:
        outward = np.column_stack([self.rivets * self.curvature, np.ones(len(self.rivets))])
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        return PanelLayout(
            tuple(
                NominalRivet(f"R{k:02d}", tuple(p), d, normal=tuple(n) if normals else None)
                for k, (p, d, n) in enumerate(zip(self.lift(self.rivets), self.diameters, outward, strict=True), 1)
            ),
            tuple(NominalSeam(f"S{k:02d}", tuple(map(tuple, self.course(c)))) for k, c in enumerate(self.seams, 1)),
            stations or {},
        )

    def course(self, corners: Array) -> Array:
        """The skin's curved line under a polyline (m, 2), with a corner every five millimetres or so."""
        flat = np.column_stack([corners, np.zeros(len(corners))])
        s = np.linspace(0, course_length(flat), int(course_length(flat) / 5))
        return self.lift(points_along(flat, s)[:, :2])

    def seen(self, placement: Placement) -> Reconstruction:
        """The cloud of the bare skin."""
        rays = RAYS @ placement.R.T
        u = rays[..., 0]
        reach = np.full(u.shape, -placement.t[2] / rays[..., 2].mean())
        for _ in range(6):  # Newton along the ray
            at = placement.t + reach[..., None] * rays
            above = at[..., 2] - self.lift(at[..., :2])[..., 2]
            slope = (
                rays[..., 2]
                + self.curvature[0] * at[..., 0] * rays[..., 0]
                + self.curvature[1] * at[..., 1] * rays[..., 1]
            )
            reach = reach - above / slope
        points = placement.to_rig(placement.t + reach[..., None] * rays).astype(np.float32)
        blank = np.zeros(u.shape, np.float32)
        flags = np.zeros(u.shape, np.uint16)
        view = DecodedView(blank, blank, blank, blank, flags)
        return Reconstruction(RIG, view, view, points, blank, flags)


NOTHING_ASKED = PanelSpec("P", "A")


def moved(placement: Placement, rng: np.random.Generator, shift: float = 15.0, turn: float = 5.0) -> Placement:
    """The rig shifted by up to `shift` mm and turned about itself by up to `turn` degrees, in any direction."""
    axis, direction = (x / np.linalg.norm(x) for x in rng.normal(size=(2, 3)))
    turned = Rotation.from_rotvec(axis * np.radians(rng.uniform(0, turn))).as_matrix()
    return Placement(placement.R @ turned, placement.t + direction * rng.uniform(0, shift))


def found_rivet(name: str, position: Array, diameter: float) -> Rivet:
    u, v = RIG.left.project(position)
    size = diameter * RIG.left.K[0, 0] / position[2]
    return rivet_at(name, tuple(map(float, position)), (float(u), float(v)), diameter, size)


def visible(points: Array, margin: float = 4.0) -> NDArray[np.bool_]:
    """What both cameras and the projector have within their images."""
    inside = np.ones(len(points), bool)
    for d in (RIG.left, RIG.right, RIG.projector):
        pixels = d.project(points)
        inside &= (pixels > margin).all(1) & (pixels < np.array([d.width, d.height]) - margin).all(1)
    return inside


@dataclass(frozen=True)
class ScanOf:
    """A simulated result and, per row, the true nominal id (None for a false one)."""

    rivets: list[Rivet]
    truth: dict[str, str | None]
    stations: list[SeamStation]


def scan(
    panel: Panel, placement: Placement, rng: np.random.Generator, missing: float = 0.0, false: float = 0.0,
    sigma: float = 0.05,
) -> ScanOf:  # fmt: skip
    at = placement.to_rig(panel.lift(panel.rivets))
    rows: list[tuple[Array, float, str | None]] = [
        (at[k] + rng.normal(0, sigma, 3), panel.diameters[k] * rng.normal(1, 0.01), f"R{k + 1:02d}")
        for k in np.flatnonzero(visible(at))
        if rng.random() >= missing
    ]
    n_false = rng.binomial(max(len(rows), 1), false)
    for xy in rng.uniform(-90, 90, (n_false, 2)):
        rows.append((placement.to_rig(panel.lift(xy)), rng.uniform(3, 9), None))
    rng.shuffle(rows)
    rivets = [found_rivet(f"F{k:02d}", p, d) for k, (p, d, _) in enumerate(rows)]
    stations = []
    for k, course in enumerate(panel.seams):
        corners = panel.course(course)
        s = np.arange(rng.uniform(0, 2), course_length(corners), 2.0)
        points = placement.to_rig(panel.lift(points_along(corners, s)[:, :2]))
        inside = visible(points)
        for own, point in zip(s[inside] - s[inside][0], points[inside], strict=True):
            u, v = RIG.left.project(point)
            stations.append(
                station_at(
                    f"L{k}",
                    float(own),
                    tuple(map(float, point)),
                    (float(u), float(v)),
                    step_mm=0.1,
                    step_u95_mm=0.01,
                    width_mm=2.0,
                    width_u95_mm=0.05,
                )
            )
    return ScanOf(rivets, {f"F{k:02d}": name for k, (_, _, name) in enumerate(rows)}, stations)


def run(panel: Panel, layout: PanelLayout, placement: Placement, seen: ScanOf, station: str = "S1") -> Registration:
    return register(seen.rivets, seen.stations, panel.seen(placement), layout, station)


def names(seen: ScanOf, result: Registration) -> dict[str, str]:
    """True id → reported id, recognised by position."""
    by_pixel = {(r.u_px, r.v_px): r.rivet_id for r in result.rivets}
    return {truth: by_pixel[r.u_px, r.v_px] for r in seen.rivets if (truth := seen.truth[r.rivet_id])}


def irregular(rng: np.random.Generator) -> Panel:
    """Rivets in staggered rows with gaps, three sizes, larger than the field of view."""
    rows = np.array(
        [(x + 10 * (j % 2), y) for j, y in enumerate(range(-150, 151, 30)) for x in range(-220, 221, 25)], float
    )
    rows = rows[rng.random(len(rows)) > 0.25]
    return Panel(rows, rng.choice([4.0, 5.0, 8.0], len(rows)), (np.array([[12.0, -160], [12.0, 160]]),))


def symmetric() -> Panel:
    """A regular grid in view as a whole: alike after a half turn, and after a shift but for its rim."""
    x, y = np.meshgrid(np.arange(-100, 101, 25.0), np.arange(-50, 51, 25.0))
    grid = np.column_stack([x.ravel(), y.ravel()])
    return Panel(grid, np.full(len(grid), 5.0))


@pytest.mark.parametrize(
    ("kind", "curvature", "scans"),
    [
        ("irregular", (0.0, 0.0), 7),
        ("irregular", (1 / 900, 1 / 2500), 20),
        ("irregular", (1 / 400, 0.0), 7),
        ("symmetric", (1 / 900, 1 / 2500), 7),
    ],
)
def test_ids_stay_from_scan_to_scan(kind: str, curvature: tuple[float, float], scans: int) -> None:
    rng = np.random.default_rng(7)
    panel = replace(irregular(rng) if kind == "irregular" else symmetric(), curvature=curvature)
    layout = panel.layout({"S1": NOMINAL})
    for _ in range(scans):
        placement = moved(NOMINAL, rng)
        seen = scan(panel, placement, rng, missing=0.1, false=0.05)
        result = run(panel, layout, placement, seen)
        assert result.status == "recognised"
        assert all(truth == reported for truth, reported in names(seen, result).items())
        # Every rivet in view is there or reported missing; nothing is both, and no false one took a name.
        assert not set(result.missing) & set(names(seen, result))
        assert len(result.unlisted) == sum(name is None for name in seen.truth.values())
        position = result.placement.to_panel(placement.to_rig([0.0, 0, 0]))
        assert np.linalg.norm(position) < 0.15


def test_missing_rivets_are_rows_that_say_so() -> None:
    rng = np.random.default_rng(1)
    panel = symmetric()
    seen = scan(panel, NOMINAL, rng)
    gone = seen.truth[seen.rivets[7].rivet_id]
    left = [r for k, r in enumerate(seen.rivets) if k != 7]
    result = register(left, [], panel.seen(NOMINAL), panel.layout({"S1": NOMINAL}), "S1")
    assert result.missing == (gone,)
    (row,) = [r for r in result.rivets if r.rivet_id == gone]
    assert row.reason == "missing: no head found where the pattern has one"
    assert row.height_mean_mm is None
    assert np.hypot(row.u_px - seen.rivets[7].u_px, row.v_px - seen.rivets[7].v_px) < 0.5
    assert any(f"not found: {gone}" in w for w in result.warnings)
    unvouched = register(left, [], panel.seen(NOMINAL), panel.layout({"S1": NOMINAL}), "S1", missing_rows=False)
    assert unvouched.warnings == result.warnings
    assert len(unvouched.rivets) == len(left)


def test_a_head_of_the_wrong_size_keeps_its_name_and_says_so() -> None:
    rng = np.random.default_rng(1)
    panel = symmetric()
    seen = scan(panel, NOMINAL, rng)
    rivets = [replace(r, diameter_mm=8.0) if k == 3 else r for k, r in enumerate(seen.rivets)]
    result = register(rivets, [], panel.seen(NOMINAL), panel.layout({"S1": NOMINAL}), "S1")
    said = {r.rivet_id: (r.decision, r.severity) for r in judge(RIVET, result.rivets, NOTHING_ASKED) if r.reason}
    assert said == {seen.truth[seen.rivets[3].rivet_id]: ("fail", "red")}
    assert not result.missing
    assert not result.warnings


@pytest.mark.parametrize("size", [2.4, 6.6, 8.0, 11.0])
def test_a_wrong_fastener_is_named_whatever_its_size(size: float) -> None:
    rng = np.random.default_rng(1)
    panel = symmetric()
    seen = scan(panel, NOMINAL, rng)
    rivets = [
        replace(r, diameter_u95_mm=0.3, diameter_mm=size if k == 3 else r.diameter_mm)
        for k, r in enumerate(seen.rivets)
    ]
    result = register(rivets, [], panel.seen(NOMINAL), panel.layout({"S1": NOMINAL}), "S1")
    judged = judge(RIVET, result.rivets, NOTHING_ASKED)
    findings = {r.rivet_id: r.reason for r in judged if r.decision != "no limit"}
    assert findings == {seen.truth[seen.rivets[3].rivet_id]: f"wrong fastener: {size:.1f} mm, expected 5.0"}
    assert not result.missing
    assert not result.unlisted


def test_a_diameter_that_its_own_uncertainty_explains_is_no_certain_finding() -> None:
    rivet = replace(found_rivet("R1", np.array([0.0, 0, 700]), 5.7), diameter_nominal_mm=5.0)
    verdicts = {u95: judge(RIVET, [replace(rivet, diameter_u95_mm=u95)], NOTHING_ASKED)[0] for u95 in (0.1, 0.3)}
    assert verdicts[0.1].decision == "fail"
    assert (verdicts[0.3].decision, verdicts[0.3].severity) == ("conditional fail", "blue")
    assert verdicts[0.3].reason == "perhaps a wrong fastener: 5.7 mm, expected 5.0 (diameter ± 0.3 mm)"
    for unknown in ({"diameter_mm": None}, {"diameter_nominal_mm": None}, {"diameter_mm": 5.4}):
        assert judge(RIVET, [replace(rivet, **unknown)], NOTHING_ASKED)[0].decision == "no limit"


@pytest.mark.parametrize("factor", [1.45, 2.6])
def test_most_heads_of_another_size_ask_for_the_station(factor: float) -> None:
    rng = np.random.default_rng(1)
    panel = symmetric()
    seen = scan(panel, NOMINAL, rng)
    other = [replace(r, diameter_mm=factor * r.diameter_mm, diameter_u95_mm=0.2) for r in seen.rivets]
    result = register(other, [], panel.seen(NOMINAL), panel.layout({"S1": NOMINAL}), "S1")
    assert "is this the right station?" in result.warnings[-1]
    if result.status == "recognised":
        n = len(seen.rivets)
        assert f"heads of another size than the pattern's: {n} of {n}" in result.warnings[-1]
        assert {r.decision for r in judge(RIVET, result.rivets, NOTHING_ASKED)} == {"fail"}


def test_a_half_turn_is_resolved_by_the_station() -> None:
    rng = np.random.default_rng(2)
    panel = symmetric()
    turned = Placement(np.diag([-1.0, -1.0, 1.0]) @ NOMINAL.R, NOMINAL.t)
    layout = panel.layout({"S1": NOMINAL, "S2": turned})
    seen = scan(panel, turned, rng)
    assert names(seen, run(panel, layout, turned, seen, "S2"))["R01"] == "R01"
    n = len(panel.rivets)
    assert names(seen, run(panel, layout, turned, seen, "S1"))["R01"] == f"R{n:02d}"


def test_without_a_nominal_placement_the_whole_pattern_is_searched() -> None:
    rng = np.random.default_rng(3)
    panel = replace(irregular(rng), curvature=(1 / 900, 0.0))
    placement = Placement(Rotation.from_rotvec([0, 0, 2.0]).as_matrix() @ FACING, np.array([40.0, -30, 690]))
    seen = scan(panel, placement, rng, missing=0.1, false=0.05)
    result = run(panel, panel.layout(), placement, seen, "anywhere")
    assert all(truth == reported for truth, reported in names(seen, result).items())
    assert result.shift_mm is None


def test_a_pattern_alike_after_a_turn_is_called_ambiguous_without_a_nominal_placement() -> None:
    rng = np.random.default_rng(3)
    panel = symmetric()
    result = run(panel, panel.layout(), NOMINAL, scan(panel, NOMINAL, rng), "anywhere")
    assert any("two ways" in w for w in result.warnings)


def test_another_panel_is_not_recognised_and_keeps_its_own_ids() -> None:
    rng = np.random.default_rng(4)
    panel, other = irregular(rng), irregular(rng)
    other = replace(other, rivets=other.rivets + rng.uniform(-10, 10, other.rivets.shape))
    seen = scan(other, NOMINAL, rng)
    result = run(other, panel.layout({"S1": NOMINAL}), NOMINAL, seen)
    assert result.status == "not recognised"
    assert [r.rivet_id for r in result.rivets] == [r.rivet_id for r in seen.rivets]
    assert "not recognised" in result.warnings[0]


def test_rivets_in_one_row_are_recognised_and_placed() -> None:
    rng = np.random.default_rng(5)
    panel = Panel(np.column_stack([np.arange(-100, 101, 20.0), np.zeros(11)]), np.full(11, 5.0), curvature=(0, 1 / 900))
    for _ in range(10):
        placement = moved(NOMINAL, rng, shift=8, turn=0.5)
        seen = scan(panel, placement, rng, missing=0.1)
        result = run(panel, panel.layout({"S1": NOMINAL}, normals=True), placement, seen)
        assert all(truth == reported for truth, reported in names(seen, result).items())
        # The turn about the row follows from the skin's direction: a place beside the row is found to a millimetre.
        beside = np.array([0.0, 50.0, 0.0])
        assert np.linalg.norm(result.placement.to_panel(placement.to_rig(beside)) - beside) < 1.0


def test_seam_positions_stay_the_same_and_pieces_become_one() -> None:
    rng = np.random.default_rng(6)
    panel = replace(irregular(rng), curvature=(0.0, 1 / 900))
    layout = panel.layout({"S1": NOMINAL})
    for _ in range(5):
        placement = moved(NOMINAL, rng)
        seen = scan(panel, placement, rng)
        half = len(seen.stations) // 2
        # Found as two pieces, the second counted the other way; one station could not be measured.
        first, second = seen.stations[:half], [replace(s, seam_id="L9") for s in seen.stations[: half - 1 : -1]]
        second = [replace(s, s_mm=2.0 * k) for k, s in enumerate(second)]
        truth = foot_on(
            layout.seams[0].course, placement.to_panel([(s.x_mm, s.y_mm, s.z_mm) for s in first + second])
        ).s
        second[3] = replace(second[3], x_mm=None, y_mm=None, z_mm=None, step_mm=None, reason="no points")
        result = register(seen.rivets, first + second, panel.seen(placement), layout, "S1")
        assert {s.seam_id for s in result.stations} == {"S01"}
        assert len(result.stations) == len(seen.stations)
        np.testing.assert_allclose([s.s_mm for s in result.stations], np.sort(truth), atol=0.3)


def test_a_lone_seam_is_recognised_by_its_course() -> None:
    rng = np.random.default_rng(8)
    courses = (np.array([[-40.0, -160], [-40, 160]]), np.array([[30.0, -160], [30, 160]]))
    panel = Panel(np.empty((0, 2)), np.empty(0), courses)
    placement = moved(NOMINAL, rng, shift=6.0, turn=1.0)
    seen = scan(panel, placement, rng)
    result = run(panel, panel.layout({"S1": NOMINAL}), placement, seen)
    assert result.status == "recognised"
    middle = [np.median([s.x_panel_mm for s in result.stations if s.seam_id == name]) for name in ("S01", "S02")]
    np.testing.assert_allclose(middle, [-40, 30], atol=0.5)


def test_of_many_seams_only_placements_within_the_rig_s_reach_are_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten seams on ten nominal ones are a hundred shifts, of which each seam's own is within reach, all alike."""
    rng = np.random.default_rng(8)
    courses = tuple(np.array([[x, -160.0], [x, 160.0]]) for x in np.linspace(-135, 135, 10))
    panel = Panel(np.empty((0, 2)), np.empty(0), courses)
    placement = moved(NOMINAL, rng, shift=6.0, turn=1.0)
    seen = scan(panel, placement, rng)
    tried = []
    refined = Matcher._refined
    monkeypatch.setattr(Matcher, "_refined", lambda self, start: tried.append(start) or refined(self, start))
    assert run(panel, panel.layout({"S1": NOMINAL}), placement, seen).status == "recognised"
    assert 1 < len(tried) < 10


def test_a_seam_not_found_in_view_has_rows_that_say_so() -> None:
    rng = np.random.default_rng(9)
    panel = irregular(rng)
    seen = scan(panel, NOMINAL, rng)
    layout = panel.layout({"S1": NOMINAL})
    lost = register(seen.rivets, [], panel.seen(NOMINAL), layout, "S1").stations
    assert len(lost) == 1
    assert "missing: the seam was not found over" in (lost[0].reason or "")
    holed = [s for s in seen.stations if abs(s.s_mm - 60) > 10]
    rows = register(seen.rivets, holed, panel.seen(NOMINAL), layout, "S1").stations
    assert sum("not found over" in (s.reason or "") for s in rows) == 1


@pytest.mark.parametrize(("flow", "sign"), [((1, 0, 0), 1), ((-1, 0, 0), -1), ((1, 1, 0), 1), ((0, 1, 0), None)])
def test_steps_into_the_wind_are_those_whose_downstream_side_is_higher(
    flow: tuple[float, float, float], sign: int | None
) -> None:
    rng = np.random.default_rng(10)
    panel = irregular(rng)
    layout = panel.layout({"S1": NOMINAL})
    layout = replace(layout, seams=tuple(replace(s, airflow=flow) for s in layout.seams))
    seen = scan(panel, NOMINAL, rng)
    # The seam is upright in the image, so side B is at larger u, which is the panel's +x; B stands 0.1 mm higher.
    for row in run(panel, layout, NOMINAL, seen).stations:
        assert row.step_into_wind_mm == (None if sign is None else pytest.approx(sign * 0.1))


def test_the_first_scan_enrols_the_pattern_and_later_ones_are_recognised_in_it() -> None:
    rng = np.random.default_rng(11)
    panel = replace(irregular(rng), curvature=(1 / 900, 0.0))
    first = scan(panel, NOMINAL, rng)
    enrolled = enrol(first.rivets, first.stations, panel.seen(NOMINAL).points, "S3")
    assert enrolled.status == "enrolled"
    assert any("first scan of station S3" in w for w in enrolled.warnings)
    assert enrolled.enrolled is not None
    # x to the right and y up for a viewer outside.
    left = min(enrolled.rivets, key=lambda r: r.u_px)
    top = min(enrolled.rivets, key=lambda r: r.v_px)
    assert left.x_panel_mm < min(r.x_panel_mm for r in enrolled.rivets) + 2
    assert top.y_panel_mm > max(r.y_panel_mm for r in enrolled.rivets) - 2
    given = {truth: own for own, truth in first.truth.items()}
    for _ in range(5):
        placement = moved(NOMINAL, rng)
        seen = scan(panel, placement, rng, missing=0.1, false=0.05)
        result = register(seen.rivets, seen.stations, panel.seen(placement), enrolled.enrolled, "S3")
        for truth, reported in names(seen, result).items():
            assert reported == given.get(truth, reported)
        assert {s.seam_id for s in result.stations} <= {"L0"}


def test_layout_mistakes_are_refused() -> None:
    rivet = NominalRivet("R01", (0, 0, 0))
    with pytest.raises(SpecError, match="twice"):
        PanelLayout((rivet, rivet))
    with pytest.raises(SpecError, match="two or more"):
        NominalSeam("S01", ((0, 0, 0),))
    with pytest.raises(SpecError, match="rotation"):
        Placement(np.diag([1.0, 1.0, -1.0]), np.zeros(3))


def test_feet_on_a_course_go_on_past_its_ends() -> None:
    foot = foot_on([(0, 0, 0), (10, 0, 0), (10, 10, 0)], [(-3, 1, 0), (4, -2, 0), (11, 5, 0), (10, 14, 0)])
    np.testing.assert_allclose(foot.s, [-3, 4, 15, 24])
    np.testing.assert_allclose(foot.distance, [1, 2, 1, 0])
