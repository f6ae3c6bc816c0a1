"""The kernels of the scan channel in plain numpy, for tests that compare the two."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from planners.types import SAME_PLACE
from sensorgraph.diagnosis.scan.likelihood import (
    CUT,
    EDGE_BETWEEN,
    EDGE_NEAR,
    EDGE_WIDTH,
    MIN_SHORT_RANGE,
    ROUND_OFF,
    SQRT_TAU,
    ExpectedReadings,
    Responsibilities,
)
from sensorgraph.diagnosis.scan.nuisance import BeamNoise
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Floats, Ints
from sensorgraph.world.wall_grid import CORNER

SETTINGS = SCAN.likelihood


def plain_e_step(
    data: ScanData, expected: ExpectedReadings, shift: Floats, noise: BeamNoise
) -> Responsibilities:
    """Return the same as `e_step`, computed in numpy; tests compare the compiled kernel with it."""
    z, sensor = data.ranges, data.sensor
    returned = data.returned
    mu = expected.reading + shift
    aimed = np.isfinite(mu)
    both = returned & aimed
    e = np.where(both, z - np.where(aimed, mu, 0.0), 0.0)
    e[~both] = 0.0
    sigma = noise.core * expected.sigma
    p_back = expected.p_return * (1 - noise.loss)  # the density already includes that z is within the limits
    cell = max(sensor.resolution, SETTINGS.min_resolution)
    core, tail = (
        _density(e, sigma, expected.lattice, cell),
        _density(e, SETTINGS.tail_width * sigma, expected.lattice, cell),
    )
    stray = 1 - (1 - expected.stray) * (1 - noise.stray)
    rest = (1 - stray) * (1 - expected.short)
    own = rest * p_back * (1 - expected.p_alternative)
    if expected.lattice > 0:
        steps = np.where(returned, z, 0.0) / expected.lattice
        off = np.abs(steps - np.round(steps)) * expected.lattice > cell / 2 + ROUND_OFF
        own = np.where(off & both, 0.0, own)
    p_core = own * (1 - noise.tail) * core * both
    p_tail = own * noise.tail * tail * both
    p = p_core + p_tail
    if (expected.p_alternative > 0).any():
        there = np.isfinite(expected.alternative) & (expected.p_alternative > 0) & returned
        s_there = np.hypot(EDGE_WIDTH * sigma, expected.spread)
        off_there = np.where(there, z - np.where(there, expected.alternative, 0.0), 0.0)
        near = np.exp(-0.5 * (off_there / s_there) ** 2) / (SQRT_TAU * s_there)
        low = np.minimum(expected.alternative, mu)
        high = np.maximum(expected.alternative, mu)
        with np.errstate(invalid="ignore"):
            between = there & (z > low) & (z < high)
            flat = np.where(between, 1 / np.maximum(high - low, sigma), 0.0)
        p = p + rest * p_back * expected.p_alternative * (EDGE_NEAR * near + EDGE_BETWEEN * flat) * there
    if expected.short > 0:
        top = np.minimum(np.where(aimed, mu, sensor.range_max), sensor.range_max)
        p = p + (1 - stray) * expected.short * (returned & (z < top)) / np.maximum(top, MIN_SHORT_RANGE)
    p_stray = stray / sensor.range_max
    p_lost, p_gone, p_near = _plain_without_return(data, expected, mu, sigma, noise.loss, stray)
    total = np.where(
        returned,
        p + p_stray + SETTINGS.unexplained / sensor.range_max,
        np.where(z > 0, p_gone, p_near) + SETTINGS.unexplained,
    )
    broken = np.isnan(z)
    total = np.where(broken, 1.0, total)
    inverse = 1 / total
    core_share = np.where(returned, p_core * inverse, 0.0)
    tail_share = np.where(returned, p_tail * inverse, 0.0)
    weight = (core_share + tail_share / SETTINGS.tail_width**2) / sigma**2
    is_cut = (mu < sensor.range_min + CUT * sigma) | (mu > sensor.range_max - CUT * sigma)
    weight = np.where(is_cut, 0.0, weight)
    lost = np.where(~returned & ~broken & (z > 0), p_lost * inverse, 0.0)
    log_p = np.log(total)
    return Responsibilities(
        log_p=log_p,
        weight=weight,
        residual=e,
        core=core_share,
        tail=tail_share,
        lost=lost,
        stray=np.where(returned, p_stray * inverse, 0.0),
    )


def _plain_without_return(
    data: ScanData, expected: ExpectedReadings, mu: Floats, sigma: Floats, loss: float, stray: float
) -> tuple[Floats, Floats, Floats]:
    """Return the probabilities that a ray is missing by chance, that it does not return, and that it reads too near."""
    sensor, there = data.sensor, expected.p_alternative
    aimed, edge = np.isfinite(mu), there > 0
    beyond = np.where(np.isfinite(expected.alternative) & edge, expected.alternative, np.inf)
    sides = (
        (1 - there, np.where(aimed, mu, np.inf), sigma),
        (there, beyond, np.hypot(EDGE_WIDTH * sigma, expected.spread)),
    )
    seen = expected.p_return * sum(share * ndtr((sensor.range_max - r) / s) for share, r, s in sides)
    near = sum(share * ndtr((sensor.range_min - r) / s) for share, r, s in sides)
    rest = (1 - stray) * (1 - expected.short)
    p_lost = (1 - stray) * seen * loss
    p_gone = (p_lost + rest * (1 - seen) + edge * SETTINGS.lost_at_edge) * (1 - expected.short)
    return p_lost, p_gone, rest * near + 0.5 * rest * (1 - seen)


def _density(e: Floats, sigma: Floats, lattice: float, cell: float) -> Floats:
    """Return the density [1/m] of a residual; on a lattice, the probability of its step divided by the resolution."""
    if lattice <= 0:
        return np.asarray(np.exp(-0.5 * (e / sigma) ** 2) / (SQRT_TAU * sigma))
    half = lattice / 2
    return np.asarray((ndtr((e + half) / sigma) - ndtr((e - half) / sigma)) / cell)


def plain_corner_sums(
    w: Floats,
    rows: Floats,
    ends: Floats,
    wall: Ints,
    y: Floats,
    normals: Floats,
    corners: Ints,
    count: int,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the same as `corner_sums`, with dense columns V for x and y of each corner."""
    columns = np.zeros((len(w), 2 * count, w.shape[1]))  # (n_scans, 2 count, n_rays)
    for e in range(2):
        for d in range(2):
            at = 2 * corners[wall, e] + d
            for column in range(2 * count):
                columns[:, column] += np.where(at == column, ends[e] * normals[wall, d], 0.0)
    weighted = w[:, None] * columns
    return (
        np.einsum("njm,nam->naj", weighted, rows[:, :3]),
        np.einsum("njm,nkm->kj", weighted, rows[:, 3:]),
        np.einsum("njm,nlm->jl", weighted, columns),
        np.einsum("njm,nm->j", weighted, y),
    )


def plain_corners_between_rays(
    corners: Floats,
    walls: Floats,
    rays: tuple[Floats, Floats, Floats, Floats],
    ranges: Floats,
    wall: Ints,
    pairs: tuple[Ints, Ints],
    blur: tuple[float, float],
    least: float,
) -> tuple[Floats, Floats]:
    """Return the same as `corners_between_rays`, in numpy."""
    chance, met = np.zeros(ranges.shape), np.full(ranges.shape, np.nan)
    for right, left in zip(*pairs, strict=True):
        for x, y in corners:
            towards = {ray: _towards(x, y, tuple(part[:, ray] for part in rays)) for ray in (right, left)}
            kept = (towards[right][1] >= 0) & (towards[left][1] <= 0)
            for ray in (right, left):
                to_ends = np.abs(walls[wall[:, ray]] - [x, y]).sum(axis=2)  # (n_scans, 2)
                kept &= ~((to_ends < SAME_PLACE).any(axis=1) & (wall[:, ray] >= 0))
            for ray in (right, left):
                ahead, aside = towards[ray]
                r = np.hypot(ahead, aside)
                ox, oy = rays[0][:, ray], rays[1][:, ray]
                first, _ = nearest_walls_plain(walls, ox, oy, (x - ox) / r, (y - oy) / r)
                met_here = kept & (ahead > 0) & (r < ranges[:, ray]) & (first > r - SAME_PLACE)
                likely = np.minimum(0.5, ndtr(-np.abs(aside) / np.hypot(blur[0] * r, blur[1])))
                better = met_here & (likely >= least) & (likely > chance[:, ray])
                chance[better, ray], met[better, ray] = likely[better], ahead[better]
    return chance, met


def _towards(x: float, y: float, rays: tuple[Floats, ...]) -> tuple[Floats, Floats]:
    """Return the distance of a place ahead of each ray, and to its left [m]."""
    ox, oy, ux, uy = rays
    return ux * (x - ox) + uy * (y - oy), ux * (y - oy) - uy * (x - ox)


def nearest_walls_plain(walls: Floats, ox: Floats, oy: Floats, ux: Floats, uy: Floats) -> tuple[Floats, Ints]:
    """Return the result of `nearest_walls`, computed by numpy without a kernel."""
    a = walls[:, 0]
    d = walls[:, 1] - a
    ax, ay = a[:, 0] - ox[:, None], a[:, 1] - oy[:, None]  # (n, n_walls)
    across = ux[:, None] * d[:, 1] - uy[:, None] * d[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        r = (ax * d[:, 1] - ay * d[:, 0]) / across
        share = (ax * uy[:, None] - ay * ux[:, None]) / across
        # nan (parallel) fails the comparison, too
        r[~((share >= -CORNER) & (share <= 1 + CORNER) & (r >= 0))] = np.inf
    wall = r.argmin(axis=1)
    found = r[np.arange(len(r)), wall]
    return found, np.where(np.isfinite(found), wall, -1)
