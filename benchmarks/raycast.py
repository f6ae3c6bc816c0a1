"""Ray casting side by side in one run: ours, plain numpy, shapely and MuJoCo, with the largest disagreement.

    pip install -e '.[bench]'
    OPENBLAS_NUM_THREADS=1 python -m benchmarks.raycast

Worlds: a 10 x 8 m room with boxes (60 walls) and a floor of furnished offices (2,000 walls); 360 rays a scan.
Each row is the best of several repeats, all rows of a world in turn within one process. `agreement` is the largest
difference of a range from plain numpy over the same rays; a ray more than 1 cm off is counted apart (`leaks`).
MuJoCo casts in 3-D against boxes 1 mm thick and leaks at corners: shown as it is.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import shapely

from benchmarks.arguments import parser_of
from benchmarks.measures import fastest
from logs.run import RangeSensor
from planners.arena import Arena
from sensorgraph.world.ray_intersection import nearest_walls_plain
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot_sensor import bearings

N_CAST_RAYS = 360


def arena_of(rings: list[np.ndarray]) -> Arena:
    """Make an Arena of an outer ring and obstacles."""
    walls = np.concatenate([np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in rings])
    free = shapely.Polygon(rings[0], [])
    free = free.difference(shapely.union_all([shapely.Polygon(ring) for ring in rings[1:]]))
    n = len(walls)
    return Arena(free=free, walls=walls, names=tuple(f"w/edge_{i}" for i in range(n)), surfaces=("wall",) * n)


def box(x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
    """Return the corners of a box (4, 2)."""
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


def room(rng: np.random.Generator) -> Arena:
    """Make a room with 14 boxes: 60 walls."""
    rings = [box(0, 0, 10, 8)]
    for i in range(14):
        x, y = 0.7 + 1.3 * (i % 7), 1.5 + 4.0 * (i // 7)
        w, h = rng.uniform(0.2, 0.8, 2)
        rings.append(box(x, y, x + w, y + h))
    return arena_of(rings)


def floor(rng: np.random.Generator) -> Arena:
    """Make a 60 x 46 m floor of 4 x 4 m rooms with doors and furniture: 2,000 walls."""
    rings = [box(0, 0, 60, 46)]
    for i in range(15):
        for j in range(11):
            x, y = 4.0 * i, 4.0 * j + 1.0
            rings.append(box(x + 0.05, y, x + 2.95, y + 0.1))  # a wall with a door beside it
            rings.append(box(x, y + 0.3, x + 0.1, y + 2.9))
            a, b, w, h = rng.uniform([0.4, 0.5, 0.1, 0.1], [2.0, 2.4, 1.4, 1.0])
            rings.append(box(x + a, y + b, x + a + w, y + b + h))
    rings += [box(0.3 + 14 * k, 45.3, 1.0 + 14 * k, 45.8) for k in range(4)]
    return arena_of(rings)


def rate(work: Callable[[], object], n_rays: int, repeats: int = 5) -> float:
    """Return rays per second of the fastest repeat."""
    return n_rays / fastest(work, repeats, time.perf_counter)


def plain(arena: Arena, poses: np.ndarray, sensor: RangeSensor, chunk: int) -> np.ndarray:
    """Cast with plain numpy, `chunk` rays at a time."""
    phi = (poses[:, 2:] + sensor.bearings).ravel()
    origins = np.repeat(poses[:, :2], sensor.n_rays, axis=0)
    ux, uy = np.cos(phi), np.sin(phi)
    parts = [slice(k, k + chunk) for k in range(0, len(phi), chunk)]
    ranges = np.concatenate([nearest_walls_plain(arena.walls, *origins[p].T, ux[p], uy[p])[0] for p in parts])
    return np.where(ranges <= sensor.range_max, ranges, np.inf)


def with_shapely(arena: Arena, poses: np.ndarray, sensor: RangeSensor) -> np.ndarray:
    """Cast with shapely: STRtree, then intersections."""
    lines = shapely.linestrings(arena.walls)
    tree = shapely.STRtree(lines)
    phi = (poses[:, 2:] + sensor.bearings).ravel()
    origins = np.repeat(poses[:, :2], sensor.n_rays, axis=0)
    ends = origins + sensor.range_max * np.stack([np.cos(phi), np.sin(phi)], axis=1)
    rays = shapely.linestrings(np.stack([origins, ends], axis=1))
    ray, line = tree.query(rays, predicate="intersects")
    distance = shapely.distance(shapely.intersection(rays[ray], lines[line]), shapely.points(origins[ray]))
    ranges = np.full(len(phi), np.inf)
    np.minimum.at(ranges, ray, distance)
    return ranges


def with_mujoco(arena: Arena, poses: np.ndarray, sensor: RangeSensor) -> Callable[[], np.ndarray]:
    """Prepare casting with MuJoCo's mj_multiRay against boxes 1 mm thick."""
    import mujoco

    spec = mujoco.MjSpec()
    for a, b in arena.walls:
        angle = np.arctan2(*(b - a)[::-1])
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[np.hypot(*(b - a)) / 2, 0.0005, 1.0],
            pos=[*(a + b) / 2, 0.0],
            quat=[np.cos(angle / 2), 0, 0, np.sin(angle / 2)],
        )
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)

    def work() -> np.ndarray:
        out = np.empty((len(poses), sensor.n_rays))
        geoms = np.zeros(sensor.n_rays, dtype=np.int32)
        for k, (x, y, phi) in enumerate(poses):
            direction = phi + sensor.bearings
            vectors = np.stack([np.cos(direction), np.sin(direction), np.zeros_like(direction)], axis=1)
            mujoco.mj_multiRay(
                model, data, np.array([x, y, 0.0]), vectors.ravel(), None, 1, -1, geoms, out[k], None,
                sensor.n_rays, sensor.range_max,
            )  # fmt: skip
        return np.where(out < 0, np.inf, out).ravel()

    return work


def compare(name: str, arena: Arena, rng: np.random.Generator, n_poses: int, n_slow: int) -> None:
    """Print one world's table."""
    sensor = RangeSensor(bearings=bearings(N_CAST_RAYS, 2 * np.pi), range_min=0.0, range_max=30.0)
    x0, y0, x1, y1 = arena.bounds
    poses = rng.uniform([x0, y0, -np.pi], [x1, y1, np.pi], (8 * n_poses, 3))
    poses = poses[arena.contains(poses[:, :2])][:n_poses]
    few = poses[:n_slow]
    truth = plain(arena, few, sensor, 256)
    chunk, best = max(
        ((c, rate(lambda c=c: plain(arena, few, sensor, c), truth.size, 3)) for c in (64, 256, 1024)),
        key=lambda pair: pair[1],
    )
    rows = [(f"plain numpy, {chunk} rays at a time (best)", best, truth)]
    ours = rate(lambda: cast(arena, poses, sensor), len(poses) * N_CAST_RAYS)
    ranges = cast(arena, few, sensor).ranges.ravel()
    rows.append(("**sensorgraph `cast`** (with incidence and wall)", ours, ranges))
    speed = rate(lambda: with_shapely(arena, few, sensor), truth.size, 2)
    rows.append(("shapely STRtree", speed, with_shapely(arena, few, sensor)))
    try:
        work = with_mujoco(arena, few, sensor)
        rows.append(("MuJoCo mj_multiRay, thin boxes", rate(work, truth.size, 3), work()))
    except ImportError:
        print("(MuJoCo is not installed: pip install -e '.[bench]')")
    print(f"\n{name}: {arena.n_walls} walls, {N_CAST_RAYS} rays a scan\n")
    print("| method | M rays/s | ours is faster by | agreement m | leaks |\n|---|---|---|---|---|")
    for label, speed, ranges in rows:
        with np.errstate(invalid="ignore"):
            apart = np.where(ranges == truth, 0.0, np.abs(ranges - truth))  # inf equals inf
        leaks = int((~(apart < 0.01)).sum())
        apart = apart[apart < 0.01].max()
        print(
            f"| {label} | {speed / 1e6:.3g} | {ours / speed:.1f}x | {apart:.1e} | {leaks} of {truth.size:,} |"
        )


def main() -> None:
    """Run both worlds."""
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=0)
    rng = np.random.default_rng(parser.parse_args().seed)
    compare("Room", room(rng), rng, 2000, 60)
    compare("Floor", floor(rng), rng, 1600, 12)


if __name__ == "__main__":
    main()
