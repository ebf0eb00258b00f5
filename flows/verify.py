"""Verification of a rig by an artefact: scans in, a verdict and a report in the store."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from pathlib import Path

from metrology.errors import SceneError, SpecError
from storage.archive import Store
from storage.archive.bundle import document_hash
from storage.documents import utc_text
from storage.evidence.artefact import Artefact, load_artefact
from storage.evidence.verifications import ArtefactModel, MeasureModel, ScanModel, VerificationModel
from storage.report.verification_page import verification_page
from storage.rig import load_rig, rig_document
from tasks.settings import InspectionSettings
from tasks.verification import look, look_at_board, measures

POSITIONS = {"plane": 6, "spheres": 7}
"""In how many positions VDI/VDE 2634 part 2 asks an artefact to be measured."""
_COARSE = 0.2  # of a limit: a certificate that is less sure leaves little of it


@dataclass(frozen=True)
class Conditions:
    """What a laboratory writes down beside the scans; "" or None where it is not stated."""

    operator: str = ""
    place: str = ""
    temperature_c: float | None = None


@dataclass(frozen=True)
class Request:
    """A verification to be made."""

    scans: Sequence[Path]
    """Scene folders, each of another position of the artefact; of a board a calibration capture."""
    artefact: Path
    rig: Path
    store: Store
    settings: InspectionSettings
    conditions: Conditions


def verify(
    request: Request, on_scan: Callable[[int, str], None] = lambda _done, _what: None
) -> tuple[VerificationModel, Path]:
    """Measure, judge and keep; returns the verification and its file.

    Parameters
    ----------
    on_scan : callable
        Told how many scans are done, and which comes next.
    """
    request.store.check_usable()
    artefact, rig = load_artefact(request.artefact), load_rig(request.rig)
    now = datetime.now(UTC).replace(microsecond=0)
    scans: list[ScanModel] = []
    found: list[MeasureModel] = []
    warnings: list[str] = []
    if artefact.file.kind == "board":
        for done, folder in enumerate(request.scans):
            on_scan(done, folder.name)
            board = look_at_board(folder, artefact, rig, now)
            scans.append(board.scan)
            found += board.measures
    else:
        looks = []
        for done, folder in enumerate(request.scans):
            on_scan(done, folder.name)
            looks.append(look(folder, artefact, request.rig, request.store, request.settings))
        scans = [one.scan for one in looks]
        found = list(measures(artefact, looks))
        warnings = [text for one in looks for text in one.warnings]
    _refuse_expired(request.artefact, artefact, scans)
    _refuse_repeated(scans)
    document = rig_document(rig)
    at = max(scan.captured_at for scan in scans)
    days = artefact.file.valid_days
    operators = [scan.operator for scan in scans if scan.operator]
    model = VerificationModel(
        rig_id=rig.id,
        rig_hash=document_hash(document),
        verified_at=at,
        processed_at=now,
        due_at=at + timedelta(days=days) if days else None,
        operator=request.conditions.operator or ", ".join(dict.fromkeys(operators)) or None,
        software_version=version("flushline"),
        config_hash=document_hash(request.settings.document),
        artefact=ArtefactModel(id=artefact.file.id, kind=artefact.file.kind, certificate=artefact.file.certificate),
        scans=tuple(scans),
        measures=tuple(found),
        warnings=(*_doubts(artefact, scans, found), *dict.fromkeys(warnings)),
        document={
            "artefact": dict(artefact.document),
            "place": request.conditions.place,
            "temperature_c": request.conditions.temperature_c,
        },
    )
    path = request.store.keep_verification(model, verification_page(model, document))
    request.store.add_rig(rig)
    return model, path


def _refuse_expired(path: Path, artefact: Artefact, scans: Sequence[ScanModel]) -> None:
    certificate = artefact.file.certificate
    late = [scan for scan in scans if certificate and certificate.overdue(scan.captured_at)]
    if certificate and late:
        raise SpecError(
            f"{path}: found certificate {certificate}, expected one that held when {late[0].name} was taken "
            f"({utc_text(late[0].captured_at)}); have the artefact calibrated again"
        )


def _refuse_repeated(scans: Sequence[ScanModel]) -> None:
    digests = [scan.frames_digest for scan in scans if scan.frames_digest]
    if len(set(digests)) < len(digests):
        raise SceneError("verify: found the same scan twice, expected each position of the artefact once")


def _doubts(artefact: Artefact, scans: Sequence[ScanModel], found: Sequence[MeasureModel]) -> list[str]:
    """What a reader of the report should know."""
    said = []
    if artefact.file.certificate is None:
        said.append("the artefact has no certificate: the result is not traceable")
    wanted = POSITIONS.get(artefact.file.kind, 0)
    if len(scans) < wanted:
        said.append(f"{len(scans)} positions of the artefact; VDI/VDE 2634 part 2 asks for {wanted}")
    coarse = {m.name for m in found if m.limit and m.certified_u95 and m.certified_u95 > _COARSE * m.limit}
    if coarse:
        said.append(f"the certificate's uncertainty is more than a fifth of the limit of: {', '.join(sorted(coarse))}")
    if all(measure.limit is None for measure in found):
        said.append("no limit was stated, so nothing was judged")
    return said
