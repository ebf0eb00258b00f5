"""The form of a defect as a run keeps it, and as a report and a page draw it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from dashboard.figures.defect import defect_map, defect_sections
from dashboard.locale import Locale
from dashboard.reports import wording_of
from metrology.fits import DefectForm, DefectSection, FittedDefect
from storage.fits import read_fits, write_fits
from storage.report.defect_form import defect_forms
from storage.wording import written_in

DEPTH = 0.3


def form() -> DefectForm:
    """A bowl on a flat skin."""
    t = np.linspace(-40.0, 40.0, 161)
    surface = -DEPTH * np.cos(0.25 * np.pi * np.minimum(np.abs(t) / 6.0, 2.0)) ** 2
    section = DefectSection(t, surface, 0 * t, np.maximum(surface, 0.0))
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    heights = np.zeros((20, 30))
    heights[0, 3] = np.nan
    heights[10, 15] = -DEPTH
    outline = 6 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return DefectForm(heights, (-15.0, -10.0), 1.0, outline, section, section, 0.4)


def defect(depth: float = DEPTH, name: str = "D01") -> FittedDefect:
    return FittedDefect(
        name, x_mm=0.0, y_mm=0.0, z_mm=700.0, u_px=5.0, v_px=5.0, kind="dent", depth_mm=depth, depth_u95_mm=0.004,
        decision="conditional fail", severity="blue", form=form(),
    )  # fmt: skip


def test_a_form_is_kept_with_its_run(tmp_path: Path) -> None:
    write_fits(tmp_path / "fits.parquet", {"defect": [defect()]})
    fits = read_fits(tmp_path / "fits.parquet")
    kept, made = fits.form("D01"), form()
    assert kept is not None
    np.testing.assert_allclose(kept.heights, made.heights, atol=1e-4)
    np.testing.assert_allclose(kept.outline, made.outline, atol=1e-3)
    np.testing.assert_allclose(kept.across.surface, made.across.surface, atol=1e-4)
    assert (kept.corner, kept.step_mm, kept.turn) == (made.corner, made.step_mm, made.turn)
    assert fits.form("D02") is None
    assert fits.head("D01") is None


def test_fits_of_older_versions_have_no_form(tmp_path: Path) -> None:
    path = tmp_path / "fits.parquet"
    write_fits(path, {"defect": [defect()]})
    old = pq.read_table(path).drop_columns(["heights_mm", "map", "outline_mm", "along_mm", "across_mm"])
    pq.write_table(old, path)
    assert read_fits(path).form("D01") is None


@pytest.mark.parametrize("depth", [DEPTH, -DEPTH])
def test_a_report_and_a_page_draw_it(tmp_path: Path, depth: float) -> None:
    rows = [defect(depth), defect(0.5 * depth, "D02")]
    write_fits(tmp_path / "fits.parquet", {"defect": rows})
    drawn = defect_forms([vars(row) for row in reversed(rows)], read_fits(tmp_path / "fits.parquet"))
    assert [("D01," in figure, "D02," in figure) for figure in drawn] == [(True, False), (False, True)]
    assert ("straight-edge" in drawn[0]) == (depth > 0)
    label = f"{depth:+.3f} ± 0.004 mm</text>"
    last = next(line for line in reversed(drawn[0].splitlines()) if label in line)
    assert "stroke" not in last  # drawn over its halo: printed pages know no paint-order
    sections = defect_sections(form(), depth, 0.004, Locale())
    assert ("straight-edge" in {trace.name for trace in sections.data}) == (depth > 0)
    (arrow, _) = sections.layout.shapes
    assert arrow.y0 - arrow.y1 == pytest.approx(depth)
    named = [trace.name for trace in defect_map(form(), Locale()).data if trace.showlegend is not False and trace.name]
    assert named == ["outline at half depth", "section along", "section across"]


def test_a_german_report_says_it_in_german(tmp_path: Path) -> None:
    write_fits(tmp_path / "fits.parquet", {"defect": [defect()]})
    fits, row = read_fits(tmp_path / "fits.parquet"), {**vars(defect()), "straight_edge_depth_mm": 0.21}
    with written_in(wording_of(Locale("de"), "de")):
        [drawn] = defect_forms([row], fits)
    assert "D01, Delle. Karte: volles Blau liegt 0,02 mm unter der Haut" in drawn
    assert "(größter Spalt darunter in irgendeiner Richtung 0,210 mm)" in drawn
    assert ">längs des Schadens, mm<" in drawn
    assert ">-0,2<" in drawn
    assert ">0<" in drawn
    assert "-0<" not in drawn


def test_the_page_of_a_scene_shows_it(tmp_path: Path) -> None:
    AppTest = pytest.importorskip("streamlit.testing.v1").AppTest

    def page() -> None:
        from dashboard.locale import Locale
        from dashboard.views.defect import show_defect
        from tests.storage.test_defect_form import defect, form

        show_defect(Locale(), defect(), form())
        show_defect(Locale(), defect(), None)

    app = AppTest.from_function(page).run(timeout=60)
    assert not app.exception
    assert "straight-edge lies on the surface" in app.caption[0].value
    assert "kept no fit" in app.info[0].value
