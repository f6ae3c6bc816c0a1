"""Search for the best terms of every size by exchange, on the Gram matrix a = [[Φ'Φ, Φ'y], [y'Φ, y'y]] of unit columns.

A sweep on variable k (Goodnight 1979) adds a term to the model or removes it in m² operations. In this order, it sets
`a_kj = a_kj / a_kk`, `a_ij = a_ij - a_ik a_kj`, `a_ik = -a_ik / a_kk` and `a_kk = 1 / a_kk`, for i, j other than k. In
the swept matrix, with m the index of y, a_mm is the unexplained share of y. Its changes have a closed form:

* Adding term j lowers it by `a_jm² / a_jj`.
* Removing term i raises it by `a_im² / a_ii`.
* Exchanging i for j changes it by `a_im² / a_ii - (a_jm + a_ij a_im / a_ii)² / (a_jj + a_ij² / a_ii)`.

Exchanges correct wrong greedy choices, which are common with slow inputs, without another pass over the data.
"""

from __future__ import annotations

import numpy as np

from robotmodic_ident.kernel import inner_kernel, kernel
from robotmodic_ident.selection.criteria import CONVERGED
from robotmodic_ident.selection.forward import DEPENDENCE_TOLERANCE, TIE_TOLERANCE
from robotmodic_ident.types import Bools, Floats, Ints

MAX_PASSES = 6
"""Maximum number of passes up and down over all sizes; most outputs need 2."""
EXCHANGES_PER_SIZE = 4
"""Maximum number of exchanges at one size, times the number of sizes; prevents endless exchanges due to rounding."""


@inner_kernel
def sweep(a: Floats, k: int) -> None:
    """Sweep on variable k, in place: add it to the model, or remove it; a second sweep restores the matrix."""
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
    """Return the term that lowers the residual sum of squares most; -1 if all depend on those inside."""
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
    """Return the term inside whose removal raises the residual sum of squares least; -1 if all are locked."""
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
    """Make the best exchange of one term for another; return False if none lowers the residual sum of squares."""
    m = len(a) - 1
    least = -CONVERGED * max(a[m, m], 1e-15)
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
            norm = a[j, j] + shared * shared / h  # without term i
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
def exchange_all(a: Floats, inside: Bools, locked: Bools, usable: Bools, most: int) -> None:
    """Exchange terms until no exchange helps, at most `most` times."""
    for _ in range(most):
        if not exchange(a, inside, locked, usable):
            break


@inner_kernel
def copy_mask(source: Bools, target: Bools) -> None:
    """Copy a mask; an explicit loop compiles faster than the assignment of a slice."""
    for j in range(len(source)):
        target[j] = source[j]


@inner_kernel
def size_of(mask: Bools) -> int:
    """Return the number of entries that are set."""
    size = 0
    for j in range(len(mask)):
        size += mask[j]
    return size


@inner_kernel
def sweep_from(a: Floats, original: Floats, inside: Bools) -> None:
    """Fill `a` with the original matrix swept on the terms inside; this limits the accumulation of rounding."""
    for j in range(len(a)):
        for k in range(len(a)):
            a[j, k] = original[j, k]
    for j in range(len(inside)):
        if inside[j]:
            sweep(a, j)


@inner_kernel
def keep_best(a: Floats, inside: Bools, size: int, rss: Floats, sets: Bools) -> bool:
    """Store the set if it is the best of its size so far; return whether it is."""
    value = max(a[len(a) - 1, len(a) - 1], 0.0)
    if value < rss[size] * (1.0 - CONVERGED) - 1e-16:
        rss[size] = value
        copy_mask(inside, sets[size])
        return True
    return False


@inner_kernel
def resize(
    a: Floats, inside: Bools, locked: Bools, usable: Bools, up: bool, swap: bool, rss: Floats, sets: Bools
) -> bool:
    """Add terms one by one up to the largest size, or remove them down to one, with exchanges after each.

    Returns whether any size improved.
    """
    better = False
    size = size_of(inside)
    while (up and size < len(rss) - 1) or (not up and size > 1):
        j = best_addition(a, inside, usable) if up else best_removal(a, inside, locked)
        if j < 0:
            break
        sweep(a, j)
        inside[j] = up
        size += 1 if up else -1
        if swap:
            exchange_all(a, inside, locked, usable, EXCHANGES_PER_SIZE * len(rss))
        better = keep_best(a, inside, size, rss, sets) or better
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
    """Search for the best set of every size for one output.

    Parameters
    ----------
    original : (m + 1, m + 1) Gram matrix of the terms and the output, all of unit norm.
    locked, usable : (m,) Terms that are always kept, and terms that may be used.
    cost : (n_max + 1,) Penalty of each size, which determines the best model for restarts.
    count : Number of rows in the Gram matrix.
    swap : Whether to exchange terms.
    restart : Whether to restart forward selection from every term of the best model (iOFR: Guo et al. 2015).
    rss : (n_max + 1,) All inf; filled with the unexplained share of the best set of each size.
    sets : (n_max + 1, m) Filled with these sets.
    """
    m, n_max = len(original) - 1, len(cost) - 1
    a, inside, tried = np.empty((m + 1, m + 1)), np.empty(m, np.bool_), np.empty(m, np.bool_)
    copy_mask(locked, inside)
    sweep_from(a, original, inside)
    keep_best(a, inside, size_of(inside), rss, sets)
    resize(a, inside, locked, usable, True, swap, rss, sets)
    if swap:
        for _ in range(MAX_PASSES):
            sweep_from(a, original, inside)
            better = resize(a, inside, locked, usable, False, swap, rss, sets)
            sweep_from(a, original, inside)
            better = resize(a, inside, locked, usable, True, swap, rss, sets) or better
            if not better:
                break
    if restart:
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
            sweep_from(a, original, inside)
            if a[first, first] > DEPENDENCE_TOLERANCE and size_of(inside) < n_max:
                inside[first] = True
                sweep(a, first)
                resize(a, inside, locked, usable, True, swap, rss, sets)


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
    """Search for the best sets of every size for many outputs.

    Parameters
    ----------
    grams : (n_grams, m, m) Φ'Φ
    cross : (m, n) Φ'Y
    power, own, count : (n,) Y'Y, index of the Gram matrix, and number of rows of each output
    locked, usable : (m,) terms that are always kept, and terms that may be used
    cost : (n, n_max + 1) penalty of each size

    Returns
    -------
    Unexplained share of the best set of each size (n, n_max + 1), and these sets (n, n_max + 1, m)
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
