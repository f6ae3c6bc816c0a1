"""Errors of wheels, mount and clock: a Kalman filter that joins the odometry and the tracked poses.

The state is the pose (x, y, phi) of base_link in map and the errors

    e_d  share of the distance that the odometry misses,
    e_t  share of the turn that it misses,
    k    [rad/m] turn that it misses per metre,
    a    [rad] angle by which the laser is turned more than stated,
    l    [m, m] way ahead and left from the stated place of the laser to its true one,
    T    [s] time by which a scan is later than its stamp,
    f    [m/m, m/m] drift with the floor per metre driven, along x and y of map: a slope, or the nap of a carpet.

A step (dx, dy, dphi) of the odometry moves the pose by R(-a) ((1 + e_d) dx, (1 + e_d) dy) + f |d| and (1 + e_t) dphi + k |d|, as
the tracked heading contains a. A tracked pose is that of the robot T later: it is ahead by v T and omega T. It is moved by l,
which the robot's turns show. The drift f belongs to the floor and is no error of the robot: a robot that drives in one direction
cannot tell it from e_d and a.

Each stamp has its own error, so that a tracked pose of a moving robot is scattered along its motion. Such errors do not
add up over the way, unlike those of the odometry. Both depend on the robot, so they are estimated: one filter for each of
several levels of both, which the likelihoods of their innovations weigh (Magill 1965, "Optimal adaptive
estimation of sampled stochastic processes").
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.transforms import compose, difference
from sensorgraph.types import Floats
from sensorgraph.watching.evidence import Baseline
from sensorgraph.watching.settings import DISTANCE_FAULTS

N_ERRORS = len(DISTANCE_FAULTS)
MOUNT, LATE, FLOOR = slice(4, 6), N_ERRORS - 1, slice(N_ERRORS, N_ERRORS + 2)
"""Places of l, T and f among the errors and f."""
STEP_NOISE = np.array([0.015, 0.008, 0.008])
"""[m, m, rad] Standard deviations of the odometry after one metre; they grow with the square root of the distance."""
TURN_NOISE = np.array([0.01, 0.01, 0.015])
"""[m, m, rad] The same after one radian."""
STILL_NOISE = np.array([0.0005, 0.0005, 0.0003])
"""[m, m, rad] of a step without motion."""
LEVELS, STAMP_NOISE = (grid.ravel() for grid in np.meshgrid([0.25, 0.5, 1.0, 2.0, 4.0], [0.005, 0.012, 0.03]))
"""(n_levels,) Ratios of the noise of a robot's odometry to these, and standard deviations [s] of the stamps of its scans: below 10 ms
on aces and intel, about 30 ms on fr079."""
POSE_NOISE = np.array([0.005, 0.005, 0.008])
"""[m, m, rad] Standard deviations of a tracked pose, from errors of the map that neighbouring poses do not share. They have the
greatest likelihood on the second half of the fr079 log."""
UNKNOWN_FLOOR = Baseline(tolerance=0.01)
"""[m/m] Drift with a floor of which nothing is known: 1 mm/m on fr079, 4 and 11 on aces, 15 and 16 on intel."""
OUTLIER = 30.0
"""Squared normalised innovation above which a step was no motion of this model (slip, a push, another place)."""


class OdometryErrors:
    """Estimates the errors of one collection of evidence."""

    def __init__(self, floor: Sequence[Baseline] = (UNKNOWN_FLOOR, UNKNOWN_FLOOR)) -> None:
        self.age = 0.0
        sizes = np.array(
            [*(fault.size for fault in DISTANCE_FAULTS), *(max(one.tolerance, 1e-6) for one in floor)]
        )
        self.mean = np.zeros((len(LEVELS), 3 + len(sizes)))
        self.mean[:, 3:][:, FLOOR] = [one.value for one in floor]
        self.covariance = np.tile(np.diag(np.concatenate([np.full(3, 1e-3), sizes**2])), (len(LEVELS), 1, 1))
        self.log_likelihood = np.zeros(len(LEVELS))
        self.has_pose = False
        self.scale, self.n = np.ones(len(LEVELS)), 0
        """(n_levels,) Mean squared normalised innovation of one coordinate, over the last 100."""
        self.driven = 0.0
        """[m + rad]"""

    def add(self, step: Floats, twist: Floats, tracked: Floats, weight: float = 1.0) -> float:
        """Take a step (3,) of the odometry, the twist (2,) and the tracked pose (3,); return the squared innovation.

        Parameters
        ----------
        weight : Share of new evidence in the scan, 0 to 1: scans from one place see the same surfaces, with the same errors.
        """
        if not self.has_pose:
            self._begin(twist, tracked)
            return 0.0
        self._move(step)
        self.driven += float(np.hypot(step[0], step[1]) + abs(step[2]))
        return self._correct(twist, tracked, POSE_NOISE**2 / max(weight, 1e-3))

    @property
    def levels(self) -> Floats:
        """(n_levels,) Probability of each noise level."""
        p = np.exp(self.log_likelihood - self.log_likelihood.max())
        return np.asarray(p / p.sum())

    def _begin(self, twist: Floats, tracked: Floats) -> None:
        """Set the pose at which the tracked one would be seen; how far it is behind depends on the time error."""
        phi = tracked[2] - twist[1] * self.mean[:, 3 + LATE]
        by = _by_errors(phi, twist)
        moved = by[:, :2] @ self.mean[:, 3:, None]
        self.mean[:, :2] = tracked[:2] - moved[:, :, 0]
        self.mean[:, 2] = phi
        of_errors = by @ self.covariance[:, 3:, 3:]
        self.covariance[:, :3, 3:] = -of_errors
        self.covariance[:, 3:, :3] = -of_errors.transpose(0, 2, 1)
        noise = np.diag(POSE_NOISE**2) + _of_stamps(by)
        self.covariance[:, :3, :3] = noise + of_errors @ by.transpose(0, 2, 1)
        self.has_pose = True

    def forget_pose(self) -> None:
        """Begin at the next tracked pose again, as the motion up to there is not known."""
        self.has_pose = False
        self.covariance[:, :3, 3:] = 0.0
        self.covariance[:, 3:, :3] = 0.0

    def estimates(self) -> tuple[Floats, Floats]:
        """Return values and standard errors (n_errors,) of the data alone, without the prior."""
        prior = np.array([fault.size for fault in DISTANCE_FAULTS]) ** 2
        variance = np.diagonal(self.covariance, axis1=1, axis2=2)[:, 3 : 3 + N_ERRORS]
        own = 1.0 / np.maximum(1.0 / variance - 1.0 / prior, 1e-9)  # [of the data]
        values = self.mean[:, 3 : 3 + N_ERRORS] / variance * own
        p = self.levels
        mean = p @ values
        spread = own * np.maximum(self.scale, 1.0)[:, None] + (values - mean) ** 2
        return mean, np.sqrt(p @ spread)

    def floor(self) -> tuple[Floats, Floats]:
        """Return the drift with the floor (2,) [m/m] and its standard deviations (2,), with the prior."""
        p = self.levels
        values = self.mean[:, 3:][:, FLOOR]
        variance = np.diagonal(self.covariance, axis1=1, axis2=2)[:, 3:][:, FLOOR]
        mean = p @ values
        return mean, np.sqrt(p @ (variance + (values - mean) ** 2))

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the standard errors: three values of each metre and radian, less what was fitted.

        Single bumps average out over these: on the Intel log, estimates after 1.8, 5.3 and 14 m and rad have the tails of 3, 5 and
        8 degrees of freedom, the last within a factor of 3.
        """
        return max(3.0 * self.driven - N_ERRORS, 1.0)

    def _move(self, step: Floats) -> None:
        phi, e_d, e_t, k, a = self.mean[:, 2:7].T
        floor = self.mean[:, 3:][:, FLOOR]
        way = float(np.hypot(step[0], step[1]))
        forward = way if step[0] >= 0 else -way
        cos, sin = np.cos(phi - a), np.sin(phi - a)
        dx, dy = cos * step[0] - sin * step[1], sin * step[0] + cos * step[1]
        jacobian = np.tile(np.eye(self.mean.shape[1]), (len(LEVELS), 1, 1))
        jacobian[:, 0, 2], jacobian[:, 1, 2] = -(1 + e_d) * dy, (1 + e_d) * dx
        jacobian[:, 0, 3], jacobian[:, 1, 3] = dx, dy
        jacobian[:, 2, 4], jacobian[:, 2, 5] = step[2], forward
        jacobian[:, 0, 6], jacobian[:, 1, 6] = (1 + e_d) * dy, -(1 + e_d) * dx
        jacobian[:, 0, 3 + FLOOR.start] = jacobian[:, 1, 4 + FLOOR.start] = way
        self.mean[:, 0] += (1 + e_d) * dx + way * floor[:, 0]
        self.mean[:, 1] += (1 + e_d) * dy + way * floor[:, 1]
        self.mean[:, 2] += (1 + e_t) * step[2] + k * forward
        noise = LEVELS**2 * (STILL_NOISE**2 + STEP_NOISE**2 * way + TURN_NOISE**2 * abs(step[2]))[:, None]
        self.covariance = jacobian @ self.covariance @ jacobian.transpose(0, 2, 1)
        turn = _turn(phi - a)
        self.covariance[:, :2, :2] += (turn * noise[:2].T[:, None]) @ turn.transpose(0, 2, 1)
        self.covariance[:, 2, 2] += noise[2]

    def _correct(self, twist: Floats, tracked: Floats, noise: Floats) -> float:
        phi, late, mount = self.mean[:, 2], self.mean[:, 3 + LATE], self.mean[:, 3:][:, MOUNT]
        ahead = np.column_stack([twist[0] * late + mount[:, 0], mount[:, 1], twist[1] * late])
        off = difference(tracked, compose(self.mean[:, :3], ahead))
        by = _by_errors(phi, twist)
        cos, sin = np.cos(phi), np.sin(phi)
        h = np.concatenate([np.tile(np.eye(3), (len(LEVELS), 1, 1)), by], axis=2)
        h[:, 0, 2] = -sin * ahead[:, 0] - cos * ahead[:, 1]
        h[:, 1, 2] = cos * ahead[:, 0] - sin * ahead[:, 1]
        innovation = h @ self.covariance @ h.transpose(0, 2, 1) + np.diag(noise) + _of_stamps(by)
        solved = np.linalg.solve(innovation, np.concatenate([off[:, :, None], h @ self.covariance], axis=2))
        squares = (off * solved[:, :, 0]).sum(axis=1)
        self.log_likelihood -= 0.5 * (np.linalg.slogdet(innovation)[1] + np.minimum(squares, OUTLIER))
        square = float(squares[np.argmax(self.log_likelihood)])
        if square > OUTLIER:
            self.forget_pose()
            return square
        gain = solved[:, :, 1:].transpose(0, 2, 1)
        self.mean += (gain @ off[:, :, None])[:, :, 0]
        self.covariance -= gain @ h @ self.covariance
        self.covariance = 0.5 * (self.covariance + self.covariance.transpose(0, 2, 1))
        self.n += 1
        self.scale += (np.minimum(squares, OUTLIER) / 3.0 - self.scale) / min(self.n, 100)
        return square


def _by_errors(phi: Floats, twist: Floats) -> Floats:
    """Return the derivative (n_levels, 3, n_errors + 2) of the tracked pose by the errors and f, at headings (n_levels,)."""
    by = np.zeros((len(phi), 3, N_ERRORS + 2))
    by[:, :2, MOUNT] = _turn(phi)
    by[:, :, LATE] = np.column_stack(
        [twist[0] * np.cos(phi), twist[0] * np.sin(phi), np.full(len(phi), twist[1])]
    )
    return by


def _of_stamps(by: Floats) -> Floats:
    """Return the covariance (n_levels, 3, 3) of a tracked pose from the error of its stamp."""
    return np.asarray(STAMP_NOISE[:, None, None] ** 2 * by[:, :, LATE, None] * by[:, None, :, LATE])


def _turn(phi: Floats) -> Floats:
    """Return the rotations (n_levels, 2, 2) by angles (n_levels,)."""
    cos, sin = np.cos(phi), np.sin(phi)
    return np.stack([np.stack([cos, -sin], axis=-1), np.stack([sin, cos], axis=-1)], axis=-2)
