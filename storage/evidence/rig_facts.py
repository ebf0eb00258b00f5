"""What a rig file says of its calibration: when, how well, by which board, and until when that holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from pydantic import ValidationError

from metrology.moments import moment_of
from storage.certificate import CertificateModel


@dataclass(frozen=True)
class RigFacts:
    """The calibration behind a rig file; None where the file does not say it."""

    calibrated_at: datetime | None
    due_at: datetime | None
    rms_px: Mapping[str, float]
    """Reprojection residuals by device."""
    board: str | None
    """Kind and sizes."""
    certificate: CertificateModel | None
    """Of the board."""


def rig_facts(document: Mapping[str, Any]) -> RigFacts:
    """From a rig file's content, which may come from another program and say anything under `calibration`."""
    found = document.get("calibration")
    calibration: Mapping[str, Any] = found if isinstance(found, Mapping) else {}
    rms = calibration.get("reprojection_rms_px")
    board = calibration.get("board")
    return RigFacts(
        _moment(document.get("calibrated_at")),
        _moment(calibration.get("due_at")),
        {str(k): v for k, v in rms.items() if isinstance(v, float)} if isinstance(rms, Mapping) else {},
        _board(board) if isinstance(board, Mapping) else None,
        _certificate(board.get("certificate")) if isinstance(board, Mapping) else None,
    )


def _moment(text: object) -> datetime | None:
    try:
        return moment_of(text) if isinstance(text, str) else None
    except ValueError:
        return None


def _board(board: Mapping[str, Any]) -> str:
    size = f"{board.get('type')} {board.get('cols')} × {board.get('rows')}"
    return f"{size}, spacing {board.get('spacing_mm')} mm"


def _certificate(found: object) -> CertificateModel | None:
    try:
        return CertificateModel.model_validate(found) if isinstance(found, Mapping) else None
    except ValidationError:
        return None
