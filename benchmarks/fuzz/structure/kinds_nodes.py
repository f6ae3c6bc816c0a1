"""Nodes: two that publish one thing, drivers that start or send again, odometry of mixed frames and units, parts of the robot, steps."""

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
)  # fmt: skip
from benchmarks.fuzz.structure.drives import PERIOD
from benchmarks.fuzz.structure.start import (
    LASERS,
    ODOM,
    Kind,
    Span,
    again,
    call,
    contents,
    dropped,
    either,
    kind,
    odometry,
    sometimes,
)  # fmt: skip


def also(draft: Draft, topic: str, poses: Floats, later: float = 0.007) -> None:
    """Publish every second one of further poses on a topic, some time [s] later."""
    for item, pose in list(zip(draft.on(topic), poses, strict=True))[::2]:
        stated = (
            {"pose": vec7(*pose)}
            if topic == "/odom"
            else {"transforms": [("odom", "base_link", vec7(*pose))]}
        )
        log = item.log + later
        draft.add(
            replace(item, stamp=item.stamp + later, log=log, arrival=log, content=item.content | stated)
        )


def driven(draft: Draft, first: Floats, way: float, turn: float) -> Floats:
    """Return the odometry (n, 3) of another filter: its first pose, and the scales of its steps."""
    odometry = draft.drive.odometry
    poses = [first]
    for step in compose(inverse(odometry[:-1]), odometry[1:]) * [way, way, turn]:
        poses.append(compose(poses[-1], step))
    return np.array(poses)


def odometry_starts_again(draft: Draft, at: float, name: str) -> None:
    """The driver of the wheels is started again: from 0, in a frame of another name or the same."""
    odometry, late = draft.drive.odometry.copy(), draft.drive.odom_times > at
    odometry[late] = compose(inverse(odometry[late][0]), odometry[late])
    draft.state(odometry)
    for item, transform, is_late in zip(draft.on("/odom"), draft.on("/tf"), late, strict=True):
        item.frame = name if is_late else item.frame
        transform.content = {"transforms": [(item.frame, *transform.content["transforms"][0][1:])]}


def field_changes(draft: Draft, at: float) -> None:
    """The driver of the laser is started again, with half of the field of view."""
    for item in draft.scans:
        if item.stamp > at:
            c = item.content
            c |= {name: c[name][90:271] for name in ("ranges", "intensities")}
            c["angle_min"] += 90 * c["angle_increment"]
            c["angle_max"] = c["angle_min"] + 180 * c["angle_increment"]
            item.stamp += 90 * c["time_increment"]
            draft.true_times[item.scan], draft.first_rays[item.scan] = item.stamp, -90


def order_changes(draft: Draft, at: float) -> None:
    """The driver of the laser is started again, and sends the array the other way, with increments that fit."""
    for item in draft.scans:
        if item.stamp > at:
            reverse(item.content)
            reverse_times(item)


def sent_again(draft: Draft) -> None:
    """A relay sends the latest scan twice as often as the laser measures, with new stamps."""
    for item in draft.scans:
        item.content["intensities"] = np.zeros(0)
        k, at, log = 1000 + item.scan, item.stamp + PERIOD / 2, item.log + PERIOD / 2
        draft.true_times[k] = at
        draft.add(replace(item, stamp=at, log=log, arrival=log, scan=k))


def stamped_in_bursts(draft: Draft, n: int) -> None:
    """Scans are stamped as they arrive, several at once."""
    for item in draft.scans:
        complete = start_of(draft.laser, item.scan // n * n + n - 1) + 0.11
        item.stamp = complete + 0.002 * (item.scan % n)
        item.log = item.arrival = item.stamp + 0.003


def twist_in_odometry(draft: Draft) -> None:
    """Only the twist is filled in, along x and y of the odometry frame."""
    for item, (_, _, phi) in zip(draft.on("/odom"), draft.drive.odometry, strict=True):
        v, omega = item.content["twist"][[0, 5]]
        item.content |= {
            "pose": UNKNOWN,
            "twist": np.array([v * np.cos(phi), v * np.sin(phi), 0.0, 0.0, 0.0, omega]),
        }


def corrected(odometry: Floats, times: Floats, rng: np.random.Generator) -> Floats:
    """Return the odometry of a filter whose poses are corrected a few times."""
    for at in rng.uniform(3, 19, 3):
        odometry[times > at] = compose(rng.uniform(-0.6, 0.6, 3), odometry[times > at])
    return odometry


def frozen(odometry: Floats, times: Floats, at: float, long: float, has_lost: bool) -> Floats:
    """Return the odometry of a driver that hangs, and goes on where it was or where the robot is."""
    first, last = np.searchsorted(times, [at, at + long])
    if has_lost:
        odometry[last:] = compose(odometry[first], compose(inverse(odometry[last]), odometry[last:]))
    odometry[first:last] = odometry[first]
    return odometry


def sideways(draft: Draft, degrees: float) -> None:
    """A robot that may drive anywhere: its base_link is at the laser, and looks elsewhere than it drives."""
    drive, place = draft.drive, np.array([*MOUNT, 0.0])

    def looks(times: Floats) -> Floats:
        return np.multiply.outer(degrees + 60.0 * np.sin(0.5 * times), [0.0, 0.0, 1.0])

    for item in draft.scans:
        off = looks(start_of(draft.laser, item.scan))[2]
        z = np.roll(drive.flashes[item.scan], -round(off))[np.arange(-180, 180)]
        z = z + 0.01 * draft.rng.normal(size=360)
        item.content["ranges"] = np.where(z > draft.laser.range_max, np.inf, np.round(z, 3))
    draft.drive = replace(drive, poses=compose(drive.poses, place) + np.radians(looks(drive.times)))
    draft.state(compose(drive.odometry, place) + np.radians(looks(drive.odom_times)))
    for item in draft.on("/odom"):
        item.content["twist"] = np.zeros(6)
    draft.drop("/tf_static")
    draft.add_static(("base_link", "laser", vec7(0.0, 0.0, 0.0, z=0.25)))


def parts_of_robot(draft: Draft, share_of_view: float, share: float) -> None:
    """Parts of the robot in a sector of the view: posts, cables or a lid hide some of its readings, or all."""
    n, rng = draft.laser.n, draft.rng
    view, first = round(n * share_of_view), int(rng.integers(n))
    own = 0.25 + 0.15 * rng.random() + 0.08 * np.sin(np.arange(view) / 9)
    for item in draft.scans:
        rays, hit = (first + np.arange(view)) % n, rng.random(view) < share
        item.content["ranges"][rays[hit]] = np.round(own + 0.005 * rng.normal(size=view), 3)[hit]


def wrong_step(draft: Draft, factor: float, is_first_right: bool) -> None:
    """The driver believes in another angle between rays, and states bearings that fit it; the first or the middle one is right."""
    n = draft.laser.n
    factor = 2 - factor if abs(draft.laser.stride * n * factor) > 360 else factor
    for c in draft.readings:
        step = c["angle_increment"] * factor
        c["angle_min"] -= (not is_first_right) * 0.5 * (step - c["angle_increment"]) * (n - 1)
        c |= {"angle_increment": step, "angle_max": c["angle_min"] + step * (n - 1)}


ELSEWHERE, UNKNOWN = np.array([1.0, 0.5, 0.6]), np.r_[np.zeros(6), 1.0]
NODES: dict[str, Kind] = {
    # wheels and a filter publish the odometry; the filter begins elsewhere, or at the same place
    "two_publishers": kind(
        call(lambda draft: also(draft, "/odom", compose(ELSEWHERE, draft.drive.odometry))), sometimes(dropped("/tf")),
        reference=0.0,
    ),
    "drifting_publisher": kind(call(
        lambda draft, turn: also(draft, "/odom", driven(draft, draft.drive.odometry[0], 1.05, turn)), (0.9, 1.1)
    ), reference=0.0),
    # a node that does nothing publishes twice as often as the wheels
    "publisher_of_zeros": kind(
        again(ODOM, lambda m: {"stamp": m.stamp + 0.003, "log": m.log + 0.003, "content": {"pose": UNKNOWN}}),
        again(ODOM, lambda m: {"stamp": m.stamp + 0.006, "log": m.log + 0.006} if m.content["pose"] is UNKNOWN else None),
        reference=0.0,
    ),
    "transforms_of_two": kind(
        call(lambda draft, first: also(draft, "/tf", driven(draft, first, 1.02, 0.95), later=0.011), (np.zeros(3), ELSEWHERE)),
        dropped("/odom"), reference=0.0,
    ),
    "odometry_starts_again": kind(
        call(odometry_starts_again, Span(6, 14), ("odom", "odom_1")), sometimes(dropped("/odom")), reference=0.0,
        said="jumps|no odometry after|two parents",
    ),
    "field_changes": kind(call(field_changes, Span(6, 14)), laser=LASERS[0], reference=0.0),
    "order_changes": kind(call(order_changes, Span(6, 14)), laser=LASERS[0], reference=0.0),
    "sent_again": kind(call(sent_again), reference=0.0, spins=True),
    "stamped_in_bursts": kind(call(stamped_in_bursts, (2, 3, 5)), reference=0.0, spins=True),
    # the y of the odometry is to the right, or x and y are exchanged; its heading is right
    "mirrored_positions": kind(
        either(odometry(lambda p, t: p * [1, -1, 1]), odometry(lambda p, t: p[:, [1, 0, 2]])), reference=0.0,
        said="positions are mirrored",
    ),
    "twist_in_odometry": kind(dropped("/tf"), call(twist_in_odometry), reference=0.0, said="frame of the odometry"),
    # only the twist is filled in, in degrees per second
    "twist_in_degrees": kind(
        dropped("/tf"), contents(ODOM, lambda c: {"pose": UNKNOWN, "twist": c["twist"] * np.r_[np.ones(5), 180 / np.pi]}),
        reference=0.0, said="degrees",
    ),
    # the heading is that of a compass, and the positions begin where the robot is switched on
    "compass_heading": kind(odometry(lambda p, t, by: p + [0.0, 0.0, by], (0.3, 0.8, np.pi / 2, -2.2)), reference=0.0,
                            said="differs from its heading"),
    # single messages of the odometry are wrong, as of a damaged byte or a register that is read as 0
    "wrong_poses": kind(
        odometry(lambda p, t, keep, off: np.where((np.arange(len(p)) % 83 == 40)[:, None], keep * p + off, p), (1.0, 0.0),
                 (np.array([0.6, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))),
        either(dropped("/odom"), dropped("/tf")), reference=0.0,
    ),
    # the odometry is published more often than the wheels are read
    "held_odometry": kind(odometry(lambda p, t, n: p[np.arange(len(p)) // n * n], (5, 10)), reference=0.0),
    "corrected_odometry": kind(call(lambda draft: draft.state(
        corrected(draft.drive.odometry.copy(), draft.drive.odom_times, draft.rng)
    )), reference=0.0),
    "frozen_odometry": kind(odometry(frozen, Span(5, 14), (1.0, 3.0), 0.5), reference=0.0),
    "sideways": kind(call(sideways, (90.0, 0.0)), laser=replace(LASERS[3], first=-180, n=360), reference=0.0),
    "parts_of_robot": kind(call(parts_of_robot, (0.1, 0.25, 0.4), (1.0, 0.6)), sometimes(call(Draft.drop_odometry), share=0.3)),
    "wrong_step": kind(call(wrong_step, (0.97, 1.02, 1.03, 1.05), 0.5), reference=0.0, said="step of the bearings"),
}  # fmt: skip
