"""Verifications of rigs, kept for good: one file per verification, and beside it its report.

    verifications/RIG/20261128T101500Z-1.json     flushline-verification/1
    verifications/RIG/20261128T101500Z-1.html     the report

Files are written once and protected; a verification is never changed nor taken back, a later one counts in its place.
Each names the checksums of its report and of the verifications before it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from metrology.errors import StoreError
from metrology.results import Decision
from metrology.verdicts import gravity
from storage.archive.files import make_folders, sha256, write_first
from storage.archive.layout import Layout
from storage.certificate import CertificateModel
from storage.documents import read_json, utc_text
from storage.models import Identifier, UtcTime, validate

HELD: tuple[Decision, ...] = ("pass", "conditional pass")
"""Verdicts of a verification that a rig passed."""


class _Kept(BaseModel):
    """A part of a verification; newer versions may say more."""

    model_config = ConfigDict(extra="allow", frozen=True)


class MeasureModel(_Kept):
    """A measure: what was found of the artefact, less what its certificate says where it says something."""

    name: str
    of: str
    """name, of: such as "sphere spacing" of "S1-S2"."""
    unit: str
    value: float | None
    u95: float | None
    """value, u95: the deviation, or the error of form, with its expanded uncertainty; None where it was not measured.
    """
    measured: float | None = None
    certified: float | None = None
    certified_u95: float | None = None
    limit: float | None = None
    """The maximum permissible amount; None where nothing is asked of it."""
    decision: Decision
    """After ISO 14253-1."""
    n: int = 0
    """Values or points that it rests on."""
    note: str = ""


class ArtefactModel(_Kept):
    """The artefact as it was described."""

    id: str
    kind: str
    certificate: CertificateModel | None = None


class ScanModel(_Kept):
    """A scan that a verification rests on."""

    name: str
    captured_at: UtcTime
    frames_digest: str | None = None
    operator: str | None = None


class Mark(_Kept):
    """A verification as it was kept: its name in the store and the SHA-256 of its file."""

    name: str
    sha256: str


class VerificationModel(_Kept):
    """A verification: rig, artefact, scans, measures and the verdict.

    `earlier` and `report_sha256` are filled in when it is kept; one kept by an earlier version has neither.
    """

    format: Literal["flushline-verification/1"] = "flushline-verification/1"
    rig_id: Identifier
    rig_hash: str
    verified_at: UtcTime
    processed_at: UtcTime
    due_at: UtcTime | None = None
    operator: str | None = None
    software_version: str
    config_hash: str
    artefact: ArtefactModel
    scans: tuple[ScanModel, ...]
    measures: tuple[MeasureModel, ...]
    warnings: tuple[str, ...] = ()
    earlier: tuple[Mark, ...] = ()
    report_sha256: str | None = None
    document: Annotated[dict[str, Any], Field(default_factory=dict)]

    @property
    def verdict(self) -> Decision:
        """The gravest decision of what a limit was stated for; "no limit" where none was."""
        return min((measure.decision for measure in self.measures), key=gravity, default="no limit")

    @property
    def held(self) -> bool:
        """Whether the rig passed."""
        return self.verdict in HELD

    @property
    def reason(self) -> str:
        """The gravest measure in words; "" where the rig passed."""
        if self.held or not self.measures:
            return ""
        worst = min(self.measures, key=lambda measure: gravity(measure.decision))
        if worst.value is None or worst.limit is None:
            return f"{worst.name} of {worst.of}: {worst.note or worst.decision}"
        return (
            f"{worst.name} of {worst.of}: {worst.value:+.4f} ± {worst.u95 or 0:.4f} {worst.unit}, "
            f"permitted {worst.limit:.4f}"
        )


@dataclass(frozen=True)
class Verification:
    """A verification and its name in the store, such as ``rig-a/20261128T101500Z-1``."""

    name: str
    model: VerificationModel


class Verifications:
    """The verifications of a store."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout

    def keep(self, model: VerificationModel, report: str) -> Path:
        """Keep a verification with its report (HTML); returns its file."""
        folder = self._layout.verifications / model.rig_id
        model = model.model_copy(
            update={
                "earlier": tuple(map(self._mark, self._files(folder))),
                "report_sha256": hashlib.sha256(report.encode()).hexdigest(),
            }
        )
        content = json.dumps(model.model_dump(mode="json"), indent=1, ensure_ascii=False, default=utc_text).encode()
        make_folders(folder, self._layout.root)
        for number in count(1):
            path = folder / f"{model.verified_at:%Y%m%dT%H%M%SZ}-{number}.json"
            # The report comes first, so that a verification has one; its name is taken with it.
            if write_first(path.with_suffix(".html"), report.encode()) and write_first(path, content):
                break
        return path

    def of_rig(self, rig_id: str) -> tuple[Verification, ...]:
        """Of one rig, the earliest first."""
        return tuple(map(self.read, self._files(self._layout.verifications / rig_id)))

    def all(self) -> tuple[Verification, ...]:
        """Of every rig, rig by rig, the earliest first."""
        return tuple(map(self.read, self.files()))

    def last(self, rig_id: str) -> Mark | None:
        """The last one of a rig, by its name, as it lies in the store."""
        files = self._files(self._layout.verifications / rig_id)
        return self._mark(files[-1]) if files else None

    def files(self) -> list[Path]:
        """Of every rig, rig by rig, the earliest first."""
        return sorted(self._layout.verifications.glob("[!.]*/[!.]*.json"))

    def path(self, name: str) -> Path:
        """The file of a verification, by its name."""
        return self._layout.verifications / f"{name}.json"

    def _files(self, folder: Path) -> list[Path]:
        return sorted(folder.glob("[!.]*.json"))

    def _mark(self, path: Path) -> Mark:
        return Mark(name=f"{path.parent.name}/{path.stem}", sha256=sha256(path))

    def read(self, path: Path) -> Verification:
        """The verification that a file holds."""
        model = validate(VerificationModel, read_json(path, StoreError), path, StoreError)
        return Verification(f"{path.parent.name}/{path.stem}", model)


@dataclass(frozen=True)
class Verified:
    """How a rig stood at a moment."""

    last: Verification | None
    """The newest one of this calibration that was made before."""
    later: Verification | None = None
    """The first one after it."""
    other_calibration: bool = False
    """Whether the rig was verified before, but with another calibration of the same id."""

    def problem(self, moment: datetime) -> str | None:
        """Why a measurement at that moment rests on no verification that was passed and held; None where it does."""
        if self.last is None:
            if self.other_calibration:
                return "verified with another calibration of the same id only"
            return "not verified before" if self.later else "never verified"
        if not self.last.model.held:
            return f"failed its last verification ({self.last.name}: {self.last.model.reason})"
        due = self.last.model.due_at
        if due and moment > due:
            return f"overdue: its last verification held until {due:%Y-%m-%d} ({self.last.name})"
        if self.later and not self.later.model.held:
            return f"failed the verification that followed ({self.later.name}: {self.later.model.reason})"
        return None


def verified(verifications: Sequence[Verification], rig_hash: str, moment: datetime) -> Verified:
    """How a rig stood at a moment, from its verifications."""
    own = [v for v in verifications if v.model.rig_hash == rig_hash]
    before = [v for v in own if v.model.verified_at <= moment]
    after = [v for v in own if v.model.verified_at > moment]
    last = max(before, key=lambda v: (v.model.verified_at, v.model.processed_at), default=None)
    later = min(after, key=lambda v: (v.model.verified_at, v.model.processed_at), default=None)
    return Verified(last, later, not own and bool(verifications))
