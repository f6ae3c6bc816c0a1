"""Search for the best terms of every size by exchange, in Gram space.

A sweep (Goodnight 1979) brings one term into the model or takes it out at the cost of m² operations, and the swept
matrix gives in closed form what every exchange of one term in for one term out would change. So greedy mistakes,
which slow inputs provoke, are repaired without looking at the data again.
"""

from __future__ import annotations

import numpy as np

from robotmodic_ident.kernel import inner_kernel, kernel
from robotmodic_ident.selection.forward import DEPENDENCE_TOLERANCE, TIE_TOLERANCE
from robotmodic_ident.types import Bools, Floats, Ints

MIN_EXCHANGE_GAIN = 1e-10
"""An exchange must lower the residual sum by this share."""
MAX_PASSES = 6
"""Passes up and down over all sizes at most; most outputs need 2."""
EXCHANGES_PER_SIZE = 4
"""Exchanges at one size at most, times the number of sizes: rounding must not exchange for ever."""


@inner_kernel
def sweep(a: Floats, k: int) -> None:
    """Bring variable k in, or take it out again: the two undo each other but for the sign of a row, kept here."""
    n = len(a)
    pivot = a[k, k]
    for j in range(n):
        a[k, j] /= pivot
    for i in range(n):
        if i != k:
            b = a[i, k]
            if b != 0.0:
                for j in range(n):
                    a[i, j] -= b * a[k, j]
            a[i, k] = -b / pivot
    a[k, k] = 1.0 / pivot


@inner_kernel
def best_addition(a: Floats, inside: Bools, usable: Bools) -> int:
    """Return the term that explains most of what is left; -1: all depend on those inside."""
    m = len(a) - 1
    best, choice = -1.0, -1
    for j in range(m):
        if usable[j] and not inside[j] and a[j, j] > DEPENDENCE_TOLERANCE:
            gain = a[j, m] * a[j, m] / a[j, j]
            if gain > best * (1.0 + TIE_TOLERANCE):
                best, choice = gain, j
    return choice


@inner_kernel
def best_removal(a: Floats, inside: Bools, locked: Bools) -> int:
    """Return the term inside whose loss costs least; -1: all are locked."""
    m = len(a) - 1
    least, choice = np.inf, -1
    for i in range(m):
        if inside[i] and not locked[i]:
            loss = a[i, m] * a[i, m] / a[i, i]
            if loss < least:
                least, choice = loss, i
    return choice


@inner_kernel
def exchange(a: Floats, inside: Bools, locked: Bools, usable: Bools) -> bool:
    """Make the best exchange of one term for another; False: none lowers the residual sum."""
    m = len(a) - 1
    least = -MIN_EXCHANGE_GAIN * max(a[m, m], 1e-15)
    out, into = -1, -1
    for i in range(m):
        if not inside[i] or locked[i]:
            continue
        h, theta = a[i, i], a[i, m]
        loss = theta * theta / h
        for j in range(m):
            if inside[j] or not usable[j]:
                continue
            shared = a[i, j]
            norm = a[j, j] + shared * shared / h  # as if i were out
            if norm > DEPENDENCE_TOLERANCE:
                rest = a[j, m] + shared * theta / h
                change = loss - rest * rest / norm
                if change < least:
                    least, out, into = change, i, j
    if out < 0:
        return False
    sweep(a, out)
    sweep(a, into)
    inside[out], inside[into] = False, True
    return True


@inner_kernel
def settle(a: Floats, inside: Bools, locked: Bools, usable: Bools, most: int) -> None:
    """Exchange terms until no exchange helps, `most` times at most."""
    for _ in range(most):
        if not exchange(a, inside, locked, usable):
            break


@inner_kernel
def copy_mask(source: Bools, target: Bools) -> None:
    """Copy a mask; numba compiles a slice that is written to with all its error texts."""
    for j in range(len(source)):
        target[j] = source[j]


@inner_kernel
def size_of(mask: Bools) -> int:
    """Return how many entries are set."""
    size = 0
    for j in range(len(mask)):
        size += mask[j]
    return size


@inner_kernel
def refresh(a: Floats, original: Floats, inside: Bools) -> None:
    """Sweep anew from the original: rounding does not pile up."""
    for j in range(len(a)):
        for k in range(len(a)):
            a[j, k] = original[j, k]
    for j in range(len(inside)):
        if inside[j]:
            sweep(a, j)


@inner_kernel
def remember(a: Floats, inside: Bools, size: int, rss: Floats, sets: Bools) -> bool:
    """Keep the set if it is the best of its size so far."""
    value = max(a[len(a) - 1, len(a) - 1], 0.0)
    if value < rss[size] * (1.0 - MIN_EXCHANGE_GAIN) - 1e-16:
        rss[size] = value
        copy_mask(inside, sets[size])
        return True
    return False


@inner_kernel
def climb(
    a: Floats, inside: Bools, locked: Bools, usable: Bools, swap: bool, rss: Floats, sets: Bools
) -> bool:
    """Add terms one by one up to the largest size, with exchanges after each; tell whether any size got better."""
    better = False
    size = size_of(inside)
    while size < len(rss) - 1:
        j = best_addition(a, inside, usable)
        if j < 0:
            break
        sweep(a, j)
        inside[j] = True
        size += 1
        if swap:
            settle(a, inside, locked, usable, EXCHANGES_PER_SIZE * len(rss))
        better = remember(a, inside, size, rss, sets) or better
    return better


@inner_kernel
def descend(
    a: Floats, inside: Bools, locked: Bools, usable: Bools, swap: bool, rss: Floats, sets: Bools
) -> bool:
    """Take terms out one by one, with exchanges after each; tell whether any size got better."""
    better = False
    size = size_of(inside)
    while size > 1:
        i = best_removal(a, inside, locked)
        if i < 0:
            break
        sweep(a, i)
        inside[i] = False
        size -= 1
        if swap:
            settle(a, inside, locked, usable, EXCHANGES_PER_SIZE * len(rss))
        better = remember(a, inside, size, rss, sets) or better
    return better


@inner_kernel
def thin(
    a: Floats, original: Floats, inside: Bools, locked: Bools, usable: Bools, rss: Floats, sets: Bools
) -> bool:
    """Take one term out of the best set of every size, largest first; tell whether any size got better.

    inside : (m,) what is written here on the way means nothing
    """
    better = False
    for size in range(len(rss) - 1, 1, -1):
        if not np.isfinite(rss[size]):
            continue
        copy_mask(sets[size], inside)
        refresh(a, original, inside)
        i = best_removal(a, inside, locked)
        if i >= 0:
            sweep(a, i)
            inside[i] = False
            settle(a, inside, locked, usable, EXCHANGES_PER_SIZE * len(rss))
            better = remember(a, inside, size - 1, rss, sets) or better
    return better


@kernel
def search_one(
    original: Floats,
    locked: Bools,
    usable: Bools,
    cost: Floats,
    count: float,
    swap: bool,
    restart: bool,
    rss: Floats,
    sets: Bools,
) -> None:
    """Search the best set of every size for one output.

    Parameters
    ----------
    original : (m + 1, m + 1) Gram of the terms and the output, all of unit norm
    locked, usable : (m,) terms that stay; terms that may be used
    cost : (n_max + 1,) of each size, to find the model whose terms are tried as the first one
    count : rows behind the Gram
    swap : exchange terms
    restart : forward selection from every term of the best model (iOFR: Guo et al. 2015)
    rss : (n_max + 1,) all inf; filled with the unexplained share of the best set of each size
    sets : (n_max + 1, m) filled with these sets
    """
    m, n_max = len(original) - 1, len(cost) - 1
    a, inside, spare = np.empty((m + 1, m + 1)), np.empty(m, np.bool_), np.empty(m, np.bool_)
    copy_mask(locked, inside)
    refresh(a, original, inside)
    remember(a, inside, size_of(inside), rss, sets)
    climb(a, inside, locked, usable, swap, rss, sets)
    if swap:
        for _ in range(MAX_PASSES):
            refresh(a, original, inside)
            better = descend(a, inside, locked, usable, swap, rss, sets)
            refresh(a, original, inside)
            better = climb(a, inside, locked, usable, swap, rss, sets) or better
            better = thin(a, original, spare, locked, usable, rss, sets) or better
            if not better:
                break
    if restart:
        tried = spare
        for j in range(m):
            tried[j] = False
        while True:
            best = sets[best_size(rss, cost, count)]
            first = 0
            while first < m and (not best[first] or tried[first] or locked[first]):
                first += 1
            if first == m:
                break
            tried[first] = True
            copy_mask(locked, inside)
            refresh(a, original, inside)
            if a[first, first] > DEPENDENCE_TOLERANCE and size_of(inside) < n_max:
                inside[first] = True
                sweep(a, first)
                climb(a, inside, locked, usable, swap, rss, sets)


@inner_kernel
def best_size(rss: Floats, cost: Floats, count: float) -> int:
    """Return the size with the least N log(rss) + cost."""
    floor = 64 * len(rss) * 2.2e-16
    best, choice = np.inf, 0
    for k in range(len(rss)):
        if np.isfinite(rss[k]):
            value = count * np.log(max(rss[k], floor)) + cost[k]
            if value < best:
                best, choice = value, k
    return choice


def search(
    grams: Floats,
    cross: Floats,
    power: Floats,
    own: Ints,
    locked: Bools,
    usable: Bools,
    cost: Floats,
    count: Floats,
    swap: bool,
    restart: bool,
) -> tuple[Floats, Bools]:
    """Search the best sets of every size for many outputs.

    Parameters
    ----------
    grams : (n_grams, m, m)
    cross : (m, n)
    power, own, count : (n,) Y'Y; which Gram; rows
    locked, usable : (m,)
    cost : (n, n_max + 1)

    Returns
    -------
    rest (n, n_max + 1) unexplained share of the best set of each size; sets (n, n_max + 1, m)
    """
    m, n = cross.shape
    rss = np.full((n, cost.shape[1]), np.inf)
    sets = np.zeros((n, cost.shape[1], m), dtype=np.bool_)
    a = np.empty((m + 1, m + 1))
    for i in range(n):
        gram = grams[own[i]]
        norm = np.sqrt(np.maximum(np.diag(gram), 0.0))
        mine = usable & (norm > 0.0)
        norm = np.where(norm > 0.0, norm, 1.0)
        size = float(np.sqrt(power[i])) if power[i] > 0.0 else 1.0
        a[:m, :m] = gram / (norm[:, None] * norm)
        a[:m, m] = a[m, :m] = cross[:, i] / (norm * size)
        a[m, m] = power[i] / (size * size)
        search_one(a, locked & mine, mine, cost[i], float(count[i]), swap, restart, rss[i], sets[i])
    return rss, sets
