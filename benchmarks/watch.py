"""`watch` on raw logs: kidnaps, beliefs put off, clean driving, planted faults and the load, beside what others use as an alarm.

    python -m benchmarks.watch ../shared/data/raw-carmen/intel.clf.bz2 --work /tmp/in_map --part pose --n 50

The graph is of the first half of the log, and the second half is watched (`localize_in_map.halves`). The believed pose is the
truth: the whole log, located together. Parts:

- `clean`: false alarms per hour on the second half, and the load
- `latency`: the time that each scan takes on the second half, where it arrives at its stamp, as live
- `policy`: how often limits from the run of the graph are exceeded in the second half, where nothing is wrong
- `pose`: `--n` kidnaps (the log goes on at another place) and as many beliefs put off by 0.5 to 1 m or 10° to 20°; share
  said within 5 s, and the area under the curve of each alarm over the seconds before and after. `--alone`: only ours

`benchmarks.watch_planted` plants faults of laser and wheels, and things in the place.

Alarms beside ours, all at the believed pose: the spread of AMCL's particles (Nav2's defaults, which start at the belief), the
mean likelihood of the returns in a 5 cm grid of the first half with the best of three widths on the first half, and a
reliability as als_ros computes it (Akai et al. 2018): a two-state filter over the mean distance of the returns from the map,
with densities from right and wrong poses of the first half.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.stats import gaussian_kde, mannwhitneyu

import logs
from benchmarks.arguments import log_of_halves, parser_of
from benchmarks.localize_in_map import Halves, halves
from benchmarks.particle_filter import driven
from logs.run import OccupancyMap, RangeSensor
from logs.transforms import compose, invert
from planners.types import Floats, Ints
from sensorgraph.exporting import amcl_filter
from sensorgraph.exporting.amcl import DEFAULTS
from sensorgraph.graph import Sensorgraph
from sensorgraph.localization.likelihood_field import points_on
from sensorgraph.watching.observation import Observation
from sensorgraph.watching.policy import learn
from sensorgraph.watching.pose import PoseJudge
from sensorgraph.watching.readings import GraphReadings
from sensorgraph.watching.tracker import PoseTracker
from sensorgraph.watching.watcher import Watcher, watch_scans

BEFORE, AFTER, WITHIN = 15.0, 8.0, 5.0
"""[s] of log before and after a kidnap; time within which it must be said."""
LEAST_WAY = 2.0
"""[m] A kidnapped robot is carried at least this far."""
WIDTHS = 0.05, 0.1, 0.2
"""[m] Widths of the likelihood field that are tried."""
REMAIN = 0.999
"""Probability per scan with which a right pose stays right, in als_ros's reliability."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Watched:
    """Scans to watch, with what the robot believes and where it is."""

    stamps: Floats
    ranges: Floats
    odometry: Floats
    believed: Floats
    changed: int
    """Scan from which the belief is wrong; the number of scans: never."""

    def observations(self) -> Iterator[Observation]:
        """Yield the scans."""
        for k in range(len(self.stamps)):
            yield Observation(
                stamp=float(self.stamps[k]),
                ranges=self.ranges[k],
                odometry=self.odometry[k],
                believed=self.believed[k],
            )

    def at(self, scans: Ints) -> Watched:
        """Return some of the scans, whose belief is right."""
        return Watched(
            stamps=self.stamps[scans], ranges=self.ranges[scans], odometry=self.odometry[scans],
            believed=self.believed[scans], changed=len(scans),
        )  # fmt: skip


def clean_scans(data: Halves, odometry: Floats, scans: Ints) -> Watched:
    """Return scans of the second half, with the truth as belief."""
    return Watched(
        stamps=data.second.stamps[scans], ranges=data.second.ranges[scans], odometry=odometry[scans],
        believed=data.truth[scans], changed=len(scans),
    )  # fmt: skip


def kidnapped(data: Halves, odometry: Floats, first: int, at: int, there: int, last: int) -> Watched:
    """Return a stretch in which the log goes on elsewhere, and the belief with the odometry."""
    n = last - there
    index = np.concatenate([np.arange(first, at), np.arange(there, last)])
    ahead = compose(invert(odometry[there]), odometry[there:last])
    stamps = data.second.stamps
    stamps = np.concatenate([stamps[first:at], stamps[at] + stamps[there:last] - stamps[there]])
    return Watched(
        stamps=stamps, ranges=data.second.ranges[index],
        odometry=np.concatenate([odometry[first:at], compose(np.tile(odometry[at], (n, 1)), ahead)]),
        believed=np.concatenate([data.truth[first:at], compose(np.tile(data.truth[at], (n, 1)), ahead)]),
        changed=at - first,
    )  # fmt: skip


def put_off(
    data: Halves, odometry: Floats, first: int, at: int, last: int, rng: np.random.Generator
) -> Watched:
    """Return a stretch in which the belief is put off."""
    way, direction = rng.uniform(0.5, 1.0), rng.uniform(-np.pi, np.pi)
    turn = rng.uniform(np.radians(10), np.radians(20)) * rng.choice([-1.0, 1.0])
    is_moved = rng.random() < 0.5
    off = np.array([way * np.cos(direction), way * np.sin(direction), 0.0] if is_moved else [0.0, 0.0, turn])
    clean = clean_scans(data, odometry, np.arange(first, last))
    believed = clean.believed.copy()
    believed[at - first :] = compose(believed[at - first :], off)
    return replace(clean, believed=believed, changed=at - first)


@dataclass(frozen=True, kw_only=True, eq=False)
class Field:
    """Distances in a grid of the first half, and what others compute from them."""

    cells: amcl_filter.CellDistances
    sensor: RangeSensor
    width: float = 0.1
    densities: tuple[gaussian_kde, gaussian_kde] | None = None
    """Of the mean distance at right and at wrong poses."""

    def distances(self, pose: Floats, ranges: Floats) -> Floats:
        """Return the distance [m] of each return of a scan (n_rays,) to the map at a pose."""
        used = np.flatnonzero(
            np.isfinite(ranges) & (ranges < self.sensor.range_max) & (ranges > self.sensor.range_min)
        )
        bearings = self.sensor.bearings[used] + self.sensor.mount[2]
        ahead = np.column_stack([np.cos(bearings), np.sin(bearings)])
        ends = self.sensor.mount[:2] + ranges[used, None] * ahead
        at = compose(pose, np.column_stack([ends, np.zeros(len(ends))]))[:, :2]
        return np.nan_to_num(self.cells.at(at), nan=amcl_filter.MAX_DISTANCE)

    def mean_likelihood(self, pose: Floats, ranges: Floats) -> float:
        """Return the mean likelihood of the returns."""
        found = self.distances(pose, ranges)
        return float(np.exp(-0.5 * (found / self.width) ** 2).mean()) if len(found) else 0.0


def field_of(data: Halves, rng: np.random.Generator) -> Field:
    """Make the grid of the first half, and tune width and densities on it."""
    points = points_on(data.walls, 0.02)
    low = points.min(axis=0) - 1.0
    nx, ny = np.ceil((points.max(axis=0) + 1.0 - low) / 0.05).astype(int)
    grid = np.zeros((ny, nx), dtype=np.int8)
    i, j = np.floor((points - low) / 0.05).astype(int).T
    grid[j, i] = 100
    cells = amcl_filter.CellDistances.of(
        OccupancyMap(data=grid, resolution=0.05, origin=np.array([low[0], low[1], 0.0]))
    )
    run = data.first
    poses = logs.pair(run).poses
    some = rng.choice(np.flatnonzero(np.isfinite(poses[:, 0])), 300)
    field = Field(cells=cells, sensor=run.sensor)
    off = np.column_stack([rng.uniform(-1, 1, (300, 2)), rng.uniform(-0.35, 0.35, 300)])
    wrong = compose(poses[some], off)
    best = max(
        WIDTHS,
        key=lambda width: _separation(replace(field, width=width), poses[some], wrong, run.ranges[some]),
    )
    means = [
        np.array([field.distances(p, z).mean() for p, z in zip(each, run.ranges[some], strict=True)])
        for each in (poses[some], wrong)
    ]
    return replace(field, width=best, densities=(gaussian_kde(means[0]), gaussian_kde(means[1])))


def _separation(field: Field, right: Floats, wrong: Floats, ranges: Floats) -> float:
    good, bad = (
        [field.mean_likelihood(p, z) for p, z in zip(each, ranges, strict=True)] for each in (right, wrong)
    )
    return area(-np.array([*good, *bad]), np.repeat([0, 1], len(good)))


def area(scores: Floats, wrong: Ints) -> float:
    """Return the area under the curve of an alarm: probability that a wrong second scores higher than a right one."""
    bad, good = scores[wrong == 1], scores[wrong == 0]
    return float(mannwhitneyu(bad, good).statistic / (len(bad) * len(good)))


class Alarms:
    """The alarm of each method, scan by scan."""

    def __init__(self, field: Field, rng: np.random.Generator, n_particles: int = 500) -> None:
        self.field, self.rng, self.n = field, rng, n_particles
        self.particles: Floats | None = None
        self.table = field.cells.table(DEFAULTS, amcl_filter.LASER_MODELS[0])
        self.last: Floats | None = None
        self.reliable = 0.9

    def add(self, one: Observation) -> dict[str, float]:
        """Return the alarms at a scan."""
        assert one.believed is not None and one.odometry is not None
        mean = self.field.distances(one.believed, one.ranges).mean()
        assert self.field.densities is not None
        right, wrong = (float(density(mean)[0]) + 1e-6 for density in self.field.densities)
        prior = REMAIN * self.reliable + (1 - REMAIN) * 0.5
        self.reliable = float(np.clip(right * prior / (right * prior + wrong * (1 - prior)), 1e-6, 1 - 1e-6))
        return {
            "AMCL covariance": self._spread(one),
            "grid likelihood": -self.field.mean_likelihood(one.believed, one.ranges),
            "als_ros reliability": -self.reliable,
        }

    def _spread(self, one: Observation) -> float:
        assert one.believed is not None and one.odometry is not None
        if self.particles is None or self.last is None:
            self.particles = one.believed + self.rng.normal(size=(self.n, 3)) * amcl_filter.START_SPREAD
            self.last = one.odometry
        step = compose(invert(self.last), one.odometry)
        if np.hypot(step[0], step[1]) > amcl_filter.MIN_D or abs(step[2]) > amcl_filter.MIN_A:
            self.last = one.odometry
            self.particles = amcl_filter._moved(self.particles, step, DEFAULTS, self.rng)
            sensor = self.field.sensor
            rays = np.linspace(0, sensor.n_rays - 1, amcl_filter.MAX_BEAMS).astype(int)
            used = rays[np.isfinite(one.ranges[rays]) & (one.ranges[rays] < sensor.range_max)]
            bearings = sensor.bearings[used] + sensor.mount[2]
            ahead = np.column_stack([np.cos(bearings), np.sin(bearings)])
            ends = sensor.mount[:2] + one.ranges[used, None] * ahead
            found = amcl_filter._contributions(self.particles, ends, self.field.cells, self.table)
            weights = 1.0 + found.sum(axis=1)
            self.particles = self.particles[amcl_filter.drawn(weights / weights.sum(), self.rng)]
        return float(np.trace(np.cov(self.particles[:, :2].T)))


def seconds(
    graph: Sensorgraph, readings: GraphReadings, watched: Watched, alarms: Alarms | None
) -> list[tuple[float, str, dict[str, float]]]:
    """Return time since the change [s], status and the alarms of each second; without those of others, only ours."""
    tracker, out, said = PoseTracker(graph, readings), [], -np.inf
    judge = PoseJudge(tracker)
    began = watched.stamps[watched.changed] if watched.changed < len(watched.stamps) else np.inf
    for one in watched.observations():
        if tracker.is_due(one):
            tracker.update(one)
        found = alarms.add(one) if alarms else {}
        if one.stamp - said >= 1.0:
            said = one.stamp
            statement = judge.state(one)
            out.append((one.stamp - began, statement.status, {"watch": statement.p_wrong, **found}))
    return out


def pose_part(data: Halves, n: int, rng: np.random.Generator, *, alone: bool = False) -> None:
    """Print how soon wrong poses are said, and the areas under the curves, unless ours is alone."""
    odometry, stamps = driven(data.second), data.second.stamps
    known = data.covered & np.isfinite(data.truth[:, 0])
    share = np.convolve(known, np.ones(25) / 25, "same")
    readings, field = GraphReadings(data.graph, data.second.sensor), field_of(data, rng)
    starts = np.flatnonzero(
        known & (share > 0.9) & (stamps > stamps[0] + BEFORE) & (stamps < stamps[-1] - AFTER)
    )
    scores: dict[str, list[float]] = {}
    labels: list[int] = []
    for kind in ("kidnapped", "put off"):
        said, lags, missed, false = 0, [], 0, 0
        for _ in range(n):
            at = int(rng.choice(starts))
            first, last = (int(k) for k in np.searchsorted(stamps, [stamps[at] - BEFORE, stamps[at] + AFTER]))
            if np.isnan(data.truth[first:last, 0]).any():
                continue
            if kind == "kidnapped":
                far = starts[np.hypot(*(data.truth[starts, :2] - data.truth[at, :2]).T) > LEAST_WAY]
                there = int(rng.choice(far))
                watched = kidnapped(
                    data, odometry, first, at, there, int(np.searchsorted(stamps, stamps[there] + AFTER))
                )
            else:
                watched = put_off(data, odometry, first, at, last, rng)
            if np.isnan(watched.believed).any():
                continue
            rows = seconds(data.graph, readings, watched, None if alone else Alarms(field, rng))
            wrong = [t for t, status, _ in rows if t >= 0 and status in ("off", "lost")]
            false += any(status in ("off", "lost") for t, status, _ in rows if t < 0)
            said += bool(wrong) and wrong[0] <= WITHIN
            missed += not wrong
            lags += wrong[:1]
            for t, _, each in rows:
                if t < -1 or 2 <= t <= WITHIN:
                    labels.append(int(t >= 0))
                    for name, value in each.items():
                        scores.setdefault(name, []).append(value)
        total = said + missed + sum(lag > WITHIN for lag in lags)
        print(f"{kind}: {said} of {total} said within {WITHIN:g} s, {missed} missed within {AFTER:g} s, "
              f"median {np.median(lags):.1f} s; false before in {false}")  # fmt: skip
    print(
        "area under the curve: "
        + ", ".join(f"{name} {area(np.array(each), np.array(labels)):.3f}" for name, each in scores.items())
    )


def clean_part(data: Halves) -> None:
    """Print false alarms and the load on the second half."""
    odometry = driven(data.second)
    watched = clean_scans(data, odometry, np.flatnonzero(np.isfinite(data.truth[:, 0])))
    began = time.process_time()
    said = list(watch_scans(data.graph, watched.observations(), data.second.sensor))
    cpu, hours = time.process_time() - began, data.second.duration / 3600
    words = [status.pose.status for status in said]
    begun = sum(a in ("ok", "ambiguous") and b in ("off", "lost") for a, b in pairwise(words))
    outside = np.mean([not status.pose.is_known_place for status in said])
    print(f"clean: {60 * hours:.1f} min, {outside:.0%} outside what the graph knows, seconds {dict(Counter(words))}, "
          f"{begun} false alarms = {begun / hours:.1f} per hour; {len(said[-1].changes)} changes; "
          f"{cpu / (3600 * hours):.1%} of a core")  # fmt: skip
    named = Counter(fault.name for status in said for fault in status.faults)
    print(f"named without a policy, in seconds: {dict(named)}")


def good_run(data: Halves) -> Watched:
    """Return the run of the graph, with its located poses as belief."""
    poses = logs.pair(data.first).poses
    whole = Watched(
        stamps=data.first.stamps, ranges=data.first.ranges, odometry=driven(data.first), believed=poses, changed=len(poses)
    )  # fmt: skip
    return whole.at(np.flatnonzero(np.isfinite(poses[:, 0])))


def policy_part(data: Halves) -> None:
    """Print how often a policy from the run of the graph warns in the second half, by statement."""
    sensor = data.second.sensor
    policy = learn([list(watch_scans(data.graph, good_run(data).observations(), sensor))])
    print(f"{60 * policy.hours:.1f} min of good runs: {policy.to_dict()}")
    watched = clean_scans(data, driven(data.second), np.flatnonzero(np.isfinite(data.truth[:, 0])))
    hours, seconds, begun = float(np.ptp(watched.stamps)) / 3600, Counter[str](), Counter[str]()
    named: dict[str, str] = {}
    before: set[str] = set()
    for status in watch_scans(data.graph, watched.observations(), sensor, baseline=policy.baseline):
        now = {f"{reason.split()[0].rstrip(':')} {each}" for each, reason in policy.reasons(status)}
        seconds.update([policy.level(status)[0], *now, *(fault.name for fault in status.faults)])
        named.update({fault.name: fault.sentence() for fault in status.faults})
        begun.update(now - before)
        before = now
    print(f"{60 * hours:.1f} min watched, in seconds: {dict(seconds)}")
    for name, text in named.items():
        print(f"{name}: {text}, healthy {policy.baseline.get(name)}")
    for name, n in begun.most_common():
        print(f"{name}: begins {n} times, {n / hours:.1f} per hour")


def latency_part(data: Halves) -> None:
    """Print how long each scan takes, by the clock and in CPU time of its thread, beside that of searches."""
    scans = np.flatnonzero(np.isfinite(data.truth[:, 0]))
    watched = clean_scans(data, driven(data.second), scans)
    watcher, took = Watcher(data.graph, data.second.sensor, waits=False), []
    began, first = time.process_time(), time.perf_counter() - float(watched.stamps[0])
    for one in watched.observations():
        time.sleep(max(first + one.stamp - time.perf_counter(), 0.0))
        clock, cpu = time.perf_counter(), time.thread_time()
        watcher.add(one)
        took.append((time.perf_counter() - clock, time.thread_time() - cpu))
    took = took[20:]  # the first ones compile
    for name, each in zip(("by the clock", "CPU time of the thread"), np.transpose(took), strict=True):
        middle, most, nearly_all, longest = 1e3 * np.quantile(each, [0.5, 0.99, 0.999, 1.0])
        print(
            f"{name}: median {middle:.1f} ms, 99 % {most:.1f} ms, 99.9 % {nearly_all:.1f} ms, longest {longest:.1f} ms"
        )
    print(f"all threads: {time.process_time() - began:.1f} s of CPU")


def main() -> None:
    """Print the tables."""
    parser = parser_of(__doc__)
    log_of_halves(parser)
    parser.add_argument("--part", choices=("clean", "latency", "policy", "pose"), default="clean")
    parser.add_argument("--n", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0, help="of the kidnaps and of the beliefs put off")
    parser.add_argument("--alone", action="store_true", help="no alarms of others")
    parser.add_argument(
        "--swapped", action="store_true", help="watch the first half in a graph of the second"
    )
    options = parser.parse_args()
    data = halves(options.log, options.work, swapped=options.swapped)
    print(
        f"{options.log.name}: {data.second.n_scans:,} scans, {data.covered.mean():.0%} covered by the graph"
    )
    if options.part == "pose":
        pose_part(data, options.n, np.random.default_rng(options.seed), alone=options.alone)
    else:
        {"clean": clean_part, "latency": latency_part, "policy": policy_part}[options.part](data)


if __name__ == "__main__":
    main()
