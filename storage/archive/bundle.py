"""A bundle: everything that one run of one scene left, in one folder that never changes once it is there."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from metrology.cloud import Reconstruction
from metrology.errors import StoreError
from metrology.inspection import InspectionResult
from metrology.kinds import KINDS, counted
from metrology.results import PanelKey, SceneKey
from metrology.steps import TIMED
from storage import png
from storage.archive import layout
from storage.archive.files import protect, sha256, sync, write_durably
from storage.archive.schema import PANELS, SCENE_TABLES, SCENES, Table
from storage.cloud import encode_cloud
from storage.documents import read_json, utc_text
from storage.fits import write_fits
from storage.models import FileName, Identifier, UtcTime, validate
from storage.panel_spec import pattern_toml

if TYPE_CHECKING:
    from storage.evidence.verifications import Mark

FORMAT = "flushline-bundle/1"
PANEL_FORMAT = "flushline-panel-run/1"
MANIFEST = layout.MANIFEST
# 10 nm, 0.1 mdeg and 0.1 mpx, far below any uncertainty: tables of such numbers take a third of the room.
_DIGITS = {"mm": 5, "deg": 4, "px": 4}
CLOUD, OVERLAY, OVERLAY_SVG, PREVIEW, RIG = "cloud.parquet", "overlay.png", "overlay.svg", "preview.png", "rig.json"
FITS = "fits.parquet"
_AT_A_TIME = 4  # files that are brought onto the disk
PATTERN = "pattern.toml"  # where the scene enrols its station's pattern


class FileModel(BaseModel):
    """A file of a bundle."""

    bytes: int
    sha256: str


class BundleModel(BaseModel):
    """manifest.json of a bundle; newer versions may say more."""

    model_config = ConfigDict(extra="allow", frozen=True)

    format: Literal["flushline-bundle/1", "flushline-panel-run/1"]
    run_id: FileName
    aircraft_serial: Identifier
    panel: Identifier
    station: Identifier | None = None  # None: of an assembled panel
    captured_at: UtcTime
    scene_id: FileName
    config_hash: str
    rig_hash: str = ""
    rig: str = ""
    frames_digest: str | None = None
    files_state: str | None = None
    first_stored_at: UtcTime | None = None
    versions: dict[str, str] = Field(default_factory=dict)
    rows: dict[FileName, int]
    files: dict[FileName, FileModel]

    @property
    def named(self) -> str:
        """The id of what it is a run of: a scene, or an assembled panel."""
        if self.station is None:
            return PanelKey(self.aircraft_serial, self.panel).panel_id
        return SceneKey(self.aircraft_serial, self.panel, self.station, self.captured_at).scene_id

    @property
    def head_table(self) -> str:
        """The table that has one row for the run."""
        return SCENES.name if self.station else PANELS.name

    @property
    def table_files(self) -> list[str]:
        """Its tables, which are those of the version that wrote it."""
        return [f"{table}.parquet" for table in self.rows]


def document_hash(document: Mapping[str, Any]) -> str:
    """A short name of a document's content."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def encode(reconstruction: Reconstruction, preview: NDArray[np.uint8]) -> dict[str, bytes]:
    """The largest files of a bundle, which depend on nothing that is measured in the scene."""
    return {CLOUD: encode_cloud(reconstruction), PREVIEW: png.encode(preview)}


def write_bundle(
    folder: Path,
    run_id: str,
    final_path: str,
    result: InspectionResult,
    first_stored_at: datetime | None = None,
    review_head: str | None = None,
    verification: Mark | None = None,
) -> None:
    """Write and sync a run's files into an empty folder; manifest.json comes last.

    Parameters
    ----------
    final_path : str
        Where the folder will lie, relative to the store.
    first_stored_at : datetime, optional
        When the scene's first run was stored; now, where this is the first one.
    review_head : str, optional
        Number and checksum of the last entry of the review log.
    verification : Mark, optional
        The rig's last verification.
    """
    first_stored_at = first_stored_at or datetime.now(UTC)
    tables = result_tables(result, run_id, final_path, first_stored_at)
    encoded = dict(result.encoded) or encode(result.reconstruction, result.preview)
    if OVERLAY not in encoded:
        encoded[OVERLAY] = png.encode(result.overlay.image())
    for name, content in encoded.items():
        (folder / name).write_bytes(content)
    (folder / OVERLAY_SVG).write_text(result.overlay.svg(), encoding="utf-8")
    (folder / RIG).write_text(json.dumps(result.rig_document, indent=1), encoding="utf-8")
    if result.pattern:
        text = pattern_toml(result.pattern, result.key.panel, "enrolled", result.key.scene_id)
        (folder / PATTERN).write_text(text, encoding="utf-8")
    write_fits(folder / FITS, result.features)
    for name, table in tables.items():
        # A dictionary of each column takes longer and more room than so few rows.
        pq.write_table(table, folder / f"{name}.parquet", compression="zstd", use_dictionary=False)
    manifest = {
        "format": FORMAT,
        "run_id": run_id,
        **_key_document(result.key),
        "operator": result.operator,
        "config_hash": result.config_hash,
        "rig_hash": document_hash(result.rig_document),
        "rig": result.reconstruction.rig.id,
        "frames_digest": result.reconstruction.frames_digest,
        "files_state": result.files_state,
        "first_stored_at": utc_text(first_stored_at),
        "review_head": review_head,
        "verification": verification.model_dump() if verification else None,
        "settings": result.settings,
        "panel_spec": result.panel_spec,
        "registration": result.registration,
        "versions": result.versions,
        "seconds": result.seconds,
        "warnings": list(result.warnings),
        "outside_overlay": list(result.overlay.outside),
        "rows": {name: table.num_rows for name, table in tables.items()},
    }
    seal(folder, manifest)


def seal(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Bring a run's files onto the disk and write its manifest, with their sizes and checksums, last."""
    files = sorted(folder.iterdir())

    def settle(path: Path) -> dict[str, Any]:
        protect(path)
        sync(path)
        return {"bytes": path.stat().st_size, "sha256": sha256(path)}

    # The disk takes several files at a time, and a file is summed up while others are written.
    with ThreadPoolExecutor(_AT_A_TIME) as workers:
        listed = dict(zip((path.name for path in files), workers.map(settle, files), strict=True))
    text = json.dumps({**manifest, "files": listed}, indent=1, ensure_ascii=False)
    write_durably(folder / MANIFEST, text.encode())
    protect(folder / MANIFEST)


def read_manifest(bundle: Path) -> BundleModel:
    """The manifest of a bundle."""
    return validate(BundleModel, read_json(bundle / MANIFEST, StoreError), bundle / MANIFEST, StoreError)


def check_bundle(bundle: Path, only_tables: bool = False) -> BundleModel:
    """Compare a bundle's files with its manifest; the first damaged one is named.

    Parameters
    ----------
    only_tables : bool
        Look at the tables alone, which is what the index is made from.
    """
    manifest = read_manifest(bundle)
    if bundle.name != manifest.run_id or {bundle.parent.name, manifest.named} != {manifest.scene_id}:
        raise StoreError(
            f"{bundle / MANIFEST}: found run {manifest.run_id!r} of {manifest.scene_id!r}, expected the folder's"
        )
    wanted = manifest.table_files
    if missing := sorted({f"{manifest.head_table}.parquet", *wanted} - set(manifest.files)):
        raise StoreError(f"{bundle / MANIFEST}: found no {missing[0]} listed, expected every table of the run")
    if manifest.format != (FORMAT if manifest.station else PANEL_FORMAT):
        raise StoreError(
            f"{bundle / MANIFEST}: found format {manifest.format!r} for {manifest.scene_id!r}, expected the other"
        )
    for name in wanted if only_tables else manifest.files:
        check_file(bundle / name, manifest)
    return manifest


def check_file(path: Path, manifest: BundleModel) -> Path:
    """The file of a bundle, refused where it is not as the manifest lists it."""
    stated = manifest.files.get(path.name)
    if stated is None:
        raise StoreError(f"{path.parent / MANIFEST}: found no {path.name} listed, expected it")
    if path.is_symlink() or not path.is_file():
        found = "a link" if path.is_symlink() else "no such file"
        raise StoreError(f"{path}: found {found}, expected a file as the manifest lists it")
    if (size := path.stat().st_size) != stated.bytes:
        raise StoreError(f"{path}: found {size} bytes, expected {stated.bytes} as the manifest says")
    if (found := sha256(path)) != stated.sha256:
        raise StoreError(f"{path}: found checksum {found[:12]}…, expected {stated.sha256[:12]}… as the manifest says")
    return path


def sound_file(path: Path) -> Path:
    """The file of a bundle, compared with the bundle's manifest: what is shown on the skin is that scan's own."""
    return check_file(path, read_manifest(path.parent))


def result_tables(
    result: InspectionResult, run_id: str, bundle_path: str, first_stored_at: datetime
) -> dict[str, pa.Table]:
    """A result's rows of every table."""
    key = {**asdict(result.key), "scene_id": result.key.scene_id}
    rows = {
        SCENES.name: [key | _scene_row(result, run_id, bundle_path, first_stored_at)],
    }
    for kind in KINDS:
        found = result.features.get(kind.name, ())
        rows[kind.table] = [key | {field.name: getattr(row, field.name) for field in fields(row)} for row in found]
    return as_tables(SCENE_TABLES, rows)


def as_tables(tables: Sequence[Table], rows: Mapping[str, Sequence[Mapping[str, Any]]]) -> dict[str, pa.Table]:
    """Rows by table as they are stored: numbers rounded, columns that a table does not have left out."""
    return {
        table.name: pa.Table.from_pylist(
            [{name: _plain(name, value) for name, value in row.items()} for row in rows[table.name]],
            table.arrow_schema,
        )
        for table in tables
    }


def _scene_row(result: InspectionResult, run_id: str, bundle_path: str, first_stored_at: datetime) -> dict[str, Any]:
    valid = result.reconstruction.valid
    # One point in sixteen gives the median to a thousandth.
    sigma = result.reconstruction.sigma_z[::4, ::4][valid[::4, ::4]]
    spec, registration = result.panel_spec, result.registration
    missing, unlisted = registration.get("missing", ()), registration.get("unlisted", ())
    return {
        "run_id": run_id,
        "rig_id": result.reconstruction.rig.id,
        "operator": result.operator,
        "processed_at": datetime.now(UTC),
        "first_stored_at": first_stored_at,
        "frames_digest": result.reconstruction.frames_digest,
        "files_state": result.files_state,
        "software_version": result.versions.get("flushline"),
        "config_hash": result.config_hash,
        "rig_hash": document_hash(result.rig_document),
        "panel_spec": " ".join(str(spec[part]) for part in ("panel", "revision") if spec.get(part)) or None,
        "status": "warnings" if result.warnings else "ok",
        "warnings": list(result.warnings),
        "n_points": int(valid.sum()),
        "valid_fraction": float(valid.mean()),
        "sigma_z_median_mm": float(np.median(sigma)) if sigma.size else None,
        "epipolar_rms_px": result.epipolar_rms_px,
        "projector_rms_px": result.projector_rms_px,
        "rig_verdict": result.rig_verdict,
        **counted(result.features),
        "registration": registration.get("status"),
        "n_missing": len(missing),
        "n_unlisted": len(unlisted),
        "registration_rms_mm": registration.get("rms_mm"),
        "rig_shift_mm": registration.get("shift_mm"),
        "rig_turn_deg": registration.get("turn_deg"),
        **{f"seconds_{step}": result.seconds.get(step) for step in TIMED},
        "seconds_total": result.seconds.get("total"),
        "bundle_path": bundle_path,
        "cloud_path": f"{bundle_path}/{CLOUD}",
        "overlay_path": f"{bundle_path}/{OVERLAY}",
        "preview_path": f"{bundle_path}/{PREVIEW}",
    }


def _plain(name: str, value: object) -> object:
    """NumPy numbers as Python's, rounded by their unit; what is not finite is not a measurement."""
    if isinstance(value, np.generic):
        value = value.item()
    if not isinstance(value, float):
        return value
    return round(value, _DIGITS.get(name.rpartition("_")[2], 6)) if math.isfinite(value) else None


def _key_document(key: SceneKey) -> dict[str, str]:
    return {
        "aircraft_serial": key.aircraft_serial,
        "panel": key.panel,
        "station": key.station,
        "captured_at": utc_text(key.captured_at),
        "scene_id": key.scene_id,
    }
