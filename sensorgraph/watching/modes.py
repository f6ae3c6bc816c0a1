"""One possible pose of a robot: a normal distribution that a match of the scan corrects."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from logs.transforms import compose, invert, wrap
from sensorgraph.localization.known_map import KnownMap
from sensorgraph.localization.map_settings import MAP_TRACKING
from sensorgraph.localization.matching import Match, match
from sensorgraph.localization.wheels import slip_of
from sensorgraph.types import Floats
from sensorgraph.watching.readings import ReadingEvidence
from sensorgraph.watching.scan_input import ScanInput, apart
from sensorgraph.watching.settings import TRACKING, TrackingPriors


@dataclass(frozen=True, kw_only=True, eq=False)
class Mode:
    """One possible pose."""

    pose: Floats
    """(3,) base_link in map."""
    covariance: Floats
    """(3, 3)"""
    score: float
    """Logarithm of the probability."""
    number: int
    """Number that stays while the mode is followed."""
    is_belief: bool = False
    """Whether the robot's belief supports it: it was added as the believed pose, and still is near it."""
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
        return replace(self, is_belief=self.is_belief and self.is_at(believed, tolerance))

    def merged(self, other: Mode) -> Mode:
        """Return the mode with another that has met it."""
        return replace(
            self,
            score=float(np.logaddexp(self.score, other.score)),
            followed=max(self.followed, other.followed),
            is_belief=self.is_belief or other.is_belief,
        )

    def unconfirmed(self, distance: float) -> float:
        """Return the share (0 to 1) in which the mode may be a place that only resembles the true one.

        It is confirmed by `distance` [m] over which it was the probable one, or by the robot's belief.
        """
        return 0.0 if self.is_belief else 1.0 - self.followed / distance

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


def corrected(mode: Mode, found: Match | None, priors: TrackingPriors = TRACKING) -> Mode:
    """Return a mode after a match of the scan; without one, its pose is that of the odometry."""
    if found is None:
        return replace(mode, is_matched=False)
    information = np.linalg.inv(mode.covariance) + _positive(found.information) / MAP_TRACKING.correlation
    covariance = np.asarray(
        np.linalg.inv(information) + np.diag(np.asarray(priors.map_floor) ** 2), dtype=np.float64
    )
    return replace(mode, pose=found.pose, covariance=covariance, is_matched=True)


def matched(place: KnownMap, pose: Floats, covariance: Floats, now: ScanInput) -> Match | None:
    """Match a scan near a pose; None without a match that the covariance allows."""
    s, scan = MAP_TRACKING, now.scan
    if len(scan.points) < s.min_points:
        return None
    prior = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    found = match(scan.points, scan.normals, place.surfaces, pose, prior_information=prior)
    off = found.pose - pose
    off[2] = wrap(off[2])
    is_near = np.hypot(off[0], off[1]) < s.max_offset and abs(off[2]) < s.max_turn_offset
    is_allowed = off @ np.linalg.solve(covariance, off) < 25.0
    if (is_near or is_allowed) and found.inliers >= s.inliers and found.agreement >= s.agreement:
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
    modes: Sequence[Mode],
    found: ReadingEvidence,
    share: float,
    weight: float,
    stay: float,
    priors: TrackingPriors,
) -> list[Mode]:
    """Return the modes weighed by the evidence of a scan.

    Parameters
    ----------
    share : Share of independent readings.
    weight : Share of new evidence in the scan.
    stay : Log-probability that the robot was not carried away.
    """
    known = np.where(found.known, found.ratios, 0.0)
    is_followed = np.array([mode.unconfirmed(priors.confirmed) == 0.0 for mode in modes])
    credit = np.where(is_followed[:, None] & ~found.known, known.max(axis=0), 0.0)
    gains = share * (known + credit).sum(axis=1)
    unlike = np.clip(
        1.0 - found.answered, priors.unlike, 1.0 - priors.unlike
    )  # the graph may not know the place
    gains = weight * np.logaddexp(gains, np.log(unlike))
    evidence = known.sum(axis=1) / np.maximum(found.known.sum(axis=1), 1)
    out = []
    for k, mode in enumerate(modes):
        answered, moved = float(found.answered[k]), mode.moved
        is_known = mode.is_matched and answered > priors.answered
        followed = mode.followed + (moved if is_known and mode.score > math.log(0.9) else 0.0)
        out.append(
            replace(
                mode, score=mode.score + stay + float(gains[k]), answered=answered, evidence=float(evidence[k]),
                alone=max(mode.alone - moved, 0.0) if is_known else mode.alone + moved,
                followed=min(followed, priors.confirmed),
            )
        )  # fmt: skip
    return out


def _positive(information: Floats) -> Floats:
    """Return an information matrix without negative eigenvalues, which it has along a wall."""
    values, vectors = np.linalg.eigh(information)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
