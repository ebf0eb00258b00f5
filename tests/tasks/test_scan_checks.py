"""Scans whose frames are not what scene.json says: refused with one line that names what was found."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from metrology.common_sight import LEAST_ALIKE, rims_alike
from metrology.errors import SceneError
from storage.archive import Store
from storage.rig import load_rig
from tasks import steps
from tasks.scan_checks import contradiction_warnings, unseen_warnings
from tasks.settings import InspectionSettings

Edit = Callable[[Path, dict[str, Any]], None]


def faulty(shared: Path, folder: Path, edit: Edit) -> Path:
    """The shared scan of the standard part, linked, with an edit."""
    sound = shared / "scenes" / "standard-part"
    document = json.loads((sound / "scene.json").read_text())
    for camera in ("left", "right"):
        (folder / camera).mkdir(parents=True)
        for name in document["frames"][camera][0]:
            os.symlink(sound / name, folder / name)
    edit(folder, document)
    (folder / "scene.json").write_text(json.dumps(document))
    return folder


def reconstruct(shared: Path, folder: Path) -> None:
    loaded = steps.load(folder, shared / "scenes" / "rig.json", Store(folder / "store"))
    steps.reconstruct_scene(loaded, InspectionSettings())


def torn(camera: str, frame: int, lower: int, row: int) -> Edit:
    def edit(folder: Path, document: dict[str, Any]) -> None:
        names = document["frames"][camera][0]
        picture, other = (cv2.imread(str(folder / names[k]), cv2.IMREAD_UNCHANGED) for k in (frame, lower))
        picture[row:] = other[row:]
        (folder / names[frame]).unlink()
        cv2.imwrite(str(folder / names[frame]), picture)

    return edit


def order(shown: Sequence[int], cameras: Sequence[str] = ("left", "right")) -> Edit:
    def edit(_: Path, document: dict[str, Any]) -> None:
        for camera in cameras:
            document["frames"][camera][0] = [document["frames"][camera][0][k] for k in shown]

    return edit


def copied(folder: Path, document: dict[str, Any]) -> None:
    for left, right in zip(document["frames"]["left"][0], document["frames"]["right"][0], strict=True):
        (folder / right).unlink()
        shutil.copy(folder / left, folder / right)


REVERSED = [0, 3, 2, 1, 4, 7, 6, 5, 8, 11, 10, 9]


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (torn("right", 5, 6, 620), r"right/e0_f1_s1.png: found that it does not fit the other steps of count 64 "
         r"below row 6[12]\d \(the same picture as right/e0_f1_s2.png\), expected step 2 of count 64"),
        (torn("left", 8, 2, 0), r"left/e0_f2_s0.png: found the same picture as left/e0_f0_s2.png, expected step 1 of"),
        (order([0, *range(11)], ["right"]), "frames of the right camera fit if each is .* late by one"),
        (copied, "right/e0_f0_s0.png: found the same picture as left/e0_f0_s0.png"),
    ],
)  # fmt: skip
def test_wrong_frames_are_refused_by_name(shared: Path, tmp_path: Path, edit: Edit, said: str) -> None:
    # "Late by one" repeats the first frame, which a manifest cannot list twice: a copy stands for it.
    folder = faulty(shared, tmp_path / "scene", lambda *_: None)
    document = json.loads((folder / "scene.json").read_text())
    edit(folder, document)
    for camera in ("left", "right"):
        names = document["frames"][camera][0]
        if len(set(names)) < len(names):
            shutil.copy(folder / names[0], folder / camera / "first.png")
            names[0] = f"{camera}/first.png"
    (folder / "scene.json").write_text(json.dumps(document))
    with pytest.raises(SceneError, match=said) as caught:
        reconstruct(shared, folder)
    assert "\n" not in str(caught.value)


def test_steps_in_reverse_order_are_told_by_the_rig(shared: Path, tmp_path: Path) -> None:
    folder = faulty(shared, tmp_path / "scene", order(REVERSED))
    loaded = steps.load(folder, shared / "scenes" / "rig.json", Store(tmp_path / "store"))
    reconstruction = steps.reconstruct_scene(loaded, InspectionSettings())
    with pytest.raises(SceneError, match="when the phase steps are taken in reverse order"):
        steps.check_rig(loaded, reconstruction, [], InspectionSettings())


def test_a_sound_scan_is_neither_refused_nor_warned_of(shared: Path, tmp_path: Path) -> None:
    folder = faulty(shared, tmp_path / "scene", lambda *_: None)
    loaded = steps.load(folder, shared / "scenes" / "rig.json", Store(tmp_path / "store"))
    reconstruction = steps.reconstruct_scene(loaded, InspectionSettings())
    assert contradiction_warnings(reconstruction, InspectionSettings().checks) == []
    assert unseen_warnings(reconstruction) == []
    assert reconstruction.doubts == ()
    assert reconstruction.remarks == ()
    assert np.isfinite(reconstruction.points).any()


def test_a_blurred_frame_is_told_and_its_ripple_taken_out(shared: Path, tmp_path: Path) -> None:
    """A frame blurred by 3 px loses a third of its fringes: less than is refused, and relief were it believed."""

    def blurred(folder: Path, document: dict[str, Any]) -> None:
        name = document["frames"]["left"][0][5]
        picture = cv2.GaussianBlur(cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED), (0, 0), 3)
        (folder / name).unlink()
        cv2.imwrite(str(folder / name), picture)

    clouds = []
    for name, edit in (("sound", lambda *_: None), ("blurred", blurred)):
        folder = faulty(shared, tmp_path / name, edit)
        loaded = steps.load(folder, shared / "scenes" / "rig.json", Store(tmp_path / "store"))
        clouds.append(steps.reconstruct_scene(loaded, InspectionSettings()))
    sound, odd = clouds
    assert sound.remarks == ()
    assert len(odd.remarks) == 1
    assert "frames of the left camera are uneven" in odd.remarks[0]
    both = (sound.flags == 0) & (odd.flags == 0)
    off = (odd.points[..., 2] - sound.points[..., 2])[both]
    assert np.std(off) < np.median(sound.sigma_z[both])


def test_frames_that_hardly_fit_are_warned_of(shared: Path, tmp_path: Path) -> None:
    """Lamps that flicker below the shutter's rows: both cameras alike, in other rows of every frame."""

    def banded(folder: Path, document: dict[str, Any]) -> None:
        for camera in ("left", "right"):
            for k, name in enumerate(document["frames"][camera][0]):
                picture = cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED).astype(float)
                light = 4 * np.sin(2 * np.pi * np.arange(len(picture)) / 300 + 2.4 * k)
                (folder / name).unlink()
                banded = np.clip(np.rint(picture + light[:, None]), 0, 255).astype(np.uint8)
                cv2.imwrite(str(folder / name), banded)

    folder = faulty(shared, tmp_path / "scene", banded)
    loaded = steps.load(folder, shared / "scenes" / "rig.json", Store(tmp_path / "store"))
    (said,) = steps.reconstruct_scene(loaded, InspectionSettings()).remarks
    assert "left and right camera hardly fit each other" in said


def test_a_lamp_that_flickers_is_no_reason_for_a_warning(shared: Path, tmp_path: Path) -> None:
    """Every frame as a whole brighter or darker by a few percent, for both cameras."""

    def flickering(folder: Path, document: dict[str, Any]) -> None:
        for camera in ("left", "right"):
            for k, name in enumerate(document["frames"][camera][0]):
                picture = cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED).astype(float)
                (folder / name).unlink()
                light = 0.95 + 0.05 * np.sin(2.4 * k)
                cv2.imwrite(str(folder / name), np.clip(np.rint(light * picture), 0, 255).astype(np.uint8))

    folder = faulty(shared, tmp_path / "scene", flickering)
    loaded = steps.load(folder, shared / "scenes" / "rig.json", Store(tmp_path / "store"))
    assert steps.reconstruct_scene(loaded, InspectionSettings()).remarks == ()


@pytest.mark.parametrize(("light", "faint"), [(0.1, True), (0.3, False)])
def test_a_scan_in_the_dark_is_warned_of(shared: Path, tmp_path: Path, light: float, faint: bool) -> None:
    def darker(folder: Path, document: dict[str, Any]) -> None:
        for name in (name for camera in ("left", "right") for name in document["frames"][camera][0]):
            picture = cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED)
            (folder / name).unlink()
            cv2.imwrite(str(folder / name), np.rint(light * picture).astype(np.uint8))

    loaded = steps.load(
        faulty(shared, tmp_path / "scene", darker), shared / "scenes" / "rig.json", Store(tmp_path / "store")
    )
    found = steps.reconstruct_scene(loaded, InspectionSettings()).doubts
    assert len(found) == faint
    assert not faint or "faint: the left camera's fringes have 6 grey levels" in found[0].warning.replace("7", "6")


@pytest.mark.parametrize("sigma", [0.0, 2.0, 4.0])
def test_a_camera_out_of_focus_is_warned_of(shared: Path, tmp_path: Path, sigma: float) -> None:
    def defocused(folder: Path, document: dict[str, Any]) -> None:
        for name in document["frames"]["right"][0] if sigma else ():
            picture = cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED)
            (folder / name).unlink()
            cv2.imwrite(str(folder / name), cv2.GaussianBlur(picture, (0, 0), sigma))

    folder = faulty(shared, tmp_path / "scene", defocused)
    loaded = steps.load(folder, shared / "scenes" / "rig.json", Store(tmp_path / "store"))
    doubts = steps.reconstruct_scene(loaded, InspectionSettings()).doubts
    if not sigma:
        assert doubts == ()
        return
    blur = re.search(r"the right camera's fringes are blurred by ([\d.]+) px", doubts[0].warning)
    assert blur is not None
    # The sound pictures' own blur, 1.2 px, adds to it.
    assert float(blur[1]) == pytest.approx(np.hypot(sigma, 1.2), abs=0.15)


def test_another_rig_under_a_stored_id_is_warned_of(shared: Path, tmp_path: Path) -> None:
    """Cameras and projector one per cent farther apart: no scan shows it, and every height is off by as much."""
    store, sound, path = Store(tmp_path / "store"), shared / "scenes" / "rig.json", tmp_path / "rig.json"
    store.add_rig(load_rig(sound))
    document = json.loads(sound.read_text())
    for device in (document["cameras"]["right"], document["projector"]):
        device["t"] = [1.01 * value for value in device["t"]]
    path.write_text(json.dumps(document))
    scene = shared / "scenes" / "standard-part"
    assert steps.load(scene, sound, store).warnings == ()
    (said,) = steps.load(scene, path, store).warnings
    assert "other values than the store has for that id" in said


def test_pictures_of_another_scan_beside_this_one_s_are_refused(shared: Path, tmp_path: Path) -> None:
    """Skins of the same grain, other heads on them: the rig fits within a third of a pixel."""
    scenes = shared / "scenes"
    folder = tmp_path / "scene"
    document = json.loads((scenes / "skin-worn" / "scene.json").read_text())
    other = json.loads((scenes / "skin" / "scene.json").read_text())
    for camera, source, names in (("left", "skin", other), ("right", "skin-worn", document)):
        (folder / camera).mkdir(parents=True)
        document["frames"][camera] = names["frames"][camera]
        for name in names["frames"][camera][0]:
            os.symlink(scenes / source / name, folder / name)
    (folder / "scene.json").write_text(json.dumps(document))
    loaded = steps.load(folder, scenes / "rig.json", Store(tmp_path / "store"))
    settings = InspectionSettings()
    seen = steps.reconstruct_scene(loaded, settings)
    detections = steps.detect_rivets(seen, settings).rivets
    said = "rims in the left camera's pictures that are not in the right one's .* expected frames of one scan"
    with pytest.raises(SceneError, match=said):
        steps.check_rig(loaded, seen, detections, settings)


def test_a_sheen_that_each_camera_sees_otherwise_is_no_other_scan(shared: Path, tmp_path: Path) -> None:
    loaded = steps.load(shared / "scenes" / "skin-shiny", shared / "scenes" / "rig.json", Store(tmp_path / "store"))
    settings = InspectionSettings()
    seen = steps.reconstruct_scene(loaded, settings)
    alike = rims_alike(seen, steps.detect_rivets(seen, settings).rivets)
    assert alike is not None
    assert alike > LEAST_ALIKE + 0.2
