"""Settings that the modules of the calibration from driving alone share, with unit and meaning.

They, and the constants of these modules, were chosen on intel, fr079 and aces, on whole logs and on parts of one located log
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
    window: int = 10
    """Number of steps whose residuals are summed. Stamp errors cancel from step to step; the sum depends on
    the wheels. Windows of 1 bias turn scales by 1 to 2 %; windows of 5 to 20 agree."""
    blocks: int = 8
    """Number of parts of a run that count as independent in the standard errors: slip and floors last for minutes."""
    least_side: int = 32
    """Minimum number of windows before and after a change during a run."""
    least_windows: int = 8
    """Number of windows above which their scatter gives the standard errors: two in each of the four blocks that these
    need. The noise of shorter drives is modelled (`short_drive`)."""
    scan_place: float = 0.003
    """[m] position error of a step that the scans do not show: wrong stamps, above all. Only for short drives."""
    shown_steps: float = 2.0
    """Number of steps of distance or turn; a quantity that less motion hides is hidden by the lack of it."""
    tail: float = 4.0
    """Degrees of freedom of Student's t for the residuals."""
    iterations: int = 8
    """Gauss-Newton steps."""
    settled: float = 0.02
    """Change of every parameter, in standard errors, below which these steps end."""
    heading_bias_sd: float = 0.1
    """[rad/m] prior standard deviation of the heading bias."""
    delay_sd: float = 0.3
    """[s] prior standard deviation of the delay between scans and odometry."""
    level: float = 0.05
    """Probability of a reported difference between two equal runs (over all parameters, Bonferroni)."""


CALIBRATION = DrivingCalibrationSettings()
