"""A depth that may grow with the width: interpolated, with the uncertainty of both as guard band."""

from __future__ import annotations

from pathlib import Path

import pytest

from metrology.defects.row import Defect
from metrology.errors import SpecError
from metrology.kinds import DEFECT
from metrology.limits import GradedLimit, PanelSpec
from metrology.tolerance import as_measured, judge
from storage.panel_spec import load_panel_spec
from storage.report.sections import limits_table

NAME = "defect_depth_by_width_mm"
STEPS = ((10.0, 0.1), (30.0, 0.5), (60.0, 0.6))
SPEC = PanelSpec("P", "A", {"default": {NAME: GradedLimit(upper=0.6, steps=STEPS, source="SRM 51", revision="3")}})


def defect(depth: float, width: float, width_u95: float = 0.0, **more: object) -> Defect:
    return Defect(
        "D01", x_mm=0.0, y_mm=0.0, z_mm=700.0, u_px=0.0, v_px=0.0, kind="dent", depth_mm=depth, depth_u95_mm=0.01,
        length_mm=width, length_u95_mm=width_u95, width_mm=width, width_u95_mm=width_u95, **more,  # type: ignore[arg-type]
    )  # fmt: skip


@pytest.mark.parametrize(
    ("depth", "width", "width_u95", "decision"),
    [
        (0.28, 20.0, 0.0, "pass"),  # 0.3 mm are allowed there
        (-0.28, 20.0, 0.0, "pass"),
        (0.295, 20.0, 0.0, "conditional pass"),
        (0.28, 20.0, 2.0, "conditional pass"),  # ± 2 mm of width are ± 0.04 mm of what is allowed
        (0.305, 20.0, 0.0, "conditional fail"),
        (0.33, 20.0, 0.0, "fail"),
        (-0.33, 20.0, 0.0, "fail"),
        (0.33, 20.0, 2.0, "conditional fail"),
        (0.12, 5.0, 0.0, "fail"),  # narrower than the first: its limit
        (0.58, 200.0, 0.0, "pass"),
    ],
)
def test_depth_is_judged_by_the_width(depth: float, width: float, width_u95: float, decision: str) -> None:
    row = defect(depth, width, width_u95)
    (judged,) = judge(DEFECT, [row], SPEC)
    assert judged.decision == decision
    if decision != "pass":
        assert f"defect depth for a width of {width:.1f} mm" in (judged.reason or "")
        assert "SRM 51 3" in (judged.reason or "")
    assert as_measured(DEFECT, judged) == row


@pytest.mark.parametrize(("depth", "decision"), [(0.55, "not measured"), (0.65, "fail")])
def test_what_is_hidden_in_part_fails_by_what_no_wider_one_may_have(depth: float, decision: str) -> None:
    (judged,) = judge(DEFECT, [defect(depth, 20.0, hidden_by="view")], SPEC)
    assert judged.decision == decision


def test_without_a_depth_it_is_not_measured() -> None:
    bare = Defect("D01", x_mm=0.0, y_mm=0.0, z_mm=700.0, u_px=0.0, v_px=0.0, kind="scratch")
    (judged,) = judge(DEFECT, [bare], SPEC)
    assert judged.decision == "not measured"
    assert as_measured(DEFECT, judged).reason is None


def test_a_specification_has_the_table(tmp_path: Path) -> None:
    text = 'format = "flushline-panel/1"\npanel = "P"\nrevision = "A"\n'
    text += (
        f'[zones.default.{NAME}]\nsteps = [[10, 0.1], [30, 0.5]]\nserious_upper = 1.0\nsource = "S"\nrevision = "1"\n'
    )
    path = tmp_path / "panel.toml"
    path.write_text(text)
    limits = load_panel_spec(path).limits
    limit = limits.zone()[NAME]
    assert isinstance(limit, GradedLimit)
    assert limit.upper_at(20.0) == pytest.approx(0.3)
    assert "0.1 at 10, 0.5 at 30" in limits_table(limits)
    for wrong in ("[[10, 0.1]]", "[[30, 0.5], [10, 0.1]]", "[[10, 0.1], [30, -0.5]]", "[]"):
        path.write_text(text.replace("[[10, 0.1], [30, 0.5]]", wrong))
        with pytest.raises(SpecError, match=r"zones.default.*steps|neither"):
            load_panel_spec(path)
