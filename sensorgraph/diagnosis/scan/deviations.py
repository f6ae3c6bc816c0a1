"""Deviations between measured and simulated readings that exceed chance.

Residuals are summed over the bins of a dozen partitions (wall, bearing, range, incidence, time, motion, place):

    z = Σ s / sqrt(Σ_blocks (s_block - mean n_block)²).

The z of a bin is clustered. Its variance is estimated from the scatter between blocks of about one second, so that
neighbouring rays and scans, which share their errors, count once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.result import Deviation
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.beams import Beams

MIN_SCATTER = {
    "bias": 1.0,
    "spread": float(np.sqrt(2)),
    "outliers": float(np.sqrt(SCAN.noise.stray[1] * (1 - SCAN.noise.stray[1]))),
    "misses": float(np.sqrt(SCAN.noise.loss[1] * (1 - SCAN.noise.loss[1]))),
}
"""Kind of deviation -> minimum scatter of the score of one ray: that of a standard normal variable, of its square, and of
events with the largest usual probability."""
N_BINS = 24
"""Number of bins of a partition by one quantity."""
OF_WALLS = ("wall", "hit place")
"""Partitions whose bins also show the shape of walls."""
Scores = dict[str, tuple[Floats, Bools]]
"""Kind of deviation -> deviation of every ray from the model, with the expected value 0, and whether it has one; else 0."""


def scores(view: FitResiduals) -> Scores:
    """Score every ray: clipped residual, its square, whether it is an outlier, whether its return is missing."""
    settings, likelihood = SCAN.goodness_of_fit, SCAN.likelihood
    responsibilities, expected = view.fitted.solution.responsibilities, view.fitted.cast.expected
    is_stray = responsibilities.stray > 0.5
    off_edge = expected.p_alternative < likelihood.min_edge_chance
    clear = view.returned & view.aimed & off_edge & view.fitted.cast.jacobian.valid
    clear &= responsibilities.weight > 0  # the mean of readings next to a limit of the sensor is biased
    if view.beams.straight is not None:
        bent = view.returned & view.aimed & ~view.beams.straight
        clear = clear | (bent & (responsibilities.stray < 0.5))
    u = np.where(clear, responsibilities.residual / view.sigma, 0.0)
    explained = clear & (responsibilities.stray < 0.5)
    if expected.short > 0:
        explained &= responsibilities.core + responsibilities.tail > 0.5
    clipped = np.clip(u, -settings.clip, settings.clip)
    rounded = expected.lattice**2 / 12 / np.square(view.sigma)
    spread = np.where(explained, clipped**2 - rounded, 0.0)
    # the part that all bins share is the noise level, not a property of a place, time or bearing
    common = float(spread.sum() / max(explained.sum(), 1))
    spread -= explained * common
    returned = view.returned & view.aimed & off_edge
    p_stray = view.noise.stray + expected.stray + expected.short
    due = view.aimed & off_edge & ~np.isnan(view.z)
    due &= view.range_max - np.where(view.aimed, view.mu, np.inf) >= settings.clip * view.sigma
    p_lost = 1 - expected.p_return * (1 - view.noise.loss)
    outline = _outlines(view)
    if outline is not None:
        explained, returned, due = explained & ~outline, returned & ~outline, due & ~outline
    return {
        "bias": (np.where(explained, clipped, 0.0), explained),
        "spread": (spread, explained),
        "outliers": (np.where(returned, is_stray - p_stray, 0.0), returned),
        "misses": (np.where(due, view.lost - p_lost, 0.0), due),
    }


def _outlines(view: FitResiduals) -> Bools | None:
    """Return which rays pass the outline of a free-standing unmapped obstacle, where a disc is a poor model."""
    aside = SCAN.goodness_of_fit.outline_distance
    arena, beams, out = view.data.arena, view.beams, None
    for a in view.fitted.model:
        if a.effect.place != "spot":
            continue
        place, r = np.array([[a["x"], a["y"]]]), a["r"]
        if not arena.contains(place)[0] or view.data.barriers.distances(place)[0] < r + aside:
            continue
        ahead, beside = beams.towards(place[0, 0], place[0, 1])
        near = (ahead > 0) & (np.abs(beside) < r + max(r, aside))
        out = near if out is None else out | near
    return out


def deviations(view: FitResiduals, parts: Sequence[Partition] | None = None) -> list[Deviation]:
    """Return the bins whose z exceeds `min_z`, largest first.

    For spreads and shares only positive deviations count.

    Parameters
    ----------
    parts : Partitions to test; None for all.
    """
    score = scores(view)
    blocks = ((view.data.stamps - view.data.begin) / SCAN.block).astype(np.intp)
    blocks -= blocks.min(initial=0)
    found = [
        deviation
        for part in (partitions(view) if parts is None else parts)
        for deviation in _in_partition(view, part, score, blocks)
    ]
    return sorted(found, key=lambda d: -abs(d.z))


def _in_partition(view: FitResiduals, part: Partition, score: Scores, blocks: Ints) -> list[Deviation]:
    """Return the deviating bins of one partition; `blocks` (n_scans,) is the block index of each scan."""
    settings, sigma = SCAN.goodness_of_fit, view.data.sensor.sigma
    inside = part.index >= 0
    occurs = np.bincount(part.index[inside], minlength=part.count) > 0
    number = np.cumsum(occurs) - 1  # most cells of a building are empty
    key = blocks[:, None] * int(occurs.sum()) + number[part.index]
    n_pairs = (int(blocks.max(initial=0)) + 1) * int(occurs.sum())
    pair, bins = key[inside], np.tile(np.flatnonzero(occurs), n_pairs // max(int(occurs.sum()), 1))

    def by_block(values: Floats | Bools) -> Floats:
        return np.asarray(np.bincount(pair, values[inside], n_pairs), dtype=np.float64)

    def by_bin(values: Floats | Bools) -> Floats:
        return np.asarray(np.bincount(bins, values, part.count), dtype=np.float64)

    grain = np.zeros(part.count)
    if view.data.grain > 0 and part.name in OF_WALLS:
        lengthened = view.data.grain / np.maximum(np.cos(view.incidence), SCAN.nuisance.min_cosine)
        grain = by_bin(by_block(np.nan_to_num(lengthened))) / np.maximum(by_bin(by_block(inside)), 1)
    found, counts = [], dict[int, Floats]()
    for family, (value, counted) in score.items():
        if id(counted) not in counts:
            counts[id(counted)] = by_block(counted)
        n, s = counts[id(counted)], by_block(value)
        total, rays = by_bin(s), by_bin(n)
        mean = total / np.maximum(rays, 1)
        scatter = np.sqrt(by_bin((s - mean[bins] * n) ** 2) + 1e-12)
        min_scatter = MIN_SCATTER[family] * np.sqrt(rays)
        z = total / np.maximum(np.maximum(scatter, min_scatter), 1e-9)
        enough = (rays >= settings.min_rays) & (by_bin(n > 0) >= settings.min_blocks)
        is_strong = (np.abs(z) if family == "bias" else z) > settings.min_z
        unit = sigma if family == "bias" else 1.0
        least = np.zeros(part.count)  # of deviations that the map may cause, in units of the scores
        if family in ("bias", "spread"):
            # a wall is off by half a pixel, and the borders of its cells deviate from it by a whole one
            least = grain / sigma if family == "bias" else (2 * grain / sigma) ** 2
        for k in np.flatnonzero(enough & is_strong & (np.abs(mean) > least)):
            found.append(
                Deviation(
                    family=family,
                    partition=part.name,
                    label=part.label(int(k)),
                    z=float(z[k]),
                    size=float(mean[k] * unit),
                    n_rays=int(rays[k]),
                    xy=part.place(int(k)),
                )
            )
    return found


def largest_z(found: Sequence[Deviation]) -> dict[str, float]:
    """Return the largest |z| per kind of deviation."""
    out = dict.fromkeys(MIN_SCATTER, 0.0)
    for deviation in found:
        out[deviation.family] = max(out[deviation.family], abs(deviation.z))
    return out


@dataclass(frozen=True, kw_only=True)
class Dispersion:
    """Difference between scans, relative to the scatter of their rays."""

    ratio: float = 1.0
    """Ratio of the variance between the mean squares of scans to the variance that their rays explain; expected 1."""
    excess: float = 0.0
    """Standard deviation of the scans' mean squares in excess of that, relative to the squared noise."""


def dispersion(view: FitResiduals) -> Dispersion:
    """Return by how much the scans differ from each other in excess of the scatter of their rays."""
    value, counted = scores(view)["spread"]
    n = counted.sum(axis=1)
    some = n > SCAN.goodness_of_fit.min_rays / 2
    if some.sum() < SCAN.goodness_of_fit.min_rays:
        return Dispersion()
    mean = value.sum(axis=1)[some] / n[some]
    within = float(value[counted].var())
    within_expected = within * float((1 / n[some]).mean())
    between = float(np.var(mean))
    return Dispersion(
        ratio=between / max(within_expected, 1e-12), excess=max(between - within_expected, 0.0) ** 0.5
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Partition:
    """One partition of the rays into bins."""

    name: str
    """As in report.json."""
    index: Ints
    """(n_scans, n_rays) Bin index, -1 for none."""
    count: int
    """Number of bins."""
    label: Callable[[int], str]
    """Readable label of a bin."""
    place: Callable[[int], tuple[float, float] | None]
    """Position of a bin [m, map]; None without a position."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Covariate:
    """A quantity that residuals may depend on."""

    name: str
    values: Floats
    """(n_scans, n_rays); nan for none."""
    edges: Floats
    """(k + 1,) Edges of its bins; the outer bins are open."""
    unit: str
    """Of labels."""
    scale: float
    """Factor from SI units to this unit."""


def covariates(data: ScanData, beams: Beams) -> list[Covariate]:
    """Return the quantities that residuals may depend on, for the cast of a fit."""
    hit, shape = np.isfinite(beams.ranges), data.ranges.shape
    stamps = np.maximum(data.stamps, data.stamps[0] + 1e-3 * np.arange(data.n_scans))
    degree, bearings = 180 / np.pi, data.sensor.bearings

    def of(name: str, values: Floats, span: tuple[float, float], unit: str, scale: float = 1.0) -> Covariate:
        edges = np.linspace(*span, min(N_BINS, values.size) + 1)
        values = np.broadcast_to(values, shape)
        return Covariate(name=name, values=values, edges=edges, unit=unit, scale=scale)

    turning = data.twists[:, 2:]
    out = [
        of("bearing", bearings, (float(bearings[0]), float(bearings[-1])), "degrees", degree),
        of("range", np.where(hit, beams.ranges, np.nan), (0.0, data.sensor.range_max), "m"),
        of("incidence", np.where(hit, beams.incidence, np.nan), (0.0, np.pi / 2), "degrees", degree),
        of("time", (data.stamps - data.begin)[:, None], (0.0, data.span), "s"),
        of("omega", turning, _span(turning), "rad/s"),
        of("speed", data.speed[:, None], _span(data.speed), "m/s"),
        of("direction in map", np.arctan2(beams.uy, beams.ux), (-np.pi, np.pi), "degrees", degree),
    ]
    if data.n_scans > 4:
        acceleration = np.gradient(data.speed, stamps)
        out.append(of("acceleration", acceleration[:, None], _span(acceleration), "m/s²"))
    return out


def partitions(view: FitResiduals) -> list[Partition]:
    """Return all partitions of the rays."""
    data, beams, bounds = view.data, view.beams, view.data.arena.bounds
    hit = np.isfinite(beams.ranges)
    reach = np.where(hit, beams.ranges, 0.0)
    x, y = (np.broadcast_to(data.poses[:, k, None], hit.shape) for k in (0, 1))
    return [
        _by_wall(view),
        *(_binned(one) for one in covariates(data, beams)),
        _by_cell("hit place", beams.ox + reach * beams.ux, beams.oy + reach * beams.uy, hit, bounds),
        _by_cell("robot place", x, y, np.ones(hit.shape, dtype=np.bool_), bounds),
    ]


def _span(rate: Floats) -> tuple[float, float]:
    """Return limits of a rate (n_scans,) that are symmetric about 0 and contain nearly all of it, with one digit."""
    most = float(f"{np.quantile(np.abs(rate), 0.98):.0e}") or 1.0
    return -most, most


def _binned(one: Covariate) -> Partition:
    """Sort rays by a quantity."""
    edges, count = one.edges, len(one.edges) - 1
    index = np.clip(np.searchsorted(edges, one.values, side="right") - 1, 0, count - 1)
    return Partition(
        name=one.name,
        index=np.where(np.isfinite(one.values), index, -1),
        count=count,
        label=lambda k: f"{edges[k] * one.scale:.3g} to {edges[k + 1] * one.scale:.3g} {one.unit}",
        place=lambda k: None,
    )


def _by_wall(view: FitResiduals) -> Partition:
    arena, beams = view.data.arena, view.beams
    return Partition(
        name="wall",
        index=np.where(np.isfinite(beams.ranges) & (beams.wall >= 0), beams.wall, -1),
        count=max(len(view.fitted.cast.scene.walls), 1),
        label=lambda k: arena.names[k],
        place=lambda k: _point(arena.walls[k].mean(axis=0)),
    )


def _by_cell(
    name: str, x: Floats, y: Floats, ok: Bools, bounds: tuple[float, float, float, float]
) -> Partition:
    """Sort rays by the square cell of a point (n_scans, n_rays) [m, map]."""
    size = SCAN.goodness_of_fit.cell
    x0, y0, x1, y1 = bounds
    nx, ny = int((x1 - x0) / size) + 2, int((y1 - y0) / size) + 2
    i, j = np.round((x - x0) / size), np.round((y - y0) / size)
    inside = ok & (i >= 0) & (i < nx) & (j >= 0) & (j < ny)

    def centre(k: int) -> tuple[float, float]:
        return x0 + k // ny * size, y0 + k % ny * size

    return Partition(
        name=name,
        index=np.where(inside, i * ny + j, -1).astype(np.intp),
        count=nx * ny,
        label=lambda k: f"around ({centre(k)[0]:.2f}, {centre(k)[1]:.2f}) m",
        place=centre,
    )


def _point(xy: Floats) -> tuple[float, float]:
    return float(xy[0]), float(xy[1])
