"""One possible pose of a robot: a normal distribution that a match of the scan corrects."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from logs.transforms import compose, invert, wrap
from sensorgraph.localization.global_search import MIN_POINTS
from sensorgraph.localization.known_map import KnownMap
from sensorgraph.localization.matching import CORRELATION, Match, match
from sensorgraph.localization.settings import MAP_TRACKING, MIN_INLIERS_IN_MAP
from sensorgraph.localization.wheels import slip_of
from sensorgraph.types import Floats
from sensorgraph.watching.readings import ReadingEvidence
from sensorgraph.watching.resemblance import resemblance_of
from sensorgraph.watching.scan_input import ScanInput, apart
from sensorgraph.watching.settings import TRACKING, TrackingPriors

REGION = 1.96
"""Standard deviations to the end of the central 95 % of a normal distribution."""


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
    is_belief: bool = False
    """Whether the robot's belief supports it: it was added as the believed pose, which its distribution still contains."""
    is_matched: bool = False
    """Whether the last scan was matched to the surfaces."""
    answered: float = 0.0
    """Share of the rays that the graph answers."""
    evidence: float = 0.0
    """[nats] Mean evidence of the answered readings of the last scan."""
    alone: float = 0.0
    """[m] Distance driven where the graph does not answer its rays or the scan does not match, less that where it does."""
    moved: float = 0.0
    """[m] Distance driven since the last scan."""
    followed: float = 0.0
    """[m] Distance over which this was the probable mode, at most `TrackingPriors.confirmed`."""

    def without_belief(self, believed: Floats, tolerance: tuple[float, float]) -> Mode:
        """Return the mode without the support of the belief, if the robot does not believe it any more."""
        return replace(self, is_belief=self.is_belief and self.contains(believed, tolerance))

    def merged(self, other: Mode) -> Mode:
        """Return the mode with another that has met it."""
        return replace(
            self,
            score=float(np.logaddexp(self.score, other.score)),
            alike=float(np.logaddexp(self.alike, other.alike)),
            followed=max(self.followed, other.followed),
            is_belief=self.is_belief or other.is_belief,
        )

    @property
    def total(self) -> float:
        """Logarithm of the probability that the robot is here or at a place that resembles it."""
        return float(np.logaddexp(self.score, self.alike))

    def is_confirmed(self, distance: float) -> bool:
        """Tell whether the robot's belief supports the mode, or it was the probable one over a distance [m]."""
        return self.is_belief or self.followed >= distance

    def parts(self) -> Floats:
        """Return the middles (7, 3) of equal parts of the distribution, each of a quarter of its covariance.

        They are the mean and two points on each axis of the covariance; together, the parts have its covariance.
        """
        values, vectors = np.linalg.eigh(self.covariance)
        steps = math.sqrt(0.75 * 7 / 2) * np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        return np.asarray(self.pose + np.concatenate([np.zeros((1, 3)), steps, -steps]))

    def weighted(self, log_weights: Floats) -> Mode:
        """Return the mode with its parts weighted by logarithms (7,)."""
        weights = np.exp(log_weights - log_weights.max())
        off = self.parts() - self.pose
        mean = weights @ off / weights.sum()
        apart = off - mean
        covariance = 0.25 * self.covariance + (weights[:, None] * apart).T @ apart / weights.sum()
        return replace(self, pose=self.pose + mean, covariance=covariance)

    def is_at(self, pose: Floats, tolerance: tuple[float, float]) -> bool:
        """Tell whether the mode is within a tolerance [m, rad] of a pose (3,)."""
        way, turn = apart(self.pose, pose)
        return way < tolerance[0] and turn < tolerance[1]

    def contains(self, pose: Floats, tolerance: tuple[float, float]) -> bool:
        """Tell whether a pose (3,) is within a tolerance [m, rad] of the 95 % region of the mode."""
        way, turn = apart(self.pose, pose)
        along = (pose - self.pose)[:2] / max(way, 1e-9)
        wide = REGION * math.sqrt(max(float(along @ self.covariance[:2, :2] @ along), 0.0))
        return way < tolerance[0] + wide and turn < tolerance[1] + REGION * math.sqrt(self.covariance[2, 2])


def corrected(mode: Mode, found: Match | None, priors: TrackingPriors = TRACKING) -> Mode:
    """Return a mode after a match of the scan; without one, its pose is that of the odometry."""
    if found is None:
        return replace(mode, is_matched=False)
    information = np.linalg.inv(mode.covariance) + _positive(found.information) / CORRELATION
    covariance = np.asarray(
        np.linalg.inv(information) + np.diag(np.asarray(priors.map_floor) ** 2), dtype=np.float64
    )
    return replace(mode, pose=found.pose, covariance=covariance, is_matched=True)


def matched(place: KnownMap, pose: Floats, covariance: Floats, now: ScanInput) -> Match | None:
    """Match a scan near a pose; None without a match that the covariance allows."""
    s, scan = MAP_TRACKING, now.scan
    if len(scan.points) < MIN_POINTS:
        return None
    prior = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    found = match(scan.points, scan.normals, place.surfaces, pose, prior_information=prior)
    off = found.pose - pose
    off[2] = wrap(off[2])
    is_near = np.hypot(off[0], off[1]) < s.max_offset and abs(off[2]) < s.max_turn_offset
    is_allowed = off @ np.linalg.solve(covariance, off) < 25.0
    if (is_near or is_allowed) and found.inliers >= MIN_INLIERS_IN_MAP and found.agreement >= s.agreement:
        return found
    return None


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
    modes: Sequence[Mode], found: ReadingEvidence, share: float, weight: float, priors: TrackingPriors
) -> list[Mode]:
    """Return the modes weighed by the evidence of a scan.

    Parameters
    ----------
    share : Share of independent readings.
    weight : Share of new evidence in the scan.
    """
    known = np.where(found.known, found.ratios, 0.0)
    confirmed = np.array([mode.is_confirmed(priors.confirmed) for mode in modes])
    gains = resemblance_of(found, confirmed, share)
    evidence = known.sum(axis=1) / np.maximum(found.known.sum(axis=1), 1)
    out = []
    for k, mode in enumerate(modes):
        answered, moved = float(found.answered[k]), mode.moved
        is_known = mode.is_matched and answered > priors.answered
        followed = mode.followed + (moved if is_known and mode.score > math.log(0.9) else 0.0)
        out.append(
            replace(
                mode, score=mode.score + weight * float(gains.here[k]),
                alike=mode.alike + weight * float(gains.elsewhere[k]),
                answered=answered, evidence=float(evidence[k]),
                alone=max(mode.alone - moved, 0.0) if is_known else mode.alone + moved,
                followed=min(followed, priors.confirmed),
            )
        )  # fmt: skip
    return out


def exchanged(mode: Mode, share: float) -> Mode:
    """Return a mode after a share of robots was carried away, and as many came back."""
    stay, change = math.log1p(-share), math.log(share) if share > 0 else -math.inf
    return replace(
        mode,
        score=float(np.logaddexp(mode.score + stay, mode.alike + change)),
        alike=float(np.logaddexp(mode.alike + stay, mode.score + change)),
    )


def found_scores(main: Mode | None, elsewhere: float, gains: Floats, carried: Floats) -> Floats:
    """Return `score` and `alike` (2,) of a pose that a search found, before its prior among all places.

    The robot may have been carried there from the most probable mode before any of the scans, or was elsewhere already.

    Parameters
    ----------
    main : The most probable mode; None without any.
    elsewhere : Logarithm of the probability of a place that resembles none of the modes.
    gains : (n_scans, n_poses, 2) [nats] Evidence of each scan at the pose and at the main mode: for the robot being there, and
        for a place that resembles it.
    carried : (n_scans,) Logarithm of the probability that the robot was carried away just before each scan.
    """
    if main is None:
        return np.asarray(elsewhere + gains[:, 0].sum(axis=0))
    since = np.cumsum((gains[:, 0] - gains[:, 1, :1])[::-1], axis=0)[::-1] + carried[:, None]
    earlier = main.alike + (gains[:, 0] - gains[:, 1, 1:]).sum(axis=0)
    return np.asarray(np.logaddexp.reduce(np.vstack([main.score + since, earlier]), axis=0))


def found_mode(pose: Floats, scores: Floats, number: int) -> Mode:
    """Return a mode at a pose (3,) that a search found, with its `score` and `alike` (2,)."""
    covariance = np.diag(np.array([0.05, 0.05, 0.02]) ** 2)
    score, alike = scores.tolist()
    return Mode(pose=pose, covariance=covariance, score=score, alike=alike, number=number, is_matched=True)


def _positive(information: Floats) -> Floats:
    """Return an information matrix without negative eigenvalues, which it has along a wall."""
    values, vectors = np.linalg.eigh(information)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
