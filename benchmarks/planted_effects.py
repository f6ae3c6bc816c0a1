"""Plant effects in a real log, and see whether the diagnosis names them against a commissioning stretch of the same site.

    OPENBLAS_NUM_THREADS=1 python benchmarks/planted_effects.py [LOG] [--effects bias,yaw] [--windows 0,3] [--half]

The log's poses come from the scans themselves (SLAM), and nobody drew a map. So the even scans of each unbroken
stretch of the log make a map of short surfaces, and the odd scans, some 90 rays of each, are the measurement, in two
windows. (A log with a scan every few seconds only is one stretch, in windows of 72 scans or a few more.) One window is the run under test, all others are known to be good: the commissioning. Effects are planted
in the window under test alone, by code of its own that knows nothing of the project's effects: ranges are altered, real
beams given another bearing, poses and stamps shifted. The laser reports whole centimetres, which robot.yaml says here;
`--undithered` leaves that and the commissioning out, and the diagnosis should find the lattice.

Prints, per effect and size: windows, how often it is named first, in how many another name stands first, the median
evidence and the median of the estimated size; and the names given on untouched windows.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from logs import Run, read
from planners.arena import Arena
from sensorgraph.diagnosis.commissioning import Commissioned, commission, merged
from sensorgraph.diagnosis.diagnose import Finding, diagnose
from sensorgraph.world.raycast import cast_laser
from sensorgraph.world.robot import Robot, default_robot

Floats = NDArray[np.float64]
LOG = Path(__file__).parents[2] / "shared" / "data" / "ple-freiburg-079" / "freiburg-079-corrected.log.gz"
FAR = 12.0  # [m] the map is made up to here; a longer reading counts as nothing seen
NEAR = 0.05  # [m] a shorter reading is broken
RAYS = 90  # of a scan that are measured, evenly spread
GAP = 3.0  # [s] without a scan: a dense log is broken here
SPARSE = 1.0  # [s] between scans: the log is taken as one stretch, whose map needs all of them
LONG = 72  # scans of a window of such a log
CELL = 0.08  # [m]
SIGMA = 0.015  # [m]


# --- the map: short surfaces -------------------------------------------------------------------------------


def ends(poses: Floats, ranges: Floats, bearings: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Return where rays end (n, 2) [m], and of which scan each is."""
    seen = np.isfinite(ranges) & (ranges > 2 * NEAR) & (ranges < FAR)
    scan, ray = np.nonzero(seen)
    angle = poses[scan, 2] + bearings[ray]
    r = ranges[seen]
    return poses[scan, :2] + r[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1), scan


def surfaces(
    poses: Floats, ranges: Floats, bearings: Floats, *, reach: float = 0.12, narrow: float = 0.008
) -> Floats:
    """Lay a short wall through each cell that three scans have met: (n, 2, 2) [m].

    Its line is the principal direction of the points around, weighted by distance (`reach`) and, robustly, by how far
    they are off the line (`narrow`).
    """
    points, scan = ends(poses, ranges, bearings)
    cells, index = np.unique(np.floor(points / CELL).astype(np.intp), axis=0, return_inverse=True)
    index = index.ravel()
    met = np.bincount(np.unique(index * len(poses) + scan) // len(poses), minlength=len(cells))
    centre = np.stack([np.bincount(index, p) for p in points.T], axis=1) / np.bincount(index)[:, None]
    good = np.flatnonzero(met >= 3)
    centre = centre[good]
    _, fine, count = np.unique(
        np.floor(points / 0.02).astype(np.intp), axis=0, return_inverse=True, return_counts=True
    )
    dots = np.stack([np.bincount(fine.ravel(), p) for p in points.T], axis=1) / count[:, None]
    near = cKDTree(dots).query_ball_point(centre, reach)
    j = np.concatenate([np.array(k, dtype=np.intp) for k in near])
    i = np.repeat(np.arange(len(good)), [np.size(k) for k in near])
    away = dots[j] - centre[i]
    kernel = count[j] * np.exp(-0.5 * (away**2).sum(axis=1) / (reach / 2) ** 2)
    weight = kernel
    for turn in range(6):
        total = np.bincount(i, weight)
        middle = np.stack([np.bincount(i, weight * a) for a in away.T], axis=1) / total[:, None]
        d = away - middle[i]
        xx, yy, xy = (
            np.bincount(i, weight * a) / total for a in (d[:, 0] ** 2, d[:, 1] ** 2, d[:, 0] * d[:, 1])
        )
        angle = 0.5 * np.arctan2(2 * xy, xx - yy)
        along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        off = d[:, 1] * along[i, 0] - d[:, 0] * along[i, 1]
        weight = kernel / (1 + (off / max(narrow, 0.04 * 0.5**turn)) ** 2)
    foot = centre + middle - (middle * along).sum(axis=1)[:, None] * along
    own = np.full(len(cells), -1)
    own[good] = np.arange(len(good))
    mine = own[index]
    kept = mine >= 0
    place = ((points[kept] - foot[mine[kept]]) * along[mine[kept]]).sum(axis=1)
    low, high = np.full(len(good), np.inf), np.full(len(good), -np.inf)
    np.minimum.at(low, mine[kept], place)
    np.maximum.at(high, mine[kept], place)
    return np.stack([foot + (low - 0.01)[:, None] * along, foot + (high + 0.01)[:, None] * along], axis=1)


def pruned(walls: Floats, poses: Floats, ranges: Floats, bearings: Floats) -> Floats:
    """Leave out surfaces that more rays pass through than meet."""
    for _ in range(3):
        expected, wall = cast_laser(walls, poses, bearings, 1e4)
        told = (wall >= 0) & ~np.isnan(ranges)
        excess = np.where(told, ranges, 0.0) - np.where(told, expected, 0.0)
        passed = np.bincount(wall[told & (excess > 0.15)], minlength=len(walls))
        stopped = np.bincount(wall[told & (np.abs(excess) < 0.15)], minlength=len(walls))
        walls = walls[(stopped >= np.maximum(1, passed)) | (stopped + passed == 0)]
    return walls


def aligned(walls: Floats, poses: Floats, ranges: Floats, bearings: Floats) -> Floats:
    """Move each pose a little so that its scan lies on the surfaces (point to line, robust)."""
    tangent = walls[:, 1] - walls[:, 0]
    tangent /= np.hypot(tangent[:, 0], tangent[:, 1])[:, None]
    width = np.array([0.012, 0.012, np.radians(0.25)])
    delta = np.zeros_like(poses)
    for _ in range(3):
        at = poses + delta
        expected, wall = cast_laser(walls, at, bearings, 1e4)
        seen = (wall >= 0) & np.isfinite(ranges)
        angle = at[:, 2:] + bearings
        ux, uy = np.cos(angle), np.sin(angle)
        nx, ny = tangent[np.where(seen, wall, 0), 1], -tangent[np.where(seen, wall, 0), 0]
        across = ux * nx + uy * ny
        off = (np.where(seen, ranges, 0.0) - np.where(seen, expected, 0.0)) * across
        r = np.where(seen, ranges, 0.0)
        rows = np.stack([nx, ny, r * (ux * ny - uy * nx)], axis=-1)
        weight = seen * (np.abs(across) > 0.2) / (1 + (off / SIGMA) ** 2) ** 2 / (2 * SIGMA) ** 2
        matrix = np.einsum("nmi,nm,nmj->nij", rows, weight, rows) + np.diag(width**-2)
        right = -np.einsum("nmi,nm->ni", rows, weight * off) - delta / width**2
        delta = delta + np.linalg.solve(matrix, right[..., None])[..., 0]
    return poses + delta


def site(poses: Floats, ranges: Floats, bearings: Floats) -> Arena:
    """Make a map of short surfaces, its own scans laid on it three times."""
    at = poses
    for turn in range(4):
        walls = pruned(surfaces(at, ranges, bearings), at, ranges, bearings)
        if turn < 3:
            at = aligned(walls, poses, ranges, bearings)
    low, high = walls.min(axis=(0, 1)) - 1, walls.max(axis=(0, 1)) + 1
    return Arena(
        free=shapely.box(*low, *high),
        walls=walls,
        names=tuple(f"site/edge_{k}" for k in range(len(walls))),
        surfaces=("wall",) * len(walls),
    )


# --- the runs ----------------------------------------------------------------------------------------------


def limited(ranges: Floats) -> Floats:
    """Code readings beyond FAR as nothing seen, those below NEAR as broken."""
    return np.where(ranges < NEAR, np.nan, np.where(ranges > FAR, np.inf, ranges))


def measured_rays(log: Run) -> NDArray[np.intp]:
    """Return which rays of the log are measured."""
    every = max(1, log.sensor.n_rays // RAYS)
    return np.arange(every // 2, log.sensor.n_rays, every)


def measurement(log: Run, scans: NDArray[np.intp]) -> Run:
    """Return some scans of the log, some 90 rays of each."""
    rays = measured_rays(log)
    sensor = replace(log.sensor, bearings=log.sensor.bearings[rays], range_max=FAR)
    return replace(
        log,
        sensor=sensor,
        stamps=log.stamps[scans],
        ranges=limited(log.ranges[scans][:, rays]),
        pose_stamps=log.stamps[scans],
        poses=log.poses[scans],
    )


def robot(log: Run, resolution: float) -> Robot:
    """Describe the laser, and what the poses of such a log deserve."""
    told = default_robot()
    sensor = replace(
        measurement(log, np.arange(1)).sensor, range_min=0.0, sigma=SIGMA, resolution=resolution, height=0.3
    )
    tolerances = replace(told.tolerances, pose_xy=0.012, pose_yaw=float(np.radians(0.25)))
    return replace(told, sensor=sensor, tolerances=tolerances)


@dataclass(frozen=True)
class Window:
    """A stretch of the log, and the map of its surroundings."""

    name: str
    scans: NDArray[np.intp]
    arena: Arena


def windows(log: Run) -> Iterator[Window]:
    """Cut the log where it is broken, and every stretch into two halves of odd scans; a sparse log is one stretch."""
    is_sparse = np.median(np.diff(log.stamps)) > SPARSE
    breaks = [] if is_sparse else np.flatnonzero(np.diff(log.stamps) > GAP) + 1
    cuts = [0, *breaks, log.n_scans]
    for low, high in pairwise(cuts):
        even, odd = np.arange(low, high, 2), np.arange(low + 1, high, 2)
        arena = site(log.poses[even], log.ranges[even], log.sensor.bearings)
        for part in np.array_split(odd, len(odd) // LONG if is_sparse else 2):
            yield Window(f"{part[0]}-{part[-1]}", part, arena)


# --- what is planted ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Plant:
    """One effect to be planted, with the name it should be given."""

    label: str
    name: str
    size: float
    unit: str
    act: Callable[[Run, Run, NDArray[np.intp], float, np.random.Generator], Run]
    """(measurement, whole log, its scans, size, rng) -> measurement with the effect."""
    read: str
    """Parameter of the named effect that is compared with the size."""
    scale: float = 1.0
    """Of the parameter, to be compared with the size."""


def _ranges(run: Run, ranges: Floats) -> Run:
    return replace(run, ranges=limited(ranges))


def bias(run: Run, log: Run, scans: NDArray[np.intp], size: float, rng: np.random.Generator) -> Run:
    """Lengthen every reading."""
    return _ranges(run, run.ranges + size)


def stretch(run: Run, log: Run, scans: NDArray[np.intp], size: float, rng: np.random.Generator) -> Run:
    """Scale every reading."""
    return _ranges(run, run.ranges * (1 + size))


def drift(run: Run, log: Run, scans: NDArray[np.intp], size: float, rng: np.random.Generator) -> Run:
    """Lengthen readings more and more."""
    t = (run.stamps - run.stamps[0]) / (run.stamps[-1] - run.stamps[0])
    return _ranges(run, run.ranges + size * t[:, None])


def sector(run: Run, log: Run, scans: NDArray[np.intp], size: float, rng: np.random.Generator) -> Run:
    """Lengthen the readings of a sector of 35 degrees."""
    first = np.radians(rng.uniform(-80, 45))
    inside = (run.sensor.bearings >= first) & (run.sensor.bearings < first + np.radians(35))
    return _ranges(run, run.ranges + size * inside)


def yaw(run: Run, log: Run, scans: NDArray[np.intp], size: float, rng: np.random.Generator) -> Run:
    """Give every ray the reading of the real beam that points further to the left by a whole count of rays."""
    step = float(np.diff(log.sensor.bearings).mean())
    turn = round(np.radians(size) / step)
    rays = measured_rays(log) + turn
    inside = (rays >= 0) & (rays < log.sensor.n_rays)
    ranges = log.ranges[scans][:, np.clip(rays, 0, log.sensor.n_rays - 1)]
    return _ranges(run, np.where(inside, ranges, np.nan))


def offset(run: Run, log: Run, scans: NDArray[np.intp], size: float, rng: np.random.Generator) -> Run:
    """Report poses of a body whose laser sits forward of where it is thought to be, or to a side."""
    angle = run.poses[:, 2] + rng.choice([0.0, np.pi / 2, np.pi, -np.pi / 2])
    poses = run.poses.copy()
    poses[:, 0] -= size * np.cos(angle)
    poses[:, 1] -= size * np.sin(angle)
    return replace(run, poses=poses)


def latency(run: Run, log: Run, scans: NDArray[np.intp], size: float, rng: np.random.Generator) -> Run:
    """Stamp scans late: they were taken where the robot was before; all poses of the stretch are told."""
    around = np.arange(scans[0], scans[-1] + 1)
    told = np.arange(
        log.stamps[scans[0]], log.stamps[scans[-1]], 0.1
    )  # scans between two far poses are dropped
    columns = [log.poses[around, 0], log.poses[around, 1], np.unwrap(log.poses[around, 2])]
    poses = np.stack([np.interp(told, log.stamps[around], column) for column in columns], axis=1)
    return replace(run, stamps=run.stamps + size, pose_stamps=told, poses=poses)


def occlusion(run: Run, log: Run, scans: NDArray[np.intp], size: float, rng: np.random.Generator) -> Run:
    """Hide a sector behind a part of the robot, 0.3 m away."""
    width = np.radians(size)
    first = rng.uniform(run.sensor.bearings[0], run.sensor.bearings[-1] - width)
    inside = (run.sensor.bearings >= first) & (run.sensor.bearings <= first + width)
    inside[np.argmin(np.abs(run.sensor.bearings - first - width / 2))] = True
    part = np.round(0.3 + rng.normal(size=run.ranges.shape) * 0.008, 2)
    hidden = inside & ~(run.ranges < part)
    return _ranges(run, np.where(hidden, part, run.ranges))


def cut_off(run: Run, log: Run, scans: NDArray[np.intp], size: float, rng: np.random.Generator) -> Run:
    """Lose what is farther."""
    return _ranges(run, np.where(run.ranges > size, np.inf, run.ranges))


def lattice(run: Run, log: Run, scans: NDArray[np.intp], size: float, rng: np.random.Generator) -> Run:
    """Round every reading."""
    return _ranges(run, np.round(run.ranges / size) * size)


def pillar(run: Run, log: Run, scans: NDArray[np.intp], size: float, rng: np.random.Generator) -> Run:
    """Stand a round pillar of this diameter in free space beside the path: of 400 places, the one most rays meet."""
    radius = size / 2
    best, most = run, 0
    for _ in range(400):
        k = rng.integers(len(run.stamps))
        away, angle = rng.uniform(0.6, 1.5), run.poses[k, 2] + rng.uniform(-1.2, 1.2)
        x, y = run.poses[k, 0] + away * np.cos(angle), run.poses[k, 1] + away * np.sin(angle)
        dx, dy = x - run.poses[:, :1], y - run.poses[:, 1:2]
        if np.hypot(dx, dy).min() < radius + 0.4:
            continue
        heading = run.poses[:, 2:] + run.sensor.bearings
        ahead = dx * np.cos(heading) + dy * np.sin(heading)
        aside = dx * np.sin(heading) - dy * np.cos(heading)
        with np.errstate(invalid="ignore"):
            r = ahead - np.sqrt(radius**2 - aside**2)
        met = (r > NEAR) & (run.ranges > r + 0.1)
        inside = (r > NEAR) & (run.ranges < r - 0.1)  # something real stands before it
        if met.sum() > most and inside.sum() < 0.2 * met.sum():
            seen = np.round(r + rng.normal(size=r.shape) * 0.008, 2)
            best, most = _ranges(run, np.where(met, seen, run.ranges)), int(met.sum())
    return best


def noise(run: Run, log: Run, scans: NDArray[np.intp], size: float, rng: np.random.Generator) -> Run:
    """Add noise in proportion to the range."""
    return _ranges(run, np.abs(run.ranges * (1 + size * rng.normal(size=run.ranges.shape))))


def outliers(run: Run, log: Run, scans: NDArray[np.intp], size: float, rng: np.random.Generator) -> Run:
    """Replace a share of the readings by any."""
    some = (rng.random(run.ranges.shape) < size) & ~np.isnan(run.ranges)
    return _ranges(run, np.where(some, np.round(rng.uniform(NEAR, FAR, run.ranges.shape), 2), run.ranges))


PLANTS = (
    Plant("bias", "range_bias", 0.03, "m", bias, "b"),
    Plant("offset", "mount_xy", 0.06, "m", offset, "dx,dy"),
    Plant("yaw", "mount_yaw", 1.0, "deg", yaw, "delta", 180 / np.pi),
    Plant("drift", "range_drift", 0.02, "m", drift, "b1"),
    Plant("sector 35 deg", "sector_bias", 0.06, "m", sector, "b"),
    Plant("occlusion", "self_occlusion", 3.0, "deg", occlusion, "theta2-theta1", 180 / np.pi),
    Plant("occlusion", "self_occlusion", 10.0, "deg", occlusion, "theta2-theta1", 180 / np.pi),
    Plant("max range", "max_range", 4.0, "m", cut_off, "R"),
    Plant("max range", "max_range", 2.5, "m", cut_off, "R"),
    Plant("lattice", "quantisation", 0.03, "m", lattice, "q"),
    Plant("lattice", "quantisation", 0.08, "m", lattice, "q"),
    Plant("pillar", "unmapped_obstacle", 0.20, "m", pillar, "r", 2.0),
)
HALF = (
    Plant("bias", "range_bias", 0.015, "m", bias, "b"),
    Plant("offset", "mount_xy", 0.03, "m", offset, "dx,dy"),
    Plant("yaw", "mount_yaw", 0.5, "deg", yaw, "delta", 180 / np.pi),
    Plant("drift", "range_drift", 0.01, "m", drift, "b1"),
    Plant("sector 35 deg", "sector_bias", 0.03, "m", sector, "b"),
    Plant("occlusion", "self_occlusion", 1.5, "deg", occlusion, "theta2-theta1", 180 / np.pi),
    Plant("occlusion", "self_occlusion", 5.0, "deg", occlusion, "theta2-theta1", 180 / np.pi),
    Plant("max range", "max_range", 6.0, "m", cut_off, "R"),
    Plant("lattice", "quantisation", 0.02, "m", lattice, "q"),
    Plant("pillar", "unmapped_obstacle", 0.10, "m", pillar, "r", 2.0),
)
ALSO = (
    Plant("latency", "latency", 0.12, "s", latency, "tau"),
    Plant("scale", "range_scale", 0.02, "", stretch, "s"),
    Plant("range noise", "range_noise", 0.02, "m/m", noise, "k"),
    Plant("outliers", "random_outliers", 0.05, "", outliers, "p"),
)


# --- the table ---------------------------------------------------------------------------------------------


def size_of(finding: Finding, plant: Plant) -> float:
    """Return the estimated size of the first effect, in the unit of what was planted."""
    values = finding.effects[0].parameters
    if plant.read == "dx,dy":
        return float(np.hypot(values["dx"], values["dy"]))
    if "-" in plant.read:
        last, first = plant.read.split("-")
        return float(values[last] - values[first]) * plant.scale
    return float(values[plant.read]) * plant.scale


def words(finding: Finding) -> str:
    """Say all names, with their evidence."""
    named = [f"{a.name} {a.evidence:.0f}" for a in finding.effects]
    return ", ".join(named) + (" [unknown]" if finding.unknown else "") or "-"


def main() -> None:
    """Plant, diagnose, count."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", nargs="?", type=Path, default=LOG)
    parser.add_argument("--effects", default="", help="labels, comma-separated; default: all")
    parser.add_argument("--windows", default="", help="numbers, comma-separated; default: all")
    parser.add_argument("--only", default="full,half,also", help="which lists of effects")
    parser.add_argument("--undithered", action="store_true", help="do not tell the resolution of the laser")
    parser.add_argument("--quiet", action="store_true", help="the table only")
    arguments = parser.parse_args()
    log = read(arguments.log)
    lists = {"full": PLANTS, "half": HALF, "also": ALSO}
    plants = [p for part in arguments.only.split(",") if part in lists for p in lists[part]]
    if arguments.effects:
        plants = [p for p in plants if p.label in arguments.effects.split(",")]
    wanted = [int(k) for k in arguments.windows.split(",")] if arguments.windows else None
    told = robot(log, 0.001 if arguments.undithered else 0.01)
    rows: dict[tuple[str, float], list[tuple[str, float, float]]] = {}
    untouched: list[tuple[str, Finding]] = []
    spent = []
    start = time.process_time()
    stretches = list(windows(log))
    good: list[Commissioned] = []
    if not arguments.undithered:
        good = [commission(measurement(log, w.scans), w.arena, told, learn=False) for w in stretches]
    took = time.process_time() - start
    print(f"{len(stretches)} windows, maps and commissioning {took:.0f} s", flush=True)
    for number, window in enumerate(stretches):
        if wanted is not None and number not in wanted:
            continue
        reference = merged([c for k, c in enumerate(good) if k != number]) if good else None
        if not arguments.quiet:
            print(f"window {number}, scans {window.name}, {window.arena.n_walls} surfaces")
            if reference is not None:
                print(f"  {reference.said('the others')}")
        run = measurement(log, window.scans)
        for plant in (None, *plants):
            rng = np.random.default_rng([number, 7])
            planted = run if plant is None else plant.act(run, log, window.scans, plant.size, rng)
            if plant is not None and planted is run:
                print(f"  {plant.label}: this window has no place for it")
                continue
            start = time.process_time()
            finding = diagnose(planted, window.arena, told, commissioned=reference, plan_next=False)
            spent.append(time.process_time() - start)
            if plant is None:
                untouched.append((window.name, finding))
                label = "untouched"
            else:
                first = finding.effects[0].name if finding.effects else ""
                right = first == plant.name
                nats = finding.effects[0].evidence or 0.0 if right else np.nan
                rows.setdefault((f"{plant.label} [{plant.name}]", plant.size), []).append(
                    (first, nats, size_of(finding, plant) if right else np.nan)
                )
                label = f"{plant.label} {plant.size:g} {plant.unit}"
            if not arguments.quiet:
                print(f"  {label:<22} {spent[-1]:5.1f} s  {words(finding)}", flush=True)
    print("| effect | size | windows | named first | another name | nats, median | size, median |")
    print("|---|---|---|---|---|---|---|")
    units = {(f"{p.label} [{p.name}]", p.size): (p.unit, p.name) for p in plants}
    for key, cases in rows.items():
        unit, name = units[key]
        found = sum(first == name for first, _, _ in cases)
        wrong = sum(first not in ("", name) for first, _, _ in cases)
        nats, size = (np.nanmedian([case[k] for case in cases]) if found else np.nan for k in (1, 2))
        print(
            f"| {key[0]} | {key[1]:g} {unit} | {len(cases)} | {found} | {wrong} | {nats:.0f} | {size:.3g} |"
        )
    false = [(name, words(finding)) for name, finding in untouched if finding.effects]
    doubted = sum(finding.unknown is not None for _, finding in untouched)
    print(
        f"untouched: {len(untouched)} windows, {len(false)} with a name {false}, {doubted} with something unknown"
    )
    print(f"CPU per diagnosis: median {np.median(spent):.1f} s, longest {max(spent):.1f} s")


if __name__ == "__main__":
    main()
