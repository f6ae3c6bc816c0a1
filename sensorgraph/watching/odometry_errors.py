"""Errors of wheels, mount and clock: a Kalman filter that joins the odometry and the tracked poses.

The state is the pose (x, y, phi) of base_link in map and the errors

    e_d  share of the distance that the odometry misses,
    e_t  share of the turn that it misses,
    k    [rad/m] turn that it misses per metre,
    a    [rad] angle by which the laser is turned more than stated,
    l    [m, m] way ahead and left from the stated place of the laser to its true one,
    T    [s] time by which a scan is later than its stamp.

A step (dx, dy, dphi) of the odometry moves the pose by R(-a) ((1 + e_d) dx, (1 + e_d) dy) and (1 + e_t) dphi + k |d|, as the
tracked heading contains a. A tracked pose is that of the robot T later: it is ahead by v T and omega T. It is moved by l, which
the robot's turns show.
"""

from __future__ import annotations

import numpy as np

from logs.transforms import compose, wrap
from sensorgraph.types import Floats
from sensorgraph.watching.settings import DISTANCE_FAULTS

N_ERRORS = len(DISTANCE_FAULTS)
MOUNT = slice(4, 6)
"""Place of l among the errors."""
STEP_NOISE = np.array([0.015, 0.008, 0.008])
"""[m, m, rad] Standard deviations of the odometry after one metre; they grow with the square root of the distance."""
TURN_NOISE = np.array([0.01, 0.01, 0.015])
"""[m, m, rad] The same after one radian."""
STILL_NOISE = np.array([0.0005, 0.0005, 0.0003])
"""[m, m, rad] of a step without motion."""
POSE_NOISE = np.array([0.02, 0.02, 0.006])
"""[m, m, rad] Standard deviations of a tracked pose, from errors of the map that neighbouring poses do not share."""
OUTLIER = 30.0
"""Squared normalised innovation above which a step was no motion of this model (slip, a push, another place)."""


class OdometryErrors:
    """Estimates the errors of one collection of evidence."""

    def __init__(self) -> None:
        self.age = 0.0
        self.mean = np.zeros(3 + N_ERRORS)
        sizes = np.array([fault.size for fault in DISTANCE_FAULTS])
        self.covariance = np.diag(np.concatenate([np.full(3, 1e-3), sizes**2]))
        self.has_pose = False
        self.scale, self.n = 1.0, 0
        self.weight = 0.0
        """Number of independent poses."""
        self.n_odd = 0

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
        self.weight += weight
        return self._correct(twist, tracked, POSE_NOISE**2 / max(weight, 1e-3))

    def _begin(self, twist: Floats, tracked: Floats) -> None:
        """Set the pose at which the tracked one would be seen; how far it is behind depends on the time error."""
        v, omega = twist
        late, phi = self.mean[-1], tracked[2] - omega * self.mean[-1]
        by = np.zeros((3, N_ERRORS))  # derivative of the tracked pose by the errors
        by[:2, MOUNT] = _turn(phi)
        by[:, -1] = v * np.cos(phi), v * np.sin(phi), omega
        moved = by[:2] @ self.mean[3:]
        self.mean[:3] = tracked[0] - moved[0], tracked[1] - moved[1], tracked[2] - omega * late
        self.covariance[:3, 3:] = -by @ self.covariance[3:, 3:]
        self.covariance[3:, :3] = self.covariance[:3, 3:].T
        self.covariance[:3, :3] = np.diag(POSE_NOISE**2) + by @ self.covariance[3:, 3:] @ by.T
        self.has_pose = True

    def forget_pose(self) -> None:
        """Begin at the next tracked pose again, as the motion up to there is not known."""
        self.has_pose = False
        self.covariance[:3, 3:] = 0.0
        self.covariance[3:, :3] = 0.0

    def estimates(self) -> tuple[Floats, Floats]:
        """Return values and standard errors (n_errors,) of the data alone, without the prior."""
        prior = np.array([fault.size for fault in DISTANCE_FAULTS]) ** 2
        variance = np.diag(self.covariance)[3:]
        own = 1.0 / np.maximum(1.0 / variance - 1.0 / prior, 1e-9)  # [of the data]
        values = self.mean[3:] / variance * own
        return values, np.sqrt(own * max(self.scale, 1.0))

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the standard errors: three values of each independent pose, less what was fitted."""
        return max(3.0 * self.weight - N_ERRORS, 1.0)

    def _move(self, step: Floats) -> None:
        phi, e_d, e_t, k, a = self.mean[2:7]
        way = float(np.hypot(step[0], step[1]))
        forward = way if step[0] >= 0 else -way
        cos, sin = np.cos(phi - a), np.sin(phi - a)
        dx, dy = cos * step[0] - sin * step[1], sin * step[0] + cos * step[1]
        jacobian = np.eye(len(self.mean))
        jacobian[0, 2], jacobian[1, 2] = -(1 + e_d) * dy, (1 + e_d) * dx
        jacobian[0, 3], jacobian[1, 3] = dx, dy
        jacobian[2, 4], jacobian[2, 5] = step[2], forward
        jacobian[0, 6], jacobian[1, 6] = (1 + e_d) * dy, -(1 + e_d) * dx
        self.mean[:3] += ((1 + e_d) * dx, (1 + e_d) * dy, (1 + e_t) * step[2] + k * forward)
        noise = STILL_NOISE**2 + STEP_NOISE**2 * way + TURN_NOISE**2 * abs(step[2])
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        self.covariance = jacobian @ self.covariance @ jacobian.T
        self.covariance[:3, :3] += (turn * noise) @ turn.T

    def _correct(self, twist: Floats, tracked: Floats, noise: Floats) -> float:
        phi, late, mount = self.mean[2], self.mean[-1], self.mean[3:][MOUNT]
        v, omega = twist
        ahead, left = v * late + mount[0], mount[1]
        expected = compose(self.mean[:3], np.array([ahead, left, omega * late]))
        h = np.zeros((3, len(self.mean)))
        h[:, :3] = np.eye(3)
        cos, sin = np.cos(phi), np.sin(phi)
        h[0, 2], h[1, 2] = -sin * ahead - cos * left, cos * ahead - sin * left
        h[:2, 3:][:, MOUNT] = _turn(phi)
        h[:, -1] = v * cos, v * sin, omega
        off = tracked - expected
        off[2] = wrap(off[2])
        innovation = h @ self.covariance @ h.T + np.diag(noise)
        square = float(off @ np.linalg.solve(innovation, off))
        if square > OUTLIER:
            self.n_odd += 1
            self.forget_pose()
            return square
        gain = np.linalg.solve(innovation, h @ self.covariance).T
        self.mean += gain @ off
        self.covariance -= gain @ h @ self.covariance
        self.covariance = 0.5 * (self.covariance + self.covariance.T)
        self.n += 1
        self.scale += (square / 3.0 - self.scale) / min(self.n, 100)
        return square


def _turn(phi: float) -> Floats:
    cos, sin = np.cos(phi), np.sin(phi)
    return np.array([[cos, -sin], [sin, cos]])
