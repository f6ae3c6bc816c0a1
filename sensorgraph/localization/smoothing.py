"""All poses of a run at once: steps from one scan to the next, and places where scans fitted a map.

The normal equations couple neighbours only, so they are banded: a Cholesky factor of 13,000 scans takes a blink, and the
diagonal blocks of the inverse follow by two sweeps (Golub and Plemmons 1980; RTS smoothing in other words).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solveh_banded

from logs.transforms import compose, invert, wrap
from sensorgraph.localization.front_end import ScanTrack
from sensorgraph.localization.settings import SMOOTHING, SmoothingSettings
from sensorgraph.types import Bools, Floats

ITERATIONS = 6
"""Gauss-Newton steps; poses start within centimetres, so that two or three change anything."""
CAUCHY = 3.0
"""[standard deviations] from which on a place counts less and less."""
_COLUMNS = np.arange(3)


@dataclass(frozen=True, kw_only=True, eq=False)
class SmoothedPoses:
    """Poses and how well each is known."""

    poses: Floats
    """(n, 3) [m, m, rad]"""
    covariances: Floats
    """(n, 3, 3) of x, y, phi in map."""


def steps_of(
    track: ScanTrack, breaks: Bools | None = None, settings: SmoothingSettings = SMOOTHING
) -> tuple[Floats, Floats]:
    """Return the laser's odometry as steps (n - 1, 3) from scan to scan, and their information (n - 1, 3, 3).

    Parameters
    ----------
    breaks : (n,) the way from the scan before is not known; None: where the track does not go on
    """
    s = settings
    steps = compose(invert(track.poses[:-1]), track.poses[1:])
    way, turn = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    sd = np.asarray(s.step_floor) + (s.step_per_metre * way + s.step_per_turn * turn)[:, None]
    sd[~track.matched[1:]] *= s.blind_step
    sd[(~track.goes_on if breaks is None else breaks)[1:]] = s.broken_step
    information = np.zeros((len(sd), 3, 3))
    information[:, _COLUMNS, _COLUMNS] = sd**-2.0
    return steps, information


def smooth(
    start: Floats, steps: Floats, step_information: Floats, places: Floats, place_information: Floats
) -> SmoothedPoses:
    """Find the poses that fit steps and places best.

    Parameters
    ----------
    start : (n, 3) [m, m, rad] poses to start from
    steps : (n - 1, 3) pose of each scan in the one before it
    step_information : (n - 1, 3, 3) of these
    places : (n, 3) poses in map as measured
    place_information : (n, 3, 3) of x, y, phi in map; zeros where there is none
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


def _normal_equations(
    poses: Floats, steps: Floats, step_information: Floats, places: Floats, place_information: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return diagonal blocks (n, 3, 3), those below (n - 1, 3, 3), and the gradient (n, 3)."""
    n = len(poses)
    off = poses - places
    off[:, 2] = wrap(off[:, 2])
    square = np.einsum("ni,nij,nj->n", off, place_information, off)
    weighted = place_information / (1.0 + square / (3 * CAUCHY**2))[:, None, None]
    diagonal = weighted + 1e-9 * np.eye(3)
    gradient = np.einsum("nij,nj->ni", weighted, off)
    way = poses[1:, :2] - poses[:-1, :2]
    cos, sin = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    back = np.zeros((n - 1, 3, 3))
    back[:, 0, 0], back[:, 0, 1], back[:, 1, 0], back[:, 1, 1], back[:, 2, 2] = cos, sin, -sin, cos, 1.0
    ahead = -back.copy()
    ahead[:, 0, 2] = -sin * way[:, 0] + cos * way[:, 1]
    ahead[:, 1, 2] = -cos * way[:, 0] - sin * way[:, 1]
    errors = np.einsum("nij,nj->ni", back[:, :2, :2], way) - steps[:, :2]
    errors = np.column_stack([errors, wrap(poses[1:, 2] - poses[:-1, 2] - steps[:, 2])])
    pull_from = np.einsum("nji,njk->nik", ahead, step_information)
    pull_to = np.einsum("nji,njk->nik", back, step_information)
    diagonal[:-1] += pull_from @ ahead
    diagonal[1:] += pull_to @ back
    gradient[:-1] += np.einsum("nij,nj->ni", pull_from, errors)
    gradient[1:] += np.einsum("nij,nj->ni", pull_to, errors)
    return diagonal, pull_to @ ahead, gradient


def _banded(diagonal: Floats, lower: Floats) -> Floats:
    """Return the lower bands (6, 3 n) that scipy takes."""
    n = len(diagonal)
    bands = np.zeros((6, n, 3))
    for column in range(3):
        for row in range(column, 3):
            bands[row - column, :, column] = diagonal[:, row, column]
        for row in range(3):
            bands[3 + row - column, :-1, column] = lower[:, row, column]
    return bands.reshape(6, 3 * n)


def _inverse_blocks(diagonal: Floats, lower: Floats) -> Floats:
    """Return the diagonal blocks (n, 3, 3) of the inverse."""
    n = len(diagonal)
    ahead = np.empty_like(diagonal)  # what is left of a block once all before it are eliminated
    ahead[0] = diagonal[0]
    gains = np.empty((max(n - 1, 0), 3, 3))
    for k in range(1, n):
        gains[k - 1] = lower[k - 1] @ np.linalg.inv(ahead[k - 1])
        ahead[k] = diagonal[k] - gains[k - 1] @ lower[k - 1].T
    out = np.empty_like(diagonal)
    out[-1] = np.linalg.inv(ahead[-1])
    for k in range(n - 2, -1, -1):
        out[k] = np.linalg.inv(ahead[k]) + gains[k].T @ out[k + 1] @ gains[k]
    return (out + out.transpose(0, 2, 1)) / 2
