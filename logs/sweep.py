"""Check the stated sweep of a laser: the time from the first to the last ray of a scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.run import RangeSensor, Run


@dataclass(frozen=True, kw_only=True)
class SweepLimits:
    """Limits for a plausible sweep; conventions, not fitted to data."""

    full_turn: float = 5.8
    """[rad] minimum span of the bearings of a spinning laser, whose sweep takes the whole scan period."""
    max_periods: float = 1.5
    """Maximum duration of a sweep in scan periods; above it, `time_increment` is wrong."""
    min_share: float = 0.05
    """Minimum share of the scan period that a sweep takes; a shorter one is not used to identify a unit."""
    max_difference: float = 0.05
    """Maximum relative difference between two durations of one sweep."""
    most_thinned: float = 10.5
    """Maximum number of sweeps per scan period for which the log may keep only every n-th scan."""


LIMITS = SweepLimits()


def differs(a: float, b: float) -> bool:
    """Return whether two durations [s] of one sweep disagree."""
    return abs(a - b) > LIMITS.max_difference * max(abs(a), abs(b))


def sweep_line(sensor: RangeSensor) -> str:
    """Describe the duration of a sweep in one line."""
    period = 1.0 / sensor.rate
    if not sensor.has_ray_delays:
        return f"no sweep: all rays have the stamp of the scan; a scan every {period:.3g} s"
    if sensor.interlaced_sweeps > 1:
        return (
            f"{sensor.interlaced_sweeps} interlaced sweeps of {sensor.sweep_time:.3g} s, {sensor.sweep_period:.3g} s apart; "
            f"a scan every {period:.3g} s"
        )
    step = 1e3 * sensor.sweep_time / sensor.n_rays
    return f"a sweep of {sensor.sweep_time:.3g} s (time_increment {step:.3g} ms), a scan every {period:.3g} s"


def sweep_warnings(run: Run) -> list[str]:
    """Return warnings where the `time_increment` of a driver contradicts `scan_time` or the scan rate.

    A laser with a field of view of a full turn spins, so its sweep takes the whole period between two scans. If an
    integer number of sweeps fits into the period, either a value is wrong by that factor, or the log keeps only every
    n-th scan. Logs that specify the sensor, such as those of `sensorgraph.record`, are not checked.
    """
    sensor = run.sensor
    if "scan_time" not in run.meta or run.n_scans < 2 or sensor.is_composite:
        return []
    if np.ptp(sensor.bearings) < LIMITS.full_turn:
        return []
    stated = float(run.meta["scan_time"])
    turn, source = (stated, "scan_time") if stated > 0 else (1.0 / sensor.rate, "the rate of the scans")
    if not differs(abs(sensor.sweep_time), turn):
        return []
    kept = turn / abs(sensor.sweep_time) if sensor.sweep_time else 0.0
    is_whole = 1.5 < kept < LIMITS.most_thinned and abs(kept - round(kept)) < LIMITS.max_difference
    unless = f"unless the log keeps one scan in {round(kept)}" if is_whole else "if the laser spins"
    return [
        f"the sweep takes {abs(sensor.sweep_time):.3g} s according to time_increment, but {turn:.3g} s according to "
        f"{source}; {unless}, set sensor.sweep_time: {turn:.3g} in a robot.yaml and pass it as `robot`"
    ]
