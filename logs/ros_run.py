"""From the messages of any ROS file to a Run: which topic plays which role, and what its numbers mean."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from logs import cdr
from logs.errors import LogError
from logs.run import Floats, PoseFrame, RangeSensor, Run
from logs.transforms import Stamps, TransformTree, to_planar, wrap

SCAN, TF = "sensor_msgs/msg/LaserScan", "tf2_msgs/msg/TFMessage"
POSE, POSE_COV = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
ODOMETRY, TWIST, TWIST_STAMPED = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/TwistStamped",
)
KNOWN = frozenset({SCAN, TF, POSE, POSE_COV, ODOMETRY, TWIST, TWIST_STAMPED})
"""Types whose messages are kept in memory; others are only counted."""

ENCODINGS = ("cdr", "ros1")

ROLES: dict[str, tuple[str, tuple[str, ...]]] = {
    "scan": ("/scan", (SCAN,)),
    "pose": ("/pose", (POSE, POSE_COV, ODOMETRY)),
    "odom": ("/odom", (ODOMETRY,)),
    "cmd": ("/cmd_vel", (TWIST_STAMPED, TWIST)),
}
"""Role -> (the name that needs no telling, the types that can play it)."""
MAPS, BASES = ("map", "world"), ("base_link", "base_footprint", "base")
UPRIGHT = 0.98  # cosine of the tilt (11°) up to which a laser counts as level


@dataclass
class Topic:
    """One topic of a recording."""

    name: str
    type: str
    encoding: str = "cdr"
    n_messages: int = 0
    log_times: list[int] = field(default_factory=list)
    """[ns] of each message, in the order of the file."""
    payloads: list[bytes] = field(default_factory=list)
    """The messages, where their type is one of `KNOWN`."""


@dataclass
class Recording:
    """What a ROS file holds, before anybody says what it means."""

    format: str
    topics: dict[str, Topic] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)

    def of_type(self, types: Iterable[str]) -> list[str]:
        """Return the names of topics with messages of these types."""
        types = set(types)
        return [t.name for t in self.topics.values() if t.type in types and t.payloads]


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


def full_type(msgtype: str) -> str:
    """Return the full name: `sensor_msgs/LaserScan` -> `sensor_msgs/msg/LaserScan`; tf's old name is renewed."""
    package, _, name = msgtype.partition("/")
    name = name.removeprefix("msg/")
    if (package, name) == ("tf", "tfMessage"):
        return TF
    return f"{package}/msg/{name}" if name else msgtype


def choose(recording: Recording, role: str, topics: Mapping[str, str] | None) -> str | None:
    """Return the topic that plays a role, or None where none or several could and none was named."""
    preferred, types = ROLES[role]
    named = (topics or {}).get(role)
    if named is not None:
        for name in (named, "/" + named, named.removeprefix("/")):
            topic = recording.topics.get(name)
            if (
                topic is not None
                and topic.payloads
                and topic.type in types + ((TF,) if role == "pose" else ())
            ):
                return name
        raise LogError(
            f"{role}={named} is no topic with messages of {' or '.join(types)}; "
            f"there are {listing(recording) or 'no topics'}"
        )
    names = recording.of_type(types if role != "pose" else (POSE, POSE_COV))
    if preferred in names:
        return preferred
    if role == "pose":  # a goal or a first guess is a pose too, but not where the robot was
        names = [name for name in names if "goal" not in name and "initial" not in name]
    return names[0] if len(names) == 1 else None


def choices(recording: Recording, role: str) -> str:
    """Return what the user may type to name a topic for a role."""
    return ", ".join(f"--topic {role}={name}" for name in recording.of_type(ROLES[role][1]))


def listing(recording: Recording) -> str:
    """Return every topic with its type."""
    return ", ".join(f"{topic.name} ({topic.type})" for topic in recording.topics.values())


def check_roles(topics: Mapping[str, str] | None) -> None:
    """Refuse a role that does not exist."""
    unknown = set(topics or {}) - set(ROLES)
    if unknown:
        raise LogError(f"no role {', '.join(sorted(unknown))}; expected {', '.join(ROLES)} as in scan=/scan")


def track(topic: Topic, column: str, width: int, *, absolute: bool = False) -> Track:
    """Decode one field of every message of a topic, sorted by stamp.

    With `absolute`, a header stamp of 0 is the time 0, not a stamp that the driver forgot.
    """
    n = len(topic.payloads)
    logged = np.array(topic.log_times, dtype=np.int64)
    stamps, values = logged.copy(), np.full((n, width), np.nan)
    frames: dict[tuple[str, str], int] = {}
    for block in cdr.unpack(topic.payloads, topic.type, topic.name, topic.encoding):
        values[block.index] = block[column]
        if "sec" in block.places:
            stamps[block.index] = block.stamps_ns
        key = (block.strings.get("frame_id", ""), block.strings.get("child_frame_id", ""))
        frames[key] = frames.get(key, 0) + len(block.index)
    frame, child = max(frames, key=lambda key: frames[key], default=("", ""))
    notes = [f"{topic.name} changes its frame"] if len(frames) > 1 else []
    stamps, order, more = settle(topic.name, stamps, stamps if absolute else logged)
    return Track(stamps, values[order], frame.strip("/"), child.strip("/"), notes + more)


def settle(name: str, stamps: Stamps, logged: Stamps) -> tuple[Stamps, NDArray[np.intp], list[str]]:
    """Replace stamps that are 0 by the log time, and sort; say what was done."""
    notes = []
    absent = (stamps == 0) & (logged != 0)
    if absent.any():
        stamps = np.where(absent, logged, stamps)
        notes.append(f"{name}: {int(absent.sum())} messages have stamp 0, their log time was taken")
    back = int((np.diff(stamps) < 0).sum())
    if back:
        notes.append(f"{name}: stamps go back {back} times, sorted")
    order = np.argsort(stamps, kind="stable")
    stamps = stamps[order]
    same = int((np.diff(stamps) == 0).sum())
    if same:
        notes.append(f"{name}: {same} stamps are duplicates, kept")
    return stamps, order, notes


def transform_tree(recording: Recording) -> TransformTree:
    """Collect every transform of the recording."""
    tree = TransformTree()
    for topic in recording.topics.values():
        if topic.type != TF or not topic.payloads:
            continue
        edges: dict[tuple[str, str], list[tuple[Stamps, Floats]]] = {}
        for block in cdr.unpack(topic.payloads, topic.type, topic.name, topic.encoding):
            for i in range(block.n_parts):
                part = block.part(i)
                key = (part.strings["frame_id"].strip("/"), part.strings["child_frame_id"].strip("/"))
                edges.setdefault(key, []).append((part.stamps_ns, part["transform"]))
        for (parent, child), samples in edges.items():
            stamps = np.concatenate([stamps for stamps, _ in samples])
            values = np.concatenate([values for _, values in samples]).astype(np.float64)
            whole = np.isfinite(values).all(axis=1) & (np.abs(values[:, 3:]).sum(axis=1) > 0)
            if whole.any():
                static = topic.name.rstrip("/").endswith("tf_static")
                tree.add(parent, child, stamps[whole], values[whole], is_static=static)
    return tree


@dataclass
class _Scans:
    """Scans of one geometry, as the driver sent them."""

    stamps: Stamps
    ranges: Floats
    bearings: Floats
    time_increment: float
    scan_time: float
    range_min: float
    range_max: float
    frame: str
    notes: list[str]


def read_scans(topic: Topic) -> _Scans:
    """Decode LaserScan messages; those of another geometry than most are dropped and counted."""
    n = len(topic.payloads)
    blocks = list(cdr.unpack(topic.payloads, topic.type, topic.name, topic.encoding))
    shapes: dict[tuple[int, bytes], int] = {}
    keys = np.empty(n, dtype=object)
    for block in blocks:
        n_rays = block.places["ranges"].count
        for i, limits in zip(block.index.tolist(), block["limits"], strict=True):
            keys[i] = (n_rays, np.round(limits[[0, 2, 5, 6]], 5).tobytes())
    for key in keys.tolist():
        shapes[key] = shapes.get(key, 0) + 1
    best = max(shapes, key=lambda key: shapes[key])
    kept = np.array([key == best for key in keys.tolist()], dtype=np.bool_)
    ranges = np.empty((n, best[0]))
    stamps = np.array(topic.log_times, dtype=np.int64)
    limits, frame = np.zeros(7), ""
    for block in blocks:
        if block.places["ranges"].count != best[0]:
            continue
        ranges[block.index] = block["ranges"]
        stamps[block.index] = block.stamps_ns
        mine = np.flatnonzero(kept[block.index])
        if len(mine):
            limits, frame = block["limits"][mine[0]].astype(np.float64), block.strings["frame_id"].strip("/")
    stamps, order, notes = settle(topic.name, stamps[kept], np.array(topic.log_times, dtype=np.int64)[kept])
    if not kept.all():
        notes.append(f"{topic.name}: {int((~kept).sum())} scans of another geometry than most were dropped")
    angle_min, angle_max, increment, time_increment, scan_time, range_min, range_max = limits.tolist()
    if increment == 0 and best[0] > 1:
        increment = (angle_max - angle_min) / (best[0] - 1)
    if not best[0] or (best[0] > 1 and not abs(increment) > 1e-9):
        raise LogError(
            f"{topic.name}: scans have {best[0]} rays and angle_increment {increment}; no bearings"
        )
    return _Scans(
        stamps, ranges[kept][order], angle_min + increment * np.arange(best[0]), time_increment, scan_time,
        range_min, range_max, frame, notes,
    )  # fmt: skip


def clean_ranges(scans: _Scans) -> None:
    """Bring missing returns to REP-117, in place; what was changed is noted.

    A range of exactly 0 is what many drivers send for "no measurement": it tells nothing, so it becomes nan.
    """
    ranges = scans.ranges
    finite = np.isfinite(ranges)
    if not (np.isfinite(scans.range_max) and scans.range_max > max(scans.range_min, 0.0)):
        top = float(ranges[finite].max()) if finite.any() else 1.0
        scans.notes.append(
            f"range_max {scans.range_max:g} makes no sense, the largest range {top:g} m was taken"
        )
        scans.range_max = max(top, 1e-3)
    if not 0 <= scans.range_min < scans.range_max:
        scans.notes.append(f"range_min {scans.range_min:g} makes no sense, 0 was taken")
        scans.range_min = 0.0
    zero, above = ranges == 0, finite & (ranges > scans.range_max)
    broken = finite & (ranges < 0)
    near = finite & (ranges > 0) & (ranges < scans.range_min)
    ranges[zero | broken], ranges[near], ranges[above] = np.nan, -np.inf, np.inf
    for count, what in (
        (int(zero.sum()), "are exactly 0, which tells nothing: nan"),
        (int(broken.sum()), "are negative: nan"),
        (int(near.sum()), f"are below range_min {scans.range_min:g} m: -inf"),
        (int(above.sum()), f"are above range_max {scans.range_max:g} m: +inf"),
    ):
        if count:
            scans.notes.append(f"{count} ranges {what}")


def order_rays(scans: _Scans, *, upside_down: bool) -> None:
    """Make bearings increase, counter-clockwise seen from above, within a turn, in place."""
    if scans.bearings[-1] < scans.bearings[0]:
        _reverse(scans)
        scans.notes.append("the laser sweeps clockwise: rays were reversed")
    if upside_down:
        scans.bearings = -scans.bearings
        _reverse(scans)
        scans.notes.append("the laser hangs upside down: rays were mirrored")
    n_turn = int(np.searchsorted(scans.bearings, scans.bearings[0] + 2 * np.pi - 1e-4))
    if n_turn < len(scans.bearings):
        scans.notes.append(f"{len(scans.bearings) - n_turn} rays repeat others after a full turn, dropped")
        scans.bearings, scans.ranges = scans.bearings[:n_turn], scans.ranges[:, :n_turn]
    inside = wrap(scans.bearings)
    if np.abs(inside - scans.bearings).max() > 1e-3 and scans.time_increment == 0:
        first = int(np.argmin(inside))
        scans.bearings, scans.ranges = np.roll(inside, -first), np.roll(scans.ranges, -first, axis=1)


def _reverse(scans: _Scans) -> None:
    """Number the rays from the other end; the stamp stays that of ray 0."""
    scans.bearings, scans.ranges = scans.bearings[::-1].copy(), scans.ranges[:, ::-1].copy()
    if scans.time_increment:
        last = round((len(scans.bearings) - 1) * scans.time_increment * 1e9)
        scans.stamps, scans.time_increment = scans.stamps + last, -scans.time_increment


def to_run(recording: Recording, source: str, topics: Mapping[str, str] | None = None) -> Run:
    """Interpret a recording."""
    from logs import own_run

    check_roles(topics)
    if own_run.is_own(recording, topics):
        return own_run.to_run(recording, source)
    scan_name = choose(recording, "scan", topics)
    if scan_name is None:
        several = recording.of_type((SCAN,))
        if several:
            raise LogError(
                f"{source} has {len(several)} scan topics; choose with {choices(recording, 'scan')}"
            )
        raise LogError(f"{source} has no LaserScan; it has {listing(recording) or 'no topics'}")
    scans = read_scans(recording.topics[scan_name])
    clean_ranges(scans)
    tree = transform_tree(recording)
    odom_name, cmd_name = choose(recording, "odom", topics), choose(recording, "cmd", topics)
    odom = _odometry(recording, odom_name)
    base = tree.first_ancestor(scans.frame, (*BASES, *((odom.child,) if odom and odom.child else ())))
    mount, height, upside_down = _mount(tree, base, scans)
    pose, frame, pose_source = _reference(recording, topics, tree, base, scans, odom, odom_name)
    order_rays(scans, upside_down=upside_down)
    command = None
    if cmd_name is not None:
        command = track(recording.topics[cmd_name], "twist", 6)
    notes = [*scans.notes]
    for part in (pose, odom, command):
        notes += [note for note in (part.notes if part else []) if note not in notes]
    for role, name in (("odom", odom_name), ("cmd", cmd_name)):
        if name is None and choices(recording, role):
            notes.append(f"several topics could be {role}, none was taken: {choices(recording, role)}")
    if tree.conflicts:
        notes.append(f"frames with two parents: {', '.join(tree.conflicts)}")
    return _assemble(
        scans, mount, height, pose, frame, odom, command,
        meta={
            "source": source,
            "format": recording.format,
            "scan_topic": scan_name,
            "pose_source": pose_source,
            **({"odom_topic": odom_name} if odom_name else {}),
            **({"cmd_topic": cmd_name} if cmd_name else {}),
            **({"notes": "; ".join(notes)} if notes else {}),
        },
        attachments=recording.attachments,
    )  # fmt: skip


def _odometry(recording: Recording, name: str | None) -> Track | None:
    if name is None:
        return None
    topic = recording.topics[name]
    pose, twist = track(topic, "pose", 7), track(topic, "twist", 6)
    pose.values = np.column_stack([to_planar(pose.values), twist.values[:, [0, 5]]])  # (n, 5)
    return pose


def _mount(tree: TransformTree, base: str | None, scans: _Scans) -> tuple[Floats, float, bool]:
    """Return the laser in base_link (3,), its height [m] and whether it hangs upside down."""
    if scans.frame in BASES:
        return np.zeros(3), 0.0, False
    place = tree.place(base, scans.frame) if base is not None else None
    if place is None:
        scans.notes.append(f"no transform base_link -> {scans.frame or 'laser'}: the mount was taken as 0")
        return np.zeros(3), 0.0, False
    if abs(place.up) < UPRIGHT:
        scans.notes.append(
            f"the laser is tilted by {np.degrees(np.arccos(abs(place.up))):.0f}°, taken as level"
        )
    if not place.is_static and np.ptp(place.poses, axis=0).max() > 1e-3:
        scans.notes.append("the laser moves on the robot; its first place was taken")
    return place.poses[0], place.height, place.up < 0


def _reference(
    recording: Recording,
    topics: Mapping[str, str] | None,
    tree: TransformTree,
    base: str | None,
    scans: _Scans,
    odom: Track | None,
    odom_name: str | None,
) -> tuple[Track | None, PoseFrame, str]:
    """Return the poses, whose they are, and where they come from: /pose, then /tf, then any pose, then /odom."""
    name = choose(recording, "pose", topics)
    asked = (topics or {}).get("pose") is not None
    if name is not None and (asked or name == ROLES["pose"][0]) and recording.topics[name].type != TF:
        return _poses(recording, name), "base_link", _pose_source(recording, name)
    for root in MAPS:
        for frame, whose in ((base, "base_link"), ("base_link", "base_link"), (scans.frame, "laser")):
            place = tree.place(root, frame) if frame else None
            if place is not None and frame != root and not place.is_static:
                found = Track(place.stamps, place.poses, root)
                return found, ("laser" if whose == "laser" else "base_link"), f"/tf {root} -> {frame}"
    if name is not None and recording.topics[name].type != TF:
        return _poses(recording, name), "base_link", _pose_source(recording, name)
    if odom is not None:
        return Track(odom.stamps, odom.values[:, :3], odom.frame), "base_link", f"odometry {odom_name}"
    if choices(recording, "pose"):
        raise LogError(
            f"several topics could be the reference pose; choose with {choices(recording, 'pose')}"
        )
    return None, "base_link", "none"


def _pose_source(recording: Recording, name: str) -> str:
    is_odometry = recording.topics[name].type == ODOMETRY and "odom" in name
    return f"odometry {name}" if is_odometry else name


def _poses(recording: Recording, name: str) -> Track:
    found = track(recording.topics[name], "pose", 7)
    found.values = to_planar(found.values)
    return found


def _assemble(
    scans: _Scans,
    mount: Floats,
    height: float,
    pose: Track | None,
    frame: PoseFrame,
    odom: Track | None,
    command: Track | None,
    *,
    meta: dict[str, str],
    attachments: Mapping[str, bytes],
) -> Run:
    tracks = [scans.stamps, *(part.stamps for part in (pose, odom, command) if part is not None)]
    epoch = min(int(stamps[0]) for stamps in tracks if len(stamps))
    steps = np.diff(scans.stamps)
    period = float(np.median(steps)) / 1e9 if len(steps) else 0.0
    period = period if period > 0 else scans.scan_time if scans.scan_time > 0 else 0.1
    none = np.zeros(0, dtype=np.int64)
    poses = pose.values if pose is not None else np.zeros((0, 3))
    driven = odom.values if odom is not None else np.zeros((0, 5))
    twists = command.values[:, [0, 5]] if command is not None else np.zeros((0, 2))
    return Run(
        sensor=RangeSensor(
            bearings=scans.bearings,
            range_min=scans.range_min,
            range_max=scans.range_max,
            mount=mount,
            rate=1.0 / period,
            sweep_time=scans.time_increment * len(scans.bearings),
            height=height,
        ),
        stamps=(scans.stamps - epoch) / 1e9,
        ranges=scans.ranges,
        pose_stamps=((pose.stamps if pose is not None else none) - epoch) / 1e9,
        poses=poses,
        odom_stamps=((odom.stamps if odom is not None else none) - epoch) / 1e9,
        odometry=driven[:, :3],
        odom_twists=driven[:, 3:],
        cmd_stamps=((command.stamps if command is not None else none) - epoch) / 1e9,
        commands=twists,
        pose_frame=frame,
        epoch_ns=epoch,
        meta=meta,
        attachments=dict(attachments),
    )
