"""Settings of calibration: every tuned number of `models/calibration` with its unit, its meaning and what set it.

`CALIBRATION` is the instance that the modules use. Some are constants of compiled code: `planners.kernel` compiles anew
after a change of any file that names it, as this one.

Numbers were set on random offices, by how near the faces come to the laser's true readings, and by perfect lasers that
must stay as stated, as printed by

    python -m benchmarks.uncalibrated_laser
    python -m benchmarks.office_graph
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class MatchSettings:
    """Which return is of which face (`matching`)."""

    min_cosine: float = 0.05
    """|n·u| below which a return is all leverage."""
    min_shift_cosine: float = 0.02
    """|n·u| below which a shift of the faces is not carried over to a return."""
    min_probability: float = 0.5
    """Chance that a return comes from this face."""
    gate_sigmas: float = 4.0
    """Standard deviations off, beyond which it does not."""
    max_ray_bias: float = 0.3
    """[m] that readings may be off before anything is known of them; larger constants are not plausible."""
    min_range: float = 1e-3
    """[m] of a corrected reading."""
    max_optic_range: float = 4.0
    """[m] beyond which the incidence terms depend on the range no more."""


@dataclass(frozen=True, kw_only=True)
class AdjustmentSettings:
    """Mount, terms and faces in one least squares (`normal_equations`), and what is plausible of them."""

    turn_arm: float = 1.0
    """[m] a face's turn moves it by that much less than a shift, at the prior."""
    max_turn: float = 0.05
    """[rad] of a face in one step."""
    ridge: float = 1e-9
    """Of a unit diagonal: for unknowns that nearly say the same."""
    min_rest: float = 1e-6
    """Share of a term's information that the others must leave for it to be selected."""
    price_rounds: int = 3
    """Selections in turn: the price of a ray's term falls with the share of rays that have one."""
    max_mount_offset: float = 0.5
    """[m] off the stated mount, beyond which a calibration is not plausible."""
    max_mount_turn: float = 0.35
    """[rad]"""
    max_slope: float = 0.1
    """Metres a metre of range."""


@dataclass(frozen=True, kw_only=True)
class PoseSettings:
    """Refined poses (`pose_refinement`)."""

    first_noise: tuple[float, float] = (0.005, 0.005)
    """[m, rad] noise of the poses to begin with."""
    rounds: int = 30
    """Of EM."""
    sweep_rate: float = 15.0
    """[1/s] corrections in a second of a sweep: the noise of a reference changes from one of its poses to the next."""
    max_noise: tuple[float, float] = (0.10, 0.10)
    """[m, rad] beyond it the log is broken (mirrored, other units) and no small step mends it."""


@dataclass(frozen=True, kw_only=True)
class GaugeSettings:
    """The walls' common shift by occlusion edges (`gauge`)."""

    readings: int = 250_000
    """Of whole scans, that it is searched on."""
    reaches: tuple[float, float] = (0.012, 0.003)
    """[m] of the first search, and of the second."""
    passes: int = 3
    """Of EM on visibility alone."""
    min_step: float = 0.0008
    """[m] step at which the search ends."""
    max_shift: float = 0.03
    """[m] that it may go."""
    min_contrast: float = 30.0
    """[nats] that the best must stand above both sides; bins alone make a few."""


@dataclass(frozen=True, kw_only=True)
class CalibrationSettings:
    """All tuned numbers of calibration."""

    matches: MatchSettings = field(default_factory=MatchSettings)
    adjustment: AdjustmentSettings = field(default_factory=AdjustmentSettings)
    poses: PoseSettings = field(default_factory=PoseSettings)
    gauge: GaugeSettings = field(default_factory=GaugeSettings)
    probe_readings: int = 250_000
    """Readings of whole scans in which a calibration that is worth its price in all shows, if only faintly."""
    coarse_sigmas: tuple[float, float] = (0.025, 0.015)
    """[m] what returns may be off by in the first rounds."""
    fine_sigma: float = 0.012
    """[m] what they may be off by afterwards."""
    min_gain: float = 20.0
    """[nats] that calibration must be worth beyond the price of its terms."""
    min_gain_per_reading: float = 0.01
    """[nats] a reading that ray terms must be worth: a seventh of the noise, rms; clutter feigns less than that."""


CALIBRATION = CalibrationSettings()
"""The settings of calibration."""
