"""Common parts of the proposers: thresholds, the best run of rays, parts of walls, cut-offs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.sensor import median_step
from sensorgraph.effects.interfaces import Proposal, Residuals
from sensorgraph.effects.places import named_walls, obstacles
from sensorgraph.types import Bools, Floats, Ints


@dataclass(frozen=True, kw_only=True)
class ProposalSettings:
    """Thresholds of a proposal, tuned on the development cases of `benchmarks.hidden_effects`."""

    min_gain: float = 6.0
    """[nats] Minimum expected gain of a candidate."""
    min_rays: int = 8
    """Minimum number of rays for a proposal."""
    min_lost: int = 3
    """Minimum number of missing returns beyond a cut-off, or on a black part."""
    min_share: float = 0.002
    """Minimum share of odd returns, for an effect on single readings."""
    wall_bin: float = 0.1
    """[m] Bin size along a wall."""
    max_walls: int = 4
    """Maximum number of walls, those with most outliers, on which panes and mirrors are searched."""
    max_obstacles: int = 8
    """Maximum number of obstacles, those with most outliers, that are tested for a move or absence."""
    behind_wall: float = 0.1
    """[m] Distance below range_max at which a missing return on a wall counts as odd."""


PROPOSAL = ProposalSettings()
"""The settings in use."""
LOSS_LEFTOVERS = dict.fromkeys(
    ("glass", "mirror", "black_surface", "incidence_dropout", "people", "random_outliers"), 0.03
)
"""Remainders at the rim of effects that lose or bend groups of rays, as shares of their gain."""


def best_run(values: Floats) -> tuple[Ints, Ints, Floats]:
    """Return, for each row of values (n, m), the first and last index of the run with the largest sum, and that sum."""
    n, m = values.shape
    total = np.concatenate([np.zeros((n, 1)), np.cumsum(values, axis=1)], axis=1)
    lowest = np.minimum.accumulate(total[:, :-1], axis=1)
    gain = total[:, 1:] - lowest
    last = gain.argmax(axis=1)
    row = np.arange(n)
    best = gain[row, last]
    before = np.where(np.arange(m)[None] <= last[:, None], total[:, :-1], np.inf)
    first = before.argmin(axis=1)
    return first, last, best


def cut_off(
    residuals: Residuals, name: str, values: Floats, gains: Floats, *, upward: bool
) -> list[Proposal]:
    """Propose the threshold beyond which no ray returns, from the exact profile of the gain over all thresholds.

    Parameters
    ----------
    name : Name of the parameter.
    values : (n_scans, n_rays) Values that are compared with the threshold; nan if it does not apply.
    gains : (n_scans, n_rays) [nats] Gain of the hypothesis that a ray does not return.
    upward : Rays above the threshold are lost; otherwise those below.
    """
    ok = np.isfinite(values)
    if not ok.any():
        return []
    v = values[ok]
    order = np.argsort(-v if upward else v)
    total = np.cumsum(gains[ok][order])
    at = int(total.argmax())
    n_lost = int((residuals.lost | residuals.near)[ok][order][: at + 1].sum())
    if n_lost < PROPOSAL.min_lost:
        return []
    v = v[order]
    beyond = v[at + 1] if at + 1 < len(v) else v[at]
    return [Proposal(values={name: float((v[at] + beyond) / 2)}, gain=float(total[at]))]


def within_range(residuals: Residuals) -> Floats:
    """Return the expected readings [m] within the range of the sensor, nan elsewhere."""
    return np.where(residuals.aimed & (residuals.mu < residuals.sensor.range_max), residuals.mu, np.nan)


def strange_on_walls(residuals: Residuals) -> tuple[Bools, list[int]]:
    """Return which rays hit walls, and the walls with enough long or missing returns, sorted by their number."""
    p = PROPOSAL
    on = (residuals.beams.wall >= 0) & residuals.aimed
    reachable = residuals.mu < residuals.sensor.range_max - p.behind_wall
    odd = on & (residuals.long | (residuals.lost & reachable))
    if odd.sum() < p.min_rays:
        return on, []
    counts = np.bincount(residuals.beams.wall[odd], minlength=len(residuals.walls))
    return on, [int(wall) for wall in np.argsort(-counts)[: p.max_walls] if counts[wall] >= p.min_rays]


def sum_by_wall(walls: Ints, along: Floats, gain: Floats, n_walls: int) -> Floats:
    """Sum gains (n,) by wall and bin along the wall, (n_walls, n_bins)."""
    place = np.clip(np.nan_to_num(along) / PROPOSAL.wall_bin, 0, None).astype(np.intp)
    n_bins = int(place.max(initial=0)) + 1
    table = np.bincount(walls * n_bins + place, gain, n_walls * n_bins).reshape(n_walls, n_bins)
    return np.asarray(table, dtype=np.float64)


def best_part(along: Floats, gain: Floats) -> tuple[float, float, float]:
    """Return start and end [m] of the part of one wall with the largest gain of rays (n,), in bins, and that gain."""
    table = sum_by_wall(np.zeros(len(gain), dtype=np.intp), along, gain, 1)
    first, last, total = best_run(table)
    return first[0] * PROPOSAL.wall_bin, (last[0] + 1) * PROPOSAL.wall_bin, float(total[0])


def sharpen_part(along: Floats, gain: Floats, a: float, b: float) -> tuple[float, float, float]:
    """Return the ends [m] of a part of a wall, refined to the largest gain of the rays (n,), and that gain."""
    slack = 2 * PROPOSAL.wall_bin
    near = np.flatnonzero((along >= a - slack) & (along <= b + slack) & (gain != 0))
    if len(near) == 0:
        return a, b, 0.0
    near = near[np.argsort(along[near])]
    first, last, total = best_run(gain[near][None])
    i, j = int(first[0]), int(last[0])
    place = along[near]
    low = (place[i] + place[i - 1]) / 2 if i > 0 else place[i]
    high = (place[j] + place[j + 1]) / 2 if j + 1 < len(place) else place[j]
    return float(low), float(high), float(total[0])


def on_part_of_wall(residuals: Residuals, wall: int, gain: float, **values: float) -> Proposal:
    """Propose an effect on the part of a wall from `a` to `b` [m], limited to the wall."""
    start, end = residuals.walls[wall]
    length = float(np.hypot(*(end - start)))
    values["b"] = min(values["b"], length)
    values["a"] = max(values["a"], 0.0)
    middle = start + (end - start) * ((values["a"] + values["b"]) / 2 / max(length, 1e-9))
    return Proposal(values=values, gain=gain, place=residuals.arena.names[wall], xy=middle)


def best_first(found: list[Proposal]) -> list[Proposal]:
    """Sort proposals by their gain."""
    return sorted(found, key=lambda proposal: -proposal.gain)


def unchanged_obstacles(residuals: Residuals) -> list[str]:
    """Return the obstacles of the map without an effect in the model."""
    changed = {a.place for a in residuals.model}
    return [name for name in obstacles(residuals.arena) if name not in changed]


def strangest_obstacles(residuals: Residuals, odd: Bools | None = None) -> list[str]:
    """Return the unchanged obstacles with the most odd rays expected to end on them, sorted by their number.

    Parameters
    ----------
    odd : (n_scans, n_rays) Odd rays. None: all outliers.
    """
    odd = residuals.strange if odd is None else odd
    walls = residuals.beams.wall[odd & (residuals.beams.wall >= 0)]
    counts = np.bincount(walls, minlength=len(residuals.walls))
    names = unchanged_obstacles(residuals)
    strange = [int(counts[named_walls(residuals.arena, name)].sum()) for name in names]
    return [names[k] for k in np.argsort(-np.array(strange), kind="stable")[: PROPOSAL.max_obstacles]]


def half_spacing(residuals: Residuals) -> float:
    """Return half the angle [rad] between neighbouring rays."""
    bearings = residuals.sensor.bearings
    return 0.5 * median_step(bearings, 0.02)


def share_of_readings(residuals: Residuals, odd: Bools, nats: float) -> list[Proposal]:
    """Propose the share `p` of odd readings (n_scans, n_rays), each with a gain of `nats`."""
    n = max(int(residuals.returned.sum()), 1)
    count = int(odd.sum())
    if count <= max(PROPOSAL.min_rays, PROPOSAL.min_share * n):
        return []
    return [Proposal(values={"p": count / n}, gain=nats * count)]
