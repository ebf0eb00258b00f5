"""The steps of an inspection, each a plain function: load, call metrology, save. `flows.inspect_scene` orders them."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from metrology import overlay, reconstruct, registration, rig_health, rivets, seams, tolerance
from metrology.cloud import DecodedView, Reconstruction, main_cause
from metrology.defects.row import Defect
from metrology.errors import RigError, SceneError
from metrology.exposures import check_brightness
from metrology.fastening import Fasteners, detect_fasteners
from metrology.inspection import InspectionResult
from metrology.kinds import DEFECT, KINDS, RIVET, SEAM_STATION
from metrology.one_camera import triangulate_one
from metrology.overlay import Overlay
from metrology.panel import PanelLayout
from metrology.registration import Registration
from metrology.registration.known import with_known_names
from metrology.results import Features, Rivet, RivetDetection, SceneKey, SeamLine, SeamStation, of_type
from metrology.rig import Rig
from metrology.rig_health import RigHealth
from metrology.scanned_cloud import ray_health
from storage.archive import Store
from storage.archive.known_defects import earlier_defects
from storage.archive.signed import refuse_signed_off
from storage.cloud_scene import CloudScene
from storage.frames import FrameStack, file_checksum
from storage.panel_spec import PanelSpecification, load_panel_spec
from storage.rig import load_rig, rig_document
from storage.scan_identity import frames_digest
from storage.scene import Scene
from storage.scene_folder import load_any_scene
from storage.scene_models import MANIFEST, Camera
from tasks.clock import clock_warnings
from tasks.cloud_scan import cloud_of
from tasks.frame_doubts import bent_light, frame_doubts, veiled, widened, without_unevenness
from tasks.loaded import LoadedScene
from tasks.rig_check import doubtful, mixed_up, other_skin, unmatched
from tasks.rig_evidence import evidence_warnings
from tasks.scan_checks import CAUSES, CheckedFrames, check_frames, refuse_wrong_frames
from tasks.settings import InspectionSettings, SceneChecks, VerificationSettings


def load(
    folder: Path, rig_path: Path | None, store: Store, evidence: VerificationSettings | None = None
) -> LoadedScene:
    """Check a scene folder and find its rig: the file that is given, the folder's own, or the one that the store has.

    A scene that is signed off is refused: its result stays. `evidence` says what is asked of the rig's verification.
    """
    scene = load_any_scene(folder)
    refuse_signed_off(store.root, scene.key.scene_id)
    rig = load_rig(rig_path) if rig_path else scene.own_rig() or store.find_rig(scene.rig_id)
    scene.check_fits(rig)
    known = store.known(scene.key)
    warnings = clock_warnings(scene.key, rig, known.first_stored_at if known else None)
    if rig.id != scene.rig_id:
        warnings.append(f"inspected with rig {rig.id!r} though the scene names {scene.rig_id!r}")
    if rig_path and _is_another(rig, store):
        warnings.append(
            f"rig {rig.id!r} was given with other values than the store has for that id; a calibration needs an id of "
            "its own"
        )
    if evidence:
        warnings += evidence_warnings(store, rig, scene.key.captured_at, evidence, scene.folder)
    return LoadedScene(scene, rig, tuple(warnings), known)


def _is_another(rig: Rig, store: Store) -> bool:
    """Whether the store has a rig of this id with other values; a damaged one is no reason to refuse what is given."""
    with contextlib.suppress(RigError):
        return store.has_rig(rig.id) and rig_document(store.find_rig(rig.id)) != rig_document(rig)
    return False


def reconstruct_scene(loaded: LoadedScene, settings: InspectionSettings) -> Reconstruction:
    """The organised cloud: from frames, or another scanner's as it is."""
    scene = loaded.scene
    if isinstance(scene, CloudScene):
        reconstruction = cloud_of(scene, loaded.rig, settings)
        if loaded.known:
            loaded.known.refuse_other(scene.key.scene_id, reconstruction.frames_digest, scene.folder)
    else:
        reconstruction = _from_frames(loaded, scene, settings)
    _check_skin_is_seen(scene, reconstruction, settings.checks)
    return reconstruction


def _from_frames(loaded: LoadedScene, scene: Scene, settings: InspectionSettings) -> Reconstruction:
    """Decode and match, or meet the projector's light; a camera's frames are read while another's are decoded."""
    rig, used = loaded.rig, scene.used(loaded.rig)
    if len(used) == 2:
        reconstruct.check_axis(rig, scene.code.axis)
    size = reconstruct.coordinate_size(rig, scene.code)
    threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    views: list[DecodedView] = []
    checked: list[CheckedFrames] = []
    checksums: dict[Camera, tuple[int, ...]] = {}
    with ThreadPoolExecutor(threads) as readers, ThreadPoolExecutor(1) as reader:
        reading = {camera: reader.submit(_read, scene, camera, readers) for camera in used}
        for camera in used:
            stack = reading.pop(camera).result()
            views.append(reconstruct.decode(stack.frames, scene.code, size, scene.exposures, settings.reconstruction))
            checked.append(check_frames(camera, stack.frames, views[-1], scene, rig))
            checksums[camera] = stack.checksums
            del stack
    refuse_wrong_frames(scene, checked, settings.checks)
    unread = tuple(file_checksum(path, SceneError) for path in scene.right if "right" not in checksums)
    digest = frames_digest(scene.code, scene.exposures, checksums["left"], checksums.get("right", unread))
    if loaded.known:
        loaded.known.refuse_other(scene.key.scene_id, digest, scene.folder)
    doubts = tuple(frame_doubts(views, checked, rig, scene.code, settings.reconstruction.blur_radius_px))
    views = [widened(view, frames.texture) for view, frames in zip(views, checked, strict=True)]
    if len(views) == 1:
        found = triangulate_one(views[0], replace(rig, right=None), scene.code, size, settings.reconstruction)
        return replace(found, frames_digest=digest, doubts=doubts)
    left, right, remarks = without_unevenness(views[0], views[1], checked, scene, size)
    found = reconstruct.triangulate(left, right, rig, settings.reconstruction)
    reconstruction = replace(found, frames_digest=digest, remarks=remarks, doubts=doubts)
    if problem := unmatched(scene, reconstruction, settings.rig_health):
        raise problem
    if len(scene.exposures) == 1:  # fused exposures each have their own contrast
        doubts += veiled(reconstruction)
    return replace(reconstruction, doubts=doubts + bent_light(reconstruction, scene.code.axis))


def _read(scene: Scene, camera: Camera, readers: Executor) -> FrameStack:
    """One camera's frames, as bright as the scene's exposures say."""
    stack = scene.read(camera, readers)
    try:
        check_brightness(stack.frames, scene.code, scene.exposures)
    except SceneError as problem:
        raise SceneError(f"{scene.folder / MANIFEST}: {camera} camera: {problem}") from None
    return stack


def with_same_frames(loaded: LoadedScene, reconstruction: Reconstruction, store: Store) -> LoadedScene:
    """A scene with the names under which its frames are stored already."""
    found = store.scenes_of_frames(reconstruction.frames_digest, loaded.scene.key)
    return replace(loaded, same_frames=found)


def detect_rivets(reconstruction: Reconstruction, settings: InspectionSettings) -> Fasteners:
    """Rivet heads in the left image, and open holes without one."""
    return detect_fasteners(reconstruction, settings.rivets)


def check_rig(
    loaded: LoadedScene,
    reconstruction: Reconstruction,
    detections: list[RivetDetection],
    settings: InspectionSettings,
) -> RigHealth:
    """Judge by the scan itself whether the rig still fits; refuse one that does not, or frames that were mixed up."""
    scene = loaded.scene
    if isinstance(scene, CloudScene):
        health = ray_health(reconstruction)
    elif reconstruction.right is None:
        health = RigHealth(None, None, 0, None, 0, "unjudged", _ONE_CAMERA)
    else:
        health = rig_health.epipolar_health(reconstruction, detections, scene.code.axis, settings.rig_health)
        if doubtful(health) and (problem := mixed_up(scene, reconstruction, settings.rig_health)):
            raise problem
        if health.verdict in ("warning", "unjudged") and (problem := other_skin(scene, reconstruction, detections)):
            raise problem
    if health.reason and (reconstruction.doubts or reconstruction.remarks):
        health = replace(health, reason=health.reason.replace(rig_health.CALIBRATE, _SCAN_AGAIN))
    if health.verdict == "refused":
        raise RigError(
            f"{scene.folder}: found that rig {loaded.rig.id!r} does not fit the scan ({health.reason}), "
            "expected the rig that took it"
        )
    return health


def detect_seams(
    reconstruction: Reconstruction, detections: list[RivetDetection], settings: InspectionSettings
) -> list[SeamLine]:
    """Centre lines of seams in the left image."""
    return seams.detect_seams(reconstruction, detections, settings.seams)


def measure_rivets(
    detections: list[RivetDetection],
    reconstruction: Reconstruction,
    lines: list[SeamLine],
    settings: InspectionSettings,
) -> list[Rivet]:
    """Height and tilt of each rivet."""
    return rivets.measure_rivets(detections, reconstruction, lines, settings.rivets)


def measure_seams(
    lines: list[SeamLine],
    reconstruction: Reconstruction,
    detections: list[RivetDetection],
    settings: InspectionSettings,
) -> list[SeamStation]:
    """Step and width along each seam."""
    return seams.measure_seams(lines, reconstruction, detections, settings.seams)


def specification(given: PanelSpecification | None, panel: str, store: Store) -> PanelSpecification:
    """What a scene is judged by: what was given, else what is in force in the store for its panel, else the example."""
    if given is not None and not given.example:
        return given
    return store.panels.in_force(panel) or given or load_panel_spec()


def register(
    found: Features,
    reconstruction: Reconstruction,
    loaded: LoadedScene,
    spec: PanelSpecification,
    store: Store,
    settings: InspectionSettings,
    doubts: Sequence[str] = (),
) -> Registration:
    """Give rivets and seams the panel's ids; the first scan of a station without a pattern is to become its pattern.

    Nothing is kept here: the pattern goes into the store with the result. A scan with doubts, or in which nothing was
    found, becomes no pattern and says why.
    """
    key = loaded.scene.key
    vouched = _nominal(spec, key)
    pattern = vouched or store.panels.pattern(key.panel, key.station)
    rivets, stations = of_type(found, Rivet), of_type(found, SeamStation)
    others = {name: rows for name, rows in found.items() if name not in (RIVET.name, SEAM_STATION.name)}
    if pattern is None:
        registered = registration.enrol(rivets, stations, reconstruction.points, key.station, doubts)
    else:
        registered = registration.register(
            rivets,
            stations,
            reconstruction,
            pattern,
            key.station,
            settings.registration,
            missing_rows=vouched is not None,
        )
    return _with_known_defects(registration.with_others(registered, others, pattern), key, store)


def _with_known_defects(registered: Registration, key: SceneKey, store: Store) -> Registration:
    """Defects of a recognised scan keep the names that earlier scans of the station gave them."""
    defects = of_type(registered.others, Defect)
    if not defects or registered.placement is None:
        return registered
    named = with_known_names(defects, earlier_defects(store.layout, key))
    return replace(registered, others={**registered.others, DEFECT.name: named})


def _nominal(spec: PanelSpecification, key: SceneKey) -> PanelLayout | None:
    """The pattern that the specification vouches for, if it is of this panel and has one."""
    return spec.layout if spec.limits.panel == key.panel and not spec.layout.empty else None


def doubts(loaded: LoadedScene, reconstruction: Reconstruction, health: RigHealth) -> tuple[str, ...]:
    """Why a scan may not become its station's pattern."""
    copied = ("its frames are stored under another name",) if loaded.same_frames else ()
    flags = {name: view.flags for name, (_, view) in reconstruction.cameras.items()}
    # Of one camera nothing ever tells whether its rig fits, so that a doubt of every scan is none of this one.
    found = registration.enrolment_doubts(flags, health.verdict if reconstruction.right else None)
    return (*copied, *(doubt.clause for doubt in reconstruction.doubts), *found)


def judge(features: Features, spec: PanelSpecification) -> Features:
    """Verdicts by the panel's limits."""
    return {kind.name: tuple(tolerance.judge(kind, features.get(kind.name, ()), spec.limits)) for kind in KINDS}


def draw_overlay(
    judged: Features, loaded: LoadedScene, reconstruction: Reconstruction, settings: InspectionSettings
) -> Overlay:
    """The image to project."""
    return overlay.draw_overlay(judged, reconstruction, overlay.scan_title(loaded.scene.key), settings.overlay)


def publish(store: Store, result: InspectionResult, rig: Rig) -> str:
    """Store the result, and the rig for later scenes that name it; returns the run's id."""
    run_id = store.publish(result)
    store.add_rig(rig)
    return run_id


def _check_skin_is_seen(scene: Scene | CloudScene, reconstruction: Reconstruction, checks: SceneChecks) -> None:
    valid = float(reconstruction.valid.mean())
    if valid >= checks.min_valid_fraction:
        return
    cause, share = main_cause(reconstruction.flags)
    raise SceneError(
        f"{scene.folder}: found points for {valid:.1%} of the pixels ({share:.0%} {CAUSES[cause]}), "
        f"expected at least {checks.min_valid_fraction:.0%}: a lit skin in the field of both cameras"
    )


_SCAN_AGAIN = "scan again first, as these frames are odd, and calibrate the rig again only where that stays so"
_ONE_CAMERA = "cannot tell whether the rig still fits: with one camera nothing is seen twice; verify it by an artefact"
