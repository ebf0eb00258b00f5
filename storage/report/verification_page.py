"""The report of a verification: one HTML page that prints, with all that a laboratory writes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from metrology.verdicts import gravity
from storage.evidence.rig_facts import rig_facts
from storage.evidence.verifications import MeasureModel, VerificationModel
from storage.report.markup import badge, code, facts, moment, number, page, table

METHODS = {
    "plane": "Flatness after VDI/VDE 2634 part 2 and ISO 10360-13: range of the points' distances from their "
    "least-squares plane, three in a thousand points left out at most; the range of 95 % of the points beside it.",
    "spheres": "Probing error of form and of size, and sphere spacing error after VDI/VDE 2634 parts 2 and 3 and "
    "ISO 10360-13: least-squares sphere of free radius through the points seen at 60° or less; form is the range of "
    "distances from it, three in a thousand points left out at most; size and spacing less the certified values.",
    "rivet-plate": "Heights of heads over the plate around them as inspections measure them, less the certified "
    "heights; their mean (bias), and their slope over the certified height (growth).",
    "step-plate": "Steps across seams as inspections measure them, less the certified ones, at places along each seam.",
    "gap-plate": "Widths of gaps as inspections measure them, less the certified ones, at places along each seam.",
    "board": "Longest rows, columns and diagonals of the board's features, triangulated from both cameras, less their "
    "certified lengths.",
}
RULE = (
    "Uncertainties are expanded (95 %, k = 2) and consist of the points' or features' scatter and of the certificate's "
    "uncertainty. Decision after ISO 14253-1: pass and fail are beyond doubt by U95; a conditional pass lies within "
    "the limit by less than that and counts as held, a conditional fail beyond it by less and does not."
)


def verification_page(model: VerificationModel, rig: Mapping[str, Any]) -> str:
    """One HTML page; it needs nothing else.

    Parameters
    ----------
    rig : mapping
        The rig file's content.
    """
    judged = [m for m in model.measures if m.limit is not None or m.value is None]
    return page(
        "verification.html",
        f"Verification of rig {model.rig_id}",
        rig_id=model.rig_id,
        verified=moment(model.verified_at),
        verdict=badge(model.verdict, big=True),
        reason=model.reason,
        warnings=model.warnings,
        identification=facts(_identification(model, rig)),
        method=METHODS.get(model.artefact.kind, ""),
        rule=RULE,
        judged=_table(sorted(judged, key=lambda m: gravity(m.decision))) if judged else "",
        others=_table(m for m in model.measures if m not in judged),
        scans=table(
            ["scan", "captured", "operator", "frames"],
            [[s.name, moment(s.captured_at), s.operator or "–", s.frames_digest or "–"] for s in model.scans],
        ),
    )


def _identification(model: VerificationModel, rig: Mapping[str, Any]) -> list[tuple[str, str]]:
    known = rig_facts(rig)
    certificate = model.artefact.certificate
    calibrated = moment(known.calibrated_at) + (f", due {moment(known.due_at)}" if known.due_at else "")
    temperature = model.document.get("temperature_c")
    return [
        ("rig", f"{model.rig_id}, content {model.rig_hash}"),
        ("calibration of the rig", calibrated),
        ("board of that calibration", f"{known.board or '–'}; certificate {known.certificate or 'not stated'}"),
        ("artefact", f"{model.artefact.kind} {model.artefact.id}"),
        ("certificate of the artefact", str(certificate) if certificate else "none"),
        ("scans taken", moment(model.verified_at)),
        ("evaluated", moment(model.processed_at)),
        ("next verification due", moment(model.due_at)),
        ("operator", model.operator or "–"),
        ("place", model.document.get("place") or "–"),
        ("temperature", "–" if temperature is None else f"{temperature:g} °C"),
        ("software", f"Flushline {model.software_version}"),
        ("settings", code(model.config_hash)),
    ]


def _table(measures: Iterable[MeasureModel]) -> str:
    rows = []
    for m in measures:
        digits = 4 if m.unit.startswith("mm") else 3
        rows.append(
            [m.name, m.of, m.unit, number(m.measured, digits), number(m.certified, digits),
             number(m.value, digits, sign=m.certified is not None), number(m.u95, digits), number(m.limit, digits),
             badge(m.decision), m.note]
        )  # fmt: skip
    heads = ["measure", "of", "unit", "measured", "certified", "error", "U95", "permitted", "decision", "why"]
    return table(heads, rows, [3, 4, 5, 6, 7])
