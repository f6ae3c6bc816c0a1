"""What stands in the way of a ray: walls, what glass, mirrors, doors, curtains and dust make of them, and people."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from shapely.geometry import LineString, Point
from shapely.prepared import prep

from benchmarks.hidden_effects.geometry import largest_part
from benchmarks.hidden_effects.log import Booleans, Floats, Ints
from benchmarks.hidden_effects.worlds.blind.base import X, Y
from benchmarks.hidden_effects.worlds.blind.drive import Driven
from benchmarks.hidden_effects.worlds.blind.effects import Hidden, Secrets

STEP = 0.05
"""[s]"""
WALL_DISTANCE = 0.22
"""[m] that people keep off walls."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Leg:
    """A moving disc."""

    stamps: Floats
    x: Floats
    y: Floats
    """(n,) [s, m, m]"""
    radius: float
    """[m]"""
    is_there: Floats
    """(n,) 1 while its owner is in the room."""


class _Floor:
    """Where people may walk."""

    def __init__(self, free: Any) -> None:
        inner = largest_part(free.buffer(-WALL_DISTANCE))
        self._bounds, self.passable = inner.bounds, prep(inner)

    def goal(self, rng: np.random.Generator, start: Floats | None = None) -> Floats:
        """Draw a point (2,) [m], in sight of a start."""
        x0, y0, x1, y1 = self._bounds
        for _ in range(300):
            point = np.array([rng.uniform(x0, x1), rng.uniform(y0, y1)])
            if not self.passable.contains(Point(point)):
                continue
            if start is None:
                return point
            if np.hypot(*(point - start)) > 0.8 and self.passable.covers(LineString([start, point])):
                return point
        return point if start is None else start


def walkers(
    rng: np.random.Generator, free: Any, driven: Driven, duration: float, n_people: int
) -> tuple[Leg, ...]:
    """Return the legs of people who walk, pause, and step aside for the robot."""
    floor, stamps = _Floor(free), np.arange(0, duration + STEP, STEP)
    robot = np.column_stack([driven.at(stamps, X), driven.at(stamps, Y)])
    legs: list[Leg] = []
    for _ in range(n_people):
        legs += _walk(rng, floor, stamps, robot, duration)
    return tuple(legs)


def _walk(
    rng: np.random.Generator, floor: _Floor, stamps: Floats, robot: Floats, duration: float
) -> list[Leg]:
    at = floor.goal(rng)
    while np.hypot(*(at - robot[0])) < 0.9:
        at = floor.goal(rng)
    goal = floor.goal(rng, at)
    speed = rng.uniform(0.5, 1.1)
    pause = heading = way = 0.0
    radius = rng.uniform(0.055, 0.075)
    track = np.zeros((len(stamps), 4))  # x, y, way, heading
    for i in range(len(stamps)):
        off, left = at - robot[i], float(np.hypot(*(goal - at)))
        if np.hypot(*off) < 0.55:
            aside = at + off / max(np.hypot(*off), 1e-6) * STEP * 0.8
            if floor.passable.contains(Point(aside)):
                at = aside
                way += 0.04
            goal, pause = floor.goal(rng, at), 0.0
        elif pause > 0:
            pause -= STEP
        elif left < 0.06:
            goal = floor.goal(rng, at)
            pause = rng.uniform(0, 2.5) if rng.random() < 0.5 else 0.0
            speed = rng.uniform(0.5, 1.1)
        else:
            ahead, towards = at + (goal - at) / left * min(left, speed * STEP), goal - at
            if np.hypot(*(ahead - robot[i])) < 0.6:
                goal = floor.goal(rng, at)
            else:
                at, heading = ahead, float(np.arctan2(towards[1], towards[0]))
                way += speed * STEP
        track[i] = *at, way, heading
    is_there = np.ones(len(stamps))
    if rng.random() < 0.5:
        enters = rng.uniform(0, 0.35) * duration
        leaves = enters + rng.uniform(0.5, 0.65) * duration
        is_there = ((stamps > enters) & (stamps < leaves)).astype(float)
    return [_leg_of(track, stamps, side, radius, is_there) for side in (1, -1)]


def _leg_of(track: Floats, stamps: Floats, side: int, radius: float, is_there: Floats) -> Leg:
    """Return the left or right leg, which swings while its owner walks."""
    x, y, way, heading = track.T
    swing = 0.17 * np.sin(2 * np.pi * way / 1.3) * side
    c, s = np.cos(heading), np.sin(heading)
    return Leg(
        stamps=stamps,
        x=x + c * swing - s * 0.09 * side,
        y=y + s * swing + c * 0.09 * side,
        radius=radius,
        is_there=is_there,
    )


@numba.njit(cache=True)
def cast(x, y, dx, dy, walls, skipped):  # type: ignore[no-untyped-def]
    """Return the nearest wall of each ray.

    Parameters
    ----------
    x, y, dx, dy : (n,) [m] where rays start, and unit vectors
    walls : (n_walls, 4) [m]
    skipped : (n,) index of a wall that a ray does not see, or -1

    Returns
    -------
    (range [m], inf: none; index of the wall, -1: none; share of the wall's length), each (n,)
    """
    n = x.size
    ranges, index, share = np.full(n, np.inf), np.full(n, -1, np.int64), np.zeros(n)
    for i in range(n):
        for j in range(walls.shape[0]):
            if j == skipped[i]:
                continue
            ex, ey = walls[j, 2] - walls[j, 0], walls[j, 3] - walls[j, 1]
            cross = dx[i] * ey - dy[i] * ex
            if cross == 0.0:
                continue
            ax, ay = walls[j, 0] - x[i], walls[j, 1] - y[i]
            t = (ax * ey - ay * ex) / cross
            if t <= 1e-9 or t >= ranges[i]:
                continue
            k = (ax * dy[i] - ay * dx[i]) / cross
            if k >= -1e-9 and k <= 1 + 1e-9:
                ranges[i], index[i], share[i] = t, j, k
    return ranges, index, share


def through_disc(
    x: Floats, y: Floats, dx: Floats, dy: Floats, cx: Floats | float, cy: Floats | float, radius: float
) -> tuple[Floats, Floats]:
    """Return where rays enter and leave a disc [m]; inf and -inf where they miss it."""
    ax, ay = cx - x, cy - y
    along = ax * dx + ay * dy
    inside = along * along - (ax * ax + ay * ay - radius * radius)
    half = np.sqrt(np.maximum(inside, 0))
    enters, leaves = along - half, along + half
    is_hit = (inside > 0) & (leaves > 0)
    return np.where(is_hit, np.maximum(enters, 1e-3), np.inf), np.where(is_hit, leaves, -np.inf)


def to_segment(
    x: Floats, y: Floats, dx: Floats, dy: Floats, ends: tuple[Floats | float, ...] | Floats
) -> Floats:
    """Return the range (n,) [m] of rays to a segment (x, y of one end, then of the other), inf: missed."""
    x0, y0, x1, y1 = ends
    ex, ey = x1 - x0, y1 - y0
    cross = dx * ey - dy * ex
    cross = np.where(cross == 0, 1e-12, cross)
    ax, ay = x0 - x, y0 - y
    t, k = (ax * ey - ay * ex) / cross, (ax * dy - ay * dx) / cross
    return np.where((t > 1e-6) & (k >= 0) & (k <= 1), t, np.inf)


COS_SOFT = 0.9
"""Cosine of the incidence said of legs, meshes and what stands behind a door."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Rays:
    """Rays (n,) in the map."""

    x: Floats
    y: Floats
    dx: Floats
    dy: Floats
    """Start [m] and unit vector."""
    stamps: Floats
    """[s]"""
    chance: Floats
    """Uniform over (0, 1): what a half-transparent thing does with the ray."""


@dataclass(kw_only=True, eq=False)
class Hits:
    """What rays (n,) meet."""

    ranges: Floats
    """[m], inf: nothing."""
    cos_incidence: Floats
    wall: Ints
    """-1: no wall."""
    along: Floats
    """[m] from the first end of the wall."""
    is_person: Booleans


class Scene:
    """Walls (n_walls, 4) [m], hidden effects, and the legs of people."""

    def __init__(self, walls: Floats, secrets: Secrets, legs: tuple[Leg, ...] = ()) -> None:
        self.walls, self.secrets, self.legs = walls, secrets, legs
        along = walls[:, 2:] - walls[:, :2]
        self.lengths: Floats = np.hypot(along[:, 0], along[:, 1])
        self.normals: Floats = np.column_stack([-along[:, 1], along[:, 0]]) / self.lengths[:, None]

    def meet(self, rays: Rays) -> Hits:
        """Return what each ray meets first."""
        ranges, wall, share = self._cast(rays)
        cosine = np.abs(rays.dx * self.normals[wall, 0] + rays.dy * self.normals[wall, 1])
        hits = Hits(
            ranges=ranges,
            cos_incidence=cosine,
            wall=wall,
            along=share * self.lengths[wall],
            is_person=np.zeros(ranges.size, dtype=bool),
        )
        for name, change in IN_THE_WAY.items():
            if name in self.secrets:
                change(self, rays, hits, self.secrets[name])
        for leg in self.legs:
            _leg(rays, hits, leg)
        return hits

    def _cast(self, rays: Rays) -> tuple[Floats, Ints, Floats]:
        nothing = np.full(rays.x.size, -1)
        ranges, wall, share = cast(rays.x, rays.y, rays.dx, rays.dy, self.walls, nothing)
        shoved = self.secrets.get("f_shoved")
        if shoved is not None:
            late = rays.stamps >= shoved["t0"]
            starts = (rays.x[late], rays.y[late], rays.dx[late], rays.dy[late])
            ranges[late], wall[late], share[late] = cast(*starts, shoved.shapes["walls_after"], nothing[late])
        return ranges, wall, share

    def sees_section(self, hits: Hits, hidden: Hidden) -> Booleans:
        """Tell which rays end on a section of a wall."""
        return np.asarray(
            (hits.wall == hidden.wall) & (hits.along >= hidden["a"]) & (hits.along <= hidden["b"])
        )

    def follow(self, m: Ints, hits: Hits, x: Floats, y: Floats, dx: Floats, dy: Floats) -> None:
        """Let rays m go on from (x, y) [m] behind or off the wall they met, and add the way."""
        ranges, wall, share = cast(x, y, dx, dy, self.walls, hits.wall[m])
        hits.ranges[m] = hits.ranges[m] + ranges
        hits.cos_incidence[m] = np.abs(dx * self.normals[wall, 0] + dy * self.normals[wall, 1])
        hits.along[m] = share * self.lengths[wall]
        hits.wall[m] = wall


def incidence(hits: Hits) -> Floats:
    """Return the incidence (n,) [rad]."""
    return np.asarray(np.arccos(np.clip(hits.cos_incidence, 0, 1)))


def _glass(scene: Scene, rays: Rays, hits: Hits, glass: Hidden) -> None:
    through = scene.sees_section(hits, glass) & (incidence(hits) >= glass["alpha_ret"])
    m = np.flatnonzero(through)
    if glass["depth"] > 0:
        hits.ranges[m] += glass["depth"] / hits.cos_incidence[m]
        return
    dx, dy = rays.dx[m], rays.dy[m]
    scene.follow(m, hits, rays.x[m] + dx * hits.ranges[m], rays.y[m] + dy * hits.ranges[m], dx, dy)


def _mirror(scene: Scene, rays: Rays, hits: Hits, mirror: Hidden) -> None:
    m = np.flatnonzero(scene.sees_section(hits, mirror))
    x, y = rays.x[m] + rays.dx[m] * hits.ranges[m], rays.y[m] + rays.dy[m] * hits.ranges[m]
    nx, ny = scene.normals[mirror.wall]
    into = rays.dx[m] * nx + rays.dy[m] * ny
    scene.follow(m, hits, x, y, rays.dx[m] - 2 * into * nx, rays.dy[m] - 2 * into * ny)


def _door(scene: Scene, rays: Rays, hits: Hits, door: Hidden) -> None:
    """Open a door into a small room behind the wall; the leaf swings inside that room."""
    m = np.flatnonzero(scene.sees_section(hits, door) & (rays.stamps > door["t0"]))
    x, y, dx, dy = rays.x[m], rays.y[m], rays.dx[m], rays.dy[m]
    behind, _, _ = cast(x, y, dx, dy, door.shapes["behind"], np.full(m.size, -1))
    angle = np.clip((rays.stamps[m] - door["t0"]) / door["dt"], 0, 1) * door["angle"]
    c, s = np.cos(angle), np.sin(angle)
    (hinge_x, hinge_y), (leaf_x, leaf_y) = door.shapes["hinge"], door.shapes["leaf"]
    tip = (hinge_x + c * leaf_x - s * leaf_y, hinge_y + s * leaf_x + c * leaf_y)
    hits.ranges[m] = np.minimum(behind, to_segment(x, y, dx, dy, (hinge_x, hinge_y, *tip)))
    hits.cos_incidence[m] = COS_SOFT


def _curtain(scene: Scene, rays: Rays, hits: Hits, curtain: Hidden) -> None:
    """Hang a curtain before a section of a wall; waves run along it."""
    m = np.flatnonzero(scene.sees_section(hits, curtain))
    wave = 2 * np.pi * (rays.stamps[m] / curtain["T"] + hits.along[m] / curtain["wave"])
    before = curtain["off"] + curtain["sway"] * np.sin(wave)  # [m]
    hits.ranges[m] -= np.minimum(before / np.maximum(hits.cos_incidence[m], 0.2), 0.5 * hits.ranges[m])


def _fence(scene: Scene, rays: Rays, hits: Hits, fence: Hidden) -> None:
    ranges = to_segment(rays.x, rays.y, rays.dx, rays.dy, fence.shapes["ends"])
    _replace(hits, (ranges < hits.ranges) & (rays.chance < fence["p"]), ranges, COS_SOFT)


def _dust(scene: Scene, rays: Rays, hits: Hits, dust: Hidden) -> None:
    enters, leaves = through_disc(rays.x, rays.y, rays.dx, rays.dy, dust["x"], dust["y"], dust["r"])
    leaves = np.minimum(leaves, hits.ranges)
    way = np.where(np.isfinite(enters), np.maximum(leaves - enters, 0), 0)
    free = -np.log(np.maximum(rays.chance, 1e-12)) / dust["mu"]
    _replace(hits, free < way, enters + free, 1.0)


def _replace(hits: Hits, m: Booleans, ranges: Floats, cosine: float) -> None:
    hits.ranges[m] = ranges[m]
    hits.cos_incidence[m] = cosine
    hits.wall[m] = -1


def _leg(rays: Rays, hits: Hits, leg: Leg) -> None:
    there = np.interp(rays.stamps, leg.stamps, leg.is_there) > 0.5
    if not there.any():
        return
    stamps = rays.stamps[there]
    x, y = np.interp(stamps, leg.stamps, leg.x), np.interp(stamps, leg.stamps, leg.y)
    ranges, _ = through_disc(rays.x[there], rays.y[there], rays.dx[there], rays.dy[there], x, y, leg.radius)
    nearer = ranges < hits.ranges[there]
    m = np.flatnonzero(there)[nearer]
    hits.ranges[m] = ranges[nearer]
    hits.is_person[m] = True
    hits.cos_incidence[m] = COS_SOFT
    hits.wall[m] = -1


IN_THE_WAY: dict[str, Callable[[Scene, Rays, Hits, Hidden], None]] = {
    "glass": _glass,
    "mirror": _mirror,
    "f_door": _door,
    "f_curtain": _curtain,
    "f_fence": _fence,
    "f_dust": _dust,
}
"""In the order in which they act."""
