"""Faults of laser and wheels, and things in the place, planted into the second half of a raw log: does `watch` name them.

    python -m benchmarks.watch_planted ../shared/data/raw-carmen/fr079.clf.bz2 --work /tmp/in_map --part robot --n 50
    python -m benchmarks.watch_planted ../shared/data/raw-carmen/fr079.clf.bz2 --work /tmp/in_map --part place --n 8

The graph is of the first half, as in `benchmarks.watch`. Parts:

- `robot`: one fault of the size of the issue in each stretch, with a policy from the run of the graph. A stretch ends when the
  robot has driven for the time of the issue where the graph knows the surroundings; it may stand, and drive elsewhere, meanwhile
- `place`: `--n` round things of 30 cm that stand all the time where the robot passes at least three times; each is found if
  it is reported while the third pass lasts. The same log without them gives the changes that are reported anyway: people who
  stand, doors, and whatever else differs between the halves
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

import logs
from benchmarks.arguments import log_of_halves, parser_of
from benchmarks.localize_in_map import Halves, halves
from benchmarks.particle_filter import driven
from benchmarks.watch import Watched, clean_scans
from logs.run import RangeSensor
from logs.transforms import compose, invert
from planners.types import Bools, Floats
from sensorgraph.watching.place import PlaceChange
from sensorgraph.watching.policy import learn
from sensorgraph.watching.watcher import watch_scans

RADIUS = 0.15
"""[m] of a planted thing."""
IN_SIGHT, CLEAR, APART, NEAR = 4.0, 0.5, 2.0, 0.4
"""[m] Distance at which a thing counts as in sight; from walls and from the path; between things; of a change from its thing."""
GAP = 10.0
"""[s] out of sight, after which another pass begins."""


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
    poses, sensor = logs.pair(data.first).poses, data.second.sensor
    of_graph = Watched(
        stamps=data.first.stamps, ranges=data.first.ranges, odometry=driven(data.first), believed=poses, changed=len(poses)
    ).at(np.flatnonzero(np.isfinite(poses[:, 0])))  # fmt: skip
    policy = learn([list(watch_scans(data.graph, of_graph.observations(), sensor))])
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


def with_things(watched: Watched, sensor: RangeSensor, things: Floats) -> Watched:
    """Return the scans with round things (n, 2) [m] that stop the rays."""
    lasers = compose(watched.believed, np.tile(sensor.mount, (len(watched.stamps), 1)))
    ranges = watched.ranges.copy()
    angles = lasers[:, 2:] + sensor.bearings
    for thing in things:
        off = thing - lasers[:, :2]
        along = off[:, :1] * np.cos(angles) + off[:, 1:] * np.sin(angles)
        aside = off[:, :1] * np.sin(angles) - off[:, 1:] * np.cos(angles)
        meets = (np.abs(aside) < RADIUS) & (along > 0)
        reach = along - np.sqrt(np.where(meets, RADIUS**2 - aside**2, 0.0))
        ranges = np.where(meets & ~(ranges < reach), reach, ranges)
    return replace(watched, ranges=ranges)


def passes_of(watched: Watched, data: Halves, thing: Floats) -> list[tuple[float, float]]:
    """Return begin and end [s] of each pass with a thing in sight, ahead of the walls."""
    shown = with_things(watched, data.second.sensor, thing[None]).ranges < watched.ranges - 0.1
    near = np.hypot(*(watched.believed[:, :2] - thing).T) < IN_SIGHT
    stamps = watched.stamps[near & (shown.sum(axis=1) >= 3)]
    if len(stamps) == 0:
        return []
    cuts = np.flatnonzero(np.diff(stamps) > GAP)
    first, last = np.concatenate([[0], cuts + 1]), np.concatenate([cuts, [len(stamps) - 1]])
    return [(float(stamps[a]), float(stamps[b])) for a, b in zip(first, last, strict=True)]


def chosen_things(watched: Watched, data: Halves, n: int, rng: np.random.Generator) -> Iterator[Floats]:
    """Yield places of things: off the path, off the walls, apart, with three passes."""
    found: list[Floats] = []
    ends = data.walls.reshape(-1, 2)
    for _ in range(2000):
        at = watched.believed[rng.integers(len(watched.stamps)), :2] + rng.uniform(-2.0, 2.0, 2)
        is_free = np.hypot(*(watched.believed[:, :2] - at).T).min() > CLEAR
        is_free &= np.hypot(*(ends - at).T).min() > CLEAR
        is_free &= all(np.hypot(*(one - at)) > APART for one in found)
        if is_free and len(passes_of(watched, data, at)) >= 3:
            found.append(at)
            yield at
        if len(found) == n:
            return


def place_part(data: Halves, n: int, rng: np.random.Generator) -> None:
    """Print how many planted things are found by the third pass, and how many changes are reported besides."""
    odometry, is_true = driven(data.second), np.isfinite(data.truth[:, 0])
    watched = clean_scans(data, odometry, np.flatnonzero(is_true))
    seen = clean_scans(data, odometry, np.flatnonzero(is_true & data.covered))
    things = np.array(list(chosen_things(seen, data, n, rng))).reshape(-1, 2)
    hours = float(np.ptp(watched.stamps)) / 3600
    *_, last = watch_scans(data.graph, watched.observations(), data.second.sensor)
    plain = last.changes
    print(f"without things: {len(plain)} changes, {len(plain) / hours:.1f} per hour")
    told = list(
        watch_scans(
            data.graph, with_things(watched, data.second.sensor, things).observations(), data.second.sensor
        )
    )
    found = 0
    for thing in things:
        third = passes_of(seen, data, thing)[2][1]
        when = next((s.t for s in told if any(_is_at(change, thing) for change in s.changes)), np.inf)
        found += when <= third + 1.0
        print(
            f"({thing[0]:.1f}, {thing[1]:.1f}) m: third pass ends at {third:.0f} s, reported at {when:.0f} s"
        )
    others = [c for c in told[-1].changes if not any(_is_at(c, thing) for thing in things)]
    print(f"found by the third pass: {found} of {len(things)}; other changes {len(others)}")


def _is_at(change: PlaceChange, thing: Floats) -> bool:
    half = change.size / 2 + NEAR
    return change.kind == "new" and bool((np.abs(thing - change.centre) < half).all())


def main() -> None:
    """Print the tables."""
    parser = parser_of(__doc__)
    log_of_halves(parser)
    parser.add_argument("--part", choices=("robot", "place"), required=True)
    parser.add_argument("--n", type=int, default=8)
    parser.add_argument("--faults", nargs="+", choices=PLANTS, default=[*PLANTS])
    options = parser.parse_args()
    data = halves(options.log, options.work)
    if options.part == "place":
        place_part(data, options.n, np.random.default_rng(0))
    else:
        robot_part(data, options.n, {name: PLANTS[name] for name in options.faults})


if __name__ == "__main__":
    main()
