"""Artefacts that ship with Flushline: description, drawing or print, and a simulation of their scans."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from metrology.calibration.board import Board
from storage.evidence.artefact import Artefact, load_artefact, shipped_artefact
from storage.evidence.drawings import board_svg, dxf, shapes, svg

_POSITIONS = (
    ((0, 0, 0), (0, 0, 0)), ((0, 0, 0), (12, 0, 90)), ((5, -5, 15), (0, 12, 0)), ((-5, 5, -15), (-12, 0, 45)),
    ((0, 5, 10), (0, -12, 135)), ((5, 0, -10), (10, 10, 180)), ((0, 0, 5), (-10, -10, 270)),
)  # fmt: skip
"""Offset (mm) and turn (°) of each position of an artefact before the rig."""


def write_artefact(name: str, out: Path) -> list[Path]:
    """Write what belongs to an artefact into a folder.

    Returns
    -------
    list of Path
        NAME.toml, to be completed with certificate and limits; NAME.dxf and NAME.svg, or the board's print as SVG; and
        NAME-simulation.toml for `flushline simulate`, but for the board.
    """
    source = shipped_artefact(name)
    artefact = load_artefact(source)
    out.mkdir(parents=True, exist_ok=True)
    files = [out / source.name]
    shutil.copyfile(source, files[0])
    file = artefact.file
    if file.board:
        files.append(out / f"{name}.svg")
        files[-1].write_text(board_svg(Board(kind=file.board.type, **_sizes(artefact))), encoding="utf-8")
        return files
    files += [out / f"{name}.dxf", out / f"{name}.svg", out / f"{name}-simulation.toml"]
    files[1].write_text(dxf(shapes(file)), encoding="ascii")
    files[2].write_text(svg(file), encoding="utf-8")
    files[-1].write_text("\n".join(simulation(artefact)) + "\n", encoding="utf-8")
    return files


def _sizes(artefact: Artefact) -> dict[str, Any]:
    assert artefact.file.board is not None
    return artefact.file.board.model_dump(exclude={"type", "certificate"})


def simulation(artefact: Artefact) -> Iterator[str]:
    """Lines of a simulation specification that renders an artefact in several positions."""
    file = artefact.file
    yield 'format = "flushline-simulation/1"'
    yield "seed = 1"
    yield f'[scene]\naircraft_serial = "ARTEFACT"\npanel = "{file.id}"\nstation = "P0"'
    yield 'captured_at = "2026-11-20T08:00:00Z"'
    for k, (offset, turn) in enumerate(_POSITIONS, 1):
        yield f'[[placements]]\nstation = "P{k}"\noffset_mm = {_list(offset)}\nrotation_deg = {_list(turn)}'
    if file.spheres:
        yield "[panel.surface]\nreflectance = 0.6"
        length = file.distances[0].length_mm if file.distances else 0.0
        for k, sphere in enumerate(file.spheres):
            at = (k - 0.5 * (len(file.spheres) - 1)) * length
            yield f'[[spheres]]\nid = "{sphere.id}"\nx_mm = {at}\ny_mm = 0.0\nz_mm = 0.0'
            yield f"diameter_mm = {sphere.diameter_mm}"
        return
    width, height = file.size_mm or (200.0, 150.0)
    yield f"[panel]\nwidth_mm = {width}\nheight_mm = {height}\n[panel.surface]\nbrushing = 0.01"
    for rivet in file.rivets:
        u, v, _ = rivet.position_mm
        yield f'[[panel.rivets]]\nid = "{rivet.id}"\nx_mm = {u}\ny_mm = {v}\ndiameter_mm = {rivet.diameter_mm}'
        yield f"height_mm = {rivet.height_mm or 0.0}"
    for seam in file.seams:
        course = [[x, y] for x, y, _ in seam.course_mm]
        yield f'[[panel.seams]]\nid = "{seam.id}"\npoints_mm = {course}\nwidth_mm = [{seam.width_mm or 2.0}]'
        yield f"step_mm = [{seam.step_mm or 0.0}]"


def _list(values: tuple[float, ...]) -> str:
    return f"[{', '.join(f'{value:.1f}' for value in values)}]"
