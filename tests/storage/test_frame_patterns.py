"""Patterns of frames' names that nobody has told."""

from __future__ import annotations

from pathlib import Path

import pytest

from metrology.errors import SceneError
from storage.frame_patterns import name_patterns
from storage.scene_names import cameras_of, matching


@pytest.mark.parametrize(
    ("names", "pattern"),
    [
        (  # seconds stand three times each, and milliseconds are no steps
            [f"{c}/05-13_14-22-{7 + k // 3:02d}-{k * 333 % 1000:03d}.png" for c in "LR" for k in range(15)],
            "{camera}/05-13_14-22-{frame}.png",
        ),
        (  # of counts with different numbers of steps, the fewer ones are the first of the others
            [f"{c}{n}_{k}.png" for c in "LR" for n, of in ((40, 8), (41, 4)) for k in range(of)],
            "{camera}{count}_{step}.png",
        ),
        ([f"{side}_{k:02d}.bmp" for side in ("left", "right") for k in range(12)], "{camera}_{frame}.bmp"),
        (
            [f"cam{c}/IM_{n}_{k:02d}.png" for c in (1, 2) for n in (12, 13, 14) for k in range(4)],
            "cam{camera}/IM_{count}_{step}.png",
        ),
        ([f"{side}/{k}.jpg" for side in "LR" for k in range(1, 9)], "{camera}/{frame}.jpg"),
        ([f"frames{c}_{k}.png" for c in (0, 1) for k in range(26)], "frames{camera}_{frame}.png"),
        ([f"s7/{c}/f{c}_{k}.tiff" for c in ("left", "right") for k in range(9)], "s7/{camera}/f{camera}_{frame}.tiff"),
        ([f"{s}/cam{c}_2_{k}.bmp" for c, s in enumerate("LR") for k in range(23)], "{camera}/cam*_2_{frame}.bmp"),
        ([f"pattern_cam{c}_im{k}.png" for c in (1, 2) for k in range(1, 45)], "pattern_cam{camera}_im{frame}.png"),
        ([f"graycode_{k:02d}.png" for k in range(42)], "graycode_{frame}.png"),
        ([f"f{n}_{k}.png" for n in (35, 36) for k in range(8)], "f{count}_{step}.png"),
        (
            [f"{s}/gray{w}{k:02d}.bmp" for s, w in (("L", "left"), ("R", "right")) for k in range(1, 13)],
            "{camera}/gray*{frame}.bmp",
        ),
        ([f"gray{side}_{k}.bmp" for side in "LR" for k in range(12)], "gray{camera}_{frame}.bmp"),
        ([f"right ({k}).png" for k in range(9)] + [f"left ({k}).png" for k in range(9)], "{camera} ({frame}).png"),
    ],
)  # fmt: skip
def test_names_tell_camera_count_step_and_number(names: list[str], pattern: str, tmp_path: Path) -> None:
    for name in [*names, "contact-sheet.png", "grey/9.png", "readme.txt"]:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (found,) = name_patterns(tmp_path)
    assert found.pattern == pattern
    assert len(found.paths) == len(names)
    fitting = matching(tmp_path, pattern)
    assert set(fitting) == set(found.paths)
    if "{frame}" in pattern:
        assert len({values["frame"] for values in fitting.values()}) == len(names) // (
            2 if "{camera}" in pattern else 1
        )
    if "{camera}" in pattern:
        assert len(cameras_of(fitting, None)) == 2


def test_pictures_of_several_kinds_have_patterns_of_their_own(tmp_path: Path) -> None:
    for name in [*(f"f{k}.png" for k in range(4)), *(f"board/{k}.png" for k in range(9))]:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert [one.pattern for one in name_patterns(tmp_path)] == ["board/{frame}.png", "f{frame}.png"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(SceneError, match="no pictures"):
        name_patterns(tmp_path / "empty")
