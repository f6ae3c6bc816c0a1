"""Families of columns for differences between commands and odometry that no effect explains."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sensorgraph.diagnosis.motion.increments import MIN_MOTION
from sensorgraph.diagnosis.motion.motor_model import Column, DriveModel
from sensorgraph.diagnosis.motion.motor_simulation import AccelerationLimit
from sensorgraph.diagnosis.motion.regression import Fit
from sensorgraph.diagnosis.motion.structure_test import StructureFamily, above_quarters, pieces
from sensorgraph.diagnosis.motion.whitening import by_kind
from sensorgraph.effects.actuator_lag import ACTUATOR_LAG
from sensorgraph.types import Bools, Floats, Ints

DRIVE_FAMILIES = {
    "time": ("gain_over_time", "a gain of the motors that changes over time"),
    "lag over time": ("lag_over_time", "a lag of the motors that changes over time"),
    "coupling": ("gain_in_turns", "a speed that depends on the turn rate, or vice versa"),
    "answer": ("motors_ring", "a response of the motors that is not a single lag"),
    "heading": ("speed_by_heading", "a speed that depends on the heading, as on a sloped floor"),
    "drops": ("speed_losses", "temporary losses of speed despite commands to continue"),
    "deadband": ("dead_zone", "a dead zone of small commands"),
    "ramp": ("slow_ramp", "a slower acceleration than specified"),
    "constant gain": ("constant_gain", "a constant gain of the motors beyond the tolerances"),
}
"""Kind -> name in the ledger, and noun phrase."""

N_SIZES = 128
"""Number of sizes of a dead zone that are tried, for driving and for turning."""
ANSWER_STEP, N_ANSWERS = 0.1, 8
"""[s] delay from one possible further response to a command to the next, and their number."""
N_RAMPS = 10
"""Number of smaller accelerations that are tried, each the previous one over sqrt 2: down to 1/32 of that in robot.yaml."""
STOP_TIME = 0.25
"""[s] minimum duration of such a stop: longer than a base waits for the next tick of its control loop."""
ASKED_SHARE = 0.15
"""Share of the maximum speed, above which the base is commanded to move."""


def drive_families(model: DriveModel, fit: Fit) -> list[StructureFamily]:
    """Return the families of differences that no effect explains, with columns (2 n, k)."""
    rows = model.rows
    middle = (rows.start + rows.end) / 2
    used = middle[rows.valid]
    later = pieces((middle - used[0]) / np.ptp(used))[1:]
    return [
        _gains("time", "a gain that changes over time", model, fit, later, later),
        _lag_over_time(model, fit, later),
        _gains_by_the_other(model, fit),
        _answers(model, fit),
        _slopes(model),
        *_drops(model, fit),
        *_deadbands(model, fit),
        *_ramps(model, fit),
    ]


def _gains(
    kind: str,
    statement: str,
    model: DriveModel,
    fit: Fit,
    masks: Sequence[Bools],
    turn_masks: Sequence[Bools],
) -> StructureFamily:
    """Return the family of gains of the speed in some rows (n,), and of the turn rate in others."""
    ways, turns = _way_and_turn(fit.simulated)
    columns = [ways * np.tile(mask, 2) for mask in masks] + [turns * np.tile(mask, 2) for mask in turn_masks]
    return StructureFamily(
        kind=kind,
        columns=model.rows.masked(np.stack(columns, axis=1)),
        statement=statement,
    )


def _lag_over_time(model: DriveModel, fit: Fit, later: Sequence[Bools]) -> StructureFamily:
    """Return the family of a lag that a load or a warm gear changes during the run.

    Waits for the control loop that spread evenly over a period smear a step as a lag of less than half a period.
    """
    columns = [fit.columns[:, Column.LAG] * np.tile(piece, 2) for piece in later]
    (size,) = ACTUATOR_LAG.sizes.values()
    return StructureFamily(
        kind="lag over time",
        columns=model.rows.masked(np.stack(columns, axis=1)),
        least_change=max(size, model.robot.tolerances.control_period / 2),
        statement="a lag of the motors that changes over time",
    )


def _way_and_turn(rates: Floats) -> tuple[Floats, Floats]:
    """Return rates (2 n,) with all turn rates set to 0, and with all speeds set to 0."""
    of_way = np.arange(len(rates)) < len(rates) // 2
    return np.where(of_way, rates, 0.0), np.where(of_way, 0.0, rates)


def _gains_by_the_other(model: DriveModel, fit: Fit) -> StructureFamily:
    """Return the family of a base whose speed depends on its turn rate, or vice versa: the wheels share power."""
    driving, turning = (above_quarters(rate) for rate in by_kind(fit.simulated, model.rows.n))
    statement = "a speed that depends on the turn rate, or a turn rate that depends on the speed"
    return _gains("coupling", statement, model, fit, turning, driving)


def _answers(model: DriveModel, fit: Fit) -> StructureFamily:
    """Return the family of motors whose response is not a single lag: they ring, overshoot or creep."""
    rates = model.simulation.rates
    late = [rates(fit.motors, later=ANSWER_STEP * (k + 1)) - fit.simulated for k in range(N_ANSWERS)]
    columns = [column for one in late for column in _way_and_turn(one)]
    return StructureFamily(
        kind="answer",
        columns=model.rows.masked(np.stack(columns, axis=1)),
        statement="a response to commands that is not a single lag: the base rings, overshoots or creeps",
    )


def _slopes(model: DriveModel) -> StructureFamily:
    """Return the family of speeds that depend on the heading, as on a sloped floor."""
    rows = model.rows
    _, omega = by_kind(rows.y, rows.n)
    heading, nothing = np.cumsum(omega * (rows.end - rows.start)), np.zeros(rows.n)
    moves = np.abs(by_kind(model.simulation.rates(model.nominal), rows.n)[0]) > MIN_MOTION
    ways = (np.cos(heading), np.sin(heading))
    columns = [
        np.concatenate([way * some, nothing]) for way in ways for some in (1.0, moves)
    ]  # at all times, or only while it moves
    return StructureFamily(
        kind="heading",
        columns=rows.masked(np.stack(columns, axis=1)),
        statement="a speed that depends on the heading, as on a floor that slopes",
    )


def _asked_and_moved(model: DriveModel, fit: Fit) -> tuple[Floats, Floats, Floats]:
    """Return simulated and measured rates (2, n) [m/s, rad/s], and the largest simulated ones (2, 1)."""
    asked, moved = (np.stack(by_kind(x, model.rows.n)) for x in (fit.simulated, model.rows.y))
    return asked, moved, np.maximum(np.abs(asked).max(axis=1, keepdims=True), MIN_MOTION)


def _by_commands(
    kind: str,
    statement: str,
    model: DriveModel,
    fit: Fit,
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


def _drops(model: DriveModel, fit: Fit) -> list[StructureFamily]:
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


def _ramps(model: DriveModel, fit: Fit) -> list[StructureFamily]:
    """Return one family for each slower ramp that a base may apply to commands."""
    is_ramped = model.simulation.limit is AccelerationLimit.SET_POINT
    limit, out = AccelerationLimit.SET_POINT if is_ramped else AccelerationLimit.MOTORS, []
    for share in np.power(2.0, -np.arange(1, N_RAMPS + 1) / 2).tolist():
        columns = _way_and_turn(
            model.simulation.rates_of(fit.motors, limit=limit, share=share) - fit.simulated
        )
        out.append(
            StructureFamily(
                kind="ramp",
                columns=model.rows.masked(np.stack(columns, axis=1)),
                sigma=1.0,
                statement=f"a slower change of speed: the base accelerates at about {100 * share:.0f} % of the limit in robot.yaml",
                choice_price=float(np.log(N_RAMPS)),
            )
        )
    return out


def _deadbands(model: DriveModel, fit: Fit) -> list[StructureFamily]:
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
