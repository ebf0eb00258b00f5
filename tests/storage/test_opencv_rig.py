"""OpenCV's FileStorage: out and in again, what other programs write, and what is missing or wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from metrology.errors import RigError
from metrology.rig import Rig
from storage.opencv_rig import load_opencv_rig, save_opencv_rig
from tests.support.results import HEIGHT, WIDTH

WHEN = "2026-11-01T08:00:00Z"


@pytest.mark.parametrize("ending", [".xml", ".yml", ".json"])
def test_a_rig_goes_out_and_comes_back(tmp_path: Path, rig: Rig, ending: str) -> None:
    path = tmp_path / f"rig{ending}"
    save_opencv_rig(rig, path)
    again = load_opencv_rig([path], "back", WHEN)
    for name in ("left", "right", "projector"):
        before, after = getattr(rig, name), getattr(again, name)
        assert (before.width, before.height) == (after.width, after.height)
        for part in ("K", "R", "t", "lens"):
            assert getattr(after, part) == pytest.approx(getattr(before, part), rel=1e-12, abs=1e-15)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def write(path: Path, **values: object) -> Path:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        storage.write(name, np.array(value, float) if not isinstance(value, str) else value)
    storage.release()
    return path


def test_two_files_as_opencvs_sample_writes_them(tmp_path: Path, rig: Rig) -> None:
    """intrinsics.yml and extrinsics.yml, in metres, rectification beside, without sizes and projector."""
    inside = write(
        tmp_path / "intrinsics.yml", M1=rig.left.K, D1=np.zeros((1, 14)), M2=rig.right.K, D2=[[0.1, 0.2, 0.0, 0.0, 0.0]]
    )
    outside = write(
        tmp_path / "extrinsics.yml", R=rig.right.R, T=rig.right.t[:, None] / 1000, R1=np.eye(3), Q=np.eye(4)
    )
    size = (rig.left.width, rig.left.height)
    found = load_opencv_rig([inside, outside], "cv", WHEN, size, "m", rig.projector)
    assert found.right.t == pytest.approx(rig.right.t)
    assert found.right.distortion[:2] == pytest.approx([0.1, 0.2])
    assert found.projector == rig.projector
    with pytest.raises(RigError, match="image_size"):
        load_opencv_rig([inside, outside], "cv", WHEN, None, "m", rig.projector)
    assert load_opencv_rig([inside, outside], "cv", WHEN, size, "m").projector is None
    with pytest.raises(RigError, match="found no R, T"):
        load_opencv_rig([inside], "cv", WHEN, size)
    with pytest.raises(RigError, match="unit"):
        load_opencv_rig([inside, outside], "cv", WHEN, size, "furlong", rig.projector)


def test_a_rotation_vector_is_a_rotation(tmp_path: Path, rig: Rig) -> None:
    path = tmp_path / "rig.yml"
    save_opencv_rig(rig, path)
    vector = write(tmp_path / "vector.yml", R=cv2.Rodrigues(rig.right.R)[0])
    assert pytest.approx(rig.right.R) == load_opencv_rig([path, vector], "cv", WHEN).right.R


def test_prism_terms_are_kept_and_tilt_is_refused(tmp_path: Path, rig: Rig) -> None:
    path = tmp_path / "rig.yml"
    save_opencv_rig(rig, path)
    terms = [0.1, 0, 0, 0, 0, 0, 0, 0, 3e-3, 0, -2e-3, 1e-3, 0, 0]
    found = load_opencv_rig([path, write(tmp_path / "prism.yml", D2=[terms])], "cv", WHEN).with_right()
    np.testing.assert_array_equal(found.distortion, terms[:12])
    strong = write(tmp_path / "strong.yml", D2=[[0.1, 0, 0, 0, 0, 0, 0, 0, 0.3, 0, 0, 0]])
    with pytest.raises(RigError, match=r"found a thin prism's terms 0\.3, 0, 0, 0, which move the image's corner"):
        load_opencv_rig([path, strong], "cv", WHEN)
    tilted = write(tmp_path / "tilted.yml", D2=[[*terms[:12], 0.01, 0]])
    with pytest.raises(RigError, match="found 14 terms with tilt, expected at most 12"):
        load_opencv_rig([path, tilted], "cv", WHEN)


@pytest.mark.parametrize("content", ["", "%YAML:1.0\n---\nM1: [1, 2", "<?xml version='1.0'?><html></html>", "{"])
def test_damaged_files_are_one_line(tmp_path: Path, content: str) -> None:
    path = tmp_path / "broken.yml"
    path.write_text(content)
    with pytest.raises(RigError) as problem:
        load_opencv_rig([path], "cv", WHEN)
    assert "broken.yml" in str(problem.value)
    assert "\n" not in str(problem.value)


def test_missing_files_and_strange_endings_are_named(tmp_path: Path, rig: Rig) -> None:
    with pytest.raises(RigError, match=r"nowhere\.yml"):
        load_opencv_rig([tmp_path / "nowhere.yml"], "cv", WHEN)
    with pytest.raises(RigError, match="ending"):
        save_opencv_rig(rig, tmp_path / "rig.txt")
    with pytest.raises(RigError, match="two image sizes"):
        save_opencv_rig(replace(rig, right=replace(rig.right, width=rig.right.width + 1)), tmp_path / "rig.yml")


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"M1": np.array([[100.0, 0, 0], [0, 100.0, 0], [32.0, 24.0, 1]])}, "left: K: .* K is transposed"),
        ({"T": [[-0.05], [0.0], [0.0]]}, r"right: found its centre 0.05 mm .* t is in metres"),
        (
            {"T": [[50.0], [0.0], [0.0]]},
            "lighting .* or the right camera's.*: most likely R and t are the inverse",
        ),
        ({"D2": [[-0.01], [0.02], [0.004], [-0.003]]}, "right: distortion: found a column of four .*fisheye"),
        ({"D1": [[-0.3, 0.2, -0.3, 0.1]]}, "left: distortion: .*fisheye"),
        ({"M2": np.array([[100.0, 1.5, 32], [0, 100.0, 24], [0, 0, 1]])}, "right: K: found a skew"),
        ({"M2": np.array([[100.0, 0, 320], [0, 100.0, 24], [0, 0, 1]])}, "right: K: found the principal point at 320"),
        ({"R": np.diag([1.0, 1.0, -1.0])}, "right: R: .*a mirror"),
        ({"R": [[1.0, 0, 0, 0, 0]]}, "right: R: found shape"),
        ({"T3": [[-25.0], [np.nan], [0.0]]}, "projector: found a value that is not finite"),
        ({"image_size": [[HEIGHT, WIDTH]]}, "left: size: .* width and height are exchanged"),
        ({"distortion_model": "fisheye"}, "distortion_model: found 'fisheye'"),
    ],
)
def test_another_convention_is_refused_on_import(
    tmp_path: Path, rig: Rig, values: dict[str, object], said: str
) -> None:
    path = tmp_path / "rig.yml"
    save_opencv_rig(rig, path)
    changed = write(tmp_path / "changed.yml", **values)
    with pytest.raises(RigError, match=said) as caught:
        load_opencv_rig([path, changed], "cv", WHEN)
    assert "changed.yml" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            '{"K1": %(K)s, "D1": %(D)s, "K2": %(K)s, "D2": %(D)s, "q": [0, 0, 0, 0], "T": [-120, 0, 0]}',
            "0 0 0 0, expected",
        ),
        (
            '{"K1": %(K)s, "D1": %(D)s, "K2": %(K)s, "D2": %(D)s, "R": [0, 0, 0], "T": [1%(zeros)s, 0, 0]}',
            "found no T, exp",
        ),
    ],
)
def test_numbers_that_are_none_are_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "rig.json").write_text(
        text % {"K": [[1200, 0, 640], [0, 1200, 512], [0, 0, 1]], "D": [-0.1, 0.05, 0, 0, 0], "zeros": 400 * "0"}
    )
    with pytest.raises(RigError, match=said):
        load_opencv_rig([tmp_path / "rig.json"], "cv", WHEN, (1280, 1024))


def test_a_rotation_that_is_none_is_taken_from_the_rectification(tmp_path: Path, rig: Rig) -> None:
    """OpenCV's own test data hold P2 under the name of R."""
    left, right = rig.left, rig.with_right()
    size = (left.width, left.height)
    none = np.zeros(5)
    R1, R2, P1, P2 = cv2.stereoRectify(left.K, none, right.K, none, size, right.R, right.t[:, None])[:4]
    said = {"M1": left.K, "D1": none, "M2": right.K, "D2": none, "T": right.t, "R1": R1, "R2": R2, "P1": P1, "P2": P2}
    found = load_opencv_rig([write(tmp_path / "p.yml", R=P2, **said)], "cv", WHEN, size)
    assert np.allclose(found.with_right().R, right.R, atol=1e-9)
    assert np.allclose(found.with_right().t, right.t, atol=1e-6)
    assert "rectification" in found.extra["read_otherwise"]
    sound = load_opencv_rig([write(tmp_path / "s.yml", R=right.R, **said)], "cv", WHEN, size)
    assert "read_otherwise" not in sound.extra
    with pytest.raises(RigError, match="R"):
        load_opencv_rig([write(tmp_path / "n.yml", R=P2, **{**said, "R1": P1})], "cv", WHEN, size)


def test_cameras_of_two_sizes(tmp_path: Path, rig: Rig) -> None:
    left, right = rig.left, rig.with_right()
    K = right.K.copy()
    K[:2] /= 2
    half = (right.width // 2, right.height // 2)
    said = {"M1": left.K, "D1": np.zeros(5), "M2": K, "D2": np.zeros(5), "R": right.R, "T": right.t}
    plain = write(tmp_path / "plain.yml", **said)
    given = load_opencv_rig([plain], "cv", WHEN, (left.width, left.height), right_size=half).with_right()
    assert (given.width, given.height) == half
    with pytest.raises(RigError, match=r"K is that of images 0\.5 times the size"):
        load_opencv_rig([plain], "cv", WHEN, (left.width, left.height))
    told = write(tmp_path / "told.yml", image_size_1=[left.width, left.height], image_size_2=list(half), **said)
    found = load_opencv_rig([told], "cv", WHEN)
    assert (found.left.width, found.with_right().width) == (left.width, half[0])


def test_centimetres_are_asked_for(tmp_path: Path) -> None:
    """A rig of 30 mm in place of 300 could be built; the file does not tell."""
    K = [[1400.0, 0, 639.5], [0, 1400.0, 479.5], [0, 0, 1]]
    R = np.asarray(cv2.Rodrigues(np.array([0.0, 0.4, 0.0]))[0])
    t = -R @ np.array([300.0, 0.0, 0.0])
    said = {"M1": K, "D1": np.zeros(5), "M2": K, "D2": np.zeros(5), "R": R, "image_size": [1280, 960]}
    path = write(tmp_path / "cm.yml", T=t / 10, **said)
    with pytest.raises(RigError, match="--unit mm, --unit cm"):
        load_opencv_rig([path], "cv", WHEN)
    assert np.allclose(load_opencv_rig([path], "cv", WHEN, unit="cm").with_right().t, t)
    assert np.allclose(load_opencv_rig([path], "cv", WHEN, unit="mm").with_right().t, t / 10)
    whole = write(tmp_path / "mm.yml", T=t, **said)
    assert np.allclose(load_opencv_rig([whole], "cv", WHEN).with_right().t, t)


def test_names_that_tell_nothing_are_asked_for(tmp_path: Path, rig: Rig) -> None:
    right = rig.with_right()
    size = (rig.left.width, rig.left.height)
    path = write(
        tmp_path / "odd.yml", uno=rig.left.K, due=np.zeros(5), tre=right.K, qua=[0.1, 0, 0, 0], cin=right.R, sei=right.t
    )
    with pytest.raises(RigError, match=r"found no M1, .*; found uno \(3×3\), .*--names M1=NAME"):
        load_opencv_rig([path], "cv", WHEN, size)
    given = {"M1": "uno", "D1": "due", "M2": "tre", "D2": "qua", "R": "cin", "T": "sei"}
    found = load_opencv_rig([path], "cv", WHEN, size, given=given).with_right()
    assert np.allclose(found.R, right.R)
    assert np.allclose(found.t, right.t)
    assert found.distortion[0] == 0.1
    for wrong in ({"M1": "sette"}, {"K1": "uno"}):
        with pytest.raises(RigError, match="--names: found"):
            load_opencv_rig([path], "cv", WHEN, size, given=wrong)
