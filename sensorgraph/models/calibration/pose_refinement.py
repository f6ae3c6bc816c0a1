"""Training poses refined against the faces: three numbers a scan, damped by the noise that the poses have.

Their noise is estimated with them (empirical Bayes), so poses that are exact stay as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from planners.kernel import kernel
from sensorgraph.models.calibration.matching import Matches, Readings
from sensorgraph.models.calibration.settings import CALIBRATION
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.types import Floats, Ints

POSES = CALIBRATION.poses


@dataclass(frozen=True, kw_only=True, eq=False)
class RefinedPoses:
    """Corrections of poses, and what they are worth."""

    shifts: Floats
    """(n_scans, 3) [m, m, rad] of each laser in its own frame."""
    sigma_xy: float
    """[m] noise of the poses, each axis."""
    sigma_yaw: float
    """[rad]"""
    log_evidence: float
    """Log evidence of noisy poses over exact ones."""
    errors: tuple[float, float]
    """[m, rad] standard errors of the poses so refined, each axis and the heading, in the mean over scans."""


def refine_poses(
    readings: Readings, lasers: Floats, matches: Matches, faces: FaceSet, shifts: Floats, sigma: float
) -> RefinedPoses:
    """Refine poses by returns of range noise `sigma` [m].

    Parameters
    ----------
    lasers : (n_poses, 3) [m, m, rad] in map
    shifts : (n_scans, 3) [m, m, rad] applied to them already; all rays of a scan share one, of a sweep, too
    """
    n = len(shifts)
    own, right = np.zeros((n, 3, 3)), np.zeros((n, 3))
    heading = lasers[readings.pose, 2]
    weight = np.where(matches.weight > 0, matches.probability / sigma**2, 0.0)
    _pose_equations(
        readings.scan, np.cos(heading), np.sin(heading), np.maximum(matches.face, 0), matches.rho, matches.den,
        matches.along, matches.residual, weight, faces.normals, own, right,
    )  # fmt: skip
    right += np.einsum("nij,nj->ni", own, shifts)
    seen = own[:, 0, 0] + own[:, 1, 1] > 0
    found = np.zeros((n, 3))
    found[seen], spread, log_evidence, errors = _solve_damped(own[seen], right[seen])
    return RefinedPoses(
        shifts=found,
        sigma_xy=float(np.sqrt(spread[0])),
        sigma_yaw=float(np.sqrt(spread[2])),
        log_evidence=log_evidence,
        errors=errors,
    )


def _solve_damped(own: Floats, right: Floats) -> tuple[Floats, Floats, float, tuple[float, float]]:
    """Solve for the scans' corrections (n, 3) and the variance (3,) that these have; return evidence and errors, too."""
    spread = np.array([POSES.first_noise[0], *POSES.first_noise]) ** 2
    for _ in range(POSES.rounds if len(own) else 0):
        inverse = np.linalg.inv(own + np.diag(1 / spread))
        found = np.einsum("nij,nj->ni", inverse, right)
        second = (found**2 + np.einsum("nii->ni", inverse)).mean(axis=0)
        second[:2] = second[:2].mean()
        spread = np.maximum(second, 1e-12)
    inverse = np.linalg.inv(own + np.diag(1 / spread))
    found = np.einsum("nij,nj->ni", inverse, right)
    explained = 0.5 * float((right * found).sum())
    volume = 0.5 * float(np.linalg.slogdet(np.eye(3) + own * spread[:, None])[1].sum())
    left = np.einsum("nii->ni", inverse).mean(axis=0) if len(own) else np.zeros(3)
    errors = float(np.sqrt(left[:2].mean())), float(np.sqrt(left[2]))
    return found, spread, explained - volume, errors


def is_broken(sigma_xy: float, sigma_yaw: float) -> bool:
    """Tell whether poses are so noisy [m, rad] that no small step mends the log."""
    most_xy, most_yaw = POSES.max_noise
    return sigma_xy > most_xy or sigma_yaw > most_yaw


def compose_poses(lasers: Floats, shifts: Floats) -> Floats:
    """Move lasers (n, 3) by shifts (n, 3) or (3,) in their own frames."""
    cos, sin = np.cos(lasers[:, 2]), np.sin(lasers[:, 2])
    dx, dy, turn = shifts.T
    moved = np.empty_like(lasers)
    moved[:, 0] = lasers[:, 0] + cos * dx - sin * dy
    moved[:, 1] = lasers[:, 1] + sin * dx + cos * dy
    moved[:, 2] = lasers[:, 2] + turn
    return moved


class LaserPoses:
    """Lasers by a mount and by refined poses, composed once for each of them: with a sweep these are millions."""

    def __init__(self, poses: Floats, pose: Ints, scan: Ints) -> None:
        """Take poses (n, 3), and the pose (m,) and the scan (m,) of each reading."""
        self.poses, self.scan = poses, np.zeros(len(poses), dtype=np.intp)
        self.scan[pose] = scan
        self._mounted: tuple[Floats, Floats] | None = None
        self._moved: tuple[Floats, Floats, Floats] | None = None

    def at(self, mount: Floats, shifts: Floats) -> Floats:
        """Return the lasers (n, 3) for a mount (3,) and shifts (n_scans, 3); arrays are told apart by identity."""
        if self._mounted is None or self._mounted[0] is not mount:
            self._mounted, self._moved = (mount, compose_poses(self.poses, mount)), None
        if not shifts.any():
            return self._mounted[1]
        if self._moved is None or self._moved[0] is not mount or self._moved[1] is not shifts:
            self._moved = mount, shifts, compose_poses(self._mounted[1], shifts[self.scan])
        return self._moved[2]


@kernel
def _pose_equations(
    scan: Any,
    cos: Any,
    sin: Any,
    face: Any,
    rho: Any,
    den: Any,
    along: Any,
    residual: Any,
    weight: Any,
    normals: Any,
    own: Any,
    right: Any,
) -> Any:
    x = np.empty(3)
    for i in range(len(scan)):
        w = weight[i]
        if w <= 0:
            continue
        nx, ny = normals[face[i], 0], normals[face[i], 1]
        x[0] = -(nx * cos[i] + ny * sin[i]) / den[i]
        x[1] = -(ny * cos[i] - nx * sin[i]) / den[i]
        x[2] = rho[i] * along[i] / den[i]
        for a in range(3):
            right[scan[i], a] += w * residual[i] * x[a]
            for b in range(3):
                own[scan[i], a, b] += w * x[a] * x[b]
