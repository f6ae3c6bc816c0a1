"""Straight walls of an occupancy-grid map, and the borders of its free space without a wall.

A map_server map has thousands of walls of one pixel. Their outlines are approximated by the fewest straight
segments within a pixel, and each segment is fitted to the steps that it replaces. The walls run through the
middle of their cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from planners.arena import Arena
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.fewest_segments import DIGITAL, closed_corners

PREFIX = "map/edge_"
"""Prefix of the wall names of an occupancy-grid map; a number follows."""
OUTLINE, THING = "outline", "thing_"
"""Names of the straight walls: outlines of free space, and of objects in it."""
MIN_AROUND = 0.75
"""Minimum share of the outline of an object that free space touches."""
MAX_OBJECT = 4.0
"""[m] Maximum extent of an object; longer ones are part of the building."""
MIN_FREE = 100
"""[pixel²] Minimum area of free space for a robot; smaller parts are gaps between the cells of a thick wall."""
ROUND_OFF = 1e-4
"""[m] Precision of coordinates in files."""
MIN_WALLS = 40
"""Minimum number of walls of an occupancy-grid map; fewer are not worth straightening."""
SPECK = 0.2
"""[pixel] Shorter walls are remnants of single cells and are dropped."""
MIN_WALL = 1.5
"""[pixel] Minimum length of a separate segment of an outline."""
MIN_THIN = 3.0
"""[pixel] Minimum length of a row of cells that is a wall without thickness; shorter rows are boxes, which
are also visible from their ends."""
CURVE_STEP = 2
"""[pixel] Distance between corners of a round wall; steps are averaged over as much on each side [half
pixel]."""
MAX_OFF_LINES = 1.25
"""Maximum ratio of the scatter of cell borders around a circle to that around separate lines; circles of 3 to
20 pixels are below."""
MIN_BULGE = 0.5
"""[pixel] Minimum distance of an arc from its chord; a straight wall has less."""
LONG_RUN = 8.0
"""[pixel] Minimum length of a straight run on both sides of a single step at which the wall may have a jog
below one pixel."""
REGULAR = 2.25
"""[pixel] Maximum difference between the runs of a slanting wall: one, or two before a corner (steps are
halves)."""
MEETS = np.cos(np.arcsin(0.2))
"""Cosine of the turn below which two walls are nearly parallel and have no stable intersection."""


def is_raster(arena: Arena) -> bool:
    """Tell whether the walls of an arena are the borders of cells."""
    return arena.n_walls >= MIN_WALLS and all(name.startswith(PREFIX) for name in arena.names)


def pixel_of(arena: Arena) -> float:
    """Return the width of a cell [m]: the common divisor of all gaps between the rows and columns of borders."""
    ends = arena.walls.reshape(-1, 2) @ grid_axes(arena).T
    lines = [np.unique(np.round(ends[:, k], 6)) for k in (0, 1)]
    return float(
        reduce(_common_divisor, np.unique(np.round(np.concatenate([np.diff(at) for at in lines]), 6)))
    )


def _common_divisor(a: float, b: float) -> float:
    """Return the largest length that divides both, up to round-off."""
    while b > ROUND_OFF:
        a, b = b, abs(a - b * round(a / b))
    return a


def grid_axes(arena: Arena) -> Floats:
    """Return the directions of rows and columns of an occupancy-grid map, (2, 2) unit vectors; a map may be rotated."""
    x, y = arena.walls[0, 1] - arena.walls[0, 0]
    angle = (np.arctan2(y, x) + np.pi / 4) % (np.pi / 2) - np.pi / 4
    if abs(angle) < ROUND_OFF:
        return np.eye(2)
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def straightened(arena: Arena) -> tuple[Arena, float]:
    """Return an occupancy-grid arena with straight walls, and their r.m.s. distance [m] from the cell borders.

    A cell is occupied because a surface lies somewhere in it. So the borders are on average half a cell width
    before the surface, along its normal. A chain of short segments that turn the same way is a round object;
    its walls follow the outline every `CURVE_STEP` pixels. Walls without adjacent free space are dropped.
    """
    pixel, axes = pixel_of(arena), grid_axes(arena)
    cells = _along_grid(arena, axes)
    parts, is_gap = _parts_of_free(cells)
    free = shapely.union_all(parts[~is_gap])
    shapely.prepare(free)
    found = [_Outline(ring, free, pixel) for ring in _rings(cells.walls, free, pixel)]
    found.sort(key=lambda one: one.is_object)  # the first outline of an arena is not an obstacle
    walls, names, n_objects, n_outline_walls = [np.zeros((0, 2, 2))], list[str](), 0, 0
    for one in found:
        own = one.walls()
        own = own[np.hypot(*np.diff(own, axis=1)[:, 0].T) > SPECK * pixel]
        walls.append(own)
        if not len(own):
            continue
        if one.is_object:
            n_objects += 1
            names += [f"{THING}{n_objects}/edge_{i}" for i in range(len(own))]
        else:
            names += [f"{OUTLINE}/edge_{n_outline_walls + i}" for i in range(len(own))]
            n_outline_walls += len(own)
    straight = np.concatenate(walls)
    rms = float(
        np.sqrt(np.mean(np.concatenate([np.zeros(1), *(off for one in found for off in one.off)]) ** 2))
    )
    straight = straight @ axes
    return replace(arena, walls=straight, names=tuple(names), surfaces=("wall",) * len(straight)), rms


def _along_grid(arena: Arena, axes: Floats) -> Arena:
    """Return an occupancy-grid arena rotated so that rows and columns run along x and y."""
    if (axes == np.eye(2)).all():
        return arena
    free = shapely.transform(arena.free, lambda points: np.round(points @ axes.T, 9))
    return replace(arena, free=free, walls=np.round(arena.walls @ axes.T, 9))


def is_near_gap(arena: Arena, points: Floats) -> Bools:
    """Tell which points (n, 2) are within a pixel of a part of free space too small for a robot.

    Such a slit may be open to a ray although cells close it.
    """
    parts, is_gap = _parts_of_free(arena)
    if not is_gap.any():
        return np.zeros(len(points), dtype=np.bool_)
    gaps = shapely.union_all(parts[is_gap])
    shapely.prepare(gaps)
    return np.asarray(shapely.dwithin(gaps, shapely.points(points), pixel_of(arena)))


def _parts_of_free(arena: Arena) -> tuple[NDArray[np.object_], Bools]:
    """Return the connected parts (n,) of free space, and which are gaps."""
    parts = shapely.get_parts(arena.free)
    return parts, np.asarray(shapely.area(parts) <= MIN_FREE * pixel_of(arena) ** 2)


def _rings(walls: Floats, free: shapely.Geometry, pixel: float) -> list[Floats]:
    """Return the outlines (n, 2) of the faces between walls that contain free space.

    The other face at a wall, that of its cells, has the same outline, except where cells touch at a corner
    only.
    """
    steps = shapely.linestrings(walls)
    frame = shapely.box(*shapely.total_bounds(steps)).buffer(pixel, join_style="mitre")
    lines = shapely.union_all([shapely.union_all(steps), frame.exterior])
    faces = shapely.get_parts(shapely.polygonize([lines]))
    holds = shapely.area(shapely.intersection(faces, free)) > 0.5 * pixel**2
    rings = [ring for face in faces[holds] for ring in (face.exterior, *face.interiors)]
    return [np.array(ring.coords)[:-1] for ring in rings if not ring.equals(frame.exterior)]


class _Outline:
    """A closed outline of steps, and its straight segments."""

    def __init__(self, ring: Floats, free: shapely.Geometry, pixel: float) -> None:
        self.pixel = pixel
        far = int(np.argmax(np.hypot(*(ring - ring.mean(axis=0)).T)))  # start at a true corner
        self.steps = _dense(np.roll(ring, -far, axis=0), pixel)
        self.side = _side_of_cells(self.steps, free)
        # midpoints of the borders: a wall drawn in cells passes within half a pixel
        borders = self.steps[1::2]
        corners = closed_corners(borders / pixel, DIGITAL)
        self.kept: Floats = borders[corners]
        at = (2 * corners + 1).tolist()
        self.ends = list(zip(at, [*at[1:], at[0] + len(self.steps)], strict=True))
        self.lines: list[tuple[Floats, Floats]] = []
        self.off: list[Floats] = []
        for first, last in self.ends:
            self._fit(self._between(first, last))

    @property
    def is_object(self) -> bool:
        """Tell whether free space surrounds the outline almost completely, is not inside it, and the outline is small."""
        x, y = self.steps.T
        area = 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
        is_small = float(np.hypot(*np.ptp(self.steps, axis=0))) < MAX_OBJECT
        return is_small and area * float(self.side.sum()) > 0 and float(np.mean(self.side != 0)) > MIN_AROUND

    def _between(self, first: int, last: int) -> Floats:
        """Return the steps (n, 2) between two indices."""
        return np.asarray(self.steps[np.arange(first, last + 1) % len(self.steps)])

    def _fit(self, points: Floats) -> None:
        """Fit a line to steps (n, 2), and shift it to the surface behind them."""
        middles = (points[1:] + points[:-1]) / 2
        centre = middles.mean(axis=0)
        way = points[-1] - points[0]
        if len(middles) >= 2 * MIN_WALL:
            axis = np.linalg.svd(middles - centre, full_matrices=False)[2][0]
            way = axis if axis @ way >= 0 else -axis
            self.off.append((middles - centre) @ np.array([-way[1], way[0]]))
        way = way / max(float(np.hypot(*way)), 1e-9)
        self.lines.append((centre + self._behind(way), way))

    def _behind(self, way: Floats) -> Floats:
        """Return the offset [m] from cell borders to their surface, for unit directions (..., 2)."""
        across = np.stack([-way[..., 1], way[..., 0]], axis=-1)
        half_width = 0.5 * self.pixel * np.abs(way).sum(axis=-1, keepdims=True)
        return np.asarray(np.sign(self.side.sum()) * half_width * across)

    def walls(self) -> Floats:
        """Return straight walls (n, 2, 2) [m] for the part of the outline with adjacent free space."""
        n = len(self.lines)
        if n < 3:
            return self._thin_or_small()
        curved = self._curved()
        meets = [
            np.repeat(self._smooth(self.ends[k][:1]), 2, axis=0)
            if curved[k] and curved[k - 1]
            else self._meeting(k)
            for k in range(n)
        ]
        walls = [np.zeros((0, 2, 2))]
        for k, (first, last) in enumerate(self.ends):
            if not self.side[np.arange(first, last) % len(self.steps)].any():
                continue
            between = self._round(first, last) if curved[k] else self._jogs(k)
            chain = np.vstack([meets[k], between, meets[(k + 1) % n][:1]])
            walls.append(np.stack([chain[:-1], chain[1:]], axis=1))
        return np.concatenate(walls)

    def _thin_or_small(self) -> Floats:
        """Return the wall through the middle of a row of cells, or the outline of a few cells."""
        centre = self.steps.mean(axis=0)
        way = np.linalg.svd(self.steps - centre, full_matrices=False)[2][0]
        along = (self.steps - centre) @ way
        reach = np.array([along.min(), along.max()]) + 0.5 * self.pixel * np.array([1.0, -1.0])
        if reach[1] - reach[0] >= MIN_THIN * self.pixel:
            return np.asarray(centre + reach[:, None] * way)[None]
        is_corner = np.abs(np.roll(self.steps, -1, axis=0) - np.roll(self.steps, 1, axis=0)).min(axis=1) > 0
        ring = self.steps[is_corner]
        return np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)

    def _curved(self) -> list[bool]:
        """Tell which segments are chords of a round object: a circle through them fits as well as lines do.

        The circle also covers half of each neighbour, except a neighbour that turns the other way. A long
        wall between two jogs is near a large circle, but nearer its own line.
        """
        ways = np.array([way for _, way in self.lines])
        before = np.roll(ways, 1, axis=0)
        turn = np.arctan2(before[:, 0] * ways[:, 1] - before[:, 1] * ways[:, 0], (before * ways).sum(axis=1))
        after = np.roll(turn, -1)
        out = []
        for k, (first, last) in enumerate(self.ends):
            earlier, later = self.ends[k - 1], self.ends[(k + 1) % len(self.ends)]
            low, high = first - (earlier[1] - earlier[0]) // 2, last + (later[1] - later[0]) // 2
            is_one = turn[k] * after[k] > 0
            cuts = [(low, first, last, high)] if is_one else [(low, first, last), (first, last, high)]
            length = float(np.hypot(*(self.steps[last % len(self.steps)] - self.steps[first]))) / self.pixel
            fits = [_circle(self._borders(at[0], at[-1])) for at in cuts]
            out.append(
                any(
                    length**2 / 8 > MIN_BULGE * radius and spread <= MAX_OFF_LINES * self._off_lines(at)
                    for at, (radius, spread) in zip(cuts, fits, strict=True)
                )
            )
        return out

    def _borders(self, first: int, last: int) -> Floats:
        """Return the midpoints of the borders between two steps, (n, 2) [pixel]."""
        return np.asarray(self._between(first, last)[1::2] / self.pixel)

    def _off_lines(self, cuts: Sequence[int]) -> float:
        """Return the standard deviation [pixel] of borders around separate straight lines between consecutive cuts."""
        parts = [self._borders(first, last) for first, last in pairwise(cuts)]
        squares = sum(float((_off_line(part) ** 2).sum()) for part in parts)
        return float(np.sqrt(squares / max(sum(map(len, parts)) - 2 * len(parts), 1)))

    def _round(self, first: int, last: int) -> Floats:
        """Return the corners (n, 2) of a round object between two steps."""
        count = max(round((last - first) / (2 * CURVE_STEP)), 1)
        return self._smooth(np.linspace(first, last, count + 1)[1:-1].round().astype(np.intp))

    def _smooth(self, at: Sequence[int] | Ints) -> Floats:
        """Return points (n, 2) of the surface behind some steps (n,)."""
        around = np.arange(-CURVE_STEP, CURVE_STEP + 1)

        def mean(shift: int) -> Floats:
            return np.asarray(
                self.steps[(np.asarray(at)[:, None] + shift + around) % len(self.steps)].mean(axis=1)
            )

        way = mean(CURVE_STEP) - mean(-CURVE_STEP)
        way /= np.maximum(np.hypot(*way.T), 1e-9)[:, None]
        return np.asarray(mean(0) + self._behind(way))

    def _jogs(self, k: int) -> Floats:
        """Return two corners at each single step (n, 2) at which a straight segment may have a jog.

        A slanting wall steps at regular intervals; one or two steps between long runs may be jogs of the
        wall.
        """
        points = self._between(*self.ends[k])
        centre, way = self.lines[k]
        major = int(np.abs(way).argmax())
        at = np.flatnonzero(np.abs(np.diff(points[:, 1 - major])) > 0.1 * self.pixel)
        if not len(at):
            return np.zeros((0, 2))
        along = ((points[at] + points[at + 1]) / 2 - centre) @ way / self.pixel
        ends = (points[[0, -1]] - centre) @ way / self.pixel
        place = along[np.diff(along, prepend=-np.inf) > 1]  # two half pixels make one step
        place = place[(place > ends[0] + MIN_WALL) & (place < ends[1] - MIN_WALL)]  # its ends are corners
        runs = np.diff(np.concatenate([ends[:1], place, ends[1:]]))
        inner = runs[1:-1]
        if (
            len(inner) >= 2
            and inner.max() - inner.min() <= REGULAR
            and max(runs[0], runs[-1]) <= inner.max() + REGULAR
        ):
            return np.zeros((0, 2))
        place = place[np.minimum(runs[:-1], runs[1:]) >= LONG_RUN]
        pair = np.stack([place - 0.5, place + 0.5], axis=1).reshape(-1, 1) * self.pixel
        return np.asarray(centre + pair * way)

    def _meeting(self, k: int) -> Floats:
        """Return the end of the previous segment and the start of this one (2, 2): their intersection, if it is near."""
        (p, u), (q, v) = self.lines[k - 1], self.lines[k]
        ends = [self.kept[k], self.kept[k]]
        is_jog = abs(u @ v) > MEETS
        for i, (point, way) in enumerate(((p, u), (q, v))):
            across = np.array([-way[1], way[0]])
            ends[i] = ends[i] + ((point - ends[i]) @ across) * across + is_jog * (i - 0.5) * self.pixel * way
        if not is_jog:
            meet = p + float((q - p)[0] * v[1] - (q - p)[1] * v[0]) / float(u[0] * v[1] - u[1] * v[0]) * u
            if np.hypot(*(meet - np.mean(ends, axis=0))) < 2 * self.pixel:
                return np.repeat(meet[None], 2, axis=0)
        return np.array(ends)


def _side_of_cells(steps: Floats, free: shapely.Geometry) -> Floats:
    """Return the side of the cells at each step (n, 2) of an outline: 1 left, -1 right, 0 no adjacent free space."""
    ahead = np.roll(steps, -1, axis=0) - steps
    middles, aside = steps + ahead / 2, 0.5 * np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    left, right = (
        shapely.contains_xy(free, *(middles + side * aside).T).astype(np.float64) for side in (1, -1)
    )
    return np.asarray(right - left)


def _off_line(points: Floats) -> Floats:
    """Return the distances (n,) of points (n, 2) from their best line."""
    if not len(points):
        return np.zeros(0)
    apart = points - points.mean(axis=0)
    across = np.linalg.eigh(apart.T @ apart)[1][:, 0]
    return np.asarray(apart @ across)


def _circle(points: Floats) -> tuple[float, float]:
    """Return the radius of the circle fitted to points (n, 2) (Kasa 1976), and their standard deviation around it."""
    if len(points) < 4:
        return np.inf, np.inf
    middle = points.mean(axis=0)
    q = points - middle
    (x, y, c), *_ = np.linalg.lstsq(np.column_stack([2 * q, np.ones(len(q))]), (q**2).sum(axis=1), rcond=None)
    radius = float(np.sqrt(max(c + x * x + y * y, 0.0)))
    off = np.hypot(*(q - [x, y]).T) - radius
    return radius, float(np.sqrt((off**2).sum() / (len(off) - 3)))


def _dense(ring: Floats, pixel: float) -> Floats:
    """Return the outline with a point every half pixel."""
    line = shapely.LineString(np.vstack([ring, ring[:1]]))
    return np.array(shapely.segmentize(line, 0.5 * pixel * (1 + 1e-6)).coords)[:-1]


def unknown_borders(arena: Arena) -> Floats:
    """Return the borders (n, 2, 2) [m] of free space without a wall."""
    pixel = pixel_of(arena)
    walls = shapely.union_all(shapely.linestrings(arena.walls)).buffer(1e-4 * pixel, cap_style="flat")
    left = shapely.get_parts(arena.free.boundary.difference(walls))
    segments = [
        np.stack([c[:-1], c[1:]], axis=1) for c in (np.array(part.coords) for part in left) if len(c) > 1
    ]
    long = [s[np.hypot(*np.diff(s, axis=1)[:, 0].T) > 0.01 * pixel] for s in segments]
    return np.concatenate(long) if long else np.zeros((0, 2, 2))
