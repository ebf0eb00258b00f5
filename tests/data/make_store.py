"""Make a small store with the version at hand, to be kept: later versions must show all that is in it.

    python tests/data/make_store.py tests/data/store-0.1.0

writes store-0.1.0.tar.xz, the store, and store-0.1.0.json, what it holds. Once checked in, such a pair is never made
again: it stands for the stores that people have.
"""

from __future__ import annotations

import contextlib
import json
import sys
import tarfile
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

from metrology.inspection import InspectionResult
from metrology.panel import NominalRivet, PanelLayout
from metrology.results import SceneKey
from storage.archive import Store
from storage.archive.decisions import dispose, shown_finding, sign_off_all
from storage.archive.schema import TABLES
from storage.archive.work import standings
from storage.review import Disposition, Feature, ReviewLog, ShownScene
from storage.review_details import Numbers, Signature
from storage.saved_queries import SavedQueries
from tests.support.results import small_key, small_result, small_rig

PANEL_SPEC = 'format = "flushline-panel/1"\npanel = "LH-F12"\nrevision = "B"\n'
PATTERN = PanelLayout((NominalRivet("R1", (1.0, 2.0, 0.0)), NominalRivet("R2", (5.0, 2.0, 0.0))))


def main(target: Path) -> None:
    """Make the store, pack it, and write down what it holds."""
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder) / "store")
        fill(store)
        held = json.dumps(contents(store), indent=1, ensure_ascii=False)
        target.with_name(f"{target.name}.json").write_text(held + "\n", encoding="utf-8")
        with tarfile.open(target.with_name(f"{target.name}.tar.xz"), "w:xz", preset=9) as tar:
            tar.add(store.root, "store", filter=_nobody)


def fill(store: Store) -> None:
    """Four scenes of two aircraft; one inspected twice, one a pattern, one decided about, one signed off."""
    store.add_rig(small_rig())
    spec = store.root.with_name("spec.toml")
    spec.write_text(PANEL_SPEC)
    store.panels.add(spec)
    store.publish(replace(result(small_key("S1"), 0.02), pattern=PATTERN))
    signed = small_key("S2")
    signed_run = store.publish(result(signed, 0.04))
    decided = small_key("S1", "MSN-2")
    store.publish(result(decided, 0.15))
    twice = small_key("S2", "MSN-2", "RH-F03")
    store.publish(result(twice, 0.31))
    store.publish(replace(result(twice, 0.27), warnings=("gap beside the rig's range",)))
    rivet, place = Feature("rivet", "R2"), Feature("seam station", "M1@0.0")
    decide(store, "m.weber", decided, [rivet, place], "rework", "flush it – „nach“ 3.2")
    decide(store, "k.ito", decided, [rivet], "use as is")
    with contextlib.closing(store.connect()) as connection:
        waiting = [s.feature for s in standings(connection, ReviewLog(store.root).read(), signed.scene_id)]
    decide(store, "k.ito", signed, waiting, "use as is")
    signature = Signature(role="reviewer", meaning="every finding is decided", confirmed="given name")
    seen = ShownScene(signed.scene_id, signed_run, {"rivets": 3}, len(waiting) + 3)
    sign_off_all(store.root, "k.ito", [seen], "all seen", signature)
    decide(store, "m.weber", decided, [place], "repair", "again", Numbers(part_number="MS20470", work_order="WO-9"))
    log = ReviewLog(store.root)
    log.mark_missed("k.ito", ShownScene(decided.scene_id, "run"), "beside the frame", (12.0, 7.5))
    log.unmark("k.ito", decided.scene_id, log.head().number, "a shadow")
    SavedQueries(store.root).save("grave ones", "SELECT * FROM worst_rivets")


def decide(
    store: Store, who: str, key: SceneKey, features: Sequence[Feature], disposition: Disposition, comment: str = "",
    numbers: Numbers | None = None,
) -> None:  # fmt: skip
    """Decide about findings of a scene as it shows them."""
    review = ReviewLog(store.root).read()
    with contextlib.closing(store.connect()) as connection:
        shown = [shown_finding(connection, review, key.scene_id, feature) for feature in features]
    dispose(store.root, who, [finding for finding in shown if finding], disposition, comment, numbers)


def result(key: SceneKey, height_mm: float) -> InspectionResult:
    """A scene whose rivets differ: one passes, one fails, one is not measured."""
    made = small_result(key, height_mm)
    first, second, third = made.features["rivet"]
    second = replace(second, height_mean_mm=height_mm + 0.002, severity="red", decision="fail", reason="too proud")
    third = replace(third, height_mean_mm=None, height_u95_mm=None, decision="not measured", reason="too dark")
    return replace(made, features={**made.features, "rivet": (first, second, third)})


def contents(store: Store) -> dict[str, Any]:
    """Rows of every table, what was decided, saved queries and panels, as JSON has them."""
    document = {
        "tables": {table.name: store.query(f"FROM {table.name} ORDER BY ALL").to_pylist() for table in TABLES},
        "review": [{**entry._asdict(), "at": entry.at} for entry in ReviewLog(store.root).read().entries],
        "queries": SavedQueries(store.root).read(),
        "patterns": {name: store.panels.stations(name) for name in store.panels.names()},
        "specifications": {
            name: [version.path.read_text(encoding="utf-8") for version in store.panels.versions(name)]
            for name in store.panels.names()
        },
        "points": {
            row["scene_id"]: int((store.load_cloud(row["scene_id"]).flags == 0).sum())
            for row in store.query("SELECT scene_id FROM scenes ORDER BY ALL").to_pylist()
        },
    }
    found: dict[str, Any] = json.loads(json.dumps(document, default=str))
    return found


def _nobody(entry: tarfile.TarInfo) -> tarfile.TarInfo:
    entry.uid = entry.gid = 0
    entry.uname = entry.gname = ""
    return entry


if __name__ == "__main__":
    main(Path(sys.argv[1]))
