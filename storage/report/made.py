"""Reports ready to be given away: HTML or PDF with letterhead, and a proof of what they say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from metrology.errors import StoreError, UsageError
from metrology.results import PanelKey
from storage.archive import Store
from storage.archive.schema import OF_KIND, PANEL_OF_KIND, Table
from storage.report.assembled import assembled_record, is_assembled
from storage.report.assembled_page import assembled_page
from storage.report.letterhead import letterhead
from storage.report.panel_page import panel_page
from storage.report.pdf import pdf
from storage.report.proof import Proof, content_of, proof_of, sealed
from storage.report.record import panel_record, scene_record
from storage.report.scene_page import scene_page
from storage.wording import Wording, written_in

OfKind = Mapping[str, Sequence[Mapping[str, Any]]]


@dataclass(frozen=True)
class Report:
    """A report."""

    html: str
    proof: Proof
    of_kinds: Sequence[OfKind]
    """The rows that it shows, by the names of the kinds; for each scan where it is of several."""
    tables: Mapping[str, Table]
    """Whose rows these are."""

    def file(self, suffix: str) -> bytes:
        """What is written to a file of this suffix: .pdf, else HTML."""
        return sealed(pdf(self.html) if suffix.lower() == ".pdf" else self.html.encode(), self.proof)


def scene_report(store: Store, scene_id: str, wording: Wording | None = None) -> Report:
    """The report of a scan, in English or with other words."""
    with written_in(wording):  # the chain says what the scan rests on
        record = scene_record(store, scene_id)
        proof = Proof(("scene", scene_id), content_of(record))
        page = scene_page(record, letterhead(store.root, proof.content))
    return Report(page, proof, [record.of_kind], OF_KIND)


def panel_report(store: Store, key: PanelKey, stations: bool = False, wording: Wording | None = None) -> Report:
    """The report of a panel: as it was put together, else or with `stations` that of its newest scans."""
    about = (key.aircraft_serial, key.panel)
    if is_assembled(store, key) and not stations:
        assembled = assembled_record(store, key)
        proof = Proof(("panel", *about), content_of(assembled))
        with written_in(wording):
            page = assembled_page(assembled, letterhead(store.root, proof.content))
        return Report(page, proof, [assembled.of_kind], PANEL_OF_KIND)
    with written_in(wording):
        record = panel_record(store, *about)
        proof = Proof(("stations", *about), content_of(record))
        page = panel_page(record, letterhead(store.root, proof.content))
    return Report(page, proof, [scene.of_kind for scene in record.scenes], OF_KIND)


def verify(path: Path, store: Store | None = None) -> str:
    """What a report's file proves, in one line; refused where it was changed, or says other than the store.

    Parameters
    ----------
    store : Store, optional
        Whose content it is held against.
    """
    try:
        report = path.read_bytes()
    except OSError as problem:
        raise UsageError(f'{path}: found "{problem.strerror}", expected a report') from None
    proof = proof_of(str(path), report)
    said = f"{path}: as it was written; {' '.join(proof.subject)}, content {proof.content}"
    if store is None:
        return said
    kind, *about = proof.subject
    now = (
        scene_report(store, about[0])
        if kind == "scene"
        else panel_report(store, PanelKey(*about), stations=kind == "stations")
    ).proof
    if now != proof:
        raise StoreError(
            f"{path}: found a report of content {proof.content[:12]}…, expected {now.content[:12]}… as {store.root} "
            "has it; it was inspected, judged or decided about since, or by another version, or the report was made up"
        )
    return f"{said}; the store says the same"
