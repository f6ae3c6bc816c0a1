"""Propose what surfaces do: swallow rays, let them through, turn them back."""

from __future__ import annotations

from typing import Any

import numpy as np

from sensorgraph.diagnosis.scan.residuals import FEW, LEAST_GAIN, View, best_run
from sensorgraph.diagnosis.scan.score_test import Candidate
from sensorgraph.effects import EFFECTS
from sensorgraph.effects.places import reflected
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.scene import each

BIN = 0.1  # [m] along a wall


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
    names = view.data.arena.names
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
    amendment = EFFECTS[name](**values).at(view.data.arena.names[wall], middle)
    return Candidate(amendment=amendment, gain=gain)
