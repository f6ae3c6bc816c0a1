"""Smooth all poses of a run at once, given steps between consecutive scans and poses of scans matched to a map.

The estimate minimises, over all poses x_k = (x, y, phi),

    sum_k |inv(x_k) ∘ x_(k+1) - steps_k|²_W  +  sum_k rho(|x_k - places_k|²_P).

W is `step_information`, P is `place_information`, and rho is Cauchy's function. Gauss-Newton solves it.

The normal equations couple neighbours only, so that they are banded: 13,000 scans take well under a second.
Two sweeps give the diagonal blocks of the inverse, as in the RTS smoother (Golub and Plemmons 1980).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solveh_banded

from logs.transforms import compose, difference, invert, wrap
from sensorgraph.localization.scan_track import ScanTrack, step_derivatives
from sensorgraph.localization.settings import CAUCHY, SMOOTHING
from sensorgraph.types import Bools, Floats

ITERATIONS = 6
"""Maximum number of Gauss-Newton steps. Poses start within centimetres, so that two or three steps suffice."""
UNMATCHED_FACTOR = 10.0
"""Factor on the standard deviation of a step where the front end did not match a scan, without odometry."""
UNKNOWN_STEP = 100.0
"""[m, rad] Standard deviation of a step where the motion is not known."""
_COLUMNS = np.arange(3)


@dataclass(frozen=True, kw_only=True, eq=False)
class SmoothedPoses:
    """Smoothed poses with covariances."""

    poses: Floats
    """(n, 3) [m, m, rad]"""
    covariances: Floats
    """(n, 3, 3) of x, y, phi in map."""


def steps_of(track: ScanTrack, breaks: Bools | None = None) -> tuple[Floats, Floats]:
    """Return the laser odometry as steps (n - 1, 3) from scan to scan, with their information (n - 1, 3, 3).

    Parameters
    ----------
    breaks : (n,) The motion from the previous scan is not known. None: where the track is not continuous.
    """
    s = SMOOTHING
    steps = compose(invert(track.poses[:-1]), track.poses[1:])
    way, turn = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    sd = np.asarray(s.step_floor) + (s.step_per_metre * way + s.step_per_turn * turn)[:, None]
    unmatched = ~(track.matched[:-1] & track.matched[1:])
    if track.wheels is None:
        sd[unmatched] *= UNMATCHED_FACTOR
    else:
        sd[unmatched] = track.wheels.deviations(way[unmatched], turn[unmatched])
    sd[(~track.is_continuous if breaks is None else breaks)[1:]] = UNKNOWN_STEP
    information = np.zeros((len(sd), 3, 3))
    information[:, _COLUMNS, _COLUMNS] = sd**-2.0
    return steps, information


def smooth(
    start: Floats, steps: Floats, step_information: Floats, places: Floats, place_information: Floats
) -> SmoothedPoses:
    """Return the poses that minimise the weighted squared errors of steps and places (see the module).

    Parameters
    ----------
    start : (n, 3) [m, m, rad] Initial poses.
    steps : (n - 1, 3) Pose of each scan in the frame of the previous one.
    step_information : (n - 1, 3, 3) Information of the steps.
    places : (n, 3) Measured poses in map.
    place_information : (n, 3, 3) Information of x, y, phi in map; zeros for a scan without a measured pose.
    """
    poses = start.copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    for _ in range(ITERATIONS):
        diagonal, lower, gradient = _normal_equations(
            poses, steps, step_information, places, place_information
        )
        move = solveh_banded(_banded(diagonal, lower), -gradient.ravel(), lower=True).reshape(-1, 3)
        poses += move
        if np.abs(move).max() < 1e-6:
            break
    diagonal, lower, _ = _normal_equations(poses, steps, step_information, places, place_information)
    poses[:, 2] = wrap(poses[:, 2])
    return SmoothedPoses(poses=poses, covariances=_inverse_blocks(diagonal, lower))


def _weights(poses: Floats, places: Floats, place_information: Floats) -> Floats:
    """Return Cauchy's weight (n,) of each measured pose: 1 / (1 + |x_k - places_k|²_P / (3 CAUCHY²))."""
    off = difference(poses, places)
    square = np.einsum("ni,nij,nj->n", off, place_information, off)
    return np.asarray(1.0 / (1.0 + square / (3 * CAUCHY**2)))


def _normal_equations(
    poses: Floats, steps: Floats, step_information: Floats, places: Floats, place_information: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return the blocks of the normal equations of one Gauss-Newton step, and the gradient.

    The blocks of JᵀWJ are `diagonal` (n, 3, 3) and, below it, `lower` (n - 1, 3, 3). The gradient (n, 3) is
    JᵀWr. Places have the weights of `_weights`.
    """
    off = difference(poses, places)
    weighted = place_information * _weights(poses, places, place_information)[:, None, None]
    diagonal = weighted + 1e-9 * np.eye(3)
    gradient = np.einsum("nij,nj->ni", weighted, off)
    way = poses[1:, :2] - poses[:-1, :2]
    first, second = step_derivatives(poses[:-1], poses[1:])
    errors = np.einsum("nij,nj->ni", second[:, :2, :2], way) - steps[:, :2]
    errors = np.column_stack([errors, wrap(poses[1:, 2] - poses[:-1, 2] - steps[:, 2])])
    first_weighted = np.einsum("nji,njk->nik", first, step_information)
    second_weighted = np.einsum("nji,njk->nik", second, step_information)
    diagonal[:-1] += first_weighted @ first
    diagonal[1:] += second_weighted @ second
    gradient[:-1] += np.einsum("nij,nj->ni", first_weighted, errors)
    gradient[1:] += np.einsum("nij,nj->ni", second_weighted, errors)
    return diagonal, second_weighted @ first, gradient


def _banded(diagonal: Floats, lower: Floats) -> Floats:
    """Return the lower bands (6, 3 n) in the format of scipy."""
    n = len(diagonal)
    bands = np.zeros((6, n, 3))
    for column in range(3):
        for row in range(column, 3):
            bands[row - column, :, column] = diagonal[:, row, column]
        for row in range(3):
            bands[3 + row - column, :-1, column] = lower[:, row, column]
    return bands.reshape(6, 3 * n)


def _inverse_blocks(diagonal: Floats, lower: Floats) -> Floats:
    """Return the diagonal blocks (n, 3, 3) of the inverse by block elimination and back substitution.

    With D and L the blocks on and below the diagonal: S_k = D_k - L_(k-1) inv(S_(k-1)) L_(k-1)ᵀ and G_k = L_k
    inv(S_k) forwards, then P_k = inv(S_k) + G_kᵀ P_(k+1) G_k backwards from P_n = inv(S_n).
    """
    n = len(diagonal)
    schur = np.empty_like(diagonal)  # S_k: Schur complement after elimination of all earlier blocks
    schur[0] = diagonal[0]
    gains = np.empty((max(n - 1, 0), 3, 3))
    for k in range(1, n):
        gains[k - 1] = lower[k - 1] @ np.linalg.inv(schur[k - 1])
        schur[k] = diagonal[k] - gains[k - 1] @ lower[k - 1].T
    blocks = np.empty_like(diagonal)
    blocks[-1] = np.linalg.inv(schur[-1])
    for k in range(n - 2, -1, -1):
        blocks[k] = np.linalg.inv(schur[k]) + gains[k].T @ blocks[k + 1] @ gains[k]
    return (blocks + blocks.transpose(0, 2, 1)) / 2
