"""Recursion of the equations of all rays over scans: one step ahead of measured readings, or in free run.

Reading of ray j, scaled on the right: r_j(k) = driven_j(k) + sum_{l,o} plain_{l,j,o} r_{j+o}(k-l)
+ sum_o (v twist_{0,j,o} + omega twist_{1,j,o} + omega² twist_{2,j,o}) r_{j+o}(k-1) + sum_l noise_{j,l} e_j(k-l).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sensorgraph.models.narmax.candidates import FACTORS, NarmaxForm, ReadingScale
from sensorgraph.types import Floats, Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadingGains:
    """Coefficients of lagged readings as arrays over rays and neighbours."""

    plain: Floats
    """(lags, n_rays, 2 * neighbours + 1) coefficients of the readings."""
    twist: Floats
    """(3, n_rays, 2 * neighbours + 1) coefficients of the readings at lag 1, times v, omega and omega^2."""

    @classmethod
    def of(cls, form: NarmaxForm, order: Ints, theta: Floats) -> ReadingGains:
        """Collect the coefficients from the terms (n_rays, n_max) of each ray."""
        n_rays, h, m = len(order), form.neighbours, len(form.shared)
        plain = np.zeros((form.lags, n_rays, 2 * h + 1))
        twist = np.zeros((len(FACTORS), n_rays, 2 * h + 1))
        for ray, j in zip(*np.nonzero(order >= m), strict=True):
            offset, lag, factor = form.readings[int(order[ray, j]) - m]
            if factor:
                twist[FACTORS.index(factor), ray, offset // form.spacing + h] = theta[ray, j]
            else:
                plain[lag - 1, ray, offset // form.spacing + h] = theta[ray, j]
        return cls(plain=plain, twist=twist)


@dataclass(frozen=True, kw_only=True, eq=False)
class Equations:
    """Inputs of the recursion at n scans: everything that does not depend on readings."""

    form: NarmaxForm
    scale: ReadingScale
    gains: ReadingGains
    noise: Floats
    """(n_rays, noise_lags) coefficients of the noise."""
    limits: tuple[float, float]
    """[m] Range limits of the sensor."""
    position: Ints
    """(n,) number of preceding scans in the stretch."""
    twists: Floats
    """(n, 2) [m/s, rad/s]"""
    start: Floats
    """(n, n_rays) [m] start equation, used without history."""
    driven: Floats
    """(n, n_rays) [m] sum of the terms of poses and twist; 0 without history."""


class RunState:
    """State of the recursion: scaled readings of the last scans, and their noise."""

    def __init__(self, equations: Equations) -> None:
        form, n_rays = equations.form, equations.start.shape[1]
        self.form, self.scale, self.n_rays = form, equations.scale, n_rays
        self.readings = np.zeros((form.lags, n_rays + 2 * form.reach))
        """(lags, n_rays + 2 reach) scaled readings, with a margin of zeros on both sides."""
        self.errors = np.zeros((equations.noise.shape[1], n_rays))

    @property
    def last(self) -> Floats:
        """(n_rays,) [m] readings of the preceding scan."""
        h = self.form.reach
        return np.asarray(
            self.readings[0, h : h + self.n_rays] * self.scale.width + self.scale.centre, dtype=np.float64
        )

    def predicted(self, equations: Equations, k: int) -> Floats:
        """Return the readings (n_rays,) [m] of scan k, which needs `lags` preceding scans."""
        if not self.form.lags:
            return np.asarray(equations.driven[k])
        window = sliding_window_view(self.readings, 2 * self.form.reach + 1, axis=1)[
            ..., :: self.form.spacing
        ]  # (lags, q, neighbours)
        v, omega = equations.twists[k]
        first = equations.gains.plain[0] + np.tensordot([v, omega, omega**2], equations.gains.twist, 1)
        raw = equations.driven[k] + np.einsum("qo,qo->q", first, window[0])
        if self.form.lags > 1:
            raw = raw + np.einsum("lqo,lqo->q", equations.gains.plain[1:], window[1:])
        return np.asarray(raw + np.einsum("ql,lq->q", equations.noise, self.errors))

    def advance(self, reading: Floats, error: Floats) -> None:
        """Append the readings and the noise (n_rays,) [m] of a scan."""
        h = self.form.reach
        if len(self.readings):
            self.readings[1:] = self.readings[:-1].copy()
            self.readings[0, h : h + self.n_rays] = (reading - self.scale.centre) / self.scale.width
        if len(self.errors):
            self.errors[1:] = self.errors[:-1].copy()
            self.errors[0] = error


def run(equations: Equations, measured: Floats | None = None) -> Floats:
    """Return the predicted readings (n, n_rays) [m].

    Parameters
    ----------
    measured : (n, n_rays) [m] Measured readings used as lags, with the last return held (one step ahead). None: predictions are used as lags (free run).
    """
    n, q = equations.start.shape
    state = RunState(equations)
    out = np.empty((n, q))
    seen = np.zeros(q, dtype=np.bool_)
    for k in range(n):
        position = equations.position[k]
        if position == 0:
            seen[:], state.errors[:] = False, 0.0
        has_history = position >= equations.form.lags
        raw = state.predicted(equations, k) if has_history else equations.start[k]
        is_held = has_history and equations.form.lags > 0
        value = np.clip(raw, *equations.limits) if is_held else raw
        out[k] = value
        reading, error = value, np.zeros(q)
        if measured is not None:
            hit = np.isfinite(measured[k])
            last = state.last if equations.form.lags else value
            reading = np.where(hit, measured[k], np.where(seen, last, value))
            error = np.where(hit & has_history, measured[k] - raw, 0.0)
            seen |= hit
        state.advance(reading, error)
    return out


def dropout_chances(base: Floats, memory: Floats, position: Ints, missing: Floats | None) -> Floats:
    """Return P(k) = base(k) + memory missing(k-1), the probability of no return (n, n_rays).

    It is a two-state Markov chain whose entry depends on the pose (Gilbert 1960).

    Parameters
    ----------
    base : (n, n_rays) Probability after a return.
    memory : (n_rays,) Increase after a missing return.
    missing : (n, n_rays) 1 for a missing return, nan where unknown. None: free run.
    """
    equilibrium = np.clip(base / (1.0 - memory), 0.0, 1.0)  # in equilibrium
    if missing is not None:
        before = np.vstack([equilibrium[:1], missing[:-1]])
        before = np.where(np.isnan(before) | (position == 0)[:, None], equilibrium, before)
        return np.clip(base + memory * before, 0.0, 1.0)
    out = np.empty_like(base)
    for k in range(len(base)):
        out[k] = equilibrium[k] if position[k] == 0 else np.clip(base[k] + memory * out[k - 1], 0.0, 1.0)
    return out
