"""How good the poses are that a run's own scans and wheels give.

    python -m benchmarks.locate relations            # aces against relations verified by hand
    python -m benchmarks.locate sharpness            # three raw logs; published corrected poses beside ours
    python -m benchmarks.locate offices --seeds 20   # simulated offices with truth: error and coverage
    python -m benchmarks.locate offices --map cells  # located in the office's occupancy grid, or in its drawn map

Real logs are looked for in ../shared/data (--data).
"""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

import logs
from benchmarks.arguments import parser_of, timed
from benchmarks.places import arena_named
from logs.run import Run
from logs.transforms import compose, difference, invert, wrap
from planners.maps.ros_map import of_grid
from planners.types import Floats, Ints
from sensorgraph.exporting.nav2 import map_of
from sensorgraph.localization.in_map import locate_in_map
from sensorgraph.localization.known_map import MapWalls
from sensorgraph.localization.locate import walls_of_place
from sensorgraph.localization.mapping import map_run
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of
from sensorgraph.localization.range_offset import with_ranges
from sensorgraph.localization.result import Localization
from sensorgraph.localization.scans import scan_points
from sensorgraph.recording.controllers import WallFollowing
from sensorgraph.recording.identified_world import ArenaWorld
from sensorgraph.world.drive import react
from sensorgraph.world.drivetrain import Drivetrain
from sensorgraph.world.robot import default_robot
from sensorgraph.world.simulate import simulate
from sensorgraph.world.wall_distance import WallDistance

RAW = ("aces", "intel", "fr079")
PUBLISHED = {"aces": "ple-aces", "intel": "ple-intel", "fr079": "ple-freiburg-079"}
RADIUS, MIN_NEIGHBOURS, LEFT_OUT = 0.2, 5, 3  # [m], points, scans before and after
SECONDS = 240.0  # [s] of a simulated drive: about two laps
SCALE, BIAS = 1.03, float(np.radians(3.0))  # of the simulated wheels: way and turn, [rad/m]


def relation_errors(run: Run, poses: Floats, relations: Floats) -> tuple[Floats, Floats]:
    """Return translation [m] and rotation [rad] errors of relations (n, 8) t1 t2 x y z roll pitch yaw.

    Kümmerle et al. 2009, eq. 4: the error of the motion between two times, by its own size.
    """
    stamps = run.stamps + run.epoch_ns * 1e-9
    first, second = (np.abs(stamps[:, None] - relations[:, k]).argmin(axis=0) for k in (0, 1))
    found = compose(invert(poses[first]), poses[second])
    error = compose(invert(relations[:, [2, 3, 7]]), found)
    return np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])


def relations_row(name: str, errors: tuple[Floats, Floats]) -> str:
    place, turn = errors[0], np.degrees(errors[1])
    return (
        f"{name:24s} {100 * place.mean():7.2f} ± {100 * place.std():6.2f} cm   {turn.mean():6.3f} ± {turn.std():.3f}°"
        f"   above 0.5 m: {100 * (place > 0.5).mean():.2f} %"
    )


def triangle_closures(relations: Floats) -> tuple[Floats, Floats, Ints]:
    """Return how far [m] and by how much [rad] three relations among three times miss the start, and which relations these are.

    No poses can meet relations that contradict each other: with n independent errors of one size, three relations miss by √3
    times that size.
    """
    steps: dict[float, dict[float, tuple[int, Floats]]] = {}
    for k, row in enumerate(relations):
        a, b, step = float(row[0]), float(row[1]), row[[2, 3, 7]]
        steps.setdefault(a, {})[b] = (k, step)
        steps.setdefault(b, {})[a] = (k, invert(step))
    corners = {
        tuple(sorted((a, b, c)))
        for a in steps
        for b in steps[a]
        for c in steps[b]
        if c != a and a in steps[c]
    }
    around = [(steps[a][b], steps[b][c], steps[c][a]) for a, b, c in sorted(corners)]
    missed = np.array([compose(compose(one[1], two[1]), three[1]) for one, two, three in around])
    used = np.unique([step[0] for sides in around for step in sides])
    return np.hypot(missed[:, 0], missed[:, 1]), np.abs(wrap(missed[:, 2])), used


def sharpness(points: Floats, scans: Ints, *, n: int = 20000, seed: int = 0) -> Floats:
    """Return distances [m] of returns from the line fitted to returns of other scans within `RADIUS`.

    Parameters
    ----------
    points : (n_points, 2) [m] in map
    scans : (n_points,) number of the scan of each; up to `LEFT_OUT` before and after do not count as others
    """
    rng = np.random.default_rng(seed)
    tree = cKDTree(points)
    chosen = rng.choice(len(points), min(n, len(points)), replace=False)
    out = []
    for k, near in zip(chosen, tree.query_ball_point(points[chosen], RADIUS), strict=True):
        others = np.array(near)[np.abs(scans[near] - scans[k]) > LEFT_OUT]
        if len(others) < MIN_NEIGHBOURS:
            continue
        off = points[others] - points[others].mean(axis=0)
        values, vectors = np.linalg.eigh(off.T @ off)
        if values[0] < 0.15 * values[1]:
            out.append(abs(float(vectors[:, 0] @ (points[k] - points[others].mean(axis=0)))))
    return np.array(out)


def in_map(run: Run, chosen: Ints, poses: Floats) -> tuple[Floats, Ints]:
    """Return points (n, 2) of some scans seen from their poses, and the number of their scan."""
    scans = scan_points(run, odometry_of(run))
    points, numbers = [], []
    for number, (k, (x, y, phi)) in enumerate(zip(chosen, poses, strict=True)):
        own = scans.points[scans.of(int(k))]
        c, s = np.cos(phi), np.sin(phi)
        points.append(own @ np.array([[c, s], [-s, c]]) + (x, y))
        numbers.append(np.full(len(own), number))
    return np.concatenate(points), np.concatenate(numbers)


def published_poses(data: Path, name: str, run: Run) -> tuple[Ints, Floats]:
    """Return scans of a raw log that the published log holds, too, and base_link there."""
    path = next((data / PUBLISHED[name]).glob("*.log*"))
    theirs = logs.read(path)
    ours = np.nan_to_num(np.where(np.isfinite(run.ranges), run.ranges, 0.0))
    other = np.nan_to_num(np.where(np.isfinite(theirs.ranges), theirs.ranges, 0.0))
    if ours.shape[1] != other.shape[1]:
        return np.zeros(0, dtype=np.intp), np.zeros((0, 3))
    distance, nearest = cKDTree(ours).query(other)
    same = distance < 0.02 * np.sqrt(other.shape[1])
    pose_at = {stamp: k for k, stamp in enumerate(theirs.pose_stamps)}
    rows = [(int(nearest[k]), pose_at[t]) for k, t in enumerate(theirs.stamps) if same[k] and t in pose_at]
    scans, poses = (np.array([row[i] for row in rows], dtype=np.intp) for i in (0, 1))
    order = np.argsort(scans, kind="stable")
    base = theirs.poses[poses[order]]
    if theirs.pose_frame == "laser":
        base = compose(base, np.broadcast_to(invert(run.sensor.mount), base.shape))
    return scans[order], base


def aligned(found: Floats, truth: Floats) -> tuple[Floats, Floats]:
    """Return errors (n, 3) after the best rigid motion (Umeyama 1991, without scale), and its turn (3, 3)."""
    a, b = found[:, :2] - found[:, :2].mean(axis=0), truth[:, :2] - truth[:, :2].mean(axis=0)
    angle = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.column_stack([a @ turn[:2, :2].T - b, wrap(found[:, 2] + angle - truth[:, 2])]), turn


def office_run(seed: int) -> tuple[Run, Floats]:
    """Follow the walls of a random office, which leads around it again and again; return true poses of the scans, too."""
    arena, robot = arena_named(str(seed)), default_robot()
    wheels = Drivetrain.of(robot)
    wheels.measured = np.array([[SCALE, 0.0], [BIAS, SCALE]])
    rng = np.random.default_rng([seed, 16])
    world, clearance = ArenaWorld(arena, robot, seed), WallDistance(arena)
    x0, y0, x1, y1 = arena.bounds
    places = rng.uniform((x0, y0), (x1, y1), size=(2000, 2))
    free = next(p for p in places if arena.contains(p) and clearance(float(p[0]), float(p[1])) > 0.6)
    start = np.array([*free, rng.uniform(-np.pi, np.pi)])
    drive = react(WallFollowing(robot, seed), world.scan, start, SECONDS, robot, clearance=clearance)
    run = simulate(drive, arena, robot, rng=rng, seed=seed, drivetrain=wheels)
    return run, drive.at(run.stamps)


def raw(data: Path, name: str) -> Run:
    return logs.read(data / "raw-carmen" / f"{name}.clf.bz2")


def compare_relations(data: Path) -> None:
    run = raw(data, "aces")
    relations = read_relations(data)
    motion = odometry_of(run)
    assert motion is not None
    print(relations_row("wheels", relation_errors(run, odometry_at_scans(run, motion), relations)))
    errors = relation_errors(run, map_run(run).poses, relations)
    print(relations_row("located", errors))
    place, turn, used = triangle_closures(relations)
    missed, own = (100 * np.sqrt((values**2).mean()) for values in (place / np.sqrt(3), errors[0][used]))
    print(
        f"{len(place)} triangles of {len(used)} relations miss their start by {100 * place.mean():.2f} cm, "
        f"{np.degrees(turn.mean()):.3f}°: the error of one relation is {missed:.2f} cm rms; located, on these, {own:.2f} cm rms"
    )


def compare_sharpness(data: Path) -> None:
    for name in RAW:
        run = raw(data, name)
        map_run(run.take_scans(slice(50)))  # compiles
        with timed() as took:
            found = map_run(run)
        print(f"{name}: {run.duration / took.cpu:.0f} x real time on one core; {found.wheels}")
        print("\n".join(f"  {note}" for note in found.notes if "sweep" in note or "ranges" in note))
        chosen, theirs = published_poses(data, name, run)
        if not len(chosen):
            print("  the published log holds other rays")
            continue
        for label, poses in (("published", theirs), ("located", found.poses[chosen])):
            taken = run
            if label == "located":  # with the ray times, bearings and ranges that were found
                taken = with_ranges(replace(run, sensor=found.sensor or run.sensor), found.range_offset)
            d = 100 * sharpness(*in_map(taken, chosen, poses))
            print(
                f"  {label:10s} {len(chosen)} scans: median {np.median(d):.2f} cm, within 5 cm {np.mean(d < 5):.3f}, "
                f"within 2 cm {np.mean(d < 2):.3f}"
            )


def read_relations(data: Path) -> Floats:
    with gzip.open(data / "raw-carmen" / "aces.relations.gz", "rt") as file:
        return np.loadtxt(file)


def place_of_office(seed: int, kind: str) -> MapWalls:
    """Return the walls of a random office as drawn, or of its occupancy grid of 5 cm."""
    arena = arena_named(str(seed))
    if kind == "cells":
        grid = map_of(arena)
        arena = of_grid(grid.data, grid.resolution, grid.origin, "office")
    return walls_of_place(arena)


def compare_offices(seeds: int, first: int, kind: str) -> None:
    places, inside, sizes, whole = [], [], [], []
    for seed in range(first, first + seeds):
        run, truth = office_run(seed)
        with timed() as took:
            found = (
                map_run(run)
                if kind == "none"
                else locate_in_map(run, **place_of_office(seed, kind)._asdict())
            )
        if kind == "none":
            errors, turn = aligned(found.poses, truth)
        else:
            errors, turn = difference(found.poses, truth), np.eye(3)
        place, covered, z = judged(errors, turn, found)
        places.append(place)
        inside.append(covered)
        sizes.append(z)
        whole.append((np.abs(errors[:, :2]).max(), run.duration / took.cpu))
        lost = sum(status != "ok" for status in found.status)
        print(
            f"office {seed}: {run.n_scans} scans, {run.duration:.0f} s, ATE {100 * place:.2f} cm, largest "
            f"{100 * np.hypot(*errors[:, :2].T).max():.2f} cm, within 2 s.e. {covered.round(3)}, rms z {z.round(2)}, "
            f"{len(found.kept)} closures, {len(found.refused)} refused, {lost} lost; {found.wheels}, "
            f"{run.duration / took.cpu:.0f} x real time"
        )
    rms = 100 * np.array(places)
    print(
        f"{'ATE' if kind == 'none' else 'error'} rms: median {np.median(rms):.2f} cm, 95 % {np.quantile(rms, 0.95):.2f} cm, worst {rms.max():.2f} cm"
    )
    print(f"within 2 s.e. (x, y, phi): {np.mean(inside, axis=0).round(3)}, all {np.mean(inside):.3f}")


def judged(errors: Floats, turn: Floats, found: Localization) -> tuple[float, Floats, Floats]:
    """Return ATE rms [m], and for x, y, phi the share within 2 standard errors and the rms of z."""
    sd = np.sqrt(np.einsum("fii->fi", turn @ found.covariances @ turn.T))
    z = errors / sd
    rms = float(np.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()))
    return rms, (np.abs(z) < 2).mean(axis=0), np.sqrt((z**2).mean(axis=0))


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("what", choices=("relations", "sharpness", "offices"))
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--seeds", type=int, default=20, help="offices to drive through")
    parser.add_argument("--first", type=int, default=0, help="seed of the first office")
    parser.add_argument(
        "--map", choices=("none", "drawn", "cells"), default="none", help="known map of an office"
    )
    options = parser.parse_args()
    if options.what == "relations":
        compare_relations(options.data)
    elif options.what == "sharpness":
        compare_sharpness(options.data)
    else:
        compare_offices(options.seeds, options.first, options.map)


if __name__ == "__main__":
    main()
