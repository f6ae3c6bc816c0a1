"""Measure the motion of the laser between scans from the scans alone.

The wheels contributed to the poses of a located run, so that these poses cannot test the wheels. Poses and
surfaces are therefore fitted again, starting from the located poses and without the wheels. The result
depends on the scans alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from logs.notes import ODOMETRY_LEFT_OUT, notes_of
from logs.run import Run, pair
from logs.transforms import compose, invert
from sensorgraph.errors import SensorgraphError
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of
from sensorgraph.localization.odometry_check import with_checked_odometry
from sensorgraph.localization.point_rows import FramePoints
from sensorgraph.localization.pose_graph import PoseEdges
from sensorgraph.localization.range_offset import with_right_ranges
from sensorgraph.localization.refinement import Refined, edge_system, refine
from sensorgraph.localization.scans import scan_points
from sensorgraph.localization.wheel_edges import WheelSteps
from sensorgraph.types import Bools, Floats, Ints, Progress, ProgressBars, no_progress

STEP_WAY = 0.4
"""[m] distance between two scans whose motion is measured, without turning."""
STEP_TURN = 0.25
"""[rad] turn between them, without driving."""
WINDOW = 10
"""Number of steps whose residuals are summed. Stamp errors cancel from step to step; the sum depends on
the wheels. Windows of 1 bias turn scales by 1 to 2 %; windows of 5 to 20 agree."""
BLOCKS = 8
"""Number of parts of a run that count as independent in the standard errors: slip and floors last for minutes. Steps of
runs with fewer windows are not summed."""
LONGEST_STEP = 3.0
"""Maximum length of a step, as a multiple of these; longer ones (scans without a pose, a jump of the
odometry) are omitted."""
SHORT_INTERVAL = 0.25
"""Share of the mean interval between scans; shorter intervals belong to a burst."""
MOST_BURSTS = 0.05
"""Share of short intervals, above which stamps record when a scan was written, not when it was taken."""
BURST_SCANS = 20
"""Number of scans before and after, over which such stamps are averaged: lasers scan at a constant rate."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LaserMotion:
    """Steps of the laser between scans, and the odometry at all scans."""

    first: Ints
    """(n_steps,) scan at which each step begins."""
    second: Ints
    """(n_steps,) scan at which it ends."""
    steps: Floats
    """(n_steps, 3) [m, m, rad] later pose of the laser in its earlier frame, from scans alone."""
    headings: Floats
    """(n_steps,) [rad] of base_link in map at the start of each step."""
    stamps: Floats
    """(n_scans,) [s] never decreasing, and smoothed if scans come in bursts."""
    odometry: Floats
    """(n_scans, 3) [m, m, rad] from the wheels."""
    mount: Floats
    """(3,) [m, m, rad] specified pose of the laser in base_link."""
    scatter: Floats | None = None
    """(n_steps, 3) [m², m², rad²] variance of ahead, left and turn of the steps, by the scans; None: not computed, for a
    long drive."""

    @cached_property
    def odometry_steps(self) -> Floats:
        """(n_scans - 1, 3) [m, m, rad] motion of the odometry from each scan to the next; turns are not wrapped."""
        moved = compose(invert(self.odometry[:-1]), self.odometry[1:])
        moved[:, 2] = np.diff(self.odometry[:, 2])
        return moved

    def part(self, chosen: slice) -> LaserMotion:
        """Return some of the steps, with the scans between them."""
        first, second = self.first[chosen], self.second[chosen]
        if len(first) == 0:
            scans = slice(0, 0)
        else:
            scans = slice(int(first[0]), int(second[-1]) + 1)
        return LaserMotion(
            first=first - scans.start,
            second=second - scans.start,
            steps=self.steps[chosen],
            headings=self.headings[chosen],
            stamps=self.stamps[scans],
            odometry=self.odometry[scans],
            mount=self.mount,
            scatter=None if self.scatter is None else self.scatter[chosen],
        )


def laser_motion(
    run: Run,
    located: Run,
    *,
    progress: ProgressBars = no_progress,
) -> LaserMotion:
    """Measure the motion of the laser from the scans alone.

    Parameters
    ----------
    run : As it was logged, with its odometry.
    located : The same run with the poses of `locate`, at which the fit starts, and with the ray times and the offset of the
        ranges that it shows.

    Raises
    ------
    SensorgraphError : The run has no odometry.
    """
    run, odometry = with_moving_odometry(run)
    run = with_right_ranges(replace(run, sensor=replace(located.sensor, mount=run.sensor.mount)), located)
    odometry[:, 2] = np.unwrap(odometry[:, 2])
    paired = pair(located)
    length = _lengths(odometry)
    keys = _keys(length, paired.paired)
    mount = np.asarray(run.sensor.mount, dtype=np.float64)
    poses, steps, scatter = paired.poses[keys], np.zeros((0, 3)), None
    if len(keys) > 1:
        with progress("measuring the motion from scans alone", "steps") as bar:
            found = _by_scans_alone(run, keys, poses, bar)
        poses = found.poses
        steps = compose(invert(poses[:-1]), poses[1:])
        if len(steps) < WINDOW * BLOCKS:
            scatter = step_scatter(found, steps, mount)
        there, back = np.broadcast_to(mount, steps.shape), np.broadcast_to(invert(mount), steps.shape)
        steps = compose(compose(back, steps), there)
    whole = np.diff(length[keys]) < LONGEST_STEP
    if scatter is not None:
        scatter = scatter[whole]
    return LaserMotion(
        first=keys[:-1][whole],
        second=keys[1:][whole],
        steps=steps[whole],
        headings=poses[:-1, 2][whole],
        stamps=_even_stamps(run.stamps),
        odometry=odometry,
        mount=mount,
        scatter=scatter,
    )


def with_moving_odometry(run: Run) -> tuple[Run, Floats]:
    """Return a run with checked odometry, and the odometry at each scan (n_scans, 3); reject a run without it.

    Odometry that never moves is that of a robot that stands.
    """
    run, notes = with_checked_odometry(run)
    motion = odometry_of(run)
    if motion is None:
        reasons = (*notes, *(note for note in notes_of(run) if note.endswith(ODOMETRY_LEFT_OUT)))
        if not reasons and len(run.odometry):
            return run, np.zeros((run.n_scans, 3))
        why = reasons[0] if reasons else "the run has no odometry"
        raise SensorgraphError(f"{why}; the calibration of wheels and mount needs a drive with odometry")
    return run, odometry_at_scans(run, motion)


def _even_stamps(stamps: Floats) -> Floats:
    """Return stamps (n,) that never decrease; moving averages if the log was written in bursts."""
    rising = np.maximum.accumulate(stamps)
    intervals = np.diff(rising)
    mean = float(np.ptp(rising)) / max(len(intervals), 1)
    if (intervals < SHORT_INTERVAL * mean).mean() > MOST_BURSTS:
        w = BURST_SCANS
        before, after = rising[0] - mean * np.arange(w, 0, -1), rising[-1] + mean * np.arange(1, w + 1)
        rising = np.convolve(
            np.concatenate([before, rising, after]), np.ones(2 * w + 1) / (2 * w + 1), "valid"
        )
    return np.asarray(rising + 1e-6 * np.arange(len(rising)))


def _lengths(odometry: Floats) -> Floats:
    """Return the accumulated distance and turn at each scan (n_scans,), in steps."""
    ways = np.hypot(*np.diff(odometry[:, :2], axis=0).T) / STEP_WAY
    turns = np.abs(np.diff(odometry[:, 2])) / STEP_TURN
    return np.concatenate([[0.0], np.cumsum(ways + turns)])


def _keys(length: Floats, usable: Bools) -> Ints:
    """Return the scans between which steps are measured: usable ones, at least a step apart."""
    keys: list[int] = []
    for k in np.flatnonzero(usable):
        if not keys or length[k] - length[keys[-1]] >= 1.0:
            keys.append(int(k))
    return np.array(keys, dtype=np.intp)


def _by_scans_alone(run: Run, keys: Ints, poses: Floats, progress: Progress) -> Refined:
    """Fit poses (n_keys, 3) and surfaces jointly, without wheels."""
    n = len(keys)
    first = np.arange(n - 1)
    relative = compose(invert(poses[:-1]), poses[1:])
    loose = np.broadcast_to(np.diag([1e4, 1e4, 1e6]), (n - 1, 3, 3)).copy()  # only speeds up the solver
    chain = PoseEdges(first=first, second=first + 1, relative=relative, information=loose)
    none = PoseEdges(
        first=first[:0], second=first[:0], relative=np.zeros((0, 3)), information=np.zeros((0, 3, 3))
    )
    untied = WheelSteps(first=first, steps=np.zeros((n - 1, 3)), has_odometry=False)
    frames = FramePoints.of(scan_points(run, odometry_of(run)), keys)
    return refine(frames, poses, untied, (chain, none), progress)


def step_scatter(found: Refined, steps: Floats, mount: Floats) -> Floats:
    """Return the variances (n, 3) [m², m², rad²] of ahead, left and turn of all n steps, in the laser frame.

        variance = diag(E H⁻¹ Eᵀ)

    H is the normal matrix of the poses, with the lines of the patches eliminated, and E the derivative of the steps.

    Parameters
    ----------
    steps : (n, 3) [m, m, rad] from key frame to key frame, in base_link.
    mount : (3,) [m, m, rad]
    """
    n, n_all = len(steps), 3 * found.system.n_frames
    inverse = np.linalg.inv(found.system.times(np.eye(n_all)) + 1e-9 * np.eye(n_all))
    first = np.arange(n)
    chain = PoseEdges(
        first=first, second=first + 1, relative=steps, information=np.tile(np.eye(3), (n, 1, 1))
    )
    rows = _at_laser(edge_system(found.poses, chain)[0].toarray().reshape(n, 3, -1), steps, mount)
    return np.asarray(np.einsum("nca,ab,ncb->nc", rows, inverse, rows, optimize=True))


def _at_laser(rows: Floats, steps: Floats, mount: Floats) -> Floats:
    """Convert derivatives (n, 3, k) of steps of base_link into those of the steps of the laser."""
    at = invert(mount[None])[0]
    cos, sin = np.cos(at[2]), np.sin(at[2])
    c, s = np.cos(steps[:, 2]), np.sin(steps[:, 2])
    lever = np.stack([-s * mount[0] - c * mount[1], c * mount[0] - s * mount[1]], axis=1)
    shift = rows[:, :2] + lever[:, :, None] * rows[:, 2:]
    turned = np.einsum("ij,njk->nik", np.array([[cos, -sin], [sin, cos]]), shift)
    return np.concatenate([turned, rows[:, 2:]], axis=1)
