"""What a log says of the laser's sweep: the time from a scan's first ray to its last, and whether it can be true."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.run import RangeSensor, Run


@dataclass(frozen=True, kw_only=True)
class SweepLimits:
    """When what a log says of the sweep is odd; conventions, none is fitted to data."""

    full_turn: float = 5.8
    """[rad] of bearings from which on a laser spins, so that a scan takes the time between two scans."""
    max_periods: float = 1.5
    """Times between scans that a sweep cannot be longer than: `time_increment` is wrong."""
    max_difference: float = 0.05
    """Share by which two statements of one sweep may differ."""
    most_thinned: float = 10.5
    """Times that a sweep fits into the time between scans, up to which the log may keep every so many-th scan."""


LIMITS = SweepLimits()


def differs(a: float, b: float) -> bool:
    """Tell whether two statements of the time [s] of a sweep disagree."""
    return abs(a - b) > LIMITS.max_difference * max(abs(a), abs(b))


def sweep_line(sensor: RangeSensor) -> str:
    """Say how long a sweep takes."""
    period = 1.0 / sensor.rate
    if not sensor.has_ray_delays:
        return f"no sweep: all rays of a scan at its stamp; a scan every {period:.3g} s"
    if sensor.interlaced_sweeps > 1:
        return (
            f"{sensor.interlaced_sweeps} interlaced sweeps of {sensor.sweep_time:.3g} s, {sensor.sweep_period:.3g} s apart; "
            f"a scan every {period:.3g} s"
        )
    step = 1e3 * sensor.sweep_time / sensor.n_rays
    return f"a sweep of {sensor.sweep_time:.3g} s (time_increment {step:.3g} ms), a scan every {period:.3g} s"


def sweep_warnings(run: Run) -> list[str]:
    """Return what is odd about the sweep that a driver stated: `time_increment` against `scan_time` and the rate.

    A laser that looks all around spins: from its first ray to its last it takes all of the time between two scans. Where a
    whole number of sweeps fits into that, either is wrong by a factor, or the log keeps every so many-th scan.
    Logs that state the sensor themselves, as those of `sensorgraph.record`, are taken at their word.
    """
    sensor = run.sensor
    if "scan_time" not in run.meta or run.n_scans < 2 or np.ptp(sensor.bearings) < LIMITS.full_turn:
        return []
    stated = float(run.meta["scan_time"])
    turn, source = (stated, "scan_time") if stated > 0 else (1.0 / sensor.rate, "the rate of the scans")
    if not differs(abs(sensor.sweep_time), turn):
        return []
    kept = turn / abs(sensor.sweep_time) if sensor.sweep_time else 0.0
    is_whole = 1.5 < kept < LIMITS.most_thinned and abs(kept - round(kept)) < LIMITS.max_difference
    unless = f"unless the log keeps one scan in {round(kept)}" if is_whole else "if the laser spins"
    return [
        f"time_increment says that a sweep takes {abs(sensor.sweep_time):.3g} s, {source} that a turn takes "
        f"{turn:.3g} s; {unless}, write sensor.sweep_time: {turn:.3g} into a robot.yaml and give it as `robot`"
    ]
