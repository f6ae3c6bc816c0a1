"""Where measured and simulated differ more than chance allows, before any naming; and whether a model is enough.

Residuals are summed over bins of a dozen partitions (wall, bearing, range, …). A bin's z is clustered: its variance
comes from the scatter between blocks of about a second, so that neighbouring rays and scans, which share their
errors, count once. The largest z is compared with replicates drawn from the model (a parametric bootstrap).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from planners.clearance import Barriers
from sensorgraph.diagnosis.result import Deviation
from sensorgraph.diagnosis.scan.fit import Fitted, bare_cast, fit, log_p_at
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.effects.proposals import best_run
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.robot import Tolerances

BLOCK = 1.0  # [s] of scans that share their errors
CELL = 0.5  # [m] of places
CLIP = 4.0  # sigmas at which a residual is cut
FLOORS = {"bias": 4.5, "spread": 6.0, "outliers": 6.0, "misses": 6.0}
MATERIAL = {"bias": 0.2, "spread": 0.15, "outliers": 0.004, "misses": 0.005}  # sigma, ratio, share, share
ASIDE = 0.1  # [m] from mapped walls, from where an obstacle is no part of them
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


def partitions(view: FitResiduals) -> list[Partition]:
    """Return every partition of the rays."""
    ev, beams = view.data, view.beams
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
    if ev.n_scans > 4:
        gained = np.gradient(ev.speed, np.maximum(ev.stamps, ev.stamps[0] + 1e-3 * np.arange(ev.n_scans)))
        add("acceleration", gained[:, None], np.array([-5, -0.3, -0.15, -0.05, 0.05, 0.15, 0.3, 5]), "m/s²")
    out += _parts_of_walls(view, t)
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


def _parts_of_walls(view: FitResiduals, t: Floats) -> list[Partition]:
    """Sort the rays of each pane, mirror or black part by time and by incidence: does its law hold?"""
    out = []
    arena, span = view.data.arena, view.data.span
    scene = view.fitted.cast.scene
    placed = [a for a in view.fitted.model if a.name in ("glass", "mirror", "black_surface")]
    bare = bare_cast(scene) if placed else view.beams
    along = bare.along(scene.walls) if placed else view.along
    for a in placed:
        on = bare.wall == arena.names.index(a.place)
        on &= (np.nan_to_num(along, nan=-1.0) >= a["a"]) & (np.nan_to_num(along, nan=1e9) <= a["b"])
        quarter = np.clip((4 * t / max(span, 1e-9)).astype(np.intp), 0, 3)
        steep = np.nan_to_num(bare.incidence) > np.radians(40)
        out.append(
            Partition(
                name="part of a wall",
                index=np.where(on, quarter * 2 + steep, -1),
                count=8,
                label=_quarters(a.place),
                place=_always(a.location.xy if a.location is not None else None),
            )
        )
    return out


def _quarters(place: str) -> Callable[[int], str]:
    return lambda k: f"{place}, quarter {k // 2 + 1} of the run, {('head-on', 'slanting')[k % 2]}"


def _always(point: tuple[float, float] | None) -> Callable[[int], tuple[float, float] | None]:
    return lambda k: point


def dispersion(view: FitResiduals) -> float:
    """Return how much more the scans differ from each other than their rays explain: variance ratio, 1 expected."""
    score = scores(view)
    value, counted = score.values["spread"], score.counted["spread"]
    n = counted.sum(axis=1)
    some = n > 10
    if some.sum() < 30:
        return 1.0
    mean = value.sum(axis=1)[some] / n[some]
    within = float(value[counted].var())
    within_expected = within * float((1 / n[some]).mean())
    return float(np.var(mean) / max(within_expected, 1e-12))


def _cells(
    name: str, x: Floats, y: Floats, ok: Bools, bounds: tuple[float, float, float, float]
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
    counted: dict[str, Bools]


def scores(view: FitResiduals) -> Scores:
    """Return, per family, how each ray deviates."""
    responsibilities, expected = view.fitted.solution.responsibilities, view.fitted.cast.expected
    clear = view.returned & view.aimed & (expected.p_alternative < 0.002) & view.fitted.cast.jacobian.valid
    if view.beams.straight is not None:
        bent = view.returned & view.aimed & ~view.beams.straight & (responsibilities.stray < 0.5)
        clear = clear | bent
    u = np.where(clear, responsibilities.residual / view.sigma, 0.0)
    usual = clear & (responsibilities.stray < 0.5)
    if expected.short > 0:
        usual &= responsibilities.core + responsibilities.tail > 0.5
    psi = np.clip(u, -CLIP, CLIP)
    tail = view.noise.tail
    lattice2 = expected.lattice**2 / 12 if expected.lattice > 0 else 0.0
    extra = lattice2 / np.square(view.sigma)
    expected_square = (1 - tail) * SPREAD + tail * 5.4 + extra
    away = view.returned & view.aimed & (expected.p_alternative < 0.002)
    odd = responsibilities.stray > 0.5
    p_stray = view.noise.stray + expected.stray + expected.short
    due = view.aimed & (expected.p_alternative < 0.002) & ~np.isnan(view.z)
    inside = np.clip((view.range_max - np.where(view.aimed, view.mu, 0.0)) / (4 * view.sigma), 0.0, 1.0)
    p_lost = 1 - expected.p_return * (1 - view.noise.loss)
    due = due & (inside >= 1.0)
    outline = outlines(view)
    if outline is not None:
        usual, away, due = usual & ~outline, away & ~outline, due & ~outline
    return Scores(
        values={
            "bias": np.where(usual, psi, 0.0),
            "spread": np.where(usual, psi**2 - expected_square, 0.0),
            "outliers": np.where(away, odd - p_stray, 0.0),
            "misses": np.where(due, view.lost - p_lost, 0.0),
        },
        counted={"bias": usual, "spread": usual, "outliers": away, "misses": due},
    )


def outlines(view: FitResiduals) -> Bools | None:
    """Tell which rays pass an unmapped obstacle that stands free: of its outline, a disc says too little to be judged."""
    arena, beams, out = view.data.arena, view.beams, None
    for a in view.fitted.model:
        if a.name != "unmapped_obstacle":
            continue
        place, r = np.array([[a["x"], a["y"]]]), a["r"]
        if not arena.contains(place)[0] or Barriers(arena).distances(place)[0] < r + ASIDE:
            continue
        x, y = place[0, 0] - beams.ox, place[0, 1] - beams.oy
        ahead = x * beams.ux + y * beams.uy > 0
        near = ahead & (np.abs(x * beams.uy - y * beams.ux) < r + max(r, ASIDE))
        out = near if out is None else out | near
    return out


def deviations(
    view: FitResiduals, parts: list[Partition] | None = None, *, least: float = 3.5
) -> list[Deviation]:
    """Return the bins of material size whose z is above `least`, largest first; spread and shares one-sided."""
    parts = partitions(view) if parts is None else parts
    score = scores(view)
    blocks = ((view.data.stamps - view.data.begin) / BLOCK).astype(np.intp)
    blocks -= blocks.min(initial=0)
    n_blocks = int(blocks.max(initial=0)) + 1
    found: list[Deviation] = []
    for part in parts:
        ok = part.index >= 0
        group = np.where(ok, blocks[:, None] * part.count + part.index, n_blocks * part.count)
        flat = group.ravel()
        size = n_blocks * part.count + 1
        counts: dict[int, Any] = {}
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
                    Deviation(
                        family=family,
                        partition=part.name,
                        label=part.label(int(k)),
                        z=float(z[k]),
                        size=float(mean[k] * (view.data.sensor.sigma if family == "bias" else 1.0)),
                        n_rays=int(rays[k]),
                        xy=part.place(int(k)),
                    )
                )
    return sorted(found, key=lambda w: -abs(w.z))


def statistic(found: list[Deviation]) -> dict[str, float]:
    """Return the largest |z| per family."""
    out = dict.fromkeys(FLOORS, 0.0)
    for deviation in found:
        out[deviation.family] = max(out[deviation.family], abs(deviation.z))
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class GoodnessOfFit:
    """Whether a model leaves something unexplained."""

    statement: str
    """What is left, in words; empty: the model is enough."""
    deviation: Deviation | None
    """The strongest deviation that replicates do not show."""
    statistic: float
    threshold: float
    found: tuple[Deviation, ...]
    """All deviations above the least z."""
    misfit: float
    """[nats] that the unexplained part is worth, roughly."""
    failed: frozenset[int] = frozenset()
    """Effects of the model whose own law fails: they are clutter without a name."""

    @property
    def doubted(self) -> bool:
        """Tell whether something is left."""
        return bool(self.statement)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Doubt:
    statement: str
    misfit: float
    statistic: float
    threshold: float
    deviation: Deviation | None = None
    failed: frozenset[int] = frozenset()


def check(
    data: ScanData,
    fitted: Fitted,
    gained: float,
    gains: Mapping[int, float],
    *,
    rng: np.random.Generator,
    replicates: int = 12,
) -> GoodnessOfFit:
    """Ask whether a model is enough: deviations against replicates, scans against each other, laws of its effects.

    Parameters
    ----------
    gained : [nats] by which the model beats the one without effects; a doubt must be worth a share of it
    gains : [nats] that each effect of the model brings
    """
    told = data.tolerances
    data, fitted = _widened(data, fitted)
    view = FitResiduals(data, fitted)
    parts = partitions(view)
    found = deviations(view, parts)
    doubts = [*_laws(view, gained, gains), *_limits(view, told), *_unsteady(view)]
    ratio = dispersion(view)
    if ratio > DISPERSED:
        worth = (ratio - 1) / 2 * data.n_scans
        doubts.append(
            _Doubt(
                statement=f"scans differ from each other {ratio:.1f} times more than their rays do within a scan",
                misfit=worth,
                statistic=ratio,
                threshold=DISPERSED,
            )
        )
    doubts += _against_replicates(data, fitted, parts, found, told, rng, replicates)
    worth = max((COARSE.get(a.name, WORTH) for a in fitted.model), default=WORTH)
    doubts = [d for d in doubts if d.misfit > worth * gained]
    failed = frozenset(i for d in doubts for i in d.failed)
    if not doubts:
        return GoodnessOfFit(
            statement="", deviation=None, statistic=0.0, threshold=0.0, found=tuple(found), misfit=0.0
        )
    worst = max(doubts, key=lambda d: d.misfit)
    deviation = next(
        (d.deviation for d in sorted(doubts, key=lambda d: -d.misfit) if d.deviation is not None), None
    )
    return GoodnessOfFit(
        statement=worst.statement,
        deviation=deviation,
        statistic=worst.statistic,
        threshold=worst.threshold,
        found=tuple(found),
        misfit=worst.misfit,
        failed=failed,
    )


WORTH = 0.003  # of the model's gain; a smaller misfit is the coarseness of a right model
COARSE = {
    "sonar_cone": 0.06, "mixed_pixels": 0.06, "people": 0.06, "glass": 0.012, "mirror": 0.012, "black_surface": 0.012,
}  # fmt: skip
"""The same for effects whose model is coarse, or sharp at an end that the map's tolerance blurs."""
DISPERSED = 1.45  # variance ratio between scans and within; right models have 0.85 to 1.15
AWAY = 100.0  # [nats] that the absence of something for one stretch of the run must explain
AWAY_RAYS = 20  # rays that must ask for it
LIMIT = 3.2  # tolerances that would have to be so many times wider


def _widened(data: ScanData, fitted: Fitted) -> tuple[ScanData, Fitted]:
    """Where the tolerances proved too tight, find edges with the wider ones."""
    state = fitted.state
    if max(state.pose_scale, state.map_scale) < 1.3:
        return data, fitted
    t = data.tolerances
    wide = replace(
        t,
        map=t.map * state.map_scale,
        pose_xy=t.pose_xy * state.pose_scale,
        pose_yaw=t.pose_yaw * state.pose_scale,
        stamp=t.stamp * state.pose_scale,
    )
    wider = replace(data, tolerances=wide, memo={})
    start = replace(state, pose_scale=1.0, map_scale=1.0)
    return wider, fit(wider, fitted.model, start, NoiseBounds(max_scale=1.3), outer=1, inner=3)


def _limits(view: FitResiduals, told: Tolerances) -> list[_Doubt]:
    """Doubt a model that needs tolerances far wider than told."""
    state, t = view.fitted.state, view.data.tolerances
    out = []
    poses = state.pose_scale * t.pose_xy / max(told.pose_xy, 1e-9)
    for name, scale in (("reference pose", poses), ("map", state.map_scale * t.map / max(told.map, 1e-9))):
        if scale >= LIMIT:
            out.append(
                _Doubt(
                    statement=f"the {name} would have to be {scale:.1f} times worse than its tolerance",
                    misfit=(scale - 1) * view.data.n_scans,
                    statistic=scale,
                    threshold=LIMIT,
                )
            )
    return out


def _laws(view: FitResiduals, gained: float, gains: Mapping[int, float]) -> list[_Doubt]:
    """Check what effects that absorb anything claim of the readings they absorb; and tell-tale combinations."""
    out = []
    responsibilities = view.fitted.solution.responsibilities
    odd = (
        view.returned
        & (responsibilities.core + responsibilities.tail < 0.5)
        & (view.fitted.cast.expected.p_alternative < 0.002)
    )
    with np.errstate(invalid="ignore"):
        short = odd & (view.z < np.where(view.aimed, view.mu, view.range_max))
    model = view.fitted.model
    for index, a in enumerate(model):
        words = ""
        if a.name == "people" and short.sum() > 20:
            words = _not_people(view, short)
        elif a.name == "random_outliers" and odd.sum() > 20:
            words = _not_random(view, odd)
        if words:
            worth = 0.1 * gains[index]  # a fringe of a strong effect's own rays is no doubt
            out.append(
                _Doubt(statement=words, misfit=worth, statistic=0.0, threshold=0.0, failed=frozenset([index]))
            )
    for names, least, words in TELLTALES:
        members = [i for i, a in enumerate(model) if a.name in names]
        enough = len({model[i].name for i in members}) if least == 0 else len(members)
        if enough >= (least or len(names)):
            out.append(
                _Doubt(
                    statement=words,
                    misfit=0.1 * sum(gains[i] for i in members),
                    statistic=float(enough),
                    threshold=float(least or len(names)),
                    failed=frozenset(members),
                )
            )
    return out


TELLTALES: tuple[
    tuple[tuple[str, ...], int, str], ...
] = (  # names, how many of them (0: each once), what to say
    (
        ("range_scale", "map_scale"),
        0,
        "map and readings both seem stretched: the poses' own scale may be wrong",
    ),
    (("sector_bias",), 2, "the bias varies with the bearing in a way that no single sector describes"),
    (
        ("glass", "mirror", "black_surface"),
        3,
        "rays are lost or long on many walls, as if by direction, not by wall",
    ),
    (("moved_wall",), 3, "several walls seem moved: the error may not be the map's"),
)


def _unsteady(view: FitResiduals) -> list[_Doubt]:
    """Doubt what stands in the world but seems to be away for one stretch of the run: a door, not a pane."""
    out = []
    data, fitted = view.data, view.fitted
    for index, a in enumerate(fitted.model):
        if a.effect.place not in ("wall", "obstacle", "spot"):
            continue
        rest = (*fitted.model[:index], *fitted.model[index + 1 :])
        bare = log_p_at(data, rest, fitted.state)
        clear = fitted.cast.expected.p_alternative < 0.002
        better = np.where(clear, bare - view.log_p, 0.0)
        first, last, gain = best_run(better.sum(axis=1)[None])
        some = better[first[0] : last[0] + 1]
        if gain[0] > AWAY and (some > 1.0).sum() > AWAY_RAYS:
            begin, end = data.stamps[first[0]], data.stamps[last[0]]
            out.append(
                _Doubt(
                    statement=f"{a.effect.title} at {a.place or 'its spot'} is not there from "
                    f"{begin - data.begin:.0f} s to {end - data.begin:.0f} s of the run",
                    misfit=float(gain[0]),
                    statistic=float(gain[0]),
                    threshold=AWAY,
                    failed=frozenset([index]),
                )
            )
    return out


def _not_people(view: FitResiduals, short: Bools) -> str:
    """Return why short readings are no people, or nothing."""
    share = float(short.mean())
    if clustered(view, short) < 0.5:
        return f"{100 * share:.1f} % of the readings are short, one by one: too scattered for people"
    z = view.z[short]
    counts, _ = np.histogram(z, bins=np.arange(0, view.range_max + 0.06, 0.06))
    if counts.max() > 0.4 * len(z):
        return f"{100 * share:.1f} % of the readings are short, most of them at {0.06 * (counts.argmax() + 0.5):.2f} m"
    return ""


def _not_random(view: FitResiduals, odd: Bools) -> str:
    """Return why stray readings are not uniform, or nothing."""
    share = float(odd.mean())
    u = np.sort(view.z[odd] / view.range_max)
    n = len(u)
    d = float(np.abs(u - (np.arange(n) + 0.5) / n).max())
    if d > max(0.15, 2.2 / np.sqrt(n)):
        return f"{100 * share:.1f} % of the readings are strays, but not from anywhere: their ranges are not uniform"
    if clustered(view, odd) > 0.35 + 3 * share:
        return f"{100 * share:.1f} % of the readings are strays that come in clusters"
    return ""


def clustered(view: FitResiduals, some: Bools) -> float:
    """Return the share of readings with a neighbour of their kind at a similar range in the same scan."""
    if not some.any():
        return 0.0
    z = np.where(some, view.z, np.nan)
    with np.errstate(invalid="ignore"):
        near = np.abs(np.diff(z, axis=1)) < 0.3
    has = np.zeros(some.shape, dtype=np.bool_)
    has[:, 1:] |= near
    has[:, :-1] |= near
    return float(has[some].mean())


def _against_replicates(
    data: ScanData,
    fitted: Fitted,
    parts: list[Partition],
    found: list[Deviation],
    told: Tolerances,
    rng: np.random.Generator,
    count: int,
) -> list[_Doubt]:
    """Compare the largest deviation of each family with replicates; none is drawn where nothing is suspect."""
    suspects = {f: z for f, z in statistic(found).items() if z > FLOORS[f]}
    if not suspects:
        return []
    t = data.tolerances
    wider = max(t.map / max(told.map, 1e-9), t.pose_xy / max(told.pose_xy, 1e-9))
    slack = float(np.clip(wider, 1.0, 2.0))
    drawn: dict[str, list[float]] = {f: [] for f in FLOORS}
    for _ in range(count):
        again = replicate(data, fitted, rng)
        for family, z in statistic(deviations(FitResiduals(*again), parts, least=2.5)).items():
            drawn[family].append(z)
    out = []
    for family, z in suspects.items():
        d = np.array(drawn[family])
        threshold = max(1.25 * float(d.max()), float(d.mean() + 4 * d.std()), FLOORS[family]) * slack
        if z > threshold:
            deviation = next(w for w in found if w.family == family)
            misfit = sum(
                0.5 * w.z**2 for w in found if w.partition == deviation.partition and w.family == family
            )
            out.append(
                _Doubt(
                    statement=deviation.sentence(),
                    misfit=float(misfit),
                    statistic=z,
                    threshold=threshold,
                    deviation=deviation,
                )
            )
    return out


def replicate(data: ScanData, fitted: Fitted, rng: np.random.Generator) -> tuple[ScanData, Fitted]:
    """Draw readings from a fitted model, with pose errors and tails, and refit nuisances linearly."""
    from sensorgraph.diagnosis.scan.gauss_newton import Solution, Solver
    from sensorgraph.diagnosis.scan.likelihood import e_step, sample
    from sensorgraph.diagnosis.scan.nuisance import pose_prior

    solution, expected, jacobian = fitted.solution, fitted.cast.expected, fitted.cast.jacobian
    state = solution.state.copy()
    prior = pose_prior(data, state.pose_scale)
    state.delta = np.einsum("nij,nj->ni", np.linalg.cholesky(prior), rng.normal(size=state.delta.shape))
    mu = expected.reading + fitted.solver.shift(state, solution.p)
    z = sample(data, expected, mu, state.noise, rng)
    drawn = replace(data, ranges=z)
    corners = fitted.solver.corners
    solver = Solver(
        drawn,
        expected,
        jacobian,
        fitted.cast.scene.walls,
        fitted.solver.effects,
        corners,
        fitted.solver.locked,
    )
    state = solution.state.copy()
    state.delta[:] = 0.0
    p = solution.p
    for _ in range(2):
        responsibilities = e_step(drawn, expected, solver.shift(state, p), state.noise)
        system = solver.assemble(responsibilities.weight, state.pose_scale)
        state.g, p = solver.maximise(system, state)
        state.delta = solver.poses_at(system, np.concatenate([state.g, p]))
    responsibilities = e_step(drawn, expected, solver.shift(state, p), state.noise)
    refit = Solution(
        state=state,
        p=p,
        j=0.0,
        responsibilities=responsibilities,
        system=system,
        covariance=solution.covariance,
    )
    return drawn, Fitted(model=fitted.model, solution=refit, cast=fitted.cast, solver=solver)
