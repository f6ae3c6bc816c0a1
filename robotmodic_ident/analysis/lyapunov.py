"""Lyapunov exponents of a model, from its tangent map, and of a series, from the divergence of neighbours.

* From a model: `tangent(k) frame(k-1) = frame(k) upper(k)` by QR, and exponent i is the mean of `log |upper_ii(k)|` per
  second (Benettin et al., Meccanica 15, 1980; Eckmann and Ruelle, Rev. Mod. Phys. 57, 1985).
* From a series: The slope of the mean log distance of neighbours over time (Rosenstein, Collins and De Luca, Physica D
  65, 1993).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from robotmodic_ident.analysis.algebra import Sum, evaluate, partial, sum_of
from robotmodic_ident.analysis.embedding import embed, neighbours
from robotmodic_ident.errors import IdentError
from robotmodic_ident.model import Narmax
from robotmodic_ident.records import Record, lagged
from robotmodic_ident.types import Floats

N_ORBIT_PARTS = 10
"""Number of parts of an orbit for the standard error of an exponent."""
LOST_SIZE = 1e6
"""Ratio to the magnitude of the start above which a trajectory counts as divergent."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LyapunovExponents:
    """The spectrum of exponents, largest first."""

    values: Floats
    """(n,) [1/s] exponents."""
    stderr: Floats
    """(n,) [1/s] standard error of the mean over trajectories."""
    lost: float
    """Share of divergent trajectories, which are ignored."""

    @property
    def dimension(self) -> float:
        """Kaplan-Yorke dimension j + Σ_{i<=j} values_i / |values_j+1| of the attractor."""
        sums = np.cumsum(self.values)
        if sums[0] < 0:
            return 0.0
        j = int(np.flatnonzero(sums >= 0)[-1])
        if j + 1 == len(sums):
            return float(len(sums))
        return j + 1 + float(sums[j] / abs(self.values[j + 1]))


def lyapunov(
    models: Narmax | Sequence[Narmax],
    starts: ArrayLike,
    *,
    n_steps: int = 2000,
    transient: int = 500,
    period: float = 1.0,
) -> LyapunovExponents:
    """Return the Lyapunov exponents of autonomous models, by QR of the tangent map along free runs.

    Parameters
    ----------
    models : One per variable; their only signals are past outputs of these models.
    starts : (n_trajectories, n_models * look_back) Initial states: y(k-1), y(k-2), ... of the first output, then
        those of the next. `states_of` draws them from a series.
    n_steps, transient : [samples] Number of evaluated steps, and number of steps before these.
    period : [s] Sampling period.
    """
    models = [models] if isinstance(models, Narmax) else list(models)
    step = TangentMap(models)
    state = np.array(starts, dtype=np.float64, ndmin=2)
    if state.shape[1] != step.n_states:
        raise ValueError(f"starts has shape {state.shape}, expected (n_trajectories, {step.n_states})")
    size = LOST_SIZE * max(float(np.abs(state).max()), 1.0)
    n, d = state.shape
    alive = np.ones(n, dtype=np.bool_)
    frame = np.broadcast_to(np.eye(d), (n, d, d)).copy()
    growth = np.zeros((n, d))
    for k in range(transient + n_steps):
        state, tangent = step(state)
        alive &= np.isfinite(state).all(axis=1) & (np.abs(state) < size).all(axis=1)
        if not alive.any():
            raise IdentError(
                f"every free run of the model diverges to infinity within {k + 1} steps; the model has no attractor"
            )
        state[~alive], tangent[~alive] = 0.0, np.eye(d)
        frame, upper = np.linalg.qr(tangent @ frame)
        if k >= transient:
            stretching = np.abs(np.diagonal(upper, axis1=1, axis2=2))
            growth += np.log(np.maximum(stretching, 1e-300))
    rates = np.sort(growth[alive] / (n_steps * period), axis=1)[:, ::-1]
    spread = rates.std(axis=0, ddof=1) if len(rates) > 1 else np.full(d, np.nan)
    return LyapunovExponents(
        values=rates.mean(axis=0), stderr=spread / np.sqrt(len(rates)), lost=float(1.0 - alive.mean())
    )


class TangentMap:
    """One step of a free run and its Jacobian, for many states at once."""

    def __init__(self, models: Sequence[Narmax]) -> None:
        self.outputs = [model.output for model in models]
        self.sums = [sum_of(model) for model in models]
        read = {f for total in self.sums for term in total for f in term}
        if strange := sorted({f.signal for f in read if f.variable not in self.outputs or not f.lag}):
            raise IdentError(
                f"the model uses {', '.join(strange)}; Lyapunov exponents require models of past outputs only"
            )
        self.look_back = max((f.lag or 1 for f in read), default=1)
        self.signals = [
            f"{output}(k-{lag})" for output in self.outputs for lag in range(1, self.look_back + 1)
        ]
        self.slopes: list[list[Sum]] = [
            [_slope(total, signal) for signal in self.signals] for total in self.sums
        ]

    @property
    def n_states(self) -> int:
        """Number of past outputs in a state."""
        return len(self.signals)

    def __call__(self, state: Floats) -> tuple[Floats, Floats]:
        """Return the next states (n, n_states) and the tangent maps (n, n_states, n_states)."""
        columns = {signal: state[:, i] for i, signal in enumerate(self.signals)}
        n, d = state.shape
        after, tangent = np.empty((n, d)), np.zeros((n, d, d))
        with np.errstate(over="ignore", invalid="ignore"):
            for m, total in enumerate(self.sums):
                first = m * self.look_back
                after[:, first] = evaluate(total, columns)
                after[:, first + 1 : first + self.look_back] = state[:, first : first + self.look_back - 1]
                for j, slope in enumerate(self.slopes[m]):
                    if slope:
                        tangent[:, first, j] = evaluate(slope, columns)
                for lag in range(1, self.look_back):
                    tangent[:, first + lag, first + lag - 1] = 1.0
        return after, tangent


def _slope(total: Sum, signal: str) -> Sum:
    out: Sum = {}
    for term, value in total.items():
        for t, share in partial(term, signal).items():
            out[t] = out.get(t, 0.0) + value * share
    return out


def lyapunov_along(
    model: Narmax, record: Record | Mapping[str, Floats], *, period: float = 1.0
) -> LyapunovExponents:
    """Return the exponents of one model along a recorded orbit instead of a free run; the model may have inputs.

    For a driven model, these are the conditional exponents. Noise of the orbit biases them; remove it with
    `without_noise`. The standard error is that of ten segments.
    """
    rows = lagged(record, model.terms, [model.output])
    total = sum_of(model)
    d = max((f.lag or 1 for t in total for f in t if f.variable == model.output), default=0)
    if d == 0:
        raise IdentError("the model has no past output, so it has no exponents; fit one with past outputs")
    slopes = [evaluate(_slope(total, f"{model.output}(k-{lag})"), rows.columns) for lag in range(1, d + 1)]
    n = len(rows.sample)
    if n < 10 * N_ORBIT_PARTS:
        raise IdentError(
            f"{n} samples are too few; exponents along an orbit require at least {10 * N_ORBIT_PARTS}"
        )
    tangent = np.zeros((n, d, d))
    for j, slope in enumerate(slopes):
        tangent[:, 0, j] = slope
    tangent[:, np.arange(1, d), np.arange(d - 1)] = 1.0
    frame, stretching = np.eye(d), np.empty((n, d))
    for k in range(n):
        frame, upper = np.linalg.qr(tangent[k] @ frame)
        stretching[k] = np.log(np.maximum(np.abs(np.diagonal(upper)), 1e-300))
    parts = np.array([part.mean(axis=0) for part in np.array_split(stretching, N_ORBIT_PARTS)]) / period
    return LyapunovExponents(
        values=stretching.mean(axis=0) / period,
        stderr=parts.std(axis=0, ddof=1) / np.sqrt(N_ORBIT_PARTS),
        lost=0.0,
    )


def states_of(
    models: Narmax | Sequence[Narmax], series: ArrayLike, n: int, rng: np.random.Generator
) -> Floats:
    """Draw n initial states for `lyapunov` from measured series (n_samples, n_models), or (n_samples,) for one model.

    Each is perturbed by 1e-6 of its standard deviation, so that pieces of one noise-free orbit do not coincide.
    """
    models = [models] if isinstance(models, Narmax) else list(models)
    step = TangentMap(models)
    table = np.asarray(series, dtype=np.float64)
    table = table[:, None] if table.ndim == 1 else table
    k = rng.integers(step.look_back, len(table), n)
    states = np.column_stack(
        [table[k - lag, m] for m in range(len(models)) for lag in range(1, step.look_back + 1)]
    )
    return np.asarray(states + 1e-6 * states.std(axis=0) * rng.normal(size=states.shape), dtype=np.float64)


@dataclass(frozen=True, kw_only=True, eq=False)
class NeighbourDivergence:
    """The mean divergence of neighbours over time."""

    exponent: float
    """[1/s] slope of the mean log distance in the fitted interval."""
    seconds: Floats
    """(n,) [s] time since the neighbours were closest."""
    log_distance: Floats
    """(n,) mean log distance."""
    n_pairs: int


def lyapunov_of_series(
    series: ArrayLike,
    *,
    dimension: int,
    lag: int = 1,
    theiler: int,
    fit: tuple[int, int],
    period: float = 1.0,
) -> NeighbourDivergence:
    """Return the largest exponent of a measured series (Rosenstein et al. 1993).

    Parameters
    ----------
    series : (n,), or (n, n_signals)
    dimension, lag : Dimension and lag [samples] of the embedding.
    theiler : [samples] Neighbours closer in time are excluded.
    fit : (first, last) [samples] Interval after the start in which the slope is fitted.
    """
    points = embed(series, dimension, lag)
    first, last = fit
    if not 0 <= first < last:
        raise ValueError(f"fit is {fit}, expected 0 <= first < last")
    if len(points) - last < 3 * max(theiler, 10):
        raise IdentError(
            f"{len(points)} embedded samples are too few to follow neighbours for {last} samples; use a longer series"
        )
    mine, theirs = neighbours(points[: len(points) - last], theiler)
    steps = np.arange(last + 1)
    seconds = np.asarray(steps * period, dtype=np.float64)
    apart = np.empty(len(steps))
    for i in steps.tolist():
        gap = np.linalg.norm(points[mine + i] - points[theirs + i], axis=1)
        apart[i] = np.log(gap[gap > 0]).mean() if (gap > 0).any() else np.nan
    used = slice(first, last + 1)
    exponent = float(np.polyfit(seconds[used], apart[used], 1)[0])
    return NeighbourDivergence(exponent=exponent, seconds=seconds, log_distance=apart, n_pairs=len(mine))
