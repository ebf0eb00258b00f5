"""The archive's tables: every column with its type and what it means, said once for DuckDB, Parquet and the reader."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyarrow as pa

STEPS = (
    "load",
    "reconstruct",
    "detect_rivets",
    "check_rig",
    "detect_seams",
    "measure_rivets",
    "measure_seams",
    "register",
    "judge",
    "overlay",
)
"""Steps of an inspection whose time is kept, in their order."""


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
        columns = ", ".join(c.create_sql for c in self.columns)
        comments = [f"COMMENT ON TABLE {self.name} IS {_quoted(self.comment)}"]
        comments += [c.comment_sql(self.name) for c in self.columns]
        return ";\n".join([f"CREATE TABLE {self.name} ({columns})", *comments])

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
            "VARCHAR[]": pa.list_(pa.string()),
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
n_rivets INTEGER rivets found, without unconfirmed ones
n_seams INTEGER seams found
n_stations INTEGER positions measured along seams
registration VARCHAR whether the panel's pattern was recognised, not recognised, enrolled by this scene or not enrolled
n_missing INTEGER rivets of the pattern that are in view but were not found
n_unlisted INTEGER rivets found that are in no pattern
registration_rms_mm DOUBLE RMS distance of the recognised rivets from their nominal places, mm
rig_shift_mm DOUBLE how far the rig stood from the station's nominal placement, mm
rig_turn_deg DOUBLE how far the rig was turned from the station's nominal placement, degrees
""")
    + tuple(Column(f"seconds_{step}", "DOUBLE", f"wall time of the step {step}, s") for step in STEPS)
    + _columns("""
seconds_total DOUBLE wall time from the first frame to the finished result, s
bundle_path VARCHAR folder with everything of this run, relative to the store
cloud_path VARCHAR organised point cloud (Parquet), relative to the store
overlay_path VARCHAR image to project (PNG), relative to the store
preview_path VARCHAR texture as the left camera sees it (PNG), relative to the store
"""),
)

RIVETS = Table(
    "rivets",
    "One row per rivet of each scene. What could not be measured is NULL and reason says why",
    KEY
    + _columns("""
rivet_id VARCHAR name of the rivet in the panel's pattern, the same on every scan of the station; X… is in no pattern
x_mm DOUBLE centre of the head in the rig frame (left camera), to the right, mm
y_mm DOUBLE centre of the head in the rig frame, down, mm
z_mm DOUBLE centre of the head in the rig frame, away from the rig, mm
u_px DOUBLE column of the head's centre in the raw left image, px
v_px DOUBLE row of the head's centre in the raw left image, px
u_right_px DOUBLE column of the head's centre in the raw right image, px
v_right_px DOUBLE row of the head's centre in the raw right image, px
diameter_mm DOUBLE diameter of the head, mm
major_px DOUBLE major axis (whole length) of the head's ellipse in the left image, px
minor_px DOUBLE minor axis (whole length) of the head's ellipse in the left image, px
angle_deg DOUBLE direction of the major axis from +u towards +v, degrees
confidence DOUBLE of the detection, 0 to 1
found_by VARCHAR what showed it: image (its ring) or relief (the cloud's deviation from the skin); NULL in older runs
height_mean_mm DOUBLE mean height of the head above the skin, mm; positive stands proud
height_min_mm DOUBLE least height of the head above the skin, mm
height_max_mm DOUBLE greatest height of the head above the skin, mm
height_u95_mm DOUBLE expanded uncertainty (95 %) of height_mean_mm, mm
tilt_deg DOUBLE angle between the head and the skin, degrees
tilt_u95_deg DOUBLE expanded uncertainty (95 %) of tilt_deg, degrees
crown_mm DOUBLE how far a domed head's middle stands above its rim, mm
n_inner INTEGER points on the head that were used
n_outer INTEGER points on the skin around it that were used
rms_inner_mm DOUBLE scatter of the head's points about its plane, mm
rms_outer_mm DOUBLE scatter of the skin's points about the reference surface, mm
diameter_u95_mm DOUBLE expanded uncertainty (95 %) of diameter_mm, mm
diameter_nominal_mm DOUBLE diameter of the head by the panel's pattern, mm; NULL where it names none
x_panel_mm DOUBLE the same point in the panel's frame, mm; NULL where the panel's pattern was not recognised
y_panel_mm DOUBLE the same point in the panel's frame, mm
z_panel_mm DOUBLE the same point in the panel's frame, mm
zone VARCHAR tolerance zone of the panel specification
severity VARCHAR green meets the limits, blue slightly outside, red seriously outside
decision VARCHAR pass, conditional pass, conditional fail, fail, not measured, unconfirmed (perhaps no rivet), no limit
reason VARCHAR why there is no value, or why the decision is not a pass
"""),
)

SEAM_STATIONS = Table(
    "seam_stations",
    "One row per position along a seam of each scene. What could not be measured is NULL and reason says why",
    KEY
    + _columns("""
seam_id VARCHAR name of the seam in the panel's pattern, the same on every scan of the station; XS… is in no pattern
s_mm DOUBLE position along the seam (arc length from the nominal seam's start), mm
x_mm DOUBLE middle between the ideal edges in the rig frame (left camera), to the right, mm
y_mm DOUBLE middle between the ideal edges in the rig frame, down, mm
z_mm DOUBLE middle between the ideal edges in the rig frame, away from the rig, mm
u_px DOUBLE column of that point in the raw left image, px
v_px DOUBLE row of that point in the raw left image, px
step_mm DOUBLE height of side B minus side A, mm; A is the side at smaller u (seam nearer to vertical) or smaller v
step_u95_mm DOUBLE expanded uncertainty (95 %) of step_mm, mm
width_mm DOUBLE width of the gap between the ideal edges, mm
width_u95_mm DOUBLE expanded uncertainty (95 %) of width_mm, mm
n_left INTEGER points used on side A
n_right INTEGER points used on side B
step_into_wind_mm DOUBLE step that the air runs against (positive) or falls from (negative), mm; NULL without an airflow
x_panel_mm DOUBLE the same point in the panel's frame, mm; NULL where the panel's pattern was not recognised
y_panel_mm DOUBLE the same point in the panel's frame, mm
z_panel_mm DOUBLE the same point in the panel's frame, mm
zone VARCHAR tolerance zone of the panel specification
severity VARCHAR green meets the limits, blue slightly outside, red seriously outside
decision VARCHAR pass, conditional pass, conditional fail, fail, not measured, no limit
reason VARCHAR why there is no value, or why the decision is not a pass
"""),
)

TABLES = (SCENES, RIVETS, SEAM_STATIONS)


def schema_hash(*more: str) -> str:
    """Names the tables (and what else is given): an index made for other tables is made again."""
    text = "\n".join([*(table.create_sql for table in TABLES), *more])
    return hashlib.sha256(text.encode()).hexdigest()[:12]
