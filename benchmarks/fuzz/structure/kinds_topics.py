"""Topics and frames: names, several sources of one role, missing and inverted transforms, mounts of every kind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.fuzz.structure.draft import (
    EPOCH,
    Draft,
    Floats,
    Item,
    Laser,
    add_reference,
    compose,
    flip,
    inverse,
    logged,
    mount_of,
    rear_scans,
    vec7,
)  # fmt: skip
from benchmarks.fuzz.structure.start import (
    ALL,
    LASERS,
    SCANS,
    Kind,
    Span,
    Start,
    again,
    call,
    changed,
    contents,
    dropped,
    edges,
    either,
    frames,
    kept,
    kind,
    publish,
    renamed,
    sometimes,
    static,
    transforms,
)  # fmt: skip

SCAN_NAMES = (
    "/base_scan",
    "/front/scan",
    "/robot_1/lidar/scan_raw",
    "/LIDAR",
    "scan",
    "/lidar/a/b/front_left",
)
ODOM_NAMES = (
    "/wheel_odom",
    "/odometry/filtered",
    "/robot_base/odom",
    "/diff_drive_controller/odom",
    "/RosAria/pose",
)
POSE_NAMES = ("/mocap/base", "/vrpn_client_node/robot/pose", "/ground_truth", "/NAV/pose", "/amcl_pose")
POSE_KINDS = ("PoseStamped", "PoseWithCovarianceStamped", "TransformStamped")
GOAL = {"pose": vec7(9.0, 9.0, 1.0), "covariance": np.zeros(36)}
GRID = {"resolution": 0.05, "data": np.full((40, 60), -1), "origin": vec7(-1.0, -1.0, 0.0)}


def two_robots(draft: Draft) -> None:
    """The frames and topics of two robots, each with its namespace."""
    draft.frames(lambda name: f"robot1/{name}" if name not in ("", "map") else name)
    for item in draft.items:
        item.topic = "/robot1" + item.topic if not item.topic.startswith("/tf") else item.topic
    rear_scans(draft, "/robot2/scan", "robot2/laser")
    draft.edges(lambda a, b, value: [("robot2/base_link", b, value)], child="robot2/laser")
    for t, pose in every(draft, 1):
        value, log = vec7(*(pose * [1.0, -1.0, -1.0])), logged(t, draft.rng)
        draft.add(
            Item("/tf", "TFMessage", t, log, "", {"transforms": [("robot2/odom", "robot2/base_link", value)]}),
            Item("/robot2/odom", "Odometry", t, log, "robot2/odom",
                 {"pose": value, "twist": np.zeros(6), "child": "robot2/base_link"}),
        )  # fmt: skip


def other_types(draft: Draft) -> None:
    """Messages of other types than a run needs, also of such that no typestore has."""
    draft.definitions = {"my_msgs/msg/LaserScan": "std_msgs/Header header\nfloat32[] ranges\n"}
    for k, t in enumerate(np.arange(0.1, 20.0, 0.25)):
        log = logged(t, draft.rng)
        draft.add(
            Item("/imu", "Imu", t, log, "imu", {"omega": 0.1}),
            Item("/status", "String", t, log, "", {"text": f"tick {k} é"}),
            Item("/plan", "Path", t, log, "map", {"poses": [vec7(1.0, 2.0, 0.0)] * 3}),
            Item("/own", "my_msgs/msg/LaserScan", t, log, "", {"payload": bytes(16)}),
        )


def another_odometry(draft: Draft, topic: str) -> None:
    """Publish every second message of the odometry once more, with noise."""
    for item in draft.on("/odom")[::2]:
        pose = item.content["pose"] + np.r_[draft.rng.normal(size=2) * 1e-3, np.zeros(5)]
        draft.add(replace(item, topic=topic, content=item.content | {"pose": pose}, log=item.log + 1e-4))


def every(draft: Draft, n: int) -> list[tuple[float, Floats]]:
    """Return time and pose of every n-th message of the odometry."""
    return list(zip(draft.drive.odom_times, draft.drive.odometry, strict=True))[::n]


def map_to_odom(draft: Draft, n: int, ahead: float) -> list[tuple[float, Floats]]:
    """Return the reference as SLAM and AMCL publish it, at a rate, perhaps post-dated."""
    late = ahead * (n > 1)
    return [(t + late, vec7(*compose(draft.drive.pose_at(t), inverse(pose)))) for t, pose in every(draft, n)]


TWO_LASERS = (renamed("/scan", "/front/scan"), call(rear_scans, "/rear/scan", every=1))
TWO_ODOMETRIES = (call(another_odometry, "/odometry/filtered"), renamed("/odom", "/odometry/wheels"))
TOPICS: dict[str, Kind] = {
    "names": kind(renamed("/scan", *SCAN_NAMES), renamed("/odom", *ODOM_NAMES)),
    "pose_name": kind(call(add_reference, POSE_NAMES, POSE_KINDS, (2.0, 10.0, 50.0)), reference=0.0, adds=("pose",)),
    "namespace": kind(
        changed(ALL, lambda m, whole: {"topic": "/robot1" * (whole or not m.topic.startswith("/tf")) + m.topic}, 0.5)
    ),
    "two_lasers": kind(*TWO_LASERS, words=("--topic", "scan=/front/scan"), said="range sensors that were not used"),
    "two_lasers_choice": kind(*TWO_LASERS, usable=False),
    "two_lasers_as_one": kind(*TWO_LASERS, words=("--topic", "scan=/front/scan,/rear/scan")),
    "two_lasers_one_topic": kind(call(rear_scans, "/scan", every=(1, 2)), said="rear_laser"),
    "two_robots": kind(call(two_robots), words=("--topic", "scan=/robot1/scan")),
    "two_poses": kind(
        call(add_reference, "/nav350/pose"),
        publish("/path_follower/wish", "PoseStamped",
                lambda draft: [(t, {"pose": vec7(*(pose + [0.5, 0.0, 0.0]))}) for t, pose in every(draft, 5)]),
        reference=0.0,
    ),
    "goals": kind(*(
        publish(topic, form, lambda draft: [(t, GOAL) for t in draft.rng.uniform(1.0, 20.0, 3)])
        for topic, form in (("/move_base_simple/goal", "PoseStamped"), ("/initialpose", "PoseWithCovarianceStamped"))
    )),
    "two_odometries": kind(*TWO_ODOMETRIES, lacks=("odom",)),
    "two_odometries_choice": kind(*TWO_ODOMETRIES, words=("--topic", "odom=/odometry/wheels")),
    "latched": kind(  # a map and a pose from before the log
        call(lambda draft, at: draft.add(
            Item("/map", "OccupancyGrid", at, 0.0, "map", GRID),
            Item("/amcl_pose", "PoseWithCovarianceStamped", -3000.0, 0.0, "map", GOAL),
        ), (-EPOCH, -5000.0)),
        reference=0.0,
    ),
    "other_types": kind(call(other_types)),
    "empty_topics": kind(
        sometimes(dropped("/odom")), reference=0.0,
        empty=(("/pose", "PoseStamped"), ("/rear", "LaserScan"), ("/points", "PointCloud2"), ("/odom", "Odometry")),
    ),
    "commands": kind(
        again(("/cmd_vel",), lambda m: {"topic": "/cmd_vel_stamped", "kind": "TwistStamped", "frame": "base_link"}),
        sometimes(kept(lambda m: m.kind != "Twist")),
    ),
    "scans_alone": kind(kept(lambda m: m.topic == "/scan"), reference=0.0, lacks=("odom",), gauges=("lever", "yaw")),
    "transforms_alone": kind(kept(lambda m: m.topic in ("/scan", "/tf_static", "/tf")), reference=0.0),
    "map_in_transforms": kind(
        transforms("map", "odom", map_to_odom, (1, 5, 25, 50), (0.0, 0.1)), reference=0.0, adds=("pose",)
    ),
}  # fmt: skip


def inverted(value: Floats) -> Floats:
    """Return the inverse of a planar transform."""
    return vec7(*inverse(np.array([value[0], value[1], 2 * np.arctan2(value[5], value[6])])), z=-value[2])


def turned(*yaws: float) -> Callable[[Start], Laser]:
    """Return what draws a laser that is turned in base_link; its first ray is where its own bearings begin."""

    def draw(start: Start) -> Laser:
        laser, yaw = start.draw(LASERS), start.draw(yaws)
        return replace(laser, yaw=yaw, first=round(laser.first + yaw))

    return draw


def upside_down(start: Start) -> Draft:
    """Mounted upside down: seen from the laser, a clockwise turn counts up."""
    spins = start.draw(0.5)
    laser = start.draw(tuple(one for one in LASERS if (one.sweep != 0) == spins))
    sweep, first = -laser.sweep, -laser.first
    draft = start.draft(replace(laser, sweep=sweep or -1, first=first)) if spins else start.draft(laser)
    yaw = start.draw((0.0, np.pi)) if laser.n * laser.stride == 360 and spins else 0.0
    for content in draft.readings:
        if not spins:
            flip(content)
        low, step = np.radians(laser.first) + yaw, np.radians(laser.stride)
        content |= {"angle_min": low, "angle_increment": step, "angle_max": low + step * (laser.n - 1)}
    mount = vec7(*mount_of(draft.laser)[:2], yaw, z=0.25, roll=np.pi)
    draft.edges(lambda a, b, value: [(a, b, mount)], child="laser")
    return draft


def tilted_little(draft: Draft, roll: float, pitch: float) -> None:
    mount = vec7(*mount_of(draft.laser), z=0.25, roll=np.radians(roll), pitch=np.radians(pitch))
    draft.edges(lambda a, b, value: [(a, b, mount)], child="laser")


def odometry_of_camera(draft: Draft, x: float, yaw: float) -> None:
    """The odometry is that of a camera, which looks elsewhere and turns about the base."""
    camera = np.array([x, 0.1, yaw])
    draft.state(compose(compose(inverse(camera), draft.drive.odometry), camera))
    draft.drop("/tf")
    for item in draft.on("/odom"):
        item.content |= {"child": "camera_link", "twist": np.zeros(6)}
    draft.add_static(("base_link", "camera_link", vec7(*camera, z=0.4)))


def optical_frame(draft: Draft) -> None:
    """Scans of a depth camera in its optical frame, whose z axis looks ahead."""
    draft.drop("/tf_static")
    draft.frames(lambda name: "camera_optical" if name == "laser" else name)
    ahead = np.array([0, 0, 0, -0.5, 0.5, -0.5, 0.5])
    draft.add_static(
        ("base_link", "camera", vec7(*mount_of(draft.laser), z=0.3)), ("camera", "camera_optical", ahead)
    )


SLASHED = (("laser",), ("laser", "base_link"), ("odom", "base_link", "laser", "map"))
FRAMES: dict[str, Kind] = {
    "prefixed": kind(frames(
        lambda name, prefix: prefix + name if name not in ("", "map") else name, ("robot1/", "/robot1/", "robot_1/base/")
    )),
    "leading_slash": kind(either(  # everywhere, or in the messages and not in the transforms
        frames(lambda name, some: "/" * (name in some) + name, SLASHED),
        changed(ALL, lambda m, some: {"frame": "/" * (m.frame in some) + m.frame}, SLASHED),
    )),
    "other_names": kind(frames(
        lambda name, base, odom, laser: {"base_link": base, "odom": odom, "laser": laser}.get(name, name),
        ("base", "chassis", "body", "base_link_1"), ("odom_combined", "wheel_odom", "Odometry"), ("lidar_link", "hokuyo"),
    )),
    "no_mount": kind(dropped("/tf_static"), gauges=("lever",), said="no transform|mount"),
    # a laser that looks backwards or sideways, and no transform says so
    "no_mount_turned": kind(
        dropped("/tf_static"), laser=turned(180.0, 90.0, -90.0, 30.0), gauges=("lever",), said="turned|backwards|yaw|180"
    ),
    "no_frame": kind(changed(SCANS, lambda m: {"frame": ""}), gauges=("lever",)),
    "frame_is_base": kind(dropped("/tf_static"), changed(SCANS, lambda m: {"frame": "base_link"}), gauges=("lever",)),
    "inverted_mount": kind(edges(lambda a, b, value: [(b, a, inverted(value))], child="laser")),
    # the tree hangs from base_link: base_link -> odom
    "inverted_odometry": kind(
        edges(lambda a, b, value: [(b, a, inverted(value))], child="base_link"), sometimes(dropped("/odom")), reference=0.0
    ),
    "map_below_odom": kind(
        transforms("odom", "map", lambda draft: [
            (t, vec7(*compose(pose, inverse(draft.drive.pose_at(t))))) for t, pose in every(draft, 5)
        ]), reference=0.0, adds=("pose",),
    ),
    "footprint_root": kind(
        frames(lambda name: "base_footprint" if name == "base_link" else name),
        edges(lambda a, b, value: [("base_link", b, value)], child="laser"),
        call(lambda draft, z: draft.add_static(("base_footprint", "base_link", vec7(0.0, 0.0, 0.0, z=z))), (0.0, 0.1, 0.33)),
    ),
    "static_in_tf": kind(
        publish("/tf", "TFMessage", lambda draft, period: [
            (t, draft.on("/tf_static")[0].content) for t in np.arange(0.0, 21.0, period)
        ], (0.02, 0.5, 5.0), frame=""), dropped("/tf_static"),
    ),
    "upside_down": upside_down,
    "any_yaw": kind(laser=turned(*map(float, range(-180, 180)))),
    "tilted_little": kind(call(tilted_little, Span(-3, 3), Span(-3, 3))),
    # a localizer publishes map -> base_link next to odom -> base_link
    "two_parents": kind(
        transforms("map", "base_link", lambda draft, period: [
            (t, vec7(*draft.drive.pose_at(t))) for t in np.arange(0.05, 21.0, period)
        ], (0.1, 0.5)), reference=0.0, adds=("pose",),
    ),
    "world_above_map": kind(static(("world", "map", vec7(3.0, 1.0, 0.5)), ("map", "odom", vec7(0.0, 0.0, 0.0)))),
    "no_child": kind(contents(("/odom",), lambda c: {"child": ""}), sometimes(dropped("/tf"))),
    # a driver is started again with another frame name, which is in the tree too
    "frame_changes": kind(
        changed(SCANS, lambda m: {"frame": "laser" if m.stamp < 12.0 else "laser_frame"}),
        edges(lambda a, b, value: [(a, b, value), (a, "laser_frame", value)], child="laser"),
    ),
    "rounded_quaternion": kind(edges(
        lambda a, b, value, sign: [(a, b, np.r_[value[:3], sign * np.round(value[3:], 4) * 1.003])], (1.0, -1.0)
    )),
    "odometry_of_camera": kind(call(odometry_of_camera, (-0.25, 0.3), (0.0, np.pi / 2, np.pi)), reference=0.0),
    "optical_frame": kind(call(optical_frame), laser=replace(LASERS[4], first=-60, n=121), reference=0.0),
}  # fmt: skip
