"""What a model leaves has a memory: residuals that stay from scan to scan, dropouts that come in bursts, and neighbours
that share both. The chances of a single reading stay those of the model; only their dependence is described here.

Events (no return, or another surface) follow a two-state Markov chain for each ray (Gilbert 1960, Elliott 1963); the
noise of a return is an autoregressive moving average where tests ask for one (`models.narmax.noise`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from sensorgraph.models.base import OFF_DISTANCE
from sensorgraph.models.narmax.noise import estimate
from sensorgraph.models.stored_numbers import check_range, check_shape
from sensorgraph.types import Floats, Ints


@dataclass(frozen=True, kw_only=True)
class MemorySettings:
    """What is taken for memory."""

    ar_lags: int = 2
    """[scans] of the noise of a return."""
    noise_lags: int = 1
    """[scans] of its moving average."""
    min_rows: int = 200
    """Scans that a ray needs for lags of its own."""
    min_events: float = 30.0
    """Expected shared events as many as which the chain of all rays counts beside a ray's own."""
    significance: float = 3.0
    """Standard errors that a correlation must differ from 0 by."""
    largest: float = 0.98
    """Root of the noise, or share of an event that lasts."""
    max_scans: int = 10_000
    """Training scans that are looked at."""
    rounds: int = 20
    """In which chains along time and rays are told apart."""


MEMORY = MemorySettings()


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualMemory:
    """How the residuals of rays depend on those of the scan before, and on their neighbours'."""

    lasting: Floats
    """(n_rays,) chance that what stopped a ray, or did not, lasts into the next scan beyond what the model says."""
    shared: Floats
    """(1,) chance that a ray shares this with its neighbour."""
    ar: Floats
    """(n_rays, ar_lags) of the noise of a return over its standard deviation."""
    ma: Floats
    """(n_rays, noise_lags)"""
    gain: Floats
    """(n_rays,) of the innovations, so that the noise keeps its variance."""
    across: Floats
    """(1,) correlation of the innovations of neighbours."""

    @classmethod
    def fit(cls, *, residual: Floats, chance: Floats, event: Floats, index: Ints) -> Self:
        """Identify the memory from scans in a row.

        Parameters
        ----------
        residual : (n, n_rays) [m] measured - predicted of returns on the predicted surface; nan elsewhere
        chance : (n, n_rays) said chance of an event
        event : (n, n_rays) 1 where it came, 0 where not, nan where not known
        index : (n,) number of each scan; a gap leaves a number out
        """
        n_rays = residual.shape[1]
        follows = np.r_[False, np.diff(index) == 1]
        now, before = np.flatnonzero(follows), np.flatnonzero(follows) - 1
        in_time = [_shared_state(event[:, ray], chance[:, ray], now, before) for ray in range(n_rays)]
        along_time = _drawn_together(np.array(in_time))
        beside = _shared_state(event.T, chance.T, np.arange(1, n_rays), np.arange(n_rays - 1))
        lasting, shared = _told_apart(along_time, float(np.clip(beside[0] / max(beside[1], 1e-9), 0.0, 1.0)))
        spread = np.sqrt(np.nanmean(np.where(np.isfinite(residual), residual, 0.0) ** 2, axis=0))
        z = residual - np.where(np.isfinite(residual).any(axis=0), _mean(residual), 0.0)
        z = z / np.maximum(spread, 1e-9)
        ar, ma = np.zeros((n_rays, MEMORY.ar_lags)), np.zeros((n_rays, MEMORY.noise_lags))
        for ray in range(n_rays):
            ar[ray], ma[ray] = _noise_of(z[:, ray], index)
        gain = np.array([1.0 / np.sqrt(_variance(a, c)) for a, c in zip(ar, ma, strict=True)])
        return cls(
            lasting=lasting, shared=np.array([shared]), ar=ar, ma=ma, gain=gain,
            across=np.clip([_pooled(z[:, 1:], z[:, :-1])], 0.0, MEMORY.largest),
        )  # fmt: skip

    def summary(self) -> str:
        """Say it in one line."""
        coloured = int((self.ar.any(axis=1) | self.ma.any(axis=1)).sum())
        return (
            f"events last with chance {np.median(self.lasting):.2f} (median ray) and are shared by neighbours with "
            f"{self.shared[0]:.2f}; noise correlated in time on {coloured} of {len(self.lasting)} rays, between "
            f"neighbours {self.across[0]:.2f}"
        )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays of a file."""
        return {f"memory.{f.name}": getattr(self, f.name) for f in fields(self)}

    @classmethod
    def restore(cls, arrays: Mapping[str, NDArray[Any]], n_rays: int) -> Self | None:
        """Return what `arrays` gave; None where there is none.

        Raises
        ------
        ValueError : an array has a wrong shape, or a process would grow
        """
        if "memory.lasting" not in arrays:
            return None
        found = {f.name: arrays[f"memory.{f.name}"] for f in fields(cls)}
        shapes = {
            "lasting": (n_rays,), "shared": (1,), "ar": (n_rays, MEMORY.ar_lags), "ma": (n_rays, MEMORY.noise_lags),
            "gain": (n_rays,), "across": (1,),
        }  # fmt: skip
        for name, shape in shapes.items():
            check_shape(f"memory.{name}", found[name], shape, "f")
        for name in ("lasting", "shared", "across", "gain"):
            check_range(f"memory.{name}", found[name], 0, 1)
        for row in found["ar"]:
            check_range(
                "memory.ar's largest root", float(np.abs(np.roots(np.r_[1.0, -row])).max(initial=0)), 0, 1
            )
        return cls(**found)


class MemoryState:
    """The memory at one scan; the next is drawn from fresh numbers."""

    def __init__(self, memory: ResidualMemory) -> None:
        n_rays = len(memory.lasting)
        self.memory = memory
        self.uniform: Floats | None = None
        self.noise = np.zeros((max(MEMORY.ar_lags, 1), n_rays))
        self.innovations = np.zeros((max(MEMORY.noise_lags, 1), n_rays))

    def step(self, uniform: Floats, normal: Floats, decisions: Floats) -> tuple[Floats, Floats]:
        """Return numbers with a memory from fresh ones.

        Parameters
        ----------
        uniform, normal : (n_rays,) fresh numbers
        decisions : (2, n_rays) uniform numbers: whether a ray shares with its neighbour, and whether the last one lasts
        """
        memory = self.memory
        if self.uniform is not None:
            uniform = np.where(decisions[1] < memory.lasting, self.uniform, uniform)
        shares = decisions[0] < memory.shared
        shares[0] = False
        source = np.maximum.accumulate(np.where(shares, 0, np.arange(len(uniform))))
        self.uniform = uniform[source]
        from scipy.signal import lfilter  # 0.3 s to import, for graphs with memory only

        rho = float(memory.across[0])
        fresh = normal * np.sqrt(1.0 - rho**2)
        fresh[0] = normal[0]
        e = memory.gain * lfilter([1.0], [1.0, -rho], fresh)
        z = e + np.einsum("rl,lr->r", memory.ar, self.noise[: memory.ar.shape[1]])
        z += np.einsum("rl,lr->r", memory.ma, self.innovations[: memory.ma.shape[1]])
        self.noise = np.vstack([z, self.noise[:-1]])
        self.innovations = np.vstack([e, self.innovations[:-1]])
        return self.uniform, z


def events_of(measured: Floats, mode: Floats, p_no_return: Floats, p_off: Floats) -> dict[str, Floats]:
    """Return `residual`, `chance` and `event` as `ResidualMemory.fit` takes them, all (n, n_rays)."""
    off = measured - mode
    near = np.isfinite(measured) & (np.abs(off) <= OFF_DISTANCE)
    return {
        "residual": np.where(near, off, np.nan),
        "chance": 1.0 - (1.0 - p_no_return) * (1.0 - p_off),
        "event": np.where(np.isnan(measured), np.nan, ~near),
    }


def _mean(values: Floats) -> Floats:
    known = np.isfinite(values)
    total = np.where(known, values, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return np.asarray(total, dtype=np.float64)


def _pooled(a: Floats, b: Floats) -> float:
    """Return the correlation of two tables about 0; 0 where it is not significant."""
    known = np.isfinite(a) & np.isfinite(b)
    x, y = a[known], b[known]
    size = np.sqrt(float(x @ x) * float(y @ y))
    if not size > 0:
        return 0.0
    r = float(x @ y) / size
    return r if abs(r) > MEMORY.significance / np.sqrt(len(x)) else 0.0


def _shared_state(event: Floats, chance: Floats, now: Ints, before: Ints) -> tuple[float, float]:
    """Return the sum of products of surprises, and what it would be if the state were always shared.

    Where the state, a uniform number, is the same, both events come with the smaller of their chances:
    E (d1 - p1)(d2 - p2) = min(p1, p2) - p1 p2.
    """
    p, q = chance[now], chance[before]
    product = (event[now] - p) * (event[before] - q)
    known = np.isfinite(product)
    return float(product[known].sum()), float((np.minimum(p, q) - p * q)[known].sum())


def _drawn_together(sums: Floats) -> Floats:
    """Return the chance that each ray keeps its state, from sums (n_rays, 2), drawn to all rays' where events are few."""
    every = sums[:, 0].sum() / max(sums[:, 1].sum(), 1e-9)
    own = (sums[:, 0] + MEMORY.min_events * every) / (sums[:, 1] + MEMORY.min_events)
    return np.asarray(np.clip(own, 0.0, MEMORY.largest), dtype=np.float64)


def _told_apart(along_time: Floats, beside: float) -> tuple[Floats, float]:
    """Return the chances of lasting and of sharing that make these correlations together.

    With chance b a ray takes its neighbour's state, else its own last one with chance a, else a fresh one. Then time gives
    T = b T S + (1 - b) a and neighbours S = b + (1 - b) a T S, if both act on their own.
    """
    S = float(np.clip(beside, 0.0, MEMORY.largest))
    T = float(np.median(along_time))
    b = S
    for _ in range(MEMORY.rounds):
        a = (T - b * T * S) / max(1.0 - b, 1e-9)
        b = float(np.clip(S - (1.0 - b) * a * T * S, 0.0, S))
    lasting = along_time * (1.0 - b * S) / max(1.0 - b, 1e-9)
    return np.clip(lasting, 0.0, MEMORY.largest), b


def _noise_of(z: Floats, index: Ints) -> tuple[Floats, Floats]:
    """Return autoregressive and moving-average coefficients of one ray's noise (n,); 0 where it is white."""
    p, q = MEMORY.ar_lags, MEMORY.noise_lags
    white = np.zeros(p), np.zeros(q)
    known = np.isfinite(z)
    rows = [k for k in range(p, len(z)) if known[k - p : k + 1].all() and index[k] - index[k - p] == p]
    if len(rows) < MEMORY.min_rows:
        return white
    k = np.array(rows)
    phi = np.column_stack([z[k - lag] for lag in range(1, p + 1)])
    plain = estimate(np.ones((len(k), 1)), z[k], np.zeros((len(k), 2)), index[k], 0)
    if not plain.tests[0] < 0.05:
        return white
    found = estimate(np.column_stack([np.ones(len(k)), phi]), z[k], np.zeros((len(k), 2)), index[k], q)
    theta = np.zeros(p + 1)
    theta[found.kept] = found.theta
    ar = theta[1:]
    root = float(np.abs(np.roots(np.r_[1.0, -ar])).max(initial=0.0))
    return ar * min(1.0, MEMORY.largest / max(root, 1e-9)) ** np.arange(1, p + 1), found.noise


def _variance(ar: Floats, ma: Floats) -> float:
    """Return the variance of a process with unit innovations, by its impulse response."""
    from scipy.signal import lfilter  # as above

    impulse = np.zeros(2000)
    impulse[0] = 1.0
    return float((lfilter(np.r_[1.0, ma], np.r_[1.0, -ar], impulse) ** 2).sum())
