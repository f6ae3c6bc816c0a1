"""Correlation of a model's residuals between places and times.

A wall mapped 2 cm off stays off, and rays that end near each other err together. The marginal distribution of a
reading remains that of the model. This module adds the dependence between readings: squares of several sizes around
the predicted end points keep their random numbers for several lifetimes (`place_noise`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from sensorgraph.models.base import OFF_DISTANCE
from sensorgraph.models.place_noise import numbers_at, squares
from sensorgraph.models.stored_numbers import check_range, check_shape
from sensorgraph.types import Bools, Floats, Ints

SIZES = (0.0125, 0.025, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
"""[m] Sides of the squares, from range noise to a piece of furniture; each twice the one before."""
LIFETIMES = (1.0, 10.0, 100.0, 1000.0)
"""[s] Lifetimes of the squares' numbers, one per decade; an unlimited lifetime is added."""
REVISIT_TIME = 30.0
"""[s] Minimum time between two readings of a place for the second to count as a second look at it."""
MIN_PAIRS = 1000.0
"""Number of uncorrelated pairs added as a prior on each share; it suppresses chance correlations of few pairs."""
GAPS = (0.01, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
"""[s] Class limits of the time between the readings of a pair; the first class holds pairs of one scan.

The sizes of the squares are the class limits of distance."""
SCAN_LAGS, RAY_LAGS = (1, 2, 3, 5, 8, 13, 21, 34, 55, 89), (1, 2)
"""Numbers of scans between two readings of one ray that form a pair, and of rays between two of one scan."""
STRIDES = (21, 55, 144, 377, 987, 2584)
"""Numbers of readings between the two of a pair, among the readings of one largest square in order of time."""
MAX_PAIRS = 200_000
"""Maximum number of pairs of each kind."""
MAX_MEMORY = 0.98
"""Upper limit of what residuals keep of the ones before: the sum of all shares here, of a root or of a probability in narmax."""
MIN_STORED = 1e-3
"""[m, s] Smallest size or lifetime accepted from a file."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualMemory:
    """Dependence between the residuals of rays that end near each other, within a scan and over time."""

    sizes: Floats
    """(n_sizes,) [m] sides of the squares, each twice the one before."""
    lifetimes: Floats
    """(n_lifetimes,) [s] finite lifetimes; an unlimited one follows."""
    events: Floats
    """(n_sizes, n_lifetimes + 1) probability that such a square decides whether an event occurs."""
    noise: Floats
    """(n_sizes, n_lifetimes + 1) share of the variance of a return that such a square contributes."""

    @classmethod
    def fit(cls, *, residual: Floats, chance: Floats, event: Floats, places: Floats, stamps: Floats) -> Self:
        """Identify the memory.

        Parameters
        ----------
        residual : (n, n_rays) [m] measured - predicted of returns on the predicted surface; nan elsewhere.
        chance : (n, n_rays) Predicted probability of an event: a reading that is not on the predicted surface.
        event : (n, n_rays) 1 where an event occurred, 0 where not, nan where unknown.
        places : (n, n_rays, 3) [m, m, rad] Predicted end points and directions of the rays (`places_of`).
        stamps : (n,) [s]
        """
        known = np.isfinite(residual)
        n_known = np.maximum(known.sum(axis=0), 1)
        z = residual - np.where(known, residual, 0.0).sum(axis=0) / n_known
        z = z / np.maximum(np.sqrt((np.where(known, z, 0.0) ** 2).sum(axis=0) / n_known), 1e-9)
        sizes, lifetimes = np.array(SIZES), np.array(LIFETIMES)
        pairs = _Pairs.of(places, stamps, sizes, np.isfinite(event))
        p, e, z = (values.ravel() for values in (chance, event, z))

        def of_events(a: Ints, b: Ints) -> tuple[Floats, Floats]:
            """Return the products, and min(p, q) - p q: their expectation if both readings share a number."""
            return (e[a] - p[a]) * (e[b] - p[b]), np.minimum(p[a], p[b]) - p[a] * p[b]

        def of_noise(a: Ints, b: Ints) -> tuple[Floats, Floats]:
            return z[a] * z[b], 0.5 * (z[a] ** 2 + z[b] ** 2)

        return cls(
            sizes=sizes, lifetimes=lifetimes,
            events=pairs.shares(of_events, sizes, lifetimes), noise=pairs.shares(of_noise, sizes, lifetimes),
        )  # fmt: skip

    def numbers(
        self, seed: int, time: float, places: Floats, uniform: Floats, normal: Floats
    ) -> tuple[Floats, Floats]:
        """Return correlated numbers of one scan, computed from independent ones, all (n_rays,).

        Parameters
        ----------
        seed : Seed of the simulated world; the numbers of its places depend on nothing else.
        time : [s] Time of the scan.
        places : (n_rays, 3) Places as `fit` takes them.
        """
        table = self.sizes, self.lifetimes, self.events, self.noise
        return numbers_at(seed, time, places, (uniform, normal), table)

    def summary(self) -> str:
        """Return a one-line summary."""
        return f"{_summary_of('events', self)}; {_summary_of('noise', self)}"

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that a file stores."""
        return {f"memory.{f.name}": getattr(self, f.name) for f in fields(self)}

    @classmethod
    def restore(cls, arrays: Mapping[str, NDArray[Any]]) -> Self | None:
        """Recreate the memory from the output of `arrays`; None if there is no memory.

        Raises
        ------
        ValueError : An array has a wrong shape, or a share is outside 0 to 1.
        """
        if "memory.events" not in arrays:
            return None
        found = {f.name: arrays[f"memory.{f.name}"] for f in fields(cls)}
        shape = (found["sizes"].size, found["lifetimes"].size + 1)
        for name in ("sizes", "lifetimes"):
            check_shape(f"memory.{name}", found[name], (found[name].size,), "f")
            check_range(f"memory.{name}", found[name], MIN_STORED)
        for name in ("events", "noise"):
            check_shape(f"memory.{name}", found[name], shape, "f")
            check_range(f"memory.{name}", found[name], 0, 1)
            check_range(f"the sum of memory.{name}", found[name].sum(), 0, 1)
        return cls(**found)


def events_of(measured: Floats, mode: Floats, p_no_return: Floats, p_off: Floats) -> dict[str, Floats]:
    """Return `residual`, `chance` and `event` as `ResidualMemory.fit` takes them, all (n, n_rays)."""
    off = measured - mode
    near = np.isfinite(measured) & (np.abs(off) <= OFF_DISTANCE)
    return {
        "residual": np.where(near, off, np.nan),
        "chance": 1.0 - (1.0 - p_no_return) * (1.0 - p_off),
        "event": np.where(np.isnan(measured), np.nan, ~near),
    }


def _summary_of(name: str, memory: ResidualMemory) -> str:
    """Return the share of events or noise that belongs to places, in all, long-lasting and wide."""
    shares: Floats = getattr(memory, name)
    total = float(shares.sum())
    longer = float(shares[:, memory.lifetimes.searchsorted(10.0) :].sum())
    wider = float(shares[memory.sizes.searchsorted(0.4) :].sum())
    return f"places keep {100 * total:.0f} % of {name}: {100 * longer:.0f} % for 10 s or more, {100 * wider:.0f} % over 0.4 m or more"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pairs:
    """Pairs of readings, by flat index, that end near each other and look in the same direction."""

    a: Ints
    b: Ints
    gap: Floats
    """(n,) [s] time between the readings."""
    distance: Floats
    """(n,) [m] distance between the end points."""

    @classmethod
    def of(cls, places: Floats, stamps: Floats, sizes: Floats, known: Bools) -> Self:
        """Pair known readings (n_scans, n_rays): neighbours in scan or ray, and readings of places seen again."""
        where = places.reshape(-1, 3)
        key = squares(where, sizes[-1])
        time, good = np.repeat(stamps, known.shape[1]), known.ravel()
        flat = np.arange(known.size).reshape(known.shape)
        found = [(flat[:-k].ravel(), flat[k:].ravel(), False) for k in SCAN_LAGS if k < len(flat)]
        found += [(flat[:, :-j].ravel(), flat[:, j:].ravel(), False) for j in RAY_LAGS if j < known.shape[1]]
        order = np.flatnonzero(good)
        order = order[np.lexsort((time[order], *key[order].T))]
        found += [(order[:-stride], order[stride:], True) for stride in STRIDES if stride < len(order)]
        parts = []
        for a, b, is_again in found:
            use = good[a] & good[b] & (key[a, 2] == key[b, 2])
            if is_again:
                use &= (key[a] == key[b]).all(axis=1) & (time[b] - time[a] > REVISIT_TIME)
            some = np.flatnonzero(use)
            some = some[:: len(some) // MAX_PAIRS + 1]
            parts.append((a[some], b[some]))
        a, b = (np.concatenate(side) for side in zip(*parts, strict=True))
        apart = np.hypot(*(where[a, :2] - where[b, :2]).T)
        near = apart < sizes[-1]
        return cls(a=a[near], b=b[near], gap=(time[b] - time[a])[near], distance=apart[near])

    def shares(
        self, product: Callable[[Ints, Ints], tuple[Floats, Floats]], sizes: Floats, lifetimes: Floats
    ) -> Floats:
        """Fit the shares c_sm >= 0 (n_sizes, n_lifetimes + 1) of squares to the products of pairs by least squares.

        E[product] = full sum_sm c_sm P_s(d) max(1 - gap / T_m, 0), with P_s(d) = 1 - (4 - d/s) d / (pi s) for d < s.
        P_s(d) is the probability that two points at a distance d in a random direction lie in the same square of side s.
        `product` returns the product of each pair, and `full`: its expectation if both readings share a number.
        """
        found, full = product(self.a, self.b)
        known = np.isfinite(found)
        found, full, gap, apart = found[known], full[known], self.gap[known], self.distance[known]
        n_gaps = len(GAPS) + 1
        of = np.searchsorted(sizes, apart, side="right") * n_gaps
        of += np.searchsorted(GAPS, gap, side="right")

        def summed(values: Floats) -> Floats:
            return np.asarray(np.bincount(of, values, minlength=len(sizes) * n_gaps), dtype=np.float64)

        weight = 1.0 / np.sqrt(np.maximum(summed(full), 1.0))
        columns = []
        for size in sizes.tolist():
            ratio = np.minimum(apart / size, 1.0)
            together = np.where(ratio < 1.0, full * (1.0 - (4.0 - ratio) * ratio / np.pi), 0.0)
            for lifetime in [*lifetimes.tolist(), np.inf]:
                columns.append(summed(together * np.maximum(1.0 - gap / lifetime, 0.0)) * weight)
        from scipy.optimize import nnls  # imported here, since it takes 0.2 s

        ridge = np.sqrt(MIN_PAIRS * float(full.mean() if len(full) else 1.0)) * np.eye(len(columns))
        rows = np.vstack([np.column_stack(columns), ridge])
        target = np.r_[summed(found) * weight, np.zeros(len(columns))]
        shares = np.asarray(nnls(rows, target)[0])
        if shares.sum() > MAX_MEMORY:  # solve again with the sum constrained
            heavy = 1e3 * float(np.linalg.norm(rows))
            rows = np.vstack([rows, np.full(len(columns), heavy)])
            shares = np.asarray(nnls(rows, np.r_[target, heavy * MAX_MEMORY])[0])
            shares *= min(1.0, MAX_MEMORY / float(shares.sum()))
        return shares.reshape(len(sizes), -1)
