"""The paper's equations as printed, held against the code that docs/equations.md names."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import numpy as np
import pytest

from metrology.calibration.initial import SingleDevice, _relative
from metrology.decode import decode_phase
from metrology.fits import SkinLine
from metrology.fringe import FringeCode
from metrology.noise import NoiseModel
from metrology.rig import Device
from metrology.seams.gap.piecewise import fit_pieces
from metrology.seams.gap.width import GapEdge, gap_width, inflection
from metrology.seams.skins.sections import Section
from metrology.seams.skins.step import step_height
from metrology.surfaces import Frame

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "equations.md"
W = 1280
USUAL = FringeCode("x", 4, (70, 64, 59))


def distance(point: np.ndarray, on_line: np.ndarray, direction: np.ndarray) -> float:
    """|A x + B y + C| / √(A² + B²) of the line through a point along a direction."""
    A, B = -direction[1], direction[0]
    return abs(A * point[0] + B * point[1] - A * on_line[0] - B * on_line[1]) / np.hypot(A, B)


def test_the_page_lists_every_equation_and_its_code_and_test_exist() -> None:
    rows = re.findall(r"^\| (\d+) \|.*\| `([\w/.]+)`: `(\w+)` \| `(\w+)` \|$", PAGE.read_text("utf-8"), re.M)
    assert [int(row[0]) for row in rows] == list(range(1, 17))
    for number, file, name, test in rows:
        source = (ROOT / file).read_text("utf-8")
        nodes = (ast.FunctionDef, ast.ClassDef)
        (found,) = (n for n in ast.walk(ast.parse(source)) if isinstance(n, nodes) and n.name == name)
        said = re.findall(r"eqs? (\d+)(?:(–| and | to |, )(\d+))?", ast.get_docstring(found) or "", re.I)
        numbers = {int(n) for first, _, last in said for n in (first, last or first)}
        between = {n for first, sep, last in said if sep in ("–", " to ") for n in range(int(first), int(last))}
        assert int(number) in numbers | between, f"{file}: {name} does not say that it is eq {number}"
        assert test in globals()


def test_eqs_1_and_3_fringes() -> None:
    shown = USUAL.patterns(W, 2)
    x, a, b = np.arange(W), 0.5, 0.5
    for k, count in enumerate(USUAL.counts):
        phi = 2 * np.pi * count * (x + 0.5) / W
        for i in range(1, 5):
            assert shown[4 * k + i - 1, 0] == pytest.approx(a * np.cos(phi + (i - 1) * np.pi / 2) + b)


def test_eqs_2_and_4_phase(rng: np.random.Generator) -> None:
    reflectivity, ambient = rng.uniform(0.3, 1.0, W), rng.uniform(0.0, 0.1, W)
    frames = np.round(30000 * reflectivity * (USUAL.patterns(W, 1)[:, 0] + ambient)).astype(np.uint16)
    view = decode_phase(frames[None, :, None], USUAL, W, noise=NoiseModel(4.0, 0.1))
    for k, count in enumerate(USUAL.counts):
        I1, I2, I3, I4 = frames[4 * k : 4 * k + 4].astype(float)
        printed = np.arctan2(I4 - I2, I1 - I3)
        ours = 2 * np.pi * count * (view.coordinate[0] + 0.5) / W
        # 16-bit rounding leaves the single phases some 1e-4 rad of noise, which the fused coordinate averages.
        assert np.abs(np.angle(np.exp(1j * (ours - printed)))).max() < 1e-3
    assert view.texture[0] == pytest.approx(30000 * reflectivity * (0.5 + ambient), rel=1e-3)
    assert view.modulation[0] == pytest.approx(30000 * reflectivity * 0.5, rel=1e-3)


def test_eq_5_pieces() -> None:
    x = np.linspace(0, 10, 201)
    y = np.where(x < 4, 0.1 * x, np.where(x < 6, 0.4 - 0.5 * (x - 4), -0.6 + 0.2 * (x - 6)))
    pieces = fit_pieces(x, y, 0.01)
    for piece in pieces:
        own = slice(piece.first, piece.end)
        assert piece.slope * x[own] + piece.intercept == pytest.approx(y[own], abs=0.01)
    # No piece runs around a corner; the middle line may come in two parts, as each split is the best one at its time.
    slopes = list(dict.fromkeys(round(piece.slope, 2) for piece in pieces))
    assert slopes == [0.1, -0.5, 0.2]


def section_of_lines(step: float) -> Section:
    """Skins of different slope, B higher."""
    a, b = SkinLine(np.array([0.0, 0.05, 0.0]), 100), SkinLine(np.array([step, -0.03, 0.0]), 100)
    return Section(Frame(np.zeros(3), np.eye(3)), a, b, np.eye(5), 1.0)


@pytest.mark.parametrize("step", [0.5, -0.5])
def test_eqs_6_to_8_step(step: float) -> None:
    section, (xa, xb) = section_of_lines(step), (-1.1, 1.3)
    D, G = (np.array([x, line.height(x)]) for x, line in ((xa, section.a), (xb, section.b)))
    d_D = distance(D, G, np.array([1.0, section.b.slope(xb)]))
    d_G = distance(G, D, np.array([1.0, section.a.slope(xa)]))
    # The paper's is a length; ours also says which side is higher.
    assert step_height(section, xa, xb) == pytest.approx(np.sign(step) * (d_D + d_G) / 2)


def test_eqs_9_to_11_width() -> None:
    section = section_of_lines(0.2)
    edges = GapEdge(-1.1, 0.3), GapEdge(1.3, 0.5)
    (D, along_a), (G, along_b) = inflection(section.a, edges[0]), inflection(section.b, edges[1])
    DD, GG = (np.array([e.ideal_mm, s.height(e.ideal_mm)]) - p for e, s, p in
              zip(edges, (section.a, section.b), (D, G), strict=True))  # fmt: skip
    assert DD @ along_a == pytest.approx(0)
    assert GG @ along_b == pytest.approx(0)
    assert gap_width(section, *edges) == pytest.approx((distance(D, G, GG) + distance(G, D, DD)) / 2)


def turn(*degrees: float) -> np.ndarray:
    """A rotation about x, then y."""
    (cx, sx), (cy, sy) = ((np.cos(a), np.sin(a)) for a in np.deg2rad(degrees))
    return np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]]) @ np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])


def test_eqs_12_to_16_projector(rng: np.random.Generator) -> None:
    pinhole = Device(
        1280, 800, np.array([[2000.0, 0, 640], [0, 2000.0, 400], [0, 0, 1]]), np.zeros(5), np.eye(3), np.zeros(3)
    )
    R, t = turn(3, -15), np.array([-180.0, 5.0, 40.0])
    R_c = {p: turn(10 * p - 15, 12 - 8 * p) for p in range(4)}
    t_c = {p: np.array([10.0 * p, -20.0, 700.0]) for p in range(4)}
    R_p, t_p = {p: R @ R_c[p] for p in range(4)}, {p: R @ t_c[p] + t for p in range(4)}
    device, bad = _relative("projector", SingleDevice(pinhole, R_p, t_p), SingleDevice(pinhole, R_c, t_c))
    assert not bad
    assert pytest.approx(R_p[0] @ np.linalg.inv(R_c[0])) == device.R
    assert device.t == pytest.approx(t_p[0] - R_p[0] @ np.linalg.inv(R_c[0]) @ t_c[0])
    p_w = rng.uniform(-50, 50, (20, 3)) * (1, 1, 0)
    p_c, p_p = p_w @ R_c[1].T + t_c[1], p_w @ R_p[1].T + t_p[1]
    assert p_c @ device.R.T + device.t == pytest.approx(p_p)
    # The pixel of a mark: without distortion the perspective image of p_p.
    pixels = p_p @ pinhole.K.T
    assert device.project(p_c) == pytest.approx(pixels[:, :2] / pixels[:, 2:])
