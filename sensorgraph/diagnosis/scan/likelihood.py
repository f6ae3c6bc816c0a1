"""Likelihood of measured readings given the expected ones: the beam mixture, and samples from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.scan.beam_mixture import (
    CORE,
    EDGE_WIDTH,
    LOG_P,
    LOST,
    RESIDUAL,
    STRAY,
    TAIL,
    WEIGHT,
    mixture,
)
from sensorgraph.diagnosis.scan.depth_edges import Edges
from sensorgraph.diagnosis.scan.nuisance import BeamNoise
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Floats
from sensorgraph.world.beams import Beams
from sensorgraph.world.scene import apply_range_limits

SETTINGS = SCAN.likelihood


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
    found = mixture(
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
        ),
        (float(noise.tail), float(noise.loss), float(noise.stray), float(expected.stray)),
        (float(expected.short), SETTINGS.lost_at_edge),
        float(expected.lattice),
        SETTINGS.tail_width,
        SETTINGS.unexplained,
    ).reshape(7, *z.shape)
    return Responsibilities(
        log_p=found[LOG_P],
        weight=found[WEIGHT],
        residual=found[RESIDUAL],
        core=found[CORE],
        tail=found[TAIL],
        lost=found[LOST],
        stray=found[STRAY],
    )


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
