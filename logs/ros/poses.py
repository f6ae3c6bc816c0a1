"""Find the base frame, the odometry and the reference poses of a ROS recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from logs.errors import LogError
from logs.jumps import find_jumps
from logs.odometry_faults import hung_poses, measured_poses, wrong_poses
from logs.publishers import of_one_publisher
from logs.ros.messages import planar_covariances
from logs.ros.recording import (
    ODOMETRY_TYPE,
    POSE_COVARIANCE_TYPE,
    ROLES,
    TF_TYPE,
    Recording,
    Track,
    candidates,
    choices,
    choose,
    common_namespace,
    track,
)
from logs.ros.transform_tree import TransformTree
from logs.run import PoseFrame
from logs.transforms import are_oriented, compose, dead_reckoning, invert, to_planar, twists_of
from logs.types import Bools, Floats, Ints

FLOOR_FRAME = "base_footprint"
"""Frame on the floor (REP 120); base_link may be anywhere on the robot, for example at the height of its axle."""
MAP_FRAMES, BASE_FRAMES = ("map", "world"), ("base_link", FLOOR_FRAME, "base")
ODOM_FRAME = "odom"
MIN_JUMP, MIN_JUMPS = 0.02, 0.02
"""[m] smallest step that counts as a jump of the odometry, and the share of such steps that is reported."""
MIN_DRIVEN = 0.1
"""[m, rad] Motion by the twists of odometry above which its constant pose was not filled in."""
MIN_LEVEL = 0.98
"""Cosine of the maximum tilt (11°) of a level frame: that of a laser, or of planar odometry."""
FIXED_FRAMES = (*MAP_FRAMES, ODOM_FRAME)
"""Words in the names of stationary frames; poses in other frames may not refer to the map."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotFrames:
    """The transforms of a log, and the frames and topic of the sensor that is read."""

    tree: TransformTree
    base: str | None
    """Base frame of the robot that carries the sensor; None: the tree has none."""
    frame: str
    """Frame of the sensor."""
    topic: str
    """Topic of the sensor."""
    whole: Mapping[str, str] | None = None
    """Meta of the whole log if the recording is a piece of it, in which the robot may stand still."""


@dataclass(frozen=True, kw_only=True)
class RobotMotion:
    """The odometry and the reference poses of a recording."""

    odometry: Track | None
    """Rows x, y, phi, v, omega of the base in the odometry frame."""
    odom_source: str
    """Topic of the odometry, or `/tf PARENT -> CHILD`; empty: none."""
    poses: Track | None
    pose_frame: PoseFrame
    pose_source: str
    notes: list[str] = field(default_factory=list)


def odometry_of_topic(recording: Recording, name: str | None) -> Track | None:
    """Return the odometry of a topic of Odometry messages; None without a topic, and for /tf."""
    if name is None or recording.topics[name].type == TF_TYPE:
        return None
    topic = recording.topics[name]
    pose, twist = track(topic, "pose", 7), track(topic, "twist", 6)
    unoriented = ~are_oriented(pose.values[:, 3:])
    if unoriented.any():
        pose.notes.append(f"{_unoriented_text(name, unoriented, pose.values)}: their heading was set to 0")
        pose.values[unoriented, 3:] = [0.0, 0.0, 0.0, 1.0]
    planar, twists = to_planar(pose.values), twist.values[:, [0, 5]]
    known = planar[np.isfinite(planar).all(axis=1)]
    if len(planar) and (len(known) == 0 or not np.ptp(known, axis=0).any()):
        driven = dead_reckoning((pose.stamps - pose.stamps[0]) / 1e9, twist.values[:, [0, 1, 5]])
        if (np.ptp(driven, axis=0) > MIN_DRIVEN).any():
            pose.notes.append(
                f"{name}: its pose never changes while its twist drives: the twist was integrated"
            )
            planar = driven
    pose.values = np.column_stack([planar, twists])  # (n, 5)
    return pose


def base_of(tree: TransformTree, frame: str, children: Sequence[str]) -> str | None:
    """Return the base frame of the robot that carries a sensor.

    It is the first of the standard names above the sensor in the tree, or else rigidly connected to it; without such a
    frame, the frame below the odometry frame. If the tree lacks the sensor, it is the first of these frames.

    Parameters
    ----------
    frame : frame of the sensor
    children : further names of the base frame
    """
    names = [*(tree.in_namespace_of(frame, name) for name in BASE_FRAMES), *children]
    above = next((name for name in names if tree.is_ancestor(name, frame)), None)
    if above is not None:
        return above
    for name in names:
        chain = tree.path(name, frame)
        if chain and all(edge.is_constant for edge, _ in chain):
            return name
    for odom in odom_frames(tree, frame):
        chain = tree.path(odom, frame)
        if chain and not any(is_inverse for _, is_inverse in chain):
            return chain[0][0].child
    if any(tree.path(name, frame) for name in tree.frames):
        return None
    below = [edge.child for edge in tree.edges.values() if ODOM_FRAME in _last(edge.parent)]
    return next((name for name in (*names, *below) if name in tree.frames), None)


def odom_frames(tree: TransformTree, frame: str) -> list[str]:
    """Return the odometry frames of the tree: that of the robot which carries `frame` first, then the nearest."""
    names = [name for name in tree.frames if ODOM_FRAME in _last(name)]
    return sorted(
        names,
        key=lambda name: (
            not tree.is_ancestor(name, frame),
            -common_namespace(name, frame),
            len(tree.path(name, frame) or tree.edges),
            _last(name) != ODOM_FRAME,
        ),
    )


def map_frames(tree: TransformTree, frame: str) -> list[str]:
    """Return the map frames for a robot which carries `frame`: the standard names, then other maps above it."""
    names = [tree.in_namespace_of(frame, name) for name in MAP_FRAMES]
    return names + [
        name
        for name in tree.frames
        if name not in names
        and any(word in _last(name) for word in MAP_FRAMES)
        and tree.is_ancestor(name, frame)
    ]


def _last(name: str) -> str:
    return name.rpartition("/")[2].lower()


def find_motion(
    recording: Recording,
    topics: Mapping[str, str] | None,
    robot: RobotFrames,
    odom: Track | None,
    odom_name: str | None,
) -> RobotMotion:
    """Find the odometry and the reference poses.

    Parameters
    ----------
    odom, odom_name : odometry of a topic, and its name

    Raises
    ------
    LogError : The user selects /tf, which has no such transform.
    """
    notes = list[str]()
    if odom is None:
        odom, odom_name = _tf_odometry(robot, odom_name)
        if odom is not None and len(candidates(recording, "odom")) > 1:
            notes.append(f"several topics could be odom ({choices(recording, 'odom')}): {odom_name} was used")
        elif candidates(recording, "odom") and odom is None:
            notes.append(f"several topics could be odom, none was used: {choices(recording, 'odom')}")
    if odom is not None:
        for change in (_measured, _whole, _of_one_publisher):
            odom, more = change(odom_name or "", odom)
            notes += more
        odom, more = _at_base(odom_name or "", odom, robot)
        notes += more
    name, is_named = choose(recording, "pose", topics, robot.topic), (topics or {}).get("pose") is not None
    is_tf = name is not None and recording.topics[name].type == TF_TYPE
    found: tuple[Track, PoseFrame, str] | None = None
    if name is not None and not is_tf and (is_named or name == ROLES["pose"][0]):
        found = _pose_topic(recording, name, odom_name)
    if found is None:
        found = _tf_reference(robot, notes, is_named=is_tf)
    if found is None and is_tf and robot.whole is None:
        raise LogError(
            f"pose={name}: it has no transform over time from map or world to {robot.base or 'base_link'} or "
            f"{robot.frame or 'laser'}; it has {', '.join(robot.tree.lines()) or 'no transforms'}"
        )
    if found is None and name is not None and not is_tf:
        found = _pose_topic(recording, name, odom_name)
    if found is None and odom is not None:
        found = (
            Track(odom.stamps, odom.values[:, :3], odom.frame), "base_link", f"odometry {odom_name}"
        )  # fmt: skip
    poses, pose_frame, source = found or (None, "base_link", "none")
    if name is None and candidates(recording, "pose"):
        used = "none" if source == "none" or source.startswith("odometry") else source
        notes.append(
            f"several topics could be the reference pose, {used} was used: {choices(recording, 'pose')}"
        )
    return RobotMotion(
        odometry=odom, odom_source=odom_name or "", poses=poses, pose_frame=pose_frame,
        pose_source=source, notes=notes,
    )  # fmt: skip


def _of_one_publisher(name: str, odom: Track) -> tuple[Track, list[str]]:
    """Return the odometry of one publisher, and a note on odometry that jumps back and forth."""
    times = (odom.stamps - odom.stamps[:1]) / 1e9
    jumps = find_jumps(times, odom.values[:, :3], least=MIN_JUMP)
    if jumps is None or jumps.share < MIN_JUMPS:
        return odom, []
    jumping = f"{name} jumps at {100 * jumps.share:.0f} % of its messages, by up to {jumps.farthest:.2f} m"
    index = of_one_publisher(times, odom.values[:, :3])
    if index is None:
        return odom, [f"{jumping}: two publishers, or two clocks"]
    n = len(index), len(times) - len(index)
    what = f"two publishers, whose {n[0]} and {n[1]} poses alternate: those of the first were used"
    return _selected(name, odom, index), [f"{jumping}: {what}"]


def _selected(name: str, odom: Track, index: Ints) -> Track:
    """Return some poses of the odometry; twists that were derived from all poses are derived again."""
    values = odom.values[index]
    if name.startswith("/tf "):
        values[:, 3:] = twists_of((odom.stamps[index] - odom.stamps[0]) / 1e9, values[:, :3])
    return replace(odom, stamps=odom.stamps[index], values=values)


def _measured(name: str, odom: Track) -> tuple[Track, list[str]]:
    """Return the odometry without poses that only repeat the one before, and a note."""
    times, poses = (odom.stamps - odom.stamps[:1]) / 1e9, odom.values[:, :3]
    index, why = measured_poses(times, poses), "is published more often than it is measured"
    if index is None:
        hung, why = hung_poses(times, poses), "hangs while the robot moves on"
        if not hung.any():
            return odom, []
        index = np.flatnonzero(~hung)
    note = f"{name} {why}: {len(times) - len(index)} poses that repeat the one before were left out"
    return _selected(name, odom, index), [note]


def _whole(name: str, odom: Track) -> tuple[Track, list[str]]:
    """Return the odometry without single wrong poses, and a note."""
    wrong = wrong_poses((odom.stamps - odom.stamps[:1]) / 1e9, odom.values[:, :3])
    if not wrong.any():
        return odom, []
    note = (
        f"{name}: {int(wrong.sum())} of {len(wrong)} poses contradict those before and after them: left out"
    )
    return _selected(name, odom, np.flatnonzero(~wrong)), [note]


def _at_base(name: str, odom: Track, robot: RobotFrames) -> tuple[Track, list[str]]:
    """Return odometry of another frame of the robot, such as that of a camera, as odometry of the base; also return notes.

    T_odom_base = T_odom_child T_child_base, with the static transform of the log. A child that is not level is left as it is.
    """
    tree, base, child = robot.tree, robot.base, odom.child
    chain = tree.path(base, child) if base is not None and len(odom.stamps) else None
    place = tree.place(base or "", child) if chain and all(edge.is_constant for edge, _ in chain) else None
    if place is None or place.up < MIN_LEVEL or not place.poses[0].any():
        return odom, []
    mount = place.poses[0]
    values = odom.values.copy()
    values[:, :3] = compose(values[:, :3], np.broadcast_to(invert(mount), (len(values), 3)))
    values[:, 3:] = twists_of((odom.stamps - odom.stamps[0]) / 1e9, values[:, :3])
    where = f"({mount[0]:.2f} m, {mount[1]:.2f} m, {np.degrees(mount[2]):.0f}°)"
    note = f"{name} is the odometry of {child}, at {where} in {base}: converted to that of {base}"
    return replace(odom, values=values, child=base or ""), [note]


def _tf_odometry(robot: RobotFrames, named: str | None) -> tuple[Track | None, str | None]:
    """Return the pose of the base in an odometry frame of /tf, and its source; None without a frame in which it moves.

    Parameters
    ----------
    named : topic of transforms that the user selected as odometry; None: none
    """
    tree, base = robot.tree, robot.base
    for odom in odom_frames(tree, base or robot.frame) if base is not None else ():
        place = tree.place(odom, base or "")
        source = f"/tf {odom} -> {base}"
        is_known = named is not None or (robot.whole or {}).get("odom_topic") == source
        if place is not None and (place.moves or (is_known and not place.is_static)):
            seconds = (place.stamps - place.stamps[0]) / 1e9
            values = np.column_stack([place.poses, twists_of(seconds, place.poses)])
            return Track(place.stamps, values, odom, base or ""), source
    if named is not None and robot.whole is None:
        raise LogError(
            f"odom={named}: it has no transform over time from odom to {base or 'base_link'}; "
            f"it has {', '.join(tree.lines()) or 'no transforms'}"
        )
    return None, None


def _tf_reference(
    robot: RobotFrames, notes: list[str], *, is_named: bool
) -> tuple[Track, PoseFrame, str] | None:
    """Return the poses of the base, or of the laser, in a map frame of /tf.

    If the transform between map and odometry never changes, the poses are odometry. They count as a reference only if
    the user selects them.
    """
    tree, frame = robot.tree, robot.frame
    for root in map_frames(tree, robot.base or frame):
        for there, whose in ((robot.base, "base_link"), ("base_link", "base_link"), (frame, "laser")):
            place = tree.place(root, there) if there and there != root else None
            if place is None or place.is_static or there is None:
                continue
            source = f"/tf {root} -> {there}"
            is_known = is_named or (robot.whole or {}).get("pose_source") == source
            odom = None if is_known else _fixed_odom(tree, root, there)
            if odom is not None:
                notes.append(f"{source} is odometry and no reference: {root} -> {odom} never changes")
                return None
            pose_frame: PoseFrame = "laser" if whose == "laser" else "base_link"
            return Track(place.stamps, place.poses, root), pose_frame, source
    return None


def _fixed_odom(tree: TransformTree, root: str, frame: str) -> str | None:
    """Return the odometry frame between two frames if its transform to the first never changes."""
    here = root
    for edge, is_inverse in tree.path(root, frame) or []:
        if ODOM_FRAME in _last(here) and here != root:
            return here
        if not edge.is_constant:
            return None
        here = edge.parent if is_inverse else edge.child
    return None


def _pose_topic(recording: Recording, name: str, odom_name: str | None) -> tuple[Track, PoseFrame, str]:
    """Return the poses of a topic, their frame and their source; the source is `none` if no pose is usable."""
    topic = recording.topics[name]
    found = track(topic, "pose", 7)
    if topic.type == POSE_COVARIANCE_TYPE:
        found.covariances = planar_covariances(track(topic, "covariance", 36).values)
    if found.frame and not any(word in found.frame.rpartition("/")[2] for word in FIXED_FRAMES):
        found.notes.append(f"{name} is in the unknown frame {found.frame}, which is assumed to be the map")
    unoriented = ~are_oriented(found.values[:, 3:])
    if unoriented.any():
        found.notes.append(f"{_unoriented_text(name, unoriented, found.values)}: left out")
        found.stamps, found.values = found.stamps[~unoriented], found.values[~unoriented]
        found.covariances = found.covariances[~unoriented] if len(found.covariances) else found.covariances
    found.values = to_planar(found.values)
    is_odometry = topic.type == ODOMETRY_TYPE and ("odom" in name or name == odom_name)
    source = f"odometry {name}" if is_odometry else name
    return found, "base_link", source if len(found.stamps) else "none"


def _unoriented_text(name: str, unoriented: Bools, poses: Floats) -> str:
    why = "quaternions of changing norm" if poses[unoriented, 3:].any() else "quaternion 0 0 0 0"
    return f"{name}: {unoriented.sum()} of {len(unoriented)} poses have no orientation ({why})"
