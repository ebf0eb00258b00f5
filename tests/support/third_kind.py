"""Inspects a scene with a further kind of feature and writes where it turned up; a process of its own declares it."""

from __future__ import annotations

import contextlib
import json
import sys
import tarfile
from pathlib import Path
from typing import Any

from metrology import kinds
from tests.support.marks import KIND

kinds.KINDS = (*kinds.KINDS, KIND)
kinds.BY_NAME[KIND.name] = KIND
kinds.LIMITS.update({limit.name: limit for quantity in KIND.quantities for limit in quantity.limits})

from dashboard.data import Archive  # noqa: E402
from dashboard.figures.scene import scene_figure  # noqa: E402
from dashboard.findings import (  # noqa: E402
    Selection,
    Wanted,
    feature_from_parameter,
    feature_parameter,
    findings,
)
from dashboard.locale import Locale  # noqa: E402
from dashboard.pictures import load_picture  # noqa: E402
from dashboard.scenes import load_features, load_scene_row, requirements, worst_feature  # noqa: E402
from dashboard.trends import QUANTITIES, SUBJECTS, Subject, series  # noqa: E402
from flows.inspect_many import describe  # noqa: E402
from flows.inspect_scene import Job, inspect_scene  # noqa: E402
from metrology import overlay  # noqa: E402
from storage.archive import Store  # noqa: E402
from storage.archive.decisions import dispose, shown_finding  # noqa: E402
from storage.archive.work import standings  # noqa: E402
from storage.panel_spec import load_panel_spec  # noqa: E402
from storage.report import scene_page, scene_record  # noqa: E402
from storage.review import Feature, Review, ReviewLog  # noqa: E402
from storage.rig import save_rig  # noqa: E402
from tasks.settings import InspectionSettings  # noqa: E402
from tests.support.results import small_key, small_rig  # noqa: E402
from tests.support.small_scene import fake_metrology_in, write_small_scene  # noqa: E402

SPEC = """
format = "flushline-panel/1"
panel = "LH-F12"
revision = "A"
[zones.default.mark_depth_mm]
lower = -0.1
upper = 0.1
serious_upper = 0.2
source = "drawing 1"
revision = "A"
"""


def old_store(data: Path, folder: Path) -> Store:
    with tarfile.open(data / "store-0.1.0.tar.xz") as tar:
        tar.extractall(folder, filter="tar")
    return Store(folder / "store")


def lost(store: Store, data: Path) -> list[dict[str, Any]]:
    """Rows that the old store had and that are not shown once each."""
    held = json.loads((data / "store-0.1.0.json").read_text(encoding="utf-8"))["tables"]
    missing = []
    for table, rows in held.items():
        shown = [json.loads(json.dumps(row, default=str)) for row in store.query(f"FROM {table}").to_pylist()]
        missing += [row for row in rows if sum({name: found.get(name) for name in row} == row for found in shown) != 1]
    return missing


def inspected(folder: Path, store: Store) -> Any:
    """A small scene, inspected with all of metrology behind its door but the overlay replaced."""
    draw = overlay.draw_overlay
    fake_metrology_in(setattr)
    overlay.draw_overlay = draw
    save_rig(small_rig(), folder / "rig.json")
    (folder / "panel.toml").write_text(SPEC, encoding="utf-8")
    scene = write_small_scene(folder / "scene", small_key("S7"))
    said: list[str] = []
    spec = load_panel_spec(folder / "panel.toml")
    job = Job(scene, store, folder / "rig.json", InspectionSettings(), spec)
    return inspect_scene(job, on_step=said.append), said


def main(data: Path, folder: Path) -> dict[str, Any]:
    store = old_store(data, folder)
    found: dict[str, Any] = {"lost before": lost(store, data), "rows before": store.query("FROM test_marks").num_rows}
    result, steps = inspected(folder, store)
    scene = result.key.scene_id
    rows = store.query(f"FROM test_marks WHERE scene_id = '{scene}' ORDER BY mark_id").to_pylist()
    found |= {
        "said": describe(result).splitlines()[0],
        "steps": steps,
        "decisions": [(row["mark_id"], row["decision"], row["severity"]) for row in rows],
        "in panel": [row["x_panel_mm"] is not None for row in rows],
        "counted": store.query(
            f"SELECT n_test_marks, seconds_measure_test_marks > 0 AS timed, n_rivets, n_stations FROM scenes "
            f"WHERE scene_id = '{scene}'"
        ).to_pylist()[0],
        "worst": store.query("SELECT mark_id FROM worst_test_marks").column(0).to_pylist(),
        "panel": store.query(
            "SELECT n_test_marks, n_test_marks_failing, n_seam_stations FROM panel_summary WHERE panel = 'LH-F12' "
            "AND n_test_marks IS NOT NULL"
        ).to_pylist(),
        "comment": store.query(
            "SELECT comment FROM duckdb_columns() WHERE table_name = 'test_marks' AND column_name = 'x_mm'"
        )
        .column(0)
        .to_pylist(),
        "overlay": store.paths(scene).overlay.with_suffix(".svg").read_text(encoding="utf-8"),
        "report": scene_page(scene_record(store, scene)),
        "lost after": lost(store, data),
    }
    mark = Feature(KIND.name, "T1")
    with contextlib.closing(store.connect()) as connection:
        stand = {s.feature.id: s.state for s in standings(connection, Review(), scene) if s.feature.kind == KIND.name}
        shown = shown_finding(connection, Review(), scene, mark)
    assert shown is not None
    dispose(store.root, "Ada", [shown], "use as is")
    with contextlib.closing(store.connect()) as connection:
        after = standings(connection, ReviewLog(store.root).read(), scene)
    archive = Archive(store.root)
    row = load_scene_row(archive, scene)
    features = load_features(archive, row)
    figure = scene_figure(load_picture(archive.file(row.preview_path)), features, mark, Locale())
    chosen = features[KIND.name].iloc[0]
    trend = series(archive, Subject("mark", "LH-F12", "S7", "T1"), QUANTITIES["depth"], Selection())
    return found | {
        "stand": stand,
        "decided": {s.feature.id: s.state for s in after if s.feature.kind == KIND.name},
        "listed": sorted(findings(archive, Wanted(kinds=(KIND.name,)))["feature_id"]),
        "address": feature_from_parameter(feature_parameter(mark)) == mark,
        "subjects": SUBJECTS["mark"],
        "figure": sorted({trace.name for trace in figure.data if (trace.name or "").startswith("mark")}),
        "worst feature": worst_feature(
            {
                KIND.name: features[KIND.name],
                **{k.name: features[k.name].iloc[:0] for k in kinds.KINDS if k is not KIND},
            }
        ),
        "required": [
            (r.name, r.limit.upper) for r in requirements(archive, row.bundle_path, mark, _tuple(chosen)) or ()
        ],
        "trend": trend["value"].tolist(),
    }


def _tuple(row: Any) -> Any:
    return next(row.to_frame().T.itertuples())


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]), Path(sys.argv[2])), default=str))
