"""What a calibration laboratory certifies of a board or an artefact: number, laboratory, dates."""

from __future__ import annotations

from datetime import datetime

from pydantic import model_validator

from storage.models import Line, StrictModel, UtcTime


class CertificateModel(StrictModel):
    """A calibration certificate."""

    number: Line
    laboratory: Line | None = None
    """Who calibrated, with the accreditation where there is one."""
    calibrated_at: UtcTime | None = None
    due_at: UtcTime | None = None
    """calibrated_at, due_at: when it was calibrated, and until when that holds."""

    @model_validator(mode="after")
    def _due_later(self) -> CertificateModel:
        if self.calibrated_at and self.due_at and self.due_at <= self.calibrated_at:
            raise ValueError(f"due_at: found {self.due_at:%Y-%m-%d}, expected a day after calibrated_at")
        return self

    def overdue(self, moment: datetime) -> bool:
        """Whether the certificate did not hold any more at a moment."""
        return self.due_at is not None and moment > self.due_at

    def __str__(self) -> str:
        laboratory = f" of {self.laboratory}" if self.laboratory else ""
        due = f", due {self.due_at:%Y-%m-%d}" if self.due_at else ", without a due date"
        return f"{self.number}{laboratory}{due}"
