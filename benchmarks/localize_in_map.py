"""Localise in a known map: the second half of a raw log in a graph of its first half.

Truth is the whole log, located together (`sensorgraph locate`): both halves are in its frame. Parts:

- `start`: a global start without a guess, from one scan and from five, at places that the first half covers
- `track`: the second half, found and followed
- `kidnap`: 30 times, 15 s of log go on at another covered place; a robot that is not found within 5 s is said to be lost
  if no pose later than 2 s after it was carried is called ok and wrong

    python -m benchmarks.localize_in_map ../shared/data/raw-carmen/intel.clf.bz2 --work /tmp/in_map
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import logs
import sensorgraph as sg
from benchmarks.arguments import log_of_halves, parser_of
from logs.run import Run
from logs.transforms import compose, invert, wrap
from planners.types import Bools, Floats, Ints
from sensorgraph.localization.global_search import MIN_POINTS, find_places, local_view
from sensorgraph.localization.graph_walls import seen_by_graph, walls_of_graph
from sensorgraph.localization.in_map import locate_in_map
from sensorgraph.localization.known_map import known_map
from sensorgraph.localization.map_tracking import min_fit_of
from sensorgraph.localization.matching import match
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of
from sensorgraph.localization.scans import scan_points
from sensorgraph.models.seen_space import SeenSpace

RIGHT_PLACE, RIGHT_TURN = 0.5, 0.26
"""[m, rad] a place nearer to the truth is the right one."""
COVERED = 0.7
"""Share of the returns on surfaces of the map at the true pose, from which on a place is covered."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Halves:
    """A graph of the first half, and the second half with its truth."""

    graph: sg.Sensorgraph
    walls: Floats
    normals: Floats
    """(n_walls, 2) to where each was seen from."""
    seen: SeenSpace | None
    first: Run
    """Located: what the graph was built from."""
    second: Run
    """Raw: its poses are the odometry."""
    truth: Floats
    """(n_scans, 3) base_link in map."""
    truth_covariances: Floats
    """(n_scans, 3, 3) as stated where the whole log was located: the truth is an estimate, too."""
    covered: Bools
    """(n_scans,) the scan fits the graph at its true pose."""


def halves(log: Path, work: Path, *, swapped: bool = False, hidden: int = 0) -> Halves:
    """Locate the log, build the first half; both are kept in `work`. Swapped: the second half is built.

    Without a number of `hidden` rays of the other half, evenly spaced, the truth does not share their errors.
    """
    work.mkdir(parents=True, exist_ok=True)
    built = "second" if swapped else "first"
    name = f"{log.name}.without_{hidden}" if hidden else log.name
    whole, path = work / f"{name}.mcap", work / f"{name}.{built}.sensorgraph"
    raw = logs.read(log)
    middle, n = raw.n_scans // 2, raw.n_scans
    known, other = ((middle, n), (0, middle)) if swapped else ((0, middle), (middle, n))
    located = located_without(raw, slice(*other), evenly_spaced(raw.sensor.n_rays, hidden), whole)
    if not path.exists():
        sg.build(part(located, *known), calibrate=False).save(path)
    graph = sg.Sensorgraph.load(path)
    (walls, normals), seen = walls_of_graph(graph), seen_by_graph(graph)
    second = part(raw, *other)
    whole_part = part(located, *other)
    truth, truth_covariances = poses_at_scans(whole_part)
    place, scans = known_map(walls, seen, normals), scan_points(second)
    covered = np.zeros(len(truth), dtype=np.bool_)
    for k in range(len(truth)):
        own = scans.of(k)
        if np.isfinite(truth[k, 0]) and own.stop - own.start >= MIN_POINTS:
            found = match(scans.points[own], scans.normals[own], place.surfaces, truth[k])
            covered[k] = found.agreement >= COVERED
    return Halves(
        graph=graph, walls=walls, normals=normals, seen=seen, first=part(located, *known), second=second, truth=truth, covered=covered,
        truth_covariances=truth_covariances,
    )  # fmt: skip


def poses_at_scans(run: Run) -> tuple[Floats, Floats]:
    """Return poses (n_scans, 3) and their covariances (n_scans, 3, 3) of a located run; poses of other scans are nan."""
    nearest = np.clip(np.searchsorted(run.pose_stamps, run.stamps), 0, len(run.poses) - 1)
    if len(run.poses) == run.n_scans:  # stamps may repeat
        nearest = np.arange(run.n_scans)
    return logs.pair(run).poses, run.pose_covariances[nearest]


def located_without(run: Run, scans: slice, rays: Ints, path: Path) -> Run:
    """Locate a run without some rays of some scans; the result is kept in `path`."""
    if not path.exists():
        ranges = run.ranges.copy()
        ranges[scans, rays] = np.nan
        sg.locate(replace(run, ranges=ranges), path=path)
    return logs.read(path)


def evenly_spaced(n_rays: int, n: int) -> Ints:
    """Return the indices of n of the rays, the first and the last among them."""
    return np.unique(np.linspace(0, n_rays - 1, n).astype(np.intp))


def part(run: Run, first: int, last: int) -> Run:
    """Return scans first to last - 1 with what was logged meanwhile."""
    t0, t1 = run.stamps[first], run.stamps[last - 1]
    pose = slice(*np.searchsorted(run.pose_stamps, [t0, np.nextafter(t1, np.inf)]))
    if len(run.pose_stamps) == run.n_scans:
        pose = slice(first, last)
    odom = slice(*np.searchsorted(run.odom_stamps, [t0 - 0.5, t1 + 0.5]))
    return replace(
        run,
        stamps=run.stamps[first:last],
        ranges=run.ranges[first:last],
        pose_stamps=run.pose_stamps[pose],
        poses=run.poses[pose],
        pose_covariances=run.pose_covariances[pose] if len(run.pose_covariances) else run.pose_covariances,
        odom_stamps=run.odom_stamps[odom],
        odometry=run.odometry[odom],
        odom_twists=run.odom_twists[odom],
    )


def errors(poses: Floats, truth: Floats) -> tuple[Floats, Floats]:
    """Return distances [m] and turns [rad]."""
    return np.hypot(*(poses - truth)[:, :2].T), np.abs(wrap(poses[:, 2] - truth[:, 2]))


def start(data: Halves, n_scans: int, n_places: int, rng: np.random.Generator) -> None:
    """Print how often a start without a guess is right, ambiguous, wrong or not found."""
    place, scans = known_map(data.walls, data.seen, data.normals), scan_points(data.second)
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(data.truth[:, :2], axis=0).T))])
    there = np.flatnonzero(data.covered & (driven > 2.0))
    tally = dict.fromkeys(("right", "ambiguous", "no place", "wrong"), 0)
    off, began = [], time.monotonic()
    for k in rng.choice(there, min(n_places, len(there)), replace=False):
        back = np.searchsorted(driven, driven[k] - 0.4 * np.arange(n_scans - 1, 0, -1))
        chosen = np.unique(np.append(back, k)).astype(np.intp)
        found = find_places(local_view(scans, chosen, data.truth[chosen]), place)
        if found.fit < min_fit_of(found):
            tally["no place"] += 1
        elif len(found.rivals):
            tally["ambiguous"] += 1
        else:
            distance, turn = errors(found.poses[:1], data.truth[k][None])
            is_right = distance[0] < RIGHT_PLACE and turn[0] < RIGHT_TURN
            tally["right" if is_right else "wrong"] += 1
            off += [distance[0]] if is_right else []
    n = sum(tally.values())
    shares = ", ".join(f"{word} {100 * count / n:.1f} %" for word, count in tally.items())
    took = 1000 * (time.monotonic() - began) / n
    print(
        f"start, {n_scans} scans, {n} places: {shares}; median error {100 * np.median(off):.1f} cm; {took:.0f} ms each"
    )


def tracking(data: Halves) -> None:
    """Print the errors of the located second half."""
    began = time.monotonic()
    found = locate_in_map(data.second, data.walls, seen=data.seen, normals=data.normals)
    took = time.monotonic() - began
    states = np.array(found.status)
    for label, which in (("ok", states == "ok"), ("ok, covered", (states == "ok") & data.covered)):
        print(f"track, {label}: {said(found.poses[which], data.truth[which])}")
    for word in ("lost", "ambiguous"):
        print(
            f"track, {word}: {100 * (states == word).mean():.1f} % of the scans, {100 * (states[data.covered] == word).mean():.1f} % of the covered ones"
        )
    both = found.covariances + data.truth_covariances
    sigma = np.sqrt(np.diagonal(both, axis1=1, axis2=2))
    off = found.poses - data.truth
    off[:, 2] = wrap(off[:, 2])
    inside = (np.abs(off) < 2 * sigma)[(states == "ok") & np.isfinite(data.truth[:, 0])]
    shares = ", ".join(f"{100 * share:.1f}" for share in inside.mean(axis=0))
    print(
        f"track: {100 * inside.mean():.1f} % within 2 s.e. (x, y, phi: {shares}); {data.second.duration / took:.1f} x real time"
    )


def said(poses: Floats, truth: Floats) -> str:
    """Say errors in one line."""
    known = np.isfinite(truth[:, 0])
    distance, turn = errors(poses[known], truth[known])
    return (
        f"{known.sum():,} scans, {100 * np.median(distance):.2f} cm and {np.degrees(np.median(turn)):.3f} deg median, "
        f"95 % {100 * np.quantile(distance, 0.95):.1f} cm, above 0.5 m {100 * (distance > 0.5).mean():.2f} %"
    )


def kidnapped(data: Halves, n: int, rng: np.random.Generator) -> None:
    """Print how often a robot that was carried elsewhere is found in time, or else said to be lost in time."""
    span, soon, at_once = 15.0, 5.0, 2.0
    stamps = data.second.stamps
    there = np.flatnonzero(data.covered & (stamps < stamps[-1] - span - 1))
    tally = dict.fromkeys(("found again within 5 s", "said to be lost within 2 s", "neither"), 0)
    wrong, later = [], 0
    for _ in range(n):
        a, b = (int(k) for k in rng.choice(there, 2, replace=False))
        one, two = (part(data.second, k, int(np.searchsorted(stamps, stamps[k] + span))) for k in (a, b))
        truth = np.concatenate([data.truth[a : a + one.n_scans], data.truth[b : b + two.n_scans]])
        try:
            found = locate_in_map(_joined(one, two), data.walls, seen=data.seen, normals=data.normals)
        except sg.errors.SensorgraphError:  # the scans fit nowhere
            tally["said to be lost within 2 s"] += 1
            continue
        ok = np.array(found.status) == "ok"
        since = found.t - found.t[one.n_scans]
        distance, _ = errors(found.poses, truth)
        is_right = ok & (distance < RIGHT_PLACE) & (since >= 0)
        is_wrong = ok & (distance >= RIGHT_PLACE)
        wrong.append(is_wrong.mean())
        first = since[is_right][0] if is_right.any() else np.inf
        if (is_wrong & (since > at_once)).any():
            tally["neither"] += 1
        elif first <= soon:
            tally["found again within 5 s"] += 1
        else:
            tally["said to be lost within 2 s"] += 1
            later += int(np.isfinite(first))
    shares = ", ".join(f"{word} {count}" for word, count in tally.items())
    print(
        f"kidnapped, {n} times: {shares} ({later} of those lost found later); "
        f"wrong poses said ok {100 * np.mean(wrong):.2f} % of the scans"
    )


def _joined(one: Run, two: Run) -> Run:
    """Return two runs as one: time and odometry go on."""
    ahead = one.stamps[-1] + 0.2 - two.stamps[0]
    drive = []
    for run in (one, two):
        motion = odometry_of(run)  # None: it stood still
        drive.append(np.zeros((run.n_scans, 3)) if motion is None else odometry_at_scans(run, motion))
    follow = compose(drive[0][-1], compose(invert(drive[1][0]), drive[1]))
    stamps = np.concatenate([one.stamps, two.stamps + ahead])
    poses = np.concatenate([drive[0], follow])
    return replace(
        one, stamps=stamps, ranges=np.concatenate([one.ranges, two.ranges]), pose_stamps=stamps, poses=poses,
        odom_stamps=stamps, odometry=poses, odom_twists=np.zeros((len(stamps), 2)),
    )  # fmt: skip


def main() -> None:
    parser = parser_of(__doc__)
    log_of_halves(parser)
    parser.add_argument("--parts", default="start,track,kidnap")
    parser.add_argument("--swap", action="store_true", help="the first half in a graph of the second")
    parser.add_argument("--places", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    data = halves(given.log, given.work, swapped=given.swap)
    print(
        f"{given.log.name}: {len(data.truth):,} scans of the second half, {100 * data.covered.mean():.0f} % covered"
    )
    rng = np.random.default_rng(given.seed)
    parts = given.parts.split(",")
    if "start" in parts:
        start(data, 1, given.places, rng)
        start(data, 5, given.places, rng)
    if "track" in parts:
        tracking(data)
    if "kidnap" in parts:
        kidnapped(data, 30, rng)


if __name__ == "__main__":
    main()
