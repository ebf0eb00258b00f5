"""The ballooned map: what the left camera saw at each station, with the numbers of the characteristics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

import cv2
import numpy as np
from markupsafe import Markup, escape

from metrology.verdicts import SEVERITIES
from storage.archive.store import Store
from storage.documents import utc_text
from storage.export.subject import Characteristic, ExportedScene, Subject
from storage.frames import read_preview
from storage.templates import data_uri

_WIDTH = 1600
_HEAD = 44
_RADIUS = 11
_JPEG_QUALITY = 82


def ballooned_map(subject: Subject, store: Store) -> str:
    """One SVG that needs nothing else: a picture for each station, one above the other."""
    pictures, height = [], 0
    for scene in subject.scenes:
        own = [c for c in subject.lines if c.scene is scene]
        drawn, tall = _station(scene, own, store, height)
        pictures.append(drawn)
        height += tall
    return Markup(
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {w} {height}" width="{w}" '
        'font-family="sans-serif"><title>{name}</title>{pictures}</svg>\n'
    ).format(w=_WIDTH, height=height, name=subject.name, pictures=Markup().join(pictures))


def _station(scene: ExportedScene, own: Sequence[Characteristic], store: Store, top: int) -> tuple[Markup, int]:
    picture = read_preview(store.file(scene.row["preview_path"]))
    scale = _WIDTH / picture.shape[1]
    tall = round(picture.shape[0] * scale)
    small = cv2.resize(picture, (_WIDTH, tall), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    _, jpeg = cv2.imencode(".jpg", np.asarray(small), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    row = scene.row
    drawn = Markup(
        '<g transform="translate(0 {top})"><text x="8" y="29" font-size="22">{title}</text>'
        '<g transform="translate(0 {head})"><image href="{picture}" width="{w}" height="{tall}"/>{marks}</g></g>'
    ).format(
        top=top,
        title=f"{row['aircraft_serial']} {row['panel']} {row['station']}, {utc_text(row['captured_at'])}",
        head=_HEAD,
        picture=data_uri(jpeg.tobytes(), "jpeg"),
        w=_WIDTH,
        tall=tall,
        marks=Markup().join(_balloon(group, scale) for group in _groups(own)),
    )
    return drawn, tall + _HEAD


def _groups(own: Sequence[Characteristic]) -> Iterator[list[Characteristic]]:
    """Characteristics that share a balloon: all of a rivet, of a stretch of a seam, of what of it passes."""
    for _, group in groupby(own, key=lambda c: (c.kind.name, c.feature)):
        yield list(group)


def _balloon(group: Sequence[Characteristic], scale: float) -> Markup:
    first, last = group[0], group[-1]
    u, v = (first.row["u_px"] + 0.5) * scale, (first.row["v_px"] + 0.5) * scale
    label = f"{first.number}–{last.number}" if last.number > first.number else f"{first.number}"
    half = max(_RADIUS, 4 + 3.6 * len(label))
    x, y = min(max(u + 26, half), _WIDTH - half), max(v - 26, _RADIUS)
    colour = SEVERITIES[first.row["severity"]].paper
    said, line = escape(f"{first.feature}: {first.row['decision']}"), f'stroke="{escape(colour)}" stroke-width="2"'
    # All but `said` are numbers of our own; filling in a Markup costs ten times as much, and there may be 10 000.
    return Markup(
        f'<g><title>{said}</title><line x1="{u:.1f}" y1="{v:.1f}" x2="{x:.1f}" y2="{y:.1f}" {line}/>'
        f'<rect x="{x - half:.1f}" y="{y - _RADIUS:.1f}" width="{2 * half:.1f}" height="{2 * _RADIUS}" rx="{_RADIUS}" '
        f'fill="#fff" {line}/><text x="{x:.1f}" y="{y + 4.5:.1f}" font-size="13" text-anchor="middle">{label}</text>'
        "</g>"
    )
