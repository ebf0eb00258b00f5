"""Scans of a simulated panel in a store, as the inspection leaves them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrology.assembly.scan import STRIDE, PanelScan
from metrology.cloud import DecodedView, Reconstruction
from metrology.inspection import InspectionResult
from metrology.kinds import BY_NAME
from metrology.tolerance import judge
from storage.archive import Store
from storage.panel_spec import load_panel_spec
from storage.rig import rig_document
from tests.support.panel_scans import RIG
from tests.support.results import small_result


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
