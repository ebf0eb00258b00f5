"""Scene folders of every kind: fringe frames (`flushline-scene/1`) or another scanner's cloud."""

from __future__ import annotations

from pathlib import Path

from metrology.errors import SceneError
from storage import cloud_scene, scene
from storage.cloud_scene import CloudScene, CloudSceneModel
from storage.models import validate
from storage.scene import Scene, read_manifest
from storage.scene_models import MANIFEST, SceneModel

SceneDocument = SceneModel | CloudSceneModel


def load_any_manifest(manifest: Path) -> SceneDocument:
    """scene.json, validated; the files that it names are not looked at."""
    document = read_manifest(manifest)
    if document.get("format") == cloud_scene.FORMAT:
        return validate(CloudSceneModel, document, manifest, SceneError)
    return scene.model_of(document, manifest)


def load_any_scene(folder: Path) -> Scene | CloudScene:
    """Read a scene's manifest and look at every file's header; nothing is decoded yet."""
    folder = Path(folder)
    model = load_any_manifest(folder / MANIFEST)
    return cloud_scene.look_at(folder, model) if isinstance(model, CloudSceneModel) else scene.look_at(folder, model)
