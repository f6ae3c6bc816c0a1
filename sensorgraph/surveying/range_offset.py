"""Offset of all ranges of a located run against the walls of its place.

A located pose absorbs most of an offset: a laser that looks ahead and measures too long seems to stand further back.
Each scan is therefore fitted by an offset and a small change of its pose together. For a ray with the direction u,
the perpendicular t and a wall with the normal n at the distance r, a change (Δp, Δφ) of the laser's pose changes the
expected range by -(n·Δp + r Δφ n·t) / (n·u).
"""

from __future__ import annotations

import math

import numpy as np

from sensorgraph.types import Bools, Floats, Ints

POSE_SIGMA = (0.3, 0.3, 0.1)
"""[m, m, rad] Prior standard deviation of the change of a pose, which matters only where the walls show nothing."""
LEAST_SLANT = 0.2
"""Least |n·u|: a nearly parallel ray shows its wall's end and not its distance."""
MIN_RAYS = 20
"""Number of rays of a scan below which it is not fitted."""
N_PASSES = 5
"""Number of passes with weights of Cauchy's law, which leave out things that the map lacks."""
INDEPENDENT = 10.0
"""Number of successive scans that count as one: they see the same walls."""


def range_offset(
    residuals: Floats, expected: Floats, angle: Floats, walls: Floats, wall: Ints, usable: Bools
) -> tuple[float, float] | None:
    """Return the offset [m] of a run's ranges and its standard error; None without scans that show it.

    Parameters
    ----------
    residuals : (n_scans, n_rays) [m] Measured minus expected ranges.
    expected : (n_scans, n_rays) [m] Distance of the wall.
    angle : (n_scans, n_rays) [rad, map] Direction of each ray.
    walls : (n_walls, 2, 2) [m, map]
    wall : (n_scans, n_rays) Index of the wall of each ray.
    usable : (n_scans, n_rays) Whether the return is from its wall.
    """
    along = walls[:, 1] - walls[:, 0]
    normals = np.column_stack([-along[:, 1], along[:, 0]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    nx, ny = np.moveaxis(normals[wall], -1, 0)
    c, s = np.cos(angle), np.sin(angle)
    slant = nx * c + ny * s
    usable = usable & (np.abs(slant) > LEAST_SLANT)
    enough = usable.sum(axis=1) >= MIN_RAYS
    if not enough.any():
        return None
    usable, slant = usable[enough], np.where(usable[enough], slant[enough], 1.0)
    off = np.where(usable, residuals[enough], 0.0)
    far = np.where(usable, expected[enough], 0.0)
    turn = far * (ny[enough] * c[enough] - nx[enough] * s[enough])
    columns = np.stack([np.ones_like(off), -nx[enough] / slant, -ny[enough] / slant, -turn / slant], axis=-1)
    weights = usable.astype(np.float64)
    for _ in range(N_PASSES):
        normal = np.einsum("km,kmi,kmj->kij", weights, columns, columns)
        scale = _scale(off, usable)
        normal[:, (1, 2, 3), (1, 2, 3)] += (scale[:, None] / POSE_SIGMA) ** 2
        right = np.einsum("km,kmi,km->ki", weights, columns, off)
        fit = np.linalg.solve(normal, right[..., None])[..., 0]
        left = off - np.einsum("kmi,ki->km", columns, fit)
        weights = usable / (1 + (left / (2 * _scale(left, usable)[:, None])) ** 2)
    information = 1 / np.linalg.inv(normal)[:, 0, 0]
    order = np.argsort(fit[:, 0])
    share = np.cumsum(information[order]) / information.sum()
    middle = float(fit[order, 0][np.searchsorted(share, 0.5)])
    spread = float(np.sqrt(np.average((fit[:, 0] - middle) ** 2, weights=information)))
    n = float(information.sum() ** 2 / (information**2).sum())
    return middle, 1.25 * spread / math.sqrt(max(n / INDEPENDENT, 1.0))


def _scale(off: Floats, usable: Bools) -> Floats:
    """Return the robust scale (n_scans,) [m] of values, at least 1 mm."""
    return np.maximum(1.4826 * np.nanmedian(np.where(usable, np.abs(off), np.nan), axis=1), 1e-3)
