"""Scans whose pictures are not as the sensor gave them: said in a line, and nothing false is left to be believed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from metrology import rig_health
from metrology.cloud import Reconstruction
from metrology.defects.row import Defect
from metrology.frame_doubts import FrameDoubt, Place, without_doubtful
from metrology.kinds import DEFECT, SEAM_STATION
from metrology.results import SeamStation
from metrology.rig_health import RigHealth
from storage.archive import Store
from tasks import steps
from tasks.settings import InspectionSettings
from tests.support.results import small_result
from tests.tasks.test_scan_checks import faulty

Change = Callable[[NDArray, np.random.Generator], NDArray]


def scanned(shared: Path, folder: Path, change: Change, cameras: tuple[str, ...] = ("left", "right")) -> Reconstruction:
    """The standard part with every picture of these cameras changed."""
    rng = np.random.default_rng(len(folder.name))

    def edit(scene: Path, document: dict[str, Any]) -> None:
        for name in (name for camera in cameras for name in document["frames"][camera][0]):
            picture = cv2.imread(str(scene / name), cv2.IMREAD_UNCHANGED)
            (scene / name).unlink()
            cv2.imwrite(str(scene / name), np.clip(np.rint(change(picture, rng)), 0, 255).astype(np.uint8))

    folder = faulty(shared, folder / "scene", edit)
    loaded = steps.load(folder, shared / "scenes" / "rig.json", Store(folder.parent / "store"))
    return steps.reconstruct_scene(loaded, InspectionSettings())


def sharpened(picture: NDArray, _: np.random.Generator) -> NDArray:
    return np.asarray(1.7 * picture - 0.7 * cv2.GaussianBlur(picture.astype(float), (0, 0), 1.2))


def compressed(picture: NDArray, _: np.random.Generator) -> NDArray:
    coded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 75])[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE))


def beating(picture: NDArray, rng: np.random.Generator) -> NDArray:
    u = np.arange(picture.shape[1])
    return np.asarray(picture * (1 + 0.03 * np.cos(2 * np.pi * u / 11 + rng.uniform(0, 6.28))))


def of_four_bits(picture: NDArray, _: np.random.Generator) -> NDArray:
    return picture // 16 * 16


def reflected(picture: NDArray, _: np.random.Generator) -> NDArray:
    return np.asarray(picture + 0.02 * np.roll(picture.astype(float), (40, 25), (0, 1)))


def rolling(picture: NDArray, rng: np.random.Generator) -> NDArray:
    v = np.arange(picture.shape[0])[:, None]
    return np.asarray(picture * (1 + 0.03 * np.sin(2 * np.pi * v / 260 + rng.uniform(0, 6.28))))


def black_too_low(picture: NDArray, _: np.random.Generator) -> NDArray:
    return picture - 40.0


@pytest.mark.parametrize(
    ("change", "said", "relief", "quantities"),
    [
        (sharpened, "pictures were sharpened", False, ("width",)),
        (compressed, "pictures were smoothed, scaled or compressed", True, ("width",)),
        (beating, "waves or stripes that change from frame to frame", True, ()),
        (black_too_low, "cut off at black", False, ("width",)),
        (reflected, "sees a second, fainter picture of the fringes", True, ()),
        (rolling, "changes from row to row, in each frame another way", True, ()),
        (of_four_bits, "grey levels (of 16 each), expected 12 at least", True, ("width",)),
    ],
)
def test_pictures_that_no_sensor_gave_are_told(
    shared: Path, tmp_path: Path, change: Change, said: str, relief: bool, quantities: tuple[str, ...]
) -> None:
    (doubt,) = scanned(shared, tmp_path, change).doubts
    assert said in doubt.warning
    assert (doubt.relief, doubt.quantities) == (relief, quantities)


def test_a_gamma_of_one_camera_is_told_and_its_ripple_taken_out(shared: Path, tmp_path: Path) -> None:
    def bent(picture: NDArray, _: np.random.Generator) -> NDArray:
        return np.asarray(255 * (picture / 255) ** 0.6)

    sound = scanned(shared, tmp_path / "sound", lambda picture, _: picture)
    odd = scanned(shared, tmp_path / "odd", bent, ("right",))
    (remark,) = odd.remarks
    assert "fringes of different shape" in remark
    both = (sound.flags == 0) & (odd.flags == 0)
    off = (odd.points[..., 2] - sound.points[..., 2])[both]
    assert np.std(off) < np.median(odd.sigma_z[both])


@pytest.mark.parametrize(("change", "most"), [(sharpened, 1.5), (compressed, 1.5), (beating, 3.0)])
def test_points_scatter_as_said_where_pixels_share_their_noise(
    shared: Path, tmp_path: Path, change: Change, most: float
) -> None:
    """Means over 8 × 8 pixels: what they differ by from the sound scan's is near what σ allows independent pixels."""
    sound = scanned(shared, tmp_path / "sound", lambda picture, _: picture)
    odd = scanned(shared, tmp_path / "odd", change)
    off = np.where((sound.flags == 0) & (odd.flags == 0), odd.points[..., 2] - sound.points[..., 2], np.nan)
    height, width = (size // 8 * 8 for size in off.shape)
    means = off[:height, :width].reshape(height // 8, 8, -1, 8).mean((1, 3))
    sigma = float(np.nanmedian(odd.sigma_z)) / 8
    spread = 1.48 * float(np.nanmedian(np.abs(means - np.nanmedian(means))))
    assert spread < most * sigma


def test_doubtful_values_are_not_left_to_be_believed() -> None:
    dent = Defect(
        "D1", x_mm=0.0, y_mm=0.0, z_mm=700.0, u_px=1.0, v_px=1.0, kind="dent", depth_mm=0.1, depth_u95_mm=0.01
    )
    station = SeamStation(
        "M1", 0.0, x_mm=1.0, y_mm=2.0, z_mm=700.0, u_px=10.0, v_px=12.0, step_mm=0.1, step_u95_mm=0.01,
        width_mm=2.4, width_u95_mm=0.05,
    )  # fmt: skip
    features = {DEFECT.name: [dent], SEAM_STATION.name: [station]}
    assert without_doubtful(features, ()) == features
    doubt = FrameDoubt("…", "pictures sharpened", relief=True, quantities=("width",))
    kept = without_doubtful(features, (doubt,))
    assert kept[DEFECT.name][0].decision == "unconfirmed"
    assert kept[DEFECT.name][0].reason == "pictures sharpened"
    (position,) = kept[SEAM_STATION.name]
    assert isinstance(position, SeamStation)
    assert (position.step_mm, position.width_mm, position.width_u95_mm) == (0.1, None, None)
    assert position.decision == "not measured"
    assert position.reason == "width not measured; pictures sharpened"
    here, elsewhere = Place((0.0, 5.0), (0.0, 5.0)), Place((30.0, 40.0), (0.0, 40.0))
    kept = without_doubtful(features, (replace(doubt, places=(elsewhere, here)),))
    assert (kept[DEFECT.name][0].decision, kept[SEAM_STATION.name]) == ("unconfirmed", [station])
    assert without_doubtful(features, (replace(doubt, places=(elsewhere,)),)) == features


@pytest.mark.parametrize("odd", [False, True])
def test_odd_frames_are_scanned_again_before_a_rig_is_calibrated(monkeypatch: pytest.MonkeyPatch, odd: bool) -> None:
    result = small_result()
    doubts = (FrameDoubt("…", "pictures sharpened"),) if odd else ()
    found = RigHealth(0.2, None, 9, None, 0, "warning", f"texture lies off: {rig_health.CALIBRATE}")
    monkeypatch.setattr(rig_health, "epipolar_health", lambda *_: found)
    monkeypatch.setattr(steps, "doubtful", lambda _: False)
    loaded = SimpleNamespace(scene=SimpleNamespace(code=SimpleNamespace(axis="x")))
    reconstruction = replace(result.reconstruction, doubts=doubts)
    health = steps.check_rig(loaded, reconstruction, [], InspectionSettings())  # type: ignore[arg-type]
    assert health.verdict == "warning"
    assert ("scan again first" in (health.reason or "")) == odd
