"""What the kinds and the steps declare is there."""

from __future__ import annotations

import inspect
from collections import Counter
from dataclasses import fields

import pytest

from metrology.defects.row import Defect
from metrology.kinds import DEFECT, KINDS, LIMITS, Kind, load
from metrology.results import Feature
from metrology.steps import STEPS, Step


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_kind_names_what_exists(kind: Kind) -> None:
    assert issubclass(kind.row_type, Feature)
    there = {field.name for field in fields(kind.row_type)}
    named = [*kind.id_columns, *(column for cell in kind.shown for column in cell.columns)]
    named += [column for values in (kind.without, *(q.not_of for q in kind.quantities)) for column, _ in values]
    for quantity in kind.quantities:
        named += [quantity.column, quantity.u95_column, *quantity.rests_on_it]
        named += [quantity.into_wind] if quantity.into_wind else []
        assert len(quantity.limits) == (3 if quantity.into_wind else 1)
    assert set(named) <= there
    for function in filter(None, (kind.verdict, kind.unlimited, kind.note, kind.measure)):
        assert callable(load(function))


def test_a_row_has_the_quantities_of_what_it_is() -> None:
    """Limits speak of the skin: what lies on it has none; a dent has those that were measured."""
    dent = Defect("D01", x_mm=0.0, y_mm=0.0, z_mm=0.0, u_px=0.0, v_px=0.0, kind="dent", depth_mm=0.1, length_mm=9.0)
    columns = [q.column for q in DEFECT.quantities_of(dent)]
    assert columns == ["depth_mm", "length_mm", "width_mm", "bottom_radius_mm"]  # which may be too small to be told
    assert DEFECT.quantities_of(dent.changed(kind="deposit")) == []


def test_names_are_of_one_thing_each() -> None:
    quantities = [quantity for kind in KINDS for quantity in kind.quantities]
    limits = [limit.name for quantity in quantities for limit in quantity.all_limits]
    for names in (
        [quantity.name for quantity in quantities],
        limits,
        *([getattr(kind, name) for kind in KINDS] for name in ("name", "table", "subject", "parameter")),
        [count.column for kind in KINDS for count in kind.counts],
        [step.name for step in STEPS],
        [step.function for step in STEPS],
    ):
        assert Counter(names).most_common(1)[0][1] == 1
    assert list(LIMITS) == limits


@pytest.mark.parametrize("step", STEPS, ids=lambda step: step.name)
def test_a_step_names_a_function(step: Step) -> None:
    assert inspect.isfunction(load(step.function))
    assert step.progress
    assert set(step.tags) <= {"io", "metrology", "store"}
