"""Convert PointCloud2 messages to LaserScan messages: the points of one plane, turn by turn, in a level frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from math import tau
from typing import Any

import numpy as np
from numpy.typing import NDArray

from logs.errors import LogError
from logs.ros import cdr
from logs.ros.cloud_points import MAX_ELEVATION, Cloud, Plane, decode, horizontal
from logs.ros.cloud_turns import Grid, TurnScans, find_grid
from logs.ros.messages import header
from logs.ros.poses import FIXED_FRAMES, FLOOR_FRAME, base_of
from logs.ros.recording import SCAN_TYPE, TF_TYPE, Recording, Topic, transform_tree
from logs.ros.transform_tree import TransformTree, to_matrices
from logs.transforms import to_translation_quaternion
from logs.types import Floats

N_FIRST_CLOUDS = 20
"""Number of clouds from which rings, bearings and the rotation are determined."""

REGISTERED_FRAMES = (*FIXED_FRAMES, "camera_init")
"""Frames of clouds that a mapping node has registered."""


@dataclass(frozen=True)
class _Level:
    """A level frame at the sensor, with the heading of the sensor."""

    rotation: Floats
    """(3, 3) from the frame of the sensor"""
    pose: Floats | None
    """(3,) [m, m, rad] in the base frame; None: unknown."""
    base: str
    height: float
    """[m] above `ground`"""
    base_height: float
    """[m] of the base frame above `ground`"""
    ground: str
    """Frame from which heights are counted."""

    @property
    def tilt(self) -> float:
        """[rad] angle between the vertical and the z axis of the sensor."""
        return float(np.arccos(np.clip(abs(self.rotation[2, 2]), -1, 1)))


def scans_of_clouds(
    recording: Recording, name: str, heights: tuple[float, float] | None
) -> tuple[dict[str, Topic], list[str]]:
    """Return LaserScan messages for a topic of point clouds, the transform to their level frame, and notes.

    Parameters
    ----------
    heights : [m] lowest and highest point that is used; None: the ring nearest the horizontal

    Raises
    ------
    LogError : If a message is damaged, or no point is in the plane.
    """
    topic = recording.topics[name]
    tree = transform_tree(recording, name)
    levels: dict[str, _Level] = {}

    def rotation(frame: str) -> Floats:
        if frame not in levels:
            levels[frame] = _level(tree, frame)
        return levels[frame].rotation

    def clouds() -> Iterator[tuple[int, Cloud]]:
        assert recording.again is not None
        for logged, payload in recording.again(name):
            yield logged, decode(bytes(payload), name, topic.encoding, rotation)

    first = [cloud for _, cloud in islice(clouds(), N_FIRST_CLOUDS)]
    if not first:
        raise LogError(f"{name} has no readable point cloud")
    frame = first[0].frame
    if frame.rpartition("/")[2] in REGISTERED_FRAMES:
        raise LogError(
            f"{name} is in the frame {frame}, which does not move with the robot; select a point cloud in the frame of "
            "its sensor with `topics` scan=NAME"
        )
    level = levels[frame]
    plane = _plane(first, level, heights)
    grid = find_grid(first, plane)
    scans = TurnScans(grid, np.inf if heights is None else np.nan)
    n_others = 0
    for logged, cloud in clouds():
        if cloud.frame == frame:
            scans.add(plane.select(cloud.points), cloud, logged)
        else:
            n_others += 1
    scans.close()
    n_dropped = scans.drop_incomplete()
    if not any(np.isfinite(scan.ranges).any() for scan in scans.scans):
        raise LogError(f"{name}: no point is in the plane ({plane.text}); choose other heights with `slice`")
    notes = [
        f"{name} is read as a laser: {plane.text}, {grid.n} bearings in a full turn",
        _times_note(name, grid, first),
    ]
    if n_dropped:
        notes.append(f"{name}: {n_dropped} incomplete turns were left out")
    if n_others:
        notes.append(f"{name}: {n_others} clouds in another frame than {frame} were left out")
    flat = frame if level.pose is None else f"{frame} (level)"
    found = turn_messages(topic, scans, flat)
    if level.pose is None:
        return {name: found}, notes
    middle = level.height if heights is None else sum(heights) / 2
    link = _transform(name, flat, level, middle - level.base_height, first[0].stamp)
    return {name: found, link.name: link}, notes


def _level(tree: TransformTree, frame: str) -> _Level:
    """Return the level frame of a sensor from the first samples of its transforms."""
    base = base_of(tree, frame, ())
    total = None if base is None else _first(tree, base, frame)
    if base is None or total is None:
        return _Level(np.eye(3), None, "", 0.0, 0.0, "the sensor")
    yaw = np.arctan2(total[1, 0], total[0, 0])
    turn = to_matrices(to_translation_quaternion(np.array([[0.0, 0.0, -yaw]])))[0, :3, :3]
    floor = tree.in_namespace_of(frame, FLOOR_FRAME)
    above, below = _first(tree, floor, frame), _first(tree, floor, base)
    known = above is not None and (base == floor or below is not None)
    height = float(above[2, 3]) if known and above is not None else float(total[2, 3])
    return _Level(
        turn @ total[:3, :3], np.array([total[0, 3], total[1, 3], yaw]), base, height,
        height - float(total[2, 3]), floor if known else base,
    )  # fmt: skip


def _first(tree: TransformTree, frame: str, other: str) -> Floats | None:
    """Return the matrix (4, 4) of another frame in `frame`, from the first sample of each transform."""
    chain = tree.path(frame, other)
    if chain is None:
        return None
    total = np.eye(4)
    for edge, is_inverse in chain:
        sample = to_matrices(edge.transforms[:1].astype(np.float64))[0]
        total = total @ (np.linalg.inv(sample) if is_inverse else sample)
    return total


def _plane(clouds: Sequence[Cloud], level: _Level, heights: tuple[float, float] | None) -> Plane:
    if heights is None:
        return horizontal(clouds, is_level=level.tilt <= MAX_ELEVATION)
    low, high = heights
    text = f"points from {low:g} to {high:g} m above {level.ground}, the nearest in each direction"
    return Plane(heights=(low - level.height, high - level.height), text=text, is_slice=True)


def turn_messages(
    topic: Topic, scans: TurnScans, frame: str, range_limits: tuple[float, float] | None = None
) -> Topic:
    """Return scans as LaserScan messages; directions at the ends that are never measured are left out.

    Parameters
    ----------
    range_limits : [m] lowest and highest range; None: 0 and the largest range
    """
    grid = scans.grid
    ranges, intensities = (
        np.stack([getattr(scan, name) for scan in scans.scans]) for name in ("ranges", "intensities")
    )
    low, high = range_limits or (0.0, float(ranges[np.isfinite(ranges)].max()))
    hit = np.flatnonzero((np.isfinite(ranges) if range_limits is None else ~np.isnan(ranges)).any(axis=0))
    some = slice(int(hit[0]), int(hit[-1]) + 1)
    delay = grid.period / grid.n
    ns = np.array([scan.start for scan in scans.scans], dtype=np.int64) + round(
        (some.start + 0.5) * delay * 1e9
    )
    first = grid.cut + grid.sign * float(scans.centres[some.start])
    width = grid.sign * grid.step * (some.stop - 1 - some.start)
    first -= tau * np.floor((first + width / 2) / tau + 0.5)  # the middle is between -pi and pi
    limits = np.array([first, first + width, grid.sign * grid.step, delay, grid.period, low, high])
    columns: dict[str, NDArray[Any]] = {**header(ns), "limits": limits, "ranges": ranges[:, some]}
    if np.isfinite(intensities[:, some]).any():
        columns["intensities"] = intensities[:, some]
    rows = cdr.pack(SCAN_TYPE, len(ns), strings={"frame_id": frame}, columns=columns)
    return Topic(
        topic.name, SCAN_TYPE, n_messages=len(ns), log_times=[scan.logged for scan in scans.scans],
        payloads=cdr.Messages(row.tobytes() for row in rows),
    )  # fmt: skip


def _times_note(name: str, grid: Grid, clouds: Sequence[Cloud]) -> str:
    if grid.period:
        turn = "counter-clockwise" if grid.sign > 0 else "clockwise"
        return f"{name}: a {turn} sweep of {grid.period:.4g} s from the times of the points"
    if not grid.unit:
        return f"{name}: points have no times, so all rays have the stamp of the cloud"
    return f"{name}: the times of points do not follow a rotation, so all rays have their median time"


def _transform(name: str, frame: str, level: _Level, z: float, ns: int) -> Topic:
    """Return a topic with the transform from the base frame to the level frame."""
    assert level.pose is not None
    columns: dict[str, NDArray[Any]] = {f"0.{key}": values for key, values in header(np.array([ns])).items()}
    columns["0.transform"] = to_translation_quaternion(level.pose[None], z)
    strings = {"0.frame_id": level.base, "0.child_frame_id": frame}
    rows = cdr.pack(TF_TYPE, 1, strings=strings, columns=columns, parts=1)
    return Topic(
        f"{name}/level/tf_static", TF_TYPE, n_messages=1, log_times=[ns],
        payloads=cdr.Messages(row.tobytes() for row in rows),
    )  # fmt: skip
