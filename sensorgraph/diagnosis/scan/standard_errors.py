"""How well the parameters of an accepted effect are known, and how surely its size is material.

Smooth parameters have the curvature of the joint fit, with poses, map, mount and clocks integrated out. Rough ones
(cut-offs, ends of panes, shares) have the half-width over which the log-likelihood falls by half a nat; where an
effect shares its freedom with the noise, the noise is estimated again at every step, and what neighbouring readings
have in common widens the error (Godambe's sandwich, clustered over blocks of a second: Varin, Reid and Firth 2011, an
overview of composite likelihood methods). What a careful set-up may hide of the same kind adds to either.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.special import ndtr

from sensorgraph.diagnosis.scan.fit import ROUGH, Fitted, fit, log_p_at, smooth_parameters
from sensorgraph.diagnosis.scan.likelihood import FINEST
from sensorgraph.diagnosis.scan.nuisance import DENSE, widths
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import size_ratio
from sensorgraph.effects.sonar_cone import RAY
from sensorgraph.types import Floats

BLOCK = 1.0  # [s] of scans that share their errors
HALF = 0.5  # [nats] by which the log-likelihood falls over one standard error
NEAR_HALF = (0.15, 1.5)  # [nats] a fall from which the half-width follows by the parabola
BROAD = (
    1.0,
    12.0,
)  # [nats] the same for what acts on single readings, whose likelihood is jagged in the small
LOOKS = 7  # casts per side, at most
REFITTED = ("range_drift",)  # whose rough parameter changes little that its smooth one cannot
NUDGED = 0.02  # [m] first step along which an obstacle is moved
FIRST = 0.1  # of the search's first step
FARTHEST = 20.0  # times the search's first step; beyond, a parameter is not known
OWN_TOLERANCE: dict[str, dict[str, str]] = {
    "mount_xy": {"dx": "mount_x", "dy": "mount_y"},
    "mount_yaw": {"delta": "mount_yaw"},
    "range_bias": {"b": "bias"},
    "range_scale": {"s": "scale"},
    "range_drift": {"b1": "drift"},
    "latency": {"tau": "latency"},
    "scan_skew": {"T": "skew"},
    "glass": {
        "depth": "third of the map",
        "a": "end of a part",
        "b": "end of a part",
        "alpha_ret": "wall direction",
    },
    "mirror": {"a": "end of a part", "b": "end of a part"},
    "black_surface": {"a": "end of a part", "b": "end of a part"},
    "incidence_dropout": {"alpha_max": "wall direction"},
    "unmapped_obstacle": {"x": "half of the map", "y": "half of the map", "r": "half of the map"},
    "tilt": {"theta0": "half a mrad", "beta": "a hundredth of a mrad"},
    "sector_bias": {"theta1": "between rays", "theta2": "between rays"},
    "self_occlusion": {"theta1": "between rays", "theta2": "between rays"},
    "mixed_pixels": {"gamma": "edges"},
    "sonar_cone": {"gamma": "between rays of the cone"},
    "max_range": {"R": "map"},
    "min_range": {"r_min": "map"},
}
"""Effect -> parameter -> what a careful set-up, or the spacing of the rays, hides of it."""


def standard_errors(fitted: Fitted, noise_bounds: NoiseBounds) -> tuple[dict[str, float], ...]:
    """Return, for every effect of a fit, its parameters' standard errors; none for what cannot be known."""
    smooth = _smooth_errors(fitted)
    out = []
    for index, amendment in enumerate(fitted.model):
        errors = {**_rough_errors(fitted, index, noise_bounds), **smooth[index]}
        errors |= _silhouette_errors(fitted, index, noise_bounds, errors)
        hidden = widths_of(fitted, amendment)
        out.append({k: float(np.hypot(v, hidden.get(k, 0.0))) for k, v in errors.items() if np.isfinite(v)})
    return tuple(out)


def _smooth_errors(fitted: Fitted) -> list[dict[str, float]]:
    """Return standard errors of smooth parameters, from the curvature with all nuisances free."""
    variance = iter(np.diag(fitted.solution.covariance))
    return [
        {name: float(np.sqrt(max(next(variance), 0.0))) for name in smooth_parameters(amendment)}
        for amendment in fitted.model
    ]


def _rough_errors(fitted: Fitted, index: int, noise_bounds: NoiseBounds) -> dict[str, float]:
    """Return standard errors of the parameters that are searched or read off the rays."""
    amendment, data = fitted.model[index], fitted.solver.data
    if amendment.name == "quantisation":
        return {"q": lattice_error(data, amendment["q"])}
    steps = {k: v for k, v in ROUGH.get(amendment.name, {}).items() if k in amendment.parameters}
    if amendment.effect.place == "sector":
        steps |= dict.fromkeys(("theta1", "theta2"), spacing(data))
    smooth = smooth_parameters(amendment)
    return {k: _profiled(fitted, index, noise_bounds, k, v) for k, v in steps.items() if k not in smooth}


def _silhouette_errors(
    fitted: Fitted, index: int, noise_bounds: NoiseBounds, errors: Mapping[str, float]
) -> dict[str, float]:
    """Return standard errors of a move that no ray met head-on: the ends of the silhouette alone tell of it."""
    amendment = fitted.model[index]
    if amendment.name != "moved_obstacle":
        return {}
    unseen = [k for k, m in amendment.effect.sizes.items() if errors.get(k, 0.0) > m]
    map_ = fitted.solver.data.tolerances.map
    return {k: float(np.hypot(_profiled(fitted, index, noise_bounds, k, NUDGED), map_)) for k in unseen}


def lattice_error(data: ScanData, q: float) -> float:
    """Return how far the step of a lattice may be off [m] before the farthest reading leaves its lattice point."""
    cell = max(data.sensor.resolution, FINEST)
    farthest = float(data.ranges[data.returned].max(initial=q))
    return 0.5 * cell * q / max(farthest, q)


def spacing(data: ScanData) -> float:
    """Return the angle [rad] between neighbouring rays."""
    bearings = data.sensor.bearings
    return float(np.median(np.diff(bearings))) if len(bearings) > 1 else 0.01


def _profiled(fitted: Fitted, index: int, noise_bounds: NoiseBounds, name: str, step: float) -> float:
    """Return the standard error of one rough parameter from how the likelihood falls on both sides."""
    data, amendment = fitted.solver.data, fitted.model[index]
    spec = next(q for q in amendment.effect.parameters if q.name == name)
    shares_noise = noise_bounds if amendment.effect.absorber else None
    at = amendment[name]

    def log_p(value: float) -> Floats:
        """Return the log-likelihood per scan."""
        moved = (
            *fitted.model[:index],
            amendment.moved_to({name: float(np.clip(value, spec.low, spec.high))}),
            *fitted.model[index + 1 :],
        )
        if amendment.name in REFITTED:
            j = fit(data, moved, fitted.state, noise_bounds, outer=1, inner=1).j
            return np.full(data.n_scans, j / data.n_scans)
        return np.asarray(log_p_at(data, moved, fitted.state, shares_noise).sum(axis=1))

    here = log_p(at)
    bounds = NEAR_HALF if shares_noise is None else BROAD
    sides = [_fall(log_p, here, at, sign * step, bounds) for sign in (1.0, -1.0)]
    width = max(
        (width for width, _ in sides if np.isfinite(width)), default=np.inf
    )  # one side may end the wall
    if shares_noise is None or not all(np.isfinite(w) for w, _ in sides):
        return width
    slope = sum(sign * change / w for sign, (w, change) in zip((0.5, -0.5), sides, strict=True))
    return width * max(1.0, width * float(np.sqrt(_by_block(data, np.asarray(slope)))))


def _fall(
    log_p: Callable[[float], Floats], here: Floats, at: float, step: float, bounds: tuple[float, float]
) -> tuple[float, Floats]:
    """Return the distance over which the log-likelihood falls by half a nat, and its change per scan there.

    Parameters
    ----------
    step : first step of the search, with the sign of the side
    bounds : [nats] of a fall from which the distance follows by the parabola
    """
    reach, sign = abs(step), np.sign(step)
    h, low, high = FIRST * reach, 0.0, np.inf
    change = np.zeros(len(here))
    for _ in range(LOOKS):
        change = log_p(at + sign * h) - here
        fall = -float(change.sum())
        if bounds[0] < fall < bounds[1]:
            scale = float(np.sqrt(HALF / fall))
            return h * scale, change * scale
        low, high = (h, high) if fall < bounds[0] else (low, h)
        if low > FARTHEST * reach:
            return np.inf, change
        h = 4 * low if high == np.inf else float(np.sqrt(max(low, high / 30) * high))
    return h, change


def _by_block(data: ScanData, slope: Floats) -> float:
    """Return the scatter between blocks of the slope of the log-likelihood, given per scan (n_scans,)."""
    block = ((data.stamps - data.begin) / BLOCK).astype(np.intp)
    sums = np.bincount(block - block.min(), slope)
    return float(np.square(sums - sums.mean()).sum())


def widths_of(fitted: Fitted, amendment: Amendment) -> dict[str, float]:
    """Return what a careful set-up may hide of an effect, by parameter."""
    data = fitted.solver.data
    t = data.tolerances
    tau = dict(zip(DENSE, widths(t), strict=True))
    tau |= {"map": t.map, "third of the map": t.map / 3, "half of the map": t.map / 2}
    tau |= {"half a mrad": 5e-4, "a hundredth of a mrad": 1e-5}
    middle = float(np.median(data.ranges[data.returned])) if data.returned.any() else 1.0
    tau |= {"edges": 0.5 * t.map / max(middle, 0.1)}  # a few corners, each off by the map's tolerance
    tau |= {"between rays of the cone": RAY / np.sqrt(12)}
    tau |= {"end of a part": float(np.hypot(t.map, t.pose_xy + t.pose_yaw * middle))}  # told by single rays
    tau |= {"between rays": spacing(data) / np.sqrt(12)}
    walls = np.diff(data.arena.walls, axis=1)[:, 0]
    tau |= {"wall direction": t.map / float(np.median(np.hypot(*walls.T)))} if len(walls) else {}
    own = OWN_TOLERANCE.get(amendment.name, {})
    return {parameter: float(tau.get(copy, 0.0)) for parameter, copy in own.items()}


def material_probability(amendment: Amendment, stderr: Mapping[str, float], slack: float = 1.0) -> float:
    """Return the chance that an effect's size is at least `slack` times its materiality; 1 where it has no limit.

    The error counts along the direction of the size (several sizes add as a vector); either sign is as good.
    """
    sizes = amendment.effect.sizes
    ratio = size_ratio(amendment.effect, amendment.parameters)
    if not np.isfinite(ratio):
        return 1.0
    parts = {
        k: (amendment[k] / m, stderr.get(k, 0.0) / m) for k, m in sizes.items() if k in amendment.parameters
    }
    along = sum((value * error) ** 2 for value, error in parts.values()) ** 0.5 / max(ratio, 1e-9)
    error = max(along, 1e-6)
    return float(ndtr((ratio - slack) / error) + ndtr((-ratio - slack) / error))
