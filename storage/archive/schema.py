"""The archive's tables: every column with its type and what it means, said once for DuckDB, Parquet and the reader."""

from __future__ import annotations

import hashlib
from dataclasses import MISSING, dataclass, fields
from datetime import datetime
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

from metrology.assembly.rows import ChangeRow, CoverageRow, DifferenceRow, FindingRow, RuleRow, StationRow, VerdictRow
from metrology.kinds import KINDS, Kind
from metrology.results import Feature
from metrology.steps import TIMED

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class Column:
    """A column: its name, DuckDB type and meaning."""

    name: str
    sql_type: str
    comment: str

    @property
    def create_sql(self) -> str:
        """Name and type, as CREATE TABLE has them."""
        return f"{self.name} {self.sql_type}"

    def comment_sql(self, table: str) -> str:
        """COMMENT ON COLUMN of a table."""
        return f"COMMENT ON COLUMN {table}.{self.name} IS {_quoted(self.comment)}"


@dataclass(frozen=True)
class Table:
    """A table and its columns."""

    name: str
    comment: str
    columns: tuple[Column, ...]

    @property
    def create_sql(self) -> str:
        """CREATE TABLE with the comments."""
        comments = [f"COMMENT ON TABLE {self.name} IS {_quoted(self.comment)}"]
        comments += [c.comment_sql(self.name) for c in self.columns]
        return ";\n".join([self.plain_sql, *comments])

    @property
    def plain_sql(self) -> str:
        """CREATE TABLE without the comments, which take four fifths of the time."""
        return f"CREATE TABLE {self.name} ({', '.join(column.create_sql for column in self.columns)})"

    @property
    def arrow_schema(self) -> pa.Schema:
        """The same columns for Parquet, the comments as field metadata."""
        import pyarrow as pa

        types = {
            "VARCHAR": pa.string(),
            "DOUBLE": pa.float64(),
            "INTEGER": pa.int32(),
            "BIGINT": pa.int64(),
            "TIMESTAMPTZ": pa.timestamp("us", tz="UTC"),
            "BOOLEAN": pa.bool_(),
            "VARCHAR[]": pa.list_(pa.string()),
            "DOUBLE[]": pa.list_(pa.float64()),
        }
        fields = [pa.field(c.name, types[c.sql_type], metadata={"comment": c.comment}) for c in self.columns]
        return pa.schema(fields, metadata={"comment": self.comment})


def _columns(text: str) -> tuple[Column, ...]:
    """Columns from lines of `name type meaning`."""
    return tuple(Column(*line.split(maxsplit=2)) for line in text.strip().splitlines())


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


KEY = _columns("""
aircraft_serial VARCHAR serial number of the aircraft
panel VARCHAR panel of the aircraft
station VARCHAR placement of the rig in front of the panel
captured_at TIMESTAMPTZ when the scan was taken (UTC)
scene_id VARCHAR aircraft, panel, station and time as one word; names the scene in every table
""")

SCENES = Table(
    "scenes",
    "One row per inspected scene: its newest run",
    KEY
    + _columns("""
run_id VARCHAR the inspection run that gave the scene's rows; grows with time
rig_id VARCHAR calibration that was used
operator VARCHAR who scanned, where the scene says so
processed_at TIMESTAMPTZ when the run was stored (UTC)
first_stored_at TIMESTAMPTZ when the scene's first run was stored (UTC); NULL where it was before this was kept
frames_digest VARCHAR names the content of the frames; another scan has another one; NULL where it was not kept yet
files_state VARCHAR names the frame files as they lay on disk; while it is the same, nothing in them changed
software_version VARCHAR version of Flushline
config_hash VARCHAR names all settings and the panel specification; equal hashes were inspected alike
rig_hash VARCHAR names the content of the rig file
panel_spec VARCHAR panel and revision of the specification that was used
status VARCHAR ok, or warnings
warnings VARCHAR[] what a person should know about this run
n_points BIGINT points of the cloud
valid_fraction DOUBLE share of the left camera's pixels with a point
sigma_z_median_mm DOUBLE median standard deviation of a point's depth, mm
epipolar_rms_px DOUBLE how far features seen by both cameras lie from their epipolar lines, RMS px; NULL where unknown
projector_rms_px DOUBLE how far decoded projector coordinates lie from where the rig projects their points, RMS px
rig_verdict VARCHAR whether the rig fits the scan: ok, warning, or unjudged (the scan cannot tell); NULL in older runs
""")
    + tuple(Column(count.column, "INTEGER", count.meaning) for kind in KINDS for count in kind.counts)
    + _columns("""
registration VARCHAR whether the panel's pattern was recognised, not recognised, enrolled by this scene or not enrolled
n_missing INTEGER rivets of the pattern that are in view but were not found
n_unlisted INTEGER rivets found that are in no pattern
registration_rms_mm DOUBLE RMS distance of the recognised rivets from their nominal places, mm
rig_shift_mm DOUBLE how far the rig stood from the station's nominal placement, mm
rig_turn_deg DOUBLE how far the rig was turned from the station's nominal placement, degrees
""")
    + tuple(Column(f"seconds_{step}", "DOUBLE", f"wall time of the step {step}, s") for step in TIMED)
    + _columns("""
seconds_total DOUBLE wall time from the first frame to the finished result, s
bundle_path VARCHAR folder with everything of this run, relative to the store
cloud_path VARCHAR organised point cloud (Parquet), relative to the store
overlay_path VARCHAR image to project (PNG), relative to the store
preview_path VARCHAR texture as the left camera sees it (PNG), relative to the store
"""),
)


def _features_table(kind: Kind) -> Table:
    """A kind's table, from the fields of its rows: its id, its place, its own columns, and how it was judged."""
    meanings = get_type_hints(kind.row_type, include_extras=True)
    shared = fields(Feature)
    place = [field.name for field in shared if field.default is MISSING]
    judged = [field.name for field in shared if field.default is not MISSING]
    own = [field.name for field in fields(kind.row_type) if field.name not in {*kind.id_columns, *place, *judged}]
    columns = [_column(name, meanings[name], kind) for name in (*kind.id_columns, *place, *own, *judged)]
    comment = f"One row per {kind.one} of each scene. What could not be measured is NULL and reason says why"
    return Table(kind.table, comment, (*KEY, *columns))


def _column(name: str, hint: Any, kind: Kind | None = None) -> Column:
    """A column from a row's field: `Annotated[type, meaning]`."""
    python_type, meaning = get_args(hint)[:2]
    sql_type = next(
        (sql for found, sql in _SQL_TYPES.items() if found in (python_type, *get_args(python_type))), "VARCHAR"
    )
    return Column(name, sql_type, meaning.format(point=kind.point, pixel=kind.pixel) if kind else meaning)


_SQL_TYPES = {
    float: "DOUBLE",
    int: "INTEGER",
    bool: "BOOLEAN",
    datetime: "TIMESTAMPTZ",
    tuple[float, ...]: "DOUBLE[]",
    tuple[str, ...]: "VARCHAR[]",
}


def _plain_table(name: str, comment: str, row: type) -> Table:
    """A table of a panel from the fields of its rows."""
    columns = tuple(_column(n, hint) for n, hint in get_type_hints(row, include_extras=True).items())
    known = {column.name for column in columns}
    return Table(name, comment, (*(c for c in PANEL_KEY if c.name not in known), *columns))


def _of_panel(kind: Kind) -> Table:
    """A kind's table for assembled panels: each physical feature once, without what only one picture has."""
    shared = {"aircraft_serial", "panel", "captured_at", "scene_id"}
    own = [
        column
        for column in OF_KIND[kind.name].columns
        if column.name not in {*shared, "station", "x_mm", "y_mm", "z_mm"} and not column.name.endswith("_px")
    ]
    comment = f"One row per {kind.one} of each assembled panel, whatever number of scans saw it"
    return Table(f"panel_{kind.table}", comment, (*PANEL_KEY, *_SEEN, *own))


PANEL_KEY = _columns("""
aircraft_serial VARCHAR serial number of the aircraft
panel VARCHAR panel of the aircraft
captured_at TIMESTAMPTZ when the newest scan in the panel was taken (UTC)
scene_id VARCHAR aircraft and panel as one word; names the assembled panel in every table
station VARCHAR the station that measured it best; NULL where it is of the whole panel
""")
_SEEN = _columns("""
part INTEGER part of the panel, from 1: places of different parts have no common frame
best_scene_id VARCHAR the scan that measured it best
n_scans INTEGER scans that found it
n_measured INTEGER scans whose values are in it
seen_by VARCHAR[] scans that found it
seen_as VARCHAR[] what these scans call it
place_u95_mm DOUBLE expanded uncertainty (95 %) of its place in the panel's frame, mm
""")
PANELS = Table(
    "panels",
    "One row per assembled panel: its newest assembly",
    PANEL_KEY
    + _columns("""
run_id VARCHAR the run that put it together; grows with time
processed_at TIMESTAMPTZ when it was put together (UTC)
software_version VARCHAR version of Flushline
panel_spec VARCHAR panel and revision of the specification that it was judged by
status VARCHAR ok, or warnings
warnings VARCHAR[] what a person should know about it
n_scenes INTEGER scans in it
n_left_out INTEGER scans that contradict the others and are not in it
n_parts INTEGER parts that nothing joins; 1 where all scans are in one frame
scenes VARCHAR[] scans in it
place_u95_mm DOUBLE expanded uncertainty (95 %) of the worst placement, mm
n_repeated INTEGER values that several scans measured
n_beyond INTEGER of these, those that differ by more than their uncertainties
verdict VARCHAR accepted, accepted with conditions, rejected, incomplete, or no rules
verdict_reason VARCHAR the rule that decided, or what is missing
area_cm2 DOUBLE skin that was measured, what several scans saw once, cm²
n_expected INTEGER nominal fasteners and stretches of seams; NULL where no pattern says what there should be
n_not_measured INTEGER of these, seen but not measured
n_not_seen INTEGER of these, in no scan's field
next_station VARCHAR where to stand next; NULL where nothing is missing or no pattern says so
""")
    + tuple(
        Column(count.column, "INTEGER", f"of the whole panel: {count.meaning}")
        for kind in KINDS
        for count in kind.counts
    )
    + _columns("""
bundle_path VARCHAR folder with everything of this run, relative to the store
"""),
)

OF_KIND = {kind.name: _features_table(kind) for kind in KINDS}
"""The table of each kind of feature."""
SCENE_TABLES = (SCENES, *OF_KIND.values())
PANEL_OF_KIND = {kind.name: _of_panel(kind) for kind in KINDS}
"""The table of each kind of feature for assembled panels."""
PANEL_STATIONS = _plain_table("panel_stations", "One row per scan of each assembled panel: where it lies", StationRow)
PANEL_DIFFERENCES = _plain_table(
    "panel_differences", "One row per value that two scans of an assembled panel measured", DifferenceRow
)
PANEL_COVERAGE = _plain_table(
    "panel_coverage", "One row per nominal fastener and stretch of a nominal seam of each assembled panel", CoverageRow
)
PANEL_RULES = _plain_table("panel_rules", "One row per acceptance rule and group of each assembled panel", RuleRow)
PANEL_FINDINGS = _plain_table(
    "panel_findings",
    "One row per feature of an assembled panel that does not simply pass; a stretch of a course is one",
    FindingRow,
)
PANEL_VERDICTS = _plain_table("panel_verdicts", "One row per judgement of each panel, the last one last", VerdictRow)
PANEL_CHANGES = _plain_table(
    "panel_changes",
    "One row per finding of an assembled panel, or of the assembly before: what became of it",
    ChangeRow,
)
PANEL_TABLES = (
    PANELS,
    *PANEL_OF_KIND.values(),
    PANEL_STATIONS,
    PANEL_DIFFERENCES,
    PANEL_COVERAGE,
    PANEL_RULES,
    PANEL_FINDINGS,
    PANEL_VERDICTS,
    PANEL_CHANGES,
)
TABLES = (*SCENE_TABLES, *PANEL_TABLES)


def schema_hash(*more: str) -> str:
    """Names the tables (and what else is given): an index made for other tables is made again."""
    text = "\n".join([*(table.create_sql for table in TABLES), *more])
    return hashlib.sha256(text.encode()).hexdigest()[:12]
