"""Putting panels together from the command line, and after the inspection of their scans."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from flows.cli import counted
from metrology.assembly.result import PanelResult
from metrology.kinds import KINDS
from metrology.results import PanelKey
from storage.archive import Store
from storage.panel_spec import PanelSpecification
from tasks.panel import assemble


def assemble_and_publish(store: Store, keys: Iterable[PanelKey], spec: PanelSpecification | None = None) -> None:
    """Assemble panels one after the other, store them and say what they are."""
    for key in keys:
        result = assemble(store, key, spec)
        store.publish_panel(result)
        print(describe(result))


def describe(result: PanelResult) -> str:
    """An assembled panel in a few lines."""
    parts = [
        "+".join(result.assembly.scans[number].key.station for number in part.numbers) for part in result.assembly.parts
    ]
    found = []
    for kind in KINDS:
        rows = [feature.row for feature in result.features[kind.name]]
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
