"""Panel specifications: limits carry their source, and what is wrong is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from metrology.errors import SpecError
from storage.panel_spec import load_panel_spec, pattern_toml

SPEC = """
format = "flushline-panel/1"
panel = "LH-F12"
revision = "B"
[zones.default.height_mm]
upper = 0.1
source = "drawing 4711"
revision = "C"
[zones.nose.step_mm]
lower = -0.1
upper = 0.05
source = "drawing 4711"
revision = "C"
[[rivets]]
id = "R01"
position_mm = [0.0, 1.0, 2.0]
diameter_mm = 8.0
[[seams]]
id = "M1"
course_mm = [[0, 0, 0], [0, 100, 0]]
zone = "nose"
airflow = [1, 0, 0]
[stations.S3]
R = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
t_mm = [0, 0, -700]
"""


def test_a_specification_is_read(tmp_path: Path) -> None:
    path = tmp_path / "panel.toml"
    path.write_text(SPEC)
    spec = load_panel_spec(path)
    assert spec.limits.zone("nose")["step_mm"] is not None
    limit = spec.limits.zone()["height_mm"]
    assert limit is not None
    assert (limit.upper, limit.lower, limit.source, limit.revision) == (0.1, None, "drawing 4711", "C")
    assert spec.layout.seams[0].zone == "nose"
    assert spec.layout.stations["S3"].t[2] == -700


def test_the_example_says_that_it_is_one() -> None:
    spec = load_panel_spec()
    assert spec.example
    zone = spec.limits.zone()
    for name in ("height_mm", "tilt_deg", "step_mm", "width_mm"):
        limit = zone[name]
        assert "example" in limit.source


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('source = "drawing 4711"\n', "", "no key 'zones.default.height_mm.source'"),
        ("upper = 0.1\n", "", "zones.default.height_mm: limits: found neither"),
        ("upper = 0.05", "upper = -0.5", "zones.nose.step_mm: limits: found"),
        ("flushline-panel/1", "flushline-scene/1", 'expected "flushline-panel/1"'),
        ("upper = 0.1\n", "uper = 0.1\n", "unknown key 'zones.default.height_mm.uper'"),
        ('zone = "nose"', 'zone = "tail"', "found zone 'tail' in seam M1"),
        ("upper = 0.1\n", "upper = nan\n", "finite number"),
        ("[[rivets]]", "[[rivets", "broken TOML"),
        ("[1, 0, 0], [0, 1, 0]", "[2, 0, 0], [0, 1, 0]", "not a rotation"),
    ],
)
def test_a_wrong_specification_is_named(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "panel.toml"
    path.write_text(SPEC.replace(old, new))
    with pytest.raises(SpecError) as caught:
        load_panel_spec(path)
    assert said in str(caught.value)
    assert "panel.toml" in str(caught.value)


def test_a_pattern_is_written_as_it_is_read(tmp_path: Path) -> None:
    path, again = tmp_path / "panel.toml", tmp_path / "again.toml"
    path.write_text(SPEC + "[stations.S4]\nR = [[0, 1, 0], [1, 0, 0], [0, 0, -1]]\nt_mm = [0.1, 1e-4, 3]\n")
    layout = load_panel_spec(path).layout
    again.write_text(
        pattern_toml(layout, "LH-F12", "1", 'a "scan"').replace('[stations."S3"]', "[zones.nose]\n[stations.S3]")
    )
    written = load_panel_spec(again)
    assert written.layout.rivets == layout.rivets
    assert written.layout.seams == layout.seams
    for name, placement in layout.stations.items():
        assert (written.layout.stations[name].R == placement.R).all()
        assert (written.layout.stations[name].t == placement.t).all()
    assert written.document["enrolled_from"] == 'a "scan"'


def test_the_specification_in_the_documentation_can_be_read(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "panels.md").read_text(encoding="utf-8")
    path = tmp_path / "panel.toml"
    path.write_text(text.split("```toml\n")[1].split("```")[0], encoding="utf-8")
    spec = load_panel_spec(path)
    assert spec.layout.seams[0].airflow == (1, 0, 0)
    assert spec.limits.zone("nose")["step_into_wind_mm"] is not None
    assert spec.limits.zone("nose")["height_mm"] == spec.limits.zone()["height_mm"]
