"""Training scans of logs as blocks: paired with poses, split, checked and counted, piece by piece."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from logs.motion import ray_poses
from logs.run import Pairing, PoseFrame, RangeSensor, Run, pair
from logs.run_warnings import warnings_of
from logs.sensor import median_step
from logs.stream import LogStream
from sensorgraph.building.split import held_out
from sensorgraph.errors import SensorgraphError
from sensorgraph.intake import STANDSTILL, check_jumps, check_ranges
from sensorgraph.localization.robot_parts import robot_parts_at_poses, robot_parts_text, without_readings
from sensorgraph.models.base import TrainingScans
from sensorgraph.models.faces.reduction import SCANS_PER_BLOCK, Block
from sensorgraph.models.narmax.sequences import MAX_STEP, stretches
from sensorgraph.types import Bools, Floats
from sensorgraph.world.orientation import orientation
from sensorgraph.world.ray_order import ray_order, ray_order_line
from sensorgraph.world.self_fit import self_fit

logger = logging.getLogger(__name__)


class TrainingData:
    """The training scans of several logs as blocks; `entries` are complete after the last block."""

    def __init__(
        self, logs: Sequence[LogStream], names: Sequence[str], *, split: str | None,
        bounds: tuple[float, float, float, float] | None, force: bool = False,
    ) -> None:  # fmt: skip
        self.logs, self.names, self.split, self.bounds, self.force = logs, names, split, bounds, force
        self.entries: list[dict[str, Any]] = []
        self.sensor = logs[0].head.sensor
        """Sensor of all logs; logs that number the rays differently are reordered."""

    @property
    def pose_frame(self) -> PoseFrame:
        """Frame of the poses of all logs."""
        return self.logs[0].head.pose_frame

    @property
    def n_scans(self) -> int:
        """Number of scans of all logs, used for training or not."""
        return sum(log.n_scans for log in self.logs)

    def __iter__(self) -> Iterator[Block]:
        first = 0
        for i, (log, name) in enumerate(zip(self.logs, self.names, strict=True)):
            intake = _LogIntake(name, log.n_scans, self.split, force=self.force)
            own = log.head.sensor.bearings
            order = ray_order(own, self.sensor.bearings)
            assert order is not None  # `build` checks all logs
            if order[0] != 0:
                line = ray_order_line(own, self.sensor.bearings, "the graph")
                logger.info("%s: %s", name, line)
            rows: list[tuple[Floats, ...]] = []
            waiting = 0
            for run in log.pieces():
                poses, time, *of_rays = intake.take(run)
                rows.append((poses, time, *(part if order[0] == 0 else part[:, order] for part in of_rays)))
                waiting += len(rows[-1][0])
                while waiting >= SCANS_PER_BLOCK:
                    joined = [np.concatenate(parts) for parts in zip(*rows, strict=True)]
                    yield self._block(first, i, *(part[:SCANS_PER_BLOCK] for part in joined))
                    first, waiting = first + SCANS_PER_BLOCK, waiting - SCANS_PER_BLOCK
                    rows = [tuple(part[SCANS_PER_BLOCK:] for part in joined)]
            if waiting:
                yield self._block(first, i, *(np.concatenate(parts) for parts in zip(*rows, strict=True)))
                first += waiting
            entry = intake.entry()
            duplicate = next((known for known in self.entries if known["sha256"] == entry["sha256"]), None)
            if duplicate is not None:
                raise SensorgraphError(
                    f"{name} holds the same scans as {duplicate['name']}, which would count twice; give each run once"
                )
            self.entries.append(entry)

    def _block(
        self, first: int, i: int, poses: Floats, time: Floats, ranges: Floats, rays: Floats | None = None
    ) -> Block:
        scans = TrainingScans(
            sensor=self.sensor, poses=poses, ranges=ranges, run=np.full(len(poses), i, dtype=np.intp),
            bounds=self.bounds, pose_frame=self.pose_frame, ray_poses=rays, stamps=time[:, 0],
            sequence=time[:, 1].astype(np.intp),
        )  # fmt: skip
        return Block(first=first, scans=scans)


class _LogIntake:
    """State of one log while it is read piece by piece."""

    def __init__(self, name: str, n_scans: int, split: str | None, *, force: bool) -> None:
        self.name, self.n_scans, self.split, self.force = name, n_scans, split, force
        self.held = held_out(n_scans, split)
        self.counts = {"n_scans": 0, "paired": 0, "held_out": 0, "empty": 0, "trained": 0}
        self.dropped: dict[str, int] = {}
        self.warnings: dict[str, str] = {}
        self.box = np.array([[np.inf] * 3, [-np.inf] * 3])
        self.digest: hashlib._Hash | None = None
        self.last: tuple[Floats, Floats] = np.zeros(0), np.zeros((0, 3))
        self.period: float | None = None
        self.end: float | None = None
        """[s] Stamp of the last scan, if it was used."""
        self.n_stretches = 0
        self.robot_parts: Floats = np.zeros(0)
        """(n_rays,) Rays that end at the robot itself, from the first piece."""

    def take(self, run: Run) -> tuple[Floats, ...]:
        """Return poses, stamps with stretch numbers, and ranges of the training scans of a piece.

        For a sweep, also return the poses of its rays.
        """
        if self.digest is None:
            self.digest = begin_digest(run.sensor)
            self._check_first_piece(run)
        self.digest.update(ranges_bytes(run.ranges))
        start = self.counts["n_scans"]
        held = self.held[start : start + run.n_scans]
        if len(held) < run.n_scans:
            raise SensorgraphError(
                f"{self.name} holds more scans than the {self.n_scans} that it announced; read it again"
            )
        pairing = pair(run)
        self._check_jumps(run, pairing)
        empty = np.isnan(run.ranges).all(axis=1)
        use: Bools = pairing.paired & ~held & ~empty
        for key, mask in (
            ("n_scans", np.ones(run.n_scans, dtype=np.bool_)),
            ("paired", pairing.paired),
            ("held_out", held & pairing.paired),
            ("empty", empty & pairing.paired & ~held),
            ("trained", use),
        ):
            self.counts[key] += int(mask.sum())
        for reason, count in pairing.dropped.items():
            self.dropped[reason] = self.dropped.get(reason, 0) + count
        for text in warnings_of(run):
            self.warnings.setdefault("".join(c for c in text if not c.isdigit())[:30], text)
        run = self._without_robot(run, pairing, is_first=start == 0)
        poses = pairing.poses[use]
        if len(poses):
            self.box = np.array(
                [np.minimum(self.box[0], poses.min(axis=0)), np.maximum(self.box[1], poses.max(axis=0))]
            )
        time = self._time(run.stamps, use)
        if not run.sensor.has_ray_poses:
            return poses, time, run.ranges[use]
        return poses, time, run.ranges[use], ray_poses(run, pairing, np.flatnonzero(use))

    def _time(self, stamps: Floats, use: Bools) -> Floats:
        """Return stamp [s] and stretch number (n_used, 2); a stretch continues from one piece to the next."""
        if self.period is None:
            self.period = median_step(stamps, np.inf)
        number = stretches(stamps, use, self.period)
        if len(number) and self.end is not None and use[0]:
            follows = stamps[0] - self.end <= MAX_STEP * self.period
            number = number + self.n_stretches - int(follows)
        else:
            number = number + self.n_stretches
        if len(number):
            self.n_stretches = int(number[-1]) + 1
        self.end = float(stamps[-1]) if len(use) and use[-1] else None
        return np.column_stack([stamps[use], number])

    def _check_jumps(self, run: Run, pairing: Pairing) -> None:
        """Refuse poses that jump between the scans of this piece or from the preceding scan."""
        check_jumps(run, pairing, force=self.force, name=self.name, last=self.last)
        if pairing.paired.any():
            self.last = run.stamps[pairing.paired][-1:], pairing.poses[pairing.paired][-1:]

    def _without_robot(self, run: Run, pairing: Pairing, *, is_first: bool) -> Run:
        """Return the piece without readings of the robot itself, which would be surfaces wherever it drives."""
        if is_first:
            self.robot_parts = robot_parts_at_poses(run, pairing)
            if np.isfinite(self.robot_parts).any():
                self.warnings["robot"] = robot_parts_text(self.robot_parts, run.sensor.bearings)
        if np.isnan(self.robot_parts).all():
            return run
        return without_readings(run, self.robot_parts)

    def _check_first_piece(self, run: Run) -> None:
        """Refuse ranges in another unit, and warn of a mirrored or turned scan, and of scans that contradict each other."""
        check_ranges(run, self.name)
        oriented = orientation(run, None)
        if oriented is not None and oriented.best != "as logged":
            self.warnings["orientation"] = (
                f"the scan fits itself better {oriented.best}: check the sign of angle_increment, the mount's yaw, the "
                f"frame of the poses and the driver's `inverted` setting (for details: sensorgraph inspect {self.name})"
            )
        elif (better := self_fit(run)) is not None:
            self.warnings["self_fit"] = better.line()

    def entry(self) -> dict[str, Any]:
        """Return the log's entry in the graph; refuse a robot that stood still."""
        n = self.counts["trained"]
        if n > 1 and (self.box[1] - self.box[0]).max() < STANDSTILL:
            raise SensorgraphError(
                f"{self.name}: the pose never changes over {n} scans; check that the robot moved and the reference was running. "
                "Record while driving, or select the topic of the poses with `topics` pose=NAME"
            )
        pairing = f"{self.counts['paired']:,} of {self.counts['n_scans']:,} scans paired with poses"
        logger.info("%s: %s", self.name, pairing)
        digest = self.digest.hexdigest() if self.digest is not None else ""
        out = {"name": self.name, "sha256": digest, **self.counts, "dropped": dict(self.dropped)}
        return out | ({"warnings": list(self.warnings.values())} if self.warnings else {})


def begin_digest(sensor: RangeSensor) -> hashlib._Hash:
    """Start the sha256 of a run's measurements: its bearings, then every range in the order of the scans."""
    total = hashlib.sha256()
    total.update(np.ascontiguousarray(sensor.bearings, dtype="<f8").tobytes())
    return total


def ranges_bytes(ranges: Floats) -> bytes:
    """Return ranges (n_scans, n_rays) as bytes for the digest."""
    return np.ascontiguousarray(ranges, dtype="<f8").tobytes()


def all_scans(feed: TrainingData) -> TrainingScans | None:
    """Load all blocks into memory, for models that need all scans; None without scans."""
    parts = [block.scans for block in feed]
    if not parts:
        return None
    return TrainingScans(
        sensor=feed.sensor, poses=np.concatenate([part.poses for part in parts]),
        ranges=np.concatenate([part.ranges for part in parts]) if len(parts) > 1 else parts[0].ranges,
        run=np.concatenate([part.run for part in parts]), bounds=feed.bounds, pose_frame=feed.pose_frame,
        ray_poses=_all_ray_poses(parts),
        stamps=np.concatenate([part.stamps for part in parts if part.stamps is not None]),
        sequence=np.concatenate([part.sequence for part in parts if part.sequence is not None]),
    )  # fmt: skip


def _all_ray_poses(parts: Sequence[TrainingScans]) -> Floats | None:
    """Concatenate the poses of all rays if the laser swept in any part; otherwise return None."""
    if all(part.ray_poses is None for part in parts):
        return None
    return np.concatenate([part.poses_of_rays for part in parts])
