"""Strata: selection of rays with equal numbers from each place and direction, so that rare views are kept."""

from __future__ import annotations

import numpy as np

from sensorgraph.types import Floats, Ints

CELL, SECTOR = 0.5, np.radians(15.0)
"""[m, rad] Size of the cells and of the sectors of direction from which samples take up to the same number of rays."""


def spread_evenly(places: Floats, turn: Floats, most: int) -> tuple[Ints, Floats]:
    """Select at most `most` rays, with up to the same number from each cell and sector, spread evenly within it.

    The selection depends on the origin of a ray and not on its outcome, so visibility remains unbiased.

    Parameters
    ----------
    places : (n, 2) [m] Starts of the rays.
    turn : (n,) [rad] Directions of the rays.

    Returns
    -------
    (m,) indices, ascending; and (m,) number of rays of its cell and sector that each represents
    """
    sector = np.floor(turn / SECTOR)
    cell = np.floor(places / CELL)
    key = np.ravel_multi_index(
        tuple((column - column.min()).astype(np.intp) for column in (*cell.T, sector)),
        tuple(int(np.ptp(column)) + 1 for column in (*cell.T, sector)),
    )
    short = key.astype(np.min_scalar_type(key.max(initial=0)))  # up to 16 bits are sorted by radix
    order = np.argsort(short, kind="stable")
    start = np.flatnonzero(np.diff(key[order], prepend=-1))
    count = np.diff(start, append=len(key))
    kept = np.repeat(np.minimum(count, _even_share(count, most)), count)
    rank, count = np.arange(len(key)) - np.repeat(start, count), np.repeat(count, count)
    is_kept = (rank + 1) * kept // count > rank * kept // count
    weight = np.empty(len(key))
    weight[order] = count / np.maximum(kept, 1)
    chosen = np.sort(order[is_kept])
    return chosen, weight[chosen]


def _even_share(count: Ints, most: int) -> int:
    """Return the largest number m for which sum_i min(count_i, m) <= most."""
    rising = np.sort(count)
    below = np.concatenate([[0], np.cumsum(rising)[:-1]])
    total = below + rising * np.arange(len(rising), 0, -1)  # total if m equals this count
    k = int(np.searchsorted(total, most, side="right"))
    return int((most - below[k]) // (len(rising) - k)) if k < len(rising) else int(rising[-1])
