"""A gage study of scans in the archive: the planner, the crossed table, bias, linearity, stability."""

from __future__ import annotations

import csv
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flows.cli import main
from flows.study.archived_gage import quantity_values
from flows.study.gage_plan import QUANTITIES, read_plan, scanned
from metrology.errors import SpecError
from metrology.gage import gage_study
from metrology.results import SceneKey
from storage.archive import Store
from tests.support.results import small_result

OPERATORS = ("A. Meyer", "B. Roy", "C. Lin")
TRUE = np.array([-0.08, -0.02, 0.03, 0.09])
PLAN = """
format = "flushline-gage/1"
title = "Flushness of LH-F12"
panel = "LH-F12"
aircraft = ["MSN-1"]
stations = ["S3"]
operators = ["A. Meyer", "B. Roy", "C. Lin"]
trials = 2
quantities = ["height", "step"]
tolerance = {height = 0.2}
"""
REFERENCES = "".join(
    f'[[reference]]\npart = "R{k + 1}"\nquantity = "height"\nvalue = {value}\nu95 = 0.001\n'
    for k, value in enumerate(TRUE)
)


def heights() -> np.ndarray:
    """(parts, operators, trials)"""
    rng = np.random.default_rng(5)
    return TRUE[:, None, None] + 0.002 + rng.normal(0, 0.002, (1, 3, 1)) + rng.normal(0, 0.001, (4, 3, 2))


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Three operators, two trials each, one of them not yet made; a scan by somebody else, one of another station."""
    made = Store(tmp_path_factory.mktemp("gage") / "store")
    values, begin = heights(), datetime(2026, 11, 20, 8, tzinfo=UTC)
    for trial in range(2):
        for k, operator in enumerate(OPERATORS):
            at = begin + timedelta(hours=3 * trial + k)
            publish(made, "S3", at, operator, values[:, k, trial])
    publish(made, "S3", begin + timedelta(days=1), "A. Meyer", values[:, 0, 0] + 1)  # one too many: not counted
    publish(made, "S3", begin + timedelta(days=2), None, values[:, 0, 0] + 1)
    publish(made, "S4", begin, "A. Meyer", values[:, 0, 0] + 1)
    return made


def publish(store: Store, station: str, at: datetime, operator: str | None, values: np.ndarray) -> None:
    base = small_result()
    rivet, (place, _) = base.features["rivet"][0], base.features["seam station"]
    rivets = tuple(replace(rivet, rivet_id=f"R{k + 1}", height_mean_mm=float(h)) for k, h in enumerate(values))
    seam = tuple(replace(place, s_mm=2.0 * k, step_mm=0.1 + 0.01 * k + float(values[0])) for k in range(12))
    key = SceneKey("MSN-1", "LH-F12", station, at)
    store.publish(replace(base, key=key, operator=operator, features={"rivet": rivets, "seam station": seam}))


def study(store: Store, folder: Path, out: Path) -> int:
    plan = str(folder / "plan.toml")
    return main(["study", "gage", "--plan", plan, "--store", str(store.root), "--out", str(out)])


def tables(out: Path, name: str) -> list[dict[str, Any]]:
    with (out / "tables" / f"{name}.csv").open(encoding="utf-8-sig") as file:
        return list(csv.DictReader(file))


def test_a_complete_study(store: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plan.toml").write_text(PLAN + REFERENCES)
    out = tmp_path / "out"
    assert study(store, tmp_path, out) == 0
    assert "%GRR of tolerance, height" in capsys.readouterr().out
    expected = gage_study(heights().round(5))
    height, step = tables(out, "gage")
    assert int(height["parts"]) == 4
    assert float(height["GRR σ, µm"]) == pytest.approx(1000 * expected.grr, rel=1e-6)
    assert float(height["%GRR of tolerance"]) == pytest.approx(expected.percent_of_tolerance(0.2), rel=1e-6)
    assert int(height["ndc"]) == expected.distinct_categories
    assert int(step["parts"]) == 10
    biases = tables(out, "bias")
    assert [float(row["bias"]) for row in biases] == pytest.approx(heights().mean((1, 2)) - TRUE, abs=1e-5)
    (line,) = tables(out, "linearity")
    assert abs(float(line["slope"])) < 0.2
    report = (out / "report.html").read_text()
    assert "an acceptable measurement system" in report
    assert "too few scans" in report
    assert "nobody: scene.json names no operator" in report
    assert [int(row["not counted"]) for row in tables(out, "plan")] == [1, 0, 0]


def test_the_planner_says_what_is_still_to_be_scanned(
    store: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plan.toml").write_text(PLAN.replace("trials = 2", "trials = 4"))
    out = tmp_path / "out"
    assert study(store, tmp_path, out) == 1
    assert "5 scans are still to be made" in capsys.readouterr().err
    left = tables(out, "to-scan")
    assert sorted(row["operator"] for row in left) == ["A. Meyer", "B. Roy", "B. Roy", "C. Lin", "C. Lin"]
    assert "preliminary" in (out / "report.html").read_text()


def test_only_scans_of_the_plans_time_count(store: Store, tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN.replace("trials = 2", 'trials = 2\nuntil = "2026-11-20T09:30:00Z"'))
    plan = read_plan(tmp_path / "plan.toml")
    assert [len(cell.scans) for cell in scanned(store, plan).cells] == [1, 1, 0]
    assert {len(v) for v in quantity_values(store, plan, *QUANTITIES["height"]).values()} == {2}


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('["height", "step"]', '["hight"]', "found quantity 'hight', expected one of height, tilt, step"),
        ("trials = 2", "trials = 1", "trials"),
        ('["MSN-1"]', "[]", "aircraft"),
        ("panel =", "pannel =", "found unknown key 'pannel', expected 'panel'|pannel"),
    ],
)
def test_a_wrong_plan_is_one_line(old: str, new: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN.replace(old, new))
    with pytest.raises(SpecError, match=said):
        read_plan(tmp_path / "plan.toml")
