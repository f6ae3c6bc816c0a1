"""Kernels of the models and of the sensor model in plain numpy, for tests that compare the two."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr

from sensorgraph.models.cells.evidence import CellEvidence
from sensorgraph.models.cells.grid import N_SECTORS, CellIndices
from sensorgraph.models.cells.ray_march import (
    COS,
    MAX_MERGED,
    MIN_RANGE,
    MIN_SINE,
    MIN_SURVIVAL,
    NO_LINE,
    OFFSET_STEP,
    RATES,
    SIN,
    CellTable,
)
from sensorgraph.models.cells.visibility import (
    _NEIGHBOURS,
    BOX_CELLS,
    BOX_SCALE,
    COUNT_SCALE,
    INTERPOLATED,
    OTHER,
    PRIOR_HITS,
    PRIOR_PASSES,
    SURROUNDING_CELLS,
    neighbour_offsets,
)
from sensorgraph.models.distribution import Mixture
from sensorgraph.models.likelihood import LINE_RADIUS, MIN_DENSITY
from sensorgraph.models.residual_memory import ResidualMemory
from sensorgraph.types import Floats


def traverse_plain(
    x: float, y: float, c: float, s: float, far: float, cell: float
) -> tuple[CellIndices, Floats]:
    """Compute `traverse` by sorting the crossings with all grid lines, in numpy."""
    crossings = [np.array([far])]
    for start, slope in ((x, c), (y, s)):
        if slope != 0.0:
            lines = np.arange(
                np.floor(min(start, start + far * slope) / cell),
                np.ceil(max(start, start + far * slope) / cell) + 1,
            )
            crossings.append((lines * cell - start) / slope)
    ends = np.unique(np.concatenate(crossings))
    ends = ends[(ends > 0) & (ends <= far)]
    middle = (np.concatenate([[0.0], ends[:-1]]) + ends) / 2
    at = np.column_stack([np.floor((x + middle * c) / cell), np.floor((y + middle * s) / cell)])
    return at.astype(np.int64), ends


def stop_candidates_plain(
    x: float, y: float, c: float, s: float, table: CellTable
) -> tuple[Floats, Floats, Floats, Floats, float]:
    """Compute `stop_candidates` in numpy: r, w, sigma, unseen (n,), survival."""
    x0, y0 = np.array([x, y]) - table.low
    at, ends = traverse_plain(x0, y0, c, s, table.reach, table.cell)
    chord = np.diff(ends, prepend=0.0)
    middle = ends - chord / 2
    inside = np.all((at >= 0) & (at < np.array(table.rows.shape)), axis=1)
    row = np.where(inside, table.rows[tuple(np.where(inside[:, None], at, 0).T)], -1)
    b = round(math.atan2(s, c) / (2 * math.pi / N_SECTORS)) % N_SECTORS
    stop = -np.expm1(-np.where(ends > MIN_RANGE, RATES[table.rate[row, b]], 0.0) * chord)
    survival = np.cumprod(1.0 - stop)
    last = int(np.argmax(survival < MIN_SURVIVAL)) + 1 if (survival < MIN_SURVIVAL).any() else len(stop)
    w = stop * np.concatenate([[1.0], survival[:-1]])
    unseen_chord = np.where(table.is_seen[row] == 0, chord, 0.0)
    crossed = np.cumsum(unseen_chord)  # [m] unseen up to the end of each cell
    code, d = table.angle[row, b], table.offset[row, b] * OFFSET_STEP
    to_middle = (at + 0.5) * table.cell - [x0, y0]
    n = np.column_stack([np.append(COS, c)[code], np.append(SIN, s)[code]])  # NO_LINE is the last code
    den = n @ [c, s]
    with np.errstate(divide="ignore"):
        r = ((n * to_middle).sum(axis=1) + d) / den
    known = np.where(
        code == NO_LINE, d != 0, (np.abs(den) > MIN_SINE) & (np.abs(r - middle) < 2 * table.cell)
    )
    r = np.maximum(np.where(known, r, middle), 0.0)
    tangent_2 = 1.0 / np.where(known & (code != NO_LINE), den, 1.0) ** 2 - 1.0
    on_line = np.sqrt(table.sigma**2 + table.across**2 * tangent_2)
    sigma = np.where(known & (code != NO_LINE), on_line, table.rough)
    groups: list[list[int]] = []  # each candidate's cells
    for k in range(last):
        if groups and w[groups[-1]].sum() + w[k] < MAX_MERGED:
            groups[-1].append(k)
        else:
            groups.append([k])
    found = []
    for own in groups:
        total = w[own].sum()
        if total >= MAX_MERGED:
            found.append((r[own[0]], total, sigma[own[0]], crossed[own[0]] - unseen_chord[own[0]]))
        elif total > 0.0:
            mean = np.average(middle[own], weights=w[own])
            spread = math.sqrt(table.rough**2 + np.average((middle[own] - mean) ** 2, weights=w[own]))
            found.append((mean, total, spread, crossed[own[-1]]))
    each = np.array(sorted(found, key=lambda one: one[0])).reshape(-1, 4)
    return each[:, 0], each[:, 1], each[:, 2], each[:, 3], float(survival[last - 1])


def features_plain(evidence: CellEvidence, row: int, b: int) -> Floats:
    """Compute the features of one cell and sector in numpy."""
    near = [(b + d) % N_SECTORS for d in range(-2, 3)]
    far = [k for k in range(N_SECTORS) if k not in near]
    beside = [(b + d) % (N_SECTORS // 2) for d in (-1, 0, 1)]
    place = evidence.window.places()[row]

    def counts(i: int, j: int) -> dict[str, float]:
        at = evidence.window.index[i, j]
        zero = at < 0
        h, i_, q = (
            np.zeros(a.shape[1]) if zero else a[at].astype(np.float64)
            for a in (evidence.hits, evidence.interpolated, evidence.passes)
        )
        own = {"Hs": h[near].sum(), "Is": i_[near].sum(), "Ho": h[far].sum(), "Io": i_[far].sum()}
        own |= {"Qs": q[beside].sum(), "Qo": q.sum() - q[beside].sum(), "Q": q[b % (N_SECTORS // 2)]}
        seen = float(h.any() or i_.any() or q.any())
        return own | {"S": own["Hs"] + own["Is"], "O": own["Ho"] + own["Io"], "seen": seen}

    def log(values: list[float]) -> float:
        return float(np.mean(np.log1p(COUNT_SCALE * np.array(values))))

    steps = neighbour_offsets(b)
    around: dict[tuple[float, float], dict[str, float]]
    around = {key: counts(*(place + steps[k])) for k, key in enumerate(_NEIGHBOURS)}
    own = counts(*place)
    square = [counts(place[0] + i, place[1] + j) for i in range(-2, 3) for j in range(-2, 3)]
    s5, o5 = sum(c["S"] for c in square), sum(c["O"] for c in square)
    out = [log([own[name]]) for name in ("Hs", "Is", "Ho", "Io", "Qs", "Qo", "Q")]
    out += [log([around[0, d][name], around[0, -d][name]]) for name in ("S", "Qs") for d in (1, 2)]
    out += [log([around[d, 0][name]]) for name in ("S", "Qs") for d in (1, 2, 3, -1, -2)]
    out += [log([around[d, 1]["S"], around[d, -1]["S"]]) for d in (1, -1)]
    out += [log([around[d, 0]["O"]]) for d in (1, 2, -1)] + [log([around[0, 1]["O"], around[0, -1]["O"]])]
    out += [
        1.0 - own["seen"],
        float(not any(c["seen"] for c in (own, around[1, 0], around[0, 1], around[0, -1]))),
    ]
    free = own["Qs"] + OTHER * own["Qo"] + PRIOR_PASSES
    hits = own["Hs"] + OTHER * own["Ho"] + PRIOR_HITS
    hits += INTERPOLATED * (own["Is"] + OTHER * own["Io"])
    out += [math.log(hits / free), math.log((s5 + OTHER * o5 + PRIOR_HITS) / free)]

    def box_log(place: CellIndices) -> float:
        if evidence.window.index[tuple(place)] < 0:
            return 0.0
        box = [counts(place[0] + i, place[1] + j)["S"] for i in range(-2, 3) for j in range(-2, 3)]
        return math.log(1 + BOX_SCALE * sum(box))

    ahead, behind, left, right = (box_log(place + steps[k]) for k in range(13, 17))
    out += [box_log(place), ahead, behind, (left + right) / 2, min(left, right)]
    large = [counts(place[0] + i, place[1] + j) for i in range(-5, 6) for j in range(-5, 6)]
    out.append(sum(c["seen"] for c in large) / SURROUNDING_CELLS)
    out += [
        math.log(1 + COUNT_SCALE / BOX_CELLS * sum(c[a] + c[b] for c in large))
        for a, b in (("S", "O"), ("Qs", "Qo"))
    ]
    out.append(1.0 - around[3.3, 0]["seen"])
    return np.array(out)


def log_density_plain(mixture: Mixture, ranges: Floats, range_min: float, stray: float) -> Floats:
    """Compute `log_density` in numpy."""
    z = np.broadcast_to(ranges, mixture.p_no_return.shape)[..., None]
    used = mixture.weights > 0
    with np.errstate(invalid="ignore"):
        x = np.where(used & np.isfinite(z), (z - mixture.means) / mixture.widths, 0.0)
        near = np.where(used, (range_min - mixture.means) / mixture.widths, -np.inf)
    w = mixture.weights
    density = w * np.exp(-0.5 * x**2) / mixture.widths / math.sqrt(2 * math.pi)
    value = density.sum(axis=-1) + stray
    value = np.where(np.isposinf(z[..., 0]), mixture.p_no_return, value)
    value = np.where(np.isneginf(z[..., 0]), (w * ndtr(near)).sum(axis=-1), value)
    return np.where(np.isnan(z[..., 0]), 0.0, np.log(np.maximum(value, MIN_DENSITY)))


def information_share_plain(memory: ResidualMemory, ends: Floats) -> Floats:
    """Compute `information_share` in numpy, of scans whose rays are in the order of their bearings."""
    out = np.ones(len(ends))
    noise = memory.noise.sum(axis=1)
    for i, points in enumerate(ends):
        there = points[np.isfinite(points).all(axis=1)]
        if len(there) < 3:
            continue
        apart = np.hypot(*np.moveaxis(there[:, None] - there[None], -1, 0))
        ratio = np.minimum(apart[..., None] / memory.sizes, 1.0)  # (n, n, n_sizes)
        correlation = np.where(ratio < 1.0, 1.0 - (4.0 - ratio) * ratio / np.pi, 0.0) @ noise
        np.fill_diagonal(correlation, 1.0)
        w = []
        for a, point in enumerate(there):
            near = apart[a] <= LINE_RADIUS
            first, last = a, a
            while first > 0 and near[first - 1]:
                first -= 1
            while last < len(there) - 1 and near[last + 1]:
                last += 1
            if first == last:
                both = [b for b in (a - 1, a + 1) if 0 <= b < len(there)]
                line = [there[min(both, key=lambda b: apart[a, b])]]
            else:
                line = [there[b] for b in range(first, last + 1) if b != a]
            along = np.linalg.svd(np.array(line) - point)[2][0]
            normal = np.array([-along[1], along[0]])
            normal *= -np.sign(normal @ point)
            w.append([*normal, point[0] * normal[1] - point[1] * normal[0]])
        w = np.array(w)
        information, variability = w.T @ w, w.T @ correlation @ w
        out[i] = min(3.0 / np.trace(np.linalg.solve(information, variability)), 1.0)
    return out
