"""Inspect a file: topics, frames, usable and missing signals, and anything suspicious."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from logs.clocks import CLOCK_LIMITS
from logs.errors import LogError
from logs.formats import FORMATS, check_slice, format_of, mcap_file, rosbag
from logs.intensities import intensity_line
from logs.no_return import check_no_return
from logs.ros.interpret import to_run
from logs.ros.recording import (
    KEPT_TYPES,
    TF_TYPE,
    Recording,
    Topic,
    check_roles,
    transform_tree,
)
from logs.run import Run, pair
from logs.run_warnings import warnings_of
from logs.sweep import sweep_line
from logs.types import Floats, Mounts, Progress, ReadOptions
from logs.usability import Ground, Use, advice, ground_of, no_use, uses_of

LOADERS: dict[str, Callable[[Path, Progress | None], Recording]] = {
    "mcap": mcap_file.load,
    "rosbag": rosbag.load,
}
"""Format with topics -> its loader."""


@dataclass(frozen=True, kw_only=True)
class TopicInfo:
    """One topic, or one signal of a file that has no topics."""

    name: str
    type: str
    n_messages: int
    rate: float | None
    """[Hz] messages over time, the median over all spans of half the log; None where half of the stamps are equal."""
    frame: str
    first: float | None
    """[s] time of the first message, from the start of the file."""
    last: float | None
    offset: float | None
    """[s] median of log time minus header stamp; None without a header."""
    longest_gap: float | None = None
    """[s] longest time between two messages; None for fewer than two."""
    n_back: int = 0
    """Number of messages whose stamp is before that of the previous message."""


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
    use: tuple[Use, ...]
    """What the log can be used for, and why."""
    ground: Ground | None
    """The motion of the robot; None if nothing shows it."""
    advice: str
    """What to record in another minute of driving; empty if nothing is missing."""
    run: Run | None = field(repr=False)
    """The run for further checks; None if the file cannot be read as a run."""

    def lines(self, more: Sequence[str] = ()) -> list[str]:
        """Return the inspection as lines of text, with more lines before the table of uses at the end."""
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
        out += ["pairing", f"  {self.pairing}"] if self.pairing else []
        return [*out, *more, *self.use_lines()]

    def use_lines(self) -> list[str]:
        """Return the table of what the log can be used for."""
        width = max(len(use.name) for use in self.use)
        rows = [f"  {use.name:<{width}}  {use.verdict:<7}  {use.why}" for use in self.use]
        unknown = "unknown: " + (
            "the log has neither odometry nor poses" if self.usable else "it is not read as a run"
        )
        rows.append(f"  {'ground covered':<{width}}  {self.ground or unknown}")
        rows += [f"  {'would help':<{width}}  {self.advice}"] if self.advice else []
        return ["what this log can be used for", *rows]

    def to_dict(self) -> dict[str, Any]:
        """Return the inspection as plain data, without the run."""
        plain = {
            name: getattr(self, name)
            for name in self.__dataclass_fields__
            if name not in ("run", "topics", "use", "ground")
        }
        return {
            **plain,
            "topics": [asdict(topic) for topic in self.topics],
            "use": [asdict(use) for use in self.use],
            "ground": None if self.ground is None else self.ground.to_dict(),
            "is_run": self.run is not None,
        }


@np.errstate(all="ignore")  # numbers that overflow are reported, not raised
def inspect(
    path: Path | str,
    topics: Mapping[str, str] | None = None,
    *,
    no_return: str | None = None,
    mounts: Mounts | None = None,
    slice: tuple[float, float] | None = None,
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
    check_slice(path, kind, slice)
    how = ReadOptions(topics, progress, no_return, mounts, slice)
    recording: Recording | None = None
    run: Run | None = None
    missing: list[str] = []
    if kind in LOADERS:
        recording = LOADERS[kind](path, progress)
        try:
            run = to_run(recording, path.name, how)
        except LogError as exc:
            if topics or slice is not None:
                raise
            missing.append(str(exc))
    else:
        run = FORMATS[kind].read(path, how)
    warnings = [] if recording is None or run is not None else _clock_warnings(recording)
    usable: list[str] = []
    pairing = ""
    ground, use, wanted = None, no_use(), ""
    if run is not None:
        usable += _usable(run)
        missing += _missing(run)
        warnings += warnings_of(run)
        pairing = str(pair(run))
        ground = ground_of(run)
        use, wanted = uses_of(run, ground), advice(run, ground)
    return Inspection(
        path=str(path),
        format=recording.format if recording is not None else kind,
        n_bytes=sum(f.stat().st_size for f in path.iterdir() if f.is_file()) if path.is_dir() else path.stat().st_size,
        topics=tuple(_topics(recording) if recording is not None else _signals(run)),
        transforms=tuple(transform_tree(recording).lines() if recording is not None else ()),
        attachments={name: len(data) for name, data in (recording.attachments if recording else {}).items()},
        usable=tuple(usable),
        missing=tuple(missing),
        warnings=tuple(dict.fromkeys(warnings)),
        pairing=pairing,
        meta=dict(run.meta) if run is not None else {},
        use=use,
        ground=ground,
        advice=wanted,
        run=run,
    )  # fmt: skip


def _topics(recording: Recording) -> list[TopicInfo]:
    start = min((min(t.log_times) for t in recording.topics.values() if t.log_times), default=0)
    return [_topic(topic, start) for topic in recording.topics.values()]


def _topic(topic: Topic, start: int) -> TopicInfo:
    logged = np.sort(np.array(topic.log_times, dtype=np.int64))
    frame, offset, n_back = "", None, 0
    stamps = logged
    if topic.type in KEPT_TYPES and topic.type != TF_TYPE and topic.payloads:
        headers, frames = logged.copy(), dict[str, int]()
        raw = np.array(topic.log_times, dtype=np.int64)
        for block in topic.blocks():
            if "sec" in block.places:
                headers[block.index] = block.stamps_ns
                offset = 0.0
            name = block.strings.get("frame_id", "")
            frames[name] = frames.get(name, 0) + len(block.index)
        if offset is not None:
            offset = float(np.median(raw - headers)) / 1e9
            n_back = int((np.diff(headers) < 0).sum())
            stamps = np.sort(headers)
        frame = ", ".join(frames)
    span = len(logged) > 0
    return TopicInfo(
        name=topic.name,
        type=topic.title,
        n_messages=topic.n_messages,
        rate=_rate(stamps / 1e9),
        frame=frame,
        first=(int(logged[0]) - start) / 1e9 if span else None,
        last=(int(logged[-1]) - start) / 1e9 if span else None,
        offset=offset,
        longest_gap=_longest(stamps / 1e9),
        n_back=n_back,
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
            first=float(stamps[0]), last=float(stamps[-1]), offset=None, longest_gap=_longest(stamps),
        )
        for name, kind, stamps, frame in rows if len(stamps)
    ]  # fmt: skip


def _longest(stamps: Floats) -> float | None:
    return float(np.diff(stamps).max()) if len(stamps) > 1 else None


def _rate(stamps: Floats) -> float | None:
    n = len(stamps) // 2
    span = float(np.median(stamps[n:] - stamps[: len(stamps) - n])) if n else 0.0
    return n / span if span > 0 else None


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
        out.append(
            "rays: " + ", ".join(f"{100 * mask.mean():.1f} % {what}" for mask, what in shares if mask.any())
        )
    if len(run.intensities):
        out.append(intensity_line(run))
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
        source = f" from {run.meta['odom_topic']}" if "odom_topic" in run.meta else ""
        out.append(f"{len(run.odom_stamps):,} odometry poses and twists{source}")
    if len(run.cmd_stamps):
        out.append(f"{len(run.cmd_stamps):,} commands")
    return out


def _missing(run: Run) -> list[str]:
    out = []
    if run.n_scans == 0:
        out.append("scans: the file has no scans")
    if len(run.pose_stamps) == 0:
        out.append(
            "reference poses (/pose, or /tf map -> base_link): required to build a sensorgraph; "
            "`sensorgraph locate` estimates them from scans and odometry"
        )
    if len(run.odom_stamps) == 0:
        out.append("odometry (/odom, or /tf odom -> base_link)")
    if len(run.cmd_stamps) == 0:
        out.append("commands (/cmd_vel)")
    return out


def _clock_warnings(recording: Recording) -> list[str]:
    """Return a warning on header stamps that differ from the log times, for a file that is not read as a run."""
    offsets = {topic.name: topic.offset for topic in _topics(recording) if topic.offset is not None}
    apart = {name: offset for name, offset in offsets.items() if abs(offset) > CLOCK_LIMITS.offset}
    if not apart:
        return []
    low, high = min(apart.values()), max(apart.values())
    span = f"{low:,.3f}" if high - low < CLOCK_LIMITS.latency else f"{low:,.3f} to {high:,.3f}"
    return [f"the log times are {span} s after the header stamps of {', '.join(apart)}"]
