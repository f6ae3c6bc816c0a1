"""What a model leaves has a memory: a wall that is mapped 2 cm off stays so, and neighbours that look at it err together.

The chances of a single reading stay those of the model; only their dependence is described here, as a function of the
place that a ray is predicted to end at: squares of several sizes keep, for several lifetimes, what is drawn for them.
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


@dataclass(frozen=True, kw_only=True)
class MemorySettings:
    """What is taken for memory."""

    sizes: tuple[float, ...] = (0.0125, 0.025, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
    """[m] sides of the squares, from the noise of a range to a piece of furniture; each twice the one before."""
    lifetimes: tuple[float, ...] = (1.0, 10.0, 100.0, 1000.0)
    """[s] that a square keeps what it has, one a decade; one more keeps it for ever."""
    gaps: tuple[float, ...] = (0.01, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
    """[s] borders of the classes in which pairs of readings are counted; below the first they are of one scan. Sizes are
    the borders of distance."""
    scan_lags: tuple[int, ...] = (1, 2, 3, 5, 8, 13, 21, 34, 55, 89)
    """Scans between the two readings of one ray that make a pair ..."""
    ray_lags: tuple[int, ...] = (1, 2)
    """... or rays between two of one scan."""
    strides: tuple[int, ...] = (21, 55, 144, 377, 987, 2584)
    """Readings of the same largest square, in order of time, between the two of a pair when a place is seen again ..."""
    again: float = 30.0
    """[s] ... after this long."""
    max_pairs: int = 200_000
    """Of each kind."""
    min_pairs: float = 1000.0
    """Without correlation, which each share must outvote: what few pairs tell is chance."""
    min_readings: int = 2000
    """That a memory is told from."""
    max_readings: int = 2_000_000
    """That are looked at: the first ones."""
    max_scans: int = 10_000
    """Alike."""
    largest: float = 0.98
    """Share of a reading that is kept in all."""
    least: float = 1e-3
    """[m, s] side or lifetime that a file may hold."""


MEMORY = MemorySettings()


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualMemory:
    """How the residuals of rays that end near each other depend on each other, in one scan and later."""

    sizes: Floats
    """(n_sizes,) [m] sides of the squares, each twice the one before."""
    lifetimes: Floats
    """(n_lifetimes,) [s]; one more, the last, is for ever."""
    events: Floats
    """(n_sizes, n_lifetimes + 1) chance that a reading takes what stops it, or does not, from such a square."""
    noise: Floats
    """(n_sizes, n_lifetimes + 1) share of the variance of a return that is such a square's."""

    @classmethod
    def fit(cls, *, residual: Floats, chance: Floats, event: Floats, places: Floats, stamps: Floats) -> Self:
        """Identify the memory.

        Parameters
        ----------
        residual : (n, n_rays) [m] measured - predicted of returns on the predicted surface; nan elsewhere
        chance : (n, n_rays) said chance of an event
        event : (n, n_rays) 1 where it came, 0 where not, nan where not known
        places : (n, n_rays, 3) [m, m, rad] where each ray was predicted to end, and its direction (`places_of`)
        stamps : (n,) [s]
        """
        known = np.isfinite(residual)
        n_known = np.maximum(known.sum(axis=0), 1)
        z = residual - np.where(known, residual, 0.0).sum(axis=0) / n_known
        z = z / np.maximum(np.sqrt((np.where(known, z, 0.0) ** 2).sum(axis=0) / n_known), 1e-9)
        sizes, lifetimes = np.array(MEMORY.sizes), np.array(MEMORY.lifetimes)
        pairs = _Pairs.of(places, stamps, sizes, np.isfinite(event))
        p, e, z = (values.ravel() for values in (chance, event, z))

        def of_events(a: Ints, b: Ints) -> tuple[Floats, Floats]:
            """Where both take the same number, both events come with the smaller chance: min(p, q) - p q."""
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
        """Return numbers with a memory from fresh ones of one scan, all (n_rays,).

        Parameters
        ----------
        seed : of the world; what places keep belongs to it, whoever drives
        time : [s]
        places : (n_rays, 3) as `fit` takes them
        """
        table = self.sizes, self.lifetimes, self.events, self.noise
        return numbers_at(seed, time, places, (uniform, normal), table)

    def summary(self) -> str:
        """Say it in one line."""
        return f"{_in_words('events', self)}; {_in_words('noise', self)}"

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays of a file."""
        return {f"memory.{f.name}": getattr(self, f.name) for f in fields(self)}

    @classmethod
    def restore(cls, arrays: Mapping[str, NDArray[Any]]) -> Self | None:
        """Return what `arrays` gave; None where there is none.

        Raises
        ------
        ValueError : an array has a wrong shape, or shares are no shares
        """
        if "memory.events" not in arrays:
            return None
        found = {f.name: arrays[f"memory.{f.name}"] for f in fields(cls)}
        shape = (found["sizes"].size, found["lifetimes"].size + 1)
        for name in ("sizes", "lifetimes"):
            check_shape(f"memory.{name}", found[name], (found[name].size,), "f")
            check_range(f"memory.{name}", found[name], MEMORY.least)
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


def _in_words(name: str, memory: ResidualMemory) -> str:
    """Say how much of events or noise places keep, how long and how far."""
    shares: Floats = getattr(memory, name)
    total = float(shares.sum())
    longer = float(shares[:, memory.lifetimes.searchsorted(10.0) :].sum())
    wider = float(shares[memory.sizes.searchsorted(0.4) :].sum())
    return (
        f"{total:.0%} of {name} belong to places: {longer:.0%} for 10 s or more, {wider:.0%} to 0.4 m or more"
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pairs:
    """Pairs of readings, by their flat indices, that end near each other and look the same way."""

    a: Ints
    b: Ints
    gap: Floats
    """(n,) [s]"""
    distance: Floats
    """(n,) [m]"""

    @classmethod
    def of(cls, places: Floats, stamps: Floats, sizes: Floats, known: Bools) -> Self:
        """Pair known readings (n_scans, n_rays): near in scan and ray, and of a place that is seen again."""
        where = places.reshape(-1, 3)
        key = _numbered(squares(where, sizes[-1]))
        time, good = np.repeat(stamps, known.shape[1]), known.ravel()
        sector = squares(where, 1.0)[:, 2]
        flat = np.arange(known.size).reshape(known.shape)
        found = [(flat[:-k].ravel(), flat[k:].ravel(), False) for k in MEMORY.scan_lags if k < len(flat)]
        found += [
            (flat[:, :-j].ravel(), flat[:, j:].ravel(), False) for j in MEMORY.ray_lags if j < known.shape[1]
        ]
        order = np.flatnonzero(good)
        order = order[np.lexsort((time[order], key[order]))]
        found += [(order[:-stride], order[stride:], True) for stride in MEMORY.strides if stride < len(order)]
        parts = []
        for a, b, is_again in found:
            use = good[a] & good[b] & (sector[a] == sector[b])
            if is_again:
                use &= (key[a] == key[b]) & (time[b] - time[a] > MEMORY.again)
            some = np.flatnonzero(use)
            some = some[:: len(some) // MEMORY.max_pairs + 1]
            parts.append((a[some], b[some]))
        a, b = (np.concatenate(side) for side in zip(*parts, strict=True))
        apart = np.hypot(*(where[a, :2] - where[b, :2]).T)
        near = apart < sizes[-1]
        return cls(a=a[near], b=b[near], gap=(time[b] - time[a])[near], distance=apart[near])

    def shares(
        self, product: Callable[[Ints, Ints], tuple[Floats, Floats]], sizes: Floats, lifetimes: Floats
    ) -> Floats:
        """Return which shares (n_sizes, n_lifetimes + 1), none below 0, explain products by places that keep numbers.

        `product` gives the product of each pair, and what it would be if both took the same number. Two points lie in the
        same square of side s with chance 1 - (4 - d/s) d/s / pi, d apart in any direction, for the same lifetime T with
        1 - gap / T.
        """
        found, full = product(self.a, self.b)
        known = np.isfinite(found)
        found, full, gap, apart = found[known], full[known], self.gap[known], self.distance[known]
        n_gaps = len(MEMORY.gaps) + 1
        of = np.searchsorted(sizes, apart, side="right") * n_gaps
        of += np.searchsorted(MEMORY.gaps, gap, side="right")

        def summed(values: Floats) -> Floats:
            return np.asarray(np.bincount(of, values, minlength=len(sizes) * n_gaps), dtype=np.float64)

        weight = 1.0 / np.sqrt(np.maximum(summed(full), 1.0))
        columns = []
        for size in sizes.tolist():
            ratio = np.minimum(apart / size, 1.0)
            together = np.where(ratio < 1.0, full * (1.0 - (4.0 - ratio) * ratio / np.pi), 0.0)
            for lifetime in [*lifetimes.tolist(), np.inf]:
                columns.append(summed(together * np.maximum(1.0 - gap / lifetime, 0.0)) * weight)
        from scipy.optimize import nnls  # 0.2 s to import, for graphs with memory only

        doubt = np.sqrt(MEMORY.min_pairs * float(full.mean() if len(full) else 1.0)) * np.eye(len(columns))
        rows = np.vstack([np.column_stack(columns), doubt])
        target = np.r_[summed(found) * weight, np.zeros(len(columns))]
        shares = np.asarray(nnls(rows, target)[0])
        if shares.sum() > MEMORY.largest:  # found again, with a sum that is no more
            heavy = 1e3 * float(np.linalg.norm(rows))
            rows = np.vstack([rows, np.full(len(columns), heavy)])
            shares = np.asarray(nnls(rows, np.r_[target, heavy * MEMORY.largest])[0])
            shares *= min(1.0, MEMORY.largest / float(shares.sum()))
        return shares.reshape(len(sizes), -1)


def _numbered(keys: Ints) -> Ints:
    """Return numbers (n,) that are equal where the rows of keys (n, 3) are."""
    low = keys.min(axis=0, initial=0)
    spans = keys.max(axis=0, initial=0) - low + 1
    return np.asarray(
        ((keys[:, 0] - low[0]) * spans[1] + keys[:, 1] - low[1]) * spans[2] + keys[:, 2] - low[2]
    )
