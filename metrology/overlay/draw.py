"""The overlay of one scene: its features through the calibrated projector (paper §5.1, Fig. 9)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.errors import UsageError
from metrology.kinds import KINDS
from metrology.overlay.features import Canvas, Wish, mark_course, mark_rings
from metrology.overlay.layout import Layout
from metrology.overlay.legend import draw_legend, entries
from metrology.overlay.marks import COLOURS, GRAVEST_FIRST, Label, Stroke
from metrology.overlay.paint import paint, paint_svg, text_size
from metrology.overlay.skin_map import MeasuredSkin, map_skin, screen
from metrology.overlay.words import BEYOND, NEARER, NO_PROJECTOR, NOT_MEASURED, ORDER, VALUES, Words
from metrology.results import Features, SceneKey
from metrology.verdicts import DECISIONS

_ENGLISH = Words()
_LEGEND_NAMES = 3  # ids of what is not shown, before "+ n"


@dataclass(frozen=True)
class OverlaySettings:
    """How the overlay looks."""

    background: int = 24
    """Grey level of the unmarked field, 0 … 255: dim enough for the marks, bright enough to see the skin."""
    text_height_mm: float = 4.0
    """Height of a capital letter on the skin; 4 mm reads well at 1 m."""
    line_width_px: int = 2
    """Base line width in projector pixels."""
    label_every_mm: float = 50.0
    """Distance between value labels along a seam whose verdict does not change."""

    def __post_init__(self) -> None:
        if not 0 <= self.background <= 255:
            raise UsageError(f"overlay background: found {self.background}, expected 0 … 255")
        if self.text_height_mm <= 0 or self.line_width_px < 1 or self.label_every_mm <= 0:
            raise UsageError("overlay: found a size that is not positive, expected positive sizes")


@dataclass(frozen=True)
class Overlay:
    """A finished overlay.

    Attributes
    ----------
    strokes, labels
        What is drawn, projector pixels.
    """

    size: tuple[int, int]
    """(width, height): the projector's, pixels."""
    background: int
    """Grey level."""
    strokes: tuple[Stroke, ...]
    labels: tuple[Label, ...]
    outside: tuple[str, ...] = field(default=())
    """Ids of the rivets, and of the seams with stations, that the projector's field does not reach."""

    def image(self) -> NDArray[np.uint8]:
        """(h, w, 3) uint8 RGB at the projector's resolution."""
        return paint(self.size, self.background, self.strokes, self.labels)

    def svg(self) -> str:
        """The same as an SVG document."""
        return paint_svg(self.size, self.background, self.strokes, self.labels)


def scan_title(key: SceneKey) -> tuple[str, ...]:
    """Lines that say which scan an overlay is of."""
    return f"{key.aircraft_serial} {key.panel} {key.station}", f"{key.captured_at:%Y-%m-%d %H:%MZ}"


def draw_overlay(
    features: Features,
    reconstruction: MeasuredSkin,
    title: Sequence[str],
    settings: OverlaySettings | None = None,
    names: Mapping[str, str] | None = None,
    words: Words = _ENGLISH,
) -> Overlay:
    """Draw the verdicts of one scene for the projector, or over the left image where the rig has none.

    Parameters
    ----------
    features : mapping
        Judged results by kind; what has no position is left out.
    reconstruction : MeasuredSkin
        Gives the rig, and the skin's place and direction.
    title : sequence of str
        Lines above the legend: station, date.
    names : mapping of str to str, optional
        Write the features' names before their values: these, or else their own (of a course that of its first id
        column).
    words : Words
        Of the language that is written in.
    """
    settings = settings or OverlaySettings()
    projector = screen(reconstruction.rig)
    if reconstruction.rig.screen is None:
        title = [*title, words.text(NO_PROJECTOR)]
    skin = map_skin(reconstruction)
    layout = Layout(projector.width, projector.height, skin)
    text_px = settings.text_height_mm * skin.px_per_mm
    canvas = Canvas(
        reconstruction, layout, skin.px_per_mm, settings.line_width_px, settings.label_every_mm, names, words
    )
    # The place of a missing fastener is drawn once: as the hole that is there.
    replaced = {getattr(row, "fastener_id", None) for rows in features.values() for row in rows}
    for kind in KINDS:
        rows = [row for row in features.get(kind.name, ()) if kind.id_of(row) not in replaced]
        (mark_course if kind.is_course else mark_rings)(kind, rows, canvas)

    present = {row.severity for rows in features.values() for row in rows}
    key = [s for s in reversed(GRAVEST_FIRST) if s is not None or None in present]
    legend = entries(title, key, _notes(features, canvas), words)
    labels, shapes = draw_legend(legend, layout, text_px, skin.angle, settings.line_width_px)
    # Grave ones first: they get the best places. What is in order may go without its value where there is no room.
    for wish in sorted(canvas.wishes, key=lambda w: GRAVEST_FIRST.index(w.severity)):
        size = text_size(wish.text, text_px)
        place = layout.place(wish.anchor, wish.reach, size, must=wish.severity != "green")
        if place is None:
            continue
        labels.append(Label(wish.text, place, text_px, skin.angle, COLOURS[wish.severity], wish.feature))
        canvas.strokes.extend(_leader(wish, place, size, layout))
    return Overlay(
        (projector.width, projector.height),
        settings.background,
        (*canvas.strokes, *shapes),
        tuple(labels),
        tuple(canvas.outside),
    )


def _notes(features: Features, canvas: Canvas) -> list[str]:
    """What the values are, and what the picture does not show."""
    word = canvas.words.text
    shown = [(kind, rows) for kind in KINDS if (rows := features.get(kind.name))]
    notes = [word(VALUES)] if shown else []
    for kind, _ in shown:
        said = [word(quantity.said) for quantity in kind.quantities if quantity.projected]
        order = f" ({word(ORDER)})" if len(said) == 2 else ""
        notes.append(f"{word(kind.subject).upper()}: {' | '.join(said)}{order}")
    for note in dict.fromkeys(DECISIONS[row.decision].note for _, rows in shown for row in rows):
        if note:
            notes.append(f"{note} {word(NEARER)}")
    if any("?" in wish.text for wish in canvas.wishes):
        notes.append(f"? {word(NOT_MEASURED)}")
    if outside := canvas.outside:
        more = len(outside) - _LEGEND_NAMES
        names = ", ".join(outside[:_LEGEND_NAMES]) + (f" + {more}" if more > 0 else "")
        notes.append(f"{word(BEYOND)}: {names}")
    return notes


def _leader(wish: Wish, place: Array, size: tuple[float, float], layout: Layout) -> list[Stroke]:
    """A thin line from a feature to its value where they are apart."""
    half = np.array(size) / 2
    offset = layout.to_upright(place - wish.anchor)
    gap = np.maximum(np.abs(offset) - wish.reach - half, 0)
    if np.hypot(*gap) < half[1]:
        return []
    start = np.clip(offset, -wish.reach, wish.reach)
    end = offset - np.clip(offset, -half, half)
    ends = np.stack([wish.anchor + layout.to_projector(start), wish.anchor + layout.to_projector(end)])
    return [Stroke(ends, COLOURS[wish.severity], 1, feature=wish.feature)]
