"""Nominal fasteners and seams from lists that people keep."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from openpyxl import Workbook

from flows.cli import EXIT_BAD_INPUT, EXIT_DONE, main
from metrology.errors import SpecError
from metrology.panel import PanelLayout
from storage.nominal_list import read_rivets
from storage.panel_spec import load_panel_spec, locations_of, pattern_toml

CSV = "id;X (mm);Y;z;diameter;zone;row\nR01;-10,5;20;0;6,4;nose;upper\nR02;40;20;0;;;\n"


def test_a_list_becomes_a_specification(tmp_path: Path) -> None:
    rivets, seams, out = tmp_path / "rivets.csv", tmp_path / "seams.csv", tmp_path / "panel.toml"
    rivets.write_text(CSV, encoding="utf-8-sig")
    seams.write_text("id,X (mm),y,z\nJ01,0,0,0\nJ01,100,0,0.5\n", encoding="utf-8")
    asked = ["panel", "import", str(rivets), "--seams", str(seams), "--panel", "P", "--revision", "A"]
    assert main([*asked, "--column", "x=X (mm)", "--out", str(out)]) == EXIT_DONE
    layout = load_panel_spec(out).layout
    first, second = layout.rivets
    assert (first.rivet_id, first.position, first.diameter_mm) == ("R01", (-10.5, 20.0, 0.0), 6.4)
    assert (first.zone, first.row, second.zone, second.diameter_mm) == ("nose", "upper", "default", None)
    assert layout.seams[0].course == ((0.0, 0.0, 0.0), (100.0, 0.0, 0.5))


def test_a_workbook_is_read_as_well(tmp_path: Path) -> None:
    book = Workbook()
    for row in (["ID", "X", "Y", "Z", "nx", "ny", "nz"], ["R01", 1, 2.5, 3, 0, 0, 1], [None] * 7):
        book.active.append(row)
    book.save(tmp_path / "list.xlsx")
    [rivet] = read_rivets(tmp_path / "list.xlsx")
    assert (rivet.position, rivet.normal) == ((1.0, 2.5, 3.0), (0.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("id,x,y\nR01,1,2\n", "found columns id, x, y, expected one for 'z'"),
        ("id,x,y,z\nR01,1,two,3\n", "row 2, y: found 'two', expected a number"),
        ("id,x,y,z\n,1,2,3\n", "row 2, id: found nothing, expected a name"),
        ("id,x,y,z\nR01,1,2,nan\n", "row 2, z: found nan"),
        ("id,x,y,z,diameter\nR01,1,2,3,-4\n", "diameter: found -4, expected a positive number"),
        ("", "found nothing in it"),
    ],
)
def test_what_is_wrong_with_a_list_is_said(text: str, expected: str, tmp_path: Path) -> None:
    path = tmp_path / "list.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SpecError) as problem:
        read_rivets(path)
    assert expected in str(problem.value)


def test_a_file_that_is_no_list_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "list.xlsx"
    path.write_bytes(b"no workbook")
    asked = ["panel", "import", str(path), "--panel", "P", "--revision", "A", "--out", str(tmp_path / "out.toml")]
    assert main(asked) == EXIT_BAD_INPUT
    assert "expected an XLSX file" in capsys.readouterr().err
    assert not (tmp_path / "out.toml").exists()


def test_where_a_rivet_is_on_the_aircraft_stays_beside_its_name(tmp_path: Path) -> None:
    path = tmp_path / "list.csv"
    path.write_text("id,x,y,z,location\nR01,1,2,3,FR47 / STR12\nR02,4,5,6,\n")
    rivets = read_rivets(path)
    assert rivets[0] == replace(rivets[0], location=None)  # the pattern is the same, whatever it is called
    spec = tmp_path / "panel.toml"
    spec.write_text(pattern_toml(PanelLayout(rivets), "P", "A"))
    assert locations_of(load_panel_spec(spec).document) == {"R01": "FR47 / STR12"}
