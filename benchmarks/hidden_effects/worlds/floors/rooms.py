"""Rooms: an outline with piers and furniture, cut from the 21 plans of KTH, and the map in pixels."""

from __future__ import annotations

import functools
import gzip
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from shapely import affinity
from shapely.geometry import Point, Polygon, box, shape
from shapely.geometry.base import BaseGeometry

from benchmarks.hidden_effects import geometry
from benchmarks.hidden_effects.case import Redraw
from benchmarks.hidden_effects.geometry import largest_part
from benchmarks.hidden_effects.log import Floats

OUTLINE = "floor"
"""Name of the ring around the free space."""
PIER = "pier"
"""Names of things that belong to the building begin so."""
RESOLUTION = 0.05
"""[m] of a raster map."""
MARGIN = 0.3
"""[m] of unknown cells around a raster map."""
FREE, OCCUPIED, UNKNOWN = 254, 0, 205


@dataclass(frozen=True, kw_only=True, eq=False)
class Room(geometry.Room):
    """The outline of a part of a floor, its piers and its furniture."""

    floor: str
    """Name of the floor that it was cut from."""

    @property
    def furniture(self) -> list[str]:
        """Names of what may be moved."""
        return [name for name in self.obstacles if not name.startswith(PIER)]

    def free(self) -> BaseGeometry:
        """Return the free space; rings of a changed room may cross themselves."""
        free: BaseGeometry = Polygon(self.outer)
        for name in self.obstacles:
            free = free.difference(Polygon(self.rings[name]).buffer(0))
        return free


def raster(room: Room) -> dict[str, str | bytes]:
    """Return the files of a map as map_server does: arena.pgm and arena.yaml; unknown outside and inside of things."""
    outline = room.outer
    x0, y0 = np.floor((outline.min(0) - MARGIN) / RESOLUTION) * RESOLUTION
    nx, ny = np.ceil((outline.max(0) + MARGIN - (x0, y0)) / RESOLUTION).astype(int)
    free = room.free()
    shapely.prepare(free)
    x, y = np.meshgrid(x0 + (np.arange(nx) + 0.5) * RESOLUTION, y0 + (np.arange(ny) + 0.5) * RESOLUTION)
    image = np.where(shapely.contains_xy(free, x, y), FREE, UNKNOWN).astype(np.uint8)
    for wall in room.walls:
        length = np.hypot(wall[2] - wall[0], wall[3] - wall[1])
        share = np.linspace(0, 1, int(length / (RESOLUTION / 10)) + 2)
        column = ((wall[0] + share * (wall[2] - wall[0]) - x0) / RESOLUTION).astype(int)
        row = ((wall[1] + share * (wall[3] - wall[1]) - y0) / RESOLUTION).astype(int)
        image[row, column] = OCCUPIED
    return {
        "arena.pgm": b"P5\n%d %d\n255\n" % (nx, ny) + image[::-1].tobytes(),
        "arena.yaml": f"image: arena.pgm\nresolution: {RESOLUTION}\norigin: [{x0:.4f}, {y0:.4f}, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.25\n",
    }


KINDS = ("desk", "cabinet", "bin", "ldesk", "sofa", "plant")


def piece(kind: str, rng: np.random.Generator) -> Polygon:
    """Return a piece of furniture [m] near the origin."""
    if kind == "desk":
        return box(0, 0, rng.uniform(1.0, 1.6), rng.uniform(0.6, 0.8))
    if kind == "cabinet":
        return box(0, 0, rng.uniform(0.6, 1.2), rng.uniform(0.35, 0.5))
    if kind == "bin":
        return Point(0, 0).buffer(rng.uniform(0.15, 0.25), quad_segs=3)
    if kind == "ldesk":
        a, b = rng.uniform(1.2, 1.7, 2)
        d = rng.uniform(0.5, 0.7)
        return Polygon([(0, 0), (a, 0), (a, d), (d, d), (d, b), (0, b)])
    if kind == "sofa":
        a = rng.uniform(1.3, 1.9)
        back, arm = 0.8, 0.2
        return Polygon(
            [(0, 0), (a, 0), (a, back), (a - arm, back), (a - arm, 0.3), (arm, 0.3), (arm, back), (0, back)]
        )
    return Polygon([(0, 0), (0.5, 0), (0.62, 0.35), (0.25, 0.6), (-0.12, 0.35)])


def rectangle(x: float, y: float, length: float, width: float, yaw: float) -> Polygon:
    """Return a rectangle [m] about (x, y), turned by yaw [rad]."""
    flat = box(-length / 2, -width / 2, length / 2, width / 2)
    turned = affinity.rotate(flat, yaw, origin=(0, 0), use_radians=True)
    return affinity.translate(turned, x, y)


FOLDER = Path(__file__).parents[5] / "shared" / "data" / "kth-floors"
"""FLOOR.geojson or FLOOR.geojson.gz of each."""
WALL = 0.012
"""[m], half of the thickness of a wall of the plan."""
SLACK = 0.08
"""[m] that the robot keeps to all walls."""
MOST_ATTEMPTS = 400
MOST_PIECES_TRIED = 250
LEAST_PIECES = 3


def floor_files(folder: Path) -> tuple[Path, ...]:
    """Return the files of the floors, by their names; an error says what is missing."""
    found = [path for path in folder.glob("*") if path.name.removesuffix(".gz").endswith(".geojson")]
    if not found:
        raise FileNotFoundError(
            f"{folder}: holds no FLOOR.geojson or FLOOR.geojson.gz; "
            "name the folder of the floors of KTH with --floors"
        )
    return tuple(sorted(found, key=lambda path: path.name.removesuffix(".gz")))


@functools.lru_cache(maxsize=32)
def free_space(path: Path) -> BaseGeometry:
    """Return the free space of a floor [m]."""
    text = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    arena: BaseGeometry = Polygon()
    walls = []
    for feature in json.loads(text)["features"]:
        part = shape(feature["geometry"])
        if feature["properties"].get("kind") == "arena":
            arena = part
        else:
            walls.append(part.buffer(WALL, join_style="mitre"))
    return arena.difference(shapely.union_all(walls))


def cut_room(rng: np.random.Generator, radius: float, floors: Sequence[Path]) -> Room:
    """Return a furnished part of a floor in which a robot of this radius [m] can drive."""
    for _ in range(MOST_ATTEMPTS):
        path = floors[int(rng.integers(len(floors)))]
        part = _part(rng, radius, free_space(path))
        if part is None:
            continue
        rings = {OUTLINE: _corners(part)}
        for i, hole in enumerate(part.interiors):
            if Polygon(hole).area > 0.01:
                rings[f"{PIER}_{i}"] = _corners(Polygon(hole))
        if not Polygon(rings[OUTLINE]).is_valid:
            continue
        room = Room(floor=path.name.split(".")[0], rings=rings)
        if isinstance(room.free(), Polygon) and _furnish(rng, radius, room) >= LEAST_PIECES:
            return room
    raise Redraw("no part of a floor is wide enough")


def _part(rng: np.random.Generator, radius: float, free: BaseGeometry) -> Polygon | None:
    """Cut a box out of the free space and put it near the origin, turned in one of four cases."""
    x0, y0, x1, y1 = free.bounds
    w, h = rng.uniform(6, 15, 2)
    if rng.random() < 0.3:
        w = rng.uniform(12, 22)
        h = rng.uniform(5, 9)
    if rng.random() < 0.5:
        w, h = h, w
    cx, cy = rng.uniform(x0, x1), rng.uniform(y0, y1)
    part = largest_part(free.intersection(box(cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2)))
    if part.area < 22:
        return None
    # slits narrower than 8 cm are no place for a map
    part = largest_part(part.buffer(-0.04, join_style="mitre").buffer(0.04, join_style="mitre"))
    part = largest_part(part.simplify(0.012))
    drivable = largest_part(part.buffer(-radius - SLACK))
    if part.area > 140 or drivable.area < 9 or drivable.area < 0.3 * part.area:
        return None
    near = largest_part(part.intersection(drivable.buffer(radius + 0.7, join_style="mitre")))
    if near.area < part.area * 0.8:
        return None
    x, y = rng.uniform(-6, 6, 2)
    x0, y0, x1, y1 = part.bounds
    part = affinity.translate(part, -(x0 + x1) / 2 + x, -(y0 + y1) / 2 + y)
    part = affinity.rotate(part, rng.choice([0, 0, 0, rng.uniform(-25, 25)]), origin=(x, y))
    part = shapely.geometry.polygon.orient(part)
    return part if len(part.exterior.coords) <= 120 else None


def _corners(polygon: Polygon) -> Floats:
    """Return the corners (n, 2) [m] of a polygon, counter-clockwise, without those that all but coincide."""
    corners = np.round(np.asarray(shapely.geometry.polygon.orient(polygon).exterior.coords)[:-1], 3)
    kept = [0]
    for i in range(1, len(corners)):
        if np.hypot(*(corners[i] - corners[kept[-1]])) > 0.015:
            kept.append(i)
    if np.hypot(*(corners[kept[-1]] - corners[0])) < 0.015:
        kept.pop()
    return np.asarray(corners[kept])


def _furnish(rng: np.random.Generator, radius: float, room: Room) -> int:
    """Add furniture to the room's rings, near to where the robot gets; return how many."""
    free = room.free()
    bare = largest_part(free.buffer(-radius - SLACK)).area
    wanted = int(rng.integers(3, 11))
    n = 0
    for _ in range(MOST_PIECES_TRIED):
        if n >= wanted:
            break
        kind = str(rng.choice(KINDS))
        thing = piece(kind, rng)
        turn = rng.choice([0, 90, 180, 270]) + rng.normal(0, 4)
        thing = affinity.rotate(thing, turn, origin="centroid")
        x0, y0, x1, y1 = free.bounds
        x, y = rng.uniform(x0, x1), rng.uniform(y0, y1)
        thing = affinity.translate(thing, x - thing.centroid.x, y - thing.centroid.y)
        if not free.contains(thing.buffer(0.03)):
            continue
        left = free.difference(thing)
        drivable = largest_part(left.buffer(-radius - SLACK))
        if drivable.area < 0.55 * bare or drivable.area < 6 or thing.distance(drivable) > radius + 0.5:
            continue
        free = left
        room.rings[f"{kind}_{n}"] = _corners(thing)
        n += 1
    return n
