"""flushline artefact: what ships can be read, drawn, printed in its true size, and simulated."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import ezdxf
import pytest

from flows.cli import main
from flows.commands.artefact import NAMES
from simulator.spec import read_spec
from storage.evidence.artefact import SHIPPED, load_artefact

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module", params=NAMES)
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    folder = tmp_path_factory.mktemp("artefact")
    assert main(["artefact", request.param, "--out", str(folder)]) == 0
    return request.param, folder


def test_every_artefact_that_ships_has_a_name() -> None:
    assert {path.stem for path in SHIPPED.glob("*.toml")} == set(NAMES)


def test_its_description_is_read_and_its_simulation_is_that_artefact(written: tuple[str, Path]) -> None:
    name, folder = written
    artefact = load_artefact(folder / f"{name}.toml").file
    if name == "board":
        return
    spec = read_spec(folder / f"{name}-simulation.toml")
    assert len(spec.placements) == 7
    assert [b.diameter_mm for b in spec.spheres] == [s.diameter_mm for s in artefact.spheres]
    assert [(r.id, r.height_mm) for r in spec.panel.rivets] == [(r.id, r.height_mm or 0.0) for r in artefact.rivets]
    assert [(s.id, s.width_mm[0], s.step_mm[0]) for s in spec.panel.seams] == [
        (s.id, s.width_mm, s.step_mm) for s in artefact.seams
    ]


def test_the_drawing_is_in_its_true_size(written: tuple[str, Path]) -> None:
    name, folder = written
    root = ElementTree.parse(folder / f"{name}.svg").getroot()
    width, box = root.attrib["width"], root.attrib["viewBox"].split()
    assert width.removesuffix("mm") == box[2]
    artefact = load_artefact(folder / f"{name}.toml").file
    circles = [(float(c.attrib["cx"]), float(c.attrib["cy"]), float(c.attrib["r"])) for c in root.iter(f"{SVG}circle")]
    if artefact.board:
        assert len(circles) == artefact.board.cols * artefact.board.rows
        assert circles[1][0] - circles[0][0] == 2 * artefact.board.spacing_mm
        return
    # y is up in the plate's frame and down in SVG.
    half = artefact.distances[0].length_mm / 2 if artefact.distances else 0.0
    assert circles == [
        *((r.position_mm[0], -r.position_mm[1], r.diameter_mm / 2) for r in artefact.rivets),
        *((side * half, 0.0, s.diameter_mm / 2) for side, s in zip((-1, 1), artefact.spheres, strict=False)),
    ]
    words = " ".join(text.text or "" for text in root.iter(f"{SVG}text"))
    assert "free to copy" in words
    text = (folder / f"{name}.dxf").read_text()
    places = re.findall(r"CIRCLE\n8\n(?:HEADS|SPHERES)\n10\n(.+)\n20\n(.+)\n40\n(.+)\n", text)
    assert [tuple(map(float, place)) for place in places] == [(x, -y, r) for x, y, r in circles]
    pairs = text.splitlines()
    assert len(pairs) % 2 == 0
    assert all(code.lstrip("-").isdigit() for code in pairs[::2])
    assert pairs[-1] == "EOF"


def test_another_program_reads_the_dxf(written: tuple[str, Path]) -> None:
    name, folder = written
    if (folder / f"{name}.dxf").exists():
        drawing = ezdxf.readfile(folder / f"{name}.dxf")
        assert len(drawing.modelspace().query("LINE")) >= 4
