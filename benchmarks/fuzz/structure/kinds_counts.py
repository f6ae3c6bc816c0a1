"""Counts: rays, scans, gaps, drives that hardly move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.fuzz.structure.draft import Draft, Laser
from benchmarks.fuzz.structure.start import Start, named, of


@of(spins=True)
def varying_rays(start: Start, draft: Draft) -> None:
    """A driver sends a few rays more or less in each scan, over the same angle."""
    few = start.pick((1, 3, 10))
    for item in draft.scans:
        c = item.content
        n = len(c["ranges"]) - int(start.rng.integers(0, few + 1))
        if start.chance(0.5):  # the last rays are missing
            c["ranges"] = c["ranges"][:n]
            c["angle_max"] = c["angle_min"] + c["angle_increment"] * (n - 1)
        else:  # fewer rays over the same angle
            old = np.arange(len(c["ranges"]))
            nearest = np.linspace(0, len(old) - 1, n)
            c["ranges"] = np.interp(nearest, old, np.where(np.isfinite(c["ranges"]), c["ranges"], 50.0))
            c["angle_increment"] = (c["angle_max"] - c["angle_min"]) / (n - 1)
            c["time_increment"] *= (len(old) - 1) / (n - 1)
        c["intensities"] = item.scan + np.linspace(0.25, 0.75, n) if len(c["intensities"]) else np.zeros(0)


def few_scans(start: Start, draft: Draft) -> None:
    n = start.pick((0, 1, 2, 3, 5, 9, 10, 12, 20, 40))
    kept = draft.scans[60 : 60 + n]
    draft.drop("/scan")
    draft.add(*kept)
    draft.usable = n >= 10
    if n == 0:
        draft.empty = [("/scan", "LaserScan")]


def few_rays(start: Start) -> Draft:
    n = start.pick((1, 2, 3, 5, 8, 16, 30))
    laser = start.pick(
        (Laser(sweep=0, first=-90, n=n, stride=180 // n), Laser(sweep=1, first=-180, n=n, stride=360 // n))
    )
    draft = start.draft(laser)
    draft.usable = n >= 30
    return draft


def narrow(start: Start) -> Draft:
    angle = start.pick((10, 30, 60, 90))
    draft = start.draft(Laser(sweep=start.pick((0, 1)), first=-angle // 2, n=angle + 1))
    draft.usable = angle >= 90
    return draft


def empty_scans(start: Start, draft: Draft) -> None:
    """Some messages have no rays at all."""
    for item in draft.scans:
        if start.chance(0.1):
            item.content |= {"ranges": np.zeros(0), "intensities": np.zeros(0)}


def blind_stretch(start: Start, draft: Draft) -> None:
    """For some seconds no ray returns."""
    first, last = sorted(start.rng.uniform(3, 18, 2))
    for item in draft.scans:
        if first < item.stamp < min(last, first + 5):
            item.content["ranges"] = np.full(len(item.content["ranges"]), start.pick((np.inf, 0.0)))


def gap_of_scans(start: Start, draft: Draft) -> None:
    at, width = float(start.rng.uniform(4, 14)), start.pick((0.5, 2.0, 5.0))
    draft.keep(lambda item: item.topic != "/scan" or not at < item.stamp < at + width)


def gap_of_odometry(start: Start, draft: Draft) -> None:
    at, width = float(start.rng.uniform(4, 14)), start.pick((0.5, 2.0, 5.0))
    draft.keep(lambda item: item.topic not in ("/odom", "/tf") or not at < item.stamp < at + width)


def gap_of_all(start: Start, draft: Draft) -> None:
    """Nothing is recorded for a while, and the robot has moved on."""
    at, width = float(start.rng.uniform(4, 12)), start.pick((1.0, 3.0, 6.0))
    draft.keep(lambda item: item.topic == "/tf_static" or not at < item.stamp < at + width)


def pause(start: Start, draft: Draft) -> None:
    """The recorder is stopped and started again an hour later, where the robot still stands."""
    at = float(start.rng.uniform(6, 14))
    for item in draft.items:
        late = 3600.0 * (item.stamp > at)
        item.stamp, item.log, item.arrival = item.stamp + late, item.log + late, item.arrival + late


def lost_scans(start: Start, draft: Draft) -> None:
    share = start.pick((0.1, 0.5))
    draft.keep(lambda item: item.topic != "/scan" or start.rng.random() > share)


def rare_scans(start: Start) -> Draft:
    """A scan every second or more."""
    return start.draft(every=start.pick((5, 10, 20)))


def rare_odometry(start: Start, draft: Draft) -> None:
    every = start.pick((5, 25, 50))
    for topic in ("/odom", "/tf"):
        kept = {id(item) for item in draft.on(topic)[::every]}
        draft.keep(lambda item, topic=topic, kept=kept: item.topic != topic or id(item) in kept)  # type: ignore[misc]


def short_odometry(start: Start, draft: Draft) -> None:
    """Odometry starts late or ends early."""
    first, last = start.pick(((6.0, 99.0), (0.0, 12.0), (5.0, 15.0), (0.0, 0.25), (-1.0, -0.5)))
    draft.keep(lambda item: item.topic not in ("/odom", "/tf") or first < item.stamp < last)
    if last < 1:
        draft.expects.discard("odom")


@of(reference=1.0)
def short_pose(start: Start, draft: Draft) -> None:
    first, last = start.pick(((6.0, 99.0), (0.0, 12.0), (0.0, 0.3)))
    draft.keep(lambda item: item.topic != "/pose" or first < item.stamp < last)
    draft.expects.discard("pose")


def standing(start: Start, draft: Draft) -> None:
    """The robot never moves."""
    still = replace(draft.drive, poses=np.repeat(draft.drive.poses[:1], len(draft.drive.poses), axis=0),
                    odometry=np.zeros_like(draft.drive.odometry))  # fmt: skip
    first = draft.scans[0].content["ranges"]
    for item in draft.items:
        if item.scan >= 0:
            item.content["ranges"] = np.round(first + 0.01 * start.rng.normal(size=len(first)), 3)
        if item.kind == "Odometry":
            item.content = item.content | {"pose": np.r_[np.zeros(6), 1.0], "twist": np.zeros(6)}
        if item.kind == "PoseStamped":
            item.content["pose"] = draft.on("/pose")[0].content["pose"]
        if item.topic == "/tf":
            item.content["transforms"] = [("odom", "base_link", np.r_[np.zeros(6), 1.0])]
    draft.drive = still
    draft.expects = set()


@of(drive="spin")
def spin(start: Start, draft: Draft) -> None:
    if start.chance():
        draft.drop_odometry()


def corridor(start: Start) -> Draft:
    draft = start.draft(drive="corridor", range_max=start.pick((5.0, 8.0)))
    if start.chance():
        draft.drop_odometry()
        draft.usable = False
        draft.said = "ambiguous|along|corridor"
    return draft


def short_range(start: Start) -> Draft:
    draft = start.draft(range_max=start.pick((0.8, 1.5, 2.5)))
    draft.usable = draft.laser.range_max > 2
    return draft


def dense_odometry(start: Start, draft: Draft) -> None:
    """Two hundred messages of odometry a second."""
    times = np.arange(0.0, draft.drive.odom_times[-1], 0.005)
    poses = np.stack([np.interp(times, draft.drive.odom_times, c) for c in draft.drive.odometry.T], axis=1)
    draft.drop("/odom", "/tf")
    for t, pose in zip(times, poses, strict=True):
        draft.add_odometry("/odom", t, pose, child="base_link")


COUNTS = named(
    varying_rays, few_scans, few_rays, narrow, empty_scans, blind_stretch, gap_of_scans, gap_of_odometry,
    gap_of_all, pause, lost_scans, rare_scans, rare_odometry, short_odometry, short_pose, standing, spin,
    corridor, short_range, dense_odometry,
)  # fmt: skip
