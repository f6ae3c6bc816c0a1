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
    """Number of windows above which their scatter gives the standard errors: two in each of the four blocks that these
    need. The noise of shorter drives is modelled (`short_drive`)."""
    scan_place: float = 0.003
    """[m] position error of a step that the scans do not show: wrong stamps, above all. Only for short drives."""
    scan_turn: float = 0.002
    """[rad] heading error of such a step."""
    usual_slip: float = 0.4
    """Usual slip of wheels, relative to the noise that localization expects of them (`WheelSettings`)."""
    noise_spread: float = 3.0
    """Factor by which the noise of wheels and scans may be larger or smaller than usual, as a standard deviation."""
    hidden_share: float = 0.5
    """Standard error, relative to the prior standard deviation, above which a drive does not show a quantity."""
    shown_steps: float = 2.0
    """Number of steps of distance or turn; a quantity that less motion hides is hidden by the lack of it."""
    tail: float = 4.0
    """Degrees of freedom of Student's t for the residuals."""
    iterations: int = 8
    """Gauss-Newton steps."""
    short_iterations: int = 30
    """Maximum number of steps of a short drive; outliers lose their weight slowly (EM)."""
    settled: float = 0.02
    """Change of every parameter, in standard errors, below which these steps end."""
    derivatives: int = 3
    """Number of initial steps in which the derivatives are updated."""
    scale_sd: float = 0.3
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
    centre_sd: float = 0.008
    """[m] variation of the point about which the base turns, between floors and ways of turning. It adds to the standard
    error of the mount's x of a short drive; long ones contain it. Pieces of fr079 and aces show 8 mm, those of intel
    less."""
    level: float = 0.05
    """Probability of a reported difference between two equal runs (over all parameters, Bonferroni)."""


CALIBRATION = DrivingCalibrationSettings()
