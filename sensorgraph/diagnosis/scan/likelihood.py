"""Likelihood of measured readings given the expected ones, a compiled beam mixture, and samples from it.

Density of a return z with the expected range mu: core, tail, far side of an edge, short, stray.

    p(z) = rest p_return (1 - loss) [(1 - a) ((1 - share) N(z; mu, s²) + share N(z; mu, (tail_width s)²))
                                     + a (EDGE_NEAR N(z; there, s_there²) + EDGE_BETWEEN U(mu, there))]
           + (1 - stray) short U(0, mu) + (stray + unexplained) / range_max.

Here a = p_alternative, s_there² = (EDGE_WIDTH s)² + spread² and rest = (1 - stray) (1 - short). Probability of no return:

    P(inf) = (1 - short) [(1 - stray) seen loss + rest (1 - seen) + lost_at_edge] + unexplained,
    seen   = p_return [(1 - a) Phi((range_max - mu) / s) + a Phi((range_max - there) / s_there)].

The term lost_at_edge applies only next to an edge. The mixture follows Thrun, Burgard and Fox 2005, section 6.3, with the
wide tail and the edges in depth added.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planners.kernel import inlined_kernel, outer_kernel
from sensorgraph.diagnosis.scan.depth_edges import MIN_SHORT_RANGE, REACH, Edges
from sensorgraph.diagnosis.scan.nuisance import BeamNoise
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.types import Floats
from sensorgraph.world.beams import Beams
from sensorgraph.world.scene import apply_range_limits

SETTINGS = SCAN.likelihood
SQRT_2, SQRT_TAU = math.sqrt(2.0), math.sqrt(2 * math.pi)
# These settings are constants of this module instead of `settings`, because numba compiles their values into the kernel.
EDGE_WIDTH = 2.0
"""Ratio of the standard deviation at the far side of an edge to that of the core."""
EDGE_NEAR = 0.9
EDGE_BETWEEN = 1 - EDGE_NEAR
"""Shares of the readings at an edge: at its far side, and anywhere between the two sides."""
CUT = REACH
"""Standard deviations from a limit of the sensor, within which a residual has weight 0: as far as from an edge in depth.

Near a limit only the readings on one side of it return, so their mean is biased."""
ROUND_OFF = 1e-6
"""[m] Rounding error of a reading that a log stores in single precision, at 16 m."""

LOG_P, WEIGHT, RESIDUAL, CORE, TAIL, LOST, STRAY = range(7)


@dataclass(frozen=True, kw_only=True, eq=False)
class ExpectedReadings:
    """Quantities that each reading is compared with; arrays (n_scans, n_rays)."""

    reading: Floats
    """[m] expected range before nuisances; inf where no return is possible."""
    sigma: Floats
    """[m] nominal standard deviation, including the additional error of slanting rays."""
    p_return: Floats
    """Probability that the ray returns."""
    alternative: Floats
    """[m] expected range on the other side of an edge; nan without an edge."""
    spread: Floats
    """[m] standard deviation of `alternative`, without the noise of a reading."""
    p_alternative: Floats
    """Probability that the ray reads `alternative`."""
    stray: float
    """Probability of an outlier that effects add."""
    short: float
    """Probability of a short reading that effects add."""
    lattice: float
    """[m] step to which effects round the readings; 0 without rounding."""


def expected_readings(
    beams: Beams,
    steep: Floats,
    edges: Edges | None,
    stray: float,
    short: float,
    lattice: float,
) -> ExpectedReadings:
    """Collect the quantities of a cast that the likelihood needs.

    Parameters
    ----------
    steep : (n_scans, n_rays) [m] Additional standard deviation of slanting rays.
    edges : Edges in depth; None without edges.
    stray, short : Probabilities of an outlier and of a short reading that effects add.
    lattice : [m] Step to which effects round the readings; 0 without rounding.
    """
    shape = beams.reading.shape
    alternative, spread, chance = np.full(shape, np.nan), np.zeros(shape), np.zeros(shape)
    if edges is not None:
        alternative[edges.index] = edges.other
        spread[edges.index] = edges.spread
        chance[edges.index] = edges.chance
    if beams.straight is not None:
        chance = np.where(beams.straight, chance, 0.0)
    sigma = np.sqrt(np.square(beams.sigma) + steep**2)
    return ExpectedReadings(
        reading=beams.reading,
        sigma=np.broadcast_to(sigma, shape),
        p_return=np.broadcast_to(np.asarray(beams.p_return, dtype=np.float64), shape),
        alternative=alternative,
        spread=spread,
        p_alternative=chance,
        stray=stray,
        short=short,
        lattice=lattice,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Responsibilities:
    """Log-likelihood of every reading, and the posterior probability of each component; arrays (n_scans, n_rays)."""

    log_p: Floats
    """[nats] 0 for a broken reading."""
    weight: Floats
    """[1/m²] weight of the residual."""
    residual: Floats
    """[m] measured - expected; 0 where either is not finite."""
    core: Floats
    """Probability that the core produced the reading."""
    tail: Floats
    """Probability that the tail produced the reading."""
    lost: Floats
    """Probability that a missing return is missing by chance."""
    stray: Floats
    """Probability that the reading is an outlier."""


def e_step(data: ScanData, expected: ExpectedReadings, shift: Floats, noise: BeamNoise) -> Responsibilities:
    """Return the responsibilities of the mixture's components for every reading (E step of EM).

    Parameters
    ----------
    shift : (n_scans, n_rays) [m] Contribution of nuisances and effects to the expected readings.
    """
    z, sensor = data.ranges, data.sensor
    found = np.zeros((7, z.size))
    mixture(
        z.ravel(),
        (expected.reading + shift).ravel(),
        (noise.core * expected.sigma).ravel(),
        np.require(expected.p_return.ravel(), requirements="W"),  # numba then compiles a single version
        expected.alternative.ravel(),
        expected.spread.ravel(),
        expected.p_alternative.ravel(),
        (
            float(sensor.range_min),
            float(sensor.range_max),
            max(float(sensor.resolution), SETTINGS.min_resolution),
            float(expected.lattice),
        ),
        (float(noise.tail), float(noise.loss), float(noise.stray), float(expected.stray)),
        (float(expected.short), SETTINGS.lost_at_edge, SETTINGS.unexplained),
        SETTINGS.tail_width,
        found,
    )
    found = found.reshape(7, *z.shape)
    return Responsibilities(
        log_p=found[LOG_P],
        weight=found[WEIGHT],
        residual=found[RESIDUAL],
        core=found[CORE],
        tail=found[TAIL],
        lost=found[LOST],
        stray=found[STRAY],
    )


def fitted_noise(
    data: ScanData,
    expected: ExpectedReadings,
    responsibilities: Responsibilities,
    noise_bounds: NoiseBounds,
) -> BeamNoise:
    """Update the scale and the shares of tail, missing returns and outliers from the responsibilities (M step of EM, in closed form)."""
    is_whole = responsibilities.weight > 0  # not truncated by a limit of the sensor
    count = max(float((responsibilities.core + responsibilities.tail)[is_whole].sum()), 1.0)
    e2 = np.where(is_whole, responsibilities.residual / expected.sigma, 0.0) ** 2
    variance = (
        float((responsibilities.core * e2 + responsibilities.tail * e2 / SETTINGS.tail_width**2).sum())
        / count
    )
    returnable = max(float((expected.p_return * np.isfinite(expected.reading)).sum()), 1.0)
    n = max(float(data.returned.sum()), 1.0)
    return BeamNoise(
        core=float(np.sqrt(variance)),
        tail=float(responsibilities.tail[is_whole].sum()) / count,
        loss=float(responsibilities.lost.sum()) / returnable,
        stray=float(responsibilities.stray.sum()) / n,
    ).within(noise_bounds)


def sample(
    data: ScanData, expected: ExpectedReadings, mu: Floats, noise: BeamNoise, rng: np.random.Generator
) -> Floats:
    """Sample readings (n_scans, n_rays) [m] around `mu` from the mixture of `e_step`; broken readings stay broken.

    A ray next to an edge reads one of the two sides. Readings between the sides, and missing ones there, are not sampled.
    """
    shape, sensor = mu.shape, data.sensor
    other = (rng.random(shape) < expected.p_alternative) & ~np.isnan(expected.alternative)
    mu = np.where(other, expected.alternative, mu)
    wide = np.where(rng.random(shape) < noise.tail, SETTINGS.tail_width, 1.0)
    sigma = np.where(
        other,
        np.hypot(EDGE_WIDTH * noise.core * expected.sigma, expected.spread),
        wide * noise.core * expected.sigma,
    )
    z = np.where(np.isfinite(mu), mu + rng.normal(size=shape) * sigma, np.inf)
    z = np.where(rng.random(shape) < expected.p_return * (1 - noise.loss), z, np.inf)
    stray = rng.random(shape) < 1 - (1 - noise.stray) * (1 - expected.stray)
    z = np.where(stray, rng.random(shape) * sensor.range_max, z)
    if expected.short > 0:
        short = rng.random(shape) < expected.short
        z = np.where(short, rng.random(shape) * np.where(np.isfinite(mu), mu, sensor.range_max), z)
    z = apply_range_limits(z, sensor, expected.lattice)
    z[np.isnan(data.ranges)] = np.nan
    return z


@inlined_kernel
def _normal_cdf(x: float) -> float:
    """Return the standard normal distribution function at x."""
    return 0.5 * math.erfc(-x / SQRT_2)


@inlined_kernel
def _densities(
    reading: float, e: float, s: float, tail_width: float, lattice: float, cell: float
) -> tuple[float, float]:
    """Return the densities [1/m] of core and tail at a reading with the residual e; 0 for a reading off the lattice."""
    if lattice > 0:
        steps, half, t = reading / lattice, lattice / 2, tail_width * s
        if abs(steps - math.floor(steps + 0.5)) * lattice > cell / 2 + ROUND_OFF:
            return 0.0, 0.0
        core = (_normal_cdf((e + half) / s) - _normal_cdf((e - half) / s)) / cell
        return core, (_normal_cdf((e + half) / t) - _normal_cdf((e - half) / t)) / cell
    u = e / s
    core = math.exp(-0.5 * u * u) / (SQRT_TAU * s)
    u /= tail_width
    return core, math.exp(-0.5 * u * u) / (SQRT_TAU * s * tail_width)


@inlined_kernel
def _density_at_edge(reading: float, expected: float, there: float, s: float, s_there: float) -> float:
    """Return the density [1/m] of a reading at the far side of an edge, or anywhere between its two sides."""
    u = (reading - there) / s_there
    near = math.exp(-0.5 * u * u) / (SQRT_TAU * s_there)
    low, high = min(there, expected), max(there, expected)
    flat = 1 / max(high - low, s) if low < reading < high else 0.0
    return EDGE_NEAR * near + EDGE_BETWEEN * flat


@outer_kernel
def mixture(
    z: Floats,
    mu: Floats,
    sigma: Floats,
    p_return: Floats,
    alternative: Floats,
    spread: Floats,
    p_alternative: Floats,
    limits: tuple[float, float, float, float],
    noise: tuple[float, float, float, float],
    chances: tuple[float, float, float],
    tail_width: float,
    out: Floats,
) -> None:
    """Fill in the log-likelihood and the responsibilities of n readings.

    Parameters
    ----------
    z : (n,) [m] Measured range; inf: missing, -inf: too near, nan: broken.
    mu : (n,) [m] Expected range; inf where no return is possible.
    sigma : (n,) [m] Standard deviation of the core.
    p_return, alternative, spread, p_alternative : (n,) As in `ExpectedReadings`.
    limits : [m] Minimum range, maximum range, resolution, and the step to which effects round readings; 0 without rounding.
    noise : Shares of the tail, of missing returns and of outliers; then the share of outliers that effects add.
    chances : Probabilities of a short reading, of a missing one next to an edge, and of one that no component explains.
    tail_width : Ratio of the standard deviation of the tail to that of the core.
    out : (7, n), zeros at first: LOG_P [nats], WEIGHT [1/m²], RESIDUAL [m], and the posterior probabilities CORE, TAIL, LOST and STRAY
    """
    nearest, farthest, cell, lattice = limits
    share, loss, stray_noise, stray_effect = noise
    short, lost_at_edge, unexplained = chances
    stray = 1 - (1 - stray_effect) * (1 - stray_noise)
    rest = (1 - stray) * (1 - short)
    p_stray = stray / farthest
    for k in range(len(z)):
        reading, expected, s, there, at_edge = z[k], mu[k], sigma[k], alternative[k], p_alternative[k]
        if math.isnan(reading):
            continue
        aimed = math.isfinite(expected)
        has_far_side = at_edge > 0 and math.isfinite(there)
        s_there = math.hypot(EDGE_WIDTH * s, spread[k]) if has_far_side else 1.0
        if math.isfinite(reading):
            p = p_core = p_tail = 0.0
            back = p_return[k] * (1 - loss) * rest  # the density already includes that z is within the limits
            if aimed:
                e = reading - expected
                out[RESIDUAL, k] = e
                core, tail = _densities(reading, e, s, tail_width, lattice, cell)
                own = back * (1 - at_edge)
                p_core, p_tail = own * (1 - share) * core, own * share * tail
                p = p_core + p_tail
            if has_far_side:
                p += back * at_edge * _density_at_edge(reading, expected, there, s, s_there)
            top = min(expected, farthest) if aimed else farthest
            if short > 0 and reading < top:
                p += (1 - stray) * short / max(top, MIN_SHORT_RANGE)
            total = p + p_stray + unexplained / farthest
            out[CORE, k], out[TAIL, k], out[STRAY, k] = p_core / total, p_tail / total, p_stray / total
            if aimed and nearest + CUT * s <= expected <= farthest - CUT * s:
                out[WEIGHT, k] = (out[CORE, k] + out[TAIL, k] / (tail_width * tail_width)) / (s * s)
        else:
            inside = _normal_cdf((farthest - expected) / s) if aimed else 0.0
            inside_there = _normal_cdf((farthest - there) / s_there) if has_far_side else 0.0
            seen = p_return[k] * ((1 - at_edge) * inside + at_edge * inside_there)
            gone = rest * (1 - seen)
            if reading > 0:
                p_lost = (1 - stray) * seen * loss
                p_gone = p_lost + gone + (lost_at_edge if at_edge > 0 else 0.0)
                total = p_gone * (1 - short) + unexplained
                out[LOST, k] = p_lost / total
            else:
                too_near = (1 - at_edge) * _normal_cdf((nearest - expected) / s) if aimed else 0.0
                if inside_there > 0.0:
                    too_near += at_edge * _normal_cdf((nearest - there) / s_there)
                total = rest * too_near + 0.5 * gone + unexplained
        out[LOG_P, k] = math.log(total)
