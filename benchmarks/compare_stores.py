"""Whether two versions left the same in their stores: tables, views, manifests, reports and overlays.

Each version writes out its own store, then the two outcomes are compared:

    PYTHONPATH=BEFORE python benchmarks/compare_stores.py dump STORE-BEFORE OUT-BEFORE
    python benchmarks/compare_stores.py dump STORE-AFTER OUT-AFTER
    python benchmarks/compare_stores.py compare OUT-BEFORE OUT-AFTER

Times, versions, ids of runs and checksums of files that name them are left out. Columns, tables and views that only
the later one has are named and count as equal; all else that differs is shown, and the exit code is 1.
"""

from __future__ import annotations

import argparse
import difflib
import hashlib
import json
import re
from pathlib import Path
from typing import Any

from storage.archive import Store
from storage.report import panel_page, panel_record, scene_page, scene_record

_OF_A_RUN = re.compile(r"run_id|processed_at|first_stored_at|software_version|seconds_.*|.*_path|file")
_MASKS = (
    (re.compile(r"manifest SHA-256 [0-9a-f]{64}"), "MANIFEST"),
    (re.compile(r"\d{8}T\d{12}Z-\w+|run-[\w-]+|\d{8}T\d{6}\.?\d*Z-\w+"), "RUN"),
    (re.compile(r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d(\.\d+)?)?( ?UTC|Z)?"), "TIME"),
)
_PICTURES = ("*.png", "*.svg", "cloud.parquet", "pattern.toml", "rig.json")
_MOST_LINES = 30


def dump(store: Store, out: Path) -> None:
    """Write what is to be compared as text, a file for each table, view, scene and report."""
    out.mkdir(parents=True)
    for name, kind in _relations(store):
        _write(out / f"{kind}-{name}.jsonl", "\n".join(_rows(store, name)))
    scenes = store.query("SELECT scene_id, aircraft_serial, panel FROM scenes ORDER BY 1").to_pylist()
    for scene in scenes:
        bundle = store.paths(scene["scene_id"]).bundle
        pictures = {path.name: _checksum(path) for pattern in _PICTURES for path in bundle.glob(pattern)}
        manifest = json.loads((bundle / "manifest.json").read_text(encoding="utf-8"))
        manifest["files"] = {**dict.fromkeys(manifest["files"]), **pictures}
        for name in ("run_id", "seconds", "versions", "first_stored_at", "review_head", "verification"):
            manifest.pop(name, None)
        _write(out / f"manifest-{scene['scene_id']}.json", json.dumps(manifest, indent=1, sort_keys=True))
        _write(out / f"report-{scene['scene_id']}.html", _page(scene_page(scene_record(store, scene["scene_id"]))))
    for aircraft, panel in sorted({(scene["aircraft_serial"], scene["panel"]) for scene in scenes}):
        page = panel_page(panel_record(store, aircraft, panel))
        _write(out / f"report-{aircraft}-{panel}.html", _page(page))


def compare(before: Path, after: Path) -> int:
    """Print what differs; returns how many files do."""
    differing = 0
    names = {path.name for folder in (before, after) for path in folder.iterdir()}
    for name in sorted(names):
        old, new = before / name, after / name
        if not old.exists():
            print(f"{name}: only in the later one")
            continue
        if not new.exists():
            print(f"{name}: LOST")
            differing += 1
            continue
        one, other = (path.read_text(encoding="utf-8").splitlines() for path in (old, new))
        if name.endswith(".jsonl"):
            one, other = _common_columns(name, one, other)
        if one != other:
            differing += 1
            print(f"{name}: differs")
            lines = [line[:400] for line in difflib.unified_diff(one, other, lineterm="", n=0)]
            print("\n".join(f"    {line}" for line in lines[2 : 2 + _MOST_LINES]))
    print(f"{len(names)} compared, {differing} differ")
    return differing


def _relations(store: Store) -> list[tuple[str, str]]:
    rows = store.query(
        "SELECT table_name AS name, 'table' AS kind FROM duckdb_tables() WHERE schema_name = 'main' AND NOT internal "
        "UNION ALL SELECT view_name, 'view' FROM duckdb_views() WHERE schema_name = 'main' AND NOT internal ORDER BY 1"
    )
    return [(row["name"], row["kind"]) for row in rows.to_pylist()]


def _rows(store: Store, name: str) -> list[str]:
    rows = [
        {k: v for k, v in row.items() if not _OF_A_RUN.fullmatch(k)} for row in store.query(f"FROM {name}").to_pylist()
    ]
    return sorted(json.dumps(row, default=str, ensure_ascii=False) for row in rows)


def _common_columns(name: str, one: list[str], other: list[str]) -> tuple[list[str], list[str]]:
    """Both in the columns of the former, and in one order of columns and rows."""
    rows: list[list[dict[str, Any]]] = [[json.loads(line) for line in lines if line] for lines in (one, other)]
    old, new = ({column for row in part for column in row} for part in rows)
    if more := sorted(new - old) if old else []:
        print(f"{name}: more columns: {', '.join(more)}")
    first, second = (
        sorted(json.dumps({c: row[c] for c in sorted(row) if c in old}, ensure_ascii=False) for row in part)
        for part in rows
    )
    return first, second


def _page(html: str) -> str:
    """A page with a line for each element, without runs and times."""
    return html.replace("><", ">\n<")


def _write(path: Path, text: str) -> None:
    if path.suffix == ".html":
        for mask, word in _MASKS:
            text = mask.sub(word, text)
        text = re.sub(r'(seconds|"version"|flushline) [\d.]+', r"\1", text)
    path.write_text(text, encoding="utf-8")


def _checksum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def main() -> int:
    """Run the script."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("dump", "compare"):
        command = commands.add_parser(name)
        command.add_argument("first", type=Path)
        command.add_argument("second", type=Path)
    options = parser.parse_args()
    if options.command == "dump":
        dump(Store(options.first), options.second)
        return 0
    return 1 if compare(options.first, options.second) else 0


if __name__ == "__main__":
    raise SystemExit(main())
