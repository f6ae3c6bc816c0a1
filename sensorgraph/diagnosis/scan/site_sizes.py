"""How large an effect seems at a site though nothing is wrong: window by window, and as an interval over windows.

A number for the whole sensor (a bias, a drift, a share of strays) that is fitted to a run at a real site is never
zero: the map is a little off here and there, people pass. Windows of good runs show how the number spreads from one
window to the next. This module holds the data and their statistics; `site_variation` estimates them from fits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtri, stdtrit

from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.types import Floats


@dataclass(frozen=True, kw_only=True)
class WindowEstimate:
    """What one window of a good run shows by itself."""

    n_scans: int
    n_readings: int
    gains: Mapping[str, float]
    """Kind of clutter (`site_clutter`) -> [nats] the most that it gains, its price paid."""
    sizes: Mapping[str, Mapping[str, float]]
    """Effect -> parameter -> fitted value."""
    stderrs: Mapping[str, float]
    """Effect -> jackknife standard error over parts of the window [materialities]."""
    misfit: float
    """[nats] left unexplained."""

    def jackknife_stderr(self, name: str, n_scans: int) -> float:
        """Return the standard error of an effect, scaled to a window of so many scans [materialities]."""
        return self.stderrs.get(name, 0.0) * float(np.sqrt(self.n_scans / n_scans))


@dataclass(frozen=True, kw_only=True)
class BaselineInterval:
    """How large an effect seems, window by window, though nothing is wrong."""

    mean: Mapping[str, float]
    """Parameter -> mean over the windows, on the scale of `even_scale`."""
    half_width: Mapping[str, float]
    """Parameter -> how far from the mean a further window may be (prediction interval), on the same scale."""
    jackknife_stderr: float | None = None
    """Pooled standard error over parts, for a run of this length [materialities]; None: not estimated."""
    n_windows: int = 1

    def limits(self, name: str) -> dict[str, list[float]]:
        """Return the two ends of the interval of each parameter of the effect `name`."""
        ends = [
            parameter_scale(name, {k: self.mean[k] + sign * self.half_width[k] for k in self.half_width})
            for sign in (-1, 1)
        ]
        return {k: [end[k] for end in ends] for k in self.half_width}

    def contains(self, amendment: Amendment) -> bool:
        """Tell whether a size is one that the site shows by itself; several parameters add as a vector."""
        values = even_scale(amendment.name, amendment.parameters)
        off = [(values[k] - self.mean[k]) / self.half_width[k] for k in self.half_width]
        return bool(np.hypot.reduce(off) < 1.0)

    def is_exceeded_by(self, stderr: float) -> bool:
        """Tell whether the parts of a window disagree more than those of good windows (F test)."""
        return self.jackknife_stderr is not None and exceeds(stderr, self.jackknife_stderr, self.n_windows)


def exceeds(stderr: float, pooled: float, n_windows: int) -> bool:
    """Test (F) whether a jackknife error exceeds the pooled one of n windows by more than chance."""
    dof = SCAN.site.n_parts - 1
    limit = fdtri(dof, dof * n_windows, SCAN.site.confidence)
    return stderr**2 > float(limit) * pooled**2


def pooled(stderrs: Sequence[float]) -> float:
    """Return the root mean square of standard errors."""
    return float(np.sqrt(np.mean(np.square(stderrs))))


def consistent(windows: Sequence[WindowEstimate], name: str, n_scans: int) -> list[WindowEstimate]:
    """Leave out windows whose parts disagree on an effect more than those of the others (F test)."""
    stderrs = [w.jackknife_stderr(name, n_scans) for w in windows]
    kept = []
    for k, (window, stderr) in enumerate(zip(windows, stderrs, strict=True)):
        others = stderrs[:k] + stderrs[k + 1 :]
        if not others or not exceeds(stderr, pooled(others), len(others)):
            kept.append(window)
    return kept


def in_materialities(name: str, values: Mapping[str, float]) -> float:
    """Return the length of a vector of parameters, each in its materiality."""
    sizes = EFFECTS[name].sizes
    return float(np.hypot.reduce([values[k] / sizes[k] for k in values]))


def even_scale(name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Return parameters on a scale where they spread evenly: of a share its root (Anscombe 1948)."""
    shares = _shares(name)
    return {k: float(np.sqrt(v)) if k in shares else v for k, v in values.items()}


def parameter_scale(name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Undo `even_scale`."""
    shares = _shares(name)
    return {k: float(max(v, 0.0) ** 2) if k in shares else v for k, v in values.items()}


def _shares(name: str) -> set[str]:
    return {q.name for q in EFFECTS[name].parameters if (q.low, q.high) == (0.0, 1.0)}


def prediction_half_width(values: Floats, prior_spread: float | None) -> float:
    """Return how far from the mean of values (n,) a further value may be.

    Parameters
    ----------
    prior_spread : by how much careful set-ups vary anyhow, believed for `prior_windows` values; None: not known
    """
    site, n = SCAN.site, len(values)
    dof, squares = n - 1.0, float(((values - values.mean()) ** 2).sum())
    if prior_spread is not None:
        dof, squares = dof + site.prior_windows, squares + site.prior_windows * prior_spread**2
    spread = np.sqrt(squares / dof)
    return max(float(stdtrit(dof, site.confidence) * spread * np.sqrt(1 + 1 / n)), 1e-9)


def baseline_intervals(windows: Sequence[WindowEstimate], n_scans: int) -> dict[str, BaselineInterval]:
    """Return, per effect, what good windows show in a run of so many scans; effects of too few windows are left out."""
    out = {}
    for name in sorted({name for w in windows for name in w.sizes}):
        having = [w for w in windows if name in w.sizes]
        stderr = None
        if EFFECTS[name].nuisances:
            having = consistent(having, name, n_scans)
            stderr = pooled([w.jackknife_stderr(name, n_scans) for w in having])
        if len(having) < SCAN.site.min_windows:
            continue
        mean, half_width = {}, {}
        for k in having[0].sizes[name]:
            values = np.array([even_scale(name, w.sizes[name])[k] for w in having])
            mean[k] = float(values.mean())
            prior = EFFECTS[name].sizes[k] * SCAN.site.prior_share if EFFECTS[name].nuisances else None
            half_width[k] = prediction_half_width(values, prior)
        out[name] = BaselineInterval(
            mean=mean, half_width=half_width, jackknife_stderr=stderr, n_windows=len(having)
        )
    return out
