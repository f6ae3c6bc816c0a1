"""When each ray of a scan was taken, found from the run itself where the log does not say.

A robot that turns smears its scans by what the mirror needs for a sweep, and tears them into a comb where several sweeps are
interlaced. In short pieces of track with many turns, poses, surfaces and these times are fitted together; what comes out is
compared with what mirrors there are. The mean of all times cannot be told from the poses, and need not be.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from logs.motion import Motion
from logs.run import RangeSensor, Run
from logs.transforms import compose, invert
from sensorgraph.localization.front_end import ScanTrack, track
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of
from sensorgraph.localization.point_rows import FramePoints, PointRows, point_rows, sums_by
from sensorgraph.localization.pose_graph import PoseEdges
from sensorgraph.localization.refinement import (
    conjugate_gradients,
    pose_graph_matrix,
    reduced_system,
    refine,
)
from sensorgraph.localization.scans import ScanPoints, scan_points
from sensorgraph.localization.settings import RAY_TIMES, REFINEMENT, RayTimeSettings
from sensorgraph.localization.wheel_edges import WheelSteps
from sensorgraph.types import Floats, Ints, Progress

CLASSES = 4
"""A ray's number modulo this is its class: up to so many sweeps may be interlaced."""
MIRRORS = {"SICK LMS 2xx": 1 / 75, "SICK PLS": 1 / 25}
"""Laser whose driver says nothing of it -> [s] that a turn of its mirror takes (SICK AG, technical descriptions)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackedRun:
    """A run whose scans were followed from one to the next."""

    run: Run
    """Its sensor has the times of its rays."""
    odometry: Floats | None
    """(n_scans, 3) [m, m, rad] at the scans; None: no use."""
    scans: ScanPoints
    track: ScanTrack
    notes: tuple[str, ...] = ()
    """What was found about the times."""


def track_run(run: Run, progress: Progress, settings: RayTimeSettings = RAY_TIMES) -> TrackedRun:
    """Follow all scans; where the log does not say when rays were taken and the run shows it, once more with that."""
    motion = odometry_of(run)
    odometry = None if motion is None else odometry_at_scans(run, motion)
    scans = scan_points(run, motion)
    tracked = track(scans, run.stamps, odometry, progress)
    if motion is not None and odometry is not None and not run.sensor.has_ray_poses:
        found = identify_ray_times(run, motion, odometry, tracked, settings)
        if found is not None:
            run = replace(run, sensor=found.sensor)
            scans = scan_points(run, motion)
            tracked = track(scans, run.stamps, odometry, progress)
            return TrackedRun(run=run, odometry=odometry, scans=scans, track=tracked, notes=(found.line,))
    return TrackedRun(run=run, odometry=odometry, scans=scans, track=tracked)


@dataclass(frozen=True, kw_only=True, eq=False)
class RayTimes:
    """A hypothesis that the run bears out, and what the run says by itself."""

    name: str
    """Of the laser."""
    sensor: RangeSensor
    values: Floats
    """(4,) [s] as estimated: time of a sweep, and from the first class of rays to each other."""
    standard_errors: Floats
    """(4,) [s]"""

    @property
    def line(self) -> str:
        """Say it."""
        sensor, k = self.sensor, self.sensor.interlaced_sweeps
        way = " clockwise" if sensor.is_clockwise else ""
        what = f"a scan sweeps{way} for {1e3 * abs(sensor.sweep_time):.1f} ms"
        if k > 1:
            what = (
                f"{k} interlaced sweeps{way} of {1e3 * abs(sensor.sweep_time):.1f} ms, {1e3 * sensor.sweep_period:+.1f} ms "
                "apart, make a scan"
            )
        both = [
            f"{1e3 * abs(v):.1f} ± {1e3 * sd:.1f}"
            for v, sd in zip(self.values, self.standard_errors, strict=True)
        ]
        shown = f"{both[0]} and {both[1]} ms" if k > 1 else f"{both[0]} ms"
        return f"{what}, as of {self.name} (found from the run, which shows {shown}; sensor.sweep_time overrules it)"


def hypotheses(sensor: RangeSensor) -> list[tuple[str, RangeSensor]]:
    """Return the name of each laser that may have taken the scans, and the sensor with its times."""
    n = sensor.n_rays
    share = (n / (n - 1) if n > 1 else 1.0) * float(np.ptp(sensor.bearings)) / (2 * np.pi)
    out = []
    for name, turn in (*MIRRORS.items(), ("a laser that turns once a scan", 1.0 / sensor.rate)):
        counts = (1, 2, 4) if name in MIRRORS else (1,)
        for way in (1.0, -1.0):
            sweep = replace(sensor, sweep_time=way * share * turn)
            for k in counts:
                for order in (1.0, -1.0)[: min(k, 2)]:
                    out.append(
                        (
                            name,
                            sweep
                            if k == 1
                            else replace(sweep, interlaced_sweeps=k, sweep_period=order * turn),
                        )
                    )
    return out


def _values(sensor: RangeSensor) -> Floats:
    """Return time of a sweep and delays of classes (4,) [s] of a sensor."""
    classes = np.arange(1, CLASSES) % sensor.interlaced_sweeps
    return np.array([sensor.sweep_time, *(sensor.sweep_period * classes)])


def identify_ray_times(
    run: Run, motion: Motion, odometry: Floats, tracked: ScanTrack, settings: RayTimeSettings = RAY_TIMES
) -> RayTimes | None:
    """Estimate time of a sweep and delays of classes, and name the laser that has them; None: none is borne out.

    Parameters
    ----------
    motion, odometry : of the run, and at its scans
    tracked : with all rays of a scan at its stamp
    """
    pieces = _Pieces.of(run, odometry, tracked, settings)
    if pieces is None:
        return None
    values, ray = np.zeros(CLASSES), np.arange(run.sensor.n_rays)
    covariance = np.zeros((CLASSES, CLASSES))
    for step in range(settings.steps):
        delays = values[0] * ray / len(ray) + np.append(0.0, values[1:])[ray % CLASSES]
        change, covariance = pieces.estimate(delays, motion)
        values = values + change
        if step == 0 and change @ np.linalg.solve(covariance, change) < settings.least_gain:
            return None
    return _judge(run.sensor, values, covariance, settings)


def _judge(
    sensor: RangeSensor, values: Floats, covariance: Floats, settings: RayTimeSettings
) -> RayTimes | None:
    """Return the hypothesis that the estimate bears out, if it is the only one.

    A scan's stamp is then the mean of its rays' times: the poses of scans stay where they are without these times.
    """

    def distance(expected: Floats) -> float:
        own = covariance + np.diag((settings.motion_error * np.abs(expected)) ** 2)
        off = values - expected
        return float(off @ np.linalg.solve(own, off))

    judged = sorted(
        ((distance(_values(one)), name, one) for name, one in hypotheses(sensor)), key=lambda row: row[0]
    )
    (best, name, found), second = judged[0], judged[1]
    without = distance(np.zeros(CLASSES))
    if best > settings.most_distance or min(without, second[0]) - best < settings.least_gain:
        return None
    found = replace(found, first_ray_delay=-float(found.ray_delays.mean()))
    return RayTimes(name=name, sensor=found, values=values, standard_errors=np.sqrt(np.diag(covariance)))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pieces:
    """Short pieces of track with many turns, laid out far from each other so that each has a map of its own."""

    run: Run
    """Its key frames alone."""
    piece: Ints
    """(n_frames,)"""
    poses: Floats
    """(n_frames, 3)"""
    wheels: WheelSteps
    graph: PoseEdges

    @staticmethod
    def of(run: Run, odometry: Floats, tracked: ScanTrack, settings: RayTimeSettings) -> _Pieces | None:
        """Choose the pieces in which the robot turned fastest; None: it hardly turned."""
        keys, m = tracked.key_frames, settings.frames
        rate = np.abs(np.gradient(odometry[:, 2], np.arange(len(odometry))))[keys] * run.sensor.rate
        starts = [k for k in range(0, len(keys) - m + 1, m) if tracked.piece[k] == tracked.piece[k + m - 1]]
        turning = np.array([(np.minimum(rate[k : k + m], settings.fast) ** 2).mean() for k in starts])
        chosen = np.sort(np.argsort(-turning)[: settings.pieces])
        if len(chosen) < settings.least_pieces or np.sqrt(np.median(turning[chosen])) < settings.least_rate:
            return None
        index = np.array([starts[k] for k in chosen])[:, None] + np.arange(m)
        frames, piece = index.ravel(), np.repeat(np.arange(len(chosen)), m)
        poses = tracked.poses[keys[frames]].copy()
        origin = poses[::m][piece]
        poses[:, :2] -= origin[:, :2]
        poses[:, 0] += settings.apart * piece
        inner = np.flatnonzero(np.diff(piece) == 0)
        relative = compose(invert(poses[inner]), poses[inner + 1])
        return _Pieces(
            run=replace(
                run,
                stamps=run.stamps[keys[frames]],
                ranges=run.ranges[keys[frames]],
            ),
            piece=piece,
            poses=poses,
            wheels=WheelSteps(
                first=inner,
                steps=compose(invert(odometry[keys[frames[inner]]]), odometry[keys[frames[inner + 1]]]),
                has_odometry=True,
            ),
            graph=PoseEdges(
                first=inner,
                second=inner + 1,
                relative=relative,
                information=tracked.edge_information[frames[inner]],
            ),
        )

    def estimate(self, delays: Floats, motion: Motion) -> tuple[Floats, Floats]:
        """Return what is missing from the delays (n_rays,) [s], as sweep and classes (4,), and its covariance."""
        s = REFINEMENT
        scans = scan_points(self.run, motion, delays=delays)
        keys = np.arange(scans.n_scans)
        frames = FramePoints.of(scans, keys)
        graph = (self.graph, PoseEdges.of([]))
        refined = refine(frames, self.poses, self.wheels, graph, lambda done, total: None)
        poses = refined.poses
        rows = point_rows(frames, poses, s.last_side, s.last_gate, s.last_sigma)
        system = reduced_system(rows, poses, self.wheels.at(poses))
        by = self._by_times(rows, poses, scans.rays[rows.index], motion)
        n, m, weight = len(poses), rows.n_patches, rows.weight
        columns = range(CLASSES)
        by_pose = np.column_stack([
            np.column_stack([sums_by(rows.frame, weight * rows.by_pose[:, i] * by[:, j], n) for i in range(3)]).ravel()
            for j in columns
        ])  # fmt: skip
        by_line = np.column_stack([
            np.column_stack([sums_by(rows.patch, weight * rows.by_line[:, i] * by[:, j], m) for i in range(2)]).ravel()
            for j in columns
        ])  # fmt: skip
        rhs = by_pose - system.coupling @ (system.inverse[:, None] * by_line)
        moved, _ = conjugate_gradients(
            system, rhs, pose_graph_matrix(system, poses, graph), s.tolerance, s.max_steps
        )
        lines = system.inverse[:, None] * (by_line - system.coupling.T @ moved)
        own = (
            by
            - np.einsum("ni,nij->nj", rows.by_pose, moved.reshape(n, 3, -1)[rows.frame])
            - np.einsum("ni,nij->nj", rows.by_line, lines.reshape(m, 2, -1)[rows.patch])
        )  # what poses and lines cannot make up for
        ridge = np.diag(np.full(CLASSES, RAY_TIMES.widest**-2.0))
        matrix = np.einsum("n,ni,nj->ij", weight, own, own) + ridge
        change = -np.linalg.solve(matrix, np.einsum("n,ni,n->i", weight, own, rows.residual))
        left = weight * (rows.residual + own @ change)
        scores = np.stack(
            [sums_by(self.piece[rows.frame], left * own[:, j], int(self.piece[-1]) + 1) for j in columns]
        )
        inverse = np.linalg.inv(matrix)
        pieces = scores.shape[1]
        return change, inverse @ (scores @ scores.T * pieces / (pieces - 1) + ridge) @ inverse

    def _by_times(self, rows: PointRows, poses: Floats, rays: Ints, motion: Motion) -> Floats:
        """Return the derivative (n, 4) [m/s] of the residuals by sweep and classes."""
        stamps, short = self.run.stamps, RAY_TIMES.short
        velocity = compose(invert(motion.at(stamps)), motion.at(stamps + short)) / short
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        in_map = np.column_stack([
            cos * velocity[:, 0] - sin * velocity[:, 1], sin * velocity[:, 0] + cos * velocity[:, 1], velocity[:, 2]
        ])  # fmt: skip
        speed = np.einsum("ni,ni->n", rows.by_pose, in_map[rows.frame])
        classes = rays % CLASSES
        share = rays / self.run.sensor.n_rays
        by_class = [np.asarray(classes == k, dtype=np.float64) for k in range(1, CLASSES)]
        return np.asarray(speed[:, None] * np.column_stack([share, *by_class]))
