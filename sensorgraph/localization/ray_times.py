"""Identify the time of each ray within a scan from the run itself, where the log does not contain it.

On a turning robot a sweep smears the scan, and interlaced sweeps split it into a comb. In short track pieces
with many turns, Gauss-Newton minimises the weighted squares of point-to-line residuals,

    sum_i w_i (r_i(pose, line) + J_i · values)².

The unknowns are the poses, the lines of the surface patches and the four `values` of the ray times. The
result is compared with the known mirrors. The mean of all times is not observable, since the poses absorb it.
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
"""Number of ray classes, by ray number modulo this: the maximum number of interlaced sweeps."""
MIRRORS = {"SICK LMS 2xx": 1 / 75, "SICK PLS": 1 / 25}
"""Laser without ray times in its driver -> [s] mirror period (SICK AG, technical descriptions)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackedRun:
    """A run with tracked scans."""

    run: Run
    """The run; its sensor has the identified ray times."""
    odometry: Floats | None
    """(n_scans, 3) [m, m, rad] Odometry at the scans; None: unusable."""
    scans: ScanPoints
    track: ScanTrack
    notes: tuple[str, ...] = ()
    """Notes about the ray times."""


def track_run(run: Run, progress: Progress, settings: RayTimeSettings = RAY_TIMES) -> TrackedRun:
    """Track all scans; if ray times are missing from the log and the run shows them, track again with these."""
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
    """A laser hypothesis that the run confirms, and the estimate from the run."""

    name: str
    """Name of the laser."""
    sensor: RangeSensor
    values: Floats
    """(4,) [s] Estimated sweep time, and delays of ray classes 1 to 3 relative to class 0."""
    standard_errors: Floats
    """(4,) [s]"""

    @property
    def line(self) -> str:
        """One line for the user: the ray times, the laser and the estimate."""
        sensor, k = self.sensor, self.sensor.interlaced_sweeps
        way = " clockwise" if sensor.is_clockwise else ""
        what = f"a scan is one{way} sweep of {1e3 * abs(sensor.sweep_time):.1f} ms"
        if k > 1:
            what = (
                f"a scan is {k} interlaced{way} sweeps of {1e3 * abs(sensor.sweep_time):.1f} ms, "
                f"{1e3 * sensor.sweep_period:+.1f} ms apart"
            )
        both = [
            f"{1e3 * abs(v):.1f} ± {1e3 * sd:.1f}"
            for v, sd in zip(self.values, self.standard_errors, strict=True)
        ]
        shown = f"{both[0]} and {both[1]} ms" if k > 1 else f"{both[0]} ms"
        return (
            f"{what}, as in {self.name}; identified from the run, which shows {shown} "
            "(`sensor.sweep_time` in robot.yaml overrides it)"
        )


def hypotheses(sensor: RangeSensor) -> list[tuple[str, RangeSensor]]:
    """Return the name of each candidate laser, and the sensor with its ray times."""
    n = sensor.n_rays
    share = (n / (n - 1) if n > 1 else 1.0) * float(np.ptp(sensor.bearings)) / (2 * np.pi)
    out = []
    for name, turn in (*MIRRORS.items(), ("a laser that turns once per scan", 1.0 / sensor.rate)):
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
    """Return the sweep time and the class delays (4,) [s] of a sensor."""
    classes = np.arange(1, CLASSES) % sensor.interlaced_sweeps
    return np.array([sensor.sweep_time, *(sensor.sweep_period * classes)])


def identify_ray_times(
    run: Run, motion: Motion, odometry: Floats, tracked: ScanTrack, settings: RayTimeSettings = RAY_TIMES
) -> RayTimes | None:
    """Estimate sweep time and class delays; return the laser that matches them, or None without a match.

    Parameters
    ----------
    motion, odometry : Odometry of the run, and the same at its scans.
    tracked : Track with all rays of a scan at its stamp.
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
        if step == 0 and change @ np.linalg.solve(covariance, change) < settings.min_gain:
            return None
    return _judge(run.sensor, values, covariance, settings)


def _judge(
    sensor: RangeSensor, values: Floats, covariance: Floats, settings: RayTimeSettings
) -> RayTimes | None:
    """Return the hypothesis that the estimate confirms, if it is the only one.

    The confirmed sensor has the mean ray time at the stamp of the scan, so that the poses do not change.
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
    if best > settings.max_distance or min(without, second[0]) - best < settings.min_gain:
        return None
    found = replace(found, first_ray_delay=-float(found.ray_delays.mean()))
    return RayTimes(name=name, sensor=found, values=values, standard_errors=np.sqrt(np.diag(covariance)))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pieces:
    """Short track pieces with many turns, placed far apart so that each has its own map."""

    run: Run
    """The run, reduced to the key frames of the pieces."""
    piece: Ints
    """(n_frames,)"""
    poses: Floats
    """(n_frames, 3)"""
    wheels: WheelSteps
    graph: PoseEdges

    @staticmethod
    def of(run: Run, odometry: Floats, tracked: ScanTrack, settings: RayTimeSettings) -> _Pieces | None:
        """Choose the pieces with the fastest turns; None if the robot hardly turned."""
        keys, m = tracked.key_frames, settings.frames
        rate = np.abs(np.gradient(odometry[:, 2], np.arange(len(odometry))))[keys] * run.sensor.rate
        starts = [k for k in range(0, len(keys) - m + 1, m) if tracked.piece[k] == tracked.piece[k + m - 1]]
        turning = np.array([(np.minimum(rate[k : k + m], settings.max_rate) ** 2).mean() for k in starts])
        chosen = np.sort(np.argsort(-turning)[: settings.pieces])
        if len(chosen) < settings.min_pieces or np.sqrt(np.median(turning[chosen])) < settings.min_rate:
            return None
        index = np.array([starts[k] for k in chosen])[:, None] + np.arange(m)
        frames, piece = index.ravel(), np.repeat(np.arange(len(chosen)), m)
        poses = tracked.poses[keys[frames]].copy()
        origin = poses[::m][piece]
        poses[:, :2] -= origin[:, :2]
        poses[:, 0] += settings.piece_offset * piece
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
        """Return the change of the delays (n_rays,) [s] as sweep time and class delays (4,), with its covariance.

        The covariance is cluster-robust over the pieces.
        """
        s = REFINEMENT
        scans = scan_points(self.run, motion, delays=delays)
        keys = np.arange(scans.n_scans)
        frames = FramePoints.of(scans, keys)
        graph = (self.graph, PoseEdges.of([]))
        refined = refine(frames, self.poses, self.wheels, graph, lambda done, total: None)
        poses = refined.poses
        rows = point_rows(frames, poses, s.last_side, s.last_gate, s.last_sigma)
        system = reduced_system(rows, poses, self.wheels.at(poses))
        by = self._time_derivatives(rows, poses, scans.rays[rows.index], motion)
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
        )  # derivatives after projection on poses and lines
        ridge = np.diag(np.full(CLASSES, RAY_TIMES.delay_sd**-2.0))
        matrix = np.einsum("n,ni,nj->ij", weight, own, own) + ridge
        change = -np.linalg.solve(matrix, np.einsum("n,ni,n->i", weight, own, rows.residual))
        left = weight * (rows.residual + own @ change)
        scores = np.stack(
            [sums_by(self.piece[rows.frame], left * own[:, j], int(self.piece[-1]) + 1) for j in columns]
        )
        inverse = np.linalg.inv(matrix)
        pieces = scores.shape[1]
        return change, inverse @ (scores @ scores.T * pieces / (pieces - 1) + ridge) @ inverse

    def _time_derivatives(self, rows: PointRows, poses: Floats, rays: Ints, motion: Motion) -> Floats:
        """Return the derivatives (n, 4) [m/s] of the residuals with respect to sweep time and class delays."""
        stamps, velocity_interval = self.run.stamps, RAY_TIMES.velocity_interval
        velocity = (
            compose(invert(motion.at(stamps)), motion.at(stamps + velocity_interval)) / velocity_interval
        )
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        in_map = np.column_stack([
            cos * velocity[:, 0] - sin * velocity[:, 1], sin * velocity[:, 0] + cos * velocity[:, 1], velocity[:, 2]
        ])  # fmt: skip
        speed = np.einsum("ni,ni->n", rows.by_pose, in_map[rows.frame])
        classes = rays % CLASSES
        share = rays / self.run.sensor.n_rays
        by_class = [np.asarray(classes == k, dtype=np.float64) for k in range(1, CLASSES)]
        return np.asarray(speed[:, None] * np.column_stack([share, *by_class]))
