"""What of an aircraft was inspected: its panels, done, partly or not, and where to stand next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from metrology.errors import StoreError
from storage.archive.store import Store

State = Literal["done", "partly", "not", "no pattern"]


@dataclass(frozen=True)
class AircraftPanel:
    """A panel of an aircraft."""

    panel: str
    state: State
    """Done: every nominal feature was measured, in one frame. No pattern: nothing says what there should be."""
    n_scans: int
    """Stations that have a scan."""
    verdict: str | None
    """None where the scans were not put together."""
    missing: str
    """What is not done, in words."""
    next_station: str | None
    """Where to stand next."""


def panels_of_aircraft(store: Store, aircraft: str) -> list[AircraftPanel]:
    """All panels that the store knows of any aircraft, as they stand on one."""
    rows = store.query(
        "WITH scanned AS (SELECT panel, count(*) AS n, list(scene_id) AS ids FROM latest_scenes "
        "WHERE aircraft_serial = $1 GROUP BY panel), known AS (SELECT DISTINCT panel FROM scenes) "
        "SELECT k.panel, s.n, s.ids, p.* EXCLUDE (panel) FROM known k LEFT JOIN scanned s USING (panel) "
        "LEFT JOIN panels p ON p.aircraft_serial = $1 AND p.panel = k.panel",
        [aircraft],
    ).to_pylist()
    if not any(row["n"] for row in rows):
        raise StoreError(f"{store.root}: found no scan of aircraft {aircraft}, expected one")
    known = {str(row["panel"]): row for row in rows}
    return [_panel(store, name, known.get(name)) for name in sorted({*known, *store.panels.names()})]


def _panel(store: Store, name: str, row: Mapping[str, Any] | None) -> AircraftPanel:
    if row is None or not row["n"]:
        spec = store.panels.in_force(name)
        first = next(iter(spec.layout.stations), None) if spec else None
        return AircraftPanel(name, "not", 0, None, "no scan", first)
    if row["scenes"] is None:
        return AircraftPanel(name, "partly", row["n"], None, "not put together: 'flushline panel assemble'", None)
    newer = len(set(row["ids"]) - set(row["scenes"])) - row["n_left_out"]
    missing = [
        f"{count} {words}"
        for count, words in (
            (row["n_not_seen"], "not seen"),
            (row["n_not_measured"], "not measured"),
            (row["n_left_out"], "scans left out"),
            (row["n_parts"] if row["n_parts"] > 1 else 0, "parts that nothing joins"),
            (newer, "scans newer than the assembly"),
        )
        if count and count > 0
    ]
    state: State = "partly" if missing else "done" if row["n_expected"] else "no pattern"
    return AircraftPanel(name, state, row["n"], row["verdict"], ", ".join(missing), row["next_station"])
