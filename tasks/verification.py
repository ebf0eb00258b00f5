"""The steps of a verification: look at a scan of an artefact, and say what was measured beside what is certified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from metrology import registration
from metrology.calibration.detect_board import detect_board
from metrology.calibration.frames import BoardFrames
from metrology.cloud import Reconstruction
from metrology.errors import CalibrationError, RigError
from metrology.flatness import flatness
from metrology.limits import Limit
from metrology.results import Decision, Rivet, SeamStation
from metrology.rig import Rig
from metrology.verification.board_lengths import board_lengths
from metrology.verification.deviations import Deviation, Trend, common_bias, growth
from metrology.verification.form import form, inflation
from metrology.verification.places import along
from metrology.verification.spheres import SphereFit, distance_u95, find_spheres, fit_sphere, identify
from storage.archive import Store
from storage.calibration import load_capture
from storage.evidence.artefact import Artefact, CertifiedSeamModel
from storage.evidence.verifications import MeasureModel, ScanModel
from tasks import steps
from tasks.settings import InspectionSettings

_MOST_POINTS = 60_000
_OFF_PLANE_MM = 1.0  # what is farther off belongs to something else than the plate
_RIM_PX = 5


@dataclass(frozen=True)
class Look:
    """A scan of an artefact."""

    scan: ScanModel
    reconstruction: Reconstruction | None
    """None where the rig does not fit the scan."""
    rivets: tuple[Rivet, ...] = ()
    stations: tuple[SeamStation, ...] = ()
    """rivets, stations: by the artefact's names."""
    failure: str = ""
    """Why the rig does not fit."""
    warnings: tuple[str, ...] = ()


def look(folder: Path, artefact: Artefact, rig: Path, store: Store, settings: InspectionSettings) -> Look:
    """Reconstruct a scan, and measure the artefact's heads and seams in it; nothing is stored."""
    loaded = steps.load(folder, rig, store)
    scene = loaded.scene
    scan = ScanModel(name=folder.name, captured_at=scene.key.captured_at, operator=scene.operator)
    try:
        reconstruction = steps.reconstruct_scene(loaded, settings)
        scan = scan.model_copy(update={"frames_digest": reconstruction.frames_digest})
        plate = bool(artefact.file.rivets or artefact.file.seams)
        found = steps.detect_rivets(reconstruction, settings).rivets if plate else []
        health = steps.check_rig(loaded, reconstruction, found, settings)
    except RigError as problem:
        return Look(scan, None, failure=str(problem), warnings=loaded.warnings)
    warnings = (*loaded.warnings, *((health.reason,) if health.verdict != "ok" and health.reason else ()))
    if not plate:
        return Look(scan, reconstruction, warnings=warnings)
    lines = steps.detect_seams(reconstruction, found, settings)
    rivets = steps.measure_rivets(found, reconstruction, lines, settings)
    stations = steps.measure_seams(lines, reconstruction, found, settings)
    named = registration.register(
        rivets, stations, reconstruction, artefact.layout, scene.key.station, settings.registration
    )
    if named.status != "recognised" or named.ambiguous:
        warnings += (f"{folder.name}: {'; '.join(named.warnings) or named.status}",)
        return Look(scan, reconstruction, warnings=warnings)
    return Look(scan, reconstruction, named.rivets, named.stations, warnings=warnings)


def measures(artefact: Artefact, looks: Sequence[Look]) -> tuple[MeasureModel, ...]:
    """Every measure of an artefact, from all its scans."""
    seen = [one for one in looks if one.reconstruction is not None]
    found = [_unfit(one) for one in looks if one.failure]
    of_kind = {"plane": _plane, "spheres": _spheres, "rivet-plate": _rivets}.get(artefact.file.kind, _seams)
    return (*found, *of_kind(artefact, seen)) if seen else tuple(found)


def _unfit(one: Look) -> MeasureModel:
    return MeasureModel(
        name="fit of the rig", of=one.scan.name, unit="", value=None, u95=None, decision="fail", note=one.failure
    )


def measure(
    name: str, of: str, value: float, u95: float, limit: float | None, *, form_error: bool = False, **more: Any
) -> MeasureModel:
    """A measure judged by its limit (ISO 14253-1)."""
    decision: Decision = "no limit"
    if limit is not None:
        decision = Limit(lower=None if form_error else -limit, upper=limit).decision(value, u95)
    return MeasureModel(
        name=name, of=of, unit=more.pop("unit", "mm"), value=value, u95=u95, limit=limit, decision=decision, **more
    )


def _lacking(name: str, of: str, note: str) -> MeasureModel:
    return MeasureModel(name=name, of=of, unit="mm", value=None, u95=None, decision="not measured", note=note)


def _plane(artefact: Artefact, looks: Sequence[Look]) -> list[MeasureModel]:
    found = []
    certified, limit = artefact.file.plane, artefact.file.limits.flatness_mm
    assert certified is not None
    for one in looks:
        points, sigma = _of(one)
        stride = max(1, int(np.ceil(np.sqrt(np.isfinite(sigma).sum() / _MOST_POINTS))))
        rough = flatness(*_some(points, sigma, stride), np.random.default_rng(0))
        if rough is None:
            found.append(_lacking("flatness", one.scan.name, "too few points"))
            continue
        image = np.full(sigma[::stride, ::stride].shape, np.nan)
        image[np.isfinite(points[::stride, ::stride, 2])] = rough.residuals_mm
        on_it = cv2.erode((np.abs(image) < _OFF_PLANE_MM).astype(np.uint8), np.ones((_RIM_PX, _RIM_PX))) > 0
        image[~on_it] = np.nan
        shell = form(image[on_it], inflation(image))
        u95 = float(np.hypot(shell.form_u95_mm, certified.flatness_u95_mm))
        more = {"measured": shell.form_mm, "certified": certified.flatness_mm, "n": shell.n,
                "certified_u95": certified.flatness_u95_mm}  # fmt: skip
        found.append(measure("flatness", one.scan.name, shell.form_mm, u95, limit, form_error=True, **more))
        found.append(measure("flatness, 95 % of the points", one.scan.name, shell.form95_mm, u95, None, n=shell.n))
    return found


def _of(one: Look) -> tuple[np.ndarray, np.ndarray]:
    assert one.reconstruction is not None
    return one.reconstruction.points.astype(float), one.reconstruction.sigma_z.astype(float)


def _some(points: np.ndarray, sigma: np.ndarray, stride: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and σ of every so many pixels, without those that have none."""
    p, s = points[::stride, ::stride], sigma[::stride, ::stride]
    known = np.isfinite(p[..., 2])
    return p[known], s[known]


def _spheres(artefact: Artefact, looks: Sequence[Look]) -> list[MeasureModel]:
    found: list[MeasureModel] = []
    for one in looks:
        fits = _fitted(artefact, one)
        if len(fits) < len(artefact.file.spheres):
            said = f"found {len(fits)} of {len(artefact.file.spheres)} spheres"
            found.append(_lacking("probing", one.scan.name, said))
            continue
        found += [m for k, fit in enumerate(fits) for m in _of_sphere(artefact, k, fit, one.scan.name)]
        found += _spacings(artefact, fits, one.scan.name)
    return found


def _fitted(artefact: Artefact, one: Look) -> list[SphereFit]:
    """The spheres in their order in the artefact; fewer where some were not found."""
    spheres = artefact.file.spheres
    points, sigma = _of(one)
    radius = sum(sphere.diameter_mm for sphere in spheres) / len(spheres) / 2
    centres = find_spheres(points, radius, len(spheres))
    fits = [fit for centre in centres if (fit := fit_sphere(points, sigma, centre, radius))]
    if len(fits) < len(spheres) or len(fits) == 1:
        return fits
    names = [sphere.id for sphere in spheres]
    pairs = {(names.index(d.between[0]), names.index(d.between[1])): d.length_mm for d in artefact.file.distances}
    return [fits[k] for k in identify(np.array([fit.centre for fit in fits]), pairs)]


def _of_sphere(artefact: Artefact, k: int, fit: SphereFit, scan: str) -> list[MeasureModel]:
    sphere, limits = artefact.file.spheres[k], artefact.file.limits
    of = f"{sphere.id}, {scan}"
    u95 = float(np.hypot(fit.form.form_u95_mm, sphere.form_u95_mm))
    size = float(np.hypot(fit.diameter_u95_mm, sphere.diameter_u95_mm))
    n = fit.form.n
    return [
        measure("probing form", of, fit.form.form_mm, u95, limits.probing_form_mm, form_error=True, n=n),
        measure("probing form, 95 % of the points", of, fit.form.form95_mm, u95, None, n=n),
        measure("probing size", of, fit.diameter_mm - sphere.diameter_mm, size, limits.probing_size_mm, n=n,
                measured=fit.diameter_mm, certified=sphere.diameter_mm, certified_u95=sphere.diameter_u95_mm),
    ]  # fmt: skip


def _spacings(artefact: Artefact, fits: Sequence[SphereFit], scan: str) -> list[MeasureModel]:
    names = [sphere.id for sphere in artefact.file.spheres]
    found = []
    for d in artefact.file.distances:
        length, u95 = distance_u95(*(fits[names.index(name)] for name in d.between))
        both = float(np.hypot(u95, d.u95_mm))
        more: dict[str, Any] = {"measured": length, "certified": d.length_mm, "certified_u95": d.u95_mm}
        of = f"{'-'.join(d.between)}, {scan}"
        found.append(
            measure("sphere spacing", of, length - d.length_mm, both, artefact.file.limits.sphere_spacing_mm, **more)
        )
    return found


def _rivets(artefact: Artefact, looks: Sequence[Look]) -> list[MeasureModel]:
    deviations: list[Deviation] = []
    why: dict[str, str] = {}
    certified = {known.id: known for known in artefact.file.rivets if known.height_mm is not None}
    for one in looks:
        rows = {row.rivet_id: row for row in one.rivets}
        for name, known in certified.items():
            assert known.height_mm is not None
            row = rows.get(name)
            if row is None or row.height_mean_mm is None or row.height_u95_mm is None:
                why.setdefault(name, (row.reason if row else None) or "not found")
                continue
            deviations.append(
                Deviation(f"{name}, {one.scan.name}", name, row.height_mean_mm, row.height_u95_mm,
                          known.height_mm, known.height_u95_mm)
            )  # fmt: skip
    return compared(artefact, "height", deviations, {name: why.get(name, "") for name in certified})


def _seams(artefact: Artefact, looks: Sequence[Look]) -> list[MeasureModel]:
    found = []
    for quantity, column in (("step", "step_into_wind_mm"), ("width", "width_mm")):
        asked = [seam for seam in artefact.file.seams if getattr(seam, f"{quantity}_mm") is not None]
        deviations = [d for one in looks for seam in asked for d in _along(one, seam, quantity, column, artefact)]
        if asked:
            found += compared(artefact, quantity, deviations, {seam.id: "" for seam in asked})
    return found


def _along(one: Look, seam: CertifiedSeamModel, quantity: str, column: str, artefact: Artefact) -> list[Deviation]:
    """Deviations at places along a seam."""
    rows = [row for row in one.stations if row.seam_id == seam.id]
    places = along(rows, artefact.file.positions, column, f"{quantity}_u95_mm")
    certified, u95 = getattr(seam, f"{quantity}_mm"), getattr(seam, f"{quantity}_u95_mm")
    return [
        Deviation(f"{seam.id} at {s:.0f} mm, {one.scan.name}", seam.id, value, spread, certified, u95)
        for s, value, spread in places
    ]


def compared(
    artefact: Artefact, quantity: str, deviations: list[Deviation], asked: dict[str, str]
) -> list[MeasureModel]:
    """Measures of deviations from certified values: of each one, their mean, and their slope over the value.

    Parameters
    ----------
    asked : dict
        Features that the certificate names, each with why it was not measured.
    """
    limits = artefact.file.limits
    seen = {one.feature for one in deviations}
    found = [
        measure(quantity, one.of, one.value, one.u95, getattr(limits, f"{quantity}_mm"), measured=one.measured,
                certified=one.certified, certified_u95=one.certified_u95)
        for one in deviations
    ]  # fmt: skip
    found += [
        _lacking(quantity, name, why or "not measured in any scan") for name, why in asked.items() if name not in seen
    ]
    trends: list[tuple[str, str, Trend]] = []
    if len(seen) >= 3:
        trends.append((f"{quantity} bias", "mm", common_bias(deviations)))
        if len({one.certified for one in deviations}) >= 3:
            trends.append((f"{quantity} growth", "mm/mm", growth(deviations)))
    for name, unit, trend in trends:
        limit = getattr(limits, f"{name.replace(' ', '_')}{'_mm' if unit == 'mm' else ''}")
        found.append(measure(name, f"{trend.n} features", trend.value, trend.u95, limit, unit=unit, n=trend.n))
    for name in ("bias", "growth"):
        key = f"{quantity}_{name}{'_mm' if name == 'bias' else ''}"
        if getattr(limits, key) is not None and f"{quantity} {name}" not in {t[0] for t in trends}:
            found.append(_lacking(f"{quantity} {name}", "all features", "too few features of different values"))
    return found


@dataclass(frozen=True)
class BoardScan:
    """Measures of a board's capture, and the capture as a scan."""

    scan: ScanModel
    measures: tuple[MeasureModel, ...] = field(default=())


def look_at_board(folder: Path, artefact: Artefact, rig: Rig, now: datetime) -> BoardScan:
    """Compare lengths on a board, pose by pose of a calibration capture, with the board's."""
    capture = load_capture(folder)
    described = artefact.file.board
    assert described is not None
    wanted = described.model_dump(exclude={"certificate"})
    if capture.model.board.model_dump(exclude={"certificate"}) != wanted:
        raise CalibrationError(
            f"{folder}: found another board than the artefact's, expected {capture.board} of its sizes"
        )
    limit, certified = artefact.file.limits.length_mm, artefact.file.length_u95_mm
    found = []
    for pose in range(len(capture)):
        of = f"{folder.name} pose {pose}"
        try:
            views = [
                detect_board(BoardFrames(images.white, images.dark, None, None), capture.board)
                for images in (capture.images(pose, camera) for camera in ("left", "right"))
            ]
            seen = board_lengths(rig, capture.board, *views)
        except CalibrationError as problem:
            found.append(_lacking("length", of, str(problem)))
            continue
        for name, measured, u95, nominal in seen.lengths:
            both = float(np.hypot(u95, certified))
            more: dict[str, Any] = {"measured": measured, "certified": nominal, "certified_u95": certified, "n": seen.n}
            found.append(measure("length", f"{name}, {of}", measured - nominal, both, limit, **more))
        found.append(measure("epipolar distance", of, seen.epipolar_rms_px, 0.0, None, unit="px", n=seen.n))
    scan = ScanModel(name=folder.name, captured_at=capture.model.captured_at or now)
    return BoardScan(scan, tuple(found))
