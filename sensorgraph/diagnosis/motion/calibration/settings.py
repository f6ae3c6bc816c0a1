"""Settings of the calibration from driving alone: every tuned number, with unit and meaning.

The defaults were chosen on intel, fr079 and aces, on whole logs and on parts of one located log
(`benchmarks.halves`). Afterwards, halves that were located separately were compared. No log of another robot
was used.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class DrivingCalibrationSettings:
    """How motions are divided, fitted and tested."""

    step_way: float = 0.4
    """[m] distance between two scans whose motion is measured, without turning."""
    step_turn: float = 0.25
    """[rad] turn between them, without driving."""
    longest_step: float = 3.0
    """Maximum length of a step, as a multiple of these; longer ones (scans without a pose, a jump of the
    odometry) are omitted."""
    window: int = 10
    """Number of steps whose residuals are summed. Stamp errors cancel from step to step; the sum depends on
    the wheels. Windows of 1 bias turn scales by 1 to 2 %; windows of 5 to 20 agree."""
    blocks: int = 8
    """Number of parts of a run that count as independent in the standard errors: slip and floors last for minutes."""
    least_block: int = 5
    """Minimum number of windows in a block. Shorter runs have fewer blocks, at least four, and larger
    standard errors."""
    least_side: int = 32
    """Minimum number of windows before and after a change during a run."""
    least_windows: int = 8
    """Minimum number of windows of a run: two in each of the four blocks that the standard errors need."""
    tail: float = 4.0
    """Degrees of freedom of Student's t for the residuals."""
    iterations: int = 8
    """Gauss-Newton steps."""
    derivatives: int = 3
    """Number of initial steps in which the derivatives are updated."""
    scale_sd: float = 0.1
    """Prior standard deviation of distance scale and turn scale."""
    heading_bias_sd: float = 0.1
    """[rad/m] prior standard deviation of the heading bias."""
    mount_sd: float = 0.3
    """[m, rad] prior standard deviation of the laser mount around its specified pose."""
    delay_sd: float = 0.3
    """[s] prior standard deviation of the delay between scans and odometry."""
    drift_sd: float = 0.02
    """[m/m] prior standard deviation of the drift with the floor (slope, nap of a carpet), in each direction."""
    short_interval: float = 0.25
    """Share of the mean interval between scans; shorter intervals belong to a burst."""
    most_bursts: float = 0.05
    """Share of short intervals, above which stamps record when a scan was written, not when it was taken."""
    burst_scans: int = 20
    """Number of scans before and after, over which such stamps are averaged: lasers scan at a constant rate."""
    sideways_sd: float = 0.0026
    """[rad] variation of the direction of travel between floors, beyond the scatter within a run. It adds to
    the standard error of the mount's yaw. The eighths of intel and aces show 0.15°, those of fr079 less."""
    level: float = 0.05
    """Probability of a reported difference between two equal runs (over all parameters, Bonferroni)."""


CALIBRATION = DrivingCalibrationSettings()
