"""How large an effect seems at a site though nothing is wrong: window by window, and as an interval over windows.

A number for the whole sensor (a bias, a drift, a share of strays) that is fitted to a run at a real site is never
zero: the map is a little off here and there, people pass. Windows of good runs show how the number spreads from one
window to the next, each as surely as its own parts agree on it: a random-effects model, and its prediction interval
(Higgins, Thompson and Spiegelhalter 2009, eq. 12). This module holds the data and their statistics; `site_variation`
estimates them from fits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import stdtrit

from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.effects.range_bias import RANGE_BIAS
from sensorgraph.effects.sector_bias import SECTOR_BIAS
from sensorgraph.types import Floats

WHOLE_OF = {SECTOR_BIAS.name: RANGE_BIAS.name}
"""Effect of some rays -> the same of all."""


@dataclass(frozen=True, kw_only=True)
class WindowEstimate:
    """What one window of a good run shows by itself."""

    n_scans: int
    n_readings: int
    gains: Mapping[str, float]
    """Effect -> [nats] the most that clutter brings it, its price paid."""
    sizes: Mapping[str, Mapping[str, float]]
    """Effect -> parameter -> fitted value."""
    stderrs: Mapping[str, Mapping[str, float]]
    """Effect -> parameter -> jackknife standard error over parts of the window; none: of some effects."""
    misfit: float
    """[nats] left unexplained."""


@dataclass(frozen=True, kw_only=True)
class BaselineInterval:
    """How large an effect seems, window by window, though nothing is wrong; values on the scale of `even_scale`."""

    mean: Mapping[str, float]
    """Parameter -> mean over windows, each weighed by how sure it is."""
    spread: Mapping[str, float]
    """Parameter -> standard deviation of a further window that is known exactly: between windows, and of the mean."""
    stderr: Mapping[str, float]
    """Parameter -> standard error of the value of one window, the median of the windows."""
    dof: float
    """Degrees of freedom of the spread."""

    def half_width(self, stderr: Mapping[str, float] | None = None) -> dict[str, float]:
        """Return how far from the mean a further window may be, by parameter (a prediction interval).

        Parameters
        ----------
        stderr : parameter -> jackknife standard error of that window's value; default: it is known exactly
        """
        own = stderr or {}
        return {k: prediction_half_width(self.spread[k], self.dof, own.get(k, 0.0)) for k in self.mean}

    def spread_of(self, name: str) -> dict[str, float]:
        """Return the spread of those parameters of the effect `name` that spread evenly as they are."""
        return {k: v for k, v in self.spread.items() if k not in _powers(name)}

    def limits(self, name: str) -> dict[str, list[float]]:
        """Return the two ends of the interval of each parameter of the effect `name`, for a window like the others."""
        far = self.half_width(self.stderr)
        ends = [parameter_scale(name, {k: self.mean[k] + sign * far[k] for k in far}) for sign in (-1, 1)]
        return {k: [end[k] for end in ends] for k in far}

    def contains(self, amendment: Amendment, stderr: Mapping[str, float] | None = None) -> bool:
        """Tell whether a size is one that the site shows by itself; several parameters add as a vector."""
        values, far = even_scale(amendment.name, amendment.parameters), self.half_width(stderr)
        return bool(np.hypot.reduce([(values[k] - self.mean[k]) / far[k] for k in far]) < 1.0)


def even_scale(name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Return parameters on a scale where they spread evenly.

    Of a share its root (Anscombe 1948), of a standard deviation the cube root of its square (Wilson and Hilferty 1931).
    """
    powers = _powers(name)
    return {k: float(v ** powers[k]) if k in powers else v for k, v in values.items()}


def parameter_scale(name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Undo `even_scale`."""
    powers = _powers(name)
    return {k: float(max(v, 0.0) ** (1 / powers[k])) if k in powers else v for k, v in values.items()}


def _powers(name: str) -> dict[str, float]:
    of_bounds = {(0.0, 1.0): 1 / 2, (0.0, np.inf): 2 / 3}
    parameters = EFFECTS[name].parameters
    return {q.name: of_bounds[q.low, q.high] for q in parameters if (q.low, q.high) in of_bounds}


def between_windows(
    values: Floats, stderrs: Floats, prior_spread: float | None
) -> tuple[float, float, float]:
    """Return mean, standard error of the mean, and standard deviation between windows (Paule and Mandel 1982).

    Parameters
    ----------
    values, stderrs : (n,) of each window
    prior_spread : by how much careful set-ups vary anyhow, believed for `prior_windows` values; None: not known
    """
    belief = 0.0 if prior_spread is None else SCAN.site.prior_windows
    prior = belief * (prior_spread or 0.0) ** 2
    dof = len(values) - 1 + belief

    def excess(variance: float) -> float:
        weights = 1 / (stderrs**2 + variance)
        mean = weights @ values / weights.sum()
        return float(weights @ (values - mean) ** 2 + prior / variance - dof)

    tiny = 1e-18
    most = float(((values - values.mean()) ** 2).sum()) + prior + tiny
    variance = float(brentq(excess, tiny, most)) if excess(tiny) > 0 else tiny
    weights = 1 / (stderrs**2 + variance)
    return float(weights @ values / weights.sum()), float(weights.sum() ** -0.5), float(np.sqrt(variance))


def prediction_half_width(spread: float, dof: float, stderr: float) -> float:
    """Return how far from the mean a further value may be, that has an error of its own.

    Parameters
    ----------
    spread : with `dof` degrees of freedom
    stderr : of a jackknife over `n_parts`; the degrees of freedom of both together are Welch's (1947)
    """
    parts = SCAN.site.n_parts - 1
    total = spread**2 + stderr**2
    joint = total**2 / (spread**4 / dof + stderr**4 / parts)
    return max(float(stdtrit(joint, SCAN.site.confidence) * np.sqrt(total)), 1e-9)


def baseline_intervals(windows: Sequence[WindowEstimate]) -> dict[str, BaselineInterval]:
    """Return, per effect, what good windows show; effects of too few windows are left out.

    Readings of a part of the sensor vary at least as those of all of it.
    """
    out = {}
    for name in sorted({name for w in windows for name in w.sizes}):
        having = [w for w in windows if name in w.sizes]
        if len(having) < SCAN.site.min_windows:
            continue
        belief = SCAN.site.prior_windows if EFFECTS[name].nuisances else 0.0
        mean, spread, stderr = {}, {}, {}
        for k in having[0].sizes[name]:
            values = np.array([even_scale(name, w.sizes[name])[k] for w in having])
            errors = np.array([w.stderrs.get(name, {}).get(k, 0.0) for w in having])
            prior = EFFECTS[name].sizes[k] * SCAN.site.prior_share if belief else None
            mean[k], of_mean, between = between_windows(values, errors, prior)
            spread[k] = float(np.hypot(of_mean, between))
            stderr[k] = float(np.median(errors))
        out[name] = BaselineInterval(mean=mean, spread=spread, stderr=stderr, dof=len(having) - 1 + belief)
    return {part: out[whole] for part, whole in WHOLE_OF.items() if whole in out} | out
