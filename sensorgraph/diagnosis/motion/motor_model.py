"""Regression of odometry on simulated motors, by Gauss-Newton, with tolerances of motors and odometry.

    y = simulated + A theta + noise

A contains the derivatives of the simulated rates by the motor parameters, the gains, and columns of
structure. The error of the odometry is a nuisance: a gain of a few per cent, a turn in proportion to speed,
and a clock offset within the accuracy that the reference poses give.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from enum import IntEnum

import numpy as np

from sensorgraph.diagnosis.motion.consequence import SimulationError, simulation_error
from sensorgraph.diagnosis.motion.increments import MIN_MOTION, CommandSignal, DriveRows
from sensorgraph.diagnosis.motion.motor_simulation import STEP, MotorParameters, MotorSimulation
from sensorgraph.diagnosis.motion.regression import (
    BoundedPrior,
    Fit,
    Regression,
    Term,
    clusters_of,
)
from sensorgraph.diagnosis.motion.structure_test import TestedFamily
from sensorgraph.diagnosis.motion.whitening import (
    Whitener,
    WhiteningFilter,
    by_kind,
    clipped,
    fit_autoregression,
)
from sensorgraph.diagnosis.result import MotionDifference
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.effects.actuator_lag import ACTUATOR_LAG
from sensorgraph.effects.dead_time import DEAD_TIME
from sensorgraph.effects.interfaces import DrivenMotion
from sensorgraph.effects.speed_saturation import SPEED_SATURATION
from sensorgraph.effects.wheel_base import WHEEL_BASE
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_radius_diff import WHEEL_RADIUS_DIFF
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Robot

LAG_SIGMA = 0.004
"""[s] tolerance of the time constant."""
QUOTIENT = LAG_SIGMA
"""[s or m/s] step of the difference quotients, within which the simulation counts as linear: what is tolerated anyway."""
MAX_STEPS = 6
"""Maximum number of Gauss-Newton steps."""
FILTER_ORDER = 4
"""Order of the whitening filters."""
GAIN_SIGMA = 0.03
"""Tolerance of the gain from command to odometry."""
TURN_SIGMA = 0.008
"""Tolerance of the turn in proportion to speed, multiplied by the wheelbase."""
MAX_SECOND_LAG = 0.03
"""[s] second lag in series with the first, as in real motors; at most half of their sum."""


class Column(IntEnum):
    """First columns of the regression, as steps from the simulated motors."""

    LAG = 0
    DELAY = 1
    GAIN_V = 2
    GAIN_OMEGA = 3
    TURN_PER_DISTANCE = 4
    V_MAX = 5
    SECOND_LAG = 6
    """Share of a second lag in series, as in every real motor: it changes the shape of a step, not its delay."""


SIMULATED_TERMS = (
    Term(ACTUATOR_LAG, Column.LAG),
    Term(DEAD_TIME, Column.DELAY),
    Term(SPEED_SATURATION, Column.V_MAX),
)
"""Effects that are parameters of the simulated motors."""
GAIN_TERMS = (
    Term(None, Column.GAIN_V, "constant gain"),
    Term(None, Column.GAIN_OMEGA, "constant gain"),
    Term(None, Column.TURN_PER_DISTANCE, "constant gain"),
)
"""Tolerances of the odometry; beyond their bounds, they are constant gains of the base."""


class DriveModel:
    """One run's regression of odometry on commands."""

    channel = "drive"

    def __init__(
        self,
        commands: CommandSignal,
        rows: DriveRows,
        robot: Robot,
        wheels: MotionDifference | None = None,
        named_wheels: Iterable[Amendment] = (),
    ) -> None:
        """Set up the regression.

        Parameters
        ----------
        wheels : Motion that the odometry channel explains by slip or structure; the wheels may have misread
            it.
        named_wheels : Effects that the odometry channel has named; the base may obey odometry or reference.
        """
        self.rows, self.robot = rows, robot
        self.top_speed = commands.top_speed
        limits = robot.limits
        self.simulation = MotorSimulation(commands, rows, np.array([limits.a, limits.alpha]))
        self.clusters = clusters_of(rows.start, 2)
        sigmas = (robot.wheels.sigma_v, robot.wheels.sigma_omega)
        first, second = (WhiteningFilter.white(FILTER_ORDER, sigma) for sigma in sigmas)
        self.whitener = Whitener.plain((first, second), rows.valid)
        self.nominal = MotorParameters(tau=robot.actuators.tau, delay=robot.actuators.delay)
        self.structure: TestedFamily | None = None
        self.tested: list[TestedFamily] = []
        """For the ledger."""
        found = [(effect, effect.diagnostics.regressor) for effect in EFFECTS.values()]
        self.regressors = [(effect, one) for effect, one in found if one and effect.channel == self.channel]
        own = (Term(effect, k) for k, (effect, _) in enumerate(self.regressors, start=len(Column)))
        terms = (*SIMULATED_TERMS, *own, *GAIN_TERMS)
        can_saturate = self.top_speed > MIN_MOTION
        self.terms = [term for term in terms if term.effect is not SPEED_SATURATION or can_saturate]
        """Hypotheses that this run could show."""
        self.misread = np.zeros((2 * rows.n, 0)) if wheels is None else _misread(rows, wheels)
        self.n_own = len(Column) + len(self.regressors) + int(self.misread.shape[1])
        """Number of columns before those of structure."""
        named = {a.effect: a["s"] for a in named_wheels if "s" in a.parameters}
        radius, base, diff = (named.get(one, 0.0) for one in (WHEEL_RADIUS, WHEEL_BASE, WHEEL_RADIUS_DIFF))
        self.gain_sigmas = (
            float(np.hypot(GAIN_SIGMA, radius)),
            float(np.hypot(GAIN_SIGMA, abs(radius) + abs(base))),
            float(np.hypot(TURN_SIGMA, diff)) / robot.wheels.base,
        )

    def linearised(self, motors: MotorParameters) -> tuple[Floats, Floats]:
        """Return the simulated rows (2 n,) and the columns (2 n, n_own + structure)."""
        rates = self.simulation.rates
        base = rates(motors)
        step = QUOTIENT
        second = _second_lag(motors)
        in_series = replace(motors, tau=motors.tau - second, second=second)
        v, omega = by_kind(base, self.rows.n)
        nothing = np.zeros(self.rows.n)
        by_v_max = np.zeros(2 * self.rows.n)
        if np.isfinite(motors.v_max):
            slower = replace(motors, v_max=motors.v_max - step)
            by_v_max = (base - rates(slower)) / step
        columns = {
            Column.LAG: (rates(replace(motors, tau=motors.tau + step)) - base) / step,
            Column.DELAY: (rates(motors, later=step) - rates(motors, later=-step)) / (2 * step),
            Column.GAIN_V: np.concatenate([v, nothing]),
            Column.GAIN_OMEGA: np.concatenate([nothing, omega]),
            Column.TURN_PER_DISTANCE: np.concatenate([nothing, v]),
            Column.V_MAX: by_v_max,
            Column.SECOND_LAG: rates(in_series) - base,
        }
        motion = DrivenMotion(distance=v, turn=omega, path=v, base=self.robot.wheels.base)
        own = [self.rows.masked(np.concatenate(regressor.column(motion))) for _, regressor in self.regressors]
        A = np.stack([*(columns[column] for column in Column), *own], axis=1)
        A = np.concatenate([A, self.misread], axis=1)
        if self.structure is not None:
            A = np.concatenate([A, self.structure.family.columns], axis=1)
        return base, A

    def prior(self, terms: Sequence[Term], fit: Fit) -> BoundedPrior:
        """Return the prior of the columns, as steps from the motors of a fit."""
        return self._prior(terms, fit.motors)

    def _prior(self, terms: Sequence[Term], motors: MotorParameters) -> BoundedPrior:
        whole_share = 1.0 / SCAN.nuisance.max_tolerances  # at the bound, all of the second lag is present
        sigma = [LAG_SIGMA, self.rows.clock_sigma, *self.gain_sigmas, 0.0, whole_share]
        sigma += [regressor.tolerance for _, regressor in self.regressors]
        bounded = len(sigma)
        sigma += [1.0] * int(self.misread.shape[1])
        if self.structure is not None:
            sigma += [1.0] * self.structure.family.columns.shape[1]
        mean = np.zeros(len(sigma))
        mean[Column.LAG] = self.nominal.tau - motors.tau
        mean[Column.DELAY] = self.nominal.delay - motors.delay
        prior = BoundedPrior.of(np.array(sigma), mean, SCAN.nuisance.max_tolerances)
        return prior.freed([term.column for term in terms]).unbounded_from(bounded)

    def fit(self, terms: Iterable[Term], start: Fit | None = None) -> Fit:
        """Return the bounded optimum of a set of hypotheses, by Gauss-Newton steps."""
        terms = [*terms]
        motors: MotorParameters = self.nominal if start is None else start.motors
        has_limit = any(term.effect is SPEED_SATURATION for term in terms)
        if has_limit and not np.isfinite(motors.v_max):
            motors = replace(motors, v_max=self._first_v_max())
        if not has_limit:
            motors = replace(motors, v_max=float("inf"))
        best: Fit | None = None
        for _ in range(MAX_STEPS):
            base, A = self.linearised(motors)
            regression = Regression.of(self.whitener(A), self.whitener(self.rows.y - base))
            solution = regression.solve(self._prior(terms, motors))
            here = Fit(
                regression=regression,
                solution=solution,
                columns=A,
                y=self.rows.y,
                simulated=base,
                motors=motors,
            )
            steps = solution.theta[[Column.LAG, Column.DELAY, Column.V_MAX]]
            is_small = bool((np.abs(steps) < QUOTIENT).all())
            if best is None or is_small or here.log_posterior > best.log_posterior:
                best = here
            if is_small:
                break
            lag, delay, v_max = steps
            motors = MotorParameters(
                tau=float(max(motors.tau + lag, 0.0)),
                delay=float(motors.delay + delay),
                v_max=float(max(motors.v_max + v_max, QUOTIENT)),
            )
        assert best is not None
        return best

    def _first_v_max(self) -> float:
        """Return the start value of the maximum speed: the highest measured one, at most the largest command."""
        v, _ = by_kind(self.rows.y, self.rows.n)
        fastest = min(float(np.abs(v[self.rows.valid]).max()), self.top_speed)
        return max(fastest, QUOTIENT)

    def sized(self, term: Term, fit: Fit, error: float) -> Amendment:
        """Return an effect with its size and standard error, from the standard error of its coefficient.

        The time constant of robot.yaml may contain a second lag in series, which bends the start of a step.
        Any share of it, from none to all, is equally likely; the RMS error is the second lag over sqrt 3.
        """
        motors, nominal, blur = fit.motors, self.nominal, 0.0
        simulated: dict[int, float] = {
            Column.LAG: motors.tau - nominal.tau,
            Column.DELAY: motors.delay - nominal.delay,
            Column.V_MAX: motors.v_max,
        }
        if term.effect is DEAD_TIME:
            blur = STEP / float(np.sqrt(12))
        elif term.effect is ACTUATOR_LAG:
            share = abs(float(fit.solution.theta[Column.SECOND_LAG]))
            blur = share * _second_lag(motors) / float(np.sqrt(3))
        key = term.named.parameters[0].name
        value = float(simulated.get(term.column, 0.0) + fit.solution.theta[term.column])
        return replace(term.named(**{key: value}), stderr={key: float(np.hypot(error, blur))})

    def fit_noise(self, residual: Floats) -> None:
        """Fit the noise to a residual (2 n,), and whiten with it afterwards."""
        residual = self.rows.masked(residual)
        first, second = (
            self.fitted_noise(k, part, self.rows.valid)
            for k, part in enumerate(by_kind(residual, self.rows.n))
        )
        self.whitener = Whitener.robust((first, second), self.rows.valid, residual)

    def fitted_noise(self, kind: int, residual: Floats, valid: Bools) -> WhiteningFilter:
        """Return autoregressive noise, fitted to a residual (n,).

        Coarse ticks that are read at a high rate are 0 most of the time, and so is their robust scale. Noise
        as large as robot.yaml specifies is therefore never clipped.

        Parameters
        ----------
        kind : 0 for translation, 1 for rotation.
        """
        stated = (self.robot.wheels.sigma_v, self.robot.wheels.sigma_omega)[kind]
        limit = SCAN.goodness_of_fit.clip
        cut = clipped(residual, valid, limit, max(limit * stated, 1e-9))
        found = fit_autoregression(cut, valid, FILTER_ORDER)
        return replace(found, sigma=max(found.sigma, 1e-6))

    def error_without(self, fit: Fit, missing: Floats) -> SimulationError:
        """Return the error of a simulation that lacks rates (2 n,) [m/s, rad/s] of a fit."""
        dt = self.rows.end - self.rows.start
        distance, turn = by_kind(fit.simulated, self.rows.n)
        return simulation_error(
            distance * dt, turn * dt, missing * np.tile(dt, 2), dt, self.robot.wheels.base
        )

    def words_of(self, freed: Mapping[int, float]) -> str:
        """Return the statement of gains beyond their bounds, of speed and turn rate, and of a turn per distance [rad/m]."""
        words = {
            Column.GAIN_V: "drives {:.2f} times the commanded speed",
            Column.GAIN_OMEGA: "turns {:.2f} times the commanded rate",
            Column.TURN_PER_DISTANCE: "turns {:+.1f}° per metre driven, in addition to the command",
        }
        values = {
            Column(k): round(float(np.degrees(x)), 1) + 0.0 if k == Column.TURN_PER_DISTANCE else 1 + x
            for k, x in freed.items()
        }
        said = [words[column].format(values[column]) for column in words if column in values]
        return f"a constant gain: the base {' and '.join(said)}"

    @property
    def nominal_residual(self) -> Floats:
        """(2 n,) with the motors of robot.yaml."""
        return np.asarray(self.rows.y - self.simulation.rates(self.nominal))

    def rates_of(self, residual: Floats) -> tuple[Floats, Floats]:
        """Return speeds and turn rates [m/s, rad/s] of a residual (2 n,)."""
        v, omega = by_kind(residual, self.rows.n)
        return v[self.rows.valid], omega[self.rows.valid]


def _second_lag(motors: MotorParameters) -> float:
    """Return the second lag in series [s] that corresponds to a share of 1."""
    return min(MAX_SECOND_LAG, motors.tau / 2)


def _misread(rows: DriveRows, wheels: MotionDifference) -> Floats:
    """Return the columns (2 n, 2) of wheels that misread what the odometry channel explains, at coefficient 1."""
    middle, nothing = (rows.start + rows.end) / 2, np.zeros(rows.n)
    v, omega = (np.interp(middle, wheels.stamps, rate) for rate in wheels.rates.T)
    return rows.masked(np.stack([np.concatenate([v, nothing]), np.concatenate([nothing, omega])], axis=1))


def due_to_loop(robot: Robot, a: Amendment) -> float:
    """Return the part of a delay or a lag [s] that the control loop of the base may cause; 0 for other effects.

    Commands wait for a tick for up to a period. If `delay` contains the mean wait, all commands in phase with the loop
    exceed it by half a period. If the period is specified and `delay` is too short to contain the mean wait, the excess
    is a whole period. Waits that are uniform over a specified period smear a step like a lag equal to their standard
    deviation.
    """
    period, is_stated = robot.tolerances.control_period, "tolerances.control_period" in robot.stated
    if a.effect is DEAD_TIME:
        return period if is_stated and robot.actuators.delay < period / 2 else period / 2
    is_lag = a.effect is ACTUATOR_LAG and a["tau"] > 0 and is_stated
    return period / float(np.sqrt(12)) if is_lag else 0.0
