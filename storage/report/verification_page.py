"""The report of a verification: one HTML page that prints, with all that a laboratory writes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from metrology.verdicts import gravity
from storage.evidence.rig_facts import rig_facts
from storage.evidence.verifications import MeasureModel, VerificationModel
from storage.report.markup import badge, code, facts, moment, number, page, table
from storage.wording import N_, _
from storage.wording import reason as worded

METHODS = {
    "plane": N_(
        "Flatness after VDI/VDE 2634 part 2 and ISO 10360-13: range of the points' distances from their "
        "least-squares plane, three in a thousand points left out at most; the range of 95 % of the points beside it."
    ),
    "spheres": N_(
        "Probing error of form and of size, and sphere spacing error after VDI/VDE 2634 parts 2 and 3 and "
        "ISO 10360-13: least-squares sphere of free radius through the points seen at 60° or less; form is the range "
        "of distances from it, three in a thousand points left out at most; size and spacing less the certified values."
    ),
    "rivet-plate": N_(
        "Heights of heads over the plate around them as inspections measure them, less the certified "
        "heights; their mean (bias), and their slope over the certified height (growth)."
    ),
    "step-plate": N_(
        "Steps across seams as inspections measure them, less the certified ones, at places along each seam."
    ),
    "gap-plate": N_("Widths of gaps as inspections measure them, less the certified ones, at places along each seam."),
    "board": N_(
        "Longest rows, columns and diagonals of the board's features, triangulated from both cameras, less their "
        "certified lengths."
    ),
}
MEASURES = (
    N_("flatness"), N_("flatness, 95 % of the points"), N_("probing form"), N_("probing form, 95 % of the points"),
    N_("probing size"), N_("sphere spacing"), N_("height"), N_("step"), N_("width"), N_("height bias"),
    N_("height growth"), N_("step bias"), N_("step growth"), N_("width bias"), N_("width growth"), N_("length"),
    N_("epipolar distance"), N_("fit of the rig"),
)  # fmt: skip
"""What verifications call their measures."""
ARTEFACTS = (
    N_("plane"), N_("spheres"), N_("rivet-plate"), N_("step-plate"), N_("gap-plate"), N_("board")
)  # fmt: skip
"""And their artefacts."""
RULE = N_(
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
        _("Verification of rig {rig}", rig=model.rig_id),
        rig_id=model.rig_id,
        verified=moment(model.verified_at),
        verdict=badge(model.verdict, big=True),
        reason=worded(model.reason),
        warnings=[worded(text) for text in model.warnings],
        identification=facts(_identification(model, rig)),
        method=_(METHODS[model.artefact.kind]) if model.artefact.kind in METHODS else "",
        rule=_(RULE),
        judged=_table(sorted(judged, key=lambda m: gravity(m.decision))) if judged else "",
        others=_table(m for m in model.measures if m not in judged),
        scans=table(
            [_("scan"), _("captured"), _("operator"), _("frames")],
            [[s.name, moment(s.captured_at), s.operator or "–", s.frames_digest or "–"] for s in model.scans],
        ),
    )


def _identification(model: VerificationModel, rig: Mapping[str, Any]) -> list[tuple[str, str]]:
    known = rig_facts(rig)
    certificate, kind = model.artefact.certificate, model.artefact.kind
    calibrated = moment(known.calibrated_at) + (
        f", {_('due {time}', time=moment(known.due_at))}" if known.due_at else ""
    )
    temperature = model.document.get("temperature_c")
    return [
        (_("rig"), _("{rig}, content {checksum}", rig=model.rig_id, checksum=model.rig_hash)),
        (_("calibration of the rig"), calibrated),
        (
            _("board of that calibration"),
            _(
                "{board}; certificate {certificate}",
                board=known.board or "–",
                certificate=known.certificate or _("not stated"),
            ),
        ),
        (_("artefact"), f"{_(kind) if kind in ARTEFACTS else kind} {model.artefact.id}"),
        (_("certificate of the artefact"), str(certificate) if certificate else _("none")),
        (_("scans taken"), moment(model.verified_at)),
        (_("evaluated"), moment(model.processed_at)),
        (_("next verification due"), moment(model.due_at)),
        (_("operator"), model.operator or "–"),
        (_("place"), model.document.get("place") or "–"),
        (_("temperature"), "–" if temperature is None else f"{temperature:g} °C"),
        (_("software"), f"Flushline {model.software_version}"),
        (_("settings"), code(model.config_hash)),
    ]


def _table(measures: Iterable[MeasureModel]) -> str:
    rows = []
    for m in measures:
        digits = 4 if m.unit.startswith("mm") else 3
        rows.append(
            [_(m.name) if m.name in MEASURES else m.name, m.of, m.unit, number(m.measured, digits),
             number(m.certified, digits), number(m.value, digits, sign=m.certified is not None), number(m.u95, digits),
             number(m.limit, digits), badge(m.decision), worded(m.note)]
        )  # fmt: skip
    heads = [
        _("measure"),
        _("of"),
        _("unit"),
        _("measured"),
        _("certified"),
        _("error"),
        "U95",
        _("permitted"),
        _("decision"),
        _("why"),
    ]
    return table(heads, rows, [3, 4, 5, 6, 7])
