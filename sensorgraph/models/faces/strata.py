"""Strata: which of many rays to keep, as many of each place and direction, so that what was passed once stays."""

from __future__ import annotations

import numpy as np

from sensorgraph.models.faces.settings import FACES
from sensorgraph.types import Floats, Ints

FIT = FACES.fit


def spread_evenly(places: Floats, turn: Floats, most: int) -> tuple[Ints, Floats]:
    """Choose `most` rays at most: of each cell and sector up to the same number, spread evenly over those that there are.

    What is chosen hangs on where a ray comes from, not on what it did, so visibility stays unbiased.

    Parameters
    ----------
    places : (n, 2) [m] where rays start
    turn : (n,) [rad] where they point

    Returns
    -------
    (m,) indices, ascending; and (m,) how many rays of its cell and sector each stands for
    """
    sector = np.floor(turn / FIT.stratum_sector)
    cell = np.floor(places / FIT.stratum_cell)
    key = np.ravel_multi_index(
        tuple((column - column.min()).astype(np.intp) for column in (*cell.T, sector)),
        tuple(int(np.ptp(column)) + 1 for column in (*cell.T, sector)),
    )
    order = np.argsort(key, kind="stable")
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
    """Return the largest number that, taken from each of several counts as far as there is, gives `most` at most."""
    rising = np.sort(count)
    below = np.concatenate([[0], np.cumsum(rising)[:-1]])
    total = below + rising * np.arange(len(rising), 0, -1)  # if each gave as much as this one has
    k = int(np.searchsorted(total, most, side="right"))
    return int((most - below[k]) // (len(rising) - k)) if k < len(rising) else int(rising[-1])
