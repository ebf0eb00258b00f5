"""Whether a ring in the image is a fastener's rim: letters, painted rings and dents are none.

What speaks for a fastener: a thin line that closes on itself; a step or a tilt of the surface at that line; the same
ring in the other camera; and, where neither step nor tilt shows, a line that takes as much light as the gaps of the
scan's other fasteners, and a size or a row shared with them. A stroke of paint is wide, ends somewhere, and lies on the
skin; a dent has no line and does not step; a drop bulges from its border on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from metrology.arrays import Array
from metrology.cloud import Reconstruction
from metrology.fastener import HALF_STEP
from metrology.rivets.bilinear import sample_image
from metrology.rivets.ellipse_detection import Ring
from metrology.rivets.geometry import lay_on_plane, nearby_plane
from metrology.rivets.relief import HeadRelief, head_relief
from metrology.rivets.rim_light import GapLight, RimLight, rim_light
from metrology.rivets.rim_step import RimStep, rim_step, steps_up
from metrology.rivets.settings import RivetSettings
from metrology.robust import MAD
from metrology.surfaces import Frame

_SURROUNDED = 0.9  # of the pixels round a weak ring must have points
_CLOSED = 0.8  # of a rim's directions in which it shows; a glint or a scratch hides the rest
_PARTLY_CLOSED = 0.65  # the same of a line like the gaps of the scan: sealant or paint fills the rest
# Half-width of a rim's line: blur of 0.7 px and a gap of a millimetre at five pixels each give 1.6.
_THIN_PX = 1.6
# By how much of its own darkness a rim departs from the model. Where a rim is faint, grain departs as much: then by how
# many times what the rims beyond doubt depart.
_CLEAN, _STROKE = 0.25, 0.15
_OF_GRAIN = 2.0
_STEPS = 3.0  # standard deviations of a step or tilt that is one
_STROKE_STEPS = 6.0  # the same where the line is a stroke: its edges pass for steps, up to five deviations
_WIDER, _WIDER_PX = 1.25, 0.15  # than the line of a scan's other fasteners, times and px beyond, is a painted line
_BULGE = 0.05  # of the diameter: a slope of 11° at the border of what is round
_PROUDER, _LEANING = 1.5, 2.0  # than the proudest fastener of a scan, the most tilted one
_NEXT_SIZE = 1 + 2.5 * HALF_STEP  # times a size, at most, is the next one of a series
# Where nothing steps: wider by so many standard deviations of the gaps' widths, or by a share of them.
_WIDER_SIGMAS, _WIDER_SHARE = 4.0, 0.15
# Where no others tell what gaps take: a black gap of more, mm, is no fastener's that lies flush in its countersink.
_WIDEST_GAP_MM = 0.35
_SIZE_PX, _SIZE_SHARE = 1.25, 0.02  # px and share of it by which two rings of one diameter differ at most
_FEW = 4  # fasteners beyond doubt, at least, to tell what others should be like
_IN_PLACE = 0.25  # diameters by which a fastener may be off its place in a row
_OF_PITCH = 0.03  # the same as a share of the row's pitch
_NEAREST = 4  # neighbours that make a row
_OTHER_VIEW = 0.2  # of a rim's contrast in the left camera that the right one must show
_DIRECTIONS = 48
# What speaks against a ring of which neither the surface nor other fasteners tell.
UNTOLD = "a ring where too few points of the skin tell what it is"
_TOLD_MM = 0.1  # heads and letters of thick paint step by so much
_FAR_OFF = 10.0  # standard deviations of a height that is no head's, where shadows leave little skin
_SEEN = 0.7  # of a rim that the right camera must see to be asked


@dataclass(frozen=True)
class Confirmed:
    """A ring that is a rivet's rim, or may be one: then `doubt` says what speaks against it."""

    ring: Ring
    doubt: str | None = None


@dataclass(frozen=True)
class _Shown:
    """A ring, and how the surface steps there."""

    ring: Ring
    step: RimStep | None
    relief: HeadRelief
    grain: float = 0.0
    place: _Place | None = None
    light: RimLight | None = None
    like_gaps: bool = False
    """Whether its line is like the gaps of the scan's fasteners beyond doubt."""

    @property
    def polarity(self) -> float:
        """1 for a dark line, −1 for a bright one."""
        return float(-np.sign(self.ring.fit.amplitude) if self.light is None else np.sign(self.light.mean_mm))

    @property
    def clear(self) -> bool:
        """Whether it is a thin line that closes on itself."""
        return self.thin and (self.like_gaps or self.ring.fit.coverage >= _CLOSED)

    @property
    def thin(self) -> bool:
        """Whether it is a thin line, closed at least in part; `grain` is what leaves a line as it is, grey levels."""
        fit = self.ring.fit
        clean = fit.noise <= max(_CLEAN * abs(fit.amplitude), self.grain)
        return clean and fit.sigma_px <= _THIN_PX and fit.coverage >= _PARTLY_CLOSED

    @property
    def stroke(self) -> bool:
        """Whether it is a brush's or a stencil's: wide, and no ring at close sight."""
        fit = self.ring.fit
        return fit.sigma_px > _THIN_PX and fit.noise > _STROKE * abs(fit.amplitude)

    @property
    def stands(self) -> bool:
        """Whether the surface steps there. The edges of paint seem to tilt it: only a clear line's tilt counts."""
        if self.step is None:
            return False
        if self.stroke:
            return self.step.mean_significance >= _STROKE_STEPS and abs(self.step.mean_mm) > self.step.rise_mm
        seems = self.step.significance if self.clear or self.raised else self.step.mean_significance
        return seems >= _STEPS

    @property
    def raised(self) -> bool:
        """Whether what it encloses lies plainly off the skin, from its rim on: then letters or dirt across a head have
        left too little beside its rim to tell the step by itself."""
        return self.relief.significance >= _STROKE_STEPS and steps_up(self.relief.step_mm, self.step)

    @property
    def certain(self) -> bool:
        """Whether it is a fastener beyond doubt: what it encloses lies off the skin, too, as no letter does of paint
        that is thick enough to step."""
        return self.clear and self.stands and self.relief.significance >= _STEPS


@dataclass(frozen=True)
class _Place:
    """A ring laid onto the skin."""

    frame: Frame
    """Origin in its centre, h along the normal of the points in and about it."""
    diameter: float
    pixel: float
    """diameter, pixel: its own, and what a pixel shows there, mm."""

    @classmethod
    def of(cls, ring: Ring, reconstruction: Reconstruction) -> _Place | None:
        plane = nearby_plane(reconstruction, ring.ellipse)
        if plane is None:
            return None
        frame = plane[0]
        x, y, radius = lay_on_plane(reconstruction.rig.left, ring.ellipse, frame)
        return cls(Frame(frame.rig([x, y, 0.0]), frame.axes), 2 * radius, radius / ring.ellipse.radius)

    def offset(self, point: Array) -> Array:
        """(3,) along the skin to a point: a row follows the skin's curvature."""
        way, normal = point - self.frame.origin, self.frame.axes[2]
        return np.asarray(way - (way @ normal) * normal)


def confirm_rings(rings: Sequence[Ring], reconstruction: Reconstruction, settings: RivetSettings) -> list[Confirmed]:
    """The rings that are rims, or may be; holes, strokes of paint and grain are left out."""
    shown = []
    for ring in rings:
        relief = head_relief(reconstruction, ring.ellipse)
        if _is_hole(relief, settings):
            continue
        sure = ring.quality >= settings.sure_quality
        if not sure and not _bears_out(relief, settings):
            continue
        step = rim_step(reconstruction, ring.ellipse)
        if sure or steps_up(relief.step_mm, step):
            shown.append(_Shown(ring, step, relief))
    standing = [s for s in shown if s.stands and not s.stroke]
    if len(standing) >= _FEW:
        grain = _OF_GRAIN * float(np.median([s.ring.fit.noise for s in standing]))
        shown = [replace(s, grain=grain) for s in shown]
    shown = [_placed(s, reconstruction) if s.thin or s.stands else s for s in shown]
    certain = [s for s in shown if s.certain]
    gaps = _gaps(certain)
    shown = [replace(s, like_gaps=_like_gaps(s, certain, gaps)) for s in shown]
    certain = [s for s in shown if s.certain]
    found = []
    for s in shown:
        if s.relief.recessed and s.ring.fit.coverage >= _CLOSED and not s.stroke:
            found.append(Confirmed(s.ring))
        elif s.stands:
            doubt = _drop(s, certain) or _chip(s, certain) or _hardly_steps(s, certain) or _nothing_inside(s)
            found.append(Confirmed(s.ring, doubt))
        elif s.clear:
            found.append(Confirmed(s.ring, _doubt(s, certain, gaps, reconstruction)))
        elif not s.stroke:
            share = f"{s.ring.fit.coverage:.0%}"
            found.append(Confirmed(s.ring, f"its rim shows in {share} of all directions, and the surface has no step"))
    return found


def _placed(one: _Shown, reconstruction: Reconstruction) -> _Shown:
    """A ring with its place on the skin and what light its line takes."""
    place = _Place.of(one.ring, reconstruction)
    if place is None:
        return one
    light = rim_light(reconstruction, place.frame, 0.5 * place.diameter, place.pixel)
    return replace(one, place=place, light=light)


def _gaps(certain: Sequence[_Shown]) -> GapLight:
    """What light the gaps of fasteners beyond doubt take."""
    return GapLight.of([s.light for s in certain if s.light is not None])


def _is_hole(relief: HeadRelief, settings: RivetSettings) -> bool:
    """A hole has skin round it and nothing inside, or something far off: below, or a temporary fastener's top."""
    empty = relief.outer_share > 0.6 and relief.inner_share < 0.15
    return empty or (abs(relief.step_mm) > settings.max_sunk_mm and relief.significance > _FAR_OFF)


def _bears_out(relief: HeadRelief, settings: RivetSettings) -> bool:
    """Whether the surface may make a rivet of a ring that hardly stands out of the grain, if it steps there.

    There must be skin all round: beside the panel's border there are other steps.
    """
    on_skin = relief.outer_share > _SURROUNDED and abs(relief.step_mm) < settings.max_sunk_mm
    return on_skin and relief.significance >= settings.sure_relief


def _doubt(one: _Shown, certain: Sequence[_Shown], gaps: GapLight, reconstruction: Reconstruction) -> str | None:
    """What speaks against a clear line at which the surface neither steps nor tilts."""
    if not _right_camera_shows(one, reconstruction):
        return "a ring that one camera shows and the other does not"
    if len(certain) < _FEW:
        if not (one.step and one.step.tells(_TOLD_MM)) and not one.relief.significance >= _STEPS:
            return UNTOLD
        broad = _broad(one, certain)
        return "a ring without a step, whose line is wider or darker than a fastener's gap" if broad else None
    if why := _unlike_gaps(one, certain, gaps):
        return f"a ring without a step, whose line is unlike the gaps of the fasteners here: {why}"
    places = [s.place for s in certain if s.place is not None]
    if one.place is None or len(places) < _FEW or _same_size(one.place, places) or _in_row(one.place, places):
        return None
    if one.light is not None and gaps.is_gap(one.light) and _between(one.place, places):
        return None
    return "a ring without a step, of another size than the fasteners here and in no row of theirs"


def _drop(one: _Shown, certain: Sequence[_Shown]) -> str | None:
    """What speaks against a ring round something that bulges, and whose line is no gap: a drop has no edge."""
    rings = [s.ring for s in certain if s is not one]
    gap = one.clear and (len(rings) < _FEW or not _wider(one.ring, rings))
    if gap or one.place is None or steps_up(one.relief.step_mm, one.step):
        return None
    bulges = one.relief.step_mm > _BULGE * one.place.diameter and one.relief.significance >= _STROKE_STEPS
    return "it bulges, and its border is no gap: a drop may lie there" if bulges else None


def _chip(one: _Shown, certain: Sequence[_Shown]) -> str | None:
    """What speaks against a ring at which the surface steps: a chip or a drop lies on the skin and has an edge, too.

    It stands higher than the fasteners or leans more, is smaller or has a blurred border, and is in no row of theirs.
    """
    placed = [(s, s.place) for s in certain if s is not one and s.place is not None]
    place = one.place
    if len(placed) < _FEW or one.relief.step_mm < 0 or place is None:
        return None
    prouder = one.relief.step_mm > _PROUDER * max(s.relief.step_mm for s, _ in placed)
    leaning = _slope(one, place) > _LEANING * max(_slope(s, p) for s, p in placed)
    smaller = place.diameter < (1 - HALF_STEP) * min(p.diameter for _, p in placed)
    rings = [s.ring for s, _ in placed]
    if not (prouder or leaning) or not (smaller or _wider(one.ring, rings)) or _in_row(place, [p for _, p in placed]):
        return None
    return "it stands out of the skin unlike all fasteners here, in no row of theirs: a chip or a drop may lie there"


def _nothing_inside(one: _Shown) -> str | None:
    """What speaks against a broken line at which the surface seems to step: what it encloses lies in the skin.

    Strong paint moves the points beside it; a head is as high inside as at its rim, but for its recess.
    """
    if one.clear or one.step is None or not one.relief.significance > 0 or one.relief.recessed:
        return None
    height, sd = one.relief.step_mm, abs(one.relief.step_mm) / one.relief.significance
    # The borders of a letter of thick paint step more surely than the little skin that it encloses is known.
    inside = height * np.sign(one.step.mean_mm) + (0.0 if one.stroke else _STEPS * sd)
    return "its rim seems to step, and nothing steps inside" if inside < 0.5 * abs(one.step.mean_mm) else None


def _hardly_steps(one: _Shown, certain: Sequence[_Shown]) -> str | None:
    """What speaks against a ring at which the surface steps little more than paint makes it seem to."""
    others = [s for s in certain if s is not one]
    if one.step is None:
        return None
    if len(others) < _FEW:
        hardly = one.step.mean_significance < _STROKE_STEPS and _broad(one, others)
        return "a ring that hardly steps, whose line is wider or darker than a fastener's gap" if hardly else None
    if (one.step.significance if one.clear else one.step.mean_significance) >= _STROKE_STEPS:
        # Thick paint steps at its edges, and so does a chip.
        why = _other_polarity(one, others) if one.stroke else None
        return why and f"a wide line that steps, unlike the fasteners' gaps here: {why}"
    why = _unlike_gaps(one, others, _gaps(others))
    return why and f"a ring that hardly steps, whose line is unlike the fasteners' gaps here: {why}"


def _broad(one: _Shown, certain: Sequence[_Shown]) -> bool:
    """Whether a line takes more light than the gap of any fastener, or is wider than the narrowest gap here."""
    if one.light is not None and abs(one.light.mean_mm) > _WIDEST_GAP_MM:
        return True
    narrowest = min(certain, key=lambda other: other.ring.fit.sigma_px, default=None)
    return narrowest is not None and _wider(one.ring, [narrowest.ring])


def _slope(one: _Shown, place: _Place) -> float:
    """Slope of a head against the skin; 0 where it is not known."""
    return 0.0 if one.step is None else one.step.rise_mm / (0.5 * place.diameter)


def _unlike_gaps(one: _Shown, certain: Sequence[_Shown], gaps: GapLight) -> str | None:
    """In what a line is unlike all gaps of the scan."""
    rings = [s.ring for s in certain]
    wide = _wider(one.ring, rings) or (not one.stands and _wider_than_all(one.ring, rings))
    return "it is wider" if wide else _other_light(one, certain, gaps)


def _other_light(one: _Shown, certain: Sequence[_Shown], gaps: GapLight) -> str | None:
    """In what the light that a line takes is unlike that of all gaps of the scan."""
    if (why := _other_polarity(one, certain)) or one.light is None:
        return why
    if gaps.takes_more(one.light):
        return "it takes more light"
    return "it looks alike from both cameras, as paint does" if gaps.is_paint(one.light) else None


def _other_polarity(one: _Shown, certain: Sequence[_Shown]) -> str | None:
    """Whether a line is bright where all gaps are dark, or dark where they are bright."""
    if any(one.polarity == other.polarity for other in certain):
        return None
    return "they are dark, and it is bright" if one.polarity < 0 else "they are bright, and it is dark"


def _wider(ring: Ring, certain: Sequence[Ring]) -> bool:
    """Whether a line is wider than gaps are here: one camera sees all of a scan through one blur."""
    usual = float(np.median([other.fit.sigma_px for other in certain]))
    return ring.fit.sigma_px > _WIDER * usual + _WIDER_PX


def _wider_than_all(ring: Ring, certain: Sequence[Ring]) -> bool:
    """Whether a line is wider than the widths of gaps scatter here."""
    widths = np.array([other.fit.sigma_px for other in certain])
    usual = float(np.median(widths))
    scatter = MAD * float(np.median(np.abs(widths - usual)))
    return ring.fit.sigma_px > usual + max(_WIDER_SIGMAS * scatter, _WIDER_SHARE * usual)


def _like_gaps(one: _Shown, certain: Sequence[_Shown], gaps: GapLight) -> bool:
    """Whether a line is a gap's: as wide, and takes as much light, or looks as different from both cameras."""
    rings = [s.ring for s in certain if s is not one]
    if one.light is None or len(rings) < _FEW or _wider_than_all(one.ring, rings) or gaps.is_paint(one.light):
        return False
    return gaps.takes_as_much(one.light, one.ring.fit.coverage) or gaps.is_gap(one.light)


def _between(place: _Place, others: Sequence[_Place]) -> bool:
    """Whether a size lies between those of others, or is the next one."""
    sizes = [other.diameter for other in others]
    return min(sizes) / _NEXT_SIZE < place.diameter < max(sizes) * _NEXT_SIZE


def _same_size(place: _Place, others: Sequence[_Place]) -> bool:
    """Whether a size is that of another, as well as diameters of rings are known."""
    known = max(_SIZE_PX * place.pixel, _SIZE_SHARE * place.diameter)
    return any(abs(place.diameter - other.diameter) < known for other in others)


def _in_row(place: _Place, others: Sequence[_Place]) -> bool:
    """Whether two neighbours make a row in which the place is the next one, or the one between them."""
    near = sorted((place.offset(other.frame.origin) for other in others), key=np.linalg.norm)[:_NEAREST]
    for one, other in permutations(near, 2):
        reach = max(_IN_PLACE * place.diameter, _OF_PITCH * float(np.linalg.norm(other - one)))
        if min(np.linalg.norm(2 * one - other), np.linalg.norm(0.5 * (one + other))) < reach:
            return True
    return False


def _right_camera_shows(one: _Shown, reconstruction: Reconstruction) -> bool:
    """Whether the right camera sees the same ring at the skin's depth; a glint or a shadow lies elsewhere.

    True where it sees too little of it to tell, and where there is but one camera.
    """
    if reconstruction.right is None or one.place is None:
        return True
    beside = max(2.5, 2.5 * one.ring.fit.sigma_px) / one.ring.ellipse.radius
    turn = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    around = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=1)
    radii = 0.5 * one.place.diameter * np.array([1 - beside, 1.0, 1 + beside])
    places = one.place.frame.rig(radii[:, None, None] * around)
    contrasts = []
    for device, view in reconstruction.cameras.values():
        inside, line, outside = sample_image(view.texture, device.project(places))
        contrasts.append(1 - 2 * line / (inside + outside))
    here, there = contrasts
    known = np.isfinite(here) & np.isfinite(there)
    if known.mean() < _SEEN:
        return True
    here_median, there_median = float(np.median(here[known])), float(np.median(there[known]))
    return there_median * np.sign(here_median) > _OTHER_VIEW * abs(here_median)
