"""Fill a store with the rows of a whole fleet, to see how the archive and the dashboard bear it.

    python benchmarks/make_large_store.py STORE [--aircraft 200] [--panels 60] [--stations 8] [--rivets 32]

200 aircraft × 60 panels × 8 stations are 96 000 scenes, 3 M rivets and 10 M seam stations, a minute or two;
`--panels 100 --stations 10 --rivets 50` makes 200 000 scenes, 10 M rivets and 21 M seam stations.
The rows are made up inside DuckDB: heights drift from aircraft to aircraft, a few panels are worse than the others, and
two rig recalibrations and one software version fall into the time. All scenes share the files of one real bundle, so
that pictures and clouds can be opened too. `archive rebuild` of such a store would find that one bundle only, and those
of one more aircraft, the newest, whose panel is put together from scans of its own.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import duckdb
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from metrology.results import PanelKey, SceneKey
from storage.archive import bookkeeping, generations
from storage.archive.files import locked
from storage.archive.panel_bundle import panel_document
from storage.archive.store import Store
from tasks.panel import assemble
from tests.support.synthetic_scene import Recipe, synthetic_result

SEAMS_PER_SCENE, STATIONS_PER_SEAM = 2, 52
FULL_SIZE = (1624, 1234)
FIRST = datetime(2025, 1, 6, 22, 0, tzinfo=UTC)


def main() -> None:
    """Read the command line and make the store."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("store", type=Path)
    parser.add_argument("--aircraft", type=int, default=200)
    parser.add_argument("--panels", type=int, default=60)
    parser.add_argument("--stations", type=int, default=8)
    parser.add_argument("--rivets", type=int, default=32, help="per scene")
    arguments = parser.parse_args()
    make_large_store(arguments.store, Fleet(arguments.aircraft, arguments.panels, arguments.stations, arguments.rivets))


@dataclass(frozen=True)
class Fleet:
    """How many aircraft, panels of each, stations of each panel, and rivets of each scene."""

    aircraft: int
    panels: int
    stations: int
    rivets: int


def make_large_store(root: Path, fleet: Fleet, size: tuple[int, int] = FULL_SIZE) -> None:
    """Make the store; it must not exist yet.

    Parameters
    ----------
    size : (width, height)
        Of the one bundle's image that all scenes share, pixels.
    """
    store = Store(root)
    heights = (*(0.02 * ((i * 7) % 11 - 5) / 5 for i in range(fleet.rivets - 1)), 0.13)
    key = SceneKey("MSN-0001", "LH-F01", "S1", FIRST)
    store.publish(synthetic_result(Recipe(key, heights_mm=heights, size=size)))
    with locked(store.layout.lock):
        generations.change(store.layout, partial(_insert, fleet=fleet))
    _put_together(store, fleet, size)


def _put_together(store: Store, fleet: Fleet, size: tuple[int, int]) -> None:
    """One more aircraft, right after the others, whose panel is assembled."""
    serial, panel = f"MSN-{fleet.aircraft + 1:04d}", "LH-F01"
    last = FIRST + timedelta(minutes=(fleet.aircraft - 1) * 3 * 24 * 60 + fleet.panels * fleet.stations * 2)
    rng = np.random.default_rng(1)
    for k in range(fleet.stations):
        heights = tuple(map(float, 0.05 * rng.standard_normal(fleet.rivets)))
        key = SceneKey(serial, panel, f"S{k + 1}", last + timedelta(minutes=2 * k))
        store.publish(synthetic_result(Recipe(key, heights_mm=heights, step_mm=0.15, size=size, seed=k)))
    store.publish_panel(panel_document(assemble(store, PanelKey(serial, panel))))


def _insert(connection: duckdb.DuckDBPyConnection, fleet: Fleet) -> None:
    connection.execute("BEGIN")
    connection.execute("CREATE TEMP TABLE model AS SELECT * FROM scenes")
    connection.execute("CREATE TEMP TABLE heads AS SELECT * FROM rivets")
    for table in ("scenes", "rivets", "seam_stations"):
        connection.execute(f"DELETE FROM {table}")
    connection.execute(_KEYS, [fleet.aircraft, fleet.panels, fleet.stations])
    connection.execute(_SCENES)
    connection.execute(_RIVETS)
    connection.execute(_SEAM_STATIONS, [SEAMS_PER_SCENE, STATIONS_PER_SEAM])
    connection.execute(f"DELETE FROM {bookkeeping.RUNS.name}")
    digests = bookkeeping.digests_sql(bookkeeping.additions(connection), lambda table: table)
    rows = f"SELECT scene_id, run_id, digest FROM scenes JOIN ({digests}) USING (scene_id)"
    connection.execute(f"INSERT INTO {bookkeeping.RUNS.name} {rows}")
    connection.execute("DROP TABLE keys; DROP TABLE model; DROP TABLE heads")
    connection.execute("COMMIT")


_KEYS = """
CREATE TEMP TABLE keys AS
SELECT *, concat_ws('~', aircraft_serial, panel, station, strftime(captured_at, '%Y%m%dT%H%M%SZ')) AS scene_id
FROM (
    SELECT printf('MSN-%04d', a + 1) AS aircraft_serial,
           CASE WHEN p % 2 = 0 THEN 'LH' ELSE 'RH' END || printf('-F%02d', p // 2 + 1) AS panel,
           printf('S%d', s + 1) AS station,
           TIMESTAMPTZ '2025-01-06 22:00:00+00' + INTERVAL (a * 3 * 24 * 60 + (p * ?3 + s) * 2) MINUTE AS captured_at,
           a, p, s
    FROM range(?1) AS A(a), range(?2) AS P(p), range(?3) AS S(s)
)
ORDER BY captured_at
"""

_SCENES = """
INSERT INTO scenes BY NAME
SELECT m.* REPLACE (
    k.aircraft_serial AS aircraft_serial, k.panel AS panel, k.station AS station, k.captured_at AS captured_at,
    k.scene_id AS scene_id, k.captured_at + INTERVAL 3 HOUR AS processed_at,
    CASE WHEN k.a < 90 THEN 'rig-2025-01-02' WHEN k.a < 150 THEN 'rig-2025-09-30' ELSE 'rig-2026-04-01' END AS rig_id,
    CASE WHEN k.a < 120 THEN '0.1.0' ELSE '0.2.0' END AS software_version,
    CASE WHEN random() < 0.02 THEN 'warnings' ELSE 'ok' END AS status,
    round(0.035 + 0.0004 * (k.a % 60) + 0.002 * random(), 4) AS epipolar_rms_px,
    0.002 + 0.0001 * (k.a % 60) + 0.001 * random() AS projector_rms_px,
    round(0.0040 + 0.0003 * random(), 5) AS sigma_z_median_mm, 0.96 + 0.03 * random() AS valid_fraction,
    0.9 + 0.2 * random() AS seconds_total
)
FROM keys k, model m
ORDER BY k.captured_at
"""

# A head's own deviation is the same on every aircraft; the panel, the aircraft and chance add to it.
_RIVETS = """
INSERT INTO rivets BY NAME
SELECT *,
    CASE WHEN decision = 'not measured' THEN NULL WHEN abs(height_mean_mm) > 0.2 THEN 'red'
         WHEN abs(height_mean_mm) > 0.1 THEN 'blue' ELSE 'green' END AS severity,
    CASE WHEN decision IN ('fail', 'conditional fail')
         THEN printf('height %+.3f ± %.3f mm outside -0.100 … +0.100', height_mean_mm, height_u95_mm)
         WHEN decision = 'not measured' THEN 'skin: points in 5 of 12 directions, at least 7 needed' END AS reason
FROM (
    SELECT * EXCLUDE (missing) REPLACE (CASE WHEN missing THEN NULL ELSE height_mean_mm END AS height_mean_mm),
        CASE WHEN missing THEN 'not measured' WHEN abs(height_mean_mm) > 0.1 + height_u95_mm THEN 'fail'
             WHEN abs(height_mean_mm) > 0.1 THEN 'conditional fail'
             WHEN abs(height_mean_mm) > 0.1 - height_u95_mm THEN 'conditional pass' ELSE 'pass' END AS decision
    FROM (
        SELECT h.* EXCLUDE (aircraft_serial, panel, station, captured_at, scene_id, height_mean_mm, severity, decision,
                            reason, tilt_deg) REPLACE (SCATTERED),
            k.aircraft_serial, k.panel, k.station, k.captured_at, k.scene_id,
            round(h.height_mean_mm * 0.8 + 0.012 * sin(k.p * 1.7) + 0.01 * sin(k.a / 25.0)
                + 0.018 * sqrt(-2 * ln(1 - random())) * cos(2 * pi() * random())
                + CASE WHEN k.p % 17 = 3 THEN 0.02 ELSE 0 END, 5) AS height_mean_mm,
            round(0.1 + 0.3 * random(), 4) AS tilt_deg, random() < 0.002 AS missing
        FROM keys k, heads h
        ORDER BY k.captured_at, h.rivet_id
    )
)
"""

# Column and how far it scatters from scan to scan, in its unit; rounded as the store rounds it.
_SCATTER = {
    "x_mm": 2.0, "y_mm": 2.0, "z_mm": 5.0, "u_px": 8.0, "v_px": 8.0, "diameter_mm": 0.05, "major_px": 0.4,
    "minor_px": 0.4, "angle_deg": 10.0, "confidence": 0.1, "height_min_mm": 0.02, "height_max_mm": 0.02,
    "height_u95_mm": 0.001, "tilt_u95_deg": 0.02, "rms_inner_mm": 0.001, "rms_outer_mm": 0.001,
}  # fmt: skip
_RIVETS = _RIVETS.replace(
    "SCATTERED",
    ", ".join(
        f"round(h.{name} + {width} * (random() - 0.5), {5 if name.endswith('mm') else 4}) AS {name}"
        for name, width in _SCATTER.items()
    ),
)

_SEAM_STATIONS = """
INSERT INTO seam_stations BY NAME
SELECT *,
    CASE WHEN abs(step_mm) > 0.4 THEN 'red' WHEN abs(step_mm) > 0.2 THEN 'blue' ELSE 'green' END AS severity,
    CASE WHEN abs(step_mm) > 0.205 THEN 'fail' WHEN abs(step_mm) > 0.2 THEN 'conditional fail'
         WHEN abs(step_mm) > 0.195 THEN 'conditional pass' ELSE 'pass' END AS decision,
    CASE WHEN abs(step_mm) > 0.2 THEN printf('step %+.3f ± 0.005 mm outside -0.200 … +0.200', step_mm) END AS reason
FROM (
    SELECT k.aircraft_serial, k.panel, k.station, k.captured_at, k.scene_id, printf('M%d', m + 1) AS seam_id,
        i * 4.0 AS s_mm, round(-110 + i * 4.0 + random(), 5) AS y_mm, round(62.0 - 80 * m + random(), 5) AS x_mm,
        round(700.0 + random(), 5) AS z_mm,
        round(1147.0 - 433 * m + random(), 4) AS u_px, round(30 + i * 22.5 + random(), 4) AS v_px,
        round(0.06 * sin(k.p * 0.9 + m) + 0.03 * sin(i / 9.0 + k.a)
            + 0.04 * sqrt(-2 * ln(1 - random())) * cos(2 * pi() * random()), 5) AS step_mm,
        0.005 AS step_u95_mm, round(2.4 + 0.05 * random(), 5) AS width_mm, 0.02 AS width_u95_mm,
        640 AS n_left, 655 AS n_right, 'default' AS zone
    FROM keys k, range(?1) AS M(m), range(?2) AS I(i)
    ORDER BY k.captured_at, m, i
)
"""


if __name__ == "__main__":
    main()
