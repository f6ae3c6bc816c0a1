"""Every tuned number of the calibration from driving alone, with unit and meaning.

The defaults were chosen on intel, fr079 and aces, whole and as parts of one located log (`benchmarks.halves`). Their halves
located apart were compared after that choice, but a log of another robot has not been seen.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class DrivingCalibrationSettings:
    """How motions are cut, fitted and judged."""

    step_way: float = 0.4
    """[m] way between two scans whose motion is measured, if the robot does not turn."""
    step_turn: float = 0.25
    """[rad] turn between them, if it does not drive."""
    longest_step: float = 3.0
    """Times these: a longer step (scans that were not located, a jump of the odometry) is left out."""
    window: int = 10
    """Steps whose residuals are added up before they are judged: errors of the stamps cancel from step to step, and what is
    left hangs on the wheels. Windows of 1 shrink or stretch turn scales by 1 to 2 %, 5 to 20 agree."""
    blocks: int = 8
    """Parts of a run that count as independent in the standard errors: slip and floors last for minutes."""
    least_block: int = 5
    """Windows of a block: runs too short for that have fewer blocks, four at least, and wider errors."""
    least_side: int = 32
    """Windows before and after a change within a run."""
    least_windows: int = 8
    """Windows of a run, below which nothing can be said: the four blocks, of which standard errors are made, have two each."""
    tail: float = 4.0
    """Degrees of freedom of Student's t of the residuals."""
    iterations: int = 8
    """Gauss-Newton steps."""
    derivatives: int = 3
    """First of these at which derivatives are taken anew."""
    scale_sd: float = 0.1
    """Standard deviation of way and turn scale before any scan."""
    heading_bias_sd: float = 0.1
    """[rad/m] the same of the heading bias."""
    mount_sd: float = 0.3
    """[m, rad] of the laser's mount around what is stated."""
    delay_sd: float = 0.3
    """[s] of the delay between scans and odometry."""
    drift_sd: float = 0.02
    """[m/m] of the drift with the floor (slope, nap of a carpet), in each direction."""
    short_interval: float = 0.25
    """Of the mean interval of the scans: shorter ones come in a burst."""
    most_bursts: float = 0.05
    """Share of short intervals above which stamps say when a scan was written, not when it was taken."""
    burst_scans: int = 20
    """Scans before and after over which such stamps are averaged: lasers scan at an even rate."""
    sideways_sd: float = 0.0026
    """[rad] by which the direction of travel wanders from floor to floor, beyond the scatter within a run; it adds to the
    standard error of the mount's yaw. The eighths of intel and aces show 0.15°, those of fr079 less."""
    level: float = 0.05
    """Share of pairs of equal runs that may be told to differ (over all parameters, Bonferroni)."""


CALIBRATION = DrivingCalibrationSettings()
