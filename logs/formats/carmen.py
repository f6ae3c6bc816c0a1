"""Read CARMEN logs: FLASER, RLASER, ROBOTLASER1, RAWLASER1, ODOM, TRUEPOS and PARAM lines; plain or gzip.

These logs state neither the code of a missing return nor whether SLAM corrected their poses. Both are inferred from
the data and recorded in the meta of the run. The words after the ranges differ between recorders: poses, times and the
host in any order, or none of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from logs.errors import LogError
from logs.formats.carmen_clock import CLOCK, CarmenClock, read_clock
from logs.formats.text import read_lines
from logs.no_return import decode
from logs.resampling import resample, resampled_text
from logs.run import PoseFrame, RangeSensor, Run, rate_of
from logs.transforms import compose, invert, twists_of, wrap
from logs.types import Floats, Mounts, Progress

SCAN_KEYWORDS = ("FLASER", "ROBOTLASER1", "RAWLASER1", "RLASER", "ROBOTLASER2", "RAWLASER2")
"""Keywords of scan lines; the first one in the log is read unless `topics` selects another, such as scan=RLASER."""
KEYWORDS = frozenset({*SCAN_KEYWORDS, "ODOM", "TRUEPOS", "PARAM", "SYNC", "NEFF", "POSITION", "GPGGA", "IMU"})
# readings -> (first bearing [°], step [°]): the configurations of SICK and Hokuyo lasers in CARMEN
LAYOUTS = {
    101: (-50.0, 1.0), 180: (-90.0, 1.0), 181: (-90.0, 1.0), 201: (-50.0, 0.5), 360: (-90.0, 0.5),
    361: (-90.0, 0.5), 401: (-50.0, 0.25), 541: (-135.0, 0.5), 682: (-120.0, 0.3515625), 720: (-90.0, 0.25),
    721: (-90.0, 0.25), 1081: (-135.0, 0.25),
}  # fmt: skip
ALL_WORDS = {"ODOM": 9, "TRUEPOS": 9, "FLASER": 9, "RLASER": 9, "RAW": 3, "ROBOT": 14}
"""Number of words of a complete line, after its ranges: poses, and `time host time`."""
RIGID_TOLERANCE = 0.02
"""[m, rad] maximum apparent motion of a rigid mount, caused by rounded poses."""


def matches(path: Path, head: bytes) -> bool:
    """Return whether the first line with content is a CARMEN line."""
    for line in head.splitlines():
        words = line.split(maxsplit=1)
        if words and not words[0].startswith(b"#"):
            return words[0].decode("ascii", errors="replace") in KEYWORDS
    return b"message formats defined" in head


@dataclass
class _ParsedLines:
    """The values of a log, grouped by keyword."""

    scans: dict[str, list[_ScanLine]] = field(default_factory=dict)
    odom: list[list[float]] = field(default_factory=list)
    """x, y, phi, v, omega, stamp, line number; nan for what a line does not contain."""
    true: list[list[float]] = field(default_factory=list)
    """x, y, phi, stamp, line number."""
    params: dict[str, str] = field(default_factory=dict)
    is_filtered: bool = False
    """Whether the log has NEFF lines of a particle filter."""
    broken: list[int] = field(default_factory=list)
    """Line numbers that could not be parsed."""
    others: Counter[str] = field(default_factory=Counter)


@dataclass(frozen=True)
class _ScanLine:
    number: int
    ranges: Floats
    geometry: tuple[float, float, float, float]
    """First bearing and step [rad], maximum range and accuracy [m]; nan if the line does not state them."""
    laser: tuple[float, ...]
    robot: tuple[float, ...]
    """Poses (x, y, phi), or empty."""
    times: tuple[float, float]
    """[s] time of the sensor and of the logger; nan without a time."""


def read(
    path: Path,
    topics: Mapping[str, str] | None = None,
    progress: Progress | None = None,
    no_return: str | None = None,
    mounts: Mounts | None = None,
) -> Run:
    """Read a run; in corrected logs the poses are those of the laser.

    Raises
    ------
    LogError
        If the log has no scans, lacks the scans that `topics` selects, or has more invalid lines than valid ones.
    """
    lines = _parse(read_lines(path), progress)
    kind = _choose(path, lines, topics)
    scans, notes = lines.scans[kind], list[str]()
    if lines.broken:
        share = len(lines.broken) / (len(lines.broken) + len(scans) + len(lines.odom))
        if share > 0.5:
            raise LogError(
                f"{path}: {len(lines.broken)} lines are invalid, the first is line {lines.broken[0]}; "
                "check that the copy is complete"
            )
        notes.append(f"{len(lines.broken)} invalid lines left out, the first is line {lines.broken[0]}")
    others = [f"{len(found)} {name}" for name, found in lines.scans.items() if name != kind]
    if others:
        notes.append(f"other scans in the log (select them with `topics` scan=NAME): {', '.join(others)}")
    laser = np.array([scan.laser or (np.nan,) * 3 for scan in scans])
    robot = np.array([scan.robot or (np.nan,) * 3 for scan in scans])
    clock = read_clock(
        np.array([scan.times for scan in scans], dtype=np.float64),
        np.array([scan.number for scan in scans], dtype=np.float64),
        laser,
        notes,
    )
    stamps, order = clock.stamps, clock.order
    ranges, bearings, limits = _ranges(scans, no_return, notes)
    source = _pose_source(path.name, lines, laser, robot)
    mount = _mount(kind, lines, laser, robot, source)
    found = _signals(lines, source, clock, laser, robot, mount)
    return Run(
        sensor=RangeSensor(
            bearings=bearings,
            range_min=0.0,
            range_max=limits,
            mount=mount,
            resolution=_resolution(ranges),
            rate=rate_of(stamps[order]),
        ),
        stamps=stamps[order],
        ranges=ranges[order],
        pose_stamps=found.pose_stamps,
        poses=found.poses,
        odom_stamps=found.odom_stamps,
        odometry=found.odometry,
        odom_twists=found.twists,
        pose_frame=found.frame,
        epoch_ns=clock.epoch_ns,
        meta={
            "source": path.name,
            "format": "carmen",
            "scan_topic": kind,
            "pose_source": source,
            **({"clock": "assumed"} if clock.is_assumed else {}),
            **({"notes": "; ".join(notes + found.notes)} if notes or found.notes else {}),
        },
    )


def _parse(text: list[str], progress: Progress | None) -> _ParsedLines:
    lines = _ParsedLines()
    found: dict[str, list[_Words]] = {}
    for number, line in enumerate(text, 1):
        if progress is not None and number % 1000 == 0:
            progress(number, len(text))
        word, _, rest = line.partition(" ")
        if not word or word.startswith("#"):
            continue
        try:
            if word in SCAN_KEYWORDS:
                found.setdefault(word, []).append(_scan_words(word, rest.split(), number))
            elif word in ("ODOM", "TRUEPOS"):
                found.setdefault(word, []).append(_Words(number, rest.split()))
            elif word == "PARAM":
                name, value = rest.split()[:2]
                lines.params[name] = value
            elif word == "NEFF":
                lines.is_filtered = True
            else:
                lines.others[word] += 1
        except (ValueError, IndexError):
            lines.broken.append(number)
    for word, parsed in found.items():
        usual = Counter(len(each.rest) for each in parsed).most_common(1)[0][0]
        for each in parsed:
            # a line with fewer words than a complete one is another dialect if most lines are like it, otherwise cut
            if len(each.rest) != usual and len(each.rest) < ALL_WORDS[_family(word)]:
                lines.broken.append(each.number)
                continue
            try:
                _add(lines, word, each)
            except ValueError:
                lines.broken.append(each.number)
    lines.broken.sort()
    return lines


@dataclass(frozen=True)
class _Words:
    """A line, split into its ranges and the words after them."""

    number: int
    rest: list[str]
    ranges: Floats = field(default_factory=lambda: np.zeros(0))
    geometry: tuple[float, float, float, float] = (np.nan,) * 4


def _family(word: str) -> str:
    return word if word in ALL_WORDS else word.partition("LASER")[0]


def _scan_words(word: str, values: list[str], number: int) -> _Words:
    """Split the words after the keyword of a scan line."""
    at, geometry = 0, (np.nan, np.nan, np.nan, np.nan)
    if not word.endswith("LASER"):  # laser_type start_angle fov resolution range_max accuracy remission_mode
        geometry = (float(values[1]), float(values[3]), float(values[4]), float(values[5]))
        at = 7
    n = int(values[at])
    end = at + 1 + n
    if n < 1 or len(values) < end:
        raise ValueError(f"{n} ranges")
    ranges = np.array(list(map(float, values[at + 1 : end])))
    if not word.endswith("LASER") and len(values) > end:
        end += 1 + int(values[end])  # remissions
    return _Words(number, values[end:], ranges, geometry)


def _add(lines: _ParsedLines, word: str, words: _Words) -> None:
    """Add a line: poses, then other numbers, then times and the host in any order.

    A line with six numbers or more has the poses of laser and robot; with three to five, one pose; with fewer, none.
    """
    rest, number = words.rest, words.number
    is_number = [_number(text) is not None for text in rest]
    n_leading = is_number.index(False) if False in is_number else len(rest)
    n_poses = 0 if word.startswith("RAW") else 6 if n_leading >= 6 else 3 if n_leading >= 3 else 0
    values = [float(text) for text in rest[:n_poses]]
    n_before = 11 if word.startswith("ROBOT") and n_leading >= 11 else n_poses
    times = [value for text in rest[n_before:] if (value := _number(text)) is not None] or [np.nan]
    if any(abs(time) > CLOCK.latest for time in times):
        raise ValueError("a stamp that is out of range")
    if word in ("ODOM", "TRUEPOS"):
        if n_poses == 0:
            raise ValueError("no pose")
        twist = values[3:5] or [np.nan, np.nan]
        (lines.odom if word == "ODOM" else lines.true).append(
            [*values[:3], *(twist if word == "ODOM" else []), times[0], number]
        )
        return
    scan = _ScanLine(
        number, words.ranges, words.geometry, tuple(values[:3]), tuple(values[-3:]), (times[0], times[-1])
    )
    lines.scans.setdefault(word, []).append(scan)


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _choose(path: Path, lines: _ParsedLines, topics: Mapping[str, str] | None) -> str:
    named = (topics or {}).get("scan")
    there = [kind for kind in SCAN_KEYWORDS if kind in lines.scans]
    if named is not None and named.lstrip("/") not in there:
        raise LogError(f"scan={named} is not in {path}; it has {', '.join(there) or 'no scans'}")
    if not there:
        kinds = {"ODOM": len(lines.odom), "TRUEPOS": len(lines.true), **lines.others}
        seen = ", ".join(f"{count} {name}" for name, count in kinds.items() if count) or "nothing"
        broken = f" and {len(lines.broken)} invalid lines" if lines.broken else ""
        raise LogError(f"{path} has no scans; it has {seen}{broken}; expected FLASER or ROBOTLASER1 lines")
    return named.lstrip("/") if named is not None else there[0]


def _ranges(scans: list[_ScanLine], no_return: str | None, notes: list[str]) -> tuple[Floats, Floats, float]:
    """Return ranges with missing returns as +inf, the most common bearings, and range_max."""
    groups: dict[bytes, list[int]] = {}
    for i, scan in enumerate(scans):
        key = np.array([len(scan.ranges), *np.round(scan.geometry[:2], 6)]).tobytes()
        groups.setdefault(key, []).append(i)
    parts = [np.stack([scans[i].ranges for i in mine]) for mine in groups.values()]
    heads = [scans[mine[0]] for mine in groups.values()]
    most = int(np.argmax([len(mine) for mine in groups.values()]))
    stated = heads[most].geometry[2]
    code, said = decode(parts, float(stated) if np.isfinite(stated) and stated > 0 else None, no_return)
    notes += said
    largest = max((float(part[np.isfinite(part)].max(initial=0.0)) for part in parts), default=0.0) or 1.0
    limit = code if code is not None else float(stated) if stated > largest else largest
    bearings = [_bearings(len(head.ranges), head.geometry, notes) for head in heads]
    ranges = np.empty((len(scans), len(bearings[most])))
    for k, mine in enumerate(groups.values()):
        ranges[mine] = parts[k] if k == most else resample(parts[k], bearings[k], bearings[most])
    if len(groups) > 1:
        notes.append(resampled_text([len(own) for own in bearings], [len(part) for part in parts]))
    return ranges, bearings[most], max(limit, 1e-3)


def _bearings(n: int, geometry: tuple[float, float, float, float], notes: list[str]) -> Floats:
    """Return the bearings (n,) [rad] of a scan of n rays."""
    first, step, _, _ = geometry
    if np.isfinite(first) and step > 0:
        return first + step * np.arange(n, dtype=np.float64)
    if n in LAYOUTS:
        return np.asarray(np.radians(LAYOUTS[n][0] + LAYOUTS[n][1] * np.arange(n, dtype=np.float64)))
    notes.append(f"the bearings of {n} rays are unknown: assumed to be evenly spaced from -90° to 90°")
    return np.linspace(-np.pi / 2, np.pi / 2, n) if n > 1 else np.zeros(1)


def _pose_source(name: str, lines: _ParsedLines, laser: Floats, robot: Floats) -> str:
    """Infer whether the poses of the laser come from SLAM, from an external reference or from odometry."""
    if lines.true:
        return "TRUEPOS"
    whole = np.isfinite(laser).all(axis=1)
    if not whole.any():
        return "none"
    mount = compose(invert(robot[whole]), laser[whole])
    middle = np.median(mount, axis=0)
    moved = np.abs(mount - middle)
    moved[:, 2] = np.abs(wrap(mount[:, 2] - middle[2]))
    is_rigid = bool((moved < RIGID_TOLERANCE).all())
    return "slam" if lines.is_filtered or "corrected" in name or not is_rigid else "odometry"


def _mount(kind: str, lines: _ParsedLines, laser: Floats, robot: Floats, source: str) -> Floats:
    """Return the mount of the laser in base_link, from the poses of a raw log or from its PARAM lines."""
    rear = kind in ("RLASER", "ROBOTLASER2", "RAWLASER2")
    name = f"robot_{'rear' if rear else 'front'}laser_offset"
    try:
        stated = float(lines.params.get(name, 0.0))
    except ValueError:
        raise LogError(
            f"PARAM {name} is {lines.params[name]!r}, expected a length in metres; correct that line"
        ) from None
    whole = np.isfinite(laser).all(axis=1)
    if source in ("odometry", "TRUEPOS") and whole.any():
        return np.asarray(np.median(compose(invert(robot[whole]), laser[whole]), axis=0))
    return np.array([stated, 0.0, np.pi if rear else 0.0])


@dataclass(frozen=True)
class _Signals:
    pose_stamps: Floats
    poses: Floats
    frame: PoseFrame
    odom_stamps: Floats
    odometry: Floats
    twists: Floats
    notes: list[str]


def _signals(
    lines: _ParsedLines, source: str, clock: CarmenClock, laser: Floats, robot: Floats, mount: Floats
) -> _Signals:
    """Return the reference poses and the wheel odometry.

    If a particle filter corrected the log (GFS, with NEFF lines), its ODOM lines restart at the corrected pose with
    every scan, and their stamps are 0 or less. They are not wheel measurements and are left out.
    """
    notes = []
    order = clock.order[np.isfinite(laser[clock.order]).all(axis=1)]
    at, lasers, robots = clock.stamps[order], laser[order], robot[order]
    odom = np.array(lines.odom, dtype=np.float64).reshape(-1, 7)
    odom = np.column_stack([odom[:, :5], clock.others(odom[:, 6], odom[:, 5])])
    if source == "slam":
        raw = bool(len(at)) and not lines.is_filtered and np.abs(lasers - robots).max() > RIGID_TOLERANCE
        if len(odom) and not raw:
            notes.append(
                f"{len(odom)} ODOM lines follow the corrected poses, not the wheels, and were left out"
            )
            odom = odom[:0]
    if len(odom) == 0 and source != "slam" and len(at):  # a log with only scans, which contain odometry
        odom = np.column_stack([robots, twists_of(at, robots), at])
    odom = odom[np.isfinite(odom[:, 5])]
    odom = odom[np.argsort(odom[:, 5], kind="stable")]
    odom_stamps, odometry, twists = odom[:, 5], odom[:, :3].copy(), odom[:, 3:5]
    odometry[:, 2] = wrap(odometry[:, 2])
    if np.isnan(twists).any():
        twists = np.where(np.isnan(twists), twists_of(odom_stamps, odometry), twists)
    frame: PoseFrame = "base_link"
    if source == "slam":
        frame, pose_stamps, poses = "laser", at, lasers
    elif source == "TRUEPOS":
        true = np.array(lines.true, dtype=np.float64)
        pose_stamps = clock.others(true[:, 4], true[:, 3])
        order = np.argsort(pose_stamps, kind="stable")
        pose_stamps, poses = pose_stamps[order], true[order, :3]
    elif source == "odometry":
        pose_stamps, poses = at, robots
    else:
        pose_stamps, poses = odom_stamps, odometry
    poses = poses.copy()
    poses[:, 2] = wrap(poses[:, 2])
    return _Signals(pose_stamps, poses, frame, odom_stamps, odometry, twists, notes)


def _resolution(ranges: Floats) -> float:
    """Return the step [m] of which all ranges are multiples: 1 mm, 5 mm, 1 cm, 5 cm, or 0."""
    values = ranges[np.isfinite(ranges)][:20000]
    for step in (0.05, 0.01, 0.005, 0.001):
        if len(values) and np.abs(values / step - np.rint(values / step)).max() < 1e-6 / step:
            return step
    return 0.0
