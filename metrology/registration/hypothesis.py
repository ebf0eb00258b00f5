"""From candidate placements to the most probable one: refinement and log-probability."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from metrology.arrays import Array, Ints
from metrology.panel import NominalSeam, PanelLayout, Placement, course_length, foot_on
from metrology.registration.fit import Correspondences, FitWeights, fit_placement
from metrology.registration.search import PointPattern, SearchLimits, alike, candidates, motion
from metrology.registration.settings import RegistrationSettings
from metrology.registration.view import in_view
from metrology.rig import Rig

_REFINEMENTS = 4
_SEARCHED_BEYOND = 1.5  # times the usual motion of the rig
_DIAMETER_RATIO = 2.0  # a larger one is not the same hole; a smaller one may be a fastener of the wrong size
_USUAL_DIAMETER_RATIO = 1.15  # one step of the usual series of fasteners
_FEWEST_RIVETS = 3  # that fix a placement which nothing was known of
_UNLIKELY = 9.0  # squared residual, in standard deviations, beyond which a deviation says no more


@dataclass(frozen=True)
class Scan:
    """What was found, rig frame: rivets as points, and stations (k, 3) by the scan's own seam id."""

    rivets: PointPattern
    seams: Mapping[str, Array]

    @property
    def middle(self) -> Array:
        """(3,) of all that was found."""
        return np.asarray(np.concatenate([self.rivets.positions, *self.seams.values()]).mean(0))


@dataclass(frozen=True)
class Hypothesis:
    """A refined placement and what belongs together under it."""

    placement: Placement
    partner: Ints
    """(n,) of int: index of the nominal rivet per found one, −1 where none."""
    seams: Mapping[str, NominalSeam]
    """By the scan's own seam id."""
    score: float
    """Log-probability up to a constant."""

    def same_as(self, other: Hypothesis) -> bool:
        """Whether both name most features alike."""
        either = (self.partner >= 0) | (other.partner >= 0)
        if not either.any():
            return dict(self.seams) == dict(other.seams)
        return bool((self.partner[either] == other.partner[either]).mean() > 0.5)


@dataclass(frozen=True)
class Matcher:
    """A scan held against a pattern."""

    scan: Scan
    nominal: PointPattern
    """The layout's rivets."""
    layout: PanelLayout
    prior: Placement | None
    """The station's nominal placement."""
    rig: Rig
    settings: RegistrationSettings

    def ranked(self) -> list[Hypothesis]:
        """Hypotheses that are possible motions of the rig, most probable first, each naming features differently."""
        refined = sorted((self._refined(start) for start in self._starts()), key=lambda h: -h.score)
        ranked: list[Hypothesis] = []
        for hypothesis in refined:
            if self._reachable(hypothesis) and not any(hypothesis.same_as(better) for better in ranked):
                ranked.append(hypothesis)
        return ranked

    def convincing(self, hypothesis: Hypothesis) -> bool:
        """Whether enough of what is expected was found for the scan to be one of this pattern."""
        matched = int((hypothesis.partner >= 0).sum())
        expected = max(int(self.expected(hypothesis.placement).sum()), matched)
        if matched == 0:
            return bool(hypothesis.seams) and expected == 0 and self.prior is not None
        share = matched / max(expected, len(hypothesis.partner))
        return share >= self.settings.least_share and (self.prior is not None or matched >= _FEWEST_RIVETS)

    def expected(self, placement: Placement) -> NDArray[np.bool_]:
        """(N,) which nominal rivets are in view with their whole heads."""
        radius = np.nan_to_num(self.nominal.diameters) / 2
        return in_view(self.rig, placement.to_rig(self.nominal.positions), radius)

    def in_place(self, hypothesis: Hypothesis) -> Ints:
        """(n,) the nominal rivet of each found one, also of a head of quite another size that stands at its place.

        Sizes help to find the placement; once it is known, a head at a nominal place is the one of that place.
        """
        partner = hypothesis.partner.copy()
        free = np.setdiff1d(np.arange(len(self.nominal)), partner)
        for row in np.flatnonzero(partner < 0):
            if len(free):
                at = hypothesis.placement.to_panel(self.scan.rivets.positions[row])
                away = np.linalg.norm(self.nominal.positions[free] - at, axis=1)
                if away.min() <= self.settings.tolerance_mm:
                    partner[row] = free[away.argmin()]
                    free = np.delete(free, away.argmin())
        return partner

    def distances(self, hypothesis: Hypothesis) -> Array:
        """(m,) distances of the recognised rivets from their nominal places, mm."""
        matched = hypothesis.partner >= 0
        at = hypothesis.placement.to_panel(self.scan.rivets.positions[matched])
        return np.asarray(np.linalg.norm(at - self.nominal.positions[hypothesis.partner[matched]], axis=1))

    def _limits(self) -> SearchLimits:
        settings = self.settings
        turn = np.radians(_SEARCHED_BEYOND * settings.turn_deg)
        positions = self.scan.rivets.positions
        radius = np.linalg.norm(positions - positions.mean(0), axis=1).max() if len(positions) else 0.0
        # Off the skin a candidate may be wrong by its unknown turn about the pair's line.
        off_skin = settings.tolerance_mm + float(radius * np.sin(turn))
        return SearchLimits(
            settings.tolerance_mm, off_skin, float(turn), _SEARCHED_BEYOND * settings.shift_mm, _DIAMETER_RATIO
        )

    def _starts(self) -> Iterable[Placement]:
        starts = candidates(self.scan.rivets, self.nominal, self.prior, self._limits())
        if self.prior is not None:
            starts.append(self.prior)
            starts += self._seam_starts(self.prior)
        return starts

    def _seam_starts(self, prior: Placement) -> list[Placement]:
        """The nominal placement shifted so that a found seam lies on a nominal one, as far as the rig may be."""
        shifts: list[Array] = []
        most = self._limits().max_shift_mm + self.settings.seam_tolerance_mm
        for stations in self.scan.seams.values():
            for seam in self.layout.seams:
                shift = np.median(foot_on(seam.course, prior.to_panel(stations)).offset, axis=0)
                known = any(np.linalg.norm(shift - other) < self.settings.tolerance_mm for other in shifts)
                if np.linalg.norm(shift) <= most and not known:
                    shifts.append(shift)
        return [Placement(prior.R, prior.t - shift) for shift in shifts]

    def _reachable(self, hypothesis: Hypothesis) -> bool:
        if self.prior is None:
            return True
        shift, turn = motion(hypothesis.placement, self.prior, self.scan.middle)
        limits = self._limits()
        return shift <= limits.max_shift_mm and turn <= limits.max_turn_rad

    def _refined(self, start: Placement) -> Hypothesis:
        placement = start
        partner, seams = self._partners(placement, self._limits().off_skin_mm), self._seam_partners(placement)
        for _ in range(_REFINEMENTS):
            if not (partner >= 0).any() and not seams:
                break
            pairs = self._correspondences(partner, seams)
            placement = fit_placement(pairs, placement, self.prior or start, FitWeights())
            before = partner, seams
            partner, seams = self._partners(placement, self.settings.tolerance_mm), self._seam_partners(placement)
            if (partner == before[0]).all() and seams == before[1]:
                break
        return Hypothesis(placement, partner, seams, self._score(placement, partner, seams))

    def _correspondences(self, partner: Ints, seams: Mapping[str, NominalSeam]) -> Correspondences:
        matched = partner >= 0
        scan, nominal = self.scan.rivets, self.nominal
        given = np.array([rivet.normal is not None for rivet in self.layout.rivets], bool)[partner[matched]]
        return Correspondences(
            scan.positions[matched],
            nominal.positions[partner[matched]],
            scan.normals[matched],
            np.where(given[:, None], nominal.normals[partner[matched]], np.nan),
            [(self.scan.seams[name], seam) for name, seam in seams.items()],
        )

    def _partners(self, placement: Placement, off_skin_mm: float) -> Ints:
        """(n,) nominal rivet of each found one: the assignment with the least sum of distances."""
        found, nominal, tolerance = self.scan.rivets, self.nominal, self.settings.tolerance_mm
        partner = np.full(len(found), -1, np.intp)
        if len(found) == 0 or len(nominal) == 0:
            return partner
        offset = placement.to_panel(found.positions)[:, None] - nominal.positions
        across = (offset * nominal.normals).sum(2)
        along = np.linalg.norm(offset - across[..., None] * nominal.normals, axis=2)
        cost = np.hypot(along / tolerance, across / off_skin_mm)
        cost = np.where(alike(found.diameters[:, None], nominal.diameters, _DIAMETER_RATIO), np.minimum(cost, 1), 1)
        for row, column in zip(*linear_sum_assignment(cost), strict=True):
            if cost[row, column] < 1:
                partner[row] = column
        return partner

    def _seam_partners(self, placement: Placement) -> dict[str, NominalSeam]:
        """The nominal seam of each found one: the nearest that runs the same way."""
        partners = {}
        for name, stations in self.scan.seams.items():
            distances = [self._seam_distance(placement.to_panel(stations), seam) for seam in self.layout.seams]
            if distances and min(distances) <= self.settings.seam_tolerance_mm:
                partners[name] = self.layout.seams[int(np.argmin(distances))]
        return partners

    def _seam_distance(self, stations: Array, seam: NominalSeam) -> float:
        """Median distance of stations (panel frame) from a nominal seam; infinite past its ends and across it."""
        foot = foot_on(seam.course, stations)
        beyond = np.maximum(-foot.s, foot.s - course_length(seam.course))
        if np.median(beyond) > 2 * self.settings.shift_mm:
            return float("inf")
        if len(stations) > 1:
            along = np.linalg.svd(stations - stations.mean(0), full_matrices=False)[2][0]
            if abs(along @ foot.tangent.mean(0)) < np.cos(np.radians(20)):
                return float("inf")
        return float(np.median(foot.distance))

    def _score(self, placement: Placement, partner: Ints, seams: Mapping[str, NominalSeam]) -> float:
        """Log-probability of the scan under a hypothesis, relative to a perfect one at the nominal placement."""
        settings, weights = self.settings, FitWeights()
        matched = partner >= 0
        expected = self.expected(placement)
        expected[partner[matched]] = True
        at = placement.to_panel(self.scan.rivets.positions[matched])
        squared = ((at - self.nominal.positions[partner[matched]]) ** 2).sum(1) / weights.rivet_mm**2
        ratio = np.log(self.scan.rivets.diameters[matched] / self.nominal.diameters[partner[matched]])
        sizes = np.nan_to_num(ratio / np.log(_USUAL_DIAMETER_RATIO)) ** 2
        score = -0.5 * (np.minimum(squared, _UNLIKELY) + np.minimum(sizes, _UNLIKELY)).sum()
        score += (int(expected.sum()) - int(matched.sum())) * np.log(settings.missing_rate)
        score += int((~matched).sum()) * np.log(settings.false_rate)
        for name, stations in self.scan.seams.items():
            if name not in seams:
                score += np.log(settings.false_rate)
            else:
                distance = self._seam_distance(placement.to_panel(stations), seams[name])
                score -= 0.5 * min(distance**2 / weights.seam_mm**2, _UNLIKELY)
        if self.prior is not None:
            # The usual motions are taken for two standard deviations.
            shift, turn = motion(placement, self.prior, self.scan.middle)
            score -= 2 * (shift / settings.shift_mm) ** 2 + 2 * (np.degrees(turn) / settings.turn_deg) ** 2
        return float(score)
