"""The uninterpreted contents of a ROS file: topics, and the role of each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from logs.errors import LogError
from logs.ros import cdr
from logs.ros.transform_tree import TransformTree
from logs.transforms import Stamps, are_oriented
from logs.types import Floats

SCAN_TYPE, RANGE_TYPE, TF_TYPE = (
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/Range",
    "tf2_msgs/msg/TFMessage",
)
MULTI_ECHO_TYPE, CLOUD_TYPE = (
    "sensor_msgs/msg/MultiEchoLaserScan",
    "sensor_msgs/msg/PointCloud2",
)
POSE_TYPE, POSE_COVARIANCE_TYPE, TRANSFORM_TYPE = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
)
ODOMETRY_TYPE, TWIST_TYPE, TWIST_STAMPED_TYPE = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/TwistStamped",
)
KEPT_TYPES = frozenset(
    {
        SCAN_TYPE,
        MULTI_ECHO_TYPE,
        RANGE_TYPE,
        TF_TYPE,
        POSE_TYPE,
        POSE_COVARIANCE_TYPE,
        TRANSFORM_TYPE,
        ODOMETRY_TYPE,
        TWIST_TYPE,
        TWIST_STAMPED_TYPE,
    }
)
"""Types whose messages are kept in memory; messages of other types are only counted, and may be read again."""
RAW_TYPES = {
    "sensor_msgs/msg/PointCloud": "a node such as point_cloud_converter",
    "velodyne_msgs/msg/VelodyneScan": "velodyne_pointcloud",
    "livox_ros_driver/msg/CustomMsg": "a converter of Livox messages",
    "livox_ros_driver2/msg/CustomMsg": "a converter of Livox messages",
    "ouster_ros/msg/PacketMsg": "the driver of Ouster",
    "ouster_sensor_msgs/msg/PacketMsg": "the driver of Ouster",
}
"""Types of range sensors that are not read -> what converts them to PointCloud2."""
ENCODINGS = ("cdr", "ros1")
ROLES: dict[str, tuple[str, tuple[str, ...]]] = {
    "scan": ("/scan", (SCAN_TYPE, MULTI_ECHO_TYPE, RANGE_TYPE, CLOUD_TYPE)),
    "pose": ("/pose", (POSE_TYPE, POSE_COVARIANCE_TYPE, TRANSFORM_TYPE, ODOMETRY_TYPE)),
    "odom": ("/odom", (ODOMETRY_TYPE,)),
    "cmd": ("/cmd_vel", (TWIST_STAMPED_TYPE, TWIST_TYPE)),
}
"""Role -> (default topic name, supported types)."""
COVARIANCE_TOPIC = "/pose_with_covariance"
"""The poses of /pose with their covariances, in the message type of AMCL."""
Reread = Callable[[str], Iterator[tuple[int, bytes | memoryview]]]


@dataclass
class Topic:
    """One topic of a recording."""

    name: str
    type: str
    encoding: str = "cdr"
    n_messages: int = 0
    log_times: list[int] = field(default_factory=list)
    """[ns] log time of each message, in the order of the file."""
    payloads: cdr.Messages = field(default_factory=cdr.Messages)
    """The messages, if their type is in `KEPT_TYPES`."""
    stamps: Stamps | None = None
    """(n,) [ns] the times of the messages on the common clock of the log (`settle_clocks`); None: as in the headers."""

    def add(self, log_time: int, payload: bytes | memoryview | None) -> None:
        """Add a message; None: it is only counted."""
        self.n_messages += 1
        self.log_times.append(log_time)
        if payload is not None:
            self.payloads.append(payload)

    def take(self, more: Topic) -> None:
        """Move the messages of another part of the topic to the end, in order."""
        self.n_messages += more.n_messages
        self.log_times += more.log_times
        self.payloads.take(more.payloads)

    def blocks(self) -> Iterator[cdr.MessageColumns]:
        """Yield the columns of the messages, one block for each layout."""
        return cdr.unpack(self.payloads, self.type, self.name, self.encoding)

    @property
    def title(self) -> str:
        """The type, and the encoding of the messages if they are not those of ROS."""
        return self.type if self.encoding in ENCODINGS else f"{self.type} ({self.encoding})"


@dataclass
class Recording:
    """The contents of a ROS file, not yet interpreted."""

    format: str
    topics: dict[str, Topic] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    """Notes on the file itself: its container, not its messages."""
    again: Reread | None = None
    """Read the messages of one topic again: topic -> log time [ns] and payload of each message.
    Point clouds are too large to be kept."""

    def of_type(self, types: Iterable[str]) -> list[str]:
        """Return the names of topics with messages of these types."""
        types = set(types)
        return [
            t.name
            for t in self.topics.values()
            if t.type in types
            and (t.payloads or (t.type == CLOUD_TYPE and t.n_messages > 0 and self.again is not None))
        ]


@dataclass
class Track:
    """Stamped rows of one topic, in time order."""

    stamps: Stamps
    """(n,) [ns]"""
    values: Floats
    """(n, width)"""
    frame: str = ""
    child: str = ""
    notes: list[str] = field(default_factory=list)
    covariances: Floats = field(default_factory=lambda: np.zeros((0, 3, 3)))
    """(n, 3, 3) covariance of x, y, phi; (0, 3, 3): unknown."""


def full_type(msgtype: str) -> str:
    """Return the full type name: `sensor_msgs/LaserScan` -> `sensor_msgs/msg/LaserScan`, `tf/tfMessage` -> tf2 type."""
    package, _, name = msgtype.partition("/")
    name = name.removeprefix("msg/")
    if (package, name) == ("tf", "tfMessage"):
        return TF_TYPE
    return f"{package}/msg/{name}" if name else msgtype


def choose(recording: Recording, role: str, topics: Mapping[str, str] | None, near: str = "") -> str | None:
    """Return the topic for a role; None if no topic fits, or if several fit and none is selected.

    Of the topics of several robots, that in the namespace of the topic `near` is used.
    """
    preferred, types = ROLES[role]
    named = (topics or {}).get(role)
    if named is not None:
        for name in (named, "/" + named, named.removeprefix("/")):
            topic = recording.topics.get(name)
            if (
                topic is not None
                and topic.payloads
                and topic.type in types + ((TF_TYPE,) if role in ("pose", "odom") else ())
            ):
                return name
        raise LogError(
            f"{role}={named} is not a topic with messages of {' or '.join(types)}; "
            f"the log has {listing(recording) or 'no topics'}"
        )
    names = candidates(recording, role)
    if preferred in names:
        return preferred
    shared = [common_namespace(name, near) for name in names]
    names = [name for name, depth in zip(names, shared, strict=True) if depth == max(shared)]
    return names[0] if len(names) == 1 else None


def candidates(recording: Recording, role: str) -> list[str]:
    """Return the topics that may have a role unless others are selected."""
    if role != "pose":
        return recording.of_type(ROLES[role][1])
    names = recording.of_type((POSE_TYPE, POSE_COVARIANCE_TYPE, TRANSFORM_TYPE))
    # a goal and an initial guess are poses too, but not of the robot over time
    return [name for name in names if "goal" not in name and "initial" not in name]


def common_namespace(name: str, other: str) -> int:
    """Return the number of leading namespaces that two names of topics or frames share."""
    shared = 0
    for a, b in zip(name.strip("/").split("/")[:-1], other.strip("/").split("/")[:-1], strict=False):
        if a != b:
            break
        shared += 1
    return shared


class ScanSource(NamedTuple):
    """The scans that are read: those of a topic, or those of one frame in a topic."""

    topic: str
    frame: str = ""
    """Frame of the scans; empty: all frames of the topic."""

    def __str__(self) -> str:
        return f"{self.topic}@{self.frame}" if self.frame else self.topic


def choose_scans(
    recording: Recording, source: str, topics: Mapping[str, str] | None, *, prefer_clouds: bool = False
) -> list[ScanSource]:
    """Return the topics of the scans: those selected, or the only laser, or every Range, or the only point cloud.

    Several topics are selected with commas or a pattern, one frame with an at sign: `scan=/front,/rear`,
    `scan=/sonar/*`, `scan=/scan@front_laser`.

    Raises
    ------
    LogError : If a name matches no topic with readings, several lasers are possible, or no topic has readings.
    """
    there = recording.of_type(ROLES["scan"][1])
    named = (topics or {}).get("scan")
    if named is not None:
        found = list[ScanSource]()
        for word in filter(None, named.split(",")):
            topic, _, frame = word.strip().partition("@")
            pattern = "/" + topic.lstrip("/")
            mine = [name for name in there if fnmatchcase("/" + name.lstrip("/"), pattern)]
            if not mine:
                raise LogError(
                    f"{source}: scan={word} is not a topic with messages of {' or '.join(ROLES['scan'][1])}; "
                    f"the log has {listing(recording) or 'no topics'}"
                )
            sources = [ScanSource(name, frame.strip("/")) for name in mine]
            found += [each for each in sources if each not in found]
        return found
    clouds = recording.of_type((CLOUD_TYPE,))
    lasers = recording.of_type((SCAN_TYPE, MULTI_ECHO_TYPE))
    if clouds and (prefer_clouds or there == clouds):
        lasers = clouds
    if ROLES["scan"][0] in lasers or len(lasers) == 1:
        return [ScanSource(ROLES["scan"][0] if ROLES["scan"][0] in lasers else lasers[0])]
    if lasers:
        raise LogError(
            f"{source} has {len(lasers)} scan topics; select one with "
            f"{', '.join(f'`topics` scan={name}' for name in lasers)}, or combine several into one sensor: "
            f"`topics` scan={','.join(lasers)}"
        )
    if not there:
        raise LogError(
            f"{source} has no PointCloud2, no Range and no LaserScan; it has {listing(recording) or 'no topics'}"
        )
    return [ScanSource(name) for name in there if name not in clouds]


def choices(recording: Recording, role: str) -> str:
    """Return the options that select a topic for a role."""
    return ", ".join(f"`topics` {role}={name}" for name in candidates(recording, role))


def listing(recording: Recording) -> str:
    """Return all topics with their types as text, and what is odd about the types."""
    topics = recording.topics.values()
    text = ", ".join(
        f"{topic.name} ({topic.title}{'' if topic.n_messages else ', no messages'})" for topic in topics
    )
    foreign = sorted({topic.encoding for topic in topics if topic.encoding not in ENCODINGS})
    if foreign:
        return (
            f"{text}; messages in {' and '.join(foreign)} are not read, only those of ROS "
            f"({' and '.join(ENCODINGS)}); record the topics of ROS, or convert these messages"
        )
    raw = [topic for topic in topics if topic.type in RAW_TYPES]
    if raw:
        return (
            f"{text}; {raw[0].type} is not read: replay the log, let {RAW_TYPES[raw[0].type]} publish a PointCloud2, and "
            "record it"
        )
    return text


def check_roles(topics: Mapping[str, str] | None) -> None:
    """Reject an unknown role."""
    unknown = set(topics or {}) - set(ROLES)
    if unknown:
        raise LogError(
            f"no role {', '.join(sorted(unknown))}; expected one of {', '.join(ROLES)}, as in scan=/scan"
        )


def track(topic: Topic, column: str, width: int, *, absolute: bool = False) -> Track:
    """Decode one field of every message of a topic, sorted by stamp.

    With `absolute`, a header stamp of 0 is the time 0 and not a missing stamp.
    """
    n = len(topic.payloads)
    logged = logged_times(topic)
    stamps, values = logged.copy(), np.full((n, width), np.nan)
    frames: dict[tuple[str, str], int] = {}
    for block in topic.blocks():
        values[block.index] = block[column]
        if "sec" in block.places:
            stamps[block.index] = block.stamps_ns
        key = (block.strings.get("frame_id", ""), block.strings.get("child_frame_id", ""))
        frames[key] = frames.get(key, 0) + len(block.index)
    if topic.stamps is not None:
        stamps, absolute = topic.stamps, True
    frame, child = max(frames, key=lambda key: frames[key], default=("", ""))
    notes = [f"{topic.name} changes its frame"] if len(frames) > 1 else []
    stamps, order, more = sort_stamps(topic.name, stamps, stamps if absolute else logged)
    return Track(stamps, values[order], frame.strip("/"), child.strip("/"), notes + more)


def logged_times(topic: Topic) -> Stamps:
    """Return the log times (n,) [ns] of the messages of a topic, in the order of the file."""
    return np.array(topic.log_times, dtype=np.int64)


def sort_stamps(name: str, stamps: Stamps, logged: Stamps) -> tuple[Stamps, NDArray[np.intp], list[str]]:
    """Replace stamps of 0 by the log time, and sort; return the stamps, their order and notes on the changes."""
    notes = []
    absent = (stamps == 0) & (logged != 0)
    if absent.any():
        stamps = np.where(absent, logged, stamps)
        notes.append(f"{name}: {int(absent.sum())} messages have stamp 0, their log time was used")
    back = int((np.diff(stamps) < 0).sum())
    if back:
        notes.append(f"{name}: stamps go back {back} times, sorted")
    order = np.argsort(stamps, kind="stable")
    stamps = stamps[order]
    same = int((np.diff(stamps) == 0).sum())
    if same:
        notes.append(f"{name}: {same} stamps are duplicates, kept")
    return stamps, order, notes


def transform_tree(recording: Recording, near: str = "") -> TransformTree:
    """Collect the transforms of the recording.

    If topics of several namespaces publish a transform between frames of equal names, as several robots do, that in the
    namespace of the topic `near` is used.
    """
    tree = TransformTree()
    found: dict[tuple[str, str], dict[str, list[tuple[Stamps, Floats, NDArray[np.intp]]]]] = {}
    for topic in recording.topics.values():
        if topic.type != TF_TYPE or not topic.payloads:
            continue
        for block in topic.blocks():
            for i in range(block.n_parts):
                part = block.part(i)
                key = (part.strings["frame_id"].strip("/"), part.strings["child_frame_id"].strip("/"))
                samples = found.setdefault(key, {}).setdefault(topic.name, [])
                samples.append((part.stamps_ns, part["transform"], block.index))
    for (parent, child), by_topic in found.items():
        shared = {name: common_namespace(name, near) for name in by_topic}
        for name in (name for name, depth in shared.items() if depth == max(shared.values())):
            stamps, values, index = (np.concatenate(parts) for parts in zip(*by_topic[name], strict=True))
            values = values.astype(np.float64)
            whole = np.isfinite(values).all(axis=1)
            whole[whole] = are_oriented(values[whole, 3:])
            if not whole.all():
                tree.notes.append(
                    f"{name} {parent} -> {child}: {int((~whole).sum())} of {len(whole)} transforms are not finite or have no "
                    "orientation: left out"
                )
            if whole.any():
                kept = np.flatnonzero(whole)[np.argsort(index[whole], kind="stable")]
                logged = logged_times(recording.topics[name])[index[kept]]
                static = name.rstrip("/").endswith("tf_static")
                tree.add(parent, child, stamps[kept], values[kept], is_static=static, logged=logged)
    return tree


def parse_topics(texts: Iterable[str]) -> dict[str, str]:
    """Parse texts such as `scan=/front/scan` to role -> topic.

    Raises
    ------
    LogError
        If a text is not ROLE=NAME, or the role is unknown.
    """
    topics = {}
    for text in texts:
        role, equals, name = text.partition("=")
        if not equals or not name:
            raise LogError(f"topic {text!r} is not ROLE=NAME; expected for example scan=/front/scan")
        topics[role.strip()] = name.strip()
    check_roles(topics)
    return topics
