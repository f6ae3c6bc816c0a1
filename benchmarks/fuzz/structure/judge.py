"""Read a log with `inspect` and `locate`, and hold what they say against the truth."""

from __future__ import annotations

import contextlib
import io
import re
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

import logs
from benchmarks.fuzz.judge import judge
from benchmarks.fuzz.structure.draft import EPOCH, Draft, compose, inverse, ray_times
from benchmarks.fuzz.structure.drives import Floats
from logs.ros.recording import parse_topics
from logs.run import RangeSensor, Run
from logs.run_warnings import warnings_of
from sensorgraph.cli.inputs import read_options
from sensorgraph.cli.inspect import inspect
from sensorgraph.intake import log_notes
from sensorgraph.localization.locate import deviations, located_run, poses_csv, summary, summary_lines
from sensorgraph.localization.locate import locate as locate_run
from sensorgraph.localization.result import Localization

SECONDS = 60.0
"""[s] of CPU time for each command; a locate takes one or two."""
SILENT_XY, SILENT_YAW = 0.05, np.radians(2.0)
"""[m, rad] beyond three stated standard deviations."""
USED_SHARE = 0.5
"""Share of the scans that must be located for a log to count as used."""
MIN_JUDGED = 5
"""Poses with status ok from which an alignment is possible."""
FIRST_RAY = 2e-3
"""[s] to which a stamp is that of the first ray."""
LEFT = "they were left as they are"
"""A stated difference of clocks that is not corrected, so that the poses have it too."""
ALIGNED = 0.02
"""[m, rad] Error beyond its stated deviation from which a pose counts less in the alignment."""
STEADY = 0.02
"""[s] to which the stamps of a clock at another rate lie on a line; also the least difference of a rate."""
MATCH = 1e-4
"""[s] to which an unchanged stamp is found again."""


@dataclass
class Outcome:
    """What became of one log."""

    kind: str
    seed: int
    container: str = ""
    usable: bool = True
    inspect: str = ""
    """ok, refused, or what is wrong."""
    locate: str = ""
    refusal: str = ""
    """The line with which a log was refused."""
    ok: float = 0.0
    """Share of the scans that are located."""
    missing: list[str] = field(default_factory=list)
    """Roles that the log has and the reader did not find."""
    is_said: bool = True
    """Whether what must be said was said."""
    error_xy: float = 0.0
    """[m] largest error of a pose with status ok."""
    error_yaw: float = 0.0
    """[rad]"""
    beyond_xy: float = 0.0
    """[m] largest error beyond three stated standard deviations."""
    beyond_yaw: float = 0.0
    n_silent: int = 0
    """Poses with status ok that are wrong beyond what is stated."""
    covered: float = np.nan
    """Share of x, y, yaw of the poses within 1.96 stated standard deviations."""
    notes: list[str] = field(default_factory=list)
    seconds: float = 0.0
    """[s] of CPU time of both commands."""

    @property
    def is_crash(self) -> bool:
        """Whether a command ended otherwise than with a result or one line."""
        return any(word not in ("ok", "refused") for word in (self.inspect, self.locate))

    @property
    def is_silent(self) -> bool:
        """Whether a pose is wrong and nothing says so."""
        return self.n_silent > 0

    @property
    def is_used(self) -> bool:
        """Whether `locate` located the run."""
        return self.locate == "ok" and self.ok >= USED_SHARE


def look(draft: Draft, path: Path, kind: str, seed: int) -> Outcome:
    """Run both commands on a written log and judge them."""
    out = Outcome(kind=kind, seed=seed, container=draft.container, usable=draft.usable)
    options = dict(zip(draft.options[::2], draft.options[1::2], strict=True))
    topics = [draft.options[i + 1] for i, word in enumerate(draft.options) if word == "--topic"]
    heights = options.get("--slice")
    said = io.StringIO()

    def inspected() -> None:
        with contextlib.redirect_stdout(said):
            inspect(path, topic=topics or None, heights=heights)

    run: Run | None = None
    found: Localization | None = None

    def located() -> None:
        nonlocal run, found
        run = logs.read(path, **read_options(topics or None, None, None, heights))
        found = locate_run(run)
        if "ok" in found.status:
            located_run(run, found)
        out.notes = [*log_notes(run), *summary_lines(found), *found.notes]
        poses_csv(found)
        summary(found)
        warnings_of(run)

    began = time.process_time()
    parse_topics(topics)
    first, second = judge(inspected, SECONDS), judge(located, SECONDS)
    out.inspect, out.locate, out.refusal = first.word, second.word, second.refusal or first.refusal
    out.seconds = time.process_time() - began
    spoken = "\n".join([said.getvalue(), *out.notes, out.refusal])
    out.is_said = bool(re.search(draft.said, spoken)) if draft.said else True
    if run is not None:
        there = {"odom": len(run.odom_stamps), "pose": len(run.pose_stamps), "cmd": len(run.cmd_stamps)}
        out.missing = sorted(role for role in draft.expects if not there[role])
        if "pose" in draft.expects and run.meta.get("pose_source", "").startswith("odometry"):
            out.missing.append("pose")
    if found is not None and run is not None:
        ok = np.array(found.status) == "ok"
        out.ok = float(ok.mean())
        _compare(out, draft, run, found, ok, locate_said="\n".join(out.notes))
    return out


def _compare(
    out: Outcome, draft: Draft, run: Run, found: Localization, ok: NDArrayBool, *, locate_said: str
) -> None:
    """Hold the poses with status ok against the truth, after alignment."""
    if run.sensor.is_composite or draft.is_stream:  # its stamps are not those of single messages
        used, when = ok, run.stamps[ok] + (run.epoch_ns / 1e9 - EPOCH)
    else:
        scan = scans_of(draft, run)
        used = ok & (scan >= 0)
        when = pose_times(draft, run, found.sensor or run.sensor, scan[used], used)
        when += stated_lag(locate_said) * (when == run.stamps[used] + (run.epoch_ns / 1e9 - EPOCH))
    if used.sum() < MIN_JUDGED:
        return
    poses, sigma = found.poses[used], deviations(found)[used]
    gauges = set(draft.gauges)
    wrong = errors_of(draft, when, poses, gauges, sigma)
    length = np.hypot(wrong[:, 0], wrong[:, 1])
    toward = np.where(length[:, None] > 0, wrong[:, :2] / np.maximum(length, 1e-12)[:, None], 0.0)
    stated = np.sqrt(np.square(toward * sigma[:, :2]).sum(axis=1))
    beyond, beyond_yaw = length - 3 * stated, np.abs(wrong[:, 2]) - 3 * sigma[:, 2]
    out.error_xy, out.error_yaw = float(length.max()), float(np.abs(wrong[:, 2]).max())
    out.beyond_xy, out.beyond_yaw = float(beyond.max()), float(beyond_yaw.max())
    out.covered = float((np.abs(wrong) <= 1.96 * sigma).mean())
    is_said = bool(draft.said) and bool(re.search(draft.said, locate_said))
    is_excused = is_said and (not draft.usable or LEFT in locate_said)
    if not is_excused:
        out.n_silent = int(((beyond > SILENT_XY) | (beyond_yaw > SILENT_YAW)).sum())


NDArrayBool = Any


def scans_of(draft: Draft, run: Run) -> Any:
    """Return the number (n_scans,) of each scan of a run; -1: unknown.

    A scan is recognised by the number in its intensities, by its stamp, by its true time, or by its order if none is
    missing.
    """
    if run.intensities.size:
        middle = np.median(run.intensities, axis=1)
        if np.isfinite(middle).all() and set(np.floor(middle)) <= set(draft.true_times):
            return np.floor(middle).astype(int)
    items = draft.scans
    stamps = run.stamps + (run.epoch_ns / 1e9 - EPOCH)
    written = np.array([item.stamp for item in items])
    true_times = np.array(list(draft.true_times.values()))
    for times, numbers in ((written, [item.scan for item in items]), (true_times, list(draft.true_times))):
        order = np.argsort(times)
        at = np.clip(np.searchsorted(times[order], stamps - MATCH), 0, len(order) - 1)
        if len(np.unique(times)) == len(times) and (np.abs(times[order][at] - stamps) < MATCH).all():
            return np.array(numbers)[order][at]
    true = np.array(sorted({item.scan for item in items}, key=lambda k: draft.true_times[k]))
    if len(true) == len(stamps):
        return true
    return np.full(len(stamps), -1)


def pose_times(draft: Draft, run: Run, sensor: RangeSensor, scans: Any, used: NDArrayBool) -> Floats:
    """Return the true times (n_used,) [s] of the used poses of a run.

    A scan that is stamped with the time of its first ray, as ROS defines it, has its pose at its stamp, whatever is
    believed of its rays. Of any other stamp only the scan is known (`stamp_times`).
    """
    when = stamp_times(draft, sensor, scans, run.stamps[used])
    stamps = run.stamps[used] + (run.epoch_ns / 1e9 - EPOCH)
    written = {item.scan: item.stamp for item in draft.scans}
    for i, (k, stamp) in enumerate(zip(scans, stamps, strict=True)):
        if abs(written.get(k, np.nan) - stamp) < FIRST_RAY and abs(draft.true_times[k] - stamp) < FIRST_RAY:
            when[i] = stamp
    return when


def stated_lag(said: str) -> float:
    """Return the lag [s] of the scans behind their stamps that `locate` states and leaves in the poses; 0: none."""
    found = re.search(
        r"lag of the scans relative to the odometry: ([-+][0-9.]+) ± [0-9.]+ ms; poses are given at the stamps",
        said,
    )
    return 0.0 if found is None else float(found.group(1)) / 1e3


def stamp_times(draft: Draft, sensor: RangeSensor, scans: Any, stamps: Floats) -> Floats:
    """Return the true times (n_scans,) [s] to which the poses of scans belong: those of their stamps.

    The sensor states the time of each ray after the stamp, and the laser knows the true one; the mean difference is the
    time of the stamp. So a pose is right if it is that of its scan, whatever clock stamped the scan. The sensor's times are on
    the clock of the stamps (n_scans,) [s], which may be that of the wheels, at another rate.
    """
    yaw = sensor.mount[2] if sensor.mount.any() else np.radians(draft.laser.yaw)
    directions = sensor.bearings + yaw
    if not len(scans):
        return np.zeros(0)
    taken = np.array([ray_times(draft, k, directions).mean() for k in scans])
    rate, first = np.polyfit(taken, stamps, 1) if len(scans) > 2 else (1.0, 0.0)
    if np.abs(first + rate * taken - stamps).max() > STEADY or abs(rate - 1) < STEADY:
        rate = 1.0  # the stamps are not those of a steady clock at another rate
    return np.asarray(taken - sensor.ray_delays.mean() / rate)


def errors_of(draft: Draft, when: Floats, poses: Floats, gauges: set[str], sigma: Floats) -> Floats:
    """Return the errors (n, 3) [m, m, rad] of poses after the alignment of what a log cannot show.

    The map is free, and so is, by `gauges`, the mount of the laser. Poses of large stated deviation `sigma` (n, 3) count
    less.
    """
    free = ["x", "y", "phi"]
    free += ["bx", "by"] if "lever" in gauges else []
    free += ["bphi"] if "yaw" in gauges else []
    truth = draft.drive.pose_at(when)

    def expected(values: Floats) -> Floats:
        v = dict(zip(free, values, strict=True))
        mounted = np.array([v.get("bx", 0.0), v.get("by", 0.0), v.get("bphi", 0.0)])
        return compose(np.array([v["x"], v["y"], v["phi"]]), compose(truth, mounted))

    def difference(values: Floats) -> Floats:
        e = poses - expected(values)
        e[:, 2] = np.pi - (np.pi - e[:, 2]) % (2 * np.pi)
        return e

    scale = np.hypot(ALIGNED, sigma)
    best: Any = None
    turns = (0.0, np.pi, np.pi / 2, -np.pi / 2) if "yaw" in gauges else (0.0,)
    for turn in turns:
        k = len(poses) // 2
        start = np.zeros(len(free))
        if "yaw" in gauges:
            start[free.index("bphi")] = turn
        start[:3] = compose(poses[k], inverse(compose(truth[k], np.array([0.0, 0.0, turn]))))
        fit = least_squares(lambda v: (difference(v) / scale).ravel(), start, loss="soft_l1", x_scale="jac")
        best = fit if best is None or fit.cost < best.cost else best
    return difference(best.x)
