"""Settings of calibration: every tuned number of `models/calibration` with unit, meaning and source.

The modules use the instance `CALIBRATION`. Some settings are constants of compiled code: `planners.kernel` recompiles
after a change of their values.

The values were set on random offices, by the distance of the faces to the true readings of the laser. Perfect lasers
must remain as specified. Both results are printed by
    python -m benchmarks.uncalibrated_laser
    python -m benchmarks.office_graph
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class MatchSettings:
    """Matching of returns to faces (`matching`)."""

    min_cosine: float = 0.05
    """|n·u| below which a return is not used, since grazing incidence amplifies errors."""
    min_shift_cosine: float = 0.02
    """|n·u| below which a shift of the face does not change the range of a return."""
    min_probability: float = 0.5
    """Minimum probability that a return is from its face."""
    gate_sigmas: float = 4.0
    """Residual beyond which a return is not used, in standard deviations."""
    max_ray_bias: float = 0.3
    """[m] Largest bias of a ray: limit of the search for its face, and of a plausible constant."""
    min_range: float = 1e-3
    """[m] Lower limit of a corrected reading."""
    max_optic_range: float = 4.0
    """[m] Range beyond which the incidence terms are independent of the range."""


@dataclass(frozen=True, kw_only=True)
class AdjustmentSettings:
    """Joint least squares of mount, terms and faces (`normal_equations`), and limits of plausible results."""

    turn_arm: float = 1.0
    """[m] Lever arm that sets the prior of a face's turn relative to that of its shift."""
    max_turn: float = 0.05
    """[rad] Maximum turn of a face in one step."""
    ridge: float = 1e-9
    """Added to the unit diagonal of the scaled equations, for nearly collinear unknowns."""
    min_remaining: float = 1e-6
    """Minimum share of a term's information that is not explained by the selected terms."""
    penalty_rounds: int = 3
    """Number of selections; the penalty of a ray's term falls with the share of rays that have one."""
    max_mount_offset: float = 0.5
    """[m] Largest plausible offset of the mount."""
    max_mount_turn: float = 0.35
    """[rad] Largest plausible yaw offset of the mount."""
    max_slope: float = 0.1
    """[m/m] Largest plausible slope of a ray."""


@dataclass(frozen=True, kw_only=True)
class PoseSettings:
    """Refinement of the poses (`pose_refinement`)."""

    first_noise: tuple[float, float] = (0.005, 0.005)
    """[m, rad] Initial noise of the poses."""
    rounds: int = 30
    """Number of EM iterations."""
    sweep_rate: float = 15.0
    """[1/s] Corrections per second of a sweep; the error of a reference changes from one of its poses to the next."""
    max_noise: tuple[float, float] = (0.10, 0.10)
    """[m, rad] Pose noise above which the log is inconsistent (mirrored scan, other units) and is not refined."""


@dataclass(frozen=True, kw_only=True)
class GaugeSettings:
    """Common shift of the walls by occlusion edges (`gauge`)."""

    readings: int = 250_000
    """Maximum number of readings used in the search, in whole scans."""
    reaches: tuple[float, float] = (0.012, 0.003)
    """[m] Half width of the first and the second search."""
    passes: int = 3
    """EM iterations of the visibility for each shift."""
    min_step: float = 0.0008
    """[m] Step at which the search ends."""
    max_shift: float = 0.03
    """[m] Largest shift; a maximum there counts as not observable."""
    min_contrast: float = 30.0
    """[nats] Minimum drop of the log likelihood towards both ends of the search; binning alone causes a few."""


@dataclass(frozen=True, kw_only=True)
class CalibrationSettings:
    """All tuned numbers of calibration."""

    matches: MatchSettings = field(default_factory=MatchSettings)
    adjustment: AdjustmentSettings = field(default_factory=AdjustmentSettings)
    poses: PoseSettings = field(default_factory=PoseSettings)
    gauge: GaugeSettings = field(default_factory=GaugeSettings)
    probe_readings: int = 250_000
    """Readings (whole scans) of a first test; without any gain there, the full test is skipped."""
    coarse_sigmas: tuple[float, float] = (0.025, 0.015)
    """[m] Range noise assumed in the coarse rounds."""
    fine_sigma: float = 0.012
    """[m] Range noise assumed in the fine rounds."""
    min_gain: float = 20.0
    """[nats] Minimum gain of a calibration after complexity penalties."""
    min_gain_per_reading: float = 0.01
    """[nats] Minimum gain of ray terms per reading: a bias of 1/7 of the noise (rms), more than clutter imitates."""


CALIBRATION = CalibrationSettings()
"""The settings that the modules use."""
