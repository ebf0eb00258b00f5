"""What the tables of a study are computed from: matching with the truth, statistics, single disturbances."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from flows.study import paper
from flows.study.budget import conditions_of, error_figures, faultless
from flows.study.coverage import coverage_section
from flows.study.detection import Detection, count
from flows.study.document import Bar, Column, Section, Table
from flows.study.gage import crossed
from flows.study.skin import repeatability_rows
from flows.study.spec import BudgetSpec, DetectionSpec
from flows.study.standard_part import accuracy_rows
from flows.study.values import Value, between, grid, nearest
from simulator.spec import shipped_spec
from simulator.truth import TrueRivet


def value(feature: str, scan: int, measured: float | None, true: float = 0.1, **more: object) -> Value:
    values = {"series": "S", "station": "S1-true", "quantity": "height", "u95_mm": 0.002} | more
    return Value(feature=feature, scan=scan, true_mm=true, measured_mm=measured, **values)  # type: ignore[arg-type]


def rivet(u: float, v: float, visible: bool = True, x: float = 0.0) -> TrueRivet:
    return TrueRivet("R", [x, 0.0, 700.0], [u, v], 8.0, visible, 0.1, 0.0, 0.0, 0.0)


def test_the_papers_tables_add_up() -> None:
    # The bottom row of Table 1, to the digits that it has.
    assert np.mean([abs(row.mean_error) for row in paper.TABLE_1]) == pytest.approx(paper.TABLE_1_MEAN_ERROR, abs=5e-4)
    assert np.mean([row.sd for row in paper.TABLE_1]) == pytest.approx(paper.TABLE_1_SD, abs=5e-5)
    assert np.mean([row.max_error for row in paper.TABLE_1]) == pytest.approx(paper.TABLE_1_MAX_ERROR, abs=5e-4)
    for row in paper.TABLE_1:
        assert row.measured - row.true == pytest.approx(row.mean_error, abs=1.1e-3)
    heights = [rivet.height_mm for rivet in shipped_spec("standard_part").panel.rivets]
    assert heights == [row.true for row in paper.TABLE_1]


def test_accuracy_of_known_errors() -> None:
    values = [value("A", k, 0.1 + e) for k, e in enumerate((0.001, 0.003, -0.001))]
    values += [value("B", 0, 0.1), value("B", 1, None), value("B", 2, 0.096)]
    values += [value("C", 0, 0.2)] + [value("C", k, None) for k in (1, 2)]
    a, b = accuracy_rows(values)
    assert (a.feature, a.mean_error, a.sd, a.max_error) == (
        "A",
        pytest.approx(0.001),
        pytest.approx(0.002),
        pytest.approx(0.003),
    )
    assert (b.mean_error, b.max_error) == (pytest.approx(-0.002), pytest.approx(0.004))


def test_repeatability_knows_no_truth() -> None:
    shifted = [value("A", k, m, true=9.9) for k, m in enumerate((0.10, 0.12, 0.11))]
    (row,) = repeatability_rows(shifted, "height")
    assert (row.mean, row.sd, row.deviation) == (pytest.approx(0.11), pytest.approx(0.01), pytest.approx(0.02))


def test_grid_keeps_scans_of_all_stations_apart() -> None:
    values = [value("A", k, 10 * s + k, station=f"S{s}-true") for s in (1, 2) for k in (0, 1)]
    features, true, measured = grid(values, "height")
    assert features == ["A"]
    assert true.tolist() == [0.1]
    assert measured.tolist() == [[10, 11, 20, 21]]


def test_between_stations() -> None:
    rows = [
        ({"step_mm": s, "step_u95_mm": u}, at) for s, u, at in ((0.1, 0.01, 0.0), (None, None, 2.0), (0.3, 0.02, 4.0))
    ]
    assert between(rows, 1.0, "step") == (pytest.approx(0.15), 0.02)
    assert between(rows, 4.5, "step") == (None, None)  # nothing beyond
    assert between(rows, -0.5, "step") == (None, None)
    far = [(row, 10 * at) for row, at in rows]
    assert between(far, 10.0, "step") == (None, None)


def test_nearest_row_is_on_the_head() -> None:
    rows = [{"x_mm": 3.0, "y_mm": 0.0, "z_mm": 700.0}, {"x_mm": 1.0, "y_mm": 0.0, "z_mm": 700.0}]
    assert nearest(rivet(0, 0), rows) is rows[1]
    assert nearest(rivet(0, 0, x=8.0), rows) is None
    assert nearest(rivet(0, 0), []) is None


def test_counts_of_found_and_false() -> None:
    trues = [rivet(100, 100), rivet(200, 100), rivet(300, 100, visible=False)]
    rows = [{"u_px": u, "v_px": 100.0, "minor_px": 40.0} for u in (103, 300, 150, 400)]
    counts = count(trues, rows)
    assert (counts.true, counts.found, counts.reported, counts.right) == (2, 1, 4, 2)
    assert (counts.recall, counts.precision) == (0.5, 0.5)
    assert count(trues, []).recall == 0
    assert np.isnan(count(trues, []).precision)


def test_contrast_changes_the_rings_alone() -> None:
    low, high = Detection(DetectionSpec(ring_levels=(6.0, 30.0), panels=1), shipped_spec("skin")).series
    rings = [[rivet.ring_reflectance for rivet in series.simulation.panel.rivets] for series in (low, high)]
    assert len(rings[0]) == len(rings[1])
    assert all(weak > strong for weak, strong in zip(*rings, strict=True))
    places = [[(r.x_mm, r.y_mm, r.height_mm) for r in series.simulation.panel.rivets] for series in (low, high)]
    assert places[0] == places[1]


def test_each_condition_switches_one_thing() -> None:
    base = faultless(shipped_spec("skin"), BudgetSpec())
    changed = {}
    for condition in conditions_of(BudgetSpec(), shipped_spec("skin")):
        mine, plain = asdict(condition.switch_on(base)), asdict(base)
        changed[condition.name] = {
            f"{block}.{key}" if isinstance(mine[block], dict) else block
            for block in mine
            for key in (mine[block] if isinstance(mine[block], dict) else [""])
            if (mine[block][key] != plain[block][key] if key else mine[block] != plain[block])
        }
    assert changed.pop("nothing") == changed.pop("calibration") == set()
    everything = changed.pop("all")
    assert all(len(keys) == 1 for keys in changed.values())
    assert everything == set().union(*changed.values())
    assert changed["temperature"] == {"disturbances.warming_k"}
    assert changed["noise"] == {"camera.sensor"}


def test_scatter_between_scans_is_no_error() -> None:
    values = [value(name, k, 0.12 + d) for name in "AB" for k, d in enumerate((-0.001, 0.001))]
    mean, largest, sd = error_figures(values, "height")
    assert (mean, largest, sd) == (pytest.approx(0.02), pytest.approx(0.021), pytest.approx(np.sqrt(2) * 0.001))
    assert np.isnan(error_figures(values, "step")).all()


def test_incomplete_parts_are_left_out_of_a_gage_study() -> None:
    rng = np.random.default_rng(4)
    values = [
        value(part, trial, k + rng.normal(0, 0.01), station=station)
        for k, part in enumerate(("P1", "P2", "P3", "P4"))
        for station in ("S1-x", "S2-x")
        for trial in (0, 1, 2)
    ]
    values[-7] = value("P3", 2, None, station="S2-x")
    found = crossed(values, "height", 3)
    assert (found.parts, found.left_out) == (["P1", "P2", "P4"], ["P3"])
    assert found.values.shape == (3, 2, 3)
    assert found.study is not None
    assert found.study.repeatability == pytest.approx(0.01, rel=0.6)
    assert crossed(values[:6], "height", 3).study is None


def test_coverage_counts_errors_within_u95() -> None:
    values = [value("A", k, 0.1 + e) for k, e in enumerate((0.001, -0.0019, 0.003, 0.0))] + [value("A", 4, None)]
    (table,) = coverage_section(values, "here").tables
    (row,) = table.rows
    assert row[:4] == ["true rig", "height", 4, 1]
    assert row[-1] == 75.0


def test_tables_as_text() -> None:
    table = Table("t", "T", (Column("|a|"), Column("b", 2, True, "g")), [("x|y", 0.126), ("z", float("nan"))])
    assert table.markdown().splitlines() == [r"| \|a\| | g: b |", "| --- | ---: |", r"| x\|y | +0.13 |", "| z | – |"]
    assert table.csv() == "|a|,g: b\nx|y,0.126\nz,\n"
    assert not Bar("b", float("nan"), 1.0, "mm").met
    assert Section("s").tables == ()
