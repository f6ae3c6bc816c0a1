"""Settings of the motion channels: every tuned number of `diagnosis/motion`, with its unit and meaning.

There are three frozen dataclasses:

- `OdometryChannelSettings`: odometry against reference poses,
- `DriveChannelSettings`: commands against odometry,
- `EvidenceSettings`: what a name requires in both.

`ODOMETRY`, `DRIVE` and `EVIDENCE` are the instances that the modules use. All numbers are in this one table.

Unless a field says otherwise, its value was set on the development cases of the hidden-effects benchmark:

    python -m benchmarks.hidden_effects generate --world own --suite SUITE --n N -o DIR
    python -m benchmarks.hidden_effects answer DIR

SUITE is one of singles, none, pairs, triples and foreign.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from sensorgraph.diagnosis.scan.settings import SCAN


@dataclass(frozen=True, kw_only=True)
class EvidenceSettings:
    """Evidence that a name requires; the same in both motion channels as in the scan channel."""

    price: float = SCAN.selection.price
    """[nats] complexity penalty of each parameter of an effect."""
    threshold: float = SCAN.selection.threshold
    """[nats] evidence, after the complexity penalty, that a name needs."""
    max_tolerances: float = SCAN.nuisance.max_tolerances
    """Bound of a nuisance, in tolerances; a larger error must be an effect."""
    lead_over_unknown: float = 3.0
    """Ratio of the evidence of an effect to that of a difference that no effect explains, above which it keeps its name.
    Evidence grows with the square of a size."""
    temperature: float = 4.0
    """Divisor of the evidence before it becomes a probability, since models are wrong in more ways than noise."""
    huber_limit: float = 3.0
    """Limit of Huber's loss, in standard deviations."""
    clip_limit: float = 4.0
    """Robust standard deviations at which a residual is clipped before its autocovariance is estimated."""
    cluster: float = 2.0
    """[s] within which errors may be correlated, beyond the whitening filter; over longer times, the reference is
    more accurate than the wheels."""
    held_out_block: float = 5.0
    """[s] duration of the blocks that are held out for the gap."""
    observable_size: float = 3.0
    """Size of an effect that should be observable, in materialities."""
    reckoning_time: float = 60.0
    """[s] duration of dead reckoning, after which the error of a simulation is evaluated."""
    min_drift: float = 0.05
    """[m] position error after that time, above which it matters to a user. For a robot at 0.4 m/s;
    proportional to its speed."""
    min_speed_error: float = 0.005
    """[m/s] speed error of the wheels, above which it matters to a user; also proportional to the speed."""
    reference_speed: float = 0.4
    """[m/s] speed of the robot for which these limits hold."""
    min_place_error: float = 0.005
    """[m] distortion of the reference positions over the place, above which it matters to a user."""
    min_yaw_error: float = 0.005
    """[rad] distortion of the reference headings, above which it matters to a user."""
    n_pieces: int = 6
    """Number of pieces of the run in which scales, gains or delays may differ."""
    n_jumps: int = 15
    """Number of moments that are tried first for a single change."""
    scale_sigma: float = 0.1
    """Prior standard deviation of a coefficient of structure, unless its family says otherwise: of a scale, a gain, an
    angle [rad], a speed [m/s], a turn rate [rad/s], a clock offset [s], or a jump [m, rad]."""
    max_gap: float = 0.35
    """[s] maximum gap in poses, odometry or commands, across which motion is compared."""
    clock_tolerance_share: float = 0.6
    """Standard deviation of a clock offset that needs no effect, as a share of the tolerance of one stamp."""
    clock_tolerance_range: tuple[float, float] = (0.0015, 0.0035)
    """[s] minimum and maximum of that standard deviation."""


@dataclass(frozen=True, kw_only=True)
class RowSettings:
    """Averaging of the reference poses, and their comparison with the wheels (`wheels/rows`)."""

    averaging_time: float = 0.1
    """[s] over which reference poses are averaged."""
    min_rows: int = 60
    """Minimum number of rows, and of reference poses; with fewer, the channel is skipped."""
    min_travel: float = 0.02
    """[m] minimum extent of the reference along one axis, unless it turns by `min_rotation`; otherwise it
    does not move."""
    min_rotation: float = 0.05
    """[rad] minimum rotation of the reference."""
    min_overlap: float = 0.9
    """Share of the run during which poses and odometry overlap, below which a note reports it."""
    max_clock: float = 0.8
    """[s] maximum clock offset of the search."""
    clock_step: float = 0.025
    """[s] step of the search."""
    clock_half_window: float = 0.1
    """[s] half the window over which rates are compared."""
    min_clock_overlap: float = 5.0
    """[s] minimum overlap for the search; otherwise it starts at a clock offset of 0."""
    clock_resolution: float = 2e-4
    """[s] step of the clock offset, below which it has converged."""
    heading_window: float = 1.0
    """[s] averaging time of the offset between the headings of reference and wheels."""


@dataclass(frozen=True, kw_only=True)
class LimitedNoiseSettings:
    """Limits of the noise model in tests for structure (`reference_noise`)."""

    max_walk: float = 3.0
    """Maximum density of the wheels' random walk, as a multiple of that in robot.yaml."""
    max_wander: float = 4.0
    """Maximum slow part of the reference noise, as a multiple of the standard deviation in robot.yaml."""
    max_memory: float = 1.0
    """[s] maximum memory of the reference noise."""


@dataclass(frozen=True, kw_only=True)
class OdometryStructureSettings:
    """Structure in odometry against reference poses that no effect explains.

    Used by `wheels/structure`, `wheels/each_wheel`, `wheels/reference_structure` and `wheels/selection`.
    """

    n_nearer_jumps: int = 5
    """Number of moments on each side of the best one that are tried next, and again around the best of these."""
    n_while: int = 9
    """Number of moments between which a temporary change may lie."""
    n_clock_pieces: tuple[int, ...] = (5, 20)
    """Numbers of pieces of the run with separate clock offsets; tried one after the other."""
    tight_turns: tuple[float, ...] = (0.3, 1.0, 3.0)
    """Distance from the middle of the axle to the centre of rotation, in half wheelbases, below which a turn
    is tight."""
    speed_cuts: tuple[float, ...] = (0.12, 0.22, 0.32)
    """[m/s] limits between speeds, for a robot at 0.4 m/s; proportional for a faster one."""
    rate_cuts: tuple[float, ...] = (0.25, 0.5, 0.75)
    """[rad/s] limits between turn rates, for a robot at 1 rad/s; proportional for a faster one."""
    acceleration_quantile: float = 0.85
    """Quantile of the accelerations of a run, above which the robot accelerates."""
    spinning_quantiles: tuple[float, ...] = (0.5, 0.7, 0.8, 0.9, 0.95)
    """Quantiles of the accelerations of the wheels, above which they may spin."""
    cell: float = 1.0
    """[m] cell size of the raster of places."""
    max_cells: int = 24
    """Maximum number of cells: those with the longest path."""
    min_cell_travel: float = 0.3
    """[m] minimum path in a cell."""
    min_extent: float = 1.5
    """[m] minimum extent of a run for a reference that is distorted over the place; a camera is not distorted
    within less."""
    radius_factors: tuple[float, ...] = (0.97, 0.98, 0.99, 1.0, 1.01, 1.02, 1.03)
    """Factors of the wheel radius in robot.yaml, for the count of turns; 1 % of 60 m is one turn."""
    max_askew: float = 0.035
    """[rad] maximum misalignment of the heading of a reference that counts as setup: 2°."""
    even_part: float = 0.5
    """Share of the contribution of a whole-run effect, above which structure takes its name."""
    n_reference_jumps: tuple[int, ...] = (1, 2, 4, 8, 16)
    """Numbers of jumps of the reference that are tried, each within a tenth of a second."""
    yaw_sigma: float = 0.02
    """[rad] prior standard deviation of each wave of a distorted heading."""
    threshold: float = 20.0
    """[nats] evidence that structure needs if the residual is white; proportionally more otherwise."""
    patch_share: float = 0.1
    """Share of the evidence of a patch, below which structure only reflects its rim: no patch is a sharp disc."""


@dataclass(frozen=True, kw_only=True)
class PatchSettings:
    """The search for slippery patches (`wheels/patch_search`)."""

    max_patches: int = 3
    """Maximum number of patches in one run."""
    min_moving: float = 1e-3
    """[m] minimum length of an increment that moves."""
    min_positions: int = 20
    """Minimum number of increments that move; with fewer, no patch is searched."""
    cell: float = 0.15
    """[m] distance between the centres that are tried."""
    max_centres: int = 250
    """Maximum number of centres; of more, every second or third is tried."""
    radii: tuple[float, ...] = (0.2, 0.3, 0.42, 0.56, 0.72, 0.92, 1.2, 1.6, 2.1)
    """[m] radii that are tried."""
    rounds: int = 7
    """Number of rounds of the importance sampler."""
    n_samples: int = 100
    """Number of discs of a round."""
    radius_range: tuple[float, float] = (0.1, 2.5)
    """[m] smallest and largest radius."""
    rim: float = 0.02
    """[m] width of the edge of a patch: about the length of an increment."""
    min_information: float = 400.0
    """[1] minimum inverse variance of the lost share, for 5 % standard error; with less, the robot hardly
    crossed the disc."""
    max_slip: float = 0.95
    """Maximum share of the motion that a patch loses."""
    min_place_error: float = 0.02
    """[m] minimum standard error of a patch's place."""


@dataclass(frozen=True, kw_only=True)
class OdometryChannelSettings:
    """All tuned numbers of the odometry channel."""

    rows: RowSettings = field(default_factory=RowSettings)
    noise: LimitedNoiseSettings = field(default_factory=LimitedNoiseSettings)
    structure: OdometryStructureSettings = field(default_factory=OdometryStructureSettings)
    patch: PatchSettings = field(default_factory=PatchSettings)
    filter_order: int = 24
    """Order of the whitening filters."""
    marker_sigma: float = 0.003
    """[m] standard deviation of the distance between the axle and the base_link of the reference."""
    max_effects: int = 7
    """Maximum number of steps of the forward selection."""
    min_clock_shift: float = 3e-4
    """[s] minimum change of the clock offset for which the rows are computed again."""
    max_clock_shift: float = 0.02
    """[s] maximum change of the clock offset at that time."""
    stamp_averaging: float = 8.0
    """Ratio of the tolerance of one stamp to the error of the mean over a run."""
    min_distance: float = 1.0
    """[m] minimum path for a slip to be observable."""


@dataclass(frozen=True, kw_only=True)
class DriveStructureSettings:
    """Structure in commands against odometry that no effect explains (`motors/structure`)."""

    speed_cuts: tuple[float, ...] = (0.25, 0.5)
    """Shares of the maximum speed, below which the gain may differ."""
    rate_cuts: tuple[float, ...] = (0.12, 0.2, 0.35, 0.6)
    """Shares of the maximum turn rate, below which the gain may differ."""
    asked_share: float = 0.15
    """Share of the maximum speed, above which the base is commanded to move."""
    stop_time: float = 0.25
    """[s] minimum duration of such a stop: longer than a base waits for the next tick of its control loop."""
    answer_lags: tuple[float, ...] = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
    """[s] delays after the response to a command, at which a second response may follow."""
    answer_sigma: float = 0.3
    """Prior standard deviation of the second response."""
    delay_sigma: float = 0.05
    """[s] prior standard deviation of a lag that differs."""
    ramps: tuple[float, ...] = (0.03, 0.05, 0.09, 0.15, 0.25, 0.35, 0.5, 0.7)
    """Shares of the acceleration in robot.yaml that a base may really have."""


@dataclass(frozen=True, kw_only=True)
class MotorFitSettings:
    """Gauss-Newton method for the simulated motors (`motors/model`)."""

    max_steps: int = 6
    quotient: float = 0.004
    """[s or m/s] step of the difference quotients."""
    max_step: float = 0.1
    """[s or m/s] maximum step of time constant, dead time and maximum speed."""
    tau_range: tuple[float, float] = (1e-3, 3.0)
    """[s] minimum and maximum time constant."""
    min_v_max: float = 0.02
    """[m/s] lower limit of the maximum speed."""
    converged: float = 1e-3
    """[s or m/s] step below which the fit has converged."""


@dataclass(frozen=True, kw_only=True)
class DriveChannelSettings:
    """All tuned numbers of the drive channel."""

    structure: DriveStructureSettings = field(default_factory=DriveStructureSettings)
    fit: MotorFitSettings = field(default_factory=MotorFitSettings)
    step: float = 0.01
    """[s] step of the simulated motors."""
    control_step: float = 0.003
    """[s] error of a dead time due to the step of the controller."""
    filter_order: int = 4
    """Order of the whitening filters."""
    gain_sigma: float = 0.03
    """Tolerance of the gain from command to odometry."""
    lag_sigma: float = 0.004
    """[s] tolerance of the time constant."""
    turn_sigma: float = 0.008
    """Tolerance of the turn in proportion to speed, multiplied by the wheelbase."""
    min_rows: int = 100
    """Minimum number of rows; with fewer, the channel is skipped."""
    min_commands: int = 20
    """Minimum number of commands; with fewer, the channel is skipped."""
    settling_time: float = 0.3
    """[s] after the first command that is not compared, because earlier commands are unknown."""
    min_clock_offset: float = 0.004
    """[s] minimum offset between the clocks of odometry and reference that is corrected."""
    max_clock_error: float = 0.01
    """[s] upper limit of the standard error of that offset."""
    second_lag: float = 0.03
    """[s] second lag in series with the first, as in real motors; at most half of their sum."""
    second_lag_sigma: float = 0.4
    """Prior standard deviation of the share of this lag that is present."""
    beat_time: float = 5.0
    """[s] over which the control loop of the base and the stamps of the commands keep their phase."""
    max_beats: int = 24
    """Maximum number of pieces of the run with separate delays; in a longer run they are longer."""
    min_top_speed: float = 0.05
    """[m/s] minimum largest command, for a saturation to be tested."""
    min_saturation: float = 0.02
    """[m/s] minimum difference between the largest command and the motors, for a saturation to be material."""
    full_speed_share: float = 0.9
    """Share of the robot's limit that commands must reach for a saturation to be observable."""
    max_effects: int = 4
    """Maximum number of steps of the forward selection."""


EVIDENCE = EvidenceSettings()
"""The settings of both channels."""
ODOMETRY = OdometryChannelSettings()
"""The settings of the odometry channel."""
DRIVE = DriveChannelSettings()
"""The settings of the drive channel."""
