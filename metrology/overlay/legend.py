"""The legend: which scan this is, what the marks and the values mean, and what is not shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array
from metrology.overlay.layout import Layout
from metrology.overlay.marks import COLOURS, WORDS, Label, Stroke, rivet_marks
from metrology.overlay.paint import text_size
from metrology.overlay.words import Words
from metrology.results import Severity

_MARGIN_PX = 6.0
_SHAPE_RADIUS = 0.35  # of the text height; ticks and rings reach twice as far


@dataclass(frozen=True)
class Entry:
    """A line of the legend, in the colour of a severity and with its mark before it where `marked`."""

    text: str
    severity: Severity | None = None
    marked: bool = False


def entries(
    title: Sequence[str], key: Sequence[Severity | None], notes: Sequence[str], words: Words
) -> list[list[Entry]]:
    """The legend's lines in up to three groups, what matters most first: title, key of the marks, notes."""
    groups = [
        [Entry(line) for line in title],
        [Entry(words.text(WORDS[severity]), severity, marked=True) for severity in key],
        [Entry(note) for note in notes],
    ]
    return [group for group in groups if group]


def draw_legend(
    groups: Sequence[Sequence[Entry]], layout: Layout, height: float, angle: float, width: int
) -> tuple[list[Label], list[Stroke]]:
    """Place the legend where it covers nothing: all of it as one block or as a row of groups, else its first groups.

    Parameters
    ----------
    groups : sequence of lists of Entry
    height : float
        Of a capital letter, px.
    angle : float
        The operator's horizontal in the projector image, radians.
    width : int
        Base line width of the marks, px.
    """
    for count in range(len(groups), 0, -1):
        shown = groups[:count]
        arrangements = [_arranged(shown, height, by_row) for by_row in ([False, True] if count > 1 else [False])]
        sizes = [size for size, _ in arrangements]
        if count > 1 and not layout.has_room(sizes, _MARGIN_PX):
            continue
        which, centre = layout.place_block(sizes, _MARGIN_PX)
        size, lines = arrangements[which]
        return _drawn(lines, centre - layout.to_projector(np.array(size) / 2), layout, height, angle, width)
    return [], []


def _line_size(entry: Entry, height: float) -> tuple[float, float]:
    text_width, text_height = text_size(entry.text, height)
    return text_width + (_shape_room(height) if entry.marked else 0.0), text_height


def _shape_room(height: float) -> float:
    return 2.2 * height


def _arranged(
    groups: Sequence[Sequence[Entry]], height: float, by_row: bool
) -> tuple[tuple[float, float], list[tuple[Entry, Array]]]:
    """Size of the block, and each entry with its upper left corner in it."""
    lines: list[tuple[Entry, Array]] = []
    x = y = right = bottom = 0.0
    for group in groups:
        sizes = [_line_size(entry, height) for entry in group]
        for entry, (_, line_height) in zip(group, sizes, strict=True):
            lines.append((entry, np.array([x, y])))
            y += line_height
        right, bottom = max(right, x + max(w for w, _ in sizes)), max(bottom, y)
        if by_row:
            x, y = right + 0.5 * height, 0.0
    return (right, bottom), lines


def _drawn(
    lines: Sequence[tuple[Entry, Array]], corner: Array, layout: Layout, height: float, angle: float, width: int
) -> tuple[list[Label], list[Stroke]]:
    labels, strokes = [], []
    for entry, offset in lines:
        text_width, text_height = text_size(entry.text, height)
        shift = 0.0
        if entry.marked:
            shift = _shape_room(height)
            middle = corner + layout.to_projector(offset + np.array([shift / 2, text_height / 2]))
            turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
            ring = middle + _SHAPE_RADIUS * height * np.column_stack([np.cos(turn), np.sin(turn)])
            strokes += rivet_marks(ring, entry.severity, max(1, width // 2))
        centre = offset + np.array([shift + text_width / 2, text_height / 2])
        labels.append(Label(entry.text, corner + layout.to_projector(centre), height, angle, COLOURS[entry.severity]))
    return labels, strokes
