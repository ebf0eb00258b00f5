"""The steps of a panel's assembly, each a plain function: load, call metrology, save."""

from __future__ import annotations

from metrology.assembly.assemble import assembled
from metrology.assembly.carried import remembered, with_frames
from metrology.assembly.coverage import coverage
from metrology.assembly.panel import panel_features
from metrology.assembly.picture import stitched
from metrology.assembly.result import PanelResult
from metrology.assembly.verdict import judgement
from metrology.errors import StoreError
from metrology.results import PanelKey
from storage.archive import Store
from storage.archive.bundle import MANIFEST
from storage.archive.panel_history import former_assembly
from storage.archive.panel_scans import newest_scans
from storage.documents import read_json
from storage.panel_spec import PanelSpecification, load_panel_spec, panel_spec_from
from tasks.result import versions


def assemble(store: Store, key: PanelKey, spec: PanelSpecification | None = None) -> PanelResult:
    """Put a panel together from the newest scans of its stations; nothing is stored.

    Parameters
    ----------
    spec : PanelSpecification, optional
        By default what is in force for the panel or, where nothing is, what its newest scan was judged by.
    """
    spec = spec or store.panels.in_force(key.panel) or _judged_by(store, key)
    found = newest_scans(store, key, spec.layout)
    former = former_assembly(store, key)
    assembly = with_frames(assembled([each.scan for each in found], spec.layout), spec.layout, former)
    warnings = list(assembly.warnings)
    if spec.example:
        warnings.append("judged by the example limits, which are nobody's requirement; put a specification in force")
    features = panel_features(assembly, spec.limits, spec.layout, former)
    covered = coverage(assembly, features, spec.layout)
    gaps = [*covered.gaps]
    gaps += [f"in {len(assembly.parts)} parts"] if len(assembly.parts) > 1 else []
    gaps += [f"{assembly.scans[k].key.station} left out" for k in assembly.left_out]
    rows = {name: [feature.row for feature in of_kind] for name, of_kind in features.items()}
    return PanelResult(
        key=key,
        assembly=assembly,
        runs={each.scan.key: each.run_id for each in found},
        features=features,
        judgement=judgement(rows, spec.limits, spec.rules, spec.layout, covered.area_mm2, gaps),
        coverage=covered,
        panel_spec=spec.document,
        spec_name=str(spec),
        warnings=tuple(warnings),
        versions=versions(),
        remembered=remembered(assembly, features, former),
        pictures=tuple(stitched(assembly, {k: each.texture for k, each in enumerate(found)})),
    )


def _judged_by(store: Store, key: PanelKey) -> PanelSpecification:
    """The specification of the newest scan; the example where it has none."""
    newest = store.query(
        "SELECT bundle_path FROM latest_scenes WHERE aircraft_serial = ? AND panel = ? "
        "ORDER BY captured_at DESC LIMIT 1",
        [key.aircraft_serial, key.panel],
    ).to_pylist()
    for row in newest:
        manifest = read_json(store.file(f"{row['bundle_path']}/{MANIFEST}"), StoreError)
        if manifest.get("panel_spec"):
            return panel_spec_from(manifest["panel_spec"], store.root)
    return load_panel_spec()
