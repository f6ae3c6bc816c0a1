"""Recorder: write a run message by message during the drive; a crash loses at most the open chunk."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import ArrayLike

from logs.arguments import numbers_of
from logs.errors import LogError
from logs.formats.mcap_file import RosFile, latch
from logs.ros.messages import (
    command_messages,
    odometry_messages,
    pose_messages,
    scan_messages,
    to_ns,
    transform_messages,
)
from logs.ros.own_record import METADATA_NAME, sensor_facts
from logs.ros.recording import ODOMETRY_TYPE, POSE_TYPE, SCAN_TYPE, TF_TYPE, TWIST_STAMPED_TYPE
from logs.run import OccupancyMap, PoseFrame, RangeSensor
from logs.transforms import Stamps, compose, invert
from logs.types import Floats

logger = logging.getLogger(__name__)


class Recorder:
    """Write a run to `NAME.mcap` during the drive.

    While open, the file is `NAME.mcap.part`; the end of the `with` block renames it. After an exception inside the
    block, including Ctrl-C, the file becomes `NAME.interrupted.mcap` with the reason in its metadata, and the
    exception propagates. After `kill -9` or a power failure, `NAME.mcap.part` remains. `sensorgraph recover` then
    saves everything except the open chunk of 64 KiB.

    Raises
    ------
    OSError : The path is a folder, or the file cannot be written.
    ValueError : An array has another shape or holds no numbers, or a time is before 1970 (`LogError`).
    """

    def __init__(
        self,
        path: Path | str,
        *,
        sensor: RangeSensor,
        epoch_ns: int = 0,
        occupancy: OccupancyMap | None = None,
        pose_frame: PoseFrame = "base_link",
        meta: Mapping[str, str] | None = None,
        attachments: Mapping[str, bytes] | None = None,
    ) -> None:
        if epoch_ns < 0:
            raise ValueError(f"epoch_ns is {epoch_ns}, expected 0 or more: MCAP has no time before 1970")
        self.path = Path(path)
        self.sensor, self.epoch_ns, self.pose_frame = sensor, int(epoch_ns), pose_frame
        self._odometry = np.zeros(3)
        self._last = self.epoch_ns
        self._file = RosFile(self.path)
        try:
            stated = sensor_facts(
                sensor, pose_frame=pose_frame, epoch_ns=epoch_ns, zero_ns=epoch_ns, meta=dict(meta or {})
            )
            self._file.describe(METADATA_NAME, stated)
            for name, data in (attachments or {}).items():
                self.attach(name, data)
            latch(self._file, self.epoch_ns, sensor, occupancy)
        except BaseException:
            self._file.abandon()
            raise

    def scan(self, stamp: float, ranges: ArrayLike, intensities: ArrayLike | None = None) -> None:
        """Write one scan with ranges and intensities (n_rays,) [m, -]; `stamp` [s] is the time of the first ray."""
        row = _row(ranges, self.sensor.n_rays, "ranges")
        strengths = None if intensities is None else _row(intensities, self.sensor.n_rays, "intensities")
        at = self._ns(stamp)
        self._put("/scan", SCAN_TYPE, at, scan_messages(self.sensor, at, row, strengths))

    def pose(self, stamp: float, pose: ArrayLike) -> None:
        """Write one reference pose (3,) of `pose_frame` in map, and the corresponding transforms."""
        row = _row(pose, 3, "pose")
        at = self._ns(stamp)
        base = compose(row, invert(self.sensor.mount)) if self.pose_frame == "laser" else row
        driven = self._odometry[None]
        edges = (("map", "odom", compose(base, invert(driven))), ("odom", "base_link", driven))
        self._put("/tf", TF_TYPE, at, transform_messages(at, *edges))
        self._put("/pose", POSE_TYPE, at, pose_messages(at, row))

    def odometry(self, stamp: float, pose: ArrayLike, twist: ArrayLike) -> None:
        """Write one odometry pose (3,), base_link in odom, with its twist (2,)."""
        row = _row(pose, 3, "odometry pose")
        at = self._ns(stamp)
        self._put("/odom", ODOMETRY_TYPE, at, odometry_messages(at, row, _row(twist, 2, "twist")))
        self._odometry = row[0]

    def command(self, stamp: float, twist: ArrayLike) -> None:
        """Write one commanded twist (2,)."""
        at = self._ns(stamp)
        self._put("/cmd_vel", TWIST_STAMPED_TYPE, at, command_messages(at, _row(twist, 2, "twist")))

    def attach(self, name: str, data: bytes) -> None:
        """Attach a file immediately."""
        self._file.attach(name, data, self._last)

    def close(self) -> Path:
        """Finish the file and give it its final name."""
        return self._file.finish()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        if exc is None:
            self.close()
            return
        self._file.describe(f"{METADATA_NAME}.interrupted", {"reason": f"{type(exc).__name__}: {exc}"})
        kept = self._file.finish(interrupted=True)
        logger.warning("the recording was interrupted; the data written so far are in %s", kept)

    def _ns(self, stamp: float) -> Stamps:
        at = to_ns(np.array([stamp], dtype=np.float64), self.epoch_ns)
        if at[0] < 0:
            raise LogError(f"stamp {stamp} s is before 1970; pass epoch_ns to the recorder")
        self._last = int(at[0])
        return at

    def _put(self, topic: str, msgtype: str, at: Stamps, rows: np.ndarray) -> None:
        self._file.put(self._file.channel(topic, msgtype), int(at[0]), rows.tobytes())


def _row(values: ArrayLike, width: int, name: str) -> Floats:
    row = numbers_of(values, name)
    if row.shape != (width,):
        raise ValueError(f"{name} has shape {row.shape}, expected ({width},)")
    return row[None]
