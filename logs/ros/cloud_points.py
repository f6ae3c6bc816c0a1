"""Decode PointCloud2 messages, and select the points of one scan plane: a ring, a band of elevations, or a slice."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from logs.errors import LogError
from logs.ros import cdr
from logs.ros.recording import CLOUD_TYPE
from logs.types import Bools, Floats

NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Code of a type in PointField -> numpy type."""
RING_FIELDS = ("ring", "line", "channel", "laser_id")
TIME_FIELDS = ("t", "time", "timestamp", "offset_time", "time_stamp", "time_offset")
INTENSITY_FIELDS = ("intensity", "intensities", "reflectivity", "i")
"""Names of fields in the drivers of Velodyne, Ouster, Hesai, RoboSense and Livox."""


MAX_ELEVATION = float(np.radians(1.0))
"""[rad] maximum elevation of a point, if the elevations form no separate rings."""
MIN_RING_GAP = float(np.radians(0.1))
"""[rad] gap between the elevations of two rings."""
MIN_DISTANCE = 1.0
"""[m] nearer points do not determine the elevation of a ring, because beams start off the centre."""
MAX_FLAT = 1e-3
"""[m] points whose heights span less were measured by a planar laser."""


@dataclass(frozen=True)
class Points:
    """The points of one cloud with a range, in a level frame at the sensor."""

    xyz: Floats
    """(n, 3) [m]"""
    ring: NDArray[np.int64] | None
    """(n,) number of the ring, or row of an organised cloud; None: unknown."""
    times: Floats | None
    """(n,) as in the message; None: unknown."""
    intensities: Floats | None
    """(n,)"""

    @property
    def bearings(self) -> Floats:
        """(n,) [rad]"""
        return np.asarray(np.arctan2(self.xyz[:, 1], self.xyz[:, 0]))

    @property
    def ranges(self) -> Floats:
        """(n,) [m] distances along the floor."""
        return np.hypot(self.xyz[:, 0], self.xyz[:, 1])

    @property
    def elevations(self) -> Floats:
        """(n,) [rad] above the horizontal."""
        return np.asarray(np.arctan2(self.xyz[:, 2], self.ranges))

    def take(self, some: Bools | NDArray[np.intp]) -> Points:
        """Return a subset of the points."""
        return Points(
            self.xyz[some],
            None if self.ring is None else self.ring[some],
            None if self.times is None else self.times[some],
            None if self.intensities is None else self.intensities[some],
        )


@dataclass(frozen=True)
class Cloud:
    """One decoded message."""

    stamp: int
    """[ns]"""
    frame: str
    points: Points


def decode(payload: bytes, topic: str, encoding: str, rotation_of: Callable[[str], Floats]) -> Cloud:
    """Decode one message; points at the origin and those that are not finite have no return and are left out.

    Parameters
    ----------
    rotation_of : Frame of the sensor -> (3, 3) rotation from it to the level frame.

    Raises
    ------
    LogError : If the message is damaged, or has no fields x, y, z.
    """
    (block,) = cdr.unpack([payload], CLOUD_TYPE, topic, encoding)
    height, width = block["size"][0].tolist()
    point_step, row_step = block["steps"][0].tolist()
    order = ">" if block["is_bigendian"][0, 0] else "<"
    names, formats, offsets = [], [], []
    for i in range(block.n_parts):
        part = block.part(i)
        kind = NUMBERS.get(int(part["datatype"][0, 0]))
        offset = int(part["offset"][0, 0])
        if kind is None or part.strings["name"] in names or not part.strings["name"]:
            continue
        if offset + np.dtype(kind).itemsize > point_step:
            raise LogError(
                f"{topic}: field {part.strings['name']} runs past the {point_step} bytes of a point"
            )
        names.append(part.strings["name"])
        formats.append(order + kind)
        offsets.append(offset)
    if not {"x", "y", "z"} <= set(names):
        raise LogError(f"{topic}: a point has the fields {', '.join(names) or 'none'}; expected x, y and z")
    data = block["data"][0]
    row_step = max(row_step, point_step * width)  # some drivers send 0
    if row_step * height > len(data):
        raise LogError(
            f"{topic}: a cloud of {height} x {width} points of {point_step} bytes holds {len(data)} bytes"
        )
    rows = data[: row_step * height].reshape(height, row_step)[:, : point_step * width]
    record = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": point_step})
    points = np.ascontiguousarray(rows).reshape(-1).view(record)
    xyz = np.stack([points[name].astype(np.float64) for name in "xyz"], axis=-1)
    kept: Bools = np.isfinite(xyz).all(axis=1) & (xyz != 0).any(axis=1)
    frame = block.strings["frame_id"].strip("/")
    level = xyz[kept] @ rotation_of(frame).T
    numbers = _column(points, RING_FIELDS, kept)
    ring = None if numbers is None else numbers.astype(np.int64)
    if ring is None and height > 1:
        ring = _grid_ring(level, kept, width)
    return Cloud(
        stamp=int(block.stamps_ns[0]),
        frame=frame,
        points=Points(
            level,
            ring,
            _column(points, TIME_FIELDS, kept),
            _column(points, INTENSITY_FIELDS, kept),
        ),
    )


def _grid_ring(level: Floats, kept: Bools, width: int) -> NDArray[np.int64]:
    """Return the row or the column of each point (n,) in an organised cloud: that whose points have one elevation."""
    row, column = np.divmod(np.flatnonzero(kept), width)
    elevations = np.arctan2(level[:, 2], np.hypot(level[:, 0], level[:, 1]))

    def spread(index: NDArray[np.int64]) -> float:
        count = np.maximum(np.bincount(index), 1)
        mean = np.bincount(index, elevations) / count
        return float(((elevations - mean[index]) ** 2).sum())

    return row if not len(row) or spread(row) <= spread(column) else column


def _column(points: NDArray[np.void], names: Sequence[str], kept: Bools) -> Floats | None:
    there = points.dtype.names or ()
    name = next((name for name in names if name in there), None)
    return None if name is None else points[name][kept].astype(np.float64)


@dataclass(frozen=True)
class Plane:
    """Which points belong to the scan."""

    ring: int | None = None
    elevations: tuple[float, float] | None = None
    """[rad] lowest and highest."""
    heights: tuple[float, float] | None = None
    """[m] lowest and highest, above the sensor."""
    text: str = ""
    is_slice: bool = False
    """Whether points of several rings are selected by height."""

    def select(self, points: Points) -> Points:
        """Return the points of the scan."""
        if self.heights is not None:
            z = points.xyz[:, 2]
            return points.take((z >= self.heights[0]) & (z <= self.heights[1]))
        if self.ring is not None and points.ring is not None:
            return points.take(points.ring == self.ring)
        low, high = self.elevations or (-MAX_ELEVATION, MAX_ELEVATION)
        elevations = points.elevations
        return points.take((elevations >= low) & (elevations <= high))


def horizontal(clouds: Sequence[Cloud], *, is_level: bool) -> Plane:
    """Return the ring nearest the horizontal; of two equally near ones the upper, which does not meet the floor.

    If the sensor is tilted, no ring is horizontal all around, and a band of elevations is used. So it is without
    rings. The ring of an organised cloud is a row.
    """
    z = np.concatenate([cloud.points.xyz[:, 2] for cloud in clouds])
    if len(z) and float(np.ptp(z)) < MAX_FLAT:  # the points of a planar laser
        return Plane(heights=(float(z.min()), float(z.max())), text="all points, which lie in one plane")
    rings = [cloud.points.ring for cloud in clouds]
    elevations = np.concatenate([cloud.points.elevations for cloud in clouds])
    is_far = np.concatenate([cloud.points.ranges for cloud in clouds]) > MIN_DISTANCE
    if is_level and all(ring is not None for ring in rings):
        ring = np.concatenate([ring for ring in rings if ring is not None])
        use = is_far if is_far.any() else np.ones(len(ring), dtype=np.bool_)
        number = np.unique(ring[use])
        middle = np.array([np.median(elevations[use & (ring == k)]) for k in number])
        if len(number):
            k = int(np.lexsort((-middle, np.round(np.abs(middle), 3)))[0])
            text = f"ring {number[k]} at an elevation of {np.degrees(middle[k]):.1f}°"
            return Plane(ring=int(number[k]), text=text)
    low, high = _band(elevations[is_far])
    shown = f"points at elevations from {np.degrees(low):.1f}° to {np.degrees(high):.1f}°"
    return Plane(elevations=(low, high), text=f"{shown}, the nearest in each direction")


def _band(elevations: Floats) -> tuple[float, float]:
    """Return the limits of the ring nearest the horizontal; of a continuous distribution, the band around it."""
    band = MAX_ELEVATION
    some = np.sort(elevations[np.abs(elevations) < 15 * band])
    if len(some) == 0:
        return -band, band
    cuts = np.flatnonzero(np.diff(some) > MIN_RING_GAP) + 1
    starts, stops = np.concatenate([[0], cuts]), np.concatenate([cuts, [len(some)]]) - 1
    middle = (some[starts] + some[stops]) / 2
    k = int(np.lexsort((-middle, np.round(np.abs(middle), 3)))[0])
    if some[stops[k]] - some[starts[k]] > 2 * band:  # no rings
        return -band, band
    below = (some[starts[k]] - some[stops[k - 1]]) / 2 if k > 0 else band
    above = (some[starts[k + 1]] - some[stops[k]]) / 2 if k + 1 < len(starts) else band
    return float(some[starts[k]] - min(below, band)), float(some[stops[k]] + min(above, band))
