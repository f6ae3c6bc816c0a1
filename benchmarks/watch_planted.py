"""Faults of laser and wheels, and things in the place, planted into the second half of a raw log: does `watch` name them.

    python -m benchmarks.watch_planted ../shared/data/raw-carmen/fr079.clf.bz2 --work /tmp/in_map --part robot --n 50
    python -m benchmarks.watch_planted ../shared/data/raw-carmen/fr079.clf.bz2 --work /tmp/in_map --part place --n 60 --seed 1

The graph is of the first half, as in `benchmarks.watch`. Parts:

- `robot`: one fault of the size of the issue in each stretch, with a policy from the run of the graph. A stretch ends when the
  robot has driven for the time of the issue where the graph knows the surroundings; it may stand, and drive elsewhere, meanwhile
- `place`: up to `--n` things, round ones 20 to 50 cm wide and boards of 80 cm. In turn, they come, go, move by 15 to 50 cm (or
  turn, as a door does) and stay between the halves, where the robot passes at least three times. The graph is of the first half
  with those that stand there. A change is found if it is reported while the third pass lasts. Of the others,
  those are of the log itself where the raw readings of the halves differ: things that really changed
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import sensorgraph as sg
from benchmarks.arguments import log_of_halves, parser_of
from benchmarks.localize_in_map import Halves, halves, poses_at_scans
from benchmarks.particle_filter import driven
from benchmarks.planted_things import BOARD, Scans, Thing, chosen_things, passes_of, share_ending, with_things
from benchmarks.watch import Watched, clean_scans, good_run
from logs.run import Run
from logs.transforms import compose, invert
from planners.types import Bools, Floats, Ints
from sensorgraph.watching.place_changes import PlaceChange
from sensorgraph.watching.policy import learn
from sensorgraph.watching.watcher import watch_scans

DIFFERS = 0.2
"""Difference of the shares of rays that end at a place, from which the log itself differs between its halves."""
BESIDE = 0.15
"""[m] A change that is further from the rim of a thing is another one."""
PLANTS: Mapping[str, float] = {
    "healthy": 120.0, "blocked_sector": 5.0, "missing_returns": 60.0, "mount_yaw": 60.0, "range_bias": 120.0, "wheel_radius": 120.0,
}  # fmt: skip
"""Fault -> [s] of driving within which it must be named."""
MOVING = 0.03
"""[m/s + rad/s] Speed from which the robot drives."""


def planted(data: Halves, watched: Watched, name: str, rng: np.random.Generator) -> Watched:
    """Return the scans with one fault of the size of the issue."""
    ranges, odometry = watched.ranges, watched.odometry
    if name == "blocked_sector":
        first = int(rng.integers(20, data.second.sensor.n_rays - 40))
        width = round(np.radians(10) / abs(np.diff(data.second.sensor.bearings[:2])[0]))
        ranges = ranges.copy()
        ranges[:, first : first + width] = np.inf
    elif name == "missing_returns":
        ranges = np.where(rng.random(ranges.shape) < 0.05, np.inf, ranges)
    elif name == "mount_yaw":  # the laser is turned by 2 degrees: whole rays, and the rest interpolated
        bearings = data.second.sensor.bearings
        with np.errstate(invalid="ignore"):
            rows = np.where(np.isfinite(ranges), ranges, 1e6)
            ranges = np.array([np.interp(bearings + np.radians(2), bearings, row) for row in rows])
        ranges = np.where(ranges > data.second.sensor.range_max, np.inf, ranges)
    elif name == "range_bias":
        ranges = ranges + 0.03
    elif name == "wheel_radius":
        steps = compose(invert(odometry[:-1]), odometry[1:]) * [1.02, 1.02, 1.0]
        out = [odometry[0]]
        for step in steps:
            out.append(compose(out[-1], step))
        odometry = np.array(out)
    return replace(watched, ranges=ranges, odometry=odometry)


def driving_clock(watched: Watched, is_known: Bools) -> Floats:
    """Return the time [s] that the robot has driven at each scan (n_scans,), where the graph knows the surroundings."""
    steps = compose(invert(watched.odometry[:-1]), watched.odometry[1:])
    dt = np.diff(watched.stamps)
    moves = np.hypot(*steps[:, :2].T) + np.abs(steps[:, 2]) > MOVING * dt
    return np.concatenate([[0.0], np.cumsum(dt * (moves & is_known[1:]))])


def robot_part(data: Halves, n: int, faults: Mapping[str, float]) -> None:
    """Print how often planted faults are named, with a policy from the run of the graph."""
    sensor = data.second.sensor
    policy = learn([list(watch_scans(data.graph, good_run(data).observations(), sensor))])
    print(
        "baseline: " + ", ".join(f"{k} {v.value:.4f} ± {v.tolerance:.4f}" for k, v in policy.baseline.items())
    )
    scans = np.flatnonzero(np.isfinite(data.truth[:, 0]))
    whole, is_known = clean_scans(data, driven(data.second), scans), data.covered[scans]
    clock = driving_clock(whole, is_known)
    print(f"{clock[-1]:.0f} s of driving where the graph knows the surroundings")
    for name, limit in faults.items():
        rng = np.random.default_rng([*PLANTS].index(name))
        starts = np.flatnonzero(is_known & (clock + limit < clock[-1]))
        named: list[float] = []
        others: Counter[str] = Counter()
        for at in rng.choice(starts, n) if len(starts) else []:
            last = int(np.searchsorted(clock, clock[at] + limit))
            watched = planted(data, whole.at(np.arange(at, last)), name, rng)
            said = list(watch_scans(data.graph, watched.observations(), sensor, baseline=policy.baseline))
            when = next((s.t for s in said if any(fault.name == name for fault in s.faults)), None)
            if when is not None:
                named.append(float(np.interp(when, whole.stamps, clock)) - clock[at])
            others.update({fault.name for status in said for fault in status.faults} - {name})
        after = f" after {np.median(named):.0f} s in the median" if named else ""
        print(
            f"{name}: named in {len(named)} of {n if len(starts) else 0}{after}, other faults {dict(others)}"
        )


def scans_of(run: Run, poses: Floats, scans: Ints) -> Scans:
    """Return some scans of a run with their poses (n_scans, 3)."""
    return Scans(stamps=run.stamps[scans], poses=poses[scans], ranges=run.ranges[scans])


def graph_with(things: Sequence[Thing], first: Run, path: Path, rng: np.random.Generator) -> sg.Sensorgraph:
    """Return the graph of a located run with the things that stand there before; it is kept in a file."""
    if not path.exists():
        scans = scans_of(first, poses_at_scans(first)[0], np.arange(first.n_scans))
        stand = [(one.before, one.radius) for one in things if one.before is not None]
        sg.build(replace(first, ranges=with_things(scans, first.sensor, stand, rng)), calibrate=False).save(
            path
        )
    return sg.Sensorgraph.load(path)


def place_part(data: Halves, n: int, seed: int, path: Path) -> None:
    """Print how many planted changes are found by the third pass, and how many others are reported."""
    sensor, first = data.second.sensor, data.first
    poses, odometry, is_true = poses_at_scans(first)[0], driven(data.second), np.isfinite(data.truth[:, 0])
    watched = clean_scans(data, odometry, np.flatnonzero(is_true))
    all_scans, known = (
        scans_of(data.second, data.truth, np.flatnonzero(one)) for one in (is_true, is_true & data.covered)
    )
    located = scans_of(first, poses, np.flatnonzero(np.isfinite(poses[:, 0])))
    rng = np.random.default_rng(seed)
    things = list(chosen_things(located, all_scans, known, sensor, data.walls, n, rng))
    graph = graph_with(things, first, path, np.random.default_rng([seed, 1]))
    stand = [(one.after, one.radius) for one in things if one.after is not None]
    planted_scans = replace(watched, ranges=with_things(all_scans, sensor, stand, rng))
    told = list(watch_scans(graph, planted_scans.observations(), sensor))
    tally: dict[str, list[bool]] = {}
    for thing in things:
        third = passes_of(thing.places[-1], thing.radius, known, sensor)[2][1]
        when, said = next(
            ((s.t, change.kind) for s in told for change in s.changes if _is_of(change, thing)),
            (np.inf, "nothing"),
        )
        tally.setdefault(thing.kind, []).append(when <= third + 1.0)
        print(f"{thing}: third pass ends at {third:.0f} s, {said} reported at {when:.0f} s")
    for pair in told[-1].moved:
        own = [
            one for one in things if one.kind == "moved" and _is_of(pair.gone, one) and _is_of(pair.new, one)
        ]
        print(f"moved by {pair.distance:.2f} m, p {pair.p:.2f}: {own[0] if own else 'no thing that moved'}")
    others = [c for c in told[-1].changes if not any(_is_of(c, one) for one in things if one.kind != "stays")]
    n_real, hours = 0, float(np.ptp(watched.stamps)) / 3600
    for change in others:
        shares = [share_ending(change.centre, one, sensor) for one in (located, all_scans)]
        n_real += (shares[1] - shares[0]) * (1 if change.kind == "new" else -1) > DIFFERS
        print(
            f"other: {change.kind} at ({change.centre[0]:.1f}, {change.centre[1]:.1f}) m, {change.passes} passes, p {change.p:.2f}; "
            f"of the rays that come there, {shares[0]:.0%} end in the first half, {shares[1]:.0%} in the second"
        )
    counts = ", ".join(f"{kind} {sum(each)} of {len(each)}" for kind, each in tally.items())
    print(
        f"reported by the third pass: {counts}; other changes {len(others)} in {hours:.2f} h, {n_real} of them of the log itself"
    )


def _is_of(change: PlaceChange, thing: Thing) -> bool:
    """Tell whether a change is at a place of a thing."""
    half = change.size / 2 + (thing.radius or BOARD / 2) + BESIDE
    places = {"new": thing.after, "gone": thing.before}
    at = thing.places[-1] if thing.kind == "stays" else places[change.kind]
    return at is not None and bool((np.abs(at[:2] - change.centre) < half).all())


def main() -> None:
    """Print the tables."""
    parser = parser_of(__doc__)
    log_of_halves(parser)
    parser.add_argument("--part", choices=("robot", "place"), required=True)
    parser.add_argument("--n", type=int, default=8, help="number of things, at most")
    parser.add_argument("--seed", type=int, default=0, help="of the places of the things")
    parser.add_argument("--faults", nargs="+", choices=PLANTS, default=[*PLANTS])
    options = parser.parse_args()
    data = halves(options.log, options.work)
    if options.part == "place":
        name = f"{options.log.name}.first.planted_{options.n}_{options.seed}.sensorgraph"
        place_part(data, options.n, options.seed, options.work / name)
    else:
        robot_part(data, options.n, {name: PLANTS[name] for name in options.faults})


if __name__ == "__main__":
    main()
