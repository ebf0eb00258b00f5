"""Holes in a panel's pattern: one where the pattern has a rivet, open or filled, is a missing fastener."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrology.panel import NominalRivet
from metrology.results import MISSING, Hole, Rivet

_SAME_PLACE = 0.5  # diameters between a hole and a nominal place
_LEAST_MM = 2.0  # the same for small ones: holes are drilled by hand


def missing_fasteners(holes: Sequence[Hole], missing: Sequence[NominalRivet]) -> list[Hole]:
    """The holes, those named at which a rivet of the pattern was expected and not found.

    Parameters
    ----------
    holes : sequence of Hole
        In panel coordinates where the panel was recognised.
    """
    return [_named(hole, missing) for hole in holes]


def _named(hole: Hole, missing: Sequence[NominalRivet]) -> Hole:
    if hole.kind not in ("open hole", "filled hole") or hole.x_panel_mm is None or not missing:
        return hole
    here = np.array([hole.x_panel_mm, hole.y_panel_mm, hole.z_panel_mm], float)
    nearest = min(missing, key=lambda nominal: float(np.linalg.norm(here - nominal.position)))
    reach = max(_SAME_PLACE * (nearest.diameter_mm or hole.diameter_mm or 0.0), _LEAST_MM)
    if np.linalg.norm(here - nearest.position) > reach:
        return hole
    return replace(
        hole,
        kind="missing fastener",
        decision="no limit",
        fastener_id=nearest.rivet_id,
        zone=nearest.zone,
        reason=f"missing fastener {nearest.rivet_id}: {_said(hole)}",
    )


def _said(hole: Hole) -> str:
    """What is there, as `missing_fasteners` found or named it."""
    if hole.kind == "missing fastener":
        return (hole.reason or "").split(": ", 1)[-1]
    return hole.kind if hole.diameter_mm is None else f"{hole.kind} of {hole.diameter_mm:.1f} mm"


def explained(rivets: Sequence[Rivet], holes: Sequence[Hole]) -> list[Rivet]:
    """The rivets, missing ones with the hole that is in their place."""
    at = {hole.fastener_id: hole for hole in holes if hole.kind == "missing fastener"}
    return [
        replace(rivet, reason=f"{MISSING}: {_said(at[rivet.rivet_id])} ({at[rivet.rivet_id].hole_id})")
        if rivet.is_missing and rivet.rivet_id in at
        else rivet
        for rivet in rivets
    ]
