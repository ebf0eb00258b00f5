"""Rivets of a scan: rings in the left image whose shape the surface bears out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrology.arrays import Array
from metrology.cloud import Reconstruction
from metrology.results import RivetDetection
from metrology.rivets.confirm import UNTOLD, confirm_rings
from metrology.rivets.ellipse import Ellipse
from metrology.rivets.ellipse_detection import Ring, detect_ellipses
from metrology.rivets.geometry import nearby_plane
from metrology.rivets.ground import Ground, ground_of
from metrology.rivets.recess import is_recess
from metrology.rivets.relief import Disc, on_skin, shows_in_texture
from metrology.rivets.rim_step import rim_step, steps_up
from metrology.rivets.ring import ellipse_of_inverse
from metrology.rivets.settings import RivetSettings


def detect_rivets(
    reconstruction: Reconstruction,
    settings: RivetSettings | None = None,
    ground: Ground | None = None,
    holes: Sequence[Ellipse] = (),
) -> list[RivetDetection]:
    """Find the rivet heads of a scan.

    The cloud tells how large heads look and what ellipse a circle on the skin makes where; rings of that size and shape
    are looked for in the left texture.

    Parameters
    ----------
    ground : Ground
        See `ground_of`; found where it is not given.
    holes : sequence of Ellipse
        Where there is no head, whatever ring shows, unless it is a head's recess.

    Returns
    -------
    list of RivetDetection
        In reading order: rows from the top, each from the left. What may be no rivet has a doubt.
    """
    settings = settings or RivetSettings()
    ground = ground or ground_of(reconstruction, settings)
    texture = reconstruction.left.texture
    if ground is None:
        rings = [r for r in detect_ellipses(texture, settings) if r.quality >= settings.sure_quality]
        return _in_reading_order([_detection(ring, reconstruction, UNTOLD) for ring in rings])
    heads = ground.discs if settings.plain_heads else []
    rings = detect_ellipses(texture, settings, ground.shapes, ground.radii, [h.ellipse for h in heads])
    rings = [r for r in rings if all(not r.ellipse.meets(h) or is_recess(h, r.ellipse, reconstruction) for h in holes)]
    confirmed = confirm_rings(rings, reconstruction, settings)
    found = [_detection(c.ring, reconstruction, c.doubt) for c in confirmed]
    if settings.plain_heads:
        taken = [*holes, *(c.ring.ellipse for c in confirmed)]
        free = [h for h in heads if not any(h.ellipse.meets(other) for other in taken)]
        found += [_plain_detection(head, reconstruction) for head in free if _is_plain(head, reconstruction)]
    return _in_reading_order(found)


def _is_plain(disc: Disc, reconstruction: Reconstruction) -> bool:
    """Whether a disc is a head under paint: its border steps and does not show in the picture."""
    if not on_skin(reconstruction, disc.ellipse) or shows_in_texture(reconstruction.left.texture, disc.ellipse):
        return False
    return steps_up(disc.height_mm, rim_step(reconstruction, disc.ellipse))


def _in_reading_order(detections: list[RivetDetection]) -> list[RivetDetection]:
    return [detections[i] for i in reading_order(detections)]


def reading_order(detections: list[RivetDetection]) -> list[int]:
    """Indices of detections row by row: a row goes on while the centres are within one diameter of its first's."""
    if not detections:
        return []
    by_height = sorted(range(len(detections)), key=lambda i: (detections[i].v_px, detections[i].u_px))
    size = float(np.median([d.major_px for d in detections]))
    rows: list[list[int]] = []
    for i in by_height:
        if not rows or detections[i].v_px - detections[rows[-1][0]].v_px > size:
            rows.append([])
        rows[-1].append(i)
    return [i for row in rows for i in sorted(row, key=lambda i: (detections[i].u_px, detections[i].v_px))]


def _detection(ring: Ring, reconstruction: Reconstruction, doubt: str | None = None) -> RivetDetection:
    e = ring.ellipse
    right = _in_right_camera(e, reconstruction)
    return RivetDetection(
        u_px=e.u,
        v_px=e.v,
        major_px=2 * e.a,
        minor_px=2 * e.b,
        angle_deg=float(np.degrees(e.angle)),
        confidence=confidence(ring.quality),
        covariance=_axes_covariance(ring),
        u_right_px=right[0] if right else None,
        v_right_px=right[1] if right else None,
        rim_sigma_px=ring.fit.sigma_px,
        doubt=doubt,
    )


def _plain_detection(head: Disc, reconstruction: Reconstruction) -> RivetDetection:
    """A head seen in the height map only, where its place is good to about a pixel."""
    e = head.ellipse
    right = _in_right_camera(e, reconstruction)
    place = 1.0
    return RivetDetection(
        u_px=e.u,
        v_px=e.v,
        major_px=2 * e.a,
        minor_px=2 * e.b,
        angle_deg=float(np.degrees(e.angle)),
        confidence=confidence(0.5 * head.significance),
        covariance=np.diag([place, place, 4 * place, 4 * place, 100.0]),
        u_right_px=right[0] if right else None,
        v_right_px=right[1] if right else None,
        found_by="relief",
    )


def confidence(quality: float) -> float:
    """0 … 1: one half at the quality below which nothing is a rivet, 0.99 where a ring stands out by 20 sigmas."""
    return float(1 - np.exp(-quality / 4.34))


def _axes_covariance(ring: Ring) -> Array:
    """(5, 5) covariance of u, v, major, minor (px) and angle (degrees) from that of the inverse shape matrix."""
    values = _axes(ring.fit.inverse)
    jacobian = np.empty((5, 5))
    for k in range(5):
        step = 1e-4 * max(abs(ring.fit.inverse[k]), abs(ring.fit.inverse[2])) if k >= 2 else 1e-3
        moved = ring.fit.inverse.copy()
        moved[k] += step
        change = _axes(moved) - values
        change[4] = (change[4] + 90) % 180 - 90
        jacobian[:, k] = change / step
    return np.asarray(jacobian @ ring.fit.covariance @ jacobian.T)


def _axes(inverse: Array) -> Array:
    e = ellipse_of_inverse(*inverse)
    return np.array([e.u, e.v, 2 * e.a, 2 * e.b, np.degrees(e.angle)])


def _in_right_camera(ellipse: Ellipse, reconstruction: Reconstruction) -> tuple[float, float] | None:
    """Where the right camera sees the circle's centre, through the plane of the points about it."""
    right = reconstruction.rig.right
    plane = nearby_plane(reconstruction, ellipse) if right else None
    if right is None or plane is None:
        return None
    frame, x, y = plane
    pixel = right.project(frame.rig([x, y, 0.0]))
    return float(pixel[0]), float(pixel[1])
