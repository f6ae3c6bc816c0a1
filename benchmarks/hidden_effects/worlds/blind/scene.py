"""What stands in the way of a ray: walls, and what glass, mirrors, doors, curtains, dust and people make of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np

from benchmarks.hidden_effects.log import Booleans, Floats, Ints
from benchmarks.hidden_effects.worlds.blind.effects import Hidden, Secrets
from benchmarks.hidden_effects.worlds.blind.people import Leg


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
