"""Sums over rays by the wall that each meets: what the corners of the map add to the normal equations.

`wall_sums` is compiled; `plain_wall_sums` says the same in numpy and is what tests hold it against.
"""

from __future__ import annotations

import numpy as np

from planners.kernel import kernel
from sensorgraph.types import Floats, Ints

Sums = tuple[Floats, Floats, Floats, Floats]


@kernel
def wall_sums(
    w: Floats, pose: Floats, stack: Floats, ends: Floats, wall: Ints, y: Floats, n_walls: int
) -> Sums:
    """Return weighted products of wall ends with poses, columns, readings and each other, wall by wall.

    Parameters
    ----------
    w : (n_scans, n_rays) [1/m²] weights; 0 leaves a ray out
    pose : (n_scans, 3, n_rays) columns of the pose of each scan
    stack : (n_scans, k, n_rays) columns that all scans share
    ends : (2, n_scans, n_rays) what each end of the wall does to the reading
    wall : (n_scans, n_rays) index of the wall
    y : (n_scans, n_rays) [m] residuals

    Returns
    -------
    (n_scans, 3, 2, n_walls), (k, 2, n_walls), (2, n_walls), (2, 2, n_walls)
    """
    n_scans, n_rays = w.shape
    k = stack.shape[1]
    cl = np.zeros((n_scans, 3, 2, n_walls))
    gl = np.zeros((k, 2, n_walls))
    rl = np.zeros((2, n_walls))
    square = np.zeros((2, 2, n_walls))
    for i in range(n_scans):
        for m in range(n_rays):
            weight = w[i, m]
            if weight == 0.0:
                continue
            at = wall[i, m]
            first, last = weight * ends[0, i, m], weight * ends[1, i, m]
            for axis in range(3):
                cl[i, axis, 0, at] += first * pose[i, axis, m]
                cl[i, axis, 1, at] += last * pose[i, axis, m]
            rl[0, at] += first * y[i, m]
            rl[1, at] += last * y[i, m]
            square[0, 0, at] += first * ends[0, i, m]
            square[0, 1, at] += first * ends[1, i, m]
            square[1, 1, at] += last * ends[1, i, m]
        for j in range(k):
            for m in range(n_rays):
                value = w[i, m] * stack[i, j, m]
                if value != 0.0:
                    gl[j, 0, wall[i, m]] += value * ends[0, i, m]
                    gl[j, 1, wall[i, m]] += value * ends[1, i, m]
    for at in range(n_walls):
        square[1, 0, at] = square[0, 1, at]
    return cl, gl, rl, square


def plain_wall_sums(
    w: Floats, pose: Floats, stack: Floats, ends: Floats, wall: Ints, y: Floats, n_walls: int
) -> Sums:
    """Return what `wall_sums` does, wall by wall."""
    masks = [np.where(wall == k, w, 0.0) for k in range(n_walls)]
    cl = np.stack([np.einsum("nm,enm,nam->nae", mask, ends, pose) for mask in masks], axis=-1)
    gl = np.stack([np.einsum("nm,enm,njm->je", mask, ends, stack) for mask in masks], axis=-1)
    rl = np.stack([np.einsum("nm,enm,nm->e", mask, ends, y) for mask in masks], axis=-1)
    square = np.stack([np.einsum("nm,enm,fnm->ef", mask, ends, ends) for mask in masks], axis=-1)
    return cl, gl, rl, square
