"""Defects on simulated panels: how many are found, how well they are measured, and what is found where there are none.

python benchmarks/study_defects.py [--panels 30] [--first 0] [--bare 40] [--repeats 10] [--rendered]

Dents, bumps and creases 0.02–2 mm deep and 5–80 mm long among rivets and seams, on skins from flat to 0.4 m radius:
recall, errors of depth and extents, and how often U95 covers the error; the same panels without defects; one panel
scanned again and again; and depths by what people do otherwise: a plane, and a cylinder, fitted by least squares.

Clouds are traced with the noise of a scan (0.012 mm a point, correlated over two pixels) and are means over the area
that a point of a scan is one of; heads and seams are where they are: a few seconds for each panel. With --rendered
fringes are rendered, decoded and matched, and heads and seams are looked for: a minute or two for each.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from scipy.optimize import least_squares

from metrology.cloud import DecodedView, Reconstruction
from metrology.defects.measure import measure_defects
from metrology.defects.row import Defect
from metrology.defects.settings import DefectSettings
from metrology.defects.skin_map import skin_map
from metrology.fastening import detect_fasteners
from metrology.reconstruct import reconstruct
from metrology.results import Rivet, RivetDetection, SeamLine, SeamStation
from metrology.rig import Rig
from metrology.rivets import measure_rivets
from metrology.seams import detect_seams, measure_seams
from metrology.sighted import Sighted
from simulator.defects import Dent
from simulator.lens import moved
from simulator.pack import pack
from simulator.panel import Panel, Seam
from simulator.random_panel import Variety, random_panel, random_placement
from simulator.scene import expose, fringe_light, make_rig, place, set_up
from simulator.spec import Camera, RigSpec, SceneKeys, SimulationSpec
from simulator.true_dents import TrueDent
from simulator.truth import Truth
from simulator.truth import truth as true_of
from tests.support.random_seams import SeamVariety, random_seam
from tests.support.whole_panel import meet

PER_PANEL = 4
NOISE_MM, CORRELATED_PX, SUPPORT_PX = 0.012, 0.8, 1.4


@dataclass(frozen=True)
class Scan:
    """A simulated scan as a kind of features gets it, and its true defects."""

    sighted: Sighted
    truth: tuple[TrueDent, ...]


def dents(rng: np.random.Generator, number: int, panel: Panel) -> tuple[Dent, ...]:
    """Defects clear of each other, anywhere on a panel: beside seams and under rivets too."""
    found: list[Dent] = []
    for _ in range(400):
        if len(found) == number:
            break
        length = math.exp(rng.uniform(math.log(5.0), math.log(80.0)))
        width = length * rng.uniform(0.5, 1.0)
        shape = rng.choice(["smooth", "smooth", "sharp", "crease"])
        depth = math.exp(rng.uniform(math.log(0.02), math.log(min(2.0, 0.15 * width))))
        room = [0.5 * size - 0.7 * length - 5 for size in (panel.width_mm, panel.height_mm)]
        if min(room) <= 0:
            continue
        x, y = (float(rng.uniform(-r, r)) for r in room)
        if all(math.hypot(x - d.x_mm, y - d.y_mm) > 1.1 * (length + d.axes_mm[0]) for d in found):
            sign = -1 if rng.random() < 0.2 else 1
            found.append(Dent(f"D{len(found)}", x, y, sign * depth, (length, width), rng.uniform(0, 180), str(shape)))
    return tuple(found)


def specification(number: int, with_dents: bool, samples: int = 24) -> SimulationSpec:
    """A panel of the study; the same number is the same panel, with defects or without."""
    rng = np.random.default_rng([22, number])
    seams: tuple[Seam, ...] = ()
    if number % 3:
        seams = (random_seam(rng, SeamVariety(direction_deg=rng.uniform(0, 180), width_mm=(0.8, 2.5))),)
    variety = Variety(rivets=(6, 14), radius_mm=(400.0, math.inf), scratches=(0, 20), stickers=0, smudges=2)
    panel = random_panel(rng, variety, seams)
    placement = random_placement(rng)
    if with_dents:
        panel = replace(panel, dents=dents(np.random.default_rng([23, number]), PER_PANEL, panel))
    return SimulationSpec(
        "flushline-simulation/1",
        SceneKeys("SIM", "DEFECTS", "S1", "2026-11-20T09:00:00Z"),
        panel,
        RigSpec(seed=300 + number),
        (placement,),
        camera=Camera(samples=samples),
        seed=int(rng.integers(1, 10000)),
    )


def scans(spec: SimulationSpec, repeats: int, rendered: bool) -> list[Scan]:
    """Scans of a panel that does not move, each with noise of its own."""
    rng = np.random.default_rng(spec.seed)
    return _rendered(spec, repeats, rng) if rendered else _traced(spec, repeats, rng)


def _rendered(spec: SimulationSpec, repeats: int, rng: np.random.Generator) -> list[Scan]:
    rig = make_rig(spec)
    stage = set_up(spec, rig, spec.placements[0])
    light = fringe_light(spec, stage, rng)
    found = []
    for _ in range(repeats):
        left, right = (expose(spec, light[side], rng) for side in ("left", "right"))
        cloud = reconstruct(left, right, rig, spec.fringe, spec.camera.exposures)
        fasteners = detect_fasteners(cloud)
        lines = detect_seams(cloud, fasteners.rivets)
        features = {
            "rivet": measure_rivets(fasteners.rivets, cloud, lines),
            "seam station": measure_seams(lines, cloud, fasteners.rivets),
        }
        found.append(Scan(Sighted(cloud, fasteners.rivets, lines, features, fasteners.openings), stage.truth.dents))
    return found


def _traced(spec: SimulationSpec, repeats: int, rng: np.random.Generator) -> list[Scan]:
    rig = make_rig(spec)
    pose, relief = place(rig, spec.placements[0]), pack(spec.panel)
    known = true_of(spec.panel, relief, rig, pose)
    camera = moved(rig.left, pose.R, pose.t)
    rays = camera.rays(np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).astype(float))
    points, kinds = meet(relief, camera.centre, rays.reshape(-1, 3))
    half = 0.5 * np.array([spec.panel.width_mm, spec.panel.height_mm])
    points[(np.abs(points[:, :2]) > half).any(axis=1) | (kinds < 0)] = np.nan
    exact = _meant(pose.to_rig(points).reshape(camera.height, camera.width, 3))
    return [Scan(_sighted(exact, known, rig, rng), known.dents) for _ in range(repeats)]


def _meant(points: np.ndarray) -> np.ndarray:
    """Points as means over their support."""
    known = np.isfinite(points[..., 2])
    total = cv2.GaussianBlur(np.where(known[..., None], points, 0.0), (0, 0), SUPPORT_PX)
    share = cv2.GaussianBlur(known.astype(float), (0, 0), SUPPORT_PX)
    return np.where(known[..., None], total / np.maximum(share, 1e-6)[..., None], np.nan)


def _sighted(exact: np.ndarray, known: Truth, rig: Rig, rng: np.random.Generator) -> Sighted:
    """A cloud with the noise of a scan, and what is on it where it is."""
    size = exact.shape[:2]
    noise = cv2.GaussianBlur(rng.normal(size=size), (0, 0), CORRELATED_PX)
    points = exact * (1 + NOISE_MM * noise / noise.std() / exact[..., 2])[..., None]
    flags, plain = np.zeros(size, np.uint16), np.zeros(size, np.float32)
    view = DecodedView(plain, plain, plain, plain, flags)
    sigma = np.full(size, NOISE_MM, np.float32)
    cloud = Reconstruction(rig, view, view, points.astype(np.float32), sigma, flags)
    scale = rig.left.K[0, 0]
    rivets, detections, lines, stations = [], [], [], []
    for k, head in enumerate(known.rivets):
        (u, v), (x, y, z) = head.uv_px, head.xyz_mm
        across = head.diameter_mm * scale / z
        detections.append(RivetDetection(u, v, across, across, 0.0, 1.0))
        rivets.append(
            Rivet(f"R{k}", x_mm=x, y_mm=y, z_mm=z, u_px=u, v_px=v, u_right_px=None, v_right_px=None, confidence=1.0,
                  diameter_mm=head.diameter_mm, major_px=across, minor_px=across, angle_deg=0.0)
        )  # fmt: skip
    for seam in known.seams:
        course = np.array(seam.uv_px)
        inside = ((course >= 0) & (course < size[::-1])).all(axis=1)
        if inside.sum() < 10:
            continue
        wide = np.array(seam.width_mm) + 2 * seam.chamfer_mm
        lines.append(SeamLine(seam.id, course[inside], (wide * scale / 700.0)[inside], 1.0, relief=True))
        stations += [
            SeamStation(seam.id, float(k), x_mm=x, y_mm=y, z_mm=z, u_px=u, v_px=v, width_mm=width)
            for k, ((x, y, z), (u, v), width) in enumerate(zip(seam.xyz_mm, seam.uv_px, seam.width_mm, strict=True))
            if inside[k]
        ]
    return Sighted(cloud, detections, lines, {"rivet": rivets, "seam station": stations})


def paired(truth: TrueDent, rows: list[Defect]) -> Defect | None:
    """The row that is a true defect."""
    here = np.array(truth.xyz_mm)
    near = [(float(np.linalg.norm(here - (row.x_mm, row.y_mm, row.z_mm))), row) for row in rows]
    away, row = min(near, key=lambda pair: pair[0], default=(math.inf, None))
    return row if away < 0.5 * max(truth.half_depth_axes_mm) else None


def local_u95(scan: Scan, truth: TrueDent) -> float:
    """U95 of a depth of nothing at a place."""
    sd = skin_map(scan.sighted, DefectSettings()).sd
    u, v = truth.uv_px
    around = sd[max(0, int(v / 4) - 3) : int(v / 4) + 4, max(0, int(u / 4) - 3) : int(u / 4) + 4]
    return 1.96 * float(np.nanmedian(around)) if np.isfinite(around).any() else math.inf


def depth_by_plane(cloud: Reconstruction, truth: TrueDent, everything: bool) -> float:
    """Depth against a plane fitted to all points by least squares, or to those within three lengths."""
    return depth_by(cloud, truth, everything, _plane)


def depth_by_cylinder(cloud: Reconstruction, truth: TrueDent, everything: bool) -> float:
    """The same against a cylinder."""
    return depth_by(cloud, truth, everything, _cylinder)


def depth_by(cloud: Reconstruction, truth: TrueDent, everything: bool, fit) -> float:  # type: ignore[no-untyped-def]
    points = cloud.points[::6, ::6].reshape(-1, 3).astype(float)
    points = points[np.isfinite(points[:, 2])]
    away = np.linalg.norm(points - truth.xyz_mm, axis=1)
    if not everything:
        points, away = points[away < 3 * truth.half_depth_axes_mm[0]], away[away < 3 * truth.half_depth_axes_mm[0]]
    below = fit(points)
    bottom = below[away < max(1.5, 0.1 * truth.half_depth_axes_mm[1])]
    return float(np.median(bottom)) if len(bottom) else math.nan


def _plane(points: np.ndarray) -> np.ndarray:
    middle = points.mean(axis=0)
    normal = np.linalg.svd(points - middle, full_matrices=False)[2][2]
    return (points - middle) @ (normal * np.sign(normal[2]))


def _cylinder(points: np.ndarray) -> np.ndarray:
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle, full_matrices=False)[2]
    local = (points - middle) @ axes.T
    local[:, 2] *= np.sign(axes[2][2])

    def distance(parameters: np.ndarray, p: np.ndarray) -> np.ndarray:
        turn, lean, offset, height, bend = parameters
        along = np.array([np.cos(turn), np.sin(turn), lean])
        along /= np.linalg.norm(along)
        out = np.array([-np.sin(turn), np.cos(turn), 0.0])
        up = np.cross(along, out)
        side, rise = p @ out - offset, p @ up - height
        # Of a circle through its top with curvature `bend`: exact, and a plane at 0.
        return (
            2 * (rise + 0.5 * bend * (side**2 + rise**2)) / (1 + np.sqrt((1 + bend * rise) ** 2 + (bend * side) ** 2))
        )

    part = local[:: max(1, len(local) // 4000)]
    fits = [least_squares(distance, [turn, 0, 0, 0, 1e-4], args=(part,)) for turn in (0.0, 0.8, 1.6, 2.4)]
    return distance(min(fits, key=lambda f: f.cost).x, local)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--panels", type=int, default=30)
    parser.add_argument("--first", type=int, default=0, help="number of the first panel: others are other panels")
    parser.add_argument("--bare", type=int, default=40)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--rendered", action="store_true")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    study_dents(range(arguments.first, arguments.first + arguments.panels), arguments.rendered)
    study_bare(arguments.bare, arguments.rendered)
    study_repeats(arguments.repeats, arguments.rendered)


@dataclass
class Tally:
    """What was found of the defects of all panels."""

    errors: list[tuple[float, float]] = field(default_factory=list)
    covered: list[bool] = field(default_factory=list)
    extents: list[float] = field(default_factory=list)
    extents_covered: list[bool] = field(default_factory=list)
    partly: list[str] = field(default_factory=list)
    lost: list[tuple[float, str]] = field(default_factory=list)
    false: list[str] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    peers: dict[str, list[float]] = field(default_factory=dict)

    def add(self, number: int, scan: Scan) -> None:
        """Look for the defects of a panel."""
        start = time.process_time()
        rows = measure_defects(scan.sighted)
        self.seconds.append(time.process_time() - start)
        self.false += [f"panel {number}: {row.kind} {row.depth_mm} mm" for row in rows if not _belongs(row, scan.truth)]
        for truth in scan.truth:
            if truth.visible:
                self._compare(number, truth, paired(truth, rows), scan)

    def _compare(self, number: int, truth: TrueDent, row: Defect | None, scan: Scan) -> None:
        length, width = truth.half_depth_axes_mm
        name = f"  {number:3d} {truth.id} {truth.shape:7s} {truth.depth_mm:+.3f} mm, {length:.0f} × {width:.0f} mm"
        if row is None:
            u95 = local_u95(scan, truth)
            self.lost.append((abs(truth.depth_mm) / u95, f"{name}: lost, U95 of a depth of nothing {u95:.4f} mm"))
            return
        if row.depth_mm is None or row.depth_u95_mm is None or row.hidden_by:
            self.partly.append(f"{name}: {row.depth_mm} mm; {row.reason}")
            return
        e = row.depth_mm - truth.depth_mm
        self.errors.append((abs(e), abs(e / truth.depth_mm)))
        self.covered.append(abs(e) <= row.depth_u95_mm)
        extents = (row.length_mm or 0.0) / length - 1, (row.width_mm or 0.0) / width - 1
        self.extents += extents
        u95s = row.length_u95_mm, row.width_u95_mm
        self.extents_covered += [
            abs(e) * own <= u95 for e, own, u95 in zip(extents, (length, width), u95s, strict=True) if u95
        ]
        print(
            f"{name}: {row.kind} {e:+.4f} ± {row.depth_u95_mm:.4f}, extents {extents[0]:+.3f} {extents[1]:+.3f}",
            flush=True,
        )
        for by, depth in (("plane", depth_by_plane), ("cylinder", depth_by_cylinder)):
            for where, everything in (("whole view", True), ("near", False)):
                found = depth(scan.sighted.reconstruction, truth, everything)
                self.peers.setdefault(f"{by}, {where}", []).append(abs(found - truth.depth_mm))

    def report(self) -> None:
        """Print it."""
        for line in (*self.partly, *(line for _, line in self.lost)):
            print(line)
        sure = sum(times > 5 for times, _ in self.lost)
        number = len(self.errors) + len(self.partly) + len(self.lost)
        print(f"{number} defects: {len(self.errors)} measured, {len(self.partly)} seen in part, {len(self.lost)} lost,")
        print(f"of these {sure} above 5 U95; {len(self.false)} false {self.false}")
        absolute, relative = np.array(self.errors).T
        within = np.mean((absolute <= 0.005) | (relative <= 0.03))
        extents = np.abs(self.extents)
        print(f"depth: median error {np.median(absolute):.4f} mm, worst {absolute.max():.4f}")
        print(f"within 0.005 mm or 3 %: {within:.1%}; U95 covers {np.mean(self.covered):.1%}")
        print(f"extents: median error {np.median(extents):.1%}, 95 % {np.quantile(extents, 0.95):.1%}")
        print(f"extents: U95 covers {np.mean(self.extents_covered):.1%} of {len(self.extents_covered)} that have one")
        print(f"CPU median {np.median(self.seconds):.3f} s, worst {max(self.seconds):.3f}")
        for name, depths in self.peers.items():
            print(f"{name}: median error {np.nanmedian(depths):.3f} mm")


def _belongs(row: Defect, truths: Sequence[TrueDent]) -> bool:
    """Whether a row lies on a true defect, on the foot that it has beyond a seam too."""
    here = np.array([row.x_mm, row.y_mm, row.z_mm], float)
    return any(np.linalg.norm(here - truth.xyz_mm) < 0.5 * max(truth.foot_axes_mm) for truth in truths)


def study_dents(panels: range, rendered: bool) -> None:
    tally = Tally()
    for number in panels:
        tally.add(number, scans(specification(number, True), 1, rendered)[0])
    if panels:
        tally.report()


def study_bare(panels: int, rendered: bool) -> None:
    found = 0
    for number in range(100, 100 + panels):
        (scan,) = scans(specification(number, False), 1, rendered)
        rows = measure_defects(scan.sighted)
        found += len(rows)
        for row in rows:
            place = f"at {row.u_px:.0f} {row.v_px:.0f}"
            print(f"  {number}: {row.kind} {row.depth_mm} ± {row.depth_u95_mm} mm {place}; {row.reason}")
    print(f"{panels} panels without defects: {found} found", flush=True)


def study_repeats(repeats: int, rendered: bool) -> None:
    spec = specification(3, False)
    dent = Dent("D0", 20.0, 15.0, 0.2, (30.0, 24.0), 30.0)
    spec = replace(spec, panel=replace(spec.panel, dents=(dent,)))
    depths = []
    for scan in scans(spec, repeats, rendered) if repeats else []:
        row = paired(scan.truth[0], measure_defects(scan.sighted))
        depths.append(math.nan if row is None else row.depth_mm)
    if repeats > 1:
        print(f"{repeats} scans of a 30 mm dent {dent.depth_mm} mm deep: mean {np.mean(depths):.4f} mm")
        print(f"standard deviation {np.std(depths, ddof=1):.5f} mm")


if __name__ == "__main__":
    main()
