"""A subject to export: texts that other programs stumble over, limits, and a placement in the panel's frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from storage.archive import Store
from storage.export.deliveries import CONFIGURATION
from storage.export.formats import Place, format_named, writer_of
from storage.export.subject import Subject, panel_subject
from storage.panel_spec import load_panel_spec
from tests.support.results import small_key, small_result

AIRCRAFT, PANEL = "MSN-1", "LH-F12"
HOSTILE = ("=SUM(A1:A9)", "+1-1", "@x", "<b>&\"'</b>", "Nietkopf Ä ö ß €", "N" * 64, "a;b,c\td", "-0.5 mm")
"""Names of rivets."""
OPERATOR = "=cmd|' /C calc'!A0"
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
SHIFT = np.array([100.0, 200.0, -700.0])


def publish_hostile(root: Path, stations: tuple[str, ...] = ("S1", "S2"), rivets: int = len(HOSTILE)) -> Store:
    """A store of one panel; every second rivet fails."""
    store = Store(root)
    spec = dict(load_panel_spec().document) | {"panel": PANEL, "rivets": [{"id": "R1", "position_mm": [0.0, 0.0, 0.0]}]}
    for station in stations:
        result = small_result(small_key(station, AIRCRAFT, PANEL), rivets=rivets)
        named = [
            replace(
                rivet,
                rivet_id=HOSTILE[i] if i < len(HOSTILE) else f"R{i:05d}",
                height_mean_mm=0.04 + 0.001 * i if i % 2 == 0 else -0.13,
                reason='<a href="x">=1+1</a>; Grat "ß"' if i % 2 else None,
                decision="fail" if i % 2 else "pass",
            )
            for i, rivet in enumerate(result.features["rivet"])
        ]
        placement = {"R": TURN.tolist(), "t_mm": SHIFT.tolist()}
        registration = {**result.registration, "status": "recognised", "matched": [], "placement": placement}
        store.publish(
            replace(
                result,
                features={**result.features, "rivet": tuple(named)},
                panel_spec=spec,
                registration=registration,
                operator=OPERATOR,
            )
        )
    return store


def exported(store: Store, folder: Path, *names: str, decimal: str = "point") -> tuple[Subject, dict[str, Path]]:
    """The panel in some formats: the subject, and the files by what follows the stem."""
    subject = panel_subject(store, AIRCRAFT, PANEL)
    files = []
    for name in names:
        files += writer_of(format_named(name).writer)(subject, Place(folder, "out", store, decimal))  # type: ignore[arg-type]
    return subject, {path.name.removeprefix("out"): path for path in files}


def deliver_panels(store: Store, place: str, *formats: str) -> None:
    """Have a store's panels delivered to a folder or a URI."""
    (store.root / CONFIGURATION).write_text(
        'format = "flushline-deliveries/1"\n[[targets]]\nname = "spc"\nsince = 2020-01-01T00:00:00Z\n'
        f'place = "{place}"\nformats = {list(formats)}\n'
    )
