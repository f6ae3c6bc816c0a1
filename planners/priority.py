"""Priorities of bins as bands of cells, bands of rooms, and values of bins.

Robots that turn in place complete one band of cells after the other. Cars cannot turn within a band: with
bands of cells their drive took 50 % longer and visited the high-priority bins no earlier. Cars therefore take
the rooms by mean priority, and within a room the bins of high priority have a higher value. The constants
were set with `python -m benchmarks.plan_options priority`.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from planners.types import Bools, Floats, Ints

BANDS = 4
"""Number of priority levels, driven one after the other."""
MEDIAN_RADIUS = 0.75
"""[m] Radius of the median filter over bands: scattered cells cost more driving than they are worth."""
VALUE_RANGE = 3.0
"""Value of the bin of highest priority minus that of lowest, for a car's search; the lowest is worth 1."""


def cell_bands(priority: Floats | None, todo: Bools, cell: float) -> Ints:
    """Return the band (nx, ny) of each cell of `todo` (nx, ny, n_phi); the lowest band comes first.

    Parameters
    ----------
    priority : (nx, ny, n_phi) Higher comes earlier.
    cell : [m] Side of a cell.
    """
    band = np.zeros(todo.shape[:2], dtype=np.int64)
    if priority is None or not todo.any():
        return band
    cells = np.asarray(todo.any(axis=2))
    score = mean(priority, todo)
    marks = np.unique(np.quantile(score[cells], np.arange(1, BANDS) / BANDS))
    band[cells] = -np.searchsorted(marks, score[cells], side="left")
    return _middle_of(band, cells, MEDIAN_RADIUS / cell)


def room_bands(priority: Floats | None, todo: Bools, rooms: list[Bools]) -> Ints:
    """Return the band (n_rooms,) of each room, a mask (nx, ny), by its mean priority; the lowest band comes first."""
    if priority is None or not rooms:
        return np.zeros(len(rooms), dtype=np.int64)
    score = np.array([mean(priority, todo & room[:, :, None], over=(0, 1, 2)) for room in rooms])
    low, high = score.min(), score.max()
    if high - low <= 1e-9 * max(abs(high), 1.0):
        return np.zeros(len(rooms), dtype=np.int64)
    return np.asarray(-np.ceil(BANDS * (score - low) / (high - low)).clip(1, BANDS), dtype=np.int64)


def bin_values(priority: Floats | None, todo: Bools) -> Floats:
    """Return the value (nx, ny) of a bin in each cell, by the rank of the cell's mean priority.

    Values are from 1 to 1 + VALUE_RANGE.
    """
    out = np.ones(todo.shape[:2])
    cells = np.asarray(todo.any(axis=2))
    if priority is None or not cells.any():
        return out
    distinct, rank = np.unique(mean(priority, todo)[cells], return_inverse=True)
    out[cells] += VALUE_RANGE * rank / max(len(distinct) - 1, 1)
    return out


def mean(priority: Floats, todo: Bools, over: tuple[int, ...] = (2,)) -> Floats:
    """Return the mean priority of the bins of `todo` over some axes; 0 where there are none."""
    return np.asarray(np.where(todo, priority, 0.0).sum(axis=over) / np.maximum(todo.sum(axis=over), 1))


def _middle_of(band: Ints, cells: Bools, radius: float) -> Ints:
    """Return the median band (nx, ny) of the cells within a radius [cells] of each cell."""
    k = int(radius)
    if k < 1:
        return band
    x, y = np.mgrid[-k : k + 1, -k : k + 1]
    disc = (np.hypot(x, y) <= radius).astype(np.float64)
    count = ndimage.convolve(cells.astype(np.float64), disc, mode="constant")
    out = np.zeros_like(band)
    for own in np.unique(band[cells])[::-1].tolist():
        up_to = ndimage.convolve((cells & (band <= own)).astype(np.float64), disc, mode="constant")
        out[cells & (2 * up_to >= count - 1e-9)] = own
    return out
