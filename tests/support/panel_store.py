"""Scans of a simulated panel in a store, as the inspection leaves them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from flows.assemble_panels import assemble_and_publish
from metrology.assembly.scan import STRIDE, PanelScan
from metrology.cloud import DecodedView, Reconstruction
from metrology.inspection import InspectionResult
from metrology.kinds import BY_NAME
from metrology.results import PanelKey
from metrology.tolerance import judge
from storage.archive import Store
from storage.panel_spec import load_panel_spec
from storage.rig import rig_document
from tests.support.panel_scans import RIG, SimulatedPanel, facing
from tests.support.results import small_result

FIELDS = (-220.0, 0.0, 220.0)  # middles of the stations, mm


def result_of(scan: PanelScan) -> InspectionResult:
    """A scan as the inspection leaves it, its features judged by the example limits."""
    points = scan.skin.points.repeat(STRIDE, 0).repeat(STRIDE, 1)
    sigma = scan.skin.sigma.repeat(STRIDE, 0).repeat(STRIDE, 1)
    grey = np.full(sigma.shape, 90, np.float32)
    flags = np.zeros(sigma.shape, np.uint16)
    view = DecodedView(grey, grey, grey, grey, flags)
    spec = load_panel_spec()
    features = {name: tuple(judge(BY_NAME[name], rows, spec.limits)) for name, rows in scan.features.items()}
    return replace(
        small_result(scan.key), reconstruction=Reconstruction(RIG, view, view, points, sigma, flags),
        features=features, preview=np.full(sigma.shape, 90, np.uint8), rig_document=rig_document(RIG),
        panel_spec=spec.document,
    )  # fmt: skip


def published(store: Store, scans: Sequence[PanelScan]) -> Store:
    for scan in scans:
        store.publish(result_of(scan))
    return store


def two_nights(root: Path) -> Store:
    """MSN-1 P, put together on two nights: N10, which stood proud, was set; another head stands prouder than before."""
    rng = np.random.default_rng(0)
    panel = SimulatedPanel.made(rng, 15, (-62.0, 74.0))
    store = Store(root)
    for day, heights in ((20, {4: 0.2, 20: 0.15}), (21, {4: 0.0, 20: 0.19})):
        changed = replace(panel, heights=np.clip(panel.heights, -0.08, 0.08))
        for head, height in heights.items():
            changed.heights[head] = height
        scans = [changed.seen(facing(x, 0.0, rng)[0], f"S{k}", rng, listed=True) for k, x in enumerate(FIELDS, 1)]
        published(
            store, [replace(s, key=replace(s.key, captured_at=s.key.captured_at.replace(day=day))) for s in scans]
        )
        assemble_and_publish(store, [PanelKey("MSN-1", "P")])
    return store
