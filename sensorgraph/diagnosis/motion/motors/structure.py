"""Families of columns for differences between commands and odometry that no effect explains."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sensorgraph.diagnosis.motion.increments import MIN_MOTION
from sensorgraph.diagnosis.motion.motors.model import Column, DriveFit, DriveModel
from sensorgraph.diagnosis.motion.motors.simulation import AccelerationLimit
from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.motion.structure_test import StructureFamily
from sensorgraph.diagnosis.motion.whitening import both_kinds
from sensorgraph.effects.actuator_lag import ACTUATOR_LAG
from sensorgraph.effects.dead_time import DEAD_TIME
from sensorgraph.types import Bools, Floats, Ints

WHAT_CHANGES = {"lag": (Column.LAG, ACTUATOR_LAG), "delay": (Column.DELAY, DEAD_TIME)}
"""Motor parameters that a load, a warm gear or a restart may change during a run."""

ANSWER = "answer"
"""Kind of the family of motors whose response is not a single lag."""


RAMP = "ramp"
"""Kind of the families of a base that accelerates more slowly than specified."""


LAG_BY_SENSE = "lag by sense"
"""Kind of the family of motors that speed up and slow down with different lags."""


OTHER_MOTORS = (ANSWER, LAG_BY_SENSE, RAMP)
"""Kinds of the families of motors whose response is not a single lag, although a lag absorbs most of it."""

N_SIZES = 128
"""Number of sizes of a dead zone that are tried, for driving and for turning."""
TRIMMED = 0.15
"""Share of the run at its start and its end, within which no change is tested: too few commands would show it
(Andrews 1993, section 4)."""
STOP_TIME = 0.25
"""[s] minimum duration of such a stop: longer than a base waits for the next tick of its control loop."""
ANSWER_LAGS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
"""[s] delays after the response to a command, at which a second response may follow."""
ANSWER_SIGMA = 0.3
"""Prior standard deviation of the second response."""
DELAY_SIGMA = 0.05
"""[s] prior standard deviation of a delay or a lag that changes."""
RAMPS = (0.03, 0.05, 0.09, 0.15, 0.25, 0.35, 0.5, 0.7)
"""Shares of the acceleration in robot.yaml that a base may really have."""
SPEED_CUTS = (0.25, 0.5)
"""Shares of the maximum speed, below which the gain may differ."""
RATE_CUTS = (0.12, 0.2, 0.35, 0.6)
"""Shares of the maximum turn rate, below which the gain may differ."""
ASKED_SHARE = 0.15
"""Share of the maximum speed, above which the base is commanded to move."""


def drive_families(model: DriveModel, fit: DriveFit) -> list[StructureFamily]:
    """Return the families of differences that no effect explains, with columns (2 n, k)."""
    rows = model.rows
    v, omega = both_kinds(fit.simulated, rows.n)
    middle = (rows.start + rows.end) / 2
    share = (middle - middle[rows.valid][0]) / np.ptp(middle[rows.valid])
    n = EVIDENCE.n_pieces
    piece = np.clip((n * share).astype(np.intp), 0, n - 1)
    pieces = [piece == k for k in range(1, n)]
    return [
        _gains("time", "a gain that changes over time", model, fit, pieces, pieces),
        _gains(
            "direction",
            "a gain that differs forward and backward, or to the left and to the right",
            model,
            fit,
            [v < 0],
            [omega < 0],
        ),
        _gains_by_the_other(model, fit),
        _answers(model, fit),
        _lag_by_sense(model, fit),
        _slopes(model),
        *_drops(model, fit),
        *_jumps(model, fit, share, middle - rows.start[0]),
        *_deadbands(model, fit),
        *_ramps(model, fit),
    ]


def _gains(
    kind: str,
    statement: str,
    model: DriveModel,
    fit: DriveFit,
    masks: Sequence[Bools],
    turn_masks: Sequence[Bools],
    choice_price: float = 0.0,
) -> StructureFamily:
    """Return the family of gains of the speed in some rows (n,), and of the turn rate in others."""
    ways, turns = _way_and_turn(fit.simulated)
    columns = [ways * np.tile(mask, 2) for mask in masks] + [turns * np.tile(mask, 2) for mask in turn_masks]
    return StructureFamily(
        kind=kind,
        columns=model.rows.masked(np.stack(columns, axis=1)),
        statement=statement,
        choice_price=choice_price,
    )


def _way_and_turn(rates: Floats) -> tuple[Floats, Floats]:
    """Return rates (2 n,) with all turn rates set to 0, and with all speeds set to 0."""
    of_way = np.arange(len(rates)) < len(rates) // 2
    return np.where(of_way, rates, 0.0), np.where(of_way, 0.0, rates)


def _gains_by_the_other(model: DriveModel, fit: DriveFit) -> StructureFamily:
    """Return the family of a base whose speed depends on its turn rate, or vice versa: the wheels share power."""
    v, omega = (np.abs(x) for x in both_kinds(fit.simulated, model.rows.n))
    top_v, top_omega = max(float(v.max()), 1e-3), max(float(omega.max()), 1e-3)
    turning = [omega > q * top_omega for q in RATE_CUTS]
    driving = [v > q * top_v for q in SPEED_CUTS]
    statement = "a speed that depends on the turn rate, or a turn rate that depends on the speed"
    return _gains("coupling", statement, model, fit, turning, driving)


def _answers(model: DriveModel, fit: DriveFit) -> StructureFamily:
    """Return the family of motors whose response is not a single lag: they ring, overshoot or creep."""
    rates = model.simulation.rates
    late = [rates(fit.motors, later=lag) - fit.simulated for lag in ANSWER_LAGS]
    columns = [column for one in late for column in _way_and_turn(one)]
    return StructureFamily(
        kind=ANSWER,
        columns=model.rows.masked(np.stack(columns, axis=1)),
        sigma=ANSWER_SIGMA,
        statement="a response to commands that is not a single lag: the base rings, overshoots or creeps",
    )


def _lag_by_sense(model: DriveModel, fit: DriveFit) -> StructureFamily:
    """Return the family of motors that speed up and slow down with different lags: a load, a brake, a worm gear."""
    faster = [np.gradient(np.abs(x)) > 0 for x in both_kinds(fit.simulated, model.rows.n)]
    return StructureFamily(
        kind=LAG_BY_SENSE,
        columns=(fit.columns[:, Column.LAG] * np.concatenate(faster))[:, None],
        sigma=DELAY_SIGMA,
        statement="a lag that differs between speeding up and slowing down",
    )


def _slopes(model: DriveModel) -> StructureFamily:
    """Return the family of speeds that depend on the heading, as on a sloped floor."""
    rows = model.rows
    _, omega = both_kinds(rows.y, rows.n)
    heading, nothing = np.cumsum(omega * (rows.end - rows.start)), np.zeros(rows.n)
    moves = np.abs(both_kinds(model.simulation.rates(model.nominal), rows.n)[0]) > MIN_MOTION
    ways = (np.cos(heading), np.sin(heading))
    columns = [
        np.concatenate([way * some, nothing]) for way in ways for some in (1.0, moves)
    ]  # at all times, or only while it moves
    return StructureFamily(
        kind="heading",
        columns=rows.masked(np.stack(columns, axis=1)),
        statement="a speed that depends on the heading, as on a floor that slopes",
    )


def _asked_and_moved(model: DriveModel, fit: DriveFit) -> tuple[Floats, Floats, Floats]:
    """Return simulated and measured rates (2, n) [m/s, rad/s], and the largest simulated ones (2, 1)."""
    asked, moved = (np.stack(both_kinds(x, model.rows.n)) for x in (fit.simulated, model.rows.y))
    return asked, moved, np.maximum(np.abs(asked).max(axis=1, keepdims=True), 1e-3)


def _by_commands(
    kind: str,
    statement: str,
    model: DriveModel,
    fit: DriveFit,
    commands: Floats,
    choice_price: float = 0.0,
    limit: AccelerationLimit | None = None,
) -> StructureFamily:
    """Return the family of a base that responds to other commands (n_commands, 2); its coefficient is the share of that.

    Parameters
    ----------
    limit : Where the acceleration is limited; default: as in the simulation.
    """
    rates = model.simulation.rates_of(fit.motors, commands, limit=limit)
    return StructureFamily(
        kind=kind,
        columns=model.rows.masked((rates - fit.simulated)[:, None]),
        sigma=1.0,
        statement=statement,
        choice_price=choice_price,
    )


def _long_stretches(model: DriveModel, some: Bools) -> Ints:
    """Return the first row and the end (k, 2) of each stretch of rows (n,) that lasts longer than commands wait."""
    least = round(STOP_TIME / float(np.median(model.rows.end - model.rows.start)))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], some.astype(np.intp), [0]]))).reshape(-1, 2)
    return np.asarray(edges[edges[:, 1] - edges[:, 0] >= least])


def _drops(model: DriveModel, fit: DriveFit) -> list[StructureFamily]:
    """Return families of a base that temporarily loses speed although it is commanded to continue.

    The speed falls at once, or at the acceleration limit. A loss begins where the base falls short of the
    command, earlier by the time of that fall, and ends at the largest shortfall. Each loss is a choice of two
    moments.
    """
    rows, motors = model.rows, fit.motors
    asked, moved, top = _asked_and_moved(model, fit)
    short = np.where(rows.valid, ((asked - moved) * np.sign(asked) / top).max(axis=0), 0.0)
    times = [
        (first, first + int(np.argmax(short[first:beyond])))
        for first, beyond in _long_stretches(model, short > ASKED_SHARE)
    ]
    out = []
    limits: tuple[AccelerationLimit, ...] = (AccelerationLimit.NOWHERE, AccelerationLimit.MOTORS)
    if model.simulation.limit not in limits:
        limits = (model.simulation.limit,)
    statement = (
        "a temporary loss of speed despite commands to continue: motors that cut out, a link that drops out"
    )
    for limit in limits if times else ():
        is_limited = limit is not AccelerationLimit.NOWHERE
        slowest = float((top[:, 0] / model.simulation.slew).max()) if is_limited else motors.tau
        stamps, without = model.simulation.commands.stamps, model.simulation.commands.values.copy()
        for first, most in times:
            begin = rows.start[first] - motors.delay - ASKED_SHARE * slowest
            without[(stamps > begin) & (stamps < rows.start[most] - motors.delay)] = 0.0
        price = 2 * len(times) * float(np.log(rows.n))
        out.append(_by_commands("drops", statement, model, fit, without, price, limit))
    return out


def _jumps(model: DriveModel, fit: DriveFit, share: Floats, passed: Floats) -> list[StructureFamily]:
    """Return families for each moment at which gains, lag or delay may change once.

    Parameters
    ----------
    share, passed : (n,) Elapsed part of the run, as a share and in s.
    """
    n, out = EVIDENCE.n_jumps, list[StructureFamily]()
    price = float(np.log(3 * n))
    for k in range(1, n + 1):
        if not TRIMMED <= k / (n + 1) <= 1 - TRIMMED:
            continue
        later = share > k / (n + 1)
        when = f"that changes once, {passed[later][0]:.0f} s into the run"
        out.append(_gains("jump", f"a gain {when}", model, fit, [later], [later], price))
        for what, (column, _) in WHAT_CHANGES.items():
            out.append(
                StructureFamily(
                    kind=f"jump of the {what}",
                    columns=(fit.columns[:, column] * np.concatenate([later, later]))[:, None],
                    sigma=DELAY_SIGMA,
                    statement=f"a {what} of the motors {when}",
                    choice_price=price,
                    least_change=_least_change(model, what),
                )
            )
    return out


def _least_change(model: DriveModel, what: str) -> float:
    """Return the change [s] of a delay, or a lag, during a run that matters: more than waits for the base may cause.

    Commands in phase with the control loop of the base may all wait a period longer than before. Waits that spread
    evenly over a period smear a step as a lag of less than half a period.
    """
    (size,) = WHAT_CHANGES[what][1].sizes.values()
    period = model.robot.tolerances.control_period
    return max(size, period if what == "delay" else period / 2)


def _ramps(model: DriveModel, fit: DriveFit) -> list[StructureFamily]:
    """Return one family for each slower ramp that a base may apply to commands."""
    shares = RAMPS
    out = []
    for share in shares:
        columns = _way_and_turn(model.simulation.rates_with_slew(fit.motors, share) - fit.simulated)
        out.append(
            StructureFamily(
                kind=RAMP,
                columns=model.rows.masked(np.stack(columns, axis=1)),
                sigma=1.0,
                statement=f"a slower change of speed: the base accelerates at about {share:.0%} of the limit in robot.yaml",
                choice_price=float(np.log(len(shares))),
            )
        )
    return out


def _deadbands(model: DriveModel, fit: DriveFit) -> list[StructureFamily]:
    """Return the families of motors that ignore small commands to drive, or to turn, with the most likely size.

        maximise over size  (cᵀ r)² / cᵀ c,    c = rates(commands without those of a magnitude up to size) - simulated,

    where r is the residual, and c and r are taken without what the motors' own columns explain. Sizes are the magnitudes
    of the commands, thinned to `N_SIZES`, and are paid for as a choice.
    """
    rows, commands = model.rows, model.simulation.commands.values
    own, _ = np.linalg.qr(rows.masked(fit.columns))
    residual = rows.masked(rows.y - fit.simulated)
    statement = "a dead zone: the motors do not respond to small commands"
    families = list[StructureFamily]()
    for kind in (0, 1):
        asked = np.unique(np.abs(commands[:, kind]))
        sizes = np.unique(np.quantile(asked, np.linspace(0.0, 1.0, N_SIZES), method="nearest"))
        ignoring = [
            np.where(np.abs(commands) <= np.eye(2)[kind] * size, 0.0, commands) for size in sizes[sizes > 0]
        ]
        gains = []
        for one in ignoring:
            column = rows.masked(model.simulation.rates_of(fit.motors, one) - fit.simulated)
            column -= own @ (own.T @ column)
            gains.append(max(float(column @ residual), 0.0) ** 2 / max(float(column @ column), 1e-12))
        if gains:
            likeliest, price = ignoring[int(np.argmax(gains))], float(np.log(2 * len(gains)))
            families.append(_by_commands("deadband", statement, model, fit, likeliest, price))
    return families
