"""A kind of feature of the tests' own: test marks, with a depth. What a kind needs is here, and nothing elsewhere."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Annotated

from metrology.kinds import Count, Kind, LimitName, Quantity
from metrology.results import Feature
from metrology.sighted import Sighted


@dataclass(frozen=True)
class TestMark(Feature):
    """One row of `test_marks`."""

    mark_id: Annotated[str, "name of the mark"]
    _: KW_ONLY
    depth_mm: Annotated[float | None, "depth of the mark, mm"] = None
    depth_u95_mm: Annotated[float | None, "expanded uncertainty (95 %) of depth_mm, mm"] = None


KIND = Kind(
    name="test mark",
    table="test_marks",
    row="tests.support.marks:TestMark",
    one="test mark",
    many="test marks",
    id_columns=("mark_id",),
    point="middle of the mark",
    quantities=(
        Quantity(
            "depth", "depth_mm", "depth_u95_mm", "mm", "Mark depth",
            (LimitName("mark_depth_mm", "depth of a test mark, mm"),), signed=True,
        ),
    ),
    counts=(Count("n_test_marks", "test marks found"),),
    subject="mark",
    parameter="mark",
    measure="tests.support.marks:measure",
)  # fmt: skip


def measure(sighted: Sighted, settings: None) -> list[TestMark]:
    """Three marks: one too deep, one in order, one that was not measured."""
    places = [TestMark(f"T{k}", x_mm=8.0 * k, y_mm=4.0, z_mm=700.0, u_px=30.0 + k, v_px=20.0) for k in (1, 2, 3)]
    assert {name: len(sighted.features[name]) for name in ("rivet", "seam station")} == {"rivet": 3, "seam station": 2}
    return [
        TestMark(**{**row.__dict__, "depth_mm": depth, "depth_u95_mm": u95})
        for row, depth, u95 in zip(places, (0.3, 0.05, None), (0.01, 0.01, None), strict=True)
    ]
