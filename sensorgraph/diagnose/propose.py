"""Propose effects that act roughly: cut-offs, surfaces, objects, sectors, lattices, mixtures.

Each proposer looks at the residuals of a fit where its effect would show, and returns candidates with start values
and the gain that the frozen nuisances promise. None of them decides: `decide` fits and compares.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from planners.arena import Bools, Floats
from sensorgraph.diagnose.likelihood import FINEST
from sensorgraph.diagnose.model import log_likelihood, start_state, thin, thin_state
from sensorgraph.diagnose.nuisance import Freedom
from sensorgraph.diagnose.screen import Candidate, obstacles
from sensorgraph.diagnose.solve import MOST_CORNERS
from sensorgraph.diagnose.view import View, best_run
from sensorgraph.effects import EFFECTS
from sensorgraph.effects.places import named_walls, reflected
from sensorgraph.world.scene import Ints, each

BIN = 0.1  # [m] along a wall
LEAST_GAIN = 6.0
FEW = 8  # rays; fewer are no ground for a proposal


def rough_candidates(view: View) -> list[Candidate]:
    """Ask every proposer."""
    found: list[Candidate] = []
    for propose in PROPOSERS:
        found += [c for c in propose(view) if c.gain > LEAST_GAIN]
    return sorted(found, key=lambda c: -c.gain)


def cut_offs(view: View) -> list[Candidate]:
    """max_range, min_range, incidence_dropout: exact profile of the gain over every threshold."""
    found = []
    dead = view.dead
    blind = np.where(view.near, -0.7 - view.log_p, dead)
    mu = np.where(view.aimed & (view.mu < view.range_max), view.mu, np.nan)
    for name, parameter, value, upward in (
        ("max_range", "R", mu, True),
        ("min_range", "r_min", mu, False),
        ("incidence_dropout", "alpha_max", np.where(np.isfinite(mu), view.incidence, np.nan), True),
    ):
        ok = np.isfinite(value)
        if not ok.any():
            continue
        v, d = value[ok], (blind if name == "min_range" else dead)[ok]
        order = np.argsort(-v if upward else v)
        total = np.cumsum(d[order])
        at = int(total.argmax())
        n_lost = int((view.lost | view.near)[ok][order][: at + 1].sum())
        if n_lost < 3:
            continue
        v = v[order]
        beyond = v[at + 1] if at + 1 < len(v) else v[at]
        found.append(
            Candidate(
                amendment=EFFECTS[name](**{parameter: float((v[at] + beyond) / 2)}), gain=float(total[at])
            )
        )
    return found


def black(view: View) -> list[Candidate]:
    """black_surface: misses that grow with range and incidence, on a part of one wall."""
    on = view.beams.wall >= 0
    lost = on & view.lost & view.aimed
    if lost.sum() < 3:
        return []
    found = []
    cosine, r = view.beams.cosine[on], view.beams.ranges[on]
    returned, log_p = view.returned[on], view.log_p[on]
    walls, along = view.beams.wall[on], view.along[on]
    n_walls = len(view.fitted.cast.scene.walls)
    best: dict[int, tuple[float, float, float, float]] = {}
    gone = view.lost[on]

    def gains(r0: float, some: Any = slice(None)) -> Floats:
        p = np.clip(np.minimum(1.0, cosine[some] * (r0 / r[some]) ** 2), 1e-4, 1.0)
        missed = np.log(1 - p * (1 - view.noise.loss) + 1e-5) - log_p[some]
        return np.where(returned[some], np.log(p), np.where(gone[some], missed, 0.0))

    for r0 in np.geomspace(0.3, view.range_max, 14):
        gain = gains(r0)
        table, _ = _by_wall(walls, along, gain, n_walls)
        first, last, total = best_run(table)
        for wall in np.argsort(-total)[:2]:
            if total[wall] > best.get(int(wall), (LEAST_GAIN,))[0]:
                best[int(wall)] = (float(total[wall]), first[wall] * BIN, (last[wall] + 1) * BIN, float(r0))
    for wall, (promised, a, b, start) in sorted(best.items(), key=lambda item: -item[1][0])[:2]:
        mine = np.flatnonzero(walls == wall)
        tries = []
        for r0 in start * np.geomspace(0.85, 1.18, 9):
            low, high, exact = sharp_ends(along[mine], gains(r0, mine), a, b)
            tries.append((exact, low, high, float(r0)))
        exact, low, high, r0 = max(tries)
        if exact < promised:
            low, high, r0 = a, b, start
        found.append(_on_wall(view, "black_surface", wall, max(exact, promised), a=low, b=high, r0=r0))
    return sorted(found, key=lambda c: -c.gain)[:2]


def glass(view: View) -> list[Candidate]:
    """Glass: long or missing readings at slanting incidence, on a part of one wall."""
    on = (view.beams.wall >= 0) & view.aimed
    odd = on & (view.long | (view.lost & (view.mu < view.range_max - 0.1)))
    if odd.sum() < FEW:
        return []
    found = []
    names = view.evidence.arena.names
    counts = np.bincount(view.beams.wall[odd], minlength=len(names))
    for wall in np.argsort(-counts)[:4]:
        if counts[wall] < FEW:
            continue
        mine = on & (view.beams.wall == wall)
        found += _panes(view, int(wall), mine)
    return sorted(found, key=lambda c: -c.gain)[:3]


def _panes(view: View, wall: int, mine: Bools) -> list[Candidate]:
    """Propose panes on one wall: with a plane behind, and with what the map has behind."""
    z, mu = view.z[mine], view.mu[mine]
    incidence, cosine = view.incidence[mine], view.beams.cosine[mine]
    along, log_p = view.along[mine], view.log_p[mine]
    long = view.long[mine]
    depths = [0.0]
    if long.sum() >= FEW:
        d = (z - mu)[long] * cosine[long]
        counts, edges = np.histogram(d, bins=np.arange(0.0, min(d.max() + 0.1, 30.0) + 0.05, 0.05))
        at = int(counts.argmax())
        near = np.abs(d - (edges[at] + 0.025)) < 0.05
        depths.append(float(np.median(d[near])))
    else:
        depths.append(50.0)
    walls = view.fitted.cast.scene.walls.copy()
    walls[wall] = 1e9
    ox = np.broadcast_to(view.beams.ox, view.z.shape)[mine]
    oy = np.broadcast_to(view.beams.oy, view.z.shape)[mine]
    behind, _ = each(
        walls, ox[:, None], oy[:, None], view.beams.ux[mine][:, None], view.beams.uy[mine][:, None]
    )
    best: Candidate | None = None
    for depth in depths:
        seen = mu + depth / np.maximum(cosine, 0.02) if depth > 0 else behind[:, 0]
        through = view.likely(seen, mine) - log_p
        for alpha in np.radians([0.0, 5, 10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75]):
            gain = np.where(incidence >= alpha, through, 0.0)
            table, _ = _by_wall(np.zeros(len(gain), dtype=np.intp), along, gain, 1)
            first, last, total = best_run(table)
            if best is None or total[0] > best.gain:
                span = (first[0] * BIN, (last[0] + 1) * BIN)
                a, b, sharp, exact = _pane(along, incidence, through, span)
                best = _on_wall(
                    view,
                    "glass",
                    wall,
                    max(exact, float(total[0])),
                    a=a,
                    b=b,
                    alpha_ret=max(sharp, 1e-3),
                    depth=depth,
                )
    return [best] if best is not None else []


def _pane(
    along: Floats, incidence: Floats, through: Floats, span: tuple[float, float]
) -> tuple[float, float, float, float]:
    """Sharpen ends and limiting incidence of a pane to the ray; return a, b, alpha_ret and the gain."""
    a, b = span
    alpha, gain = 0.0, 0.0
    for _ in range(2):
        inside = (along >= a) & (along <= b)
        if not inside.any():
            return *span, 0.0, 0.0
        order = np.argsort(-incidence[inside])
        total = np.cumsum(through[inside][order])
        at = int(total.argmax())
        sorted_incidence = incidence[inside][order]
        alpha = float((sorted_incidence[at] + sorted_incidence[min(at + 1, len(order) - 1)]) / 2)
        a, b, gain = sharp_ends(along, np.where(incidence >= alpha, through, 0.0), a, b)
    return a, b, alpha, gain


def sharp_ends(along: Floats, gain: Floats, a: float, b: float) -> tuple[float, float, float]:
    """Move the ends [m] of a part of a wall to where the gain of the rays is largest."""
    near = np.flatnonzero((along >= a - 2 * BIN) & (along <= b + 2 * BIN) & (gain != 0))
    if len(near) == 0:
        return a, b, 0.0
    near = near[np.argsort(along[near])]
    first, last, total = best_run(gain[near][None])
    i, j = int(first[0]), int(last[0])
    place = along[near]
    low = (place[i] + place[i - 1]) / 2 if i > 0 else place[i]
    high = (place[j] + place[j + 1]) / 2 if j + 1 < len(place) else place[j]
    return float(low), float(high), float(total[0])


def mirror(view: View) -> list[Candidate]:
    """Mirror: long readings that show the room reflected in a part of one wall."""
    on = (view.beams.wall >= 0) & view.aimed
    odd = on & (view.long | (view.lost & (view.mu < view.range_max - 0.1)))
    if odd.sum() < FEW:
        return []
    n_walls = len(view.fitted.cast.scene.walls)
    counts = np.bincount(view.beams.wall[odd], minlength=n_walls)
    found = []
    for wall in np.argsort(-counts)[:4]:
        mine = on & (view.beams.wall == wall)
        if counts[wall] < FEW:
            continue
        seen = view.mu[mine] + reflected(view.fitted.cast.scene.walls, view.beams, mine)
        gain = view.likely(seen, mine) - view.log_p[mine]
        table, _ = _by_wall(np.zeros(len(gain), dtype=np.intp), view.along[mine], gain, 1)
        first, last, total = best_run(table)
        a, b, exact = sharp_ends(view.along[mine], gain, first[0] * BIN, (last[0] + 1) * BIN)
        found.append(_on_wall(view, "mirror", int(wall), max(exact, float(total[0])), a=a, b=b))
    return sorted(found, key=lambda c: -c.gain)[:2]


def _by_wall(walls: Ints, along: Floats, gain: Floats, n_walls: int) -> tuple[Floats, int]:
    """Sum gains by wall and bin along it, (n_walls, n_bins)."""
    place = np.clip(np.nan_to_num(along) / BIN, 0, None).astype(np.intp)
    n_bins = int(place.max(initial=0)) + 1
    table = np.bincount(walls * n_bins + place, gain, n_walls * n_bins).reshape(n_walls, n_bins)
    return np.asarray(table, dtype=np.float64), n_bins


def _on_wall(view: View, name: str, wall: int, gain: float, **values: float) -> Candidate:
    a, b = view.fitted.cast.scene.walls[wall]
    length = float(np.hypot(*(b - a)))
    values["b"] = min(values["b"], length)
    values["a"] = max(values["a"], 0.0)
    middle = a + (b - a) * ((values["a"] + values["b"]) / 2 / max(length, 1e-9))
    amendment = EFFECTS[name](**values).at(view.evidence.arena.names[wall], middle)
    return Candidate(amendment=amendment, gain=gain)


def missing_or_moved(view: View) -> list[Candidate]:
    """Look for an obstacle that is gone, or that stands elsewhere."""
    found = []
    present = {(a.name, a.place) for a in view.fitted.model}
    walls = view.fitted.cast.scene.walls
    odd_end = view.ends(view.strange) if view.strange.sum() else np.zeros((0, 2))
    for feature in obstacles(view.evidence):
        if ("missing_obstacle", feature) in present or ("moved_obstacle", feature) in present:
            continue
        members = named_walls(view.evidence.arena, feature)
        mine = np.isin(view.beams.wall, members)
        if mine.sum() < FEW:
            continue
        bare = walls.copy()
        bare[members] = 1e9
        ox = np.broadcast_to(view.beams.ox, view.z.shape)[mine][:, None]
        oy = np.broadcast_to(view.beams.oy, view.z.shape)[mine][:, None]
        behind, _ = each(bare, ox, oy, view.beams.ux[mine][:, None], view.beams.uy[mine][:, None])
        gain = float((view.likely(behind[:, 0], mine) - view.log_p[mine]).sum())
        centre = walls[members].reshape(-1, 2).mean(axis=0)
        if gain > LEAST_GAIN:
            found.append(Candidate(amendment=EFFECTS["missing_obstacle"]().at(feature, centre), gain=gain))
        found += _shifted(view, feature, walls[members], odd_end, mine)
    return found


def _shifted(view: View, feature: str, outline: Floats, ends: Floats, mine: Bools) -> list[Candidate]:
    """Lay the outline of an obstacle over the ends of unexplained rays."""
    low, high = outline.min(axis=(0, 1)) - 0.7, outline.max(axis=(0, 1)) + 0.7
    near = ends[((ends > low) & (ends < high)).all(axis=1)]
    if len(near) < 2 * FEW:
        return []
    near = near[:: max(1, len(near) // 150)]
    steps = np.arange(-0.6, 0.61, 0.04)
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    a, d = outline[:, 0], outline[:, 1] - outline[:, 0]
    size = np.maximum((d**2).sum(axis=1), 1e-12)
    p = near[None] - grid[:, None]  # (n_grid, n_points, 2)
    best = np.full(p.shape[:2], np.inf)
    for k in range(len(outline)):
        q = p - a[k]
        share = np.clip((q @ d[k]) / size[k], 0.0, 1.0)
        best = np.minimum(best, np.hypot(q[..., 0] - share * d[k, 0], q[..., 1] - share * d[k, 1]))
    score = np.exp(-0.5 * (best / 0.03) ** 2).sum(axis=1)
    at = int(score.argmax())
    share = score[at] / len(near)
    if share < 0.35:
        return []
    dx, dy = grid[at]
    centre = outline.reshape(-1, 2).mean(axis=0)
    unexplained = float(-(view.log_p[view.strange & mine]).sum())
    gain = 3.0 * score[at] * max(1, len(ends) // 150) + max(unexplained, 0.0)
    return [
        Candidate(
            amendment=EFFECTS["moved_obstacle"](dx=float(dx), dy=float(dy)).at(feature, centre), gain=gain
        )
    ]


def unmapped(view: View) -> list[Candidate]:
    """unmapped_obstacle: short readings that end at one place, again and again."""
    if view.short.sum() < FEW:
        return []
    ends = view.ends(view.short)
    scan = np.nonzero(view.short)[0]
    cell = np.floor(ends / 0.2).astype(np.intp)
    _, index, counts = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    index = index.ravel()
    there = [a for a in view.fitted.model if a.name == "unmapped_obstacle"]
    found = []
    for k in np.argsort(-counts)[:3]:
        if counts[k] < FEW:
            break
        middle = np.median(ends[index == k], axis=0)
        near = np.hypot(*(ends - middle).T) < 0.6
        if len(np.unique(scan[near])) < 4:
            continue
        directions = np.stack([view.beams.ux[view.short][near], view.beams.uy[view.short][near]], axis=1)
        fitted = _circle(ends[near], directions)
        far = np.hypot(*(ends[near] - middle).T)
        small = float(np.clip(np.quantile(far, 0.5), 0.01, 0.3))
        compact = (middle + 0.5 * small * directions.mean(axis=0), small, 0.0)
        for centre, radius, spread in (fitted, compact):
            if any(np.hypot(a["x"] - centre[0], a["y"] - centre[1]) < a["r"] + radius + 0.1 for a in there):
                continue
            if spread < 0.08 and (spread or small < 0.15):
                gain = 8.0 * float((far < radius + 0.1).sum()) * max(0.1, 1 - spread / 0.1)
                amendment = EFFECTS["unmapped_obstacle"](
                    x=float(centre[0]), y=float(centre[1]), r=float(radius)
                )
                found.append(Candidate(amendment=amendment.at("", centre), gain=gain))
    return found


def _circle(points: Floats, directions: Floats) -> tuple[Floats, float, float]:
    """Fit a circle to points on its near side; return centre (2,), radius, median distance from it [m]."""
    best: tuple[float, Floats, float] | None = None
    for start in (0.04, 0.1, 0.2, 0.35):
        centre, radius = np.median(points + start * directions, axis=0), start
        for _ in range(12):
            off = points - centre
            far = np.maximum(np.hypot(off[:, 0], off[:, 1]), 1e-6)
            e = far - radius
            w = 1 / (1 + (e / 0.03) ** 2)
            rows = np.column_stack([-off / far[:, None], -np.ones(len(far))])
            a = rows.T @ (rows * w[:, None]) + np.diag([1e-3, 1e-3, 1e-3]) * len(far)
            step = np.linalg.solve(a, -rows.T @ (w * e))
            centre, radius = centre + step[:2], float(np.clip(radius + step[2], 0.01, 0.8))
        spread = float(np.median(np.abs(np.hypot(*(points - centre).T) - radius)))
        if best is None or spread < best[0] - 1e-4:
            best = (spread, centre, radius)
    assert best is not None
    return best[1], best[2], best[0]


def sectors(view: View) -> list[Candidate]:
    """sector_bias: the run of neighbouring rays whose mean residual explains most."""
    judged = view.fitted.solution.judged
    bearings = view.evidence.sensor.bearings
    found = []
    for weight in (judged.weight, _broad(view)):
        valid = view.fitted.cast.cols.valid & view.returned
        w = np.where(valid, weight, 0.0)
        num, den = (w * judged.residual).sum(axis=0), w.sum(axis=0)
        n = len(num)
        cn, cd = np.concatenate([[0.0], np.cumsum(num)]), np.concatenate([[0.0], np.cumsum(den)])
        i, j = np.triu_indices(n + 1, 1)
        few = (j - i) <= 0.8 * n
        i, j = i[few], j[few]
        s, d = cn[j] - cn[i], cd[j] - cd[i]
        score = 0.5 * s**2 / np.maximum(d, 1e-9) - 1.5 * np.log(n)
        at = int(score.argmax())
        half = 0.5 * float(np.median(np.diff(bearings))) if n > 1 else 0.01
        amendment = EFFECTS["sector_bias"](
            theta1=float(bearings[i[at]] - half),
            theta2=float(bearings[j[at] - 1] + half),
            b=float(s[at] / max(d[at], 1e-9)),
        )
        found.append(Candidate(amendment=amendment, gain=float(score[at])))
    return sorted(found, key=lambda c: -c.gain)[:1]


def _broad(view: View) -> Floats:
    """Weigh readings far off as well, but less than near ones."""
    e = view.fitted.solution.judged.residual
    sigma = view.sigma
    return np.asarray(np.where(view.returned, 1 / (sigma**2 * (1 + (e / (6 * sigma)) ** 2) * 6), 0.0))


def self_occlusion(view: View) -> list[Candidate]:
    """self_occlusion: rays that read one and the same, whatever the pose."""
    n_scans = view.z.shape[0]
    odd = view.short.sum(axis=0) > 0.3 * n_scans
    if not odd.any():
        return []
    found = []
    bearings = view.evidence.sensor.bearings
    edges = np.flatnonzero(np.diff(np.concatenate([[0], odd.astype(int), [0]])))
    for first, last in zip(edges[::2], edges[1::2] - 1, strict=True):
        z = view.z[:, first : last + 1]
        r0 = float(np.median(z[view.short[:, first : last + 1]]))
        sector = slice(first, last + 1)
        mu = np.minimum(np.where(view.aimed[:, sector], view.mu[:, sector], np.inf), r0)
        some = np.zeros(view.z.shape, dtype=np.bool_)
        some[:, sector] = True
        gain = float((view.likely(mu.ravel(), some) - view.log_p[some]).sum())
        half = 0.5 * float(np.median(np.diff(bearings))) if len(bearings) > 1 else 0.01
        amendment = EFFECTS["self_occlusion"](
            r0=r0, theta1=float(bearings[first] - half), theta2=float(bearings[last] + half)
        )
        found.append(Candidate(amendment=amendment, gain=gain))
    return found


def lattice(view: View) -> list[Candidate]:
    """Quantisation: few distinct readings, a step apart."""
    z = view.z[view.returned]
    finest = max(view.evidence.sensor.resolution, FINEST)
    cells, counts = np.unique(np.round(z / FINEST).astype(np.int64), return_counts=True)
    values = cells[counts >= 3] * np.float64(FINEST)
    if len(values) < 5 or len(z) < 200 or counts[counts >= 3].sum() < 0.9 * len(z):
        return []
    q = float(np.median(np.diff(values)))
    if q < 1.7 * finest:
        return []
    grid = q * (1 + np.linspace(-0.08, 0.08, 641))
    few = values[values < max(0.05 / 0.08 * q * 8, values[0] + 12 * q)]  # first where no step can be lost
    for _ in range(6):
        turn = np.exp(2j * np.pi * few[None] / grid[:, None]).mean(axis=1).real
        q = float(grid[int(turn.argmax())])
        width = 0.2 * q / max(few[-1], q)
        grid = q * (1 + np.linspace(-width, width, 201))
        if len(few) == len(values):
            break
        few = values[values < 2.5 * few[-1]]
    k = np.round(z / q)
    on = np.abs(z - k * q) <= 0.5 * finest + 1e-6
    if on.mean() < 0.95:
        return []
    return [
        Candidate(amendment=EFFECTS["quantisation"](q=q), gain=len(z) * max(np.log(q / finest), 0.1) * 0.5)
    ]


def noises(view: View) -> list[Candidate]:
    """range_noise, random_outliers, people: what widens or mixes."""
    found = []
    judged = view.fitted.solution.judged
    ok = view.returned & view.aimed & (judged.stray < 0.5)
    e, r, sigma = judged.residual[ok], view.mu[ok], view.fitted.cast.what.sigma[ok]
    if ok.sum() > 100:
        base = None
        for k in (0.0, 0.0015, 0.003, 0.005, 0.008, 0.012, 0.02, 0.03):
            best = -np.inf
            for core in (0.75, 0.85, 1.0, 1.15):
                s = np.sqrt((core * sigma) ** 2 + (k * r) ** 2)
                tail = self_tail(e, s, view.noise.tail)
                best = max(best, tail)
            if base is None:
                base = best
            elif best > base + LEAST_GAIN:
                found.append(Candidate(amendment=EFFECTS["range_noise"](k=k), gain=best - base))
    found = sorted(found, key=lambda c: -c.gain)[:1]
    n = max(int(view.returned.sum()), 1)
    odd = int(view.strange.sum())
    if odd > max(FEW, 0.002 * n):
        p = odd / n
        found.append(Candidate(amendment=EFFECTS["random_outliers"](p=p), gain=2.0 * odd * 0.5))
    odd = int(view.short.sum())
    if odd > max(FEW, 0.002 * n):
        found.append(Candidate(amendment=EFFECTS["people"](p=odd / n), gain=2.2 * odd * 0.5))
    return found


def self_tail(e: Floats, s: Floats, tail: float) -> float:
    """Return the log-likelihood of residuals under core and tail."""
    q = (e / s) ** 2
    return float(np.log(((1 - tail) * np.exp(-0.5 * q) + tail / 3 * np.exp(-0.5 * q / 9)) / s + 1e-3).sum())


def optics(view: View) -> list[Candidate]:
    """mixed_pixels, sonar_cone: fits of whole rays on a few scans."""
    if view.evidence.floors.get("mixed_pixels") == np.inf:
        return []
    found = []
    if _between(view) >= FEW and "mixed_pixels" not in view.fitted.names():
        found += _swept(view, "mixed_pixels", "gamma", np.radians([0.12, 0.2, 0.35, 0.6, 1.0, 1.6]), {})
    if view.short.mean() + view.lost.mean() > 0.1:
        for alpha in np.radians([20.0, 30.0, 45.0, 89.9]):
            found += _swept(
                view,
                "sonar_cone",
                "gamma",
                np.radians([4.0, 6.0, 8.0, 10.0, 12.5, 15.0, 18.0, 22.0, 27.0]),
                {"alpha_max": float(alpha)},
            )
        found = sorted(found, key=lambda c: -c.gain)[:2]
    return found


def _between(view: View) -> int:
    """Count readings at steps in depth that lie between what the two sides read."""
    mu = np.where(view.aimed, np.minimum(view.mu, view.range_max), view.range_max)
    low, high = mu.copy(), mu.copy()
    for a, b in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
        low[:, a] = np.minimum(low[:, a], mu[:, b])
        high[:, a] = np.maximum(high[:, a], mu[:, b])
    margin = 5 * view.sigma
    with np.errstate(invalid="ignore"):
        inside = view.returned & (view.z > low + margin) & (view.z < high - margin) & (high - low > 0.2)
        return int((inside & (np.abs(view.z - view.mu) > margin)).sum())


def _swept(view: View, name: str, parameter: str, values: Floats, fixed: dict[str, float]) -> list[Candidate]:
    """Try values of one parameter on every so-manieth scan, nuisances frozen."""
    some = 60 if view.evidence.arena.n_walls <= MOST_CORNERS else 20  # scans
    every = max(1, view.evidence.n_scans // some)
    few = thin(view.evidence, every)
    state = thin_state(view.fitted.state, every)
    if state.noise.core > 1.1 or state.noise.tail > 0.1:  # bent by what is looked for
        state = start_state(few, Freedom())
    model = view.fitted.model
    base = log_likelihood(few, model, state)
    best: Candidate | None = None
    for value in values:
        amendment = EFFECTS[name](**{parameter: float(value)}, **fixed)
        gain = (log_likelihood(few, (*model, amendment), state) - base) * every
        if best is None or gain > best.gain:
            best = Candidate(amendment=amendment, gain=gain)
    return [best] if best is not None else []


def tilt(view: View) -> list[Candidate]:
    """Tilt: readings capped by the floor. There h / z = sin(beta cos(theta - theta0)): linear in cos and sin theta."""
    h = view.evidence.sensor.height
    some = view.short & (view.z > 1.5 * h)
    if h <= 0 or some.sum() < 2 * FEW:
        return []
    bearings = np.broadcast_to(view.evidence.sensor.bearings, view.z.shape)[some]
    z = view.z[some]
    dip = np.arcsin(h / z)
    rows = np.column_stack([np.cos(bearings), np.sin(bearings)])
    width = np.maximum(3 * view.sigma[some] * h / z**2, 1e-4)  # [rad] of a dip, three sigma
    rng = np.random.default_rng(0)
    best: Floats = np.zeros(2)
    most = 0
    for _ in range(120):
        pair = rng.choice(len(z), 2, replace=False)
        system = rows[pair]
        if abs(np.linalg.det(system)) < 0.05:
            continue
        x = np.linalg.solve(system, dip[pair])
        count = int((np.abs(rows @ x - dip) < width).sum())
        if count > most:
            best, most = x, count
    for _ in range(3):
        inlier = np.abs(rows @ best - dip) < width
        if inlier.sum() < 2 * FEW:
            return []
        w = 1 / width[inlier]
        best = np.asarray(
            np.linalg.lstsq(rows[inlier] * w[:, None], dip[inlier] * w, rcond=None)[0], dtype=np.float64
        )
    beta, theta0 = float(np.hypot(*best)), float(np.arctan2(best[1], best[0]))
    if not 0.003 < beta < 0.5 or most < 0.2 * some.sum():
        return []
    return [Candidate(amendment=EFFECTS["tilt"](beta=beta, theta0=theta0), gain=8.0 * most)]


PROPOSERS: tuple[Callable[[View], list[Candidate]], ...] = (
    cut_offs,
    black,
    glass,
    mirror,
    missing_or_moved,
    unmapped,
    sectors,
    self_occlusion,
    lattice,
    noises,
    optics,
    tilt,
)
