"""Rig files (`flushline-rig/1`); keys that Flushline does not know are kept."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from metrology.errors import RigError
from metrology.rig import Device, Rig
from metrology.rig_plausibility import check_rig
from storage.archive.files import replacing
from storage.documents import check_format, read_json, utc_text
from storage.lens_names import check_lens_names
from storage.models import Identifier, UtcTime, WholeNumber, validate

FORMAT = "flushline-rig/1"

Number = Annotated[float, Field(ge=-1e9, le=1e9)]  # no product of some overflows
Vector3 = Annotated[tuple[Number, ...], Field(min_length=3, max_length=3)]
Matrix3 = Annotated[tuple[Vector3, ...], Field(min_length=3, max_length=3)]


class _OpenModel(BaseModel):
    """A rig file may say more than Flushline reads."""

    model_config = ConfigDict(extra="allow", frozen=True, allow_inf_nan=False)


class DeviceModel(_OpenModel):
    """A camera or the projector."""

    width: Annotated[WholeNumber, Field(gt=0)]
    height: Annotated[WholeNumber, Field(gt=0)]
    K: Matrix3
    distortion: tuple[Number, ...]
    R: Matrix3
    t: Vector3


class CamerasModel(_OpenModel):
    """`cameras` of a rig file."""

    left: DeviceModel
    right: DeviceModel | None = None


class RigModel(_OpenModel):
    """A rig file."""

    format: Literal["flushline-rig/1"]
    id: Identifier
    calibrated_at: UtcTime
    units: Literal["mm"]
    cameras: CamerasModel
    projector: DeviceModel | None = None


def load_rig(path: Path) -> Rig:
    """Read a rig file to measure with: one that can be a real rig."""
    path = Path(path)
    rig = rig_from_document(read_json(path, RigError), path)
    _check_plausible(rig, path)
    return rig


def rig_from_document(document: Mapping[str, Any], path: Path) -> Rig:
    """The rig that a document describes, real or not, to show what results were measured with.

    `path` names it in errors.
    """
    check_format(document, FORMAT, path, RigError)
    model = validate(RigModel, document, path, RigError)
    said = {"left": model.cameras.left, "right": model.cameras.right, "projector": model.projector}
    try:
        return Rig(
            id=model.id,
            calibrated_at=utc_text(model.calibrated_at),
            extra=_unknown(model),
            **{name: _device(name, device) for name, device in said.items() if device},
        )
    except RigError as problem:
        raise RigError(f"{path}: {problem}") from None


def rig_document(rig: Rig) -> dict[str, Any]:
    """The rig as a file has it, with the extra keys it came with."""
    document: dict[str, Any] = {
        "format": FORMAT,
        "id": rig.id,
        "calibrated_at": rig.calibrated_at,
        "units": "mm",
        "cameras": {name: _device_document(camera) for name, camera in rig.cameras.items()},
    }
    if rig.projector:
        document["projector"] = _device_document(rig.projector)
    return _merged(rig.extra, document)


def save_rig(rig: Rig, path: Path) -> None:
    """Write a rig file; it is whole or not there, also where it replaces another or others write it too."""
    path = Path(path)
    document = rig_document(rig)
    _check_plausible(rig_from_document(document, path), path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as partial:
        partial.write_text(json.dumps(document, indent=1, allow_nan=False), encoding="utf-8")


def _check_plausible(rig: Rig, path: Path) -> None:
    try:
        check_lens_names(rig.extra)
        check_rig(rig)
    except RigError as problem:
        raise RigError(f"{path}: {problem}") from None


def _device(name: str, model: DeviceModel) -> Device:
    try:
        return Device(
            model.width,
            model.height,
            np.array(model.K),
            np.array(model.distortion),
            np.array(model.R),
            np.array(model.t),
        )
    except RigError as problem:
        raise RigError(f"{name}: {problem}") from None


def _device_document(device: Device) -> dict[str, Any]:
    return {
        "width": device.width,
        "height": device.height,
        **{name: getattr(device, name).tolist() for name in ("K", "distortion", "R", "t")},
    }


def _unknown(model: BaseModel) -> dict[str, Any]:
    """What the model does not know, nested as it was in the file."""
    unknown = dict(model.model_extra or {})
    for name in type(model).model_fields:
        value = getattr(model, name)
        if isinstance(value, BaseModel) and (inner := _unknown(value)):
            unknown[name] = inner
    return unknown


def _merged(extra: Mapping[str, Any], document: Mapping[str, Any]) -> dict[str, Any]:
    """`document` with the keys of `extra` that it does not have, at every depth."""
    merged = dict(document)
    for key, value in extra.items():
        if key not in merged:
            merged[key] = value
        elif isinstance(value, Mapping) and isinstance(merged[key], dict):
            merged[key] = _merged(value, merged[key])
    return merged
