"""Topics: names, several sources of one role, topics of other types, topics without messages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.fuzz.structure.draft import (
    EPOCH,
    Draft,
    Item,
    add_reference,
    compose,
    inverse,
    logged,
    rear_scans,
    vec7,
)
from benchmarks.fuzz.structure.start import Start, named, of

SCAN_NAMES = (
    "/base_scan", "/front/scan", "/robot_1/lidar/scan_raw", "/LIDAR", "/scan_filtered", "scan", "/lidar/a/b/front_left",
)  # fmt: skip
ODOM_NAMES = (
    "/wheel_odom",
    "/odometry/filtered",
    "/robot_base/odom",
    "/diff_drive_controller/odom",
    "/RosAria/pose",
)


def scan_name(start: Start, draft: Draft) -> None:
    draft.rename("/scan", start.pick(SCAN_NAMES))


def odom_name(start: Start, draft: Draft) -> None:
    draft.rename("/odom", start.pick(ODOM_NAMES))


@of(reference=0.0)
def pose_name(start: Start, draft: Draft) -> None:
    name = start.pick(
        ("/mocap/base", "/vrpn_client_node/robot/pose", "/ground_truth", "/NAV/pose", "/amcl_pose")
    )
    kinds = ("PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Odometry")
    kind = start.pick(kinds[:3])
    add_reference(draft, name, kind, rate=start.pick((2.0, 10.0, 50.0)))
    draft.expects.add("pose")


def namespace(start: Start, draft: Draft) -> None:
    whole = start.chance()
    for item in draft.items:
        if whole or not item.topic.startswith("/tf"):
            item.topic = "/robot1" + item.topic


def two_lasers(start: Start, draft: Draft) -> None:
    rear_scans(draft, start.pick(("/scan_rear", "/rear/scan", "/scan2")))
    draft.said = "range sensors that were not used|rear|scan2"


def two_lasers_choice(start: Start, draft: Draft) -> None:
    draft.rename("/scan", "/front/scan")
    rear_scans(draft, "/rear/scan")
    draft.usable = start.chance()
    draft.options = ["--topic", "scan=/front/scan"] if draft.usable else []


def two_lasers_as_one(start: Start, draft: Draft) -> None:
    draft.rename("/scan", "/front/scan")
    rear_scans(draft, "/rear/scan", every=1)
    draft.options = ["--topic", "scan=/front/scan,/rear/scan"]


def two_lasers_one_topic(start: Start, draft: Draft) -> None:
    rear_scans(draft, "/scan", every=start.pick((1, 2)))
    draft.said = "rear_laser"


def two_robots(start: Start, draft: Draft) -> None:
    for item in draft.items:
        item.topic = "/robot1" + item.topic if not item.topic.startswith("/tf") else item.topic
    draft.frames(lambda name: f"robot1/{name}" if name not in ("", "map") else name)
    rear_scans(draft, "/robot2/scan", "robot2/laser")
    draft.edges(lambda a, b, value: [("robot2/base_link", b, value)], child="robot2/laser")
    for t, pose in zip(draft.drive.odom_times, draft.drive.odometry * [1.0, -1.0, -1.0], strict=True):
        edges = {"transforms": [("robot2/odom", "robot2/base_link", vec7(*pose))]}
        content = {"pose": vec7(*pose), "twist": np.zeros(6), "child": "robot2/base_link"}
        log = logged(t, draft.rng)
        draft.add(Item("/tf", "TFMessage", t, log, "", edges))
        draft.add(Item("/robot2/odom", "Odometry", t, log, "robot2/odom", content))
    draft.options = ["--topic", "scan=/robot1/scan"]


@of(reference=0.0)
def two_poses(start: Start, draft: Draft) -> None:
    add_reference(draft, "/nav350/pose")
    for t, pose in zip(draft.drive.odom_times[::5], draft.drive.odometry[::5], strict=True):
        wish = {"pose": vec7(*(pose + [0.5, 0.0, 0.0]))}
        draft.add(Item("/path_follower/wish", "PoseStamped", t, logged(t, draft.rng), "map", wish))


def goals(start: Start, draft: Draft) -> None:
    for topic, kind in (
        ("/move_base_simple/goal", "PoseStamped"),
        ("/initialpose", "PoseWithCovarianceStamped"),
    ):
        for t in draft.rng.uniform(1.0, 20.0, 3):
            content = {"pose": vec7(9.0, 9.0, 1.0), "covariance": np.zeros(36)}
            draft.add(Item(topic, kind, t, logged(t, draft.rng), "map", content))


def _another_odometry(draft: Draft, topic: str) -> None:
    for item in draft.on("/odom")[::2]:
        pose = item.content["pose"] + np.r_[draft.rng.normal(size=2) * 1e-3, np.zeros(5)]
        draft.add(replace(item, topic=topic, content=item.content | {"pose": pose}, log=item.log + 1e-4))


def two_odometries(start: Start, draft: Draft) -> None:
    _another_odometry(draft, start.pick(("/odometry/filtered", "/ekf/odom", "/rf2o_laser_odometry")))


def two_odometries_choice(start: Start, draft: Draft) -> None:
    _another_odometry(draft, "/odometry/filtered")
    draft.rename("/odom", "/odometry/wheels")
    if start.chance():
        draft.options = ["--topic", "odom=/odometry/wheels"]
    else:
        draft.expects.discard("odom")


@of(reference=0.0)
def true_odometry(start: Start, draft: Draft) -> None:
    """Stage publishes the true pose as Odometry."""
    for t in np.arange(0.0, draft.drive.times[-1], 0.1):
        draft.add_odometry("/base_pose_ground_truth", t, draft.drive.pose_at(t), child="")


@of(reference=0.0)
def latched(start: Start, draft: Draft) -> None:
    grid = {"resolution": 0.05, "data": np.full((40, 60), -1), "origin": vec7(-1.0, -1.0, 0.0)}
    draft.add(Item("/map", "OccupancyGrid", -EPOCH if start.chance() else -5000.0, 0.0, "map", grid))
    if start.chance():
        draft.add(Item("/amcl_pose", "PoseWithCovarianceStamped", -3000.0, 0.0, "map",
                       {"pose": vec7(1.0, 1.0, 0.0), "covariance": np.zeros(36)}))  # fmt: skip
    for item in draft.on("/tf_static"):
        item.stamp = start.pick((-EPOCH, -86400.0, 0.0))


def other_types(start: Start, draft: Draft) -> None:
    own = {
        "my_msgs/msg/LaserScan": "std_msgs/Header header\nfloat32[] ranges\n",
        "my_robot_msgs/msg/Odometry": "float64 left\nfloat64 right\n",
        "my_msgs/msg/Twist": "float32 x\n",
    }
    draft.definitions = own
    for k, t in enumerate(np.arange(0.1, 20.0, 0.25)):
        log = logged(t, draft.rng)
        draft.add(
            Item("/imu", "Imu", t, log, "imu", {"omega": 0.1}),
            Item("/status", "String", t, log, "", {"text": f"tick {k} é"}),
            Item("/battery", "Float64", t, log, "", {"value": 24.0}),
            Item("/plan", "Path", t, log, "map", {"poses": [vec7(1.0, 2.0, 0.0)] * 3}),
        )
        for i, name in enumerate(own):
            draft.add(Item(f"/own_{i}", name, t, log, "", {"payload": bytes(16 + 8 * i)}))
    if start.chance():
        draft.add(
            *(Item(f"/camera/raw_{k}", "String", 1.0, 1.0, "", {"text": "x" * 200_000}) for k in range(3))
        )


def many_topics(start: Start, draft: Draft) -> None:
    draft.add(
        *(Item(f"/joint_{k}/state", "Float64", 1.0, 1.0 + k / 100, "", {"value": 0.0}) for k in range(120))
    )


@of(reference=0.0)
def empty_topics(start: Start, draft: Draft) -> None:
    draft.empty = [
        ("/pose", "PoseStamped"),
        ("/scan_rear", "LaserScan"),
        ("/odometry/filtered", "Odometry"),
        ("/points", "PointCloud2"),
    ]
    if start.chance():
        draft.drop("/odom")
        draft.empty.append(("/odom", "Odometry"))


def commands(start: Start, draft: Draft) -> None:
    stamped = [
        replace(item, topic="/cmd_vel_stamped", kind="TwistStamped", frame="base_link")
        for item in draft.on("/cmd_vel")
    ]
    if start.chance():
        draft.keep(lambda item: item.kind != "Twist")
    draft.add(*stamped)


def no_odometry(start: Start, draft: Draft) -> None:
    draft.keep(lambda item: item.topic in ("/scan", "/tf_static", "/pose"))
    draft.expects.discard("odom")


@of(reference=0.0)
def scans_alone(start: Start, draft: Draft) -> None:
    draft.keep(lambda item: item.topic == "/scan")
    draft.expects = set()
    draft.gauges |= {"lever", "yaw"}


@of(reference=0.0)
def transforms_alone(start: Start, draft: Draft) -> None:
    draft.keep(lambda item: item.topic in ("/scan", "/tf_static", "/tf"))


@of(reference=0.0)
def map_in_transforms(start: Start, draft: Draft) -> None:
    """The reference is map -> odom, as SLAM and AMCL publish it, at any rate."""
    every = start.pick((1, 5, 25, 50))
    for t, odometry in list(zip(draft.drive.odom_times, draft.drive.odometry, strict=True))[::every]:
        shift = compose(draft.drive.pose_at(t), inverse(odometry))
        ahead = start.pick((0.0, 0.1)) if every > 1 else 0.0
        edges = {"transforms": [("map", "odom", vec7(*shift))]}
        draft.add(Item("/tf", "TFMessage", t + ahead, logged(t, draft.rng), "", edges))
    draft.expects.add("pose")


TOPICS = named(
    scan_name, odom_name, pose_name, namespace, two_lasers, two_lasers_choice, two_lasers_as_one,
    two_lasers_one_topic, two_robots, two_poses, goals, two_odometries, two_odometries_choice,
    true_odometry, latched, other_types, many_topics, empty_topics, commands, no_odometry, scans_alone,
    transforms_alone, map_in_transforms,
)  # fmt: skip
