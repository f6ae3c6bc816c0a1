"""Deviations between measured and simulated readings that exceed chance.

Residuals are summed over the bins of a dozen partitions (wall, bearing, range, …):

    z = Σ s / sqrt(Σ_blocks (s_block - mean n_block)²).

The z of a bin is clustered. Its variance is estimated from the scatter between blocks of about one second, so that
neighbouring rays and scans, which share their errors, count once.

Partition the rays of a run into bins: by wall, bearing, range, incidence, time, motion and place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from sensorgraph.diagnosis.result import Deviation
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Bools, Floats, Ints

MIN_SCATTER = {
    "bias": 1.0,
    "spread": float(np.sqrt(2)),
    "outliers": float(np.sqrt(SCAN.noise.stray[1] * (1 - SCAN.noise.stray[1]))),
    "misses": float(np.sqrt(SCAN.noise.loss[1] * (1 - SCAN.noise.loss[1]))),
}
"""Kind of deviation -> minimum scatter of the score of one ray: that of a standard normal variable, of its square, and of
events with the largest usual probability."""
MAX_BINS_PER_KEY = 4
"""Maximum ratio of bins to keys for counting; above it the keys are sorted, because a large building would fill the memory."""
SPEED_EDGES = np.array([-2, -0.25, -0.1, -0.02, 0.02, 0.1, 0.2, 0.3, 0.4, 2])  # [m/s]
TURN_RATE_EDGES = np.array([-3, -0.8, -0.5, -0.25, -0.08, 0.08, 0.25, 0.5, 0.8, 3])  # [rad/s]
ACCELERATION_EDGES = np.array([-5, -0.3, -0.15, -0.05, 0.05, 0.15, 0.3, 5])  # [m/s²]
INCIDENCE_EDGES = np.radians(np.arange(0, 91, 7.5))  # [rad]
N_BEARINGS, N_TIMES = 24, 20
OF_WALLS = ("wall", "hit place")
"""Partitions whose bins also show the shape of walls."""
MARGIN = 0.1  # [m] of the raster beyond the arena


@dataclass(frozen=True, kw_only=True, eq=False)
class Scores:
    """Deviation of every ray from the model, by kind; arrays (n_scans, n_rays)."""

    values: dict[str, Floats]
    """Scores with the expected value 0."""
    counted: dict[str, Bools]
    """Whether a ray has a score; elsewhere the score is 0."""


def scores(view: FitResiduals) -> Scores:
    """Score every ray: clipped residual, its square, whether it is an outlier, whether its return is missing."""
    settings, likelihood = SCAN.goodness_of_fit, SCAN.likelihood
    responsibilities, expected = view.fitted.solution.responsibilities, view.fitted.cast.expected
    is_stray = responsibilities.stray > likelihood.stray_responsibility
    off_edge = expected.p_alternative < likelihood.min_edge_chance
    clear = view.returned & view.aimed & off_edge & view.fitted.cast.jacobian.valid
    clear &= responsibilities.weight > 0  # the mean of readings next to a limit of the sensor is biased
    if view.beams.straight is not None:
        bent = view.returned & view.aimed & ~view.beams.straight
        clear = clear | (bent & (responsibilities.stray < likelihood.stray_responsibility))
    u = np.where(clear, responsibilities.residual / view.sigma, 0.0)
    explained = clear & (responsibilities.stray < likelihood.stray_responsibility)
    if expected.short > 0:
        explained &= responsibilities.core + responsibilities.tail > 0.5
    clipped = np.clip(u, -settings.clip, settings.clip)
    tail = view.noise.tail
    lattice_variance = expected.lattice**2 / 12 if expected.lattice > 0 else 0.0
    expected_square = (
        (1 - tail) * clipped_variance(1.0, settings.clip)
        + tail * clipped_variance(likelihood.tail_width, settings.clip)
        + lattice_variance / np.square(view.sigma)
    )
    spread = np.where(explained, clipped**2 - expected_square, 0.0)
    # the part that all bins share is the noise level, not a property of a place, time or bearing
    common = float(spread.sum() / max(explained.sum(), 1))
    spread -= explained * common
    returned = view.returned & view.aimed & off_edge
    p_stray = view.noise.stray + expected.stray + expected.short
    due = view.aimed & off_edge & ~np.isnan(view.z)
    inside = np.clip(
        (view.range_max - np.where(view.aimed, view.mu, 0.0)) / (settings.clip * view.sigma),
        0.0,
        1.0,
    )
    due = due & (inside >= 1.0)
    p_lost = 1 - expected.p_return * (1 - view.noise.loss)
    outline = _outlines(view)
    if outline is not None:
        explained, returned, due = explained & ~outline, returned & ~outline, due & ~outline
    return Scores(
        values={
            "bias": np.where(explained, clipped, 0.0),
            "spread": np.where(explained, spread, 0.0),
            "outliers": np.where(returned, is_stray - p_stray, 0.0),
            "misses": np.where(due, view.lost - p_lost, 0.0),
        },
        counted={"bias": explained, "spread": explained, "outliers": returned, "misses": due},
    )


def clipped_variance(sigma: float, limit: float) -> float:
    """Return the mean square of a normal variable with the standard deviation `sigma`, clipped at ±`limit`."""
    a = limit / sigma
    inside = float(erf(a / np.sqrt(2)))
    density = float(np.exp(-0.5 * a**2) / np.sqrt(2 * np.pi))
    return sigma**2 * (inside - 2 * a * density) + limit**2 * (1 - inside)


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
    pairs, pair = numbered((blocks[:, None] * part.count + part.index)[inside])
    bins = pairs % part.count  # of each pair (block, bin)

    def by_block(values: Floats | Bools) -> Floats:
        return np.asarray(np.bincount(pair, values[inside], len(pairs)), dtype=np.float64)

    def by_bin(values: Floats | Bools) -> Floats:
        return np.asarray(np.bincount(bins, values, part.count), dtype=np.float64)

    grain = np.zeros(part.count)
    if view.data.grain > 0 and part.name in OF_WALLS:
        lengthened = view.data.grain / np.maximum(np.cos(view.incidence), SCAN.nuisance.min_cosine)
        grain = by_bin(by_block(np.nan_to_num(lengthened))) / np.maximum(by_bin(by_block(inside)), 1)
    found, counts = [], dict[int, Floats]()
    for family, value in score.values.items():
        counted = score.counted[family]
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


def numbered(keys: Ints) -> tuple[Ints, Ints]:
    """Return the keys (n,) that occur, ascending, and the position of each key among them.

    Equivalent to `np.unique` with `return_inverse`, but usually without sorting. A building has thousands of bins, each
    met in a few blocks, so only the pairs that occur are summed.
    """
    if not len(keys) or keys.max() > MAX_BINS_PER_KEY * len(keys):
        found = np.unique(keys, return_inverse=True)
        return found[0], found[1]
    occurs = np.bincount(keys) > 0
    return np.flatnonzero(occurs), (np.cumsum(occurs) - 1)[keys]


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
    score = scores(view)
    value, counted = score.values["spread"], score.counted["spread"]
    n = counted.sum(axis=1)
    some = n > SCAN.goodness_of_fit.min_readings
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


def partitions(view: FitResiduals) -> list[Partition]:
    """Return all partitions of the rays."""
    data, beams, arena = view.data, view.beams, view.data.arena
    shape = view.z.shape
    hit = np.isfinite(beams.ranges)
    bearings, range_max = data.sensor.bearings, data.sensor.range_max
    t = (data.stamps - data.begin)[:, None]

    def binned(name: str, value: Floats, edges: Floats, unit: str, scale: float = 1.0) -> Partition:
        return _binned(name, np.broadcast_to(value, shape), edges, unit, scale)

    degree = 180 / np.pi
    bearing_edges = np.linspace(bearings[0] - 1e-9, bearings[-1] + 1e-9, min(N_BEARINGS, len(bearings)) + 1)
    range_edges = np.concatenate([np.arange(0, 4, 0.4), np.arange(4, range_max + 1, 0.8)])
    circle = np.linspace(-np.pi, np.pi + 1e-9, N_BEARINGS + 1)
    reach = np.where(hit, beams.ranges, 0.0)
    out = [
        _by_wall(view),
        binned("bearing", bearings, bearing_edges, "degrees", degree),
        binned("range", np.where(hit, beams.ranges, np.nan), range_edges, "m"),
        binned("incidence", np.where(hit, view.incidence, np.nan), INCIDENCE_EDGES, "degrees", degree),
        binned("time", t, np.linspace(0, data.span + 1e-9, N_TIMES + 1), "s"),
        binned("omega", data.twists[:, 2:], TURN_RATE_EDGES, "rad/s"),
        binned("speed", data.speed[:, None], SPEED_EDGES, "m/s"),
        binned("direction in map", np.arctan2(beams.uy, beams.ux), circle, "degrees", degree),
        _by_cell("hit place", beams.ox + reach * beams.ux, beams.oy + reach * beams.uy, hit, arena.bounds),
        _by_cell(
            "robot place",
            np.broadcast_to(data.poses[:, :1], shape),
            np.broadcast_to(data.poses[:, 1:2], shape),
            np.ones(shape, dtype=np.bool_),
            arena.bounds,
        ),
    ]
    if data.n_scans > 4:
        stamps = np.maximum(data.stamps, data.stamps[0] + 1e-3 * np.arange(data.n_scans))
        acceleration = np.gradient(data.speed, stamps)
        out.append(binned("acceleration", acceleration[:, None], ACCELERATION_EDGES, "m/s²"))
    return out


def _binned(name: str, value: Floats, edges: Floats, unit: str, scale: float) -> Partition:
    """Sort rays by a value (n_scans, n_rays); labels show the value times `scale`, in `unit`."""
    index = np.searchsorted(edges, value, side="right") - 1
    ok = (index >= 0) & (index < len(edges) - 1) & np.isfinite(value)
    return Partition(
        name=name,
        index=np.where(ok, index, -1),
        count=len(edges) - 1,
        label=lambda k: f"{edges[k] * scale:.3g} to {edges[k + 1] * scale:.3g} {unit}",
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
    nx, ny = int((x1 - x0 + 2 * MARGIN) / size) + 1, int((y1 - y0 + 2 * MARGIN) / size) + 1
    i, j = np.floor((x - x0 + MARGIN) / size), np.floor((y - y0 + MARGIN) / size)
    inside = ok & (i >= 0) & (i < nx) & (j >= 0) & (j < ny)

    def centre(k: int) -> tuple[float, float]:
        return (x0 - MARGIN + (k // ny + 0.5) * size, y0 - MARGIN + (k % ny + 0.5) * size)

    return Partition(
        name=name,
        index=np.where(inside, i * ny + j, -1).astype(np.intp),
        count=nx * ny,
        label=lambda k: f"around ({centre(k)[0]:.2f}, {centre(k)[1]:.2f}) m",
        place=centre,
    )


def _point(xy: Floats) -> tuple[float, float]:
    return float(xy[0]), float(xy[1])
