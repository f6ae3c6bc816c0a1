"""Nodes: two that publish one thing, drivers that are started again or send again, odometry of mixed frames and units, parts of the robot, steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.fuzz.structure.draft import (
    MOUNT,
    Draft,
    Floats,
    compose,
    inverse,
    reverse,
    reverse_times,
    start_of,
    vec7,
)
from benchmarks.fuzz.structure.drives import PERIOD
from benchmarks.fuzz.structure.start import LASERS, Start, named, of

LATER = 0.007
"""[s] by which the messages of a second publisher are later."""


def _also(draft: Draft, topic: str, poses: Floats, later: float = LATER) -> None:
    """Publish every second one of further poses on a topic."""
    for item, pose in list(zip(draft.on(topic), poses, strict=True))[::2]:
        if topic == "/odom":
            content = item.content | {"pose": vec7(*pose)}
        else:
            content = {"transforms": [("odom", "base_link", vec7(*pose))]}
        log = item.log + later
        draft.add(replace(item, stamp=item.stamp + later, log=log, arrival=log, content=content))


def _driven(draft: Draft, first: Floats, scales: Floats) -> Floats:
    """Return the odometry (n, 3) of another filter: its first pose, and the scales (3,) of its steps."""
    odometry = draft.drive.odometry
    poses = [first]
    for step in compose(inverse(odometry[:-1]), odometry[1:]) * scales:
        poses.append(compose(poses[-1], step))
    return np.array(poses)


@of(reference=0.0)
def two_publishers(start: Start, draft: Draft) -> None:
    """Wheels and a filter that begins elsewhere publish the odometry."""
    _also(draft, "/odom", compose(np.array([1.0, 0.5, 0.6]), draft.drive.odometry))
    if start.chance():
        draft.drop("/tf")


@of(reference=0.0)
def drifting_publisher(start: Start, draft: Draft) -> None:
    """Wheels and a filter that begins at the same place publish the odometry."""
    scales = np.array([1.05, 1.05, start.pick((0.9, 1.1))])
    _also(draft, "/odom", _driven(draft, draft.drive.odometry[0], scales))


@of(reference=0.0)
def publisher_of_zeros(start: Start, draft: Draft) -> None:
    """A node that does nothing publishes twice as often as the wheels."""
    wheels, zeros = draft.on("/odom"), vec7(0.0, 0.0, 0.0)
    for later in (0.003, 0.009):
        times = [(item, item.log + later) for item in wheels]
        draft.add(*(replace(item, stamp=item.stamp + later, log=log, arrival=log, content=item.content | {"pose": zeros})
                    for item, log in times))  # fmt: skip


@of(reference=0.0)
def transforms_of_two(start: Start, draft: Draft) -> None:
    first = start.pick((np.zeros(3), np.array([1.0, 0.5, 0.6])))
    _also(draft, "/tf", _driven(draft, first, np.array([1.02, 1.02, 0.95])), later=0.011)
    draft.drop("/odom")


@of(reference=0.0)
def odometry_starts_again(start: Start, draft: Draft) -> None:
    """The driver of the wheels is started again: from 0, in a frame of another name or the same."""
    odometry, late = draft.drive.odometry.copy(), draft.drive.odom_times > float(start.rng.uniform(6, 14))
    odometry[late] = compose(inverse(odometry[late][0]), odometry[late])
    draft.state(odometry)
    name = start.pick(("odom", "odom_1"))
    for item, transform, is_late in zip(draft.on("/odom"), draft.on("/tf"), late, strict=True):
        item.frame = name if is_late else item.frame
        _, child, value = transform.content["transforms"][0]
        transform.content = {"transforms": [(item.frame, child, value)]}
    if start.chance():
        draft.drop("/odom")
    draft.said = "jumps|no odometry after|two parents"


def field_changes(start: Start) -> Draft:
    """The driver of the laser is started again, with half of the field of view."""
    draft = start.draft(LASERS[0], reference=0.0)
    at = float(start.rng.uniform(6, 14))
    for item in draft.scans:
        if item.stamp > at:
            c = item.content
            c |= {name: c[name][90:271] for name in ("ranges", "intensities")}
            c["angle_min"] += 90 * c["angle_increment"]
            c["angle_max"] = c["angle_min"] + 180 * c["angle_increment"]
            item.stamp += 90 * c["time_increment"]
            draft.true_times[item.scan], draft.first_rays[item.scan] = item.stamp, -90
    return draft


def order_changes(start: Start) -> Draft:
    """The driver of the laser is started again, and sends the array the other way, with increments that fit."""
    draft = start.draft(LASERS[0], reference=0.0)
    at = float(start.rng.uniform(6, 14))
    for item in draft.scans:
        if item.stamp > at:
            reverse(item.content)
            reverse_times(item)
    return draft


@of(reference=0.0, spins=True)
def sent_again(start: Start, draft: Draft) -> None:
    """A relay sends the latest scan twice as often as the laser measures, with new stamps."""
    for item in draft.scans:
        item.content["intensities"] = np.zeros(0)
        k, at = 1000 + item.scan, item.stamp + PERIOD / 2
        draft.true_times[k] = at
        draft.add(replace(item, stamp=at, log=item.log + PERIOD / 2, arrival=item.log + PERIOD / 2, scan=k))


@of(reference=0.0, spins=True)
def stamped_in_bursts(start: Start, draft: Draft) -> None:
    """Scans are stamped as they arrive, several at once."""
    n = start.pick((2, 3, 5))
    for item in draft.scans:
        complete = start_of(draft.laser, item.scan // n * n + n - 1) + 0.11
        item.stamp = complete + 0.002 * (item.scan % n)
        item.log = item.arrival = item.stamp + 0.003


def sectors(start: Start) -> Draft:
    """Each turn comes in four messages."""
    draft = start.draft(LASERS[0], reference=0.0)
    draft.is_stream = True
    scans = draft.scans
    draft.drop("/scan")
    for item in scans:
        c = item.content
        for i in range(4):
            at, low = item.stamp + i * PERIOD / 4, c["angle_min"] + 90 * i * c["angle_increment"]
            content = c | {
                "ranges": c["ranges"][90 * i : 90 * i + 90], "intensities": np.zeros(0),
                "angle_min": low, "angle_max": low + 89 * c["angle_increment"],
            }  # fmt: skip
            draft.add(replace(item, stamp=at, log=at + 0.03, arrival=at + 0.03, content=content))
    return draft


@of(reference=0.0)
def mirrored_positions(start: Start, draft: Draft) -> None:
    """The y of the odometry is to the right, or x and y are exchanged; its heading is right."""
    odometry = draft.drive.odometry
    draft.state(odometry * [1, -1, 1] if start.chance() else odometry[:, [1, 0, 2]])
    draft.said = "positions are mirrored"


@of(reference=0.0)
def twist_in_odometry(start: Start, draft: Draft) -> None:
    """Only the twist is filled in, along x and y of the odometry frame."""
    draft.drop("/tf")
    for item, (_, _, phi) in zip(draft.on("/odom"), draft.drive.odometry, strict=True):
        v, omega = item.content["twist"][[0, 5]]
        twist = np.array([v * np.cos(phi), v * np.sin(phi), 0.0, 0.0, 0.0, omega])
        item.content = item.content | {"pose": np.r_[np.zeros(6), 1.0], "twist": twist}
    draft.said = "frame of the odometry"


@of(reference=0.0)
def twist_in_degrees(start: Start, draft: Draft) -> None:
    """Only the twist is filled in, in degrees per second."""
    draft.drop("/tf")
    for item in draft.on("/odom"):
        twist = item.content["twist"] * [1, 1, 1, 1, 1, 180 / np.pi]
        item.content = item.content | {"pose": np.r_[np.zeros(6), 1.0], "twist": twist}
    draft.said = "degrees"


@of(reference=0.0)
def compass_heading(start: Start, draft: Draft) -> None:
    """The heading is that of a compass, and the positions begin where the robot is switched on."""
    draft.state(draft.drive.odometry + [0.0, 0.0, start.pick((0.3, 0.8, np.pi / 2, -2.2))])
    draft.said = "differs from its heading"


@of(reference=0.0)
def wrong_poses(start: Start, draft: Draft) -> None:
    """Single messages of the odometry are wrong, as of a damaged byte or a register that is read as 0."""
    odometry = draft.drive.odometry.copy()
    off = start.pick((np.array([0.6, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), None))
    for k in start.rng.choice(np.arange(20, len(odometry) - 20), 12, replace=False):
        odometry[k] = 0.0 if off is None else odometry[k] + off
    draft.state(odometry)
    draft.drop(start.pick(("/odom", "/tf")))


@of(reference=0.0)
def held_odometry(start: Start, draft: Draft) -> None:
    """The odometry is published more often than the wheels are read."""
    every, n = start.pick((5, 10)), len(draft.drive.odometry)
    draft.state(draft.drive.odometry[np.arange(n) // every * every])


@of(reference=0.0)
def corrected_odometry(start: Start, draft: Draft) -> None:
    """A filter whose poses are corrected a few times."""
    odometry = draft.drive.odometry.copy()
    for at in start.rng.uniform(3, 19, 3):
        late = draft.drive.odom_times > at
        odometry[late] = compose(start.rng.uniform(-0.6, 0.6, 3), odometry[late])
    draft.state(odometry)


@of(reference=0.0)
def frozen_odometry(start: Start, draft: Draft) -> None:
    """The driver of the wheels hangs, and goes on where it was or where the robot is."""
    odometry, at = draft.drive.odometry.copy(), float(start.rng.uniform(5, 14))
    first, last = np.searchsorted(draft.drive.odom_times, [at, at + start.pick((1.0, 3.0))])
    if start.chance():
        odometry[last:] = compose(odometry[first], compose(inverse(odometry[last]), odometry[last:]))
    odometry[first:last] = odometry[first]
    draft.state(odometry)


def sideways(start: Start) -> Draft:
    """A robot that may drive anywhere: its base_link is at the laser, and looks elsewhere than it drives."""
    draft = start.draft(replace(LASERS[3], first=-180, n=360), reference=0.0)
    drive, place = draft.drive, np.array([*MOUNT, 0.0])
    turned = start.pick((lambda t: 90.0 + 0.0 * t, lambda t: 60.0 * np.sin(0.5 * t)))
    for item in draft.scans:
        off = turned(start_of(draft.laser, item.scan))
        z = np.roll(drive.flashes[item.scan], -round(off))[np.arange(-180, 180)]
        z = z + 0.01 * start.rng.normal(size=360)
        item.content["ranges"] = np.where(z > draft.laser.range_max, np.inf, np.round(z, 3))
    looks = np.column_stack([0 * drive.times, 0 * drive.times, np.radians(turned(drive.times))])
    draft.drive = replace(drive, poses=compose(drive.poses, place) + looks)
    looks = np.column_stack(
        [0 * drive.odom_times, 0 * drive.odom_times, np.radians(turned(drive.odom_times))]
    )
    draft.state(compose(drive.odometry, place) + looks)
    for item in draft.on("/odom"):
        item.content["twist"] = np.zeros(6)
    draft.drop("/tf_static")
    draft.add_static(("base_link", "laser", vec7(0.0, 0.0, 0.0, z=0.25)))
    return draft


def parts_of_robot(start: Start) -> Draft:
    """Parts of the robot in a sector of the view: posts, cables or a lid hide some of its readings, or all."""
    draft = start.draft(reference=0.0)
    n, rng = draft.laser.n, start.rng
    view, first = round(n * start.pick((0.1, 0.25, 0.4))), int(rng.integers(n))
    share = start.pick((1.0, 0.6))
    own = 0.25 + 0.15 * rng.random() + 0.08 * np.sin(np.arange(view) / 9)
    for item in draft.scans:
        rays = (first + np.arange(view)) % n
        hit = rng.random(view) < share
        z = np.round(own + 0.005 * rng.normal(size=view), 3)
        item.content["ranges"][rays[hit]] = z[hit]
    if start.chance(0.3):
        draft.drop_odometry()
    return draft


@of(reference=0.0)
def wrong_step(start: Start, draft: Draft) -> None:
    """The driver believes in another angle between rays, and states bearings that fit it."""
    factor, n = start.pick((0.97, 1.02, 1.03, 1.05)), draft.laser.n
    if abs(draft.laser.stride * n * factor) > 360:
        factor = 2 - factor
    ahead = start.chance()  # the first ray is right, or the middle
    for item in draft.scans:
        c = item.content
        step = c["angle_increment"] * factor
        if not ahead:
            c["angle_min"] -= 0.5 * (step - c["angle_increment"]) * (n - 1)
        c |= {"angle_increment": step, "angle_max": c["angle_min"] + step * (n - 1)}
    draft.said = "step of the bearings"


NODES = named(
    two_publishers, drifting_publisher, publisher_of_zeros, transforms_of_two, odometry_starts_again,
    field_changes, order_changes, sent_again, stamped_in_bursts, sectors, mirrored_positions,
    twist_in_odometry, twist_in_degrees, compass_heading, sideways, parts_of_robot,
    wrong_step, wrong_poses, held_odometry, corrected_odometry, frozen_odometry,
)  # fmt: skip
