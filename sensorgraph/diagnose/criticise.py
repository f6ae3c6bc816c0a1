"""Where measured and simulated differ more than chance allows, before any naming; and whether a model is enough.

Residuals are summed over bins of a dozen partitions (wall, bearing, range, …). A bin's z is clustered: its variance
comes from the scatter between blocks of about a second, so that neighbouring rays and scans, which share their
errors, count once. The largest z is compared with replicates drawn from the model (a parametric bootstrap).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.arena import Floats
from sensorgraph.diagnose.evidence import Evidence
from sensorgraph.diagnose.finding import Where
from sensorgraph.diagnose.model import Fitted
from sensorgraph.diagnose.view import View

Ints = NDArray[np.intp]

BLOCK = 1.0  # [s] of scans that share their errors
CELL = 0.5  # [m] of places
CLIP = 4.0  # sigmas at which a residual is cut
FLOORS = {"bias": 4.2, "spread": 5.0, "outliers": 5.0, "misses": 5.0}
MATERIAL = {"bias": 0.2, "spread": 0.15, "outliers": 0.004, "misses": 0.005}  # sigma, ratio, share, share
SPREAD = 0.9866  # mean square of a unit normal cut at CLIP, nearly
LEAST = 40  # rays in a bin
LEAST_BLOCKS = 5


@dataclass(frozen=True, kw_only=True, eq=False)
class Partition:
    """One way to sort rays into bins."""

    name: str
    index: Ints
    """(n_scans, n_rays) bin, -1: none."""
    count: int
    label: Callable[[int], str]
    place: Callable[[int], tuple[float, float] | None]


def partitions(view: View) -> list[Partition]:
    """Return every partition of the rays."""
    ev, beams = view.evidence, view.beams
    shape = view.z.shape
    hit = np.isfinite(beams.ranges)
    phi = ev.poses[:, 2]
    bearings = ev.sensor.bearings
    arena = ev.arena
    out: list[Partition] = []

    def add(name: str, value: Floats, edges: Floats, unit: str, scale: float = 1.0) -> None:
        index = np.broadcast_to(np.searchsorted(edges, value, side="right") - 1, shape)
        ok = (index >= 0) & (index < len(edges) - 1) & np.isfinite(np.broadcast_to(value, shape))
        out.append(
            Partition(
                name=name,
                index=np.where(ok, index, -1),
                count=len(edges) - 1,
                label=lambda k: f"{edges[k] * scale:.3g} to {edges[k + 1] * scale:.3g} {unit}",
                place=lambda k: None,
            )
        )

    wall = np.where(hit & (beams.wall >= 0), beams.wall, -1)
    walls = view.fitted.cast.scene.walls
    out.append(
        Partition(
            name="wall",
            index=wall,
            count=max(len(walls), 1),
            label=lambda k: arena.names[k],
            place=lambda k: _point(arena.walls[k].mean(axis=0)),
        )
    )
    degree = 180 / np.pi
    spread = np.linspace(bearings[0] - 1e-9, bearings[-1] + 1e-9, min(25, len(bearings) + 1))
    add("bearing", np.broadcast_to(bearings, shape), spread, "degrees", degree)
    r = np.where(hit, beams.ranges, np.nan)
    add("range", r, np.concatenate([np.arange(0, 4, 0.4), np.arange(4, ev.sensor.range_max + 1, 0.8)]), "m")
    add(
        "incidence",
        np.where(hit, view.incidence, np.nan),
        np.radians(np.arange(0, 91, 7.5)),
        "degrees",
        degree,
    )
    t = (ev.stamps - ev.begin)[:, None]
    add("time", t, np.linspace(0, ev.span + 1e-9, 21), "s")
    add("omega", ev.twists[:, 2:], np.array([-3, -0.8, -0.5, -0.25, -0.08, 0.08, 0.25, 0.5, 0.8, 3]), "rad/s")
    add("speed", ev.speed[:, None], np.array([-2, -0.25, -0.1, -0.02, 0.02, 0.1, 0.2, 0.3, 0.4, 2]), "m/s")
    direction = np.arctan2(beams.uy, beams.ux)
    add("direction in map", direction, np.linspace(-np.pi, np.pi + 1e-9, 25), "degrees", degree)
    heading = np.pi - (np.pi - phi) % (2 * np.pi)
    add("heading", heading[:, None], np.linspace(-np.pi, np.pi + 1e-9, 17), "degrees", degree)
    safe = np.where(hit, beams.ranges, 0.0)
    out.append(_cells("hit place", beams.ox + safe * beams.ux, beams.oy + safe * beams.uy, hit, arena.bounds))
    base = np.broadcast_to(ev.poses[:, :1], shape), np.broadcast_to(ev.poses[:, 1:2], shape)
    out.append(_cells("robot place", *base, np.ones(shape, dtype=np.bool_), arena.bounds))
    half = (t > ev.span / 2).astype(np.intp)
    fine = out[1]
    out.append(
        Partition(
            name="bearing and half of the run",
            index=np.where(fine.index >= 0, fine.index * 2 + half, -1),
            count=fine.count * 2,
            label=lambda k: f"{fine.label(k // 2)}, {('first', 'second')[k % 2]} half of the run",
            place=lambda k: None,
        )
    )
    late = (t > ev.span / 2).astype(np.intp)
    out.append(
        Partition(
            name="wall and half of the run",
            index=np.where(wall >= 0, wall * 2 + late, -1),
            count=max(len(walls), 1) * 2,
            label=lambda k: f"{arena.names[k // 2]}, {('first', 'second')[k % 2]} half of the run",
            place=lambda k: _point(arena.walls[k // 2].mean(axis=0)),
        )
    )
    return out


def _cells(
    name: str, x: Floats, y: Floats, ok: Floats, bounds: tuple[float, float, float, float]
) -> Partition:
    x0, y0, x1, y1 = bounds
    nx, ny = int((x1 - x0 + 0.2) / CELL) + 1, int((y1 - y0 + 0.2) / CELL) + 1
    i, j = np.floor((x - x0 + 0.1) / CELL), np.floor((y - y0 + 0.1) / CELL)
    inside = ok & (i >= 0) & (i < nx) & (j >= 0) & (j < ny)
    index = np.where(inside, i * ny + j, -1).astype(np.intp)

    def centre(k: int) -> tuple[float, float]:
        return (x0 - 0.1 + (k // ny + 0.5) * CELL, y0 - 0.1 + (k % ny + 0.5) * CELL)

    return Partition(
        name=name,
        index=index,
        count=nx * ny,
        label=lambda k: f"around ({centre(k)[0]:.2f}, {centre(k)[1]:.2f}) m",
        place=centre,
    )


def _point(xy: Floats) -> tuple[float, float]:
    return float(xy[0]), float(xy[1])


@dataclass(frozen=True, kw_only=True, eq=False)
class Scores:
    """Deviation of every ray from what the model expects, per family; arrays (n_scans, n_rays)."""

    values: dict[str, Floats]
    counted: dict[str, Floats]


def scores(view: View) -> Scores:
    """Return, per family, how each ray deviates."""
    judged, what = view.fitted.solution.judged, view.fitted.cast.what
    clear = view.returned & view.aimed & (what.p_alternative < 0.002) & view.fitted.cast.cols.valid
    if view.beams.straight is not None:
        bent = view.returned & view.aimed & ~view.beams.straight & (judged.stray < 0.5)
        clear = clear | bent
    u = np.where(clear, judged.residual / view.sigma, 0.0)
    usual = clear & (judged.stray < 0.5)
    psi = np.clip(u, -CLIP, CLIP)
    tail = view.noise.tail
    lattice2 = what.lattice**2 / 12 if what.lattice > 0 else 0.0
    extra = lattice2 / np.square(view.sigma)
    expected = (1 - tail) * SPREAD + tail * 5.4 + extra
    away = view.returned & view.aimed & (what.p_alternative < 0.002)
    odd = judged.stray > 0.5
    p_stray = view.noise.stray + what.stray + what.short
    due = view.aimed & (what.p_alternative < 0.002) & ~np.isnan(view.z)
    inside = np.clip((view.range_max - np.where(view.aimed, view.mu, 0.0)) / (4 * view.sigma), 0.0, 1.0)
    p_lost = 1 - what.p_return * (1 - view.noise.loss)
    due = due & (inside >= 1.0)
    return Scores(
        values={
            "bias": np.where(usual, psi, 0.0),
            "spread": np.where(usual, psi**2 - expected, 0.0),
            "outliers": np.where(away, odd - p_stray, 0.0),
            "misses": np.where(due, view.lost - p_lost, 0.0),
        },
        counted={"bias": usual, "spread": usual, "outliers": away, "misses": due},
    )


def deviations(view: View, parts: list[Partition] | None = None, *, least: float = 3.5) -> list[Where]:
    """Return the bins of material size whose z is above `least`, largest first; spread and shares one-sided."""
    parts = partitions(view) if parts is None else parts
    score = scores(view)
    blocks = ((view.evidence.stamps - view.evidence.begin) / BLOCK).astype(np.intp)
    blocks -= blocks.min(initial=0)
    n_blocks = int(blocks.max(initial=0)) + 1
    found: list[Where] = []
    for part in parts:
        ok = part.index >= 0
        group = np.where(ok, blocks[:, None] * part.count + part.index, n_blocks * part.count)
        flat = group.ravel()
        size = n_blocks * part.count + 1
        counts: dict[int, Floats] = {}
        for family, value in score.values.items():
            counted = score.counted[family]
            if id(counted) not in counts:
                counts[id(counted)] = np.bincount(flat, counted.ravel(), size)[:-1].reshape(n_blocks, -1)
            n = counts[id(counted)]
            s = np.bincount(flat, value.ravel(), size)[:-1].reshape(n_blocks, -1)
            total, rays = s.sum(axis=0), n.sum(axis=0)
            mean = total / np.maximum(rays, 1)
            scatter = np.sqrt(((s - mean * n) ** 2).sum(axis=0) + 1e-12)
            least_scatter = {"bias": 1.0, "spread": 1.6, "outliers": 0.04, "misses": 0.04}[family] * np.sqrt(
                rays
            )
            z = total / np.maximum(np.maximum(scatter, least_scatter), 1e-9)
            enough = (rays >= LEAST) & ((n > 0).sum(axis=0) >= LEAST_BLOCKS)
            size_ok = np.abs(mean) > MATERIAL[family]
            strong = enough & size_ok & ((np.abs(z) > least) if family == "bias" else (z > least))
            for k in np.flatnonzero(strong):
                found.append(
                    Where(
                        family=family,
                        partition=part.name,
                        label=part.label(int(k)),
                        z=float(z[k]),
                        size=float(mean[k] * (view.evidence.sensor.sigma if family == "bias" else 1.0)),
                        n_rays=int(rays[k]),
                        xy=part.place(int(k)),
                    )
                )
    return sorted(found, key=lambda w: -abs(w.z))


def statistic(found: list[Where]) -> dict[str, float]:
    """Return the largest |z| per family."""
    out = dict.fromkeys(FLOORS, 0.0)
    for where in found:
        out[where.family] = max(out[where.family], abs(where.z))
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Verdict:
    """Whether a model leaves something unexplained."""

    where: Where | None
    """The strongest deviation that replicates do not show; None: the model is enough."""
    statistic: float
    threshold: float
    found: tuple[Where, ...]
    """All deviations above the floor."""
    misfit: float
    """[nats] that a free correction over the worst partition would bring, roughly."""


def check(evidence: Evidence, fitted: Fitted, *, rng: np.random.Generator, replicates: int = 12) -> Verdict:
    """Compare the deviations of a fit with those of replicates drawn from it."""
    view = View(evidence, fitted)
    parts = partitions(view)
    found = deviations(view, parts)
    observed = statistic(found)
    suspects = {f: z for f, z in observed.items() if z > FLOORS[f]}
    if not suspects:
        return Verdict(where=None, statistic=0.0, threshold=0.0, found=(), misfit=0.0)
    drawn = {f: [] for f in FLOORS}
    for _ in range(replicates):
        again = replicate(evidence, fitted, rng)
        for family, z in statistic(deviations(View(*again), parts, least=2.5)).items():
            drawn[family].append(z)
    worst: tuple[float, Where, float] | None = None
    for family, z in suspects.items():
        d = np.array(drawn[family])
        threshold = max(1.25 * d.max(), d.mean() + 4 * d.std(), FLOORS[family])
        if z > threshold and (worst is None or z / threshold > worst[0]):
            where = next(w for w in found if w.family == family)
            worst = (z / threshold, where, threshold)
    if worst is None:
        return Verdict(
            where=None, statistic=max(suspects.values()), threshold=0.0, found=tuple(found), misfit=0.0
        )
    misfit = sum(
        0.5 * w.z**2 for w in found if w.partition == worst[1].partition and w.family == worst[1].family
    )
    return Verdict(
        where=worst[1],
        statistic=abs(worst[1].z),
        threshold=worst[2],
        found=tuple(found),
        misfit=float(misfit),
    )


def replicate(evidence: Evidence, fitted: Fitted, rng: np.random.Generator) -> tuple[Evidence, Fitted]:
    """Draw readings from a fitted model, with pose errors and tails, and refit nuisances linearly."""
    from dataclasses import replace

    from sensorgraph.diagnose.likelihood import judge
    from sensorgraph.diagnose.nuisance import TAIL, pose_prior
    from sensorgraph.diagnose.solve import Solution, Solver
    from sensorgraph.world.scene import limited

    solution, what, cols = fitted.solution, fitted.cast.what, fitted.cast.cols
    state = solution.state.copy()
    prior = pose_prior(evidence, state.pose_scale)
    state.delta = np.einsum("nij,nj->ni", np.linalg.cholesky(prior), rng.normal(size=state.delta.shape))
    mu = what.reading + fitted.solver.shift(state, solution.p)
    shape = mu.shape
    other = rng.random(shape) < what.p_alternative
    mu = np.where(other & np.isfinite(what.alternative), what.alternative, mu)
    wide = np.where(rng.random(shape) < state.noise.tail, TAIL, 1.0)
    z = np.where(np.isfinite(mu), mu + rng.normal(size=shape) * wide * state.noise.core * what.sigma, np.inf)
    z = np.where(rng.random(shape) < what.p_return * (1 - state.noise.loss), z, np.inf)
    stray = rng.random(shape) < 1 - (1 - state.noise.stray) * (1 - what.stray)
    z = np.where(stray, rng.random(shape) * evidence.sensor.range_max, z)
    if what.short > 0:
        short = rng.random(shape) < what.short
        z = np.where(short, rng.random(shape) * np.where(np.isfinite(mu), mu, evidence.sensor.range_max), z)
    z = limited(z, evidence.sensor, what.lattice)
    z[np.isnan(evidence.ranges)] = np.nan
    drawn = replace(evidence, ranges=z)
    corners = fitted.solver.corners
    solver = Solver(
        drawn, what, cols, fitted.cast.scene.walls, fitted.solver.effects, corners, fitted.solver.locked
    )
    state = solution.state.copy()
    state.delta[:] = 0.0
    p = solution.p
    for _ in range(2):
        judged = judge(drawn, what, solver.shift(state, p), state.noise)
        system = solver.assemble(judged.weight, state.pose_scale)
        state.g, p = solver.maximise(system, state)
        state.delta = solver.poses_at(system, np.concatenate([state.g, p]))
    judged = judge(drawn, what, solver.shift(state, p), state.noise)
    refit = Solution(state=state, p=p, j=0.0, judged=judged, system=system, covariance=solution.covariance)
    return drawn, Fitted(model=fitted.model, solution=refit, cast=fitted.cast, solver=solver)
