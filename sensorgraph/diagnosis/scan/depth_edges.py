"""Edges in depth: rays that a small error of pose or map takes past the end of a surface, and what they read there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from sensorgraph.diagnosis.scan.corners_between_rays import corners_between_rays
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.silhouettes import silhouettes
from sensorgraph.types import Floats, Ints
from sensorgraph.world.beams import Beams
from sensorgraph.world.ray_order import is_full_turn, neighbouring_rays
from sensorgraph.world.robot import Tolerances

SETTINGS = SCAN.likelihood
MIN_END_RANGE = 0.05
"""[m] range of the nearer side of an edge, at least: map and pose errors turn it by their size over the range."""
MAX_CORNERS = 1.5
"""Corners a wall, of a map whose walls meet: closed outlines have one, scraps two."""
SLACK = 1e-3
"""[rad] by which the end of a wall may seem to lie outside of two rays that begin at different places."""
GRAZING = 0.02
"""Cosine against the normal, below which a ray does not meet the extension of a wall."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Edges:
    """Rays so near a step in depth that a small error of pose or map takes them to its other side."""

    index: tuple[Ints, Ints]
    """Indices (scan, ray) of k rays."""
    other: Floats
    """(k,) [m] what they would read on the other side."""
    spread: Floats
    """(k,) [m] standard deviation of that by small errors of pose and map, more where the other side is met at a slant; the
    noise of a reading aside."""
    chance: Floats
    """(k,) of being there."""


Rows = tuple[Ints, Ints, Floats, Floats, Floats]
"""Of k rays: scan, ray, what it would read on the other side [m], the spread of that [m], the chance of being there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Other:
    """What is met on the other side of edges."""

    wall: Ints
    """(k,) index; below 0 none of the map."""
    ranges: Floats
    """(k,) [m] from where it was met."""

    def of(self, some: Ints) -> _Other:
        """Return that of some edges."""
        return _Other(wall=self.wall[some], ranges=self.ranges[some])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Steps:
    """Pairs of neighbours that meet different walls."""

    scan: Ints
    """(k,)"""
    right: Ints
    """(k,) the right ray of each pair."""
    left: Ints
    gap: Floats
    """(k,) [rad] from the right ray to the left one."""
    nearer: Ints
    """(k,) that of the two which reads less."""

    @property
    def farther(self) -> Ints:
        """(k,) the other one."""
        return np.where(self.nearer == self.right, self.left, self.right)

    def away(self, ray: Ints, edge: Floats) -> Floats:
        """Return the angle (k,) [rad] between one of the rays and an edge, told from the right ray."""
        return np.where(ray == self.right, edge, self.gap - edge)

    def met_by(self, ray: Ints, beams: Beams) -> _Other:
        """Return what one of the rays meets."""
        return _Other(wall=beams.wall[self.scan, ray], ranges=beams.ranges[self.scan, ray])


def find_edges(data: ScanData, beams: Beams, walls: Floats) -> Edges | None:
    """Find the rays next to a step in depth, and what they would read beyond it; of several steps the likeliest counts."""
    ranges, wall = beams.ranges, beams.wall
    rights, lefts = neighbouring_rays(data.sensor)
    rows = [_passed_by(data, beams, walls, rights, lefts)]
    scan, pair = np.nonzero(wall[:, lefts] != wall[:, rights])
    right, left = rights[pair], lefts[pair]
    steps = _Steps(
        scan=scan,
        right=right,
        left=left,
        gap=_gap(data, beams, scan, right, left),
        nearer=np.where(ranges[scan, right] <= ranges[scan, left], right, left),
    )
    rows += _of_walls(data, beams, walls, steps) if _is_drawn(data) else _of_scraps(data, beams, walls, steps)
    index_scan, index_ray, beyond, spread, chance = (np.concatenate(part) for part in zip(*rows, strict=True))
    if len(chance) == 0:
        return None
    order = np.argsort(chance, kind="stable")  # the last that is written counts
    index = (index_scan[order], index_ray[order])
    return Edges(index=index, other=beyond[order], spread=spread[order], chance=chance[order])


def _gap(data: ScanData, beams: Beams, scan: Ints, right: Ints, left: Ints) -> Floats:
    """Return the angle [rad] from right rays to left ones, as they point: within a sweep a robot turns on."""
    told = (data.sensor.bearings[left] - data.sensor.bearings[right]) % (2 * np.pi)
    to_right, to_left = ((beams.ux[scan, ray], beams.uy[scan, ray]) for ray in (right, left))
    across = to_right[0] * to_left[1] - to_right[1] * to_left[0]
    along = to_right[0] * to_left[0] + to_right[1] * to_left[1]
    turned = (np.arctan2(across, along) - told + np.pi) % (2 * np.pi) - np.pi
    return np.maximum(told + turned, 0.0)


def _of_walls(data: ScanData, beams: Beams, walls: Floats, steps: _Steps) -> list[Rows]:
    """Let each ray pass the end of its own surface, and the farther one meet the nearer surface."""
    rows = list[Rows]()
    for own in (steps.farther, steps.nearer):  # the nearer last: its end is the other rays' edge, too
        edge = _end_angle(beams, walls, steps, own)
        blur = _blur_at(data.tolerances, beams.ranges[steps.scan, own])
        edge, last, beyond = _past_the_end(beams, walls, steps, own, edge, blur)
        ends = np.flatnonzero(np.isfinite(edge))
        rows.append(_beside(data, beams, walls, steps, own, beyond, edge, blur, ends))
    has_none, edge = np.flatnonzero(np.isnan(edge)), np.where(np.isnan(edge), steps.gap / 2, edge)
    onto_nearer = _Other(wall=last, ranges=beams.ranges[steps.scan, steps.nearer])
    every, far = np.arange(len(edge)), steps.met_by(steps.farther, beams)
    rows.append(_beside(data, beams, walls, steps, steps.farther, onto_nearer, edge, blur, every))
    rows.append(_beside(data, beams, walls, steps, steps.nearer, far, edge, blur, has_none))
    return rows


def _is_drawn(data: ScanData) -> bool:
    """Tell whether the walls of the map are whole: a map of pixels has steps, an identified one scraps that meet nowhere."""
    if data.grain > 0 or data.arena.is_identified:
        return False
    walls = data.arena.walls
    n = data.kept(b"corners", lambda: len(np.unique(walls.reshape(-1, 2), axis=0)))
    return n < MAX_CORNERS * len(walls)


def _of_scraps(data: ScanData, beams: Beams, walls: Floats, steps: _Steps) -> list[Rows]:
    """Let rays of both sides meet what the neighbour meets: where a scrap ends, no surface need end.

    Of a map of pixels also those further from the edge, as a cell is wider than their gap.
    """
    edge = _end_angle(beams, walls, steps, steps.nearer)
    edge = np.where(np.isnan(edge), steps.gap / 2, edge)
    blur = _blur_at(data.tolerances, beams.ranges[steps.scan, steps.nearer])
    rows = list[Rows]()
    for ray, other in ((steps.right, steps.left), (steps.left, steps.right)):
        onward = _onward(other, ray, data.n_rays)
        rays = [(steps.scan, ray, steps.met_by(other, beams), steps.away(ray, edge), blur)]
        while data.grain > 0 and len(rays[-1][0]):
            rays.append(_next_to(*rays[-1], onward, beams.wall, data.sensor.bearings))
        rows += [_beside_edge(data, beams, walls, *one) for one in rays]
    return rows


def _beside(
    data: ScanData,
    beams: Beams,
    walls: Floats,
    steps: _Steps,
    ray: Ints,
    other: _Other,
    edge: Floats,
    blur: Floats,
    some: Ints,
) -> Rows:
    """Return the rows of some of the steps for one of the rays of each."""
    away = steps.away(ray, edge)
    return _beside_edge(
        data, beams, walls, steps.scan[some], ray[some], other.of(some), away[some], blur[some]
    )


def _passed_by(data: ScanData, beams: Beams, walls: Floats, rights: Ints, lefts: Ints) -> Rows:
    """Return the rays beside which something stands that they pass, and their neighbours too: a leg between two rays.

    In a map of pixels the outline of a cell is no such thing, nor is a scrap; rays of several sensors have no common order.
    """
    sensor = data.sensor
    none = np.zeros(0, dtype=np.intp)
    if not _is_drawn(data) or sensor.is_composite or len(walls) == 0 or len(rights) == 0:
        return none, none, np.zeros(0), np.zeros(0), np.zeros(0)
    ox, oy = (np.ascontiguousarray(np.broadcast_to(part, beams.ux.shape)) for part in (beams.ox, beams.oy))
    chance, met = corners_between_rays(
        np.unique(walls.reshape(-1, 2), axis=0),
        walls,
        (ox, oy, beams.ux, beams.uy),
        np.minimum(beams.ranges - SETTINGS.min_edge_step * sensor.sigma, sensor.range_max),
        beams.wall,
        (rights, lefts),
        sensor.bearings[rights] - sensor.bearings[rights[0]],
        is_full_turn(sensor.bearings),
        _blur(data.tolerances),
        SETTINGS.min_edge_chance,
    )
    scan, ray = np.nonzero(chance > 0)
    return scan, ray, met[scan, ray], np.full(len(scan), _blur(data.tolerances)[1]), chance[scan, ray]


def _blur(t: Tolerances) -> tuple[float, float]:
    """Return by how much small errors turn a ray [rad], and move it against the map along each axis [m]."""
    return float(np.hypot(t.pose_yaw, t.mount_yaw)), float(np.sqrt(t.pose_xy**2 + t.map**2 + t.mount_xy**2))


def _past_the_end(
    beams: Beams, walls: Floats, steps: _Steps, own: Ints, edge: Floats, blur: Floats
) -> tuple[Floats, Ints, _Other]:
    """Follow the surfaces of rays to where they end for the eye; return that, the last walls, and what is met beyond.

    That is not always what the neighbour meets: between a leg and what stands beside it a wall may be seen.

    Parameters
    ----------
    own : (k,) the rays; where they are the nearer ones, their surfaces are followed however far away they end, as these ends
    are the other rays' edges, too
    edge : (k,) [rad] from the right ray to the end of the ray's wall; nan where it does not end between the rays
    """
    mine = steps.met_by(own, beams)
    beyond = steps.met_by(np.where(own == steps.right, steps.left, steps.right), beams)
    with np.errstate(invalid="ignore"):
        is_near = ndtr(-steps.away(own, edge) / blur) > SETTINGS.min_edge_chance
    is_near |= np.isfinite(edge) & (own == steps.nearer)
    some = np.flatnonzero((mine.wall >= 0) & is_near)
    ray = (steps.scan[some], steps.right[some])
    ox, oy = (np.broadcast_to(o, beams.ux.shape)[ray] for o in (beams.ox, beams.oy))
    is_right = (own == steps.right)[some]
    found = silhouettes(
        walls,
        (ox, oy),
        (beams.ux[ray], beams.uy[ray]),
        mine.wall[some],
        is_right,
        edge[some],
        steps.gap[some],
    )
    edge = edge.copy()
    edge[some], mine.wall[some] = found.edge, found.wall
    beyond.wall[some], beyond.ranges[some] = found.behind, found.ranges
    return edge, mine.wall, beyond


def _blur_at(t: Tolerances, ranges: Floats) -> Floats:
    """Return by how much small errors turn the direction [rad] in which something stands at these ranges [m]."""
    turn, place = _blur(t)
    return np.asarray(np.hypot(turn, place / np.maximum(ranges, MIN_END_RANGE)))


def _onward(behind: Ints, ahead: Ints, n_rays: int) -> Ints:
    """Return the neighbour ahead of each ray (n_rays,), -1 where there is none."""
    out = np.full(n_rays, -1, dtype=np.intp)
    out[behind] = ahead
    return out


def _next_to(
    scan: Ints,
    ray: Ints,
    other: _Other,
    away: Floats,
    blur: Floats,
    onward: Ints,
    wall: Ints,
    bearings: Floats,
) -> tuple[Ints, Ints, _Other, Floats, Floats]:
    """Return the rays one further from their edges, as far as they meet the same wall and the edge may be theirs."""
    further = onward[ray]
    is_near = ndtr(-away / blur) > SETTINGS.min_edge_chance
    some = np.flatnonzero((further >= 0) & (wall[scan, further] == wall[scan, ray]) & is_near)
    step = np.abs((bearings[further[some]] - bearings[ray[some]] + np.pi) % (2 * np.pi) - np.pi)
    return scan[some], further[some], other.of(some), away[some] + step, blur[some]


def _beside_edge(
    data: ScanData,
    beams: Beams,
    walls: Floats,
    scan: Ints,
    ray: Ints,
    other: _Other,
    away: Floats,
    blur: Floats,
) -> Rows:
    """Return the rays that may be beyond an edge."""
    chance = np.minimum(ndtr(-away / blur), 0.5)
    beyond, cosine = _extended(beams, walls, scan, ray, other)
    turn, place = _blur(data.tolerances)
    sine = np.sqrt(np.maximum(1 - cosine**2, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = np.hypot(turn * beyond * sine, place) / cosine
    spread = np.where(np.isfinite(beyond), np.minimum(spread, SCAN.nuisance.max_grazing_sigma), 0.0)
    own = beams.ranges[scan, ray]
    with np.errstate(invalid="ignore"):
        keep = (
            (chance > SETTINGS.min_edge_chance)
            & (np.abs(beyond - own) > SETTINGS.min_edge_step * data.sensor.sigma)
            & np.isfinite(own)
            & (beyond > 0)
            & (np.minimum(own, beyond) < data.sensor.range_max)  # else nothing comes back from either side
        )
    return scan[keep], ray[keep], beyond[keep], spread[keep], chance[keep]


def _end_angle(beams: Beams, walls: Floats, steps: _Steps, own: Ints) -> Floats:
    """Return the angle [rad] from the right ray to the end of the wall of one of the rays; nan where it has none there."""
    scan, right, gap = steps.scan, steps.right, steps.gap
    index = beams.wall[scan, own]
    best = np.full(len(scan), np.nan)
    if len(walls) == 0:
        return best
    known = index >= 0
    ux, uy = beams.ux[scan, right], beams.uy[scan, right]
    ox, oy = (np.broadcast_to(o, beams.ux.shape)[scan, right] for o in (beams.ox, beams.oy))
    towards = np.where(own == right, 1.0, -1.0)  # the other ray
    for end in (0, 1):
        corner = walls[np.where(known, index, 0), end]
        x, y = corner[:, 0] - ox, corner[:, 1] - oy
        angle = np.arctan2(ux * y - uy * x, ux * x + uy * y)
        fits = known & (angle >= -SLACK) & (angle <= gap + SLACK)
        angle = np.clip(angle, 0.0, gap)
        best = np.where(fits & ~(towards * best > towards * angle), angle, best)
    return best


def _extended(beams: Beams, walls: Floats, scan: Ints, ray: Ints, other: _Other) -> tuple[Floats, Floats]:
    """Return where a ray would meet the surface on the other side, extended, inf where that is nothing; and the cosine of
    the incidence there.
    """
    if len(walls) == 0:
        return other.ranges, np.ones(len(scan))
    a, b = walls[np.maximum(other.wall, 0)].transpose(1, 2, 0)  # (2, k) each
    length = np.maximum(np.hypot(*(b - a)), 1e-12)
    nx, ny = (b - a)[1] / length, (a - b)[0] / length
    ox = np.broadcast_to(beams.ox, beams.ux.shape)[scan, ray]
    oy = np.broadcast_to(beams.oy, beams.ux.shape)[scan, ray]
    across = beams.ux[scan, ray] * nx + beams.uy[scan, ray] * ny
    with np.errstate(divide="ignore", invalid="ignore"):
        r = ((a[0] - ox) * nx + (a[1] - oy) * ny) / across
    is_wall = other.wall >= 0
    usable = is_wall & (np.abs(across) > GRAZING) & (r > 0)
    return np.where(usable, r, other.ranges), np.where(is_wall, np.abs(across), 1.0)
