"""Putting panels together from the command line, and after the inspection of their scans."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from flows.cli import counted, print_error
from flows.panel_changes import counted_changes
from metrology.assembly.result import PanelResult
from metrology.errors import FlushlineError
from metrology.kinds import KINDS
from metrology.results import PanelKey
from storage.archive import Store
from storage.archive.panel_bundle import panel_document
from storage.archive.panel_changes import with_changes
from storage.archive.panel_judging import judged_again, stored_rows
from storage.archive.schema import PANEL_CHANGES, PANEL_VERDICTS
from storage.panel_spec import PanelSpecification
from tasks.panel import assemble


def assemble_and_publish(store: Store, keys: Iterable[PanelKey], spec: PanelSpecification | None = None) -> None:
    """Assemble panels one after the other, store them and say what they are."""
    for key in keys:
        result = assemble(store, key, spec)
        document = with_changes(store, panel_document(result, stored_rows(store, key, PANEL_VERDICTS.name)))
        store.publish_panel(document)
        print("\n".join([describe(result), *counted_changes(document.rows[PANEL_CHANGES.name])]))


def judge_again(store: Store, key: PanelKey, spec: PanelSpecification) -> None:
    """Judge a stored panel by another specification, store it and say both verdicts."""
    document = with_changes(store, judged_again(store, key, spec))
    store.publish_panel(document)
    for row in document.rows[PANEL_VERDICTS.name][-2:]:
        print(f"panel {key} by {row['panel_spec']}: {row['verdict']}: {row['reason']}")


def assemble_after(store: Store, scene_ids: Iterable[str]) -> None:
    """Assemble the panels that newly inspected scenes are of, where these have more than one station or a pattern.

    The scenes are stored by then: what is wrong with a panel is said, and nothing else comes of it.
    """
    for key in _panels_of(store, scene_ids):
        try:
            if _is_worth_it(store, key):
                assemble_and_publish(store, [key])
        except FlushlineError as problem:
            print_error(f"panel {key}: {problem}; the scenes are stored, 'flushline panel assemble' tries again")


def _panels_of(store: Store, scene_ids: Iterable[str]) -> list[PanelKey]:
    """The panels that scenes are of, as the archive has them."""
    wanted = list(scene_ids)
    if not wanted:
        return []
    rows = store.query(
        "SELECT DISTINCT aircraft_serial, panel FROM scenes WHERE scene_id IN (SELECT unnest(?)) ORDER BY ALL", [wanted]
    )
    return [PanelKey(**row) for row in rows.to_pylist()]


def _is_worth_it(store: Store, key: PanelKey) -> bool:
    spec = store.panels.in_force(key.panel)
    if spec and (spec.rules or not spec.layout.empty):
        return True
    stations = store.query(
        "SELECT count(*) FROM latest_scenes WHERE aircraft_serial = ? AND panel = ?", [key.aircraft_serial, key.panel]
    )
    return bool(stations.column(0)[0].as_py() > 1)


def describe(result: PanelResult) -> str:
    """An assembled panel in a few lines."""
    parts = [
        "+".join(result.assembly.scans[number].key.station for number in part.numbers) for part in result.assembly.parts
    ]
    found = []
    for kind in KINDS:
        rows = [feature.row for feature in result.features[kind.name]]
        if not kind.counts_in(rows):
            continue
        decisions = ", ".join(f"{n} {d}" for d, n in Counter(row.decision for row in rows).most_common())
        found.append(counted(len(kind.names(rows)), kind.subject) + (f" ({decisions})" if decisions else ""))
    joined = f"in one frame ({parts[0]})" if len(parts) == 1 else f"in {len(parts)} parts ({', '.join(parts)})"
    lines = [f"panel {result.key} {joined}: {'; '.join(found)}"]
    lines += [f"  {result.judgement.verdict}: {result.judgement.reason}"] if result.judgement.rules else []
    if result.coverage.next_station:
        lines.append(f"  scan next: {result.coverage.next_station}")
    differences = result.difference_rows()
    if differences:
        beyond = sum(row.beyond for row in differences)
        lines.append(
            f"  measured by several scans: {counted(len(differences), 'value')}, {beyond} apart by more than U95"
        )
    return "\n".join([*lines, *(f"  warning: {warning}" for warning in result.warnings)])
