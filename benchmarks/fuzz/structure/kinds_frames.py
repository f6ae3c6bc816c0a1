"""Frames: names, missing and inverted transforms, other roots, mounts of every kind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.fuzz.structure.draft import (
    Draft,
    Floats,
    Item,
    compose,
    flip,
    inverse,
    logged,
    mount_of,
    vec7,
)
from benchmarks.fuzz.structure.start import LASERS, Start, named, of


def _planar(value: Floats) -> Floats:
    return np.array([value[0], value[1], 2 * np.arctan2(value[5], value[6])])


def _turned(start: Start, yaw: float) -> Draft:
    """Return a log whose laser is turned in base_link; its first ray is where its own bearings begin."""
    laser = start.pick(LASERS)
    return start.draft(replace(laser, yaw=yaw, first=round(laser.first + yaw)))


def prefixed(start: Start, draft: Draft) -> None:
    prefix = start.pick(("robot1/", "/robot1/", "robot_1/base/"))
    draft.frames(lambda name: prefix + name if name not in ("", "map") else name)


def leading_slash(start: Start, draft: Draft) -> None:
    some = start.pick((("laser",), ("laser", "base_link"), ("odom", "base_link", "laser", "map")))
    if start.chance():  # the messages only, not the transforms
        for item in draft.items:
            item.frame = "/" + item.frame if item.frame in some else item.frame
    else:
        draft.frames(lambda name: "/" + name if name in some else name)


def other_names(start: Start) -> Draft:
    names = {
        "base_link": start.pick(("base", "chassis", "body", "robot_base", "base_link_1")),
        "odom": start.pick(("odom", "odom_combined", "wheel_odom", "Odometry", "odom_frame")),
        "laser": start.pick(("lidar_link", "hokuyo", "base_laser_link", "velodyne")),
    }
    draft = start.draft()
    draft.frames(lambda name: names.get(name, name))
    return draft


def no_mount(start: Start, draft: Draft) -> None:
    draft.drop("/tf_static")
    draft.gauges.add("lever")
    draft.said = "no transform|mount"


def no_mount_turned(start: Start) -> Draft:
    """A laser that looks backwards or sideways, and no transform says so."""
    draft = _turned(start, start.pick((180.0, 90.0, -90.0, 30.0)))
    draft.drop("/tf_static")
    draft.gauges.add("lever")
    draft.said = "turned|backwards|yaw|180"
    return draft


def no_frame(start: Start, draft: Draft) -> None:
    for item in draft.on("/scan"):
        item.frame = ""
    draft.gauges.add("lever")


def frame_is_base(start: Start, draft: Draft) -> None:
    draft.drop("/tf_static")
    for item in draft.on("/scan"):
        item.frame = "base_link"
    draft.gauges.add("lever")


def inverted_mount(start: Start, draft: Draft) -> None:
    draft.edges(lambda a, b, v: [(b, a, vec7(*inverse(_planar(v)), z=-v[2]))], child="laser")


@of(reference=0.0)
def inverted_odometry(start: Start, draft: Draft) -> None:
    """The tree hangs from base_link: base_link -> odom."""
    draft.edges(lambda a, b, value: [(b, a, vec7(*inverse(_planar(value))))], child="base_link")
    if start.chance():
        draft.drop("/odom")


@of(reference=0.0)
def map_below_odom(start: Start, draft: Draft) -> None:
    for t, odometry in list(zip(draft.drive.odom_times, draft.drive.odometry, strict=True))[::5]:
        shift = compose(odometry, inverse(draft.drive.pose_at(t)))
        draft.add_transform(t, ("odom", "map", vec7(*shift)))
    draft.expects.add("pose")


def footprint_root(start: Start, draft: Draft) -> None:
    height = start.pick((0.0, 0.1, 0.33))
    draft.frames(lambda name: "base_footprint" if name == "base_link" else name)
    draft.edges(lambda a, b, value: [("base_link", b, value)], child="laser")
    draft.add_static(("base_footprint", "base_link", vec7(0.0, 0.0, 0.0, z=height)))


def long_chain(start: Start, draft: Draft) -> None:
    mount = mount_of(draft.laser)
    turn = np.array([0.2, -0.1, float(start.rng.uniform(-3, 3))])
    chain = [
        ("base_link", "torso", vec7(*turn, z=0.5)),
        ("torso", "arm", vec7(0.0, 0.0, 0.0, z=-0.2)),
        ("arm", "laser", vec7(*compose(inverse(turn), mount))),
    ]
    draft.edges(lambda a, b, value: chain, child="laser")
    if start.chance():  # each transform in a message, some of them in /tf
        parts = [replace(item, content={"transforms": [edge]}, topic=start.pick(("/tf", "/tf_static")))
                 for item in draft.on("/tf_static") for edge in item.content["transforms"]]  # fmt: skip
        draft.drop("/tf_static")
        draft.add(*parts)


def static_in_tf(start: Start, draft: Draft) -> None:
    static = draft.on("/tf_static")[0].content
    draft.drop("/tf_static")
    period = start.pick((0.02, 0.5, 5.0))
    draft.add(*(Item("/tf", "TFMessage", t + start.pick((0.0, 0.1)), logged(t, draft.rng), "", static)
                for t in np.arange(0.0, 21.0, period)))  # fmt: skip


def static_repeated(start: Start, draft: Draft) -> None:
    first = draft.on("/tf_static")[0]
    draft.add(*(replace(first, stamp=t, log=t, arrival=t) for t in (3.0, 9.0, 15.0)))


def several_in_one(start: Start, draft: Draft) -> None:
    """Each message of /tf holds many transforms: wheels, casters, an arm."""
    for item in draft.on("/tf"):
        angle = 5.0 * item.stamp
        more = [("base_link", f"wheel_{i}", vec7(0.0, 0.2 * i, 0.0, pitch=angle)) for i in (-1, 1)]
        item.content["transforms"] = [
            *more,
            *item.content["transforms"],
            ("torso", "head", vec7(0.0, 0.0, 0.1)),
        ]


def upside_down(start: Start) -> Draft:
    """Mounted upside down: seen from the laser, a clockwise turn counts up."""
    spins = start.chance()
    laser = start.pick([one for one in LASERS if (one.sweep != 0) == spins])
    sweep, first = -laser.sweep, -laser.first
    draft = start.draft(replace(laser, sweep=sweep or -1, first=first)) if spins else start.draft(laser)
    yaw = start.pick((0.0, np.pi)) if laser.n * laser.stride == 360 and spins else 0.0
    for content in draft.readings:
        if not spins:
            flip(content)
        low = np.radians(laser.first) + yaw
        content |= {"angle_min": low, "angle_increment": np.radians(laser.stride)}
        content["angle_max"] = low + content["angle_increment"] * (laser.n - 1)
    mount = vec7(*mount_of(draft.laser)[:2], yaw, z=0.25, roll=np.pi)
    draft.edges(lambda a, b, value: [(a, b, mount)], child="laser")
    return draft


def backwards(start: Start) -> Draft:
    return _turned(start, 180.0)


def any_yaw(start: Start) -> Draft:
    return _turned(start, float(start.rng.integers(-179, 180)))


def tilted_little(start: Start, draft: Draft) -> None:
    roll, pitch = np.radians(start.rng.uniform(-3.0, 3.0, 2))
    mount = vec7(*mount_of(draft.laser), z=0.25, roll=roll, pitch=pitch)
    draft.edges(lambda a, b, value: [(a, b, mount)], child="laser")


def high_mount(start: Start, draft: Draft) -> None:
    draft.edges(lambda a, b, value: [(a, b, value + np.r_[0, 0, 1.5, 0, 0, 0, 0])], child="laser")


@of(reference=0.0)
def two_parents(start: Start, draft: Draft) -> None:
    """A localizer publishes map -> base_link beside odom -> base_link."""
    for t in np.arange(0.05, 21.0, start.pick((0.1, 0.5))):
        draft.add_transform(t, ("map", "base_link", vec7(*draft.drive.pose_at(t))))
    draft.expects.add("pose")


def two_trees(start: Start, draft: Draft) -> None:
    draft.add_static(("table", "camera", vec7(1.0, 1.0, 0.0)), ("world", "table", vec7(3.0, 0.0, 0.0)))


def world_above_map(start: Start, draft: Draft) -> None:
    draft.add_static(("world", "map", vec7(3.0, 1.0, 0.5)), ("map", "odom", vec7(0.0, 0.0, 0.0)))


def no_child(start: Start, draft: Draft) -> None:
    for item in draft.on("/odom"):
        item.content = item.content | {"child": ""}
    if start.chance():
        draft.drop("/tf")


def frame_changes(start: Start, draft: Draft) -> None:
    """A driver is started again with another frame name, which is in the tree too."""
    for item in draft.on("/scan"):
        item.frame = "laser" if item.stamp < 12.0 else "laser_frame"
    draft.edges(lambda a, b, value: [(a, b, value), (a, "laser_frame", value)], child="laser")


def rounded_quaternion(start: Start, draft: Draft) -> None:
    sign = start.pick((1.0, -1.0))
    draft.edges(lambda a, b, value: [(a, b, np.r_[value[:3], sign * np.round(value[3:], 4) * 1.003])])


def late_transforms(start: Start, draft: Draft) -> None:
    late = start.pick((2.0, 5.0))
    draft.keep(lambda item: not item.topic.startswith("/tf") or item.log > late or item.topic == "/tf_static")
    for item in draft.on("/tf_static"):
        item.stamp = item.log = item.arrival = late


@of(reference=0.0)
def odometry_of_camera(start: Start, draft: Draft) -> None:
    """The odometry is that of a camera, which looks elsewhere and turns about the base."""
    camera = np.array([start.pick((-0.25, 0.3)), 0.1, start.pick((0.0, np.pi / 2, np.pi))])
    seen = compose(compose(inverse(camera), draft.drive.odometry), camera)
    draft.drop("/tf")
    for item, pose in zip(draft.on("/odom"), seen, strict=True):
        item.content = item.content | {"pose": vec7(*pose), "child": "camera_link", "twist": np.zeros(6)}
    draft.add_static(("base_link", "camera_link", vec7(*camera, z=0.4)))


def optical_frame(start: Start) -> Draft:
    """Scans of a depth camera in its optical frame, whose z axis looks ahead."""
    draft = start.draft(replace(LASERS[4], first=-60, n=121), reference=0.0)
    mount = vec7(*mount_of(draft.laser), z=0.3)
    draft.drop("/tf_static")
    draft.frames(lambda name: "camera_optical" if name == "laser" else name)
    draft.add_static(
        ("base_link", "camera", mount),
        ("camera", "camera_optical", np.array([0, 0, 0, -0.5, 0.5, -0.5, 0.5])),
    )
    return draft


FRAMES = named(
    prefixed, leading_slash, other_names, no_mount, no_mount_turned, no_frame, frame_is_base,
    inverted_mount, inverted_odometry, map_below_odom, footprint_root, long_chain, static_in_tf,
    static_repeated, several_in_one, upside_down, backwards, any_yaw, tilted_little, high_mount,
    two_parents, two_trees, world_above_map, no_child, frame_changes, rounded_quaternion, late_transforms,
    odometry_of_camera, optical_frame,
)  # fmt: skip
