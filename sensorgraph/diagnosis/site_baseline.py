"""Baseline of a site: what known-good runs show of each effect, per window, and as a prediction interval over windows.

    Σ_w (values_w - mean)² / (stderrs_w² + variance) + prior / variance = dof        (Paule and Mandel 1982)
    half width = t(joint) sqrt(spread² + stderr²)

A parameter of the whole sensor (a bias, a drift, a share of outliers) that is fitted to a run at a real site
is never zero: the map is slightly off in places, and people pass. Windows of known-good runs show the spread
of the parameter from one window to the next. Each window is weighted by the agreement of its parts. This is a
random-effects model with its prediction interval (Higgins, Thompson and Spiegelhalter 2009, eq. 12). This
module holds the data and their statistics; `commissioning` estimates them from fits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import stdtrit

from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.effects.range_bias import RANGE_BIAS
from sensorgraph.effects.sector_bias import SECTOR_BIAS
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot

WHOLE_OF = {SECTOR_BIAS.name: RANGE_BIAS.name}
"""Effect of some rays -> the same effect of all rays."""


@dataclass(frozen=True, kw_only=True)
class WindowEstimate:
    """Apparent effects in one window of a known-good run."""

    n_scans: int
    n_readings: int
    gains: Mapping[str, float]
    """Effect -> [nats] Largest evidence that clutter contributes, after the complexity penalty."""
    sizes: Mapping[str, Mapping[str, float]]
    """Effect -> parameter -> fitted value."""
    stderrs: Mapping[str, Mapping[str, float]]
    """Effect -> parameter -> jackknife standard error over parts of the window; for some effects only."""
    misfit: float
    """[nats] Unexplained misfit."""


@dataclass(frozen=True, kw_only=True)
class BaselineInterval:
    """Apparent size of an effect in windows of known-good runs; values on the scale of `even_scale`."""

    mean: Mapping[str, float]
    """Parameter -> mean over windows, weighted by their inverse variances."""
    spread: Mapping[str, float]
    """Parameter -> standard deviation of an exactly known further window: between windows, and of the mean."""
    stderr: Mapping[str, float]
    """Parameter -> standard error of the value of one window, as the median over windows."""
    dof: float
    """Degrees of freedom of the spread."""

    def half_width(self, stderr: Mapping[str, float] | None = None) -> dict[str, float]:
        """Return the half-width of the prediction interval of a further window, by parameter.

        Parameters
        ----------
        stderr : Parameter -> jackknife standard error of the value of that window; default: the value is exact.
        """
        own = stderr or {}
        return {k: prediction_half_width(self.spread[k], self.dof, own.get(k, 0.0)) for k in self.mean}

    def spread_of(self, name: str) -> dict[str, float]:
        """Return the spread of those parameters of the effect `name` that `even_scale` does not change."""
        return {k: v for k, v in self.spread.items() if k not in _powers(name)}

    def limits(self, name: str) -> dict[str, list[float]]:
        """Return the interval limits of each parameter of the effect `name`, for a window like the others."""
        far = self.half_width(self.stderr)
        ends = [parameter_scale(name, {k: self.mean[k] + sign * far[k] for k in far}) for sign in (-1, 1)]
        return {k: [end[k] for end in ends] for k in far}

    def contains(self, amendment: Amendment, stderr: Mapping[str, float] | None = None) -> bool:
        """Return whether a size is usual for the site; several parameters add as a vector."""
        values, far = even_scale(amendment.name, amendment.parameters), self.half_width(stderr)
        return bool(np.hypot.reduce([(values[k] - self.mean[k]) / far[k] for k in far]) < 1.0)


@dataclass(frozen=True, kw_only=True)
class SitePrior:
    """What known-good runs of a site show of each effect; without such runs, nothing."""

    floors: Mapping[str, float] = field(default_factory=dict)
    """Effect -> [nats] Additional evidence that its name requires; inf: not searched for."""
    leads: Mapping[str, float] = field(default_factory=dict)
    """Smooth effect of the whole sensor -> [nats] Evidence that clutter alone may contribute. A smaller lead does
    not decide against a rival that is also outside its own interval."""
    intervals: Mapping[str, BaselineInterval] = field(default_factory=dict)
    """Effect -> Sizes that fits to the runs show."""

    @property
    def is_known(self) -> bool:
        """Whether clutter of the site is known."""
        return bool(self.floors)

    def floor(self, name: str) -> float:
        """Return the additional evidence [nats] that the name of an effect requires."""
        return self.floors.get(name, 0.0)

    def lead(self, a: Amendment, rival: Amendment) -> float:
        """Return the lead [nats] over a rival that clutter alone may give an effect; 0 if the rival has a usual size."""
        usual = self.intervals.get(rival.name)
        if a.name not in self.leads or usual is None or usual.contains(rival, usual.stderr):
            return 0.0
        return max(self.leads[a.name], self.leads.get(rival.name, 0.0))


def even_scale(name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Return parameters on a scale of constant variance.

    A share is replaced by its square root (Anscombe 1948), and a standard deviation by its power 2/3 (Wilson
    and Hilferty 1931).
    """
    powers = _powers(name)
    return {k: float(v ** powers[k]) if k in powers else v for k, v in values.items()}


def parameter_scale(name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Invert `even_scale`."""
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
    prior_spread : Usual variation of careful setups, with the weight of `prior_windows` windows; None: unknown.
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
    """Return the half-width of the prediction interval of a further value with its own error.

        half width = t(joint) sqrt(spread² + stderr²)
        joint = (spread² + stderr²)² / (spread⁴ / dof + stderr⁴ / (n_parts - 1))

    Parameters
    ----------
    spread : with `dof` degrees of freedom
    stderr : of a jackknife over `n_parts`; the joint degrees of freedom follow Welch (1947)
    """
    parts = SCAN.site.n_parts - 1
    total = spread**2 + stderr**2
    joint = total**2 / (spread**4 / dof + stderr**4 / parts)
    return max(float(stdtrit(joint, SCAN.site.confidence) * np.sqrt(total)), 1e-9)


def baseline_intervals(windows: Sequence[WindowEstimate]) -> dict[str, BaselineInterval]:
    """Return the interval of each effect in known-good windows; effects with too few windows are omitted.

    Readings of a part of the sensor vary at least as much as those of the whole sensor.
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


@dataclass(frozen=True, kw_only=True, eq=False)
class SiteBaseline:
    """Effects, tolerances and noise that known-good runs of a site show."""

    robot: Robot
    """With the pose tolerances and the sensor resolution that the runs showed."""
    known: tuple[Amendment, ...]
    """Effects that the runs show; they become part of the simulator."""
    noise_bounds: NoiseBounds
    """Limits of the noise, close to what the runs showed."""
    not_looked_for: tuple[str, ...]
    """Effects that a map of this kind cannot show."""
    runs: tuple[tuple[tuple[WindowEstimate, ...], ...], ...]
    """Estimates of each run, for the whole run and for shorter windows."""

    @property
    def n_runs(self) -> int:
        """Number of known-good runs, or of parts of them."""
        return len(self.runs)

    def to_dict(self, name: str) -> dict[str, Any]:
        """Return the baseline as plain data for the report, for a run as long as the first.

        Parameters
        ----------
        name : Of the runs.
        """
        first = self.runs[0][0][0]
        windows = self.similar_windows(first.n_scans)
        intervals = baseline_intervals(windows)
        clutter = self.clutter_nats(windows, intervals, first.n_readings)
        bounds = self.noise_bounds
        return {
            "run": name,
            "runs": self.n_runs,
            "tolerances": asdict(self.robot.tolerances),
            "resolution": self.robot.sensor.resolution,
            "noise": {
                "core": bounds.core,
                "tail": bounds.tail,
                "loss": bounds.loss,
                "stray": bounds.stray,
                "most": bounds.max_scale,
            },
            "known": {a.name: dict(a.parameters) for a in self.known},
            "clutter_floor_nats": {effect: round(nats, 1) for effect, nats in clutter.items()},
            "usual_sizes": {effect: interval.limits(effect) for effect, interval in intervals.items()},
            "not_looked_for": list(self.not_looked_for),
        }

    def similar_windows(self, n_scans: int) -> list[WindowEstimate]:
        """Return windows of the known-good runs of nearly the same length; also shorter ones, if these are few."""
        levels = []
        for cuts in self.runs:
            apart = [abs(np.log(level[0].n_scans / n_scans)) for level in cuts]
            levels.append(cuts[int(np.argmin(apart)) :])
        windows: list[WindowEstimate] = []
        for depth in range(max(len(level) for level in levels)):
            windows += [w for finer in levels for level in finer[depth : depth + 1] for w in level]
            if len(windows) >= SCAN.site.min_windows:
                break
        return windows

    def clutter_nats(
        self,
        windows: Sequence[WindowEstimate],
        intervals: Mapping[str, BaselineInterval],
        n_readings: int,
    ) -> dict[str, float]:
        """Return the evidence [nats] that clutter may give to each effect in a run of this length.

        Smooth whole-sensor effects with a baseline interval are omitted: the interval is the sharper test.
        """
        return {
            name: most
            for name, most in self._most_nats(windows, n_readings).items()
            if not _has_sharper_test(name, intervals)
        }

    def _most_nats(self, windows: Sequence[WindowEstimate], n_readings: int) -> dict[str, float]:
        """Return the evidence [nats] that clutter may give to each effect in a run with this number of readings."""
        factor = SCAN.site.clutter_factor_of_one if self.n_runs == 1 else SCAN.site.clutter_factor
        most: dict[str, float] = {}
        for w in windows:
            size = float(np.sqrt(n_readings / w.n_readings))
            for name, gain in w.gains.items():
                most[name] = max(most.get(name, 0.0), factor * gain * (1.0 if _is_local(name) else size))
        return most

    def prior(self, n_scans: int, n_readings: int) -> SitePrior:
        """Return what the known-good runs show of each effect, for a later run of this length."""
        windows = self.similar_windows(n_scans)
        intervals = baseline_intervals(windows)
        floors = self.clutter_nats(windows, intervals, n_readings)
        clutter = {name: max(nats - SCAN.selection.threshold, 0.0) for name, nats in floors.items()}
        clutter |= dict.fromkeys(self.not_looked_for, float("inf"))
        leads = {
            name: nats
            for name, nats in self._most_nats(windows, n_readings).items()
            if _has_sharper_test(name, intervals)
        }
        return SitePrior(floors=clutter, leads=leads, intervals=intervals)

    def usual_misfit(self, n_readings: int) -> float:
        """Return the unexplained misfit [nats] that a run with this number of readings may have."""
        windows = [w for cuts in self.runs for level in cuts[:2] for w in level]
        own = max(w.misfit / w.n_readings for w in windows) * n_readings
        return SCAN.site.clutter_factor_of_one * own


def _has_sharper_test(name: str, intervals: Mapping[str, BaselineInterval]) -> bool:
    """Tell whether an effect is a smooth whole-sensor effect, whose size is compared with known-good runs."""
    return name in intervals and bool(EFFECTS[name].nuisances)


def _is_local(name: str) -> bool:
    """Tell whether an effect has one place in the site, so that its evidence does not grow with the run."""
    return EFFECTS[name].place in ("wall", "obstacle", "spot")
