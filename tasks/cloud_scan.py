"""The organised cloud of a cloud scene: read, with σ where nobody gave one, and flagged."""

from __future__ import annotations

from dataclasses import replace

from metrology.cloud import Reconstruction
from metrology.errors import SceneError
from metrology.rig import Rig
from metrology.saturation import saturation_level
from metrology.scanned_cloud import scanned
from storage.cloud_scene import CloudScene
from tasks.settings import InspectionSettings


def cloud_of(scene: CloudScene, rig: Rig, settings: InspectionSettings) -> Reconstruction:
    """What the steps after reconstruction take."""
    picture = scene.picture()
    saturation = settings.reconstruction.saturation or saturation_level(picture[None, None])
    try:
        return scanned(
            scene.points(),
            picture.astype("float32"),
            scene.sigma(),
            saturation,
            replace(rig, right=None),  # its pictures are not there
            settings.reconstruction,
            scene.model.digest(scene.folder),
        )
    except SceneError as problem:
        if str(problem).startswith(str(scene.folder)):
            raise
        raise SceneError(f"{scene.folder}: {problem}") from None
