"""Read CARMEN logs: FLASER, RLASER, ROBOTLASER1, RAWLASER1, ODOM, TRUEPOS and PARAM lines; plain or gzip.

These logs state neither the code of a missing return nor whether SLAM corrected their poses. Both are inferred from
the data and recorded in the meta of the run. The words after the ranges differ between recorders: poses, times and the
host in any order, or none of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from logs.error_codes import blank_error_codes
from logs.errors import LogError
from logs.formats.carmen_clock import ASSUMED_PERIOD, CarmenClock, read_clock
from logs.formats.carmen_lines import SCAN_KEYWORDS, ParsedLines, ScanLine, parse_lines
from logs.formats.text import read_lines
from logs.intensities import is_varied
from logs.no_return import decode
from logs.resampling import resample, resampled_text, take_nearest
from logs.run import PoseFrame, RangeSensor, Run
from logs.sensor import usual_step
from logs.transforms import compose, invert, twists_of, wrap
from logs.types import Floats, ReadOptions

KEYWORDS = frozenset({*SCAN_KEYWORDS, "ODOM", "TRUEPOS", "PARAM", "SYNC", "NEFF", "POSITION", "GPGGA", "IMU"})
# readings -> (first bearing [°], step [°]): the configurations of SICK and Hokuyo lasers in CARMEN
LAYOUTS = {
    101: (-50.0, 1.0), 180: (-90.0, 1.0), 181: (-90.0, 1.0), 201: (-50.0, 0.5), 360: (-90.0, 0.5),
    361: (-90.0, 0.5), 401: (-50.0, 0.25), 541: (-135.0, 0.5), 682: (-120.0, 0.3515625), 720: (-90.0, 0.25),
    721: (-90.0, 0.25), 1081: (-135.0, 0.25),
}  # fmt: skip
RIGID_TOLERANCE = 0.02
"""[m, rad] maximum apparent motion of a rigid mount, caused by rounded poses."""


def matches(path: Path, head: bytes) -> bool:
    """Return whether the first line with content is a CARMEN line."""
    for line in head.splitlines():
        words = line.split(maxsplit=1)
        if words and not words[0].startswith(b"#"):
            return words[0].decode("ascii", errors="replace") in KEYWORDS
    return b"message formats defined" in head


def read(path: Path, how: ReadOptions) -> Run:
    """Read a run; in corrected logs the poses are those of the laser.

    Raises
    ------
    LogError
        If the log has no scans, lacks the scans that `topics` selects, or has more invalid lines than valid ones.
    """
    lines = parse_lines(read_lines(path), how.progress)
    kind = _choose(path, lines, how.topics)
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
    ranges, intensities, bearings, limits = _ranges(scans, how.no_return, notes)
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
            rate=1.0 / usual_step(stamps[order], ASSUMED_PERIOD),
        ),
        stamps=stamps[order],
        ranges=ranges[order],
        intensities=intensities[order] if len(intensities) else intensities,
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
            **({"clock": clock.replaced_by} if clock.replaced_by else {}),
            **({"notes": "; ".join(notes + found.notes)} if notes or found.notes else {}),
        },
    )


def _choose(path: Path, lines: ParsedLines, topics: Mapping[str, str] | None) -> str:
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


def _ranges(
    scans: list[ScanLine], no_return: str | None, notes: list[str]
) -> tuple[Floats, Floats, Floats, float]:
    """Return ranges with missing returns as +inf, intensities or (0, n_rays), the most common bearings, and range_max."""
    groups: dict[bytes, list[int]] = {}
    for i, scan in enumerate(scans):
        key = np.array([len(scan.ranges), *np.round(scan.geometry[:2], 6)]).tobytes()
        groups.setdefault(key, []).append(i)
    parts = [np.stack([scans[i].ranges for i in mine]) for mine in groups.values()]
    heads = [scans[mine[0]] for mine in groups.values()]
    most = int(np.argmax([len(mine) for mine in groups.values()]))
    stated = heads[most].geometry[2]
    notes += blank_error_codes(parts, 0.0, np.inf)  # `decode` finds the codes beyond all returns
    code, said = decode(parts, float(stated) if np.isfinite(stated) and stated > 0 else None, no_return)
    notes += said
    largest = max((float(part[np.isfinite(part)].max(initial=0.0)) for part in parts), default=0.0) or 1.0
    limit = code if code is not None else float(stated) if stated > largest else largest
    bearings = [_bearings(len(head.ranges), head.geometry, notes) for head in heads]
    ranges, intensities = np.empty((2, len(scans), len(bearings[most])))
    for k, mine in enumerate(groups.values()):
        remissions = np.stack([scans[i].remissions for i in mine])
        ranges[mine] = parts[k] if k == most else resample(parts[k], bearings[k], bearings[most])
        intensities[mine] = remissions if k == most else take_nearest(remissions, bearings[k], bearings[most])
    if len(groups) > 1:
        notes.append(resampled_text([len(own) for own in bearings], [len(part) for part in parts]))
    intensities = intensities if is_varied(intensities) else intensities[:0]
    return ranges, intensities, bearings[most], max(limit, 1e-3)


def _bearings(n: int, geometry: tuple[float, float, float, float], notes: list[str]) -> Floats:
    """Return the bearings (n,) [rad] of a scan of n rays."""
    first, step, _, _ = geometry
    if np.isfinite(first) and step > 0:
        return first + step * np.arange(n, dtype=np.float64)
    if n in LAYOUTS:
        return np.asarray(np.radians(LAYOUTS[n][0] + LAYOUTS[n][1] * np.arange(n, dtype=np.float64)))
    notes.append(f"the bearings of {n} rays are unknown: assumed to be evenly spaced from -90° to 90°")
    return np.linspace(-np.pi / 2, np.pi / 2, n) if n > 1 else np.zeros(1)


def _pose_source(name: str, lines: ParsedLines, laser: Floats, robot: Floats) -> str:
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


def _mount(kind: str, lines: ParsedLines, laser: Floats, robot: Floats, source: str) -> Floats:
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
    lines: ParsedLines, source: str, clock: CarmenClock, laser: Floats, robot: Floats, mount: Floats
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
