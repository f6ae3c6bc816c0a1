"""Convert the messages of a ROS file to a Run: assign roles to topics and interpret their values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from logs.clocks import CLOCK_LIMITS
from logs.errors import MAX_LISTED, LogError
from logs.notes import ODOMETRY_LEFT_OUT
from logs.repeated_scans import blank_repeated
from logs.ros import own_record
from logs.ros.composite import combine, join_restarted
from logs.ros.laser_messages import as_laser_scans
from logs.ros.laser_scan import LaserScans, ShapeCensus, order_rays, read_scans
from logs.ros.mounts import mount_in_tree
from logs.ros.poses import (
    BASE_FRAMES,
    RobotFrames,
    RobotMotion,
    base_of,
    find_motion,
    odometry_of_topic,
)
from logs.ros.range_readings import read_ranges
from logs.ros.recording import (
    RANGE_TYPE,
    ROLES,
    TF_TYPE,
    Recording,
    ScanSource,
    Track,
    check_roles,
    choices,
    choose,
    choose_scans,
    track,
    transform_tree,
)
from logs.ros.stamps import settle_clocks, without_repeats
from logs.ros.stated_times import check_times
from logs.ros.transform_tree import TransformTree
from logs.run import RangeSensor, Run
from logs.sensor import median_step
from logs.transforms import Stamps
from logs.types import Floats, Mounts, ReadOptions


def to_run(
    recording: Recording,
    source: str,
    how: ReadOptions,
    census: Mapping[str, ShapeCensus] | None = None,
    whole: Mapping[str, str] | None = None,
) -> Run:
    """Interpret a recording as a run.

    Parameters
    ----------
    census : Topic -> number of scans of each shape in the whole log, if the recording holds only some messages of it.
    whole : Meta of the run of the whole log, if the recording is a piece of it.

    Raises
    ------
    LogError
        If the recording has no scans, several lasers are possible and none is selected, or a selected topic is absent.
    """
    topics, no_return, heights = how.topics, how.no_return, how.heights
    check_roles(topics)
    if own_record.is_own(recording, topics) and heights is None:
        return _odometry_as_poses(own_record.to_run(recording, source, no_return))
    sources = choose_scans(recording, source, topics, prefer_clouds=heights is not None)
    recording = as_laser_scans(recording, sources, heights)
    near = sources[0].topic
    odom_name, cmd_name, pose_name = (
        choose(recording, role, topics, near) for role in ("odom", "cmd", "pose")
    )
    used = [each.topic for each in sources]
    used += [name for name in (odom_name, pose_name, cmd_name) if name is not None]
    recording, notes = without_repeats(recording, used)
    tree = transform_tree(recording, near)
    recording, tree, clock_notes = settle_clocks(
        recording, [name for name in used if recording.topics[name].type != TF_TYPE], tree, near
    )
    odom = odometry_of_topic(recording, odom_name)
    parts, titles, unused = _read_topics(recording, sources, no_return, census or {})
    reading = _mounted(parts, titles, source, tree, odom, how.mounts or {})
    scans = reading.scans
    robot = RobotFrames(tree=tree, base=reading.base, frame=scans.frame, topic=near, whole=whole)
    motion = find_motion(recording, topics, robot, odom, odom_name)
    command = None if cmd_name is None else track(recording.topics[cmd_name], "twist", 6)
    motion, more = _overlapping(motion, scans.stamps) if census is None else (motion, [])
    notes += [
        *recording.notes,
        *clock_notes,
        *scans.notes,
        *motion.notes,
        *more,
        *_unused_text(recording, sources, unused),
    ]
    for part in (motion.poses, motion.odometry, command):
        notes += part.notes if part else []
    if cmd_name is None and choices(recording, "cmd"):
        notes.append(f"several topics could be cmd, none was used: {choices(recording, 'cmd')}")
    notes += tree.faults
    return blank_repeated(_assemble(
        reading, motion, command,
        meta={
            "source": source,
            "format": recording.format,
            "scan_topic": ",".join(map(str, sources)),
            "pose_source": motion.pose_source,
            **({"scan_time": f"{scans.scan_time:.6g}"} if np.isfinite(scans.scan_time) else {}),
            **({"no_return": scans.no_return} if scans.no_return != "inf" else {}),
            **({"odom_topic": motion.odom_source} if motion.odom_source else {}),
            **({"cmd_topic": cmd_name} if cmd_name else {}),
            **({} if reading.is_mount_known else {"mount": "unknown"}),
            **({"notes": "; ".join(dict.fromkeys(notes))} if notes else {}),
        },
        attachments=recording.attachments,
    ))  # fmt: skip


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
    delays: Floats
    rate: float | None = None
    """[Hz] rate of the fastest of several sensors; None for one sensor."""
    is_mount_known: bool = True


def _read_topics(
    recording: Recording,
    sources: Sequence[ScanSource],
    no_return: str | None,
    census: Mapping[str, ShapeCensus],
) -> tuple[list[LaserScans], list[tuple[str, str]], list[tuple[str, str, int]]]:
    """Read the sensors of some topics.

    Returns
    -------
    The sensors, the topic and frame of each, and topic, frame and number of scans of each sensor that is not selected.

    Raises
    ------
    LogError : A selected frame is not in its topic.
    """
    parts: list[LaserScans] = []
    titles: list[tuple[str, str]] = []
    unused: list[tuple[str, str, int]] = []
    for name in dict.fromkeys(source.topic for source in sources):
        topic = recording.topics[name]
        is_range = topic.type == RANGE_TYPE
        found = read_ranges(topic, no_return) if is_range else read_scans(topic, no_return, census.get(name))
        frames = [source.frame for source in sources if source.topic == name]
        absent = set(filter(None, frames)) - {part.frame for part in found}
        if absent:
            there = ", ".join(f"{name}@{part.frame}" for part in found)
            raise LogError(f"scan={name}@{absent.pop()}: {name} has no scans in this frame; it has {there}")
        for part in found:
            if "" in frames or part.frame in frames:
                parts.append(part)
                titles.append((name, part.frame))
            else:
                unused.append((name, part.frame, len(part.stamps)))
    return parts, titles, unused


def _unused_text(
    recording: Recording, sources: Sequence[ScanSource], unused: Sequence[tuple[str, str, int]]
) -> list[str]:
    """Report the range sensors of the log that are not read."""
    read = {source.topic for source in sources}
    others = [
        (f"{name}@{frame}", n_scans) for name, frame, n_scans in unused
    ] + [
        (name, recording.topics[name].n_messages)
        for name in recording.of_type(ROLES["scan"][1]) if name not in read
    ]  # fmt: skip
    if not others:
        return []
    listed = ", ".join(f"{name} ({n:,} scans)" for name, n in others[:MAX_LISTED])
    more = f" and {len(others) - MAX_LISTED} more" if len(others) > MAX_LISTED else ""
    return [
        f"range sensors that were not used: {listed}{more} (select one with `topics` scan={others[0][0]}, several with commas)"
    ]


def _mounted(
    parts: Sequence[LaserScans],
    titles: Sequence[tuple[str, str]],
    source: str,
    tree: TransformTree,
    odom: Track | None,
    stated: Mounts,
) -> SensorReading:
    """Determine the mounts of the sensors; several sensors are combined into one in base_link.

    Parameters
    ----------
    titles : topic and frame of each sensor
    odom : odometry, whose child frame is another name of the base frame
    stated : mounts that apply if the transform tree has none
    """
    children = (odom.child,) if odom and odom.child else ()
    bases = [base_of(tree, part.frame, children) for part in parts]
    mounts: list[Floats] = []
    heights: list[float] = []
    lost: list[str] = []
    for part, base, title in zip(parts, bases, titles, strict=True):
        known = next((np.asarray(stated[name]) for name in title if name in stated), None)
        is_in_tree = part.frame in (*BASE_FRAMES, base) or (
            base is not None and tree.place(base, part.frame) is not None
        )
        mount, height, upside_down = (
            (known, 0.0, False) if known is not None and not is_in_tree else mount_in_tree(tree, base, part)
        )
        if known is None and not is_in_tree:
            lost.append(" in ".join(filter(None, title)))
        check_times(part)
        order_rays(part, upside_down=upside_down)
        mounts.append(mount)
        heights.append(height)
    if not lost:
        joined = join_restarted(parts, mounts, [" in ".join(title) for title in titles])
        parts = list(joined.values())
        titles, bases, mounts = ([v[k] for k in joined] for v in (titles, bases, mounts))  # type: ignore[assignment]
    if len(parts) == 1:
        cones = np.full(len(parts[0].bearings) if parts[0].cone > 0 else 0, parts[0].cone)
        return SensorReading(
            scans=parts[0], base=bases[0], mount=mounts[0], height=heights[0],
            origins=np.zeros((0, 2)), cones=cones, delays=np.zeros(0), is_mount_known=not lost,
        )  # fmt: skip
    if lost:
        raise LogError(f"{source}: {_unknown_mounts_text(parts, titles, lost)}")
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
        delays=rays.delays,
        rate=1e9 / min(periods) if periods and min(periods) > 0 else None,
    )


def _unknown_mounts_text(
    parts: Sequence[LaserScans], titles: Sequence[tuple[str, str]], lost: Sequence[str]
) -> str:
    """Describe why several sensors cannot be read as one, and what to do."""
    names = [name for name, _ in titles]
    for name in dict.fromkeys(names):
        mine = [part for part, other in zip(parts, names, strict=True) if other == name]
        if len(mine) > 1 and not mine[0].cone:
            frames = ", ".join(f"{len(part.stamps):,} of {part.frame or 'no frame'}" for part in mine)
            return (
                f"{name} holds scans of {len(mine)} frames ({frames}) with unknown mounts; select one with `topics` "
                f"scan={name}@{mine[0].frame}, or record /tf_static, or list the mounts under `sensors` of a robot.yaml "
                "(`robot`)"
            )
    return (
        f"the mounts of {', '.join(lost)} are unknown; record /tf_static, give a robot.yaml that lists "
        "them under `sensors` (`robot`), or select one with `topics` scan=NAME"
    )


def _overlapping(motion: RobotMotion, scans: Stamps) -> tuple[RobotMotion, list[str]]:
    """Leave out odometry and poses that are at no time recorded together with the scans; also return notes."""
    notes = list[str]()

    def is_apart(part: Track | None, what: str) -> bool:
        if part is None or not len(part.stamps) or not len(scans):
            return False
        apart = max(int(part.stamps[0] - scans[-1]), int(scans[0] - part.stamps[-1])) / 1e9
        if apart > CLOCK_LIMITS.offset:
            notes.append(
                f"{what} and scans do not overlap in time, by stamps and by log times: they are {apart:,.1f} s apart, "
                + (ODOMETRY_LEFT_OUT if what == "odometry" else f"the {what} was left out")
            )
        return apart > CLOCK_LIMITS.offset

    if is_apart(motion.odometry, "odometry"):
        is_pose = motion.pose_source.startswith("odometry")
        motion = replace(motion, odometry=None, odom_source="")
        motion = replace(motion, poses=None, pose_source="none") if is_pose else motion
    if is_apart(motion.poses, "reference"):
        odom = motion.odometry
        poses = None if odom is None else Track(odom.stamps, odom.values[:, :3], odom.frame)
        source = "none" if odom is None else f"odometry {motion.odom_source}"
        motion = replace(motion, poses=poses, pose_frame="base_link", pose_source=source)
    return motion, notes


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


def _assemble(
    reading: SensorReading,
    motion: RobotMotion,
    command: Track | None,
    *,
    meta: dict[str, str],
    attachments: Mapping[str, bytes],
) -> Run:
    pose, odom = motion.poses, motion.odometry
    scans = reading.scans
    tracks = [scans.stamps, *(part.stamps for part in (pose, odom, command) if part is not None)]
    epoch = min(int(stamps[0]) for stamps in tracks if len(stamps))
    usual = scans.scan_time if 0 < scans.scan_time < np.inf else 0.1
    period = median_step(scans.stamps, 0.0) / 1e9 or usual
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
            delays=reading.delays,
        ),
        stamps=(scans.stamps - epoch) / 1e9,
        ranges=scans.ranges,
        intensities=np.zeros((0, 0)) if scans.intensities is None else scans.intensities,
        pose_stamps=((pose.stamps if pose is not None else none) - epoch) / 1e9,
        poses=poses,
        pose_covariances=pose.covariances if pose is not None else np.zeros((0, 3, 3)),
        odom_stamps=((odom.stamps if odom is not None else none) - epoch) / 1e9,
        odometry=driven[:, :3],
        odom_twists=driven[:, 3:],
        cmd_stamps=((command.stamps if command is not None else none) - epoch) / 1e9,
        commands=twists,
        pose_frame=motion.pose_frame,
        epoch_ns=epoch,
        meta=meta,
        attachments=dict(attachments),
    )
