"""Estimate the standard errors of accepted effects.

    smooth parameter             stderr = sqrt(diag(covariance))
    searched parameter           log p(at) - log p(at ± stderr) = 1/2
    searched, shared with noise  stderr = max(H^(-1/2), sqrt(S) / H)
    all                          sqrt(stderr² + hidden²)

The covariance is that of the joint fit, with poses, map, mount and clocks integrated out. Searched parameters are
cut-offs, ends of panes and shares. If an effect shares freedom with the noise, the noise is estimated again at
every step. H is then the curvature of the log-likelihood, and S the scatter of its slope between blocks of one
second, because neighbouring readings are correlated. This is Godambe's sandwich (Varin, Reid and Firth 2011, an
overview of composite likelihood methods). A careful setup may contain a hidden error of the same kind.

Slow reference errors look like a wrong mount or delay. The error of their mean is `width` (`wander_widths`):

    square = (2 Σ_k<m (c_2k + c_2k+1) - c_0) / n / max(1 - (4 m - 1) / n, LEAST_SEEN)
    width² = square - (c_0 + square) / n

Here c_k is the autocovariance of the n pose errors at lag k. The sum ends at the first pair of neighbours that is
not positive (Geyer 1992, Practical Markov chain Monte Carlo, section 3.3). A fit treats the pose errors of all
scans as independent. If they are correlated in time, their mean in the robot frame or along its path has a
larger error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted, fit, log_p_at
from sensorgraph.diagnosis.scan.nuisance import prior_widths
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.effects import Amendment
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.effects.set_up import SetUp
from sensorgraph.types import Floats

FALL_WINDOW = (0.15, 1.5)
"""[nats] Decreases from which a parabola gives the half-width of a searched parameter."""
MAX_CASTS = 7
"""Maximum number of casts per side."""
FIRST_STEP = 0.1
"""First step, relative to the first step of the search."""
LEAST_SEEN = 0.1
"""Minimum share of the squared error that a run shows, for any correlation time."""


def standard_errors(fitted: Fitted, noise_bounds: NoiseBounds) -> tuple[dict[str, float], ...]:
    """Return the standard errors of the parameters of every effect of a fit; undetermined ones are omitted."""
    smooth = _smooth_errors(fitted)
    out = []
    for index, amendment in enumerate(fitted.model):
        errors = {**_rough_errors(fitted, index, noise_bounds), **smooth[index]}
        errors |= _silhouette_errors(fitted, index, noise_bounds, errors)
        hidden = hidden_widths(fitted, amendment)
        out.append({k: float(np.hypot(v, hidden.get(k, 0.0))) for k, v in errors.items() if np.isfinite(v)})
    return tuple(out)


def _smooth_errors(fitted: Fitted) -> list[dict[str, float]]:
    """Return the standard errors of smooth parameters, from the curvature with all nuisances free."""
    variance = iter(np.diag(fitted.solution.covariance))
    return [
        {name: float(np.sqrt(max(next(variance), 0.0))) for name in amendment.steps}
        for amendment in fitted.model
    ]


def _rough_errors(fitted: Fitted, index: int, noise_bounds: NoiseBounds) -> dict[str, float]:
    """Return the standard errors of parameters that are searched or read off the rays."""
    amendment, data = fitted.model[index], fitted.solver.data
    if amendment.effect.diagnostics.is_lattice:
        return {name: lattice_error(data, step) for name, step in amendment.parameters.items()}
    steps = amendment.search_steps
    if amendment.effect.place == "sector":
        steps |= dict.fromkeys(("theta1", "theta2"), spacing(data))
    smooth = amendment.steps
    return {k: _profiled(fitted, index, noise_bounds, k, v) for k, v in steps.items() if k not in smooth}


def _silhouette_errors(
    fitted: Fitted, index: int, noise_bounds: NoiseBounds, errors: Mapping[str, float]
) -> dict[str, float]:
    """Return the standard errors of a move that no ray observed head-on, from the ends of the silhouette."""
    amendment = fitted.model[index]
    if amendment.effect.place != "obstacle":
        return {}
    unseen = {k: 2 * m for k, m in amendment.effect.sizes.items() if errors.get(k, 0.0) > m}
    map_ = fitted.solver.data.tolerances.map
    return {k: float(np.hypot(_profiled(fitted, index, noise_bounds, k, v), map_)) for k, v in unseen.items()}


def lattice_error(data: ScanData, q: float) -> float:
    """Return the largest error [m] of a lattice step q at which the farthest reading keeps its lattice point.

        error = cell q / (2 max(farthest, q))

    Here `cell` is the resolution of a reading.
    """
    cell = max(data.sensor.resolution, SCAN.likelihood.min_resolution)
    farthest = float(data.ranges[data.returned].max(initial=q))
    return 0.5 * cell * q / max(farthest, q)


def spacing(data: ScanData) -> float:
    """Return the angle [rad] between neighbouring rays."""
    bearings = data.sensor.bearings
    return float(np.median(np.diff(bearings))) if len(bearings) > 1 else 0.01


def _profiled(fitted: Fitted, index: int, noise_bounds: NoiseBounds, name: str, step: float) -> float:
    """Return the standard error of one searched parameter from the decrease of the likelihood on both sides."""
    data, amendment = fitted.solver.data, fitted.model[index]
    spec = amendment.effect.parameter(name)
    shares_noise = noise_bounds if amendment.effect.absorber else None
    at = amendment[name]

    def log_p(value: float) -> Floats:
        """Return the log-likelihood per scan."""
        moved = (
            *fitted.model[:index],
            amendment.moved_within_bounds({name: value}),
            *fitted.model[index + 1 :],
        )
        if spec.refit:
            j = fit(data, moved, fitted.state, noise_bounds).j
            return np.full(data.n_scans, j / data.n_scans)
        return np.asarray(log_p_at(data, moved, fitted.state, shares_noise).sum(axis=1))

    here = log_p(at)
    if shares_noise is not None:
        return jagged_error(lambda value: np.asarray(log_p(value) - here), data, at, step)
    sides = [_fall(log_p, here, at, sign * step) for sign in (1.0, -1.0)]
    return max((side for side in sides if np.isfinite(side)), default=np.inf)  # the wall may end on one side


def jagged_error(change: Callable[[float], Floats], data: ScanData, at: float, step: float) -> float:
    """Return the standard error of a parameter with a jagged likelihood, in which single readings jump.

        H = -Σ (up + down) / step²,   slope = (up - down) / (2 step),   S = Σ over blocks of (slope - mean)²
        stderr = max(H^(-1/2), sqrt(S) / H)

    Here `up` and `down` are the changes of the log-likelihood after one step to either side. The step decreases
    until it is below three times the resulting error. A shorter step would measure the jags (numerical
    derivatives of non-smooth functions: Pakes and Pollard 1989).

    Parameters
    ----------
    change : Change of the log-likelihood per scan [nats] from its value `at` the estimate.
    step : First step.
    """
    width = step
    for _ in range(MAX_CASTS):
        up, down = change(at + step), change(at - step)
        curvature = -float((up + down).sum()) / step**2
        if curvature > 0:
            scatter = float(np.sqrt(_by_block(data, (up - down) / (2 * step))))
            width = max(curvature**-0.5, scatter / curvature)
            if step < 3 * width:
                break
        step /= 3
    return width


def _fall(log_p: Callable[[float], Floats], here: Floats, at: float, step: float) -> float:
    """Return the distance over which the log-likelihood decreases by 1/2.

    Parameters
    ----------
    step : First step of the search, with the sign of the side.
    """
    reach, sign = abs(step), np.sign(step)
    h, low, high = FIRST_STEP * reach, 0.0, np.inf
    for _ in range(MAX_CASTS):
        fall = -float((log_p(at + sign * h) - here).sum())
        if FALL_WINDOW[0] < fall < FALL_WINDOW[1]:
            return h * float(np.sqrt(0.5 / fall))
        low, high = (h, high) if fall < FALL_WINDOW[0] else (low, h)
        h = 4 * low if high == np.inf else float(np.sqrt(max(low, high / 30) * high))
    return h if np.isfinite(high) else np.inf


def _by_block(data: ScanData, slope: Floats) -> float:
    """Return the scatter between blocks of the slope of the log-likelihood, given per scan (n_scans,)."""
    block = ((data.stamps - data.begin) / SCAN.block).astype(np.intp)
    sums = np.bincount(block - block.min(), slope)
    return float(np.square(sums - sums.mean()).sum())


def hidden_widths(fitted: Fitted, amendment: Amendment) -> dict[str, float]:
    """Return the hidden standard error of an effect, by parameter: of a careful setup and of a slow reference error.

    At a site with known-good runs, the spread between these runs is added.
    """
    data = fitted.solver.data
    nuisances, wanders = prior_widths(data.tolerances), wander_widths(fitted)
    set_up = set_up_of(data)
    baseline = data.site.intervals.get(amendment.name)
    out = {} if baseline is None else baseline.spread_of(amendment.name)
    for p in amendment.effect.parameters:
        if p.hidden is not None:
            out[p.name] = float(np.hypot(out.get(p.name, 0.0), p.hidden(set_up)))
        elif p.nuisance is not None:
            widths = (out.get(p.name, 0.0), nuisances[p.nuisance], wanders.get(p.nuisance, 0.0))
            out[p.name] = float(np.hypot.reduce(widths))
    return out


def evidence_beside_wander(fitted: Fitted, amendment: Amendment) -> float:
    """Return the evidence [nats] of a size, with the errors of the fit and of the mean of a slow reference error.

        evidence = Σ_p p² / (2 (stderr_p² - setup_p²)) - ½ k log n

    Here p are the k parameters that a pose error can imitate; the result is inf without any. The gains of a search
    are larger, because they treat the pose errors of different scans as independent.
    """
    nuisances, wanders = prior_widths(fitted.solver.data.tolerances), wander_widths(fitted)
    total, imitated = 0.0, 0
    for p in amendment.effect.parameters:
        if p.nuisance is None or p.nuisance not in wanders:
            continue
        set_up = float(nuisances[p.nuisance])  # added by `standard_errors` for a careful setup
        variance = amendment.stderr.get(p.name, np.inf) ** 2 - set_up**2
        total += amendment[p.name] ** 2 / max(variance, 1e-18)
        imitated += 1
    return total / 2 - fitted.solver.data.price(imitated) if imitated else np.inf


def set_up_of(data: ScanData) -> SetUp:
    """Return the accuracy of the setup of a run."""
    walls = np.diff(data.arena.walls, axis=1)[:, 0]
    return SetUp(
        tolerances=data.tolerances,
        median_range=float(np.median(data.ranges[data.returned])) if data.returned.any() else 1.0,
        ray_spacing=spacing(data),
        wall_length=float(np.median(np.hypot(*walls.T))) if len(walls) else np.inf,
        range_bias=float(prior_widths(data.tolerances)[Nuisance.BIAS]),
        strays=float(np.ptp(SCAN.noise.stray)) / float(np.sqrt(12)),
    )


def wander_widths(fitted: Fitted) -> dict[Nuisance, float]:
    """Return the standard deviations [m, m, rad, s] of mount and delay from slow pose errors.

    A delay is estimated from translation and turning, each weighted by the tolerance of the reference.
    """
    data, delta = fitted.solver.data, fitted.state.delta
    c, s = np.cos(data.poses[:, 2]), np.sin(data.poses[:, 2])
    ahead, aside = c * delta[:, 0] + s * delta[:, 1], c * delta[:, 1] - s * delta[:, 0]
    t, turning = data.tolerances, data.twists[:, 2]
    by_delay = ahead * data.speed / t.pose_xy**2 + delta[:, 2] * turning / t.pose_yaw**2
    square = float(np.mean((data.speed / t.pose_xy) ** 2 + (turning / t.pose_yaw) ** 2))
    return {
        Nuisance.MOUNT_X: error_of_mean(ahead),
        Nuisance.MOUNT_Y: error_of_mean(aside),
        Nuisance.MOUNT_YAW: error_of_mean(delta[:, 2]),
        Nuisance.DELAY: error_of_mean(by_delay) / square if square > 0 else 0.0,
    }


def error_of_mean(values: Floats) -> float:
    """Return `width`, the standard error of the mean of values (n,) in excess of that of independent values.

    Autocovariances about the sample mean are each too small by the squared error of that mean. The divisor of
    `square` corrects this. If the correlation time exceeds a tenth of the run, the correction is partial.
    """
    n, off = len(values), values - values.mean()
    spectrum = np.abs(np.fft.rfft(off, 2 * n)) ** 2
    covariance = np.fft.irfft(spectrum)[:n] / n
    pairs = covariance[0 : n - 1 : 2] + covariance[1:n:2]
    positive = pairs > 0
    kept = int(positive.argmin()) if not positive.all() else len(pairs)
    summed = 2 * float(pairs[:kept].sum()) - float(covariance[0])
    square = summed / n / max(1 - (4 * kept - 1) / n, LEAST_SEEN)
    return float(np.sqrt(max(square - (float(covariance[0]) + square) / n, 0.0)))
