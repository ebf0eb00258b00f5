"""The report of one scene."""

from __future__ import annotations

from markupsafe import Markup

from metrology.kinds import DEFECT, KINDS, Kind
from storage.report.defect_form import defect_forms
from storage.report.drawings import marked_picture
from storage.report.letterhead import Letterhead
from storage.report.markup import figure, moment, page, png_figure
from storage.report.record import SceneRecord
from storage.report.sections import decisions_table, features, limits_table, many, traceability, verdict
from storage.report.verdicts import key
from storage.wording import _, capital, reason


def scene_page(record: SceneRecord, letterhead: Letterhead | None = None) -> str:
    """One HTML page with pictures, tables, verdicts and what they rest on; it needs nothing else."""
    scene = record.scene
    name = f"{scene['aircraft_serial']} {scene['panel']} {scene['station']}"
    return page(
        "scene.html",
        _("Inspection of {name}", name=name),
        letterhead=letterhead,
        name=name,
        captured=moment(scene["captured_at"]),
        verdict=verdict(record.features),
        warnings=[reason(text) for text in scene["warnings"] or ()],
        picture=figure(
            marked_picture(record.preview, record.of_kind), _("Left camera. Rims and symbols: {key}.", key=key())
        ),
        overlay=png_figure(record.overlay_shown, _("overlay"), _("The overlay, as the projector shows it.")),
        features=[
            (capital(many(kind)), [*features(kind, rows, record.limits), *_close_ups(kind, record)])
            for kind in KINDS
            if (rows := record.of_kind[kind.name])
        ],
        decisions=decisions_table(record),
        limits=limits_table(record.limits),
        traceability=traceability(record),
    )


def _close_ups(kind: Kind, record: SceneRecord) -> list[Markup]:
    """Of defects, whose form a table does not tell."""
    return defect_forms(record.of_kind[kind.name], record.fits) if kind is DEFECT else []
