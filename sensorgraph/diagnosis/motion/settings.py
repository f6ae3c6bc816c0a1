"""Settings of the motion channels: every tuned number of `diagnosis/motion` with its unit, its meaning and what set it.

Three frozen dataclasses: `OdometryChannelSettings` (odometry against reference poses), `DriveChannelSettings` (commands
against odometry) and `EvidenceSettings` (what a name takes in either). `ODOMETRY`, `DRIVE` and `EVIDENCE` are the
instances that the modules use.

Unless a field says otherwise, its number was set on the development cases of the hidden-effects benchmark:

    python -m benchmarks.hidden_effects.generate --suite SUITE --seeds dev --n N -o DIR
    python -m benchmarks.hidden_effects.run DIR

with SUITE one of singles, none, pairs, triples and foreign.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from sensorgraph.diagnosis.scan.settings import SCAN


@dataclass(frozen=True, kw_only=True)
class EvidenceSettings:
    """What a name costs; the same in both motion channels as in the scan channel."""

    price: float = SCAN.selection.price
    """[nats] per parameter of an effect."""
    threshold: float = SCAN.selection.threshold
    """[nats] of evidence, less the price, that a name needs."""
    max_tolerances: float = SCAN.nuisance.max_tolerances
    """Tolerances at which a nuisance is bounded; a larger error must be an effect."""
    temperature: float = 4.0
    """Evidence is divided by this before it becomes a probability: models are wrong in more ways than noise."""
    huber_limit: float = 3.0
    """Standard deviations beyond which a row counts by its size, not by its square."""
    clip_limit: float = 4.0
    """Robust standard deviations at which a residual is cut before its autocovariance is estimated."""
    cluster: float = 2.0
    """[s] within which errors may be correlated beyond the whitening filter."""
    held_out_block: float = 5.0
    """[s] of rows that are held out together where the gap is measured."""
    listed_z: float = 4.0
    """z above which a deviation is listed."""
    observable_size: float = 3.0
    """Materialities: an effect of this size should show."""
    reckoning_time: float = 60.0
    """[s] of dead reckoning after which a simulation without something is judged."""
    min_drift: float = 0.05
    """[m] by which it must be off then for the user to mind, of a robot that drives 0.4 m/s; another one in proportion."""
    min_speed_error: float = 0.005
    """[m/s] by which the wheels' speed must be off for the user to mind; in proportion, too."""
    reference_speed: float = 0.4
    """[m/s] of the robot that these are for."""
    min_place_error: float = 0.005
    """[m] by which a reference must be bent over the place for the user to mind."""
    min_yaw_error: float = 0.005
    """[rad] the same of its yaw."""
    clock_tolerance_share: float = 0.6
    """Of the tolerance of one stamp: the standard deviation of a clock offset that needs no effect."""
    clock_tolerance_range: tuple[float, float] = (0.0015, 0.0035)
    """[s] least and largest such standard deviation."""


@dataclass(frozen=True, kw_only=True)
class RowSettings:
    """How the reference poses are averaged and compared with the wheels (`wheels/rows`)."""

    averaging_time: float = 0.1
    """[s] over which reference poses are averaged."""
    max_gap: float = 0.35
    """[s] without poses or odometry across which nothing is compared."""
    min_rows: int = 60
    """Rows, or reference poses; with fewer the channel is skipped."""
    min_travel: float = 0.02
    """[m] of the reference along one axis; with less, and less than `min_rotation`, it does not move."""
    min_rotation: float = 0.05
    """[rad]"""
    min_overlap: float = 0.9
    """Share of the whole time that poses and odometry overlap, below which a note says so."""
    max_clock: float = 0.8
    """[s] clock offsets that are tried."""
    clock_step: float = 0.025
    """[s] between them."""
    clock_half_window: float = 0.1
    """[s] before and after, over which rates are compared."""
    min_clock_overlap: float = 5.0
    """[s] of overlap, below which the clocks are taken to agree at first."""
    max_clock_correction: float = 0.05
    """[s] of one Gauss-Newton step of the clock offset."""
    clock_resolution: float = 2e-4
    """[s] step below which the clock offset has converged."""
    heading_window: float = 1.0
    """[s] over which the offset between the headings of reference and wheels is averaged."""
    position_window: float = 2.0
    """[s] the same for positions."""


@dataclass(frozen=True, kw_only=True)
class LimitedNoiseSettings:
    """Limits of the noise that structure is tested against (`reference_noise`)."""

    order: int = 24
    """Of the whitening filter."""
    max_walk: float = 3.0
    """Times the density in robot.yaml that the wheels' random walk may have."""
    max_wander: float = 4.0
    """Times the standard deviation in robot.yaml that the slow part of the reference's noise may have."""
    max_memory: float = 1.0
    """[s] of memory of the reference's noise."""


@dataclass(frozen=True, kw_only=True)
class OdometryStructureSettings:
    """Structure in odometry against reference that no effect makes (`wheels/structure`, `wheels/each_wheel`, `wheels/reference_structure`, `wheels/selection`)."""

    n_pieces: int = 6
    """Pieces of the run, each with its own scales."""
    n_jumps: int = 15
    """Moments of a run at which something may change once, tried first."""
    n_nearer_jumps: int = 5
    """Moments to each side of the best of them, tried next, and again about the best of these."""
    n_while: int = 9
    """Moments of a run between two of which something may be another, for a while."""
    n_clock_pieces: tuple[int, ...] = (5, 20)
    """Pieces of the run, each with its own clock offset; tried one after the other."""
    tight_turns: tuple[float, ...] = (0.3, 1.0, 3.0)
    """Half bases from the middle of the axle to the point about which the robot turns, below which a turn is tight."""
    speed_cuts: tuple[float, ...] = (0.12, 0.22, 0.32)
    """[m/s] of a robot that drives 0.4 m/s; of a faster one in proportion."""
    reference_speed: float = 0.4
    """[m/s]"""
    rate_cuts: tuple[float, ...] = (0.25, 0.5, 0.75)
    """[rad/s] of a robot that turns at 1 rad/s; of a faster one in proportion."""
    acceleration_quantile: float = 0.85
    """Of the run's accelerations, above which the robot accelerates."""
    spinning_quantiles: tuple[float, ...] = (0.5, 0.7, 0.8, 0.9, 0.95)
    """Of the accelerations of the wheels, above which they may spin."""
    cell: float = 1.0
    """[m] of the raster of places."""
    max_cells: int = 24
    """Cells, those that the robot drove through most."""
    min_cell_travel: float = 0.3
    """[m] driven in a cell."""
    min_extent: float = 1.5
    """[m] that a run must cover for its reference to be called distorted over the place: no camera bends within less."""
    least_turning: float = 0.02
    """[m/s] of a wheel that turns: slower ones may stand."""
    play: float = 0.005
    """[m] after a wheel has turned back, within which play would show."""
    radius_factors: tuple[float, ...] = (0.97, 0.98, 0.99, 1.0, 1.01, 1.02, 1.03)
    """Times the wheels' radius in robot.yaml, by which their turns are counted; 1 % of 60 m is a turn."""
    max_askew: float = 0.035
    """[rad] by which the heading of a reference may be put on askew: 2°."""
    askew_sigma: float = 0.1
    """[rad] a priori, of that angle."""
    even_part: float = 0.5
    """Of what an effect of the whole run explains, above which structure leaves it no name."""
    n_reference_jumps: tuple[int, ...] = (1, 2, 4, 8, 16)
    """Tenths of a second in which a reference jumps, that are tried."""
    jump_sigma: float = 0.05
    """[m or rad] a priori, of each jump of the reference."""
    scale_sigma: float = 0.1
    """A priori, of each coefficient that is a scale; in seconds, of a clock offset."""
    rest_sigma: float = 0.01
    """[rad/s] a priori, of a turn that goes on at rest."""
    yaw_sigma: float = 0.02
    """[rad] a priori, of each wave of a distorted yaw."""
    position_sigma: float = 0.2
    """[1] a priori, of each power of a distorted position."""
    threshold: float = 20.0
    """[nats] that structure needs where what is left is noise; in proportion more where it is not."""
    scatter_span: float = 0.3
    """[s] over which what ticks of an encoder add to the noise hangs together."""
    min_gain_per_row: float = 1e-3
    """[nats] per row that structure must explain: less is 0.2 % of the noise's variance, and matters to nobody."""
    wheel_share: float = 0.02
    """Of the evidence of all wheel effects: structure below it is where an effect's model is not exact."""
    patch_share: float = 0.1
    """The same of the evidence of a patch: none is a sharp round disc, and its rim looks like structure."""


@dataclass(frozen=True, kw_only=True)
class PatchSettings:
    """The search for slippery patches (`wheels/patch_search`)."""

    max_patches: int = 3
    """In one run."""
    min_moving: float = 1e-3
    """[m] of an increment that moves."""
    min_positions: int = 20
    """Increments that move; with fewer no patch is looked for."""
    cell: float = 0.15
    """[m] between the centres that are tried."""
    max_centres: int = 250
    """Centres that are tried; of more, every second or third."""
    radii: tuple[float, ...] = (0.2, 0.3, 0.42, 0.56, 0.72, 0.92, 1.2, 1.6, 2.1)
    """[m] of patches that are tried."""
    first_steps: tuple[float, ...] = (0.08, 0.04)
    """[m] of the random steps about the best of them."""
    first_spread: float = 1.5
    """Steps to each side, within which these are drawn."""
    n_first: int = 120
    """Drawn for each step."""
    grid_reach: float = 0.9
    """[m] around an accepted patch, within which centres are tried first."""
    grid_step: float = 0.3
    """[m] between them."""
    grid_radii: tuple[float, float, float] = (0.15, 2.3, 0.15)
    """[m] first radius tried there, end, and step."""
    n_refining: int = 80
    """Drawn for each refining step, of either kind."""
    ridge_growth: float = 2.0
    """Steps (standard deviation) by which a patch grows whose near edge stays."""
    posterior_cell: float = 0.05
    """[m] cells of (x, y, r) that count as one disc each for the spread of the place."""
    radius_range: tuple[float, float] = (0.1, 2.5)
    """[m] of patches, in these steps and in the refining ones."""
    refining_steps: tuple[float, ...] = (0.25, 0.25, 0.12, 0.06, 0.03)
    """[m] of the random steps about an accepted patch."""
    rim: float = 0.02
    """[m] over which a patch fades at its edge: about as long as an increment."""
    min_information: float = 400.0
    """[1] inverse variance of the lost share, 5 % standard error; with less the disc was hardly driven through."""
    max_slip: float = 0.95
    """Share of the motion that a patch may take."""
    min_gain: float = 4.0
    """[nats] at which a patch is judged again by a noise of its own."""
    clear_gain: float = 50.0
    """[nats] at which that is not needed."""
    noise_price: float = 8.0
    """[nats] for a noise of its own."""
    further_share: float = 0.005
    """Of the evidence of all effects that a further patch must bring: less mends the rim of the others."""
    credible_fall: float = 6.0
    """[nats] below the best disc, within which a disc counts for the spread of the place."""
    place_doubt: float = 2.0
    """Widens the spread of a patch's place: the search alone is too sure of it."""
    min_place_error: float = 0.02
    """[m] least standard error of a patch's place."""
    rim_shift: float = 0.06
    """[m] by which a patch may be off before that counts as structure."""


@dataclass(frozen=True, kw_only=True)
class OdometryChannelSettings:
    """All tuned numbers of the odometry channel."""

    rows: RowSettings = field(default_factory=RowSettings)
    noise: LimitedNoiseSettings = field(default_factory=LimitedNoiseSettings)
    structure: OdometryStructureSettings = field(default_factory=OdometryStructureSettings)
    patch: PatchSettings = field(default_factory=PatchSettings)
    filter_order: int = 24
    """Of the whitening filters."""
    walk_over_level: tuple[float, float] = (1e-3, 10.0)
    """Least and largest variance of the wheels' random walk from row to row, over that of an averaged reference."""
    marker_sigma: float = 0.003
    """[m] between the axle and what the reference calls base_link."""
    max_effects: int = 7
    """Steps of the forward selection."""
    min_clock_shift: float = 3e-4
    """[s] by which the clock offset must move for the rows to be laid out anew."""
    max_clock_shift: float = 0.02
    """[s] by which it may move then."""
    stamp_averaging: float = 8.0
    """The mean of a run's stamps is so many times less off than the tolerance of one stamp."""
    min_distance: float = 1.0
    """[m] driven, below which no slip can be seen."""
    max_listed: int = 12
    """Deviations listed before any naming."""


@dataclass(frozen=True, kw_only=True)
class DriveStructureSettings:
    """Structure in commands against odometry that no effect makes (`motors/structure`)."""

    n_pieces: int = 6
    """Pieces of the run, each with its own gains and its own delay."""
    n_jumps: int = 15
    """Moments of a run at which a gain may change once."""
    speed_cuts: tuple[float, ...] = (0.25, 0.5)
    """Shares of the largest speed below which the gain may be another."""
    rate_cuts: tuple[float, ...] = (0.12, 0.2, 0.35, 0.6)
    """The same of the turn rate."""
    deadbands: tuple[float, ...] = (0.03, 0.06, 0.09, 0.12, 0.15, 0.18, 0.21, 0.24, 0.28, 0.33)
    """Shares of the largest command below which motors may do nothing."""
    still_share: float = 0.03
    """Of the largest speed, below which a base stands."""
    asked_share: float = 0.15
    """Of the largest speed, above which commands ask it to move."""
    stop_time: float = 0.25
    """[s] that it must stand so: longer than a base waits for the next tick of its loop."""
    rolling_times: tuple[float, ...] = (0.6, 1.2, 2.5, 5.0)
    """[s] for which a base may go on after it was told to stand."""
    answer_lags: tuple[float, ...] = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
    """[s] after a command has acted, at which it may act again."""
    answer_sigma: float = 0.3
    """A priori, of how much it acts again."""
    ramps: tuple[float, ...] = (0.03, 0.05, 0.09, 0.15, 0.25, 0.35, 0.5, 0.7)
    """Shares of the robot's acceleration that a base may really have."""
    lead_over_answer: float = 10.0
    """Times the evidence of such an answer, or ramp, that a lag or a dead time must bring beside it for a name."""
    gain_sigma: float = 0.1
    """A priori, of each coefficient that is a gain."""
    delay_sigma: float = 0.05
    """[s] a priori, of each delay."""
    max_families: int = 3
    """That the size of a doubt counts: the strongest, and others that explain as much beside it as a name takes."""
    slope_sigma: float = 0.05
    """[m/s] a priori, by which a slope makes the robot faster or slower."""
    deadband_sigma: float = 1.0
    """A priori: the share of a deadband that is there."""
    accepted_sigma: float = 0.5
    """A priori, of each coefficient of structure once it is part of the model."""
    share: float = 0.01
    """Of the evidence of the strongest effect: structure below it is where that effect's model is not exact."""


@dataclass(frozen=True, kw_only=True)
class MotorFitSettings:
    """Gauss-Newton on the simulated motors (`motors/model`)."""

    max_steps: int = 6
    tau_quotient: tuple[float, float] = (0.004, 0.05)
    """[s] and share of the time constant: the larger is the step of its difference quotient."""
    delay_quotient: float = 0.01
    """[s] to each side, of the difference quotient of the dead time."""
    v_max_quotient: float = 0.004
    """[m/s] downward, of the difference quotient of the largest speed."""
    tau_step: tuple[float, float] = (-0.08, 0.15)
    """[s] largest steps of the time constant, down and up."""
    delay_step: tuple[float, float] = (-0.1, 0.1)
    """[s] of the dead time."""
    v_max_step: tuple[float, float] = (-0.05, 0.05)
    """[m/s] of the largest speed."""
    tau_range: tuple[float, float] = (1e-3, 3.0)
    """[s] least and largest time constant."""
    min_v_max: float = 0.02
    """[m/s] least largest speed."""
    converged: tuple[float, float, float] = (1e-3, 1e-3, 5e-4)
    """[s, s, m/s] steps of time constant, dead time and largest speed below which the fit has converged."""
    v_max_quantile: float = 0.995
    """Of the measured speeds: the largest speed to begin with."""
    v_max_start: tuple[float, float] = (0.03, 0.005)
    """[m/s] its least value, and how far it stays below the largest command."""


@dataclass(frozen=True, kw_only=True)
class DriveChannelSettings:
    """All tuned numbers of the drive channel."""

    structure: DriveStructureSettings = field(default_factory=DriveStructureSettings)
    fit: MotorFitSettings = field(default_factory=MotorFitSettings)
    step: float = 0.01
    """[s] of the simulated motors."""
    control_step: float = 0.003
    """[s] by which a controller's own step blurs a dead time."""
    filter_order: int = 4
    """Of the whitening filters."""
    gain_sigma: float = 0.03
    """Tolerance of the gain from command to odometry."""
    lag_sigma: float = 0.004
    """[s] tolerance of the time constant."""
    turn_sigma: float = 0.008
    """Tolerance of the turn in proportion to speed, times the wheelbase."""
    min_rows: int = 100
    """Rows; with fewer the channel is skipped."""
    min_commands: int = 20
    """Commands; with fewer the channel is skipped."""
    max_gap: float = 0.35
    """[s] between commands, or of an increment, across which nothing is compared."""
    settling_time: float = 0.3
    """[s] after the first command, which is not compared: what came before it is unknown."""
    min_clock_offset: float = 0.004
    """[s] of the odometry's clock against the reference's, below which it is not corrected."""
    max_clock_error: float = 0.01
    """[s] largest standard error of that offset which counts."""
    second_lag: float = 0.03
    """[s] of a second lag in series with the first, as real motors have one; at most half of both together."""
    second_lag_sigma: float = 0.4
    """Standard deviation a priori of the share of such a lag that is there."""
    beat_time: float = 5.0
    """[s] over which the ticks of the base and the stamps of the commands keep their phase."""
    max_beats: int = 24
    """Pieces of the run with a delay of their own; in a longer run they are longer."""
    min_top_speed: float = 0.05
    """[m/s] of the largest command, below which no saturation is looked for."""
    min_saturation: float = 0.02
    """[m/s] by which motors must fall short of the largest command for a saturation to be material."""
    full_speed_share: float = 0.9
    """Of the robot's limit that commands must reach to show a saturation."""
    max_effects: int = 4
    """Steps of the forward selection."""


EVIDENCE = EvidenceSettings()
"""The settings of both channels."""
ODOMETRY = OdometryChannelSettings()
"""The settings of the odometry channel."""
DRIVE = DriveChannelSettings()
"""The settings of the drive channel."""
