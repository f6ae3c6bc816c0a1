"""Refinement of the training poses against the faces: three numbers per scan, with an estimated prior.

The correction x_i of scan i minimises sum_j w_j (e_j - a_j·x)² + x' D⁻¹ x, so x_i = (H_i + D⁻¹)⁻¹ g_i.
Here H_i = sum_j w_j a_j a_j' and g_i = sum_j w_j e_j a_j are sums over the scan's returns. D is the variance of the
pose noise, estimated by EM (empirical Bayes): D = mean_i(x_i x_i' + (H_i + D⁻¹)⁻¹), diagonal. Exact poses remain
unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from logs.transforms import compose
from planners.kernel import inner_kernel, outer_kernel
from sensorgraph.models.calibration.matching import Matches, Readings
from sensorgraph.models.calibration.settings import CALIBRATION
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.visibility import ReturnNoise
from sensorgraph.types import Floats, Ints

FIRST_NOISE = np.array([0.005, 0.005, 0.005])
"""[m, m, rad] Initial noise of the poses."""
ROUNDS = 30
"""Number of EM iterations."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RefinedPoses:
    """Corrections of poses and their evidence."""

    shifts: Floats
    """(n_scans, 3) [m, m, rad] correction of each laser pose in its own frame."""
    sigma_xy: float
    """[m] noise of the poses, per axis."""
    sigma_yaw: float
    """[rad] noise of the heading."""
    log_evidence: float
    """[nats] log evidence of noisy poses over exact poses."""
    errors: tuple[float, float]
    """[m, rad] standard errors of the refined poses, per axis and heading, averaged over scans."""


def refine_poses(
    readings: Readings, lasers: Floats, matches: Matches, faces: FaceSet, shifts: Floats, noise: ReturnNoise
) -> RefinedPoses:
    """Refine poses, given returns with the range noise of `noise`.

    Parameters
    ----------
    lasers : (n_poses, 3) [m, m, rad] Poses of the laser in map.
    shifts : (n_scans, 3) [m, m, rad] Corrections already applied to `lasers`, one per scan, also for a sweep.
    """
    n = len(shifts)
    information, rhs = np.zeros((n, 3, 3)), np.zeros((n, 3))
    heading = lasers[readings.pose, 2]
    is_used = matches.weight > 0
    weight = np.where(is_used, matches.probability / noise.at(np.where(is_used, matches.rho, 0.0)) ** 2, 0.0)
    _pose_equations(
        readings.scan, np.cos(heading), np.sin(heading), np.maximum(matches.face, 0), matches.rho, matches.den,
        matches.along, matches.residual, weight, faces.normals, information, rhs, np.empty(3),
    )  # fmt: skip
    rhs += np.einsum("nij,nj->ni", information, shifts)
    seen = information[:, 0, 0] + information[:, 1, 1] > 0
    found = np.zeros((n, 3))
    found[seen], spread, log_evidence, errors = _solve_damped(information[seen], rhs[seen])
    return RefinedPoses(
        shifts=found,
        sigma_xy=float(np.sqrt(spread[0])),
        sigma_yaw=float(np.sqrt(spread[2])),
        log_evidence=log_evidence,
        errors=errors,
    )


def _solve_damped(information: Floats, rhs: Floats) -> tuple[Floats, Floats, float, tuple[float, float]]:
    """Solve x_i = (H_i + D⁻¹)⁻¹ g_i and iterate D by EM; return x (n, 3), D (3,), log evidence and standard errors.

    Log evidence: ½ sum_i g_i·x_i - ½ sum_i log det(I + H_i D).
    """
    spread = FIRST_NOISE**2
    for _ in range(ROUNDS if len(information) else 0):
        inverse = np.linalg.inv(information + np.diag(1 / spread))
        found = np.einsum("nij,nj->ni", inverse, rhs)
        second = (found**2 + np.einsum("nii->ni", inverse)).mean(axis=0)
        second[:2] = second[:2].mean()
        spread = np.maximum(second, 1e-12)
    inverse = np.linalg.inv(information + np.diag(1 / spread))
    found = np.einsum("nij,nj->ni", inverse, rhs)
    explained = 0.5 * float((rhs * found).sum())
    volume = 0.5 * float(np.linalg.slogdet(np.eye(3) + information * spread[:, None])[1].sum())
    left = np.einsum("nii->ni", inverse).mean(axis=0) if len(information) else np.zeros(3)
    errors = float(np.sqrt(left[:2].mean())), float(np.sqrt(left[2]))
    return found, spread, explained - volume, errors


def exceeds_max_noise(sigma_xy: float, sigma_yaw: float) -> bool:
    """Return whether the noise of the poses [m, rad] exceeds what small corrections can repair."""
    most_xy, most_yaw = CALIBRATION.max_pose_noise
    return sigma_xy > most_xy or sigma_yaw > most_yaw


class LaserPoses:
    """Poses of the laser from a mount and refined poses; the results are cached, since a sweep has millions of poses."""

    def __init__(self, poses: Floats, pose: Ints, scan: Ints) -> None:
        """Store poses (n, 3), and the indices of pose (m,) and scan (m,) of each reading."""
        self.poses, self.scan = poses, np.zeros(len(poses), dtype=np.intp)
        self.scan[pose] = scan
        self._mounted: tuple[Floats, Floats] | None = None
        self._moved: tuple[Floats, Floats, Floats] | None = None

    def at(self, mount: Floats, shifts: Floats) -> Floats:
        """Return the laser poses (n, 3) for a mount (3,) and shifts (n_scans, 3); the cache compares arrays by identity."""
        if self._mounted is None or self._mounted[0] is not mount:
            self._mounted, self._moved = (mount, compose(self.poses, mount)), None
        if not shifts.any():
            return self._mounted[1]
        if self._moved is None or self._moved[0] is not mount or self._moved[1] is not shifts:
            self._moved = mount, shifts, compose(self._mounted[1], shifts[self.scan])
        return self._moved[2]


@inner_kernel
def pose_slopes(normal: Any, cos: Any, sin: Any, rho: Any, den: Any, along: Any) -> Any:
    """Return a = (-n·e_x, -n·e_y, rho t·u) / n·u: change of a residual with x, y [m] and yaw [rad] of the laser in its own frame.

    Parameters
    ----------
    cos, sin : Of the heading: e_x = (cos, sin), e_y = (-sin, cos).
    den, along : n·u and t·u.
    """
    nx, ny = normal
    return -(nx * cos + ny * sin) / den, -(ny * cos - nx * sin) / den, rho * along / den


@outer_kernel
def _pose_equations(
    scan: Any, cos: Any, sin: Any, face: Any, rho: Any, den: Any, along: Any, residual: Any, weight: Any,
    normals: Any, information: Any, rhs: Any, x: Any,
) -> Any:  # fmt: skip
    """Add H_i = sum_j w_j a_j a_j' to `information` (n, 3, 3) and g_i = sum_j w_j e_j a_j to `rhs` (n, 3) of each scan; `x` (3,) is memory."""
    for i in range(len(scan)):
        w = weight[i]
        if w <= 0:
            continue
        x[0], x[1], x[2] = pose_slopes(normals[face[i]], cos[i], sin[i], rho[i], den[i], along[i])
        for a in range(3):
            rhs[scan[i], a] += w * residual[i] * x[a]
            for b in range(3):
                information[scan[i], a, b] += w * x[a] * x[b]
