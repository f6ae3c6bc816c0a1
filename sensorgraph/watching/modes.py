"""One possible pose of a robot: a normal distribution that a match of the scan corrects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from logs.transforms import compose, difference, invert
from sensorgraph.localization.branch_and_bound import SearchWindow
from sensorgraph.localization.global_search import MIN_POINTS
from sensorgraph.localization.known_map import KnownMap
from sensorgraph.localization.matching import CORRELATION, Match, match
from sensorgraph.localization.settings import MAP_TRACKING
from sensorgraph.localization.wheels import slip_of
from sensorgraph.robust import MAJORITY
from sensorgraph.types import Floats
from sensorgraph.watching.readings import ReadingEvidence
from sensorgraph.watching.resemblance import resemblance_of
from sensorgraph.watching.scan_input import (
    ScanInput,
    apart,
    driven_on,
    moved_covariance,
    unknown_deviations,
)
from sensorgraph.watching.settings import TRACKING, TrackingPriors

PROBABLE = 0.9
"""Probability from which a mode is the pose of the robot, whatever its prior was."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Mode:
    """One possible pose."""

    pose: Floats
    """(3,) base_link in map."""
    covariance: Floats
    """(3, 3)"""
    score: float
    """Logarithm of the probability that the robot is here."""
    alike: float = -math.inf
    """Logarithm of the probability that it is at another place, whose scans resemble this pose."""
    number: int
    """Number that stays while the mode is followed."""
    is_matched: bool = False
    """Whether the last scan was matched to the surfaces."""
    answered: float = 0.0
    """Share of the rays that the graph answers."""
    evidence: float = 0.0
    """[nats] Mean evidence of the answered readings of the last scan."""
    handicap: float = 0.0
    """[nats] By which its prior was reduced as a belief that contradicts the tracking; 0 once it was the probable pose."""
    slips: bool = False
    """Whether its last step is one that the odometry does not show."""
    resembles: Mapping[int, float] = field(default_factory=dict)
    """Number of another mode -> log-odds that what the graph does not know here resembles the surroundings there, against any."""

    @classmethod
    def found_at(cls, pose: Floats) -> Mode:
        """Return a mode at a pose (3,) that a match of a search found."""
        covariance = np.diag(np.array([0.05, 0.05, 0.02]) ** 2)
        return cls(pose=pose, covariance=covariance, score=-math.inf, number=0, is_matched=True)

    def merged(self, other: Mode) -> Mode:
        """Return the mode with another that has met it: mean and covariance are those of both, by their probabilities."""
        share = math.exp(other.total - float(np.logaddexp(self.total, other.total)))
        off = difference(other.pose, self.pose)
        spread = (1.0 - share) * self.covariance + share * other.covariance
        return replace(
            self,
            pose=self.pose + share * off,
            covariance=spread + share * (1.0 - share) * np.outer(off, off),
            score=float(np.logaddexp(self.score, other.score)),
            alike=float(np.logaddexp(self.alike, other.alike)),
        )

    @property
    def total(self) -> float:
        """Logarithm of the probability that the robot is here or at a place that resembles it."""
        return float(np.logaddexp(self.score, self.alike))

    def parts(self) -> Floats:
        """Return the middles (7, 3) of equal parts of the distribution, each of a quarter of its covariance.

        They are the mean and two points on each axis of the covariance; together, the parts have its covariance.
        """
        values, vectors = np.linalg.eigh(self.covariance)
        steps = math.sqrt(0.75 * 7 / 2) * np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        return np.asarray(self.pose + np.concatenate([np.zeros((1, 3)), steps, -steps]))

    def weighted(self, log_weights: Floats) -> Mode:
        """Return the mode with its parts weighted by logarithms (7,) of likelihoods, whose mean is that of the mode."""
        weights = np.exp(log_weights - log_weights.max())
        mean_likelihood = float(np.logaddexp.reduce(log_weights) - math.log(len(log_weights)))
        off = self.parts() - self.pose
        mean = weights @ off / weights.sum()
        apart = off - mean
        covariance = 0.25 * self.covariance + (weights[:, None] * apart).T @ apart / weights.sum()
        return replace(self.plus(mean_likelihood), pose=self.pose + mean, covariance=covariance)

    def plus(self, nats: float) -> Mode:
        """Return the mode with evidence [nats] for the robot being here or at a place that resembles it."""
        return replace(self, score=self.score + nats, alike=self.alike + nats)

    def resembling(self, number: int, odds: float) -> Mode:
        """Return the mode if its unknown surroundings may resemble those of a new one, with log-odds by the recent scans.

        The odds are against all that its surroundings may be: its score already has the evidence that they resemble other modes.
        """
        known = float(np.logaddexp.reduce([0.0, *self.resembles.values()]))
        score = self.score + float(np.logaddexp(0.0, odds))
        return replace(self, score=score, resembles={**self.resembles, number: known + odds})

    def is_at(self, pose: Floats, tolerance: tuple[float, float]) -> bool:
        """Tell whether the mode is within a tolerance [m, rad] of a pose (3,)."""
        way, turn = apart(self.pose, pose)
        return way < tolerance[0] and turn < tolerance[1]


def corrected(mode: Mode, found: Match | None, priors: TrackingPriors = TRACKING) -> Mode:
    """Return a mode after a match of the scan; without one, its pose is that of the odometry.

    A mode that drifted before is as probable as its likelihood at the match, times the share of its volume that the match
    leaves: Laplace's approximation sqrt(|Σ'| / |Σ|) exp(-½ dᵀ Σ⁻¹ d) of a mean likelihood, with the covariances Σ before and
    Σ' after the match at a distance d. A mode that is followed by matches keeps its volume.
    """
    if found is None:
        return replace(mode, is_matched=False)
    information = np.linalg.inv(mode.covariance) + _positive(found.information) / CORRELATION
    covariance = np.asarray(
        np.linalg.inv(information) + np.diag(np.asarray(priors.map_floor) ** 2), dtype=np.float64
    )
    if not mode.is_matched:
        off = difference(found.pose, mode.pose)
        nats = 0.5 * float(np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(mode.covariance)[1])
        mode = mode.plus(min(nats, 0.0) - 0.5 * float(off @ np.linalg.solve(mode.covariance, off)))
    return replace(mode, pose=found.pose, covariance=covariance, is_matched=True)


def moved_on(mode: Mode, place: KnownMap, step: Floats, deviations: Floats, now: ScanInput) -> Mode:
    """Return a mode moved by the odometry (3,), with its standard deviations (3,), and corrected by a match of the scan."""
    pose = compose(mode.pose, step)
    covariance = moved_covariance(mode.covariance, mode.pose, step, deviations)
    found = matched(place, pose, covariance, now)
    return corrected(replace(mode, pose=pose, covariance=covariance, slips=False), found)


def matched(place: KnownMap, pose: Floats, covariance: Floats, now: ScanInput) -> Match | None:
    """Match a scan near a pose; None without a match that the covariance allows."""
    s, scan = MAP_TRACKING, now.scan
    if len(scan.points) < MIN_POINTS:
        return None
    prior = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    found = match(scan.points, scan.normals, place.surfaces, pose, prior_information=prior)
    off = difference(found.pose, pose)
    is_near = np.hypot(off[0], off[1]) < s.max_offset and abs(off[2]) < s.max_turn_offset
    is_allowed = off @ np.linalg.solve(covariance, off) < 25.0
    if (is_near or is_allowed) and found.inliers >= MAJORITY and found.agreement >= s.agreement:
        return found
    return None


def slipped(
    mode: Mode,
    place: KnownMap,
    now: ScanInput,
    velocity: Floats,
    dt: float,
    least: float,
    priors: TrackingPriors,
) -> Mode | None:
    """Return a mode after a step that the odometry does not show: wheels slip, or an encoder is dead.

    It moves as a robot without odometry and pays for this volume. Slip begins at the rate at which tracking fails, and
    after a step with slip it is as probable as not. None without a match, or if the mode is improbable.

    Parameters
    ----------
    velocity : (3,) [m/s, m/s, rad/s] Velocity of the robot before the step.
    dt : [s] Time of the step.
    least : Logarithm of the least probability of a mode that is followed.
    """
    p = 0.5 if mode.slips else min(priors.carried * dt, 0.5)
    if p <= 0.0 or mode.total + math.log(p) < least:
        return None
    step, deviations = driven_on(velocity, dt, priors), unknown_deviations(dt, priors)
    pose = compose(mode.pose, step)
    covariance = moved_covariance(mode.covariance, mode.pose, step, deviations)
    found = matched(place, pose, covariance, now)
    if found is None:
        return None
    moved = replace(mode, pose=pose, covariance=covariance, is_matched=False, slips=True)
    return corrected(moved.plus(math.log(p)), found, priors)


def surroundings_of(mode: Mode, back: Floats) -> SearchWindow:
    """Return the window of three standard deviations around a mode after a motion (3,), at least 0.5 m and 0.2 rad."""
    x, y, turn = (3.0 * np.sqrt(np.diag(mode.covariance))).tolist()
    return SearchWindow.around(compose(mode.pose, back), half_xy=max(0.5, x, y), half_phi=max(0.2, turn))


def velocity_of(before: Mode | None, after: Mode | None, dt: float, most: float, otherwise: Floats) -> Floats:
    """Return the velocity (3,) [m/s, m/s, rad/s] of a mode that was followed for a time [s]."""
    if before is None or after is None or after.number != before.number or dt <= 0.05:
        return otherwise
    moved = compose(invert(before.pose), after.pose) / dt
    return np.asarray(moved if np.hypot(moved[0], moved[1]) < most else np.zeros(3))


def error_of_step(
    before: Mode | None, after: Mode | None, step: Floats, deviations: Floats, dt: float
) -> Floats:
    """Return the error (3,) [m/s, m/s, rad/s] of the odometry's speed in a step, if it is beyond its noise; otherwise zero."""
    if before is None or after is None or after.number != before.number or not after.is_matched or dt <= 0:
        return np.zeros(3)
    off = compose(invert(compose(before.pose, step)), after.pose)
    return slip_of(off, deviations) / dt


def weighed(
    modes: Sequence[Mode],
    found: ReadingEvidence,
    share: float,
    weight: float,
    log_places: float,
    priors: TrackingPriors,
) -> list[Mode]:
    """Return the modes weighed by the evidence of a scan.

    Parameters
    ----------
    share : Share of independent readings.
    weight : Share of new evidence in the scan.
    log_places : Logarithm of the number of different places.
    """
    known = np.where(found.known, found.ratios, 0.0)
    gains = resemblance_of(found, share)
    evidence = known.sum(axis=1) / np.maximum(found.known.sum(axis=1), 1)
    others = max(weight * priors.independent_distance / priors.surroundings, 1e-9)
    out = []
    for k, mode in enumerate(modes):
        numbers = [other.number for other in modes]
        gain, resembles = _in_surroundings(mode, numbers, weight * gains.here[k], others, log_places)
        out.append(
            replace(
                mode, score=mode.score + gain, alike=mode.alike + weight * float(gains.elsewhere[k]),
                answered=float(found.answered[k]), evidence=float(evidence[k]), resembles=resembles,
                handicap=0.0 if mode.score > math.log(PROBABLE) else mode.handicap,
            )
        )  # fmt: skip
    return out


def _in_surroundings(
    mode: Mode, numbers: Sequence[int], gains: Floats, others: float, log_places: float
) -> tuple[float, dict[int, float]]:
    """Return the evidence of a scan for a mode, and the log-odds after it that its unknown surroundings resemble other modes.

    Before, they resemble those of one certain pose with odds of one to the number of places (a hidden Markov model).

    Parameters
    ----------
    numbers : (n_modes,) Numbers of all modes.
    gains : (n_modes,) [nats] Evidence for the robot being at this mode, where its unknown surroundings resemble those of each
        other mode; at the place of this mode, if they resemble none.
    others : Probability that the surroundings are others than at the last scan.
    log_places : Logarithm of the number of different places.
    """
    own = np.array([number == mode.number for number in numbers])
    prior = np.where(own, 0.0, -log_places)
    last = np.where(own, 0.0, [mode.resembles.get(number, -log_places) for number in numbers])
    same = last - np.logaddexp.reduce(last) + math.log1p(-others)
    new = prior - np.logaddexp.reduce(prior) + math.log(others)
    after = np.logaddexp(same, new) + gains
    odds = after - after[own]
    kept = {number: float(one) for number, one in zip(numbers, odds, strict=True) if number != mode.number}
    return float(np.logaddexp.reduce(after)), kept


def exchanged(mode: Mode, share: float) -> Mode:
    """Return a mode after a share of robots was carried away, and as many came back."""
    stay, change = math.log1p(-share), math.log(share) if share > 0 else -math.inf
    return replace(
        mode,
        score=float(np.logaddexp(mode.score + stay, mode.alike + change)),
        alike=float(np.logaddexp(mode.alike + stay, mode.score + change)),
    )


def found_scores(
    main: Mode | None, elsewhere: float, gains: Floats, of_main: Floats, carried: Floats
) -> Floats:
    """Return `score` and `alike` (2,) of a pose that a search found, before its prior of one among all places.

    The robot may have been carried there from the most probable mode before any of the scans, or was elsewhere already. It is as
    probable at the pose as at a place outside the graph that resembles it.

    Parameters
    ----------
    main : The most probable mode; None without any.
    elsewhere : Logarithm of the probability of a place that resembles none of the modes.
    gains : (n_scans, 2) [nats] Evidence of the scans from each one on: for the robot being at the pose, and for a place that
        resembles it.
    of_main : (n_scans, 2) [nats] The same for the main mode.
    carried : (n_scans,) Logarithm of the probability that the robot was carried away just before each scan.
    """
    if main is None:
        return np.asarray(elsewhere + gains[0] - math.log(2.0))
    since = main.score + gains - of_main[:, :1] + carried[:, None]
    earlier = main.alike + gains[:1] - of_main[0, 1]
    return np.asarray(np.logaddexp.reduce(np.vstack([since, earlier]), axis=0) - math.log(2.0))


def found_mode(
    found: Mode, modes: Sequence[Mode], elsewhere: float, gains: Floats, carried: Floats, log_places: float
) -> tuple[Mode, Floats]:
    """Return a mode that a search found with its probability.

    The second value (n_modes,) holds the log-odds that the unknown surroundings of each other mode resemble those of the pose,
    against all else that they may be.

    Parameters
    ----------
    elsewhere : Logarithm of the probability of a place that resembles none of the modes.
    gains : (n_scans, 2 + n_modes, 1 + n_modes) [nats] Evidence of scans at the pose and the modes: `here` of a resemblance, and
        `elsewhere` in the last row.
    carried : (n_scans,) Logarithm of the probability that the robot was carried away just before each scan.
    log_places : Logarithm of the number of different places.
    """
    since = np.cumsum(gains[::-1], axis=0)[::-1]  # sums from each scan on
    prior = np.where(np.eye(len(modes), dtype=np.bool_), 0.0, -log_places)
    of_modes = np.logaddexp.reduce(since[:, 1:-1, 1:] + prior, axis=2)  # (n_scans, n_modes)
    main = max(modes, key=lambda mode: mode.score, default=None)
    of_main = np.zeros((len(gains), 2))
    if main is not None:
        k = next(k for k, mode in enumerate(modes) if mode is main)
        of_main = np.column_stack([of_modes[:, k], since[:, -1, 1 + k]])
    scores = found_scores(main, elsewhere, since[:, [0, -1], 0], of_main, carried) - log_places
    odds = since[0, 1:-1, 0] - of_modes[0] - log_places
    score, alike = scores.tolist()
    return replace(found, score=score, alike=alike), odds


def joined(modes: Sequence[Mode], found: Mode, odds: Floats) -> list[Mode]:
    """Return the modes with one that a search found, and the log-odds (n,) that the first n of them resemble it."""
    n = len(odds)
    alike = [mode.resembling(found.number, float(one)) for mode, one in zip(modes[:n], odds, strict=True)]
    return [*alike, *modes[n:], found]


def pruned(modes: Sequence[Mode], priors: TrackingPriors) -> list[Mode]:
    """Return the most probable modes: those that have met are merged, and those that are improbable dropped."""
    kept: list[Mode] = []
    for mode in sorted(modes, key=lambda one: -one.total):
        met = next((k for k, one in enumerate(kept) if one.is_at(mode.pose, priors.tolerance)), None)
        if met is not None:
            kept[met] = kept[met].merged(mode)
        elif not kept or mode.total > kept[0].total - priors.dropped:
            kept.append(mode)
    return kept[: priors.n_modes]


def _positive(information: Floats) -> Floats:
    """Return an information matrix without negative eigenvalues, which it has along a wall."""
    values, vectors = np.linalg.eigh(information)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
