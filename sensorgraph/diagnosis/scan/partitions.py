"""Partition the rays of a run into bins: by wall, bearing, range, incidence, time, motion and place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Bools, Floats, Ints

SPEED_EDGES = np.array([-2, -0.25, -0.1, -0.02, 0.02, 0.1, 0.2, 0.3, 0.4, 2])  # [m/s]
TURN_RATE_EDGES = np.array([-3, -0.8, -0.5, -0.25, -0.08, 0.08, 0.25, 0.5, 0.8, 3])  # [rad/s]
ACCELERATION_EDGES = np.array([-5, -0.3, -0.15, -0.05, 0.05, 0.15, 0.3, 5])  # [m/s²]
INCIDENCE_EDGES = np.radians(np.arange(0, 91, 7.5))  # [rad]
N_BEARINGS, N_HEADINGS, N_TIMES = 24, 16, 20
OF_WALLS = ("wall", "wall and half of the run", "hit place")
"""Partitions whose bins also show the shape of walls."""
MARGIN = 0.1  # [m] of the raster beyond the arena


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
    walls = _by_wall(view)
    bearing_edges = np.linspace(bearings[0] - 1e-9, bearings[-1] + 1e-9, min(N_BEARINGS, len(bearings)) + 1)
    by_bearing = binned("bearing", bearings, bearing_edges, "degrees", degree)
    range_edges = np.concatenate([np.arange(0, 4, 0.4), np.arange(4, range_max + 1, 0.8)])
    circle = np.linspace(-np.pi, np.pi + 1e-9, N_BEARINGS + 1)
    heading = np.pi - (np.pi - data.poses[:, 2:]) % (2 * np.pi)
    reach = np.where(hit, beams.ranges, 0.0)
    out = [
        walls,
        by_bearing,
        binned("range", np.where(hit, beams.ranges, np.nan), range_edges, "m"),
        binned("incidence", np.where(hit, view.incidence, np.nan), INCIDENCE_EDGES, "degrees", degree),
        binned("time", t, np.linspace(0, data.span + 1e-9, N_TIMES + 1), "s"),
        binned("omega", data.twists[:, 2:], TURN_RATE_EDGES, "rad/s"),
        binned("speed", data.speed[:, None], SPEED_EDGES, "m/s"),
        binned("direction in map", np.arctan2(beams.uy, beams.ux), circle, "degrees", degree),
        binned("heading", heading, np.linspace(-np.pi, np.pi + 1e-9, N_HEADINGS + 1), "degrees", degree),
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
    late = (t > data.span / 2).astype(np.intp)
    return [*out, _by_half(by_bearing, late), _by_half(walls, late)]


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


def _by_half(whole: Partition, late: Ints) -> Partition:
    """Split each bin of a partition by the half of the run; `late` (n_scans, 1) is 1 in the second half."""
    return Partition(
        name=f"{whole.name} and half of the run",
        index=np.where(whole.index >= 0, whole.index * 2 + late, -1),
        count=whole.count * 2,
        label=lambda k: f"{whole.label(k // 2)}, {('first', 'second')[k % 2]} half of the run",
        place=lambda k: whole.place(k // 2),
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
