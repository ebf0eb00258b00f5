"""Acceptance rules: worked examples, and how often a panel that breaks a rule is accepted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from metrology.acceptance import judge_rules, panel_verdict, unruled
from metrology.arrays import Array
from metrology.errors import SpecError
from metrology.kinds import RIVET, SEAM_STATION
from metrology.limits import Limit, PanelSpec
from metrology.results import Rivet, SeamStation
from metrology.rules import Rule
from metrology.stretches import stretches
from metrology.tolerance import as_measured, judge
from tests.support.rows import rivet_at, station_at

LIMIT = 0.1
SPEC = PanelSpec(
    "P", "1",
    {"default": {
        "height_mm": Limit(-LIMIT, LIMIT, -0.2, 0.2, "DS-1", "A"),
        "step_mm": Limit(-LIMIT, LIMIT, -0.2, 0.2, "DS-1", "A"),
    }},
)  # fmt: skip


def heads(heights: Array, u95: float = 0.004, columns: int = 10) -> list[Rivet]:
    """Heads 25 mm apart, row by row."""
    return [
        rivet_at(
            f"R{k:02d}", (0, 0, 700), (0, 0), 6.4, 20.0, height_mean_mm=float(h), height_u95_mm=u95,
            x_panel_mm=25.0 * (k % columns), y_panel_mm=25.0 * (k // columns), z_panel_mm=0.0,
        )
        for k, h in enumerate(heights)
    ]  # fmt: skip


def seam(steps: Array, u95: float = 0.004) -> list[SeamStation]:
    return [
        station_at(
            "J01", 2.0 * k, (0, 0, 700), (0, 0), step_mm=float(s), step_u95_mm=u95, width_mm=2.0, width_u95_mm=0.05,
            x_panel_mm=2.0 * k, y_panel_mm=0.0, z_panel_mm=0.0,
        )
        for k, s in enumerate(steps)
    ]  # fmt: skip


SHARE = Rule("A1", "share", "rivet", most=0.1, quantity="height", source="DS-1", revision="A")
SERIOUS = Rule("A2", "number", "rivet", most=0, quantity="height", beyond="serious", source="DS-1", revision="A")
ADJACENT = Rule("A3", "adjacent", "rivet", most=2, quantity="height", source="DS-1", revision="A")
RUN = Rule("A4", "run", "seam station", most=10, quantity="step", source="DS-1", revision="A")
LENGTH = Rule("A5", "length", "seam station", most=20, quantity="step", source="DS-1", revision="A")
MEAN = Rule("A6", "mean", "seam station", quantity="step", over_mm=40, source="DS-1", revision="A")


def verdict(rule: Rule, rows: list[Rivet] | list[SeamStation], area: float | None = None) -> str:
    kind = RIVET if rule.kind == "rivet" else SEAM_STATION
    [outcome] = judge_rules({rule.kind: judge(kind, rows, SPEC)}, SPEC, [rule], area_mm2=area)  # type: ignore[type-var]
    return outcome.verdict


def some(n: int, out: list[int], value: float = 0.15) -> Array:
    values = np.zeros(n)
    values[out] = value
    return values


@pytest.mark.parametrize(
    ("rule", "rows", "expected"),
    [
        (SHARE, heads(some(30, [1, 9, 20])), "met"),
        (SHARE, heads(some(30, [1, 9, 20, 25])), "not met"),
        (SHARE, heads(some(30, [1, 9, 20]) + some(30, [25], 0.097)), "met with conditions"),
        (SERIOUS, heads(some(30, [4], 0.19)), "met"),
        (SERIOUS, heads(some(30, [4], 0.21)), "not met"),
        (SERIOUS, heads(some(30, [4], 0.197)), "met with conditions"),
        (ADJACENT, heads(some(30, [4, 5, 17, 18, 25])), "met"),
        (ADJACENT, heads(some(30, [4, 5, 6])), "not met"),
        (ADJACENT, heads(some(30, [4, 14, 24])), "not met"),  # below each other
        (RUN, seam(some(100, [10, 11, 12, 13, 14, 20, 21, 22, 23, 24])), "met"),
        (RUN, seam(some(100, [10, 11, 12, 13, 14, 15])), "not met"),
        (LENGTH, seam(some(100, [10, 11, 12, 13, 14, 20, 21, 22, 23, 24])), "met"),
        (LENGTH, seam(some(100, [10, 11, 12, 13, 14, 20, 21, 22, 23, 24, 50])), "not met"),
        (MEAN, seam(some(100, [*range(10, 20)], 0.15)), "met"),
        (MEAN, seam(some(100, [*range(10, 30)], 0.15)), "not met"),
    ],
)
def test_worked_examples(rule: Rule, rows: list[Rivet] | list[SeamStation], expected: str) -> None:
    assert verdict(rule, rows) == expected


def test_features_per_area_count_whatever_their_values() -> None:
    rule = Rule("A7", "density", "rivet", most=10, beyond="any", source="DS-1", revision="A")
    assert verdict(rule, heads(np.zeros(10)), area=1e6) == "met"
    assert verdict(rule, heads(np.zeros(11)), area=1e6) == "not met"
    assert verdict(rule, heads(np.zeros(11)), area=1.2e6) == "met"


def test_groups_are_judged_each_on_its_own() -> None:
    rows = heads(some(20, [0, 1]))
    names = {f"R{k:02d}": "upper" if k < 10 else "lower" for k in range(20)}
    rule = replace(SHARE, per="row")
    outcomes = judge_rules({"rivet": judge(RIVET, rows, SPEC)}, SPEC, [rule], names)
    assert {outcome.group: outcome.verdict for outcome in outcomes} == {"upper": "not met", "lower": "met"}
    assert outcomes[0].features == ("R00", "R01")


def test_what_was_not_measured_is_never_good() -> None:
    rows = heads(np.zeros(30))
    rows[3] = replace(rows[3], height_mean_mm=None, height_u95_mm=None)
    judged = {"rivet": judge(RIVET, rows, SPEC)}
    outcomes = judge_rules(judged, SPEC, [SHARE])
    assert outcomes[0].verdict == "not decided"
    assert panel_verdict(outcomes, unruled(judged, [SHARE]), [], True)[0] == "incomplete"
    assert panel_verdict([], [], ["not seen: R77"], True) == ("incomplete", "not seen: R77")
    assert panel_verdict([], [], [], False)[0] == "no rules"


def test_the_verdict_names_the_rule_and_what_no_rule_covers_has_to_pass() -> None:
    judged = {
        "rivet": judge(RIVET, heads(some(30, [1, 9, 20, 25])), SPEC),
        "seam station": judge(SEAM_STATION, seam(np.zeros(20)), SPEC),
    }
    said = panel_verdict(judge_rules(judged, SPEC, [SHARE]), unruled(judged, [SHARE]), [], True)
    assert said[0] == "rejected"
    assert said[1].startswith(
        "A1: at most 10% of the rivets of a panel with height beyond its limit (DS-1 A): found 13%"
    )
    judged = {
        "rivet": judge(RIVET, heads(some(30, [1])), SPEC),
        "seam station": judge(SEAM_STATION, seam(some(20, [5])), SPEC),
    }
    assert panel_verdict(judge_rules(judged, SPEC, [SHARE]), unruled(judged, [SHARE]), [], True) == (
        "rejected", "beyond limits that no rule allows to exceed: J01@10.0"
    )  # fmt: skip
    judged = {"rivet": judge(RIVET, heads(some(30, [1])), SPEC)}
    assert panel_verdict(judge_rules(judged, SPEC, [SHARE]), unruled(judged, [SHARE]), [], True)[0] == "accepted"


def _at_the_limit(rule: Rule) -> Callable[[], Array]:
    """True values of a panel that just breaks a rule: as few and as little beyond as can be, the others far inside."""
    just = LIMIT + 1e-6
    return {
        "share": lambda: some(30, [1, 9, 20, 25], just),
        "number": lambda: some(30, [4], 0.2 + 1e-6),
        "adjacent": lambda: some(30, [4, 5, 6], just),
        "run": lambda: some(30, [*range(10, 16)], just),
        "length": lambda: some(30, [1, 2, 3, 7, 8, 9, 14, 15, 16, 22, 23], just),
        "mean": lambda: some(24, [*range(2, 22)], just),
    }[rule.measure]


@pytest.mark.parametrize("rule", [SHARE, SERIOUS, ADJACENT, RUN, LENGTH, MEAN], ids=lambda rule: rule.measure)
def test_a_panel_that_breaks_a_rule_is_accepted_in_one_of_forty_cases_at_most(rule: Rule) -> None:
    """Few panels here; `benchmarks/bench_acceptance.py` looks at ten thousand."""
    assert wrongly_accepted(rule, 100) <= 0.025 + 3 * np.sqrt(0.025 * 0.975 / 100)


def wrongly_accepted(rule: Rule, panels: int) -> float:
    """Share of panels at a rule's limit of which the rule says that it is met."""
    rng = np.random.default_rng(11)
    true, u95 = _at_the_limit(rule)(), 0.004
    rows_of = heads if rule.kind == "rivet" else seam
    accepted = 0
    for _ in range(panels):
        rows = rows_of(true + rng.normal(0, u95 / 1.96, len(true)), u95)  # type: ignore[operator]
        accepted += judge_rules({rule.kind: rows}, SPEC, [rule])[0].verdict == "met"
    return accepted / panels


def test_a_stretch_of_a_seam_is_one_finding() -> None:
    rows = judge(SEAM_STATION, seam(some(60, [10, 11, 12, 13]) + some(60, [12], 0.03) + some(60, [40], 0.13)), SPEC)
    long, short = stretches(SEAM_STATION, rows, SPEC)
    assert (long.from_mm, long.to_mm, long.length_mm, len(long.rows)) == (20, 26, 8, 4)
    assert long.feature_id == "J01@20.0-26.0"
    assert long.worst.s_mm == 24  # type: ignore[attr-defined]
    assert long.decision == "fail"
    assert "worst step +0.180 ± 0.004 mm at 24 mm" in long.said
    assert (short.from_mm, short.to_mm) == (80, 80)


def test_judging_again_leaves_no_word_of_the_former_judgement() -> None:
    row = replace(heads(np.array([0.15]))[0], reason="found by relief; see to it")
    [judged] = judge(RIVET, [row], SPEC)
    assert as_measured(RIVET, judged) == row
    other = PanelSpec("P", "2", {"default": {"height_mm": Limit(-0.2, 0.2, source="DS-1; table 3", revision="B")}})
    assert judge(RIVET, [as_measured(RIVET, judged)], other)[0].reason == "found by relief; see to it"
    unmeasured = replace(row, height_mean_mm=None, height_u95_mm=None)
    [judged] = judge(RIVET, [unmeasured], SPEC)
    assert as_measured(RIVET, judged) == unmeasured


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ({"kind": "bolt"}, "found kind 'bolt'"),
        ({"quantity": "width"}, "found quantity 'width', expected one of height, tilt"),
        ({"measure": "run"}, "expected a kind that runs along a course"),
        ({"most": 1.5}, "expected 0 … 1"),
        ({"over_mm": 10.0}, "expected a length for mean and for nothing else"),
    ],
)
def test_rules_that_make_no_sense_are_refused(more: dict[str, object], expected: str) -> None:
    with pytest.raises(SpecError, match="acceptance A1: ") as problem:
        replace(SHARE, **more)  # type: ignore[arg-type]
    assert expected in str(problem.value)
