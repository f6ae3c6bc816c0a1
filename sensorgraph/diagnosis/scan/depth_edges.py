"""Edges in depth: rays that a small pose or map error moves past the end of a surface, and their range beyond it.

A ray at the angle `away` from an edge passes it with the probability chance = min(½, Phi(-away / blur)). The blur combines
the errors of heading and mount with those of place and map over the range of the nearer surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from sensorgraph.diagnosis.scan.corners_between_rays import corners_between_rays
from sensorgraph.diagnosis.scan.rays_behind_edges import GRAZING, add_rays_behind
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.silhouettes import silhouettes
from sensorgraph.types import Floats, Ints
from sensorgraph.world.beams import Beams
from sensorgraph.world.ray_order import is_full_turn, neighbouring_rays
from sensorgraph.world.robot import Tolerances

SETTINGS = SCAN.likelihood
MIN_END_RANGE = 0.05
"""[m] minimum range of the nearer side of an edge, because map and pose errors turn it by their size over the range."""
MAX_CORNERS = 1.5
"""Maximum number of corners per wall in a map of connected walls: closed outlines have one, separate fragments two."""
SLACK = 1e-3
"""[rad] tolerance for the end of a wall outside of two rays, which may have different origins."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Edges:
    """Rays so close to a step in depth that a small pose or map error moves them to its other side."""

    index: tuple[Ints, Ints]
    """Indices (scan, ray) of k rays."""
    other: Floats
    """(k,) [m] range on the other side."""
    spread: Floats
    """(k,) [m] standard deviation of `other` due to pose and map errors, without the noise of a reading.

    It increases with the incidence on the other side."""
    chance: Floats
    """(k,) probability of the other side."""


Rows = tuple[Ints, Ints, Floats, Floats, Floats]
"""k rays: scan, ray, range on the other side [m], its standard deviation [m], probability of the other side."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Other:
    """Surfaces on the other side of edges."""

    wall: Ints
    """(k,) index; negative where it is not a wall of the map."""
    ranges: Floats
    """(k,) [m] range at which the neighbour met it."""

    def of(self, some: Ints) -> _Other:
        """Return the surfaces of some edges."""
        return _Other(wall=self.wall[some], ranges=self.ranges[some])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Steps:
    """Pairs of neighbouring rays that meet different walls."""

    scan: Ints
    """(k,)"""
    right: Ints
    """(k,) right ray of each pair."""
    left: Ints
    gap: Floats
    """(k,) [rad] angle from the right ray to the left one."""
    nearer: Ints
    """(k,) ray with the smaller range."""

    @property
    def farther(self) -> Ints:
        """(k,) ray with the larger range."""
        return np.where(self.nearer == self.right, self.left, self.right)

    def away(self, ray: Ints, edge: Floats) -> Floats:
        """Return the angle (k,) [rad] between one of the rays and an edge; `edge` is measured from the right ray."""
        return np.where(ray == self.right, edge, self.gap - edge)

    def met_by(self, ray: Ints, beams: Beams) -> _Other:
        """Return the surface that one of the rays meets."""
        return _Other(wall=beams.wall[self.scan, ray], ranges=beams.ranges[self.scan, ray])


def find_edges(data: ScanData, beams: Beams, walls: Floats) -> Edges | None:
    """Find the rays next to a step in depth, and their range beyond it; each ray keeps its most likely step."""
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
    order = np.argsort(chance, kind="stable")  # the most likely one is written last and wins
    index = (index_scan[order], index_ray[order])
    return Edges(index=index, other=beyond[order], spread=spread[order], chance=chance[order])


def _gap(data: ScanData, beams: Beams, scan: Ints, right: Ints, left: Ints) -> Floats:
    """Return the actual angle [rad] from right rays to left ones, which changes if the robot turns during the sweep."""
    told = (data.sensor.bearings[left] - data.sensor.bearings[right]) % (2 * np.pi)
    to_right, to_left = ((beams.ux[scan, ray], beams.uy[scan, ray]) for ray in (right, left))
    across = to_right[0] * to_left[1] - to_right[1] * to_left[0]
    along = to_right[0] * to_left[0] + to_right[1] * to_left[1]
    turned = (np.arctan2(across, along) - told + np.pi) % (2 * np.pi) - np.pi
    return np.maximum(told + turned, 0.0)


def _of_walls(data: ScanData, beams: Beams, walls: Floats, steps: _Steps) -> list[Rows]:
    """Return rays that may pass the end of their surface, and far rays that may meet the nearer surface."""
    rows = list[Rows]()
    for own in (steps.farther, steps.nearer):  # nearer last: its end is also the edge for the other ray
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
    """Return whether the map has connected walls, unlike an occupancy-grid map (steps) or an identified one (fragments)."""
    if data.grain > 0 or data.arena.is_identified:
        return False
    walls = data.arena.walls
    n = data.kept(b"corners", lambda: len(np.unique(walls.reshape(-1, 2), axis=0)))
    return n < MAX_CORNERS * len(walls)


def _of_scraps(data: ScanData, beams: Beams, walls: Floats, steps: _Steps) -> list[Rows]:
    """Return the rays of both sides with the surface of their neighbour; a surface may continue where a fragment ends.

    In an occupancy-grid map, rays farther from the edge are included, because a cell is wider than the gap between rays.
    """
    edge = _end_angle(beams, walls, steps, steps.nearer)
    edge = np.where(np.isnan(edge), steps.gap / 2, edge)
    blur = _blur_at(data.tolerances, beams.ranges[steps.scan, steps.nearer])
    shape, sensor = beams.ux.shape, data.sensor
    best = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    ox, oy, ux, uy, ranges = (
        np.ascontiguousarray(np.broadcast_to(part, shape))
        for part in (beams.ox, beams.oy, beams.ux, beams.uy, beams.ranges)
    )
    limits = (
        -float(ndtri(SETTINGS.min_edge_chance)) if data.grain > 0 else 0.0,
        SETTINGS.min_edge_chance,
        SETTINGS.min_edge_step * sensor.sigma,
        float(sensor.range_max),
        SCAN.nuisance.max_grazing_sigma,
    )
    for ray, other in ((steps.right, steps.left), (steps.left, steps.right)):
        met = steps.met_by(other, beams)
        add_rays_behind(
            best,
            (steps.scan, ray, steps.away(ray, edge), blur),
            (met.wall, met.ranges),
            (ox, oy, ux, uy, ranges),
            beams.wall,
            walls,
            _onward(other, ray, data.n_rays),
            sensor.bearings,
            _blur(data.tolerances),
            limits,
        )
    scan, ray = np.nonzero(best[0] > 0)
    chance, beyond, spread = (part[scan, ray] for part in best)
    return [(scan, ray, beyond, spread, chance)]


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
    """Return the rows of some of the steps, for one of the two rays of each."""
    away = steps.away(ray, edge)
    return _beside_edge(
        data, beams, walls, steps.scan[some], ray[some], other.of(some), away[some], blur[some]
    )


def _passed_by(data: ScanData, beams: Beams, walls: Floats, rights: Ints, lefts: Ints) -> Rows:
    """Return the rays that pass close to a corner between two rays, such as a table leg.

    This applies only to maps with connected walls. The rays of several sensors are excluded, because they have no common order.
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
    """Return the standard deviations of a ray's direction [rad] and of its place relative to the map, along each axis [m]."""
    return float(np.hypot(t.pose_yaw, t.mount_yaw)), float(np.sqrt(t.pose_xy**2 + t.map**2 + t.mount_xy**2))


def _past_the_end(
    beams: Beams, walls: Floats, steps: _Steps, own: Ints, edge: Floats, blur: Floats
) -> tuple[Floats, Ints, _Other]:
    """Follow the surfaces of rays to their visible end; return its angle, the last walls, and the surfaces beyond.

    The surface beyond is not always the one that the neighbour meets: a wall may be visible between a leg and the next object.

    Parameters
    ----------
    own : (k,) The rays. The surface of the nearer ray is followed at any distance, because its end is also the edge
        for the other ray.
    edge : (k,) [rad] Angle from the right ray to the end of the ray's wall; nan if it does not end between the rays.
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
    """Return the standard deviation of the direction [rad] of an object at these ranges [m]."""
    turn, place = _blur(t)
    return np.asarray(np.hypot(turn, place / np.maximum(ranges, MIN_END_RANGE)))


def _onward(behind: Ints, ahead: Ints, n_rays: int) -> Ints:
    """Return the next ray (n_rays,) behind each one, away from the edge; -1 at the end."""
    out = np.full(n_rays, -1, dtype=np.intp)
    out[behind] = ahead
    return out


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
    """Return the rays that may see past an edge."""
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
            & (np.minimum(own, beyond) < data.sensor.range_max)  # otherwise neither side returns
        )
    return scan[keep], ray[keep], beyond[keep], spread[keep], chance[keep]


def _end_angle(beams: Beams, walls: Floats, steps: _Steps, own: Ints) -> Floats:
    """Return the angle [rad] from the right ray to the end of the wall of one of the rays; nan if it is not between them."""
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
    """Return the range at which a ray would meet the extended surface on the other side, and the cosine of its incidence.

    The range is inf where nothing is on the other side.
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
