"""flushline panel: panel specifications and the patterns that scans enrolled."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metrology.panel import PanelLayout
    from storage.panel_spec import PanelSpecification

Run = Callable[[argparse.Namespace], int]


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `panel` and its actions."""
    parser = commands.add_parser("panel", help="check, put in force or show panel specifications; enrol patterns")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)

    def add(name: str, run: Run, text: str) -> argparse.ArgumentParser:
        action = actions.add_parser(name, parents=[common], help=text, description=f"{text[:1].upper()}{text[1:]}.")
        action.set_defaults(run=run)
        return action

    checking = add("check", check, "read a specification and say what is in it")
    checking.add_argument("spec", type=Path, metavar="FILE")
    adding = add("add", put_in_force, "put a specification in force: later inspections of its panel are judged by it")
    adding.add_argument("spec", type=Path, metavar="FILE")
    adding.add_argument("--store", type=Path, required=True, metavar="DIR")
    showing = add("show", show, "what is in force for the panels of a store, and what was enrolled")
    showing.add_argument("panel", nargs="?", metavar="PANEL", help="without it all panels")
    showing.add_argument("--store", type=Path, required=True, metavar="DIR")
    enrolling = add("enrol", enrol, "take an inspected scene as the pattern of its panel and station")
    enrolling.add_argument("scene_id", metavar="SCENE_ID", help="as the table scenes has it")
    enrolling.add_argument("--store", type=Path, required=True, metavar="DIR")
    enrolling.add_argument(
        "--out", type=Path, metavar="FILE", help="write the pattern as a specification to complete, not into the store"
    )
    enrolling.add_argument("--replace", action="store_true", help="in place of the station's earlier pattern")
    assembling = add("assemble", assemble, "put the newest scans of a panel together: one frame, every feature once")
    assembling.add_argument("--store", type=Path, required=True, metavar="DIR")
    assembling.add_argument("--aircraft", metavar="SERIAL", help="without it the panels of every aircraft")
    assembling.add_argument("--panel", metavar="PANEL", help="without it all panels")
    assembling.add_argument("--panel-spec", type=Path, metavar="FILE", help="in place of the specification in force")
    listing = add("list", list_aircraft, "an aircraft's panels: done, partly or not inspected, and where to stand next")
    listing.add_argument("--store", type=Path, required=True, metavar="DIR")
    listing.add_argument("--aircraft", required=True, metavar="SERIAL")
    changing = add("changes", show_changes, "what changed since an earlier assembly, and what became of rework")
    changing.add_argument("--store", type=Path, required=True, metavar="DIR")
    changing.add_argument("--aircraft", required=True, metavar="SERIAL")
    changing.add_argument("--panel", required=True, metavar="PANEL")
    changing.add_argument("--since", metavar="TIME", help="as the assembly before names it; the last one by default")
    judging = add("judge", judge, "judge an assembled panel by another specification, without measuring again")
    judging.add_argument("--store", type=Path, required=True, metavar="DIR")
    judging.add_argument("--aircraft", required=True, metavar="SERIAL")
    judging.add_argument("--panel", required=True, metavar="PANEL")
    judging.add_argument("--panel-spec", type=Path, metavar="FILE", help="by default what is in force by now")
    importing = add("import", import_list, "a specification's pattern from a list of fasteners, CSV or XLSX")
    importing.add_argument("list", type=Path, metavar="FILE", help="one row per fastener: id, x, y, z in mm, and more")
    importing.add_argument("--seams", type=Path, metavar="FILE", help="one row per corner of a seam: id, x, y, z")
    importing.add_argument("--panel", required=True, metavar="PANEL")
    importing.add_argument("--revision", required=True, metavar="REVISION")
    importing.add_argument(
        "--column", action="append", default=[], metavar="NAME=COLUMN",
        help="what the list calls id, x, y, z, nx, ny, nz (normal), diameter, zone, row, location; may be given again",
    )  # fmt: skip
    importing.add_argument("--out", type=Path, required=True, metavar="FILE", help="specification (TOML) to complete")


def check(options: argparse.Namespace) -> int:
    """Say what a specification holds."""
    from storage.panel_spec import load_panel_spec

    print("\n".join(_described(load_panel_spec(options.spec))))
    return 0


def put_in_force(options: argparse.Namespace) -> int:
    """Keep a specification in the store as its panel's newest."""
    from storage.archive import Store

    store = Store(options.store)
    store.prepare()
    version = store.panels.add(options.spec)
    print(f"version {version.number} in force: {version.path}")
    return 0


def show(options: argparse.Namespace) -> int:
    """List panels with their specifications and enrolled stations."""
    from metrology.errors import StoreError
    from storage.archive import Store
    from storage.panel_spec import load_panel_spec

    store = Store(options.store)
    store.existing()
    panels = store.panels
    names = [options.panel] if options.panel else panels.names()
    if not names:
        raise StoreError(f"{options.store}: found no panel with a specification or an enrolled pattern")
    if unknown := sorted(set(names) - set(panels.names())):
        raise StoreError(f"{options.store}: found no panel {unknown[0]!r}, expected one of {', '.join(panels.names())}")
    for name in names:
        print(f"panel {name}")
        versions = panels.versions(name)
        for version in versions:
            spec = load_panel_spec(version.path)
            force = " (in force)" if version is versions[-1] else ""
            print(f"  version {version.number}: revision {spec.limits.revision}{force}  {version.path}")
        if not versions:
            print("  no specification: judged by what is given, or by the example limits")
        for station in panels.stations(name):
            path = panels.pattern_path(name, station)
            pattern = load_panel_spec(path)
            print(
                f"  station {station}: {_features(pattern.layout)} enrolled "
                f"from {pattern.document.get('enrolled_from', '?')}  {path}"
            )
    return 0


def enrol(options: argparse.Namespace) -> int:
    """Make a pattern of what an inspected scene found."""
    from metrology.errors import StoreError
    from storage.archive import Store
    from storage.archive.enrolment import doubts_of, pattern_of
    from storage.panel_spec import pattern_toml

    store = Store(options.store)
    key, layout = pattern_of(store, options.scene_id)
    doubts = doubts_of(store, options.scene_id)
    panel, station = key.panel, key.station
    if options.out:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(pattern_toml(layout, panel, "enrolled", options.scene_id), encoding="utf-8")
        print(options.out)
        for doubt in doubts:
            print(f"  warning: {doubt}: see to what is in the file before it is put in force")
        return 0
    if doubts:
        raise StoreError(
            f"{options.scene_id}: found that {'; '.join(doubts)}, expected a scan that can be vouched for: scan the "
            "station again, or write its pattern to a file with --out and complete it by hand"
        )
    if not store.panels.enrol(layout, panel, station, options.scene_id, options.replace):
        raise StoreError(
            f"{store.panels.pattern_path(panel, station)}: found a pattern enrolled already, expected none or --replace"
        )
    print(store.panels.pattern_path(panel, station))
    return 0


def assemble(options: argparse.Namespace) -> int:
    """Put panels together and store them."""
    from flows.assemble_panels import assemble_and_publish
    from metrology.errors import StoreError
    from storage.archive import Store
    from storage.archive.panel_scans import panels_of
    from storage.panel_spec import load_panel_spec

    store = Store(options.store)
    known = panels_of(store)
    keys = [
        key for key in known if options.aircraft in (None, key.aircraft_serial) and options.panel in (None, key.panel)
    ]
    if not keys:
        asked = " ".join(name for name in (options.aircraft, options.panel) if name) or "any panel"
        expected = ", ".join(map(str, known[:5])) or "an inspected scene"
        raise StoreError(f"{options.store}: found no scan of {asked}, expected one of: {expected}")
    assemble_and_publish(store, keys, load_panel_spec(options.panel_spec) if options.panel_spec else None)
    return 0


def list_aircraft(options: argparse.Namespace) -> int:
    """List the panels of an aircraft."""
    from flows.cli import counted
    from storage.archive import Store
    from storage.archive.aircraft import panels_of_aircraft

    for found in panels_of_aircraft(Store(options.store), options.aircraft):
        said = [found.state, counted(found.n_scans, "station"), found.verdict or "", found.missing]
        said += [f"scan next: {found.next_station}"] if found.next_station else []
        print(f"panel {found.panel}: {'; '.join(part for part in said if part)}")
    return 0


def show_changes(options: argparse.Namespace) -> int:
    """Say what changed on a panel."""
    from flows.panel_changes import changes_lines
    from metrology.results import PanelKey
    from storage.archive import Store

    print("\n".join(changes_lines(Store(options.store), PanelKey(options.aircraft, options.panel), options.since)))
    return 0


def judge(options: argparse.Namespace) -> int:
    """Judge a stored panel again."""
    from flows.assemble_panels import judge_again
    from metrology.errors import StoreError
    from metrology.results import PanelKey
    from storage.archive import Store
    from storage.panel_spec import load_panel_spec

    store = Store(options.store)
    spec = load_panel_spec(options.panel_spec) if options.panel_spec else store.panels.in_force(options.panel)
    if spec is None:
        raise StoreError(f"{options.store}: found no specification of {options.panel}, expected one or --panel-spec")
    judge_again(store, PanelKey(options.aircraft, options.panel), spec)
    return 0


def import_list(options: argparse.Namespace) -> int:
    """Write a specification with the pattern of a list."""
    from metrology.errors import UsageError
    from metrology.panel import PanelLayout
    from storage.nominal_list import read_rivets, read_seams
    from storage.panel_spec import load_panel_spec, pattern_toml

    if wrong := [text for text in options.column if "=" not in text]:
        raise UsageError(f"--column: found {wrong[0]!r}, expected NAME=COLUMN such as x='X (mm)'")
    names = dict(text.split("=", 1) for text in options.column)
    rivets = read_rivets(options.list, names)
    layout = PanelLayout(rivets, read_seams(options.seams, names) if options.seams else ())
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(pattern_toml(layout, options.panel, options.revision), encoding="utf-8")
    print("\n".join([str(options.out), *_described(load_panel_spec(options.out))]))
    return 0


def _described(spec: PanelSpecification) -> list[str]:
    lines = [f"panel {spec.limits.panel}, revision {spec.limits.revision}" + (" (example)" if spec.example else "")]
    for name, zone in spec.limits.zones.items():
        lines += [f"  zone {name}: {quantity} {limit}" for quantity, limit in zone.items()]
    layout = spec.layout
    stations = f"; stations {', '.join(layout.stations)}" if layout.stations else ""
    lines.append(f"  pattern: {_features(layout)}{stations}")
    return lines


def _features(layout: PanelLayout) -> str:
    from flows.cli import counted

    return f"{counted(len(layout.rivets), 'rivet')}, {counted(len(layout.seams), 'seam')}"
