"""Quick evidence for a ring on a candidate ellipse, so that the joint fit runs only where it can succeed."""

from __future__ import annotations

import math

import numpy as np

from metrology.jit import kernel
from metrology.linear import copy_values
from metrology.robust import MAD

_FLANK = 4  # px from the ridge at which skin and head are taken
_SLACK = 2  # px by which a sector's ridge may lie beside the candidate
_AWAY = 7  # px from the ridge at which the same measure must find nothing
_REACH = _AWAY + _SLACK + _FLANK
_SEARCH = 3  # steps by which a suspect's radius may be wrong, of half a pixel
_STEP_SHARE = 0.04  # of the radius, at most: beyond a quarter in all it is another ring


@kernel
def _contrast(profile, shift, polarity):  # type: ignore[no-untyped-def]
    """Flanks minus ridge (times polarity) of a profile, the largest within the slack about `shift`."""
    best = -1e9
    for s in range(shift - _SLACK, shift + _SLACK + 1):
        o = s + _REACH
        ridge = 0.25 * profile[o - 1] + 0.5 * profile[o] + 0.25 * profile[o + 1]
        flanks = 0.5 * (profile[o - _FLANK] + profile[o + _FLANK])
        best = max(best, polarity * (flanks - ridge))
    return best


@kernel
def _ring_profiles(image, ellipse, sectors, lowest, profile):  # type: ignore[no-untyped-def]
    """Each sector's mean profile across an ellipse, from `lowest` pixels inside to `_REACH` outside, into `profile`.

    A sector out of the picture has NaN in its first place. Returns how many those are.
    """
    height, width = image.shape
    span = 2 * _REACH + 1
    u0, v0, a, b, angle = ellipse
    ca = math.cos(angle)
    sa = math.sin(angle)
    per = max(2, int(math.pi * (a + b) / sectors / 1.5 + 0.5))
    missing = 0
    for k in range(sectors):
        profile[k] = 0.0
        count = 0
        for m in range(per):
            t = 2.0 * math.pi * (k + (m + 0.5) / per) / sectors
            c = math.cos(t)
            s = math.sin(t)
            nx = c / a
            ny = s / b
            norm = math.sqrt(nx * nx + ny * ny)
            gx = (ca * nx - sa * ny) / norm
            gy = (sa * nx + ca * ny) / norm
            x = u0 + ca * a * c - sa * b * s
            y = v0 + sa * a * c + ca * b * s
            xe = x + _REACH * gx
            ye = y + _REACH * gy
            if xe < 1.0 or ye < 1.0 or xe > width - 3.0 or ye > height - 3.0:
                continue
            if x < _REACH or y < _REACH or x > width - 1.0 - _REACH or y > height - 1.0 - _REACH:
                continue
            count += 1
            for o in range(lowest + _REACH, span):
                px = x + (o - _REACH) * gx
                py = y + (o - _REACH) * gy
                ix = int(px)
                iy = int(py)
                fx = px - ix
                fy = py - iy
                profile[k, o] += (1.0 - fy) * ((1.0 - fx) * image[iy, ix] + fx * image[iy, ix + 1]) + fy * (
                    (1.0 - fx) * image[iy + 1, ix] + fx * image[iy + 1, ix + 1]
                )
        if count == 0:
            missing += 1
            profile[k, 0] = np.nan
        else:
            for o in range(span):
                profile[k, o] /= count
    return missing


@kernel
def ring_evidence(image, ellipses, polarity, sectors, result):  # type: ignore[no-untyped-def]
    """Contrast of the ring against what the same measure finds beside it.

    Each sector's mean profile across the ellipse is measured as ridge minus the mean of its two flanks, the best of the
    positions within two pixels; the same at seven pixels' distance to either side, where no ring is, gives the noise:
    grain, shading and clutter are thereby in it.

    Parameters
    ----------
    image : (h, w) float32
    ellipses : (n, 5) float64
        u, v, semi-axes, angle.
    polarity : (n,) float64
        +1 dark, −1 bright.
    sectors : int
    result : (n, 2) float64, output
        Median contrast over its noise, and the share of sectors above 1.5 times a single sector's noise.
    """
    profile = np.zeros((sectors, 2 * _REACH + 1))
    outside = np.zeros(sectors)
    within = np.zeros(sectors)
    contrast = np.zeros(sectors)
    for index in range(len(ellipses)):
        result[index] = 0.0
        sign = polarity[index]
        both_sides = min(ellipses[index, 2], ellipses[index, 3]) > _REACH + 1.0
        lowest = -_REACH if both_sides else -_FLANK - _SLACK
        if _ring_profiles(image, ellipses[index], sectors, lowest, profile) > 0.45 * sectors:
            continue
        n = 0
        for k in range(sectors):
            if np.isnan(profile[k, 0]):
                continue
            contrast[n] = _contrast(profile[k], 0, sign)
            outside[n] = abs(_contrast(profile[k], _AWAY, sign))
            if both_sides:
                within[n] = abs(_contrast(profile[k], -_AWAY, sign))
            n += 1
        # The quieter side: a glint on the head or a seam beside it is no noise of the ring.
        noise = np.median(outside[:n])
        if both_sides:
            noise = min(noise, np.median(within[:n]))
        noise = MAD * noise + 1e-9
        hits = (contrast[:n] > 1.5 * noise).sum()
        result[index, 0] = np.median(contrast[:n]) * math.sqrt(n) / noise
        result[index, 1] = hits / sectors


@kernel
def _room(angles):  # type: ignore[no-untyped-def]
    """Empty arrays for `_template`."""
    across = 2 * _FLANK + 1
    return np.empty((angles, across), np.int64), np.empty((angles, 2)), np.empty((angles, across, 4))


@kernel
def _template(ellipse, sigma, width, place, reach, share):  # type: ignore[no-untyped-def]
    """The matched filter of a ring as weights of pixels: in each direction of the ellipse nine places across it.

    The filter is the ring's profile across the ellipse less its mean over ±4 px. Moved by whole pixels, the ring asks
    for the same weights of other pixels.

    Parameters
    ----------
    ellipse : (5,) float64
    sigma : float
    width : int
        Of the image.
    place : (n, 9) int64, output
        Upper left of the four pixels between which each place lies, as an index into the flat image.
    reach : (n, 2) float64, output
        u, v of the directions' places on the ellipse.
    share : (n, 9, 4) float64, output
        Weights of the four pixels.
    """
    a, b = ellipse[2], ellipse[3]
    ca = math.cos(ellipse[4])
    sa = math.sin(ellipse[4])
    mean = 0.0
    for o in range(-_FLANK, _FLANK + 1):
        mean += math.exp(-0.5 * (o / sigma) ** 2) / (2 * _FLANK + 1)
    norm = 0.0
    for o in range(-_FLANK, _FLANK + 1):
        norm += (math.exp(-0.5 * (o / sigma) ** 2) - mean) ** 2
    angles = len(place)
    for k in range(angles):
        t = 2.0 * math.pi * k / angles
        c = math.cos(t)
        s = math.sin(t)
        nx = c / a
        ny = s / b
        length = math.sqrt(nx * nx + ny * ny)
        gx = (ca * nx - sa * ny) / length
        gy = (sa * nx + ca * ny) / length
        x = ellipse[0] + ca * a * c - sa * b * s
        y = ellipse[1] + sa * a * c + ca * b * s
        reach[k, 0] = x
        reach[k, 1] = y
        for o in range(-_FLANK, _FLANK + 1):
            weight = (math.exp(-0.5 * (o / sigma) ** 2) - mean) / norm
            px = x + o * gx
            py = y + o * gy
            ix = math.floor(px)
            iy = math.floor(py)
            fx = px - ix
            fy = py - iy
            i = o + _FLANK
            place[k, i] = iy * width + ix
            share[k, i, 0] = weight * (1.0 - fy) * (1.0 - fx)
            share[k, i, 1] = weight * (1.0 - fy) * fx
            share[k, i, 2] = weight * fy * (1.0 - fx)
            share[k, i, 3] = weight * fy * fx


@kernel
def _template_mean(image, place, reach, share, du, dv, response):  # type: ignore[no-untyped-def]
    """Amplitude of a ring moved by whole pixels (du, dv): mean over the middle half of its directions' responses.

    NaN where less than half of it lies on the image. See `_template`; `response` is room for one value per direction.
    """
    height, width = image.shape
    flat = image.ravel()
    away = dv * width + du
    count = 0
    for k in range(len(place)):
        x = reach[k, 0] + du
        y = reach[k, 1] + dv
        if x < _FLANK + 1 or y < _FLANK + 1 or x > width - _FLANK - 3 or y > height - _FLANK - 3:
            continue
        total = 0.0
        for i in range(2 * _FLANK + 1):
            at = place[k, i] + away
            total += (
                share[k, i, 0] * flat[at]
                + share[k, i, 1] * flat[at + 1]
                + share[k, i, 2] * flat[at + width]
                + share[k, i, 3] * flat[at + width + 1]
            )
        response[count] = total
        count += 1
    if count < len(place) // 2:
        return np.nan
    # The middle half: a glint or a crossing seam fills some directions.
    ordered = np.sort(response[:count])
    return ordered[count // 4 : count - count // 4].mean()


@kernel
def distinction(image, ellipse, sigma):  # type: ignore[no-untyped-def]
    """How far the ring's amplitude stands out from what the same ring finds at other places nearby.

    Sixty-four places on a spiral from just outside the ring to two and a half radii: their robust standard deviation
    holds grain, shading and clutter, whatever their correlation.
    """
    places = 64
    place, reach, share = _room(64)
    response = np.empty(64)
    _template(ellipse, sigma, image.shape[1], place, reach, share)
    away = max(ellipse[2], ellipse[3]) + 8.0
    values = np.empty(places)
    n = 0
    for k in range(places):
        r = away * (1.2 + 1.3 * k / places)
        t = 2.399963 * k  # golden angle: no direction is preferred
        du, dv = round(r * math.cos(t)), round(r * math.sin(t))
        value = _template_mean(image, place, reach, share, du, dv, response)
        if not np.isnan(value):
            values[n] = value
            n += 1
    own = _template_mean(image, place, reach, share, 0, 0, response)
    if n < 12 or np.isnan(own):
        return 0.0
    middle = np.median(values[:n])
    departures = np.sort(np.abs(values[:n] - middle))
    # The 90 % quantile too: grain has heavy tails, while neighbours and seams fill fewer places than that.
    spread = max(MAD * departures[n // 2], departures[int(0.9 * n)] / 1.645) + 1e-12
    return abs(own - middle) / spread


@kernel
def settle(image, ellipse, sigma, found):  # type: ignore[no-untyped-def]
    """Move an ellipse to where a ring of its shape shows best nearby.

    The size first, then centres two pixels apart, then both in finer steps: a glint may have pulled a suspect aside
    by several. The middle half of the directions counts, which a glint does not reach.

    Parameters
    ----------
    image : (h, w) float32
    ellipse : (5,) float64
    sigma : float
        Half-width of the ring looked for, px.
    found : (5,) float64, output
    """
    angles = 48
    place, reach, share = _room(angles)
    response = np.empty(angles)
    width = image.shape[1]
    copy_values(found, ellipse)
    best = -1.0
    unit = min(0.5, _STEP_SHARE * ellipse[2])
    for step in (2, 1):
        grown = found.copy()
        trial = found.copy()
        for k in range(-_SEARCH, _SEARCH + 1):
            trial[2] = grown[2] + k * step * unit
            trial[3] = trial[2] * grown[3] / grown[2]
            _template(trial, sigma, width, place, reach, share)
            value = abs(_template_mean(image, place, reach, share, 0, 0, response))
            if value > best:
                best = value
                copy_values(found, trial)
        _template(found, sigma, width, place, reach, share)
        du = 0
        dv = 0
        for p in range(-2, 3):
            for q in range(-2, 3):
                value = abs(_template_mean(image, place, reach, share, step * p, step * q, response))
                if value > best:
                    best = value
                    du = step * p
                    dv = step * q
        found[0] += du
        found[1] += dv


@kernel
def _level(image, x, y):  # type: ignore[no-untyped-def]
    """Bilinear value of an image; NaN beyond its border."""
    height, width = image.shape
    if x < 0.0 or y < 0.0 or x > width - 2.0 or y > height - 2.0:
        return np.nan
    ix = int(x)
    iy = int(y)
    fx = x - ix
    fy = y - iy
    return (1.0 - fy) * ((1.0 - fx) * image[iy, ix] + fx * image[iy, ix + 1]) + fy * (
        (1.0 - fx) * image[iy + 1, ix] + fx * image[iy + 1, ix + 1]
    )


@kernel
def ring_steps(image, ellipse, offsets, result):  # type: ignore[no-untyped-def]
    """Median step from the ellipse to distances from it along its normal; NaN where less than half is on the image.

    The median of each direction's own step: uneven light round the ring is in none of them.

    Parameters
    ----------
    image : (h, w) float32
    ellipse : (5,) float64
    offsets : (n,) float64
        px, negative inside.
    result : (n,) float64, output
        Grey levels there less those on the ellipse.
    """
    angles = 64
    a, b = ellipse[2], ellipse[3]
    ca = math.cos(ellipse[4])
    sa = math.sin(ellipse[4])
    values = np.empty((len(offsets), angles))
    count = np.zeros(len(offsets), np.int64)
    for k in range(angles):
        t = 2.0 * math.pi * k / angles
        c = math.cos(t)
        s = math.sin(t)
        length = math.sqrt((c / a) ** 2 + (s / b) ** 2)
        own = _level(image, ellipse[0] + ca * a * c - sa * b * s, ellipse[1] + sa * a * c + ca * b * s)
        for o in range(len(offsets)):
            x = a * c + offsets[o] * c / a / length
            y = b * s + offsets[o] * s / b / length
            step = _level(image, ellipse[0] + ca * x - sa * y, ellipse[1] + sa * x + ca * y) - own
            if not np.isnan(step):
                values[o, count[o]] = step
                count[o] += 1
    for o in range(len(offsets)):
        result[o] = np.median(values[o, : count[o]]) if count[o] > angles // 2 else np.nan
