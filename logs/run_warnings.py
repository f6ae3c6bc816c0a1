"""Warnings about a run: what its reader assumed or corrected, and values that look wrong."""

from __future__ import annotations

import numpy as np

from logs.alternating_scans import alternating_text
from logs.jumps import JUMP_LIMITS, find_jumps
from logs.notes import notes_of
from logs.range_limits import median_text
from logs.run import Run
from logs.sensor import usual_step
from logs.sweep import sweep_warnings
from logs.transforms import interpolate, wrap
from logs.types import ROUNDING

# thresholds above which a property is reported; conventions, not fitted to data
MIN_GAP_PERIODS = 5.0
"""A step is a gap if it exceeds this number of median steps ..."""
MIN_GAP = 0.5
"""[s] ... and also exceeds this duration."""
USUAL_PERIODS = (1e-3, 20.0)
"""[s] a scan period outside of this suggests stamps in another unit."""
MIN_FROZEN = 0.5
"""[m, rad] motion of the odometry while the pose keeps exactly its place, or its heading, above which the reference has
stopped."""


def warnings_of(run: Run) -> list[str]:
    """Return the warnings about a run, one line each."""
    out = notes_of(run)
    source = run.meta.get("pose_source", "")
    if source == "slam":
        out.append(
            "the poses were estimated from these scans, so they absorb errors of the mount and the clock"
        )
    if source == "locate":
        out.append(
            "the poses were located with these scans, so they absorb errors of the mount and the clock"
        )
    if source.startswith("odometry"):
        out.append(
            "the poses are odometry, which drifts and distorts a map; "
            "`sensorgraph locate` estimates better poses"
        )
    out += _stamp_warnings(run) + _pose_warnings(run) + sweep_warnings(run)
    finite = np.isfinite(run.ranges)
    out += filter(None, [median_text(run.ranges), alternating_text(run.ranges)])
    blind = np.flatnonzero(~finite.any(axis=0)) if run.n_scans else np.zeros(0, dtype=np.intp)
    if len(blind):
        out.append(f"{len(blind)} rays never return: {_spans(blind)}; check whether the sensor is obstructed")
    return out


def _stamp_warnings(run: Run) -> list[str]:
    out = []
    for name, stamps in (("scan", run.stamps), ("pose", run.pose_stamps), ("odom", run.odom_stamps)):
        steps = np.diff(stamps)
        if len(steps) < 2:
            continue
        period = usual_step(stamps, 1.0)
        low, high = USUAL_PERIODS
        if name == "scan" and not low <= period <= high:
            out.append(f"a scan every {period:.3g} s: check that the stamps are in seconds")
        same = int((steps == 0).sum())
        if same and "duplicates" not in run.meta.get("notes", ""):
            out.append(
                f"{same} {name} stamps are duplicates; check for two publishers, or a bag recorded during playback"
            )
        gaps = steps > max(MIN_GAP_PERIODS * float(np.median(steps)), MIN_GAP)
        if gaps.any():
            at = float(stamps[int(np.argmax(steps))])
            out.append(f"{name}: {int(gaps.sum())} gaps, the longest {steps.max():.2f} s at {at:.2f} s")
    return out


def _pose_warnings(run: Run) -> list[str]:
    poses, stamps = run.poses, run.pose_stamps
    out: list[str] = []
    if len(stamps) == 0 or run.n_scans == 0:
        return out
    if stamps[0] > run.stamps[-1] or stamps[-1] < run.stamps[0]:
        apart = max(stamps[0] - run.stamps[-1], run.stamps[0] - stamps[-1])
        out.append(f"poses and scans do not overlap in time, they are {apart:.1f} s apart; check the clocks")
    broken = int((~np.isfinite(poses)).any(axis=1).sum())
    if broken:
        out.append(f"{broken} poses are not finite")
    if len(stamps) > 1 and broken == 0:
        if np.ptp(poses, axis=0).max() < ROUNDING:
            out.append("the pose never changes; check that the robot moved and the reference was running")
        is_timed = run.meta.get("clock") != "assumed"
        if jumps := find_jumps(stamps, poses, least=JUMP_LIMITS.noise, is_timed=is_timed):
            out.append(
                f"the pose jumps {jumps.count} times, at most {jumps.farthest:.2f} m at {jumps.at:.2f} s"
            )
    return out + _frozen_warnings(run)


def _frozen_warnings(run: Run) -> list[str]:
    """Return warnings on poses that keep their place, or their heading, while the odometry moves."""
    if len(run.odom_stamps) < 2 or run.meta.get("pose_source", "").startswith("odometry"):
        return []
    known, measured = (np.isfinite(values).all(axis=1) for values in (run.poses, run.odometry))
    if known.sum() < 2 or measured.sum() < 2:
        return []
    stamps, poses = run.pose_stamps[known], run.poses[known]
    driven = interpolate(stamps, run.odom_stamps[measured], run.odometry[measured])
    ways, turns = np.hypot(*np.diff(driven[:, :2], axis=0).T), np.abs(wrap(np.diff(driven[:, 2])))
    steps, out = np.diff(poses, axis=0), []
    for what, still, moved, limit, unit in (
        ("place", (steps[:, :2] == 0).all(axis=1), ways, MIN_FROZEN, "m"),
        ("heading", steps[:, 2] == 0, turns, MIN_FROZEN, "rad"),
    ):
        edges = np.flatnonzero(np.diff(still.astype(np.int8), prepend=0, append=0))
        spans = [(moved[a:b].sum(), a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]
        most, first, last = max(spans, default=(0.0, 0, 0))
        if most > limit:
            length = stamps[last] - stamps[first]
            out.append(
                f"the {what} of the pose stays the same for {length:.1f} s from {stamps[first]:.1f} s while the odometry "
                f"moves by {most:.1f} {unit}: check that the reference was running"
            )
    return out


def _spans(numbers: np.ndarray) -> str:
    """Format 3, 4, 5, 9 as `3-5, 9`."""
    groups = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)
    shown = [f"{group[0]}-{group[-1]}" if len(group) > 1 else f"{group[0]}" for group in groups[:5]]
    return ", ".join(shown) + (", ..." if len(groups) > 5 else "")
