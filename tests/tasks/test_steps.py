"""What the steps add around metrology: checks that refuse a scan, and what is kept with a result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metrology.cloud import PixelFlag
from metrology.errors import RigError, SceneError, UsageError
from metrology.fringe import FringeCode
from metrology.mix_ups import MixUp
from metrology.rig_health import RigHealth
from storage.panel_spec import load_panel_spec
from storage.scene import Scene
from tasks import rig_check, steps
from tasks.loaded import LoadedScene
from tasks.result import config_hash, overexposure_warnings, preview, versions
from tasks.settings import InspectionSettings, SceneChecks, load_settings, settings_from
from tests.support.results import small_key, small_result


@pytest.fixture
def scene() -> Scene:
    return Scene(Path("scene"), small_key(), "rig-a", None, None, (1.0,), (), (), None, None)  # type: ignore[arg-type]


def test_a_dark_scan_is_refused_with_its_cause(scene: Scene) -> None:
    reconstruction = small_result().reconstruction
    dark = replace(
        reconstruction,
        points=np.full_like(reconstruction.points, np.nan),
        flags=np.full_like(reconstruction.flags, PixelFlag.LOW_MODULATION),
    )
    with pytest.raises(SceneError, match=r"scene: found points for 0\.0% of the pixels \(100% too dark"):
        steps._check_skin_is_seen(scene, dark, SceneChecks())


@pytest.mark.parametrize(("lost_share", "said"), [(0.5, True), (0.02, False)])
def test_an_overexposed_scan_says_so(lost_share: float, said: bool) -> None:
    rng = np.random.default_rng(1)
    reconstruction = small_result().reconstruction
    lost = reconstruction.valid & (rng.random(reconstruction.valid.shape) < lost_share)
    flags, points = reconstruction.flags.copy(), reconstruction.points.copy()
    flags[lost] |= np.uint16(PixelFlag.SATURATED)
    points[lost] = np.nan
    warnings = overexposure_warnings(replace(reconstruction, flags=flags, points=points), SceneChecks())
    assert len(warnings) == said
    # A share of some hundred pixels looked at, to four standard deviations.
    assert not said or 0.4 < int(warnings[0].split("%")[0].removeprefix("overexposed: ")) / 100 < 0.6


def test_a_rig_that_does_not_fit_is_refused(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    health = RigHealth(0.06, 0.004, 200, 41.5, 400, "refused", "the decoded projector coordinate is off by 41.5 px")
    monkeypatch.setattr(steps.rig_health, "epipolar_health", lambda *_: health)
    result = small_result()
    loaded = LoadedScene(replace(scene, code=FringeCode("x", 4, (7, 6, 5))), result.reconstruction.rig)
    with pytest.raises(RigError, match=r"scene: found that rig 'rig-a' does not fit the scan \(the decoded"):
        steps.check_rig(loaded, result.reconstruction, [], InspectionSettings())


def test_frames_that_were_mixed_up_are_named_instead(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    health = RigHealth(0.06, 0.004, 200, 41.5, 400, "refused", "the decoded projector coordinate is off by 41.5 px")
    found = MixUp("left and right are exchanged", "scene.json to list them as the rig's cameras are")
    monkeypatch.setattr(steps.rig_health, "epipolar_health", lambda *_: health)
    monkeypatch.setattr(rig_check, "find_mix_up", lambda *_: found)
    result = small_result()
    loaded = LoadedScene(replace(scene, code=FringeCode("x", 4, (7, 6, 5))), result.reconstruction.rig)
    with pytest.raises(SceneError, match=r"fit rig 'rig-a' when left and right are exchanged, expected scene\.json to"):
        steps.check_rig(loaded, result.reconstruction, [], InspectionSettings())


def test_hardly_any_counterparts_are_no_darkness(scene: Scene) -> None:
    reconstruction = small_result().reconstruction
    lost = replace(
        reconstruction,
        points=np.full_like(reconstruction.points, np.nan),
        flags=np.full_like(reconstruction.flags, PixelFlag.UNMATCHED),
    )
    problem = rig_check.unmatched(replace(scene, code=FringeCode("x", 4, (7, 6, 5))), lost)
    assert isinstance(problem, RigError)
    assert "counterparts for 0.0% of the pixels though the left camera sees fringes on 98%" in str(problem)
    assert "give the rig that took the scan" in str(problem)
    assert rig_check.unmatched(scene, reconstruction) is None


def test_the_preview_keeps_grey_levels_where_they_fit() -> None:
    texture = np.linspace(0, 200, 64 * 48, dtype=np.float32).reshape(48, 64)
    assert np.abs(preview(texture) - texture).max() <= 0.5
    bright = preview(texture * 20)
    assert bright.max() <= 255
    assert 240 <= np.sort(bright.ravel())[-10] <= 255


def test_settings_are_read_and_named(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_text('[rivets]\nreference = "plane"\n[checks]\nmin_valid_fraction = 0.3\n[seams.lines]\nseed = 7\n')
    settings = load_settings(path)
    assert settings.rivets.reference == "plane"
    assert settings.checks.min_valid_fraction == 0.3
    assert settings.seams.lines.seed == 7
    assert settings.reconstruction == InspectionSettings().reconstruction
    spec = load_panel_spec()
    assert config_hash(settings, spec) != config_hash(InspectionSettings(), spec)
    assert config_hash(load_settings(), spec) == config_hash(InspectionSettings(), spec)


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ({"rivet": {}}, "unknown key 'rivet', expected 'rivets'"),
        ({"rivets": {"referense": "plane"}}, "unknown key 'rivets.referense', expected 'reference'"),
        ({"seams": {"lines": {"sed": 1}}}, "unknown key 'seams.lines.sed', expected 'seed'"),
        ({"rivets": {"reference": "sphere"}}, "reference"),
        ({"rivets": 4}, "expected a table of settings"),
        ({"reconstruction": {"min_modulation": -1.0}}, "min_modulation: found -1"),
        ({"reconstruction": {"min_modulation": "much"}}, 'reconstruction.min_modulation: found "much"'),
    ],
)
def test_wrong_settings_are_named(document: dict[str, object], said: str) -> None:
    with pytest.raises(UsageError) as caught:
        settings_from(document, "settings.toml")
    assert said in str(caught.value)
    assert str(caught.value).startswith("settings.toml: ")


def test_versions_name_what_computes() -> None:
    assert {"flushline", "numpy", "numba", "opencv-python-headless", "python"} <= set(versions())
