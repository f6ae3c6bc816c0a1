"""Convert the messages of a ROS file to a Run: assign roles to topics and interpret their values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from logs.errors import LogError
from logs.ros import own_record
from logs.ros.composite import combine
from logs.ros.laser_scan import LaserScans, ShapeCensus, check_sweep, order_rays, read_scans
from logs.ros.messages import planar_covariances
from logs.ros.range_readings import read_ranges
from logs.ros.recording import (
    ODOMETRY_TYPE,
    POSE_COVARIANCE_TYPE,
    RANGE_TYPE,
    ROLES,
    TF_TYPE,
    Recording,
    Track,
    check_roles,
    choices,
    choose,
    choose_scans,
    track,
    transform_tree,
)
from logs.ros.transform_tree import TransformTree
from logs.run import PoseFrame, RangeSensor, Run
from logs.transforms import to_planar
from logs.types import Bools, Floats, Mounts

FLOOR_FRAME = "base_footprint"
"""Frame on the floor (REP 120); base_link may be anywhere on the robot, for example at the height of its axle."""
MAP_FRAMES, BASE_FRAMES = ("map", "world"), ("base_link", FLOOR_FRAME, "base")
FIXED_FRAMES = (*MAP_FRAMES, "odom")
"""Words in the names of stationary frames; poses in other frames may not refer to the map."""
MIN_UPRIGHT_COSINE = 0.98  # cosine of the maximum tilt (11°) of a level laser


def to_run(
    recording: Recording,
    source: str,
    topics: Mapping[str, str] | None = None,
    no_return: str | None = None,
    mounts: Mounts | None = None,
    census: Mapping[str, ShapeCensus] | None = None,
) -> Run:
    """Interpret a recording as a run.

    Parameters
    ----------
    topics : Role -> topic, for non-standard topic names.
    no_return : Encoding of a missing return, one of `NO_RETURNS`; None: Detected from the readings.
    mounts : Topic or frame of a sensor -> (3,) [m, m, rad] mount in base_link, used if the log has no transform.
    census : Topic -> number of scans of each shape in the whole log, if the recording is a piece of it.

    Raises
    ------
    LogError
        If the recording has no scans, or several topics fit a role and none is selected.
    """
    check_roles(topics)
    if own_record.is_own(recording, topics):
        return _odometry_as_poses(own_record.to_run(recording, source, no_return))
    names = choose_scans(recording, source, topics)
    tree = transform_tree(recording)
    odom_name, cmd_name = choose(recording, "odom", topics), choose(recording, "cmd", topics)
    odom = _odometry(recording, odom_name)
    children = (odom.child,) if odom and odom.child else ()
    parts, titles = _read_topics(recording, names, no_return, census or {})
    reading = _mounted(parts, titles, source, tree, children, mounts or {})
    scans, base = reading.scans, reading.base
    pose, frame, pose_source = _reference(recording, topics, tree, base, scans, odom, odom_name)
    command = None
    if cmd_name is not None:
        command = track(recording.topics[cmd_name], "twist", 6)
    notes = [*recording.notes, *scans.notes]
    for part in (pose, odom, command):
        notes += [note for note in (part.notes if part else []) if note not in notes]
    for role, name in (("odom", odom_name), ("cmd", cmd_name)):
        if name is None and choices(recording, role):
            notes.append(f"several topics could be {role}, none was used: {choices(recording, role)}")
    if tree.conflicts:
        notes.append(f"frames with two parents: {', '.join(tree.conflicts)}")
    return _assemble(
        reading, pose, frame, odom, command,
        meta={
            "source": source,
            "format": recording.format,
            "scan_topic": ",".join(names),
            "pose_source": pose_source,
            **({"scan_time": f"{scans.scan_time:.6g}"} if np.isfinite(scans.scan_time) else {}),
            **({"no_return": scans.no_return} if scans.no_return != "inf" else {}),
            **({"odom_topic": odom_name} if odom_name else {}),
            **({"cmd_topic": cmd_name} if cmd_name else {}),
            **({"notes": "; ".join(notes)} if notes else {}),
        },
        attachments=recording.attachments,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorReading:
    """The scans of one sensor, or of several as one, and its mount."""

    scans: LaserScans
    base: str | None
    """The base frame of the robot; None if the transform tree has none."""
    mount: Floats
    height: float
    origins: Floats
    cones: Floats
    rate: float | None = None
    """[Hz] rate of the fastest of several sensors; None for one sensor."""


def _read_topics(
    recording: Recording, names: Sequence[str], no_return: str | None, census: Mapping[str, ShapeCensus]
) -> tuple[list[LaserScans], list[tuple[str, str]]]:
    """Read the sensors of some topics; also return the topic and frame of each sensor."""
    parts: list[LaserScans] = []
    titles: list[tuple[str, str]] = []
    for name in names:
        topic = recording.topics[name]
        is_range = topic.type == RANGE_TYPE
        found = (
            read_ranges(topic, no_return) if is_range else [read_scans(topic, no_return, census.get(name))]
        )
        parts += found
        titles += [(name, part.frame) for part in found]
    return parts, titles


def _mounted(
    parts: Sequence[LaserScans],
    titles: Sequence[tuple[str, str]],
    source: str,
    tree: TransformTree,
    children: Sequence[str],
    stated: Mounts,
) -> SensorReading:
    """Determine the mounts of the sensors; several sensors are combined into one in base_link.

    Parameters
    ----------
    titles : topic and frame of each sensor
    children : further names of the base frame
    stated : mounts that apply if the transform tree has none
    """
    bases = [
        tree.first_ancestor(
            part.frame, (*(tree.in_namespace_of(part.frame, name) for name in BASE_FRAMES), *children)
        )
        for part in parts
    ]
    mounts: list[Floats] = []
    heights: list[float] = []
    lost: list[str] = []
    for part, base, title in zip(parts, bases, titles, strict=True):
        known = next((np.asarray(stated[name]) for name in title if name in stated), None)
        is_in_tree = part.frame in BASE_FRAMES or (
            base is not None and tree.place(base, part.frame) is not None
        )
        mount, height, upside_down = (
            (known, 0.0, False) if known is not None and not is_in_tree else _mount(tree, base, part)
        )
        if known is None and not is_in_tree:
            lost.append(" in ".join(filter(None, title)))
        check_sweep(part)
        order_rays(part, upside_down=upside_down)
        mounts.append(mount)
        heights.append(height)
    if len(parts) == 1:
        n_cones = len(parts[0].bearings) if parts[0].cone > 0 else 0
        return SensorReading(
            scans=parts[0], base=bases[0], mount=mounts[0], height=heights[0],
            origins=np.zeros((0, 2)), cones=np.full(n_cones, parts[0].cone),
        )  # fmt: skip
    if lost:
        raise LogError(
            f"{source}: the mounts of {', '.join(lost)} are unknown; record /tf_static, give a robot.yaml that lists "
            "them under `sensors` (`robot`), or select one with `topics` scan=NAME"
        )
    names = [topic for topic, _ in titles]
    rays = combine(parts, mounts, [" in ".join(t) if names.count(t[0]) > 1 else t[0] for t in titles])
    base = next(filter(None, bases), None)
    rays.scans.frame = base or BASE_FRAMES[0]
    periods = [float(np.median(np.diff(part.stamps))) for part in parts if len(part.stamps) > 1]
    return SensorReading(
        scans=rays.scans,
        base=base,
        mount=np.zeros(3),
        height=float(np.median([height for height in heights if height] or [0.0])),
        origins=rays.origins,
        cones=rays.cones,
        rate=1e9 / min(periods) if periods and min(periods) > 0 else None,
    )


def _odometry(recording: Recording, name: str | None) -> Track | None:
    if name is None:
        return None
    topic = recording.topics[name]
    pose, twist = track(topic, "pose", 7), track(topic, "twist", 6)
    unoriented = (pose.values[:, 3:] == 0).all(axis=1)
    if unoriented.any():
        pose.notes.append(f"{_unoriented_text(name, unoriented)}: their heading was set to 0")
    pose.values = np.column_stack([to_planar(pose.values), twist.values[:, [0, 5]]])  # (n, 5)
    return pose


def _mount(tree: TransformTree, base: str | None, scans: LaserScans) -> tuple[Floats, float, bool]:
    """Return the mount (3,) in base_link, the height [m] above the floor if known, and whether it is upside down."""
    if scans.frame in BASE_FRAMES:
        return np.zeros(3), 0.0, False
    place = tree.place(base, scans.frame) if base is not None else None
    if place is None:
        scans.notes.append(
            f"no transform base_link -> {scans.frame or 'laser'}: the mount of robot.yaml is used if given, otherwise 0"
        )
        return np.zeros(3), 0.0, False
    if abs(place.up) < MIN_UPRIGHT_COSINE:
        scans.notes.append(
            f"the laser is tilted by {np.degrees(np.arccos(abs(place.up))):.0f}°, but assumed to be level"
        )
    if not place.is_static and np.ptp(place.poses, axis=0).max() > 1e-3:
        scans.notes.append("the laser moves on the robot: its first mount was used")
    # the floor frame may be the root of the tree, above base_link, or a leaf below it
    floor = tree.in_namespace_of(scans.frame, FLOOR_FRAME)
    below = tree.place(base, floor) if base is not None else None
    above_floor = tree.place(floor, scans.frame) or place
    return place.poses[0], above_floor.height - (below.height if below else 0.0), place.up < 0


def _reference(
    recording: Recording,
    topics: Mapping[str, str] | None,
    tree: TransformTree,
    base: str | None,
    scans: LaserScans,
    odom: Track | None,
    odom_name: str | None,
) -> tuple[Track | None, PoseFrame, str]:
    """Return the poses, their frame and their source: the first of /pose, /tf, any other pose topic, and /odom."""
    name = choose(recording, "pose", topics)
    is_named = (topics or {}).get("pose") is not None
    if name is not None and (is_named or name == ROLES["pose"][0]) and recording.topics[name].type != TF_TYPE:
        return _pose_topic(recording, name, odom_name)
    for root in (tree.in_namespace_of(scans.frame, name) for name in MAP_FRAMES):
        for frame, whose in ((base, "base_link"), ("base_link", "base_link"), (scans.frame, "laser")):
            place = tree.place(root, frame) if frame else None
            if place is not None and frame != root and not place.is_static:
                found = Track(place.stamps, place.poses, root)
                return found, ("laser" if whose == "laser" else "base_link"), f"/tf {root} -> {frame}"
    if name is not None and recording.topics[name].type != TF_TYPE:
        return _pose_topic(recording, name, odom_name)
    if odom is not None:
        return Track(odom.stamps, odom.values[:, :3], odom.frame), "base_link", f"odometry {odom_name}"
    if choices(recording, "pose"):
        raise LogError(
            f"several topics could be the reference pose; select one with {choices(recording, 'pose')}"
        )
    return None, "base_link", "none"


def _pose_topic(recording: Recording, name: str, odom_name: str | None) -> tuple[Track, PoseFrame, str]:
    """Return the poses of a topic, their frame and their source; the source is `none` if no pose is usable."""
    found = _poses(recording, name)
    is_odometry = recording.topics[name].type == ODOMETRY_TYPE and ("odom" in name or name == odom_name)
    source = f"odometry {name}" if is_odometry else name
    return found, "base_link", source if len(found.stamps) else "none"


def _odometry_as_poses(run: Run) -> Run:
    """Use the odometry as the poses of a run without other poses; the meta records this."""
    if len(run.pose_stamps) or not len(run.odom_stamps):
        return run
    return replace(
        run,
        pose_stamps=run.odom_stamps,
        poses=run.odometry,
        pose_frame="base_link",
        meta={**run.meta, "pose_source": "odometry /odom"},
    )


def _poses(recording: Recording, name: str) -> Track:
    topic = recording.topics[name]
    found = track(topic, "pose", 7)
    if topic.type == POSE_COVARIANCE_TYPE:
        found.covariances = planar_covariances(track(topic, "covariance", 36).values)
    if found.frame and not any(word in found.frame.rpartition("/")[2] for word in FIXED_FRAMES):
        found.notes.append(f"{name} is in the unknown frame {found.frame}, which is assumed to be the map")
    unoriented = (found.values[:, 3:] == 0).all(axis=1)
    if unoriented.any():
        found.notes.append(f"{_unoriented_text(name, unoriented)}: left out")
        found.stamps, found.values = found.stamps[~unoriented], found.values[~unoriented]
        found.covariances = found.covariances[~unoriented] if len(found.covariances) else found.covariances
    found.values = to_planar(found.values)
    return found


def _unoriented_text(name: str, unoriented: Bools) -> str:
    return f"{name}: {unoriented.sum()} of {len(unoriented)} poses have no orientation (quaternion 0 0 0 0)"


def _assemble(
    reading: SensorReading,
    pose: Track | None,
    frame: PoseFrame,
    odom: Track | None,
    command: Track | None,
    *,
    meta: dict[str, str],
    attachments: Mapping[str, bytes],
) -> Run:
    scans = reading.scans
    tracks = [scans.stamps, *(part.stamps for part in (pose, odom, command) if part is not None)]
    epoch = min(int(stamps[0]) for stamps in tracks if len(stamps))
    steps = np.diff(scans.stamps)
    period = float(np.median(steps)) / 1e9 if len(steps) else 0.0
    period = period if period > 0 else scans.scan_time if 0 < scans.scan_time < np.inf else 0.1
    none = np.zeros(0, dtype=np.int64)
    poses = pose.values if pose is not None else np.zeros((0, 3))
    driven = odom.values if odom is not None else np.zeros((0, 5))
    twists = command.values[:, [0, 5]] if command is not None else np.zeros((0, 2))
    return Run(
        sensor=RangeSensor(
            bearings=scans.bearings,
            range_min=scans.range_min,
            range_max=scans.range_max,
            mount=reading.mount,
            rate=1.0 / period if reading.rate is None else reading.rate,
            sweep_time=scans.time_increment * len(scans.bearings),
            height=reading.height,
            origins=reading.origins,
            cones=reading.cones,
        ),
        stamps=(scans.stamps - epoch) / 1e9,
        ranges=scans.ranges,
        pose_stamps=((pose.stamps if pose is not None else none) - epoch) / 1e9,
        poses=poses,
        pose_covariances=pose.covariances if pose is not None else np.zeros((0, 3, 3)),
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
