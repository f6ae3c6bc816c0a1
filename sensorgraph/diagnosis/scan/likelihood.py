"""How likely measured readings are under predicted beams: a mixture of core, tail, other side of an edge, short, stray, lost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from sensorgraph.diagnosis.scan.beam_mixture import CORE, LOG_P, LOST, RESIDUAL, STRAY, WEIGHT, mixture
from sensorgraph.diagnosis.scan.beam_mixture import TAIL as OUTER
from sensorgraph.diagnosis.scan.nuisance import TAIL, BeamNoise
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.types import Floats, Ints
from sensorgraph.world.scene import Beams, limited

ROOT = np.sqrt(2 * np.pi)
FLOOR = 1e-5  # chance of a reading that nothing explains
LOST_AT_EDGE = 0.02  # chance that a beam which passes an edge does not come back
FINEST = 1e-4  # [m] cell of a reading whose resolution is not told


@dataclass(frozen=True, kw_only=True, eq=False)
class Edges:
    """Rays that pass so near a corner in depth that a small error of pose or map takes them to the other side."""

    at: tuple[Ints, Ints]
    """Indices (scan, ray) of k rays."""
    other: Floats
    """(k,) [m] what they would read on the other side."""
    chance: Floats
    """(k,) of being there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ExpectedReadings:
    """What each reading is compared with; arrays (n_scans, n_rays)."""

    reading: Floats
    """[m] expected, before nuisances; inf where nothing can be seen."""
    sigma: Floats
    """[m] nominal, with what slanting rays have in addition."""
    p_return: Floats
    alternative: Floats
    """[m] on the other side of an edge; nan where there is none."""
    p_alternative: Floats
    stray: float
    short: float
    lattice: float


def expected_readings(
    beams: Beams, steep: Floats, edges: Edges | None, stray: float, short: float, lattice: float
) -> ExpectedReadings:
    """Collect what the likelihood needs of a cast."""
    shape = beams.reading.shape
    alternative, chance = np.full(shape, np.nan), np.zeros(shape)
    if edges is not None:
        alternative[edges.at] = edges.other
        chance[edges.at] = edges.chance
    if beams.straight is not None:
        chance = np.where(beams.straight, chance, 0.0)
    sigma = np.sqrt(np.square(beams.sigma) + steep**2)
    return ExpectedReadings(
        reading=beams.reading,
        sigma=np.broadcast_to(sigma, shape),
        p_return=np.broadcast_to(np.asarray(beams.p_return, dtype=np.float64), shape),
        alternative=alternative,
        p_alternative=chance,
        stray=stray,
        short=short,
        lattice=lattice,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Responsibilities:
    """Log-likelihood of every reading, and what an update of the parameters needs; arrays (n_scans, n_rays)."""

    log_p: Floats
    """[nats] 0 where the reading is broken."""
    weight: Floats
    """[1/m²] with which the residual counts."""
    residual: Floats
    """[m] measured - expected; 0 where either is not a number."""
    core: Floats
    """Chance that the reading is of the core."""
    tail: Floats
    lost: Floats
    """Chance that it was lost by chance."""
    stray: Floats


def e_step(data: ScanData, expected: ExpectedReadings, shift: Floats, noise: BeamNoise) -> Responsibilities:
    """Judge every reading against `expected.reading + shift`."""
    z, sensor = data.ranges, data.sensor
    found = mixture(
        z.ravel(),
        (expected.reading + shift).ravel(),
        (noise.core * expected.sigma).ravel(),
        expected.p_return.ravel(),
        expected.alternative.ravel(),
        expected.p_alternative.ravel(),
        (float(sensor.range_min), float(sensor.range_max), max(float(sensor.resolution), FINEST)),
        (float(noise.tail), float(noise.loss), float(noise.stray), float(expected.stray)),
        (float(expected.short), LOST_AT_EDGE),
        float(expected.lattice),
        float(TAIL),
        FLOOR,
    ).reshape(7, *z.shape)
    return Responsibilities(
        log_p=found[LOG_P],
        weight=found[WEIGHT],
        residual=found[RESIDUAL],
        core=found[CORE],
        tail=found[OUTER],
        lost=found[LOST],
        stray=found[STRAY],
    )


def plain_e_step(
    data: ScanData, expected: ExpectedReadings, shift: Floats, noise: BeamNoise
) -> Responsibilities:
    """Judge as `e_step` does, in numpy; tests hold the compiled one against it."""
    z, sensor = data.ranges, data.sensor
    returned = data.returned
    mu = expected.reading + shift
    aimed = np.isfinite(mu)
    both = returned & aimed
    e = np.where(both, z - np.where(aimed, mu, 0.0), 0.0)
    e[~both] = 0.0
    sigma = noise.core * expected.sigma
    inside = ndtr((sensor.range_max - np.where(aimed, mu, 1e9)) / sigma)
    p_back = expected.p_return * (1 - noise.loss) * np.where(aimed, inside, 0.0)
    cell = max(sensor.resolution, FINEST)
    core, tail = _density(e, sigma, expected.lattice, cell), _density(e, TAIL * sigma, expected.lattice, cell)
    stray = 1 - (1 - expected.stray) * (1 - noise.stray)
    rest = (1 - stray) * (1 - expected.short)
    own = rest * p_back * (1 - expected.p_alternative)
    if expected.lattice > 0:
        steps = np.where(returned, z, 0.0) / expected.lattice
        off = np.abs(steps - np.round(steps)) * expected.lattice > 0.51 * cell + 1e-9
        own = np.where(off & both, 1e-9, own)
    p_core = own * (1 - noise.tail) * core * both
    p_tail = own * noise.tail * tail * both
    p = p_core + p_tail
    edge = expected.p_alternative > 0
    if edge.any():
        there = np.isfinite(expected.alternative) & edge & returned
        off_there = np.where(there, z - np.where(there, expected.alternative, 0.0), 0.0)
        near = np.exp(-0.5 * (off_there / (2 * sigma)) ** 2) / (2 * ROOT * sigma)
        low = np.minimum(expected.alternative, mu)
        high = np.maximum(expected.alternative, mu)
        with np.errstate(invalid="ignore"):
            between = there & (z > low) & (z < high)
            flat = np.where(between, 1 / np.maximum(high - low, 0.01), 0.0)
        p = p + rest * p_back * expected.p_alternative * (0.9 * near + 0.1 * flat) * there
    if expected.short > 0:
        top = np.minimum(np.where(aimed, mu, sensor.range_max), sensor.range_max)
        p = p + (1 - stray) * expected.short * (returned & (z < top)) / np.maximum(top, 0.05)
    p_stray = stray / sensor.range_max
    p_lost = (1 - stray) * np.where(aimed, expected.p_return * inside * noise.loss, 0.0)
    gone = (1 - stray) * (1 - expected.short) * np.where(aimed, 1 - expected.p_return * inside, 1.0)
    p_gone = p_lost + gone + edge * LOST_AT_EDGE
    if expected.short > 0:
        p_gone = p_gone * (1 - expected.short)
    near_limit = np.where(aimed, ndtr((sensor.range_min - np.where(aimed, mu, 1e9)) / sigma), 0.0)
    total = np.where(
        returned,
        p + p_stray + FLOOR / sensor.range_max,
        np.where(z > 0, p_gone + FLOOR, rest * near_limit + 0.5 * gone + FLOOR),
    )
    broken = np.isnan(z)
    total = np.where(broken, 1.0, total)
    inverse = 1 / total
    core_share = np.where(returned, p_core * inverse, 0.0)
    tail_share = np.where(returned, p_tail * inverse, 0.0)
    weight = (core_share + tail_share / TAIL**2) / sigma**2
    lost = np.where(~returned & ~broken & (z > 0), p_lost * inverse, 0.0)
    return Responsibilities(
        log_p=np.log(total),
        weight=weight,
        residual=e,
        core=core_share,
        tail=tail_share,
        lost=lost,
        stray=np.where(returned, p_stray * inverse, 0.0),
    )


def _density(e: Floats, sigma: Floats, lattice: float, cell: float) -> Floats:
    """Return the density [1/m] of a residual; on a lattice, the mass of its step over the resolution's cell."""
    if lattice <= 0:
        return np.asarray(np.exp(-0.5 * (e / sigma) ** 2) / (ROOT * sigma))
    half = lattice / 2
    return np.asarray((ndtr((e + half) / sigma) - ndtr((e - half) / sigma)) / cell)


def find_edges(data: ScanData, beams: Beams, walls: Floats) -> Edges | None:
    """Find the rays next to a step in depth, and what they would read beyond it."""
    t = data.tolerances
    ranges, wall = beams.ranges, beams.wall
    differ = wall[:, 1:] != wall[:, :-1]
    scan, left = np.nonzero(differ)
    if len(scan) == 0:
        return None
    bearings = data.sensor.bearings
    gap = np.diff(bearings)[left]
    near_left = ranges[scan, left] <= ranges[scan, left + 1]
    near = np.where(near_left, left, left + 1)
    rows: list[tuple[Ints, Ints, Floats, Floats]] = []
    # where the nearer surface ends, as an angle from the left ray
    edge = _end_angle(beams, walls, scan, left, near, gap)
    r_near = np.maximum(ranges[scan, near], 0.05)
    blur = np.sqrt(t.pose_yaw**2 + t.mount_yaw**2 + (t.pose_xy**2 + t.map**2 + t.mount_xy**2) / r_near**2)
    for ray, other, away in ((left, left + 1, edge), (left + 1, left, gap - edge)):
        chance = np.minimum(ndtr(-away / blur), 0.5)
        beyond = _extended(beams, walls, scan, ray, other)
        own = ranges[scan, ray]
        with np.errstate(invalid="ignore"):
            keep = (
                (chance > 0.002)
                & (np.abs(beyond - own) > 2 * data.sensor.sigma)
                & np.isfinite(own)
                & (beyond > 0)
            )
        rows.append((scan[keep], ray[keep], beyond[keep], chance[keep]))
    return Edges(
        at=(np.concatenate([r[0] for r in rows]), np.concatenate([r[1] for r in rows])),
        other=np.concatenate([r[2] for r in rows]),
        chance=np.concatenate([r[3] for r in rows]),
    )


def _end_angle(beams: Beams, walls: Floats, scan: Ints, left: Ints, near: Ints, gap: Floats) -> Floats:
    """Return the angle [rad] from the left ray to the end of the nearer wall; half the gap where it has none there."""
    index = beams.wall[scan, near]
    middle = gap / 2
    if len(walls) == 0:
        return np.asarray(middle)
    known = index >= 0
    ux, uy = beams.ux[scan, left], beams.uy[scan, left]
    ox = np.broadcast_to(beams.ox, beams.ux.shape)[scan, left]
    oy = np.broadcast_to(beams.oy, beams.ux.shape)[scan, left]
    best = np.asarray(middle).copy()
    for end in (0, 1):
        corner = walls[np.where(known, index, 0), end]
        x, y = corner[:, 0] - ox, corner[:, 1] - oy
        angle = np.arctan2(ux * y - uy * x, ux * x + uy * y)
        fits = known & (angle >= -1e-3) & (angle <= gap + 1e-3)
        best = np.where(fits, np.clip(angle, 0.0, gap), best)
    return best


def _extended(beams: Beams, walls: Floats, scan: Ints, ray: Ints, other: Ints) -> Floats:
    """Return where a ray would meet the surface that its neighbour meets, extended; inf where that is nothing."""
    index = beams.wall[scan, other]
    fallback = beams.ranges[scan, other]
    if len(walls) == 0:
        return np.asarray(fallback)
    a = walls[np.where(index >= 0, index, 0), 0]
    nx, ny = beams.nx[scan, other], beams.ny[scan, other]
    ox = np.broadcast_to(beams.ox, beams.ux.shape)[scan, ray]
    oy = np.broadcast_to(beams.oy, beams.ux.shape)[scan, ray]
    across = beams.ux[scan, ray] * nx + beams.uy[scan, ray] * ny
    with np.errstate(divide="ignore", invalid="ignore"):
        r = ((a[:, 0] - ox) * nx + (a[:, 1] - oy) * ny) / across
    usable = (index >= 0) & (across < -0.02)
    return np.asarray(np.where(usable, r, fallback))


def sample(
    data: ScanData, expected: ExpectedReadings, mu: Floats, noise: BeamNoise, rng: np.random.Generator
) -> Floats:
    """Draw readings (n_scans, n_rays) [m] around `mu` from the mixture that `e_step` judges by; broken ones stay broken."""
    shape, sensor = mu.shape, data.sensor
    other = (rng.random(shape) < expected.p_alternative) & np.isfinite(expected.alternative)
    mu = np.where(other, expected.alternative, mu)
    wide = np.where(rng.random(shape) < noise.tail, TAIL, 1.0)
    z = np.where(np.isfinite(mu), mu + rng.normal(size=shape) * wide * noise.core * expected.sigma, np.inf)
    z = np.where(rng.random(shape) < expected.p_return * (1 - noise.loss), z, np.inf)
    stray = rng.random(shape) < 1 - (1 - noise.stray) * (1 - expected.stray)
    z = np.where(stray, rng.random(shape) * sensor.range_max, z)
    if expected.short > 0:
        short = rng.random(shape) < expected.short
        z = np.where(short, rng.random(shape) * np.where(np.isfinite(mu), mu, sensor.range_max), z)
    z = limited(z, sensor, expected.lattice)
    z[np.isnan(data.ranges)] = np.nan
    return z
