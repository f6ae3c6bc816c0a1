"""Inspect a file: topics, frames, usable and missing signals, and anything suspicious."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from logs.errors import LogError
from logs.formats import FORMATS, format_of, mcap_file, rosbag
from logs.jumps import JUMP_LIMITS
from logs.no_return import check_no_return
from logs.notes import notes_of
from logs.ros import cdr
from logs.ros.interpret import to_run
from logs.ros.recording import (
    ENCODINGS,
    KEPT_TYPES,
    TF_TYPE,
    Recording,
    Topic,
    check_roles,
    choices,
    transform_tree,
)
from logs.run import Run, pair
from logs.sweep import sweep_line, sweep_warnings
from logs.types import Floats, Mounts, Progress

LOADERS: dict[str, Callable[[Path, Progress | None], Recording]] = {
    "mcap": mcap_file.load,
    "rosbag": rosbag.load,
}
"""Format with topics -> its loader."""


@dataclass(frozen=True, kw_only=True)
class WarningLimits:
    """Thresholds above which a property of a log is reported; conventions, not fitted to data."""

    clock_offset: float = 0.5
    """[s] offset between log time and header stamp."""
    gap_periods: float = 5.0
    """A step is a gap if it exceeds this number of median steps ..."""
    gap: float = 0.5
    """[s] ... and also exceeds this duration."""
    jump_speed: float = 5.0
    """[m/s] speed between two poses that counts as a jump; mobile robots are slower."""
    jump: float = 0.1
    """[m] shorter jumps count as noise of the reference pose."""
    millimetres: float = 1000.0
    """[m] a larger median range indicates millimetres."""
    centimetres: float = 60.0
    """[m] a larger median range indicates centimetres or millimetres."""
    still: float = 1e-6
    """[m, rad] poses that span less are constant."""


LIMITS = WarningLimits()


@dataclass(frozen=True, kw_only=True)
class TopicInfo:
    """One topic, or one signal of a file that has no topics."""

    name: str
    type: str
    n_messages: int
    rate: float | None
    """[Hz] median rate; None for fewer than two distinct stamps."""
    frame: str
    first: float | None
    """[s] time of the first message, from the start of the file."""
    last: float | None
    offset: float | None
    """[s] median of log time minus header stamp; None without a header."""


@dataclass(frozen=True, kw_only=True)
class Inspection:
    """The contents of a file, and what they can be used for."""

    path: str
    format: str
    n_bytes: int
    topics: tuple[TopicInfo, ...]
    transforms: tuple[str, ...]
    attachments: Mapping[str, int]
    """Name -> size [bytes]."""
    usable: tuple[str, ...]
    missing: tuple[str, ...]
    warnings: tuple[str, ...]
    pairing: str
    """Number of scans with a pose, and why the others have none."""
    meta: Mapping[str, str]
    run: Run | None = field(repr=False)
    """The run for further checks; None if the file cannot be read as a run."""

    def lines(self) -> list[str]:
        """Return the inspection as lines of text."""
        out = [f"{self.path}: {self.format}, {self.n_bytes:,} bytes", "topics"]
        width = max((len(topic.name) for topic in self.topics), default=0)
        for topic in self.topics:
            rate = f"{topic.rate:7.2f} Hz" if topic.rate is not None else " " * 10
            span = f" {topic.first:9.3f} to {topic.last:.3f} s" if topic.first is not None else ""
            frame = f"  in {topic.frame}" if topic.frame else ""
            out.append(f"  {topic.name:<{width}}  {topic.n_messages:>8,}  {rate}{span}  {topic.type}{frame}")
        for title, items in (
            ("frames", self.transforms),
            ("attachments", [f"{name} ({size:,} bytes)" for name, size in self.attachments.items()]),
            ("usable", self.usable),
            ("missing", self.missing),
            ("warnings", self.warnings),
        ):
            if items:
                out += [title, *(f"  {item}" for item in items)]
        return out + (["pairing", f"  {self.pairing}"] if self.pairing else [])

    def to_dict(self) -> dict[str, Any]:
        """Return the inspection as plain data, without the run."""
        shown = {
            name: getattr(self, name) for name in self.__dataclass_fields__ if name not in ("run", "topics")
        }
        return {**shown, "topics": [asdict(topic) for topic in self.topics], "is_run": self.run is not None}


@np.errstate(all="ignore")  # numbers that overflow are reported, not raised
def inspect(
    path: Path | str,
    topics: Mapping[str, str] | None = None,
    *,
    no_return: str | None = None,
    mounts: Mounts | None = None,
    progress: Progress | None = None,
) -> Inspection:
    """Inspect a file, also one that cannot be read as a run.

    Raises
    ------
    LogError
        If no format matches, the file is damaged, or a requested topic is absent.
    """
    path = Path(path)
    check_roles(topics)
    check_no_return(no_return)
    kind = format_of(path)
    recording: Recording | None = None
    run: Run | None = None
    missing: list[str] = []
    if kind in LOADERS:
        recording = LOADERS[kind](path, progress)
        try:
            run = to_run(recording, path.name, topics, no_return, mounts)
        except LogError as exc:
            if topics:
                raise
            missing.append(str(exc))
    else:
        run = FORMATS[kind].read(path, topics, progress, no_return, mounts)
    warnings = _ros_warnings(recording) if recording is not None else []
    usable: list[str] = []
    pairing = ""
    if run is not None:
        usable += _usable(run)
        missing += _missing(run, recording)
        warnings += warnings_of(run)
        pairing = str(pair(run))
    return Inspection(
        path=str(path),
        format=recording.format if recording is not None else kind,
        n_bytes=sum(f.stat().st_size for f in path.iterdir() if f.is_file()) if path.is_dir() else path.stat().st_size,
        topics=tuple(_topics(recording) if recording is not None else _signals(run)),
        transforms=tuple(transform_tree(recording).lines() if recording is not None else ()),
        attachments={name: len(data) for name, data in (recording.attachments if recording else {}).items()},
        usable=tuple(usable),
        missing=tuple(missing),
        warnings=tuple(warnings),
        pairing=pairing,
        meta=dict(run.meta) if run is not None else {},
        run=run,
    )  # fmt: skip


def _topics(recording: Recording) -> list[TopicInfo]:
    start = min((min(t.log_times) for t in recording.topics.values() if t.log_times), default=0)
    return [_topic(topic, start) for topic in recording.topics.values()]


def _topic(topic: Topic, start: int) -> TopicInfo:
    logged = np.sort(np.array(topic.log_times, dtype=np.int64))
    frame, offset = "", None
    stamps = logged
    if topic.type in KEPT_TYPES and topic.type != TF_TYPE and topic.payloads:
        headers, frames = logged.copy(), dict[str, int]()
        raw = np.array(topic.log_times, dtype=np.int64)
        for block in cdr.unpack(topic.payloads, topic.type, topic.name, topic.encoding):
            if "sec" in block.places:
                headers[block.index] = block.stamps_ns
                offset = 0.0
            name = block.strings.get("frame_id", "")
            frames[name] = frames.get(name, 0) + len(block.index)
        if offset is not None:
            offset = float(np.median(raw - headers)) / 1e9
            stamps = np.sort(headers)
        frame = ", ".join(frames)
    span = len(logged) > 0
    return TopicInfo(
        name=topic.name,
        type=topic.type if topic.encoding in ENCODINGS else f"{topic.type} ({topic.encoding})",
        n_messages=topic.n_messages,
        rate=_rate(stamps / 1e9),
        frame=frame,
        first=(int(logged[0]) - start) / 1e9 if span else None,
        last=(int(logged[-1]) - start) / 1e9 if span else None,
        offset=offset,
    )


def _signals(run: Run | None) -> list[TopicInfo]:
    """Describe the signals of a file that has no topics."""
    assert run is not None
    rows = (
        ("scan", f"{run.sensor.n_rays} ranges", run.stamps, "laser"),
        ("pose", f"pose of {run.pose_frame}", run.pose_stamps, "map"),
        ("odom", "odometry", run.odom_stamps, "odom"),
        ("cmd", "command", run.cmd_stamps, "base_link"),
    )
    return [
        TopicInfo(
            name=name, type=kind, n_messages=len(stamps), rate=_rate(stamps), frame=frame,
            first=float(stamps[0]), last=float(stamps[-1]), offset=None,
        )
        for name, kind, stamps, frame in rows if len(stamps)
    ]  # fmt: skip


def _rate(stamps: Floats) -> float | None:
    steps = np.diff(stamps)
    steps = steps[steps > 0]
    return float(1.0 / np.median(steps)) if len(steps) else None


def _usable(run: Run) -> list[str]:
    sensor = run.sensor
    first, last = np.degrees(sensor.bearings[[0, -1]])
    out = [
        f"{run.n_scans:,} scans of {sensor.n_rays} rays from {first:.1f}° to {last:.1f}°, "
        f"{sensor.range_min:g} to {sensor.range_max:g} m"
    ]
    if run.ranges.size:
        shares = [(np.isfinite(run.ranges), "a return"), (np.isposinf(run.ranges), "no return")]
        shares += [(np.isneginf(run.ranges), "too close"), (np.isnan(run.ranges), "invalid")]
        if run.sensor.is_composite:
            shares[-1] = (shares[-1][0], "not measured at the time of the scan, or invalid")
        out.append("rays: " + ", ".join(f"{mask.mean():.1%} {what}" for mask, what in shares if mask.any()))
    x, y, yaw = sensor.mount
    if sensor.is_composite:
        n_places = len(np.unique(np.round(sensor.origins, 6), axis=0))
        out.append(f"several sensors combined: rays start at {n_places} positions in base_link")
    else:
        out.append(f"laser at ({x:.3f}, {y:.3f}) m, {np.degrees(yaw):.1f}° in base_link")
    if not sensor.is_composite and not sensor.cones.any():
        out.append(sweep_line(sensor))
    if sensor.cones.any():
        low, high = np.degrees([sensor.cones.min(), sensor.cones.max()])
        span = f"{low:.1f}°" if low == high else f"{low:.1f}° to {high:.1f}°"
        out.append(f"each ray measures the nearest surface in a cone of {span}")
    if len(run.pose_stamps):
        out.append(
            f"{len(run.pose_stamps):,} poses of {run.pose_frame} from {run.meta.get('pose_source', '/pose')}"
        )
    if len(run.odom_stamps):
        out.append(f"{len(run.odom_stamps):,} odometry poses and twists")
    if len(run.cmd_stamps):
        out.append(f"{len(run.cmd_stamps):,} commands")
    return out


def _missing(run: Run, recording: Recording | None) -> list[str]:
    out = []
    if run.n_scans == 0:
        out.append("scans: the file has no scans")
    if len(run.pose_stamps) == 0:
        out.append(
            "reference poses (/pose, or /tf map -> base_link): required to build a sensorgraph; "
            "`sensorgraph locate` estimates them from scans and odometry"
        )
    if len(run.odom_stamps) == 0:
        out.append("odometry (/odom)")
    if len(run.cmd_stamps) == 0:
        out.append("commands (/cmd_vel)")
    if recording is not None:
        out += [
            f"a selected topic for {role}: {choices(recording, role)}"
            for role, stamps in (("odom", run.odom_stamps), ("cmd", run.cmd_stamps))
            if len(stamps) == 0 and choices(recording, role)
        ]
    return out


def _ros_warnings(recording: Recording) -> list[str]:
    out = []
    for topic in _topics(recording):
        if topic.offset is not None and abs(topic.offset) > LIMITS.clock_offset:
            out.append(
                f"{topic.name}: log time is {topic.offset:.3f} s after the header stamp; check the clocks"
            )
    return out


def warnings_of(run: Run) -> list[str]:
    """Return the warnings about a run, one line each."""
    out = notes_of(run)
    source = run.meta.get("pose_source", "")
    if source == "slam":
        out.append(
            "the poses were estimated from these scans, so they absorb errors of the mount and the clock"
        )
    if source == "locate":
        out.append(
            "the poses were located with these scans, so they absorb errors of the mount and the clock"
        )
    if source.startswith("odometry"):
        out.append(
            "the poses are odometry, which drifts and distorts a map; "
            "`sensorgraph locate` estimates better poses"
        )
    out += _stamp_warnings(run) + _pose_warnings(run) + sweep_warnings(run)
    finite = np.isfinite(run.ranges)
    if finite.any():
        middle = float(np.median(run.ranges[finite]))
        if middle > LIMITS.centimetres:
            unit = "millimetres" if middle > LIMITS.millimetres else "centimetres or millimetres"
            out.append(f"the median range is {middle:g}, probably in {unit}; expected metres")
    blind = np.flatnonzero(~finite.any(axis=0)) if run.n_scans else np.zeros(0, dtype=np.intp)
    if len(blind):
        out.append(f"{len(blind)} rays never return: {_spans(blind)}; check whether the sensor is obstructed")
    return out


def _stamp_warnings(run: Run) -> list[str]:
    out = []
    for name, stamps in (("scan", run.stamps), ("pose", run.pose_stamps), ("odom", run.odom_stamps)):
        steps = np.diff(stamps)
        if len(steps) < 2:
            continue
        same = int((steps == 0).sum())
        if same and "duplicates" not in run.meta.get("notes", ""):
            out.append(
                f"{same} {name} stamps are duplicates; check for two publishers, or a bag recorded during playback"
            )
        gaps = steps > max(LIMITS.gap_periods * float(np.median(steps)), LIMITS.gap)
        if gaps.any():
            at = float(stamps[int(np.argmax(steps))])
            out.append(f"{name}: {int(gaps.sum())} gaps, the longest {steps.max():.2f} s at {at:.2f} s")
    return out


def _pose_warnings(run: Run) -> list[str]:
    poses, stamps = run.poses, run.pose_stamps
    out: list[str] = []
    if len(stamps) == 0 or run.n_scans == 0:
        return out
    if stamps[0] > run.stamps[-1] or stamps[-1] < run.stamps[0]:
        apart = max(stamps[0] - run.stamps[-1], run.stamps[0] - stamps[-1])
        out.append(f"poses and scans do not overlap in time, they are {apart:.1f} s apart; check the clocks")
    broken = int((~np.isfinite(poses)).any(axis=1).sum())
    if broken:
        out.append(f"{broken} poses are not finite")
    if len(stamps) > 1 and broken == 0:
        if np.ptp(poses, axis=0).max() < LIMITS.still:
            out.append("the pose never changes; check that the robot moved and the reference was running")
        steps = np.diff(stamps)
        moved = np.hypot(*np.diff(poses[:, :2], axis=0).T)
        jumps = (moved > LIMITS.jump) & (moved > LIMITS.jump_speed * np.maximum(steps, 1e-3))
        if run.meta.get("clock") == "assumed":
            jumps = moved > JUMP_LIMITS.untimed
        if jumps.any():
            at = float(stamps[int(np.argmax(np.where(jumps, moved, 0)))])
            out.append(
                f"the pose jumps {int(jumps.sum())} times, at most {moved[jumps].max():.2f} m at {at:.2f} s"
            )
    return out


def _spans(numbers: np.ndarray) -> str:
    """Format 3, 4, 5, 9 as `3-5, 9`."""
    groups = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)
    shown = [f"{group[0]}-{group[-1]}" if len(group) > 1 else f"{group[0]}" for group in groups[:5]]
    return ", ".join(shown) + (", ..." if len(groups) > 5 else "")
