"""How bright a place of the panel is: paint, sky, the projector's light and its lobe."""

from __future__ import annotations

import math
from typing import NamedTuple

from simulator.cast import lit
from simulator.compiled import kernel
from simulator.relief import (
    BACKGROUND,
    BEAD,
    CABLE,
    FLOOR,
    HEAD,
    HOLE,
    PLATE,
    R_HEAD_REFLECTANCE,
    R_OUTER,
    R_RADIUS,
    R_RING_DEPTH,
    R_RING_REFLECTANCE,
    RING,
    S_CHAMFER,
    S_DEPTH,
    S_EDGE_REFLECTANCE,
    S_FILLED,
    S_FLOOR_REFLECTANCE,
    SLOT,
    WIDTH,
    broken,
    circle,
    exists,
    lateral,
    piece_height,
    table,
)  # fmt: skip

OFF = 1e-6  # mm off the surface, where its shadow rays start


class Light(NamedTuple):
    """What the shading needs.

    brightness : grey levels of a white matt surface facing the projector at `distance_mm`, at exposure 1.
    ambient : grey levels of a white matt surface in the ambient light alone.
    specular, roughness : weight and width (GGX α) of the lobe.
    background, wall : reflectances of what lies behind the panel and of the walls of gaps.
    """

    brightness: float
    distance_mm: float
    ambient: float
    specular: float
    roughness: float
    background: float
    wall: float


@kernel
def reflectance_at(values, origin, texel, x, y):  # type: ignore[no-untyped-def]
    """Bilinear look-up, clamped at the rim."""
    u = min(max((x - origin[0]) / texel, 0.0), values.shape[1] - 1.001)
    v = min(max((y - origin[1]) / texel, 0.0), values.shape[0] - 1.001)
    i, j = int(v), int(u)
    a, b = v - i, u - j
    top = (1.0 - b) * values[i, j] + b * values[i, j + 1]
    bottom = (1.0 - b) * values[i + 1, j] + b * values[i + 1, j + 1]
    return (1.0 - a) * top + a * bottom


@kernel
def _paint(relief, light, kind, index, sides, wall, x, y):  # type: ignore[no-untyped-def]
    """How a piece's own reflectance compares with the skin's."""
    if wall:
        return light.wall
    if kind == BACKGROUND:
        return light.background
    if kind in (HEAD, SLOT):
        return relief.rivets[index, R_HEAD_REFLECTANCE]
    if kind in (RING, HOLE):
        return relief.rivets[index, R_RING_REFLECTANCE]
    if kind in (FLOOR, CABLE, BEAD):
        return relief.seams[index, S_FLOOR_REFLECTANCE]
    if kind == PLATE:
        for s in range(relief.seams.shape[0]):
            if relief.seams[s, S_CHAMFER] > 0.0 and exists(relief, s, sides):
                t, xi = lateral(relief, s, x, y)
                near = abs(t) < 0.5 * table(relief, s, WIDTH, xi)[0] + relief.seams[s, S_CHAMFER]
                if near and broken(relief, s, t, xi):
                    return relief.seams[s, S_EDGE_REFLECTANCE]
    return 1.0


@kernel
def _sky(relief, kind, index, x, y):  # type: ignore[no-untyped-def]
    """Share of the ambient light that reaches the floor of a gap: view factor of a long slot's opening."""
    if kind == FLOOR and relief.seams[index, S_FILLED] == 0.0:
        t, xi = lateral(relief, index, x, y)
        half, depth = 0.5 * table(relief, index, WIDTH, xi)[0], relief.seams[index, S_DEPTH]
        a, b = half - t, half + t
        return 0.5 * (a / math.hypot(a, depth) + b / math.hypot(b, depth))
    if kind == RING:
        rivet = relief.rivets[index]
        a = max(math.sqrt(circle(rivet, True, x, y)) - rivet[R_RADIUS], 0.0)
        b = max(rivet[R_OUTER] - math.sqrt(circle(rivet, False, x, y)), 0.0)
        depth = rivet[R_RING_DEPTH]
        return 0.5 * (a / math.hypot(a, depth) + b / math.hypot(b, depth)) if depth > 0.0 else 1.0
    return 1.0


@kernel
def _normal(relief, kind, index, sides, p, out):  # type: ignore[no-untyped-def]
    """Unit normal of a piece at its point p by differences over 2 µm (good to 1e-5 rad)."""
    h = 2e-3
    for k in range(2):
        x, y = p[0] + (h if k == 0 else 0.0), p[1] + (h if k == 1 else 0.0)
        out[k] = (p[2] - piece_height(relief, kind, index, sides, x, y)) / h
    norm = 1.0 / math.sqrt(out[0] * out[0] + out[1] * out[1] + 1.0)
    out[0], out[1], out[2] = out[0] * norm, out[1] * norm, norm


@kernel
def _lobe(cos_light, cos_view, cos_half, roughness):  # type: ignore[no-untyped-def]
    """GGX lobe relative to a matt white surface: π D G / (4 cos_light cos_view) (Walter et al. 2007)."""
    a2 = roughness * roughness
    bottom = cos_half * cos_half * (a2 - 1.0) + 1.0
    distribution = a2 / (math.pi * bottom * bottom)
    g_light = 2.0 * cos_light / (cos_light + math.sqrt(a2 + (1.0 - a2) * cos_light * cos_light))
    g_view = 2.0 * cos_view / (cos_view + math.sqrt(a2 + (1.0 - a2) * cos_view * cos_view))
    return math.pi * distribution * g_light * g_view / (4.0 * cos_light * cos_view)


@kernel
def shade(relief, light, hit, d, source, p, n, borders):  # type: ignore[no-untyped-def]
    """Direct and ambient grey levels of a hit at `p` on a skin of reflectance 1; its normal goes into `n`."""
    _, kind, index, sides, wall_x, wall_y = hit
    wall = wall_x != 0.0 or wall_y != 0.0
    if wall:
        n[0], n[1], n[2] = wall_x, wall_y, 0.0
    else:
        _normal(relief, kind, index, sides, p, n)
    reflectance = _paint(relief, light, kind, index, sides, wall, p[0], p[1])
    ambient = light.ambient * reflectance * _sky(relief, kind, index, p[0], p[1])
    if wall:
        ambient *= 0.5
    lx, ly, lz = source[0] - p[0], source[1] - p[1], source[2] - p[2]
    r = math.sqrt(lx * lx + ly * ly + lz * lz)
    lx, ly, lz = lx / r, ly / r, lz / r
    cos_light = n[0] * lx + n[1] * ly + n[2] * lz
    cos_view = -(n[0] * d[0] + n[1] * d[1] + n[2] * d[2])
    if cos_light <= 1e-6 or cos_view <= 1e-6:
        return 0.0, ambient
    for k in range(3):
        p[k] += OFF * n[k]
    bright = lit(relief, p, source, borders)
    for k in range(3):
        p[k] -= OFF * n[k]
    if not bright:
        return 0.0, ambient
    direct = 1.0
    if light.specular > 0.0 and kind not in (BACKGROUND, HOLE):
        hx, hy, hz = lx - d[0], ly - d[1], lz - d[2]
        cos_half = (n[0] * hx + n[1] * hy + n[2] * hz) / math.sqrt(hx * hx + hy * hy + hz * hz)
        direct += light.specular * _lobe(cos_light, cos_view, cos_half, light.roughness)
    falloff = (light.distance_mm / r) ** 2
    return light.brightness * reflectance * cos_light * falloff * direct, ambient
