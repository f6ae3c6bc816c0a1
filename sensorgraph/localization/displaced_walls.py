"""Pose errors from walls that are displaced as a whole, as in an occupancy grid: a cell does not state where in it its wall is.

The wall w of return k is displaced along its normal n by δ_w, with mean 0 and standard deviation σ_w. To first order in the pose
error d, the distance of the return from the map is r_k = δ_w - J_k d, J_k = nᵀ (I, R'(phi) p_k). A match minimises
Σ r_k² / v + dᵀ P d, with P the information of the prior and v the variance of the returns. So

    d = A⁻¹ Σ_w δ_w g_w,   A = Σ_k J_kᵀ J_k + v P,   g_w = Σ_(k on w) J_kᵀ,
    cov d = A⁻¹ G A⁻¹,     G = Σ_w σ_w² g_w g_wᵀ,
    E Σ_k r_k² = Σ_k σ_w² - trace(A⁻¹ G).

All scans of a place meet the same walls, so that smoothing does not reduce these errors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from sensorgraph.localization.likelihood_field import points_with_owners
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.types import Floats, Ints

REACH = 2.0
"""Distance of a return from its wall, in units of the side of a cell: half a cell by the displacement, the rest by pose and noise."""


class StraightWalls(NamedTuple):
    """Straight walls of an occupancy grid."""

    walls: Floats
    """(n, 2, 2) [m, map] Both ends of each wall."""
    normals: Floats
    """(n, 2) Unit normals towards free space; 0, 0: both sides match."""
    deviations: Floats
    """(n,) [m] Standard deviation of the displacement along the normal."""
    lines: Ints
    """(n,) Number of the line of each wall; parts of one line have one displacement."""
    cell: float
    """[m] Side of a cell."""


def straight_walls_of_grid(walls: Floats, normals: Floats, axis: Floats, cell: float) -> StraightWalls:
    """Return straight walls with their displacements.

    The surface is anywhere in its cells, uniformly: σ = cell / √12. A slanting wall averages over the m + 1 rows that it crosses:
    its position in a cell is a sawtooth of the way along it, whose mean over m whole periods is known, so σ = cell / √12 / (m + 1).

    Parameters
    ----------
    axis : (2,) Unit vector along the rows of the grid.
    """
    ahead = walls[:, 1] - walls[:, 0]
    along = np.abs(np.column_stack([ahead @ axis, ahead @ [-axis[1], axis[0]]]))
    rows = np.floor(along.min(axis=1) / cell + 0.5)
    direction = ahead / np.maximum(np.hypot(*ahead.T), 1e-9)[:, None]
    direction *= np.where(direction[:, :1] + 1e-6 * direction[:, 1:] < 0, -1.0, 1.0)
    offset = direction[:, 0] * walls[:, 0, 1] - direction[:, 1] * walls[:, 0, 0]
    key = np.round(np.column_stack([direction, offset / cell]) * [20.0, 20.0, 4.0]).astype(np.int64)
    lines = np.unique(key, axis=0, return_inverse=True)[1].reshape(-1)
    return StraightWalls(walls, normals, cell / np.sqrt(12.0) / (rows + 1.0), lines, cell)


def displacement_errors(
    scans: ScanPoints, poses: Floats, noise: Floats, place: StraightWalls, prior: Floats
) -> tuple[Floats, Floats]:
    """Return the covariances (n_scans, 3, 3) of the poses and the variances (n_scans,) [m²] of the returns around the map.

    Parameters
    ----------
    poses : (n_scans, 3) Matched poses.
    noise : (n_scans,) [m] Scatter of the returns around the walls; nan: not matched, then the results are those of the next
        matched scan.
    prior : (3,) [m, m, rad] Standard deviations of the prior of the matches.
    """
    points, owner = points_with_owners(place.walls, place.cell)
    tree = cKDTree(points)
    ahead = place.walls[:, 1] - place.walls[:, 0]
    ahead /= np.maximum(np.hypot(*ahead.T), 1e-9)[:, None]
    covariances, variances = np.zeros((len(poses), 3, 3)), np.zeros(len(poses))
    for k in np.flatnonzero(np.isfinite(noise)):
        c, s = np.cos(poses[k, 2]), np.sin(poses[k, 2])
        turned = scans.points[scans.of(int(k))] @ np.array([[c, s], [-s, c]])
        distance, nearest = (
            np.asarray(one)
            for one in tree.query(turned + poses[k, :2], distance_upper_bound=REACH * place.cell)
        )
        near = np.isfinite(distance)
        if not near.any():
            continue
        wall, arm = owner[nearest[near]], turned[near]
        normal = np.column_stack([-ahead[wall, 1], ahead[wall, 0]])
        rows = np.column_stack([normal, normal[:, 1] * arm[:, 0] - normal[:, 0] * arm[:, 1]])
        met, line = np.unique(place.lines[wall], return_inverse=True)
        g = np.zeros((len(met), 3))
        np.add.at(g, line, rows * place.deviations[wall][:, None])
        inverse = np.linalg.inv(rows.T @ rows + np.diag((noise[k] / prior) ** 2))
        spread = g.T @ g
        covariances[k] = inverse @ spread @ inverse
        square = (place.deviations[wall] ** 2).sum() - np.trace(inverse @ spread)
        variances[k] = max(float(square), 0.0) / int(near.sum())
    matched = np.flatnonzero(np.isfinite(noise))
    if not len(matched):
        return covariances, variances
    of_next = matched[np.searchsorted(matched, np.arange(len(poses))).clip(max=len(matched) - 1)]
    return covariances[of_next], variances[of_next]
