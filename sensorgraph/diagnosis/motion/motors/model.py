"""Regression of odometry on simulated motors, by Gauss-Newton, with tolerances of motors and odometry.

    y = simulated + A theta + noise

A contains the derivatives of the simulated rates by the motor parameters, the gains, and columns of
structure. The error of the odometry is a nuisance: a gain of a few per cent, a turn in proportion to speed,
and a clock offset within the accuracy that the reference poses give.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from sensorgraph.diagnosis.motion.consequence import SimulationError, simulation_error
from sensorgraph.diagnosis.motion.motors.rows import CommandSignal, DriveRows
from sensorgraph.diagnosis.motion.motors.simulation import (
    AccelerationLimit,
    MotorParameters,
    MotorSimulation,
)
from sensorgraph.diagnosis.motion.regression import (
    SHUT_SIGMA,
    BoundedPrior,
    Regression,
    RegressionFit,
    Term,
    clusters_of,
)
from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.motion.structure_test import StructureFamily, TestedStructure
from sensorgraph.diagnosis.motion.whitening import (
    Whitener,
    WhiteningFilter,
    both_kinds,
    clipped,
    fit_autoregression,
)
from sensorgraph.diagnosis.result import MotionDifference
from sensorgraph.effects import EFFECTS, Effect
from sensorgraph.effects.actuator_lag import ACTUATOR_LAG
from sensorgraph.effects.dead_time import DEAD_TIME
from sensorgraph.effects.interfaces import MotorMotion, MotorRegressor
from sensorgraph.effects.speed_saturation import SPEED_SATURATION
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Robot

QUOTIENT = 0.004
"""[s or m/s] step of the difference quotients."""
TAU_RANGE = (1e-3, 3.0)
"""[s] minimum and maximum time constant."""
LAG_SIGMA = 0.004
"""[s] tolerance of the time constant."""
SECOND_LAG_SIGMA = 0.4
"""Prior standard deviation of the share of this lag that is present."""
MIN_TOP_SPEED = 0.05
"""[m/s] minimum largest command, for a saturation to be tested."""
MAX_STEPS = 6
MAX_STEP = 0.1
"""[s or m/s] maximum step of time constant, dead time and maximum speed."""
MIN_V_MAX = 0.02
"""[m/s] lower limit of the maximum speed."""
CONVERGED = 1e-3
"""[s or m/s] step below which the fit has converged."""
CONTROL_STEP = 0.003
"""[s] error of a dead time due to the step of the controller."""
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


GAINS = (Column.GAIN_V, Column.GAIN_OMEGA, Column.TURN_PER_DISTANCE)
"""Possible errors of the odometry in every motion: gain of the distance, gain of the turn, turn per distance."""


SIMULATED_TERMS = (
    Term(ACTUATOR_LAG, Column.LAG),
    Term(DEAD_TIME, Column.DELAY),
    Term(SPEED_SATURATION, Column.V_MAX),
)
"""Effects that are parameters of the simulated motors."""


@dataclass(frozen=True, kw_only=True)
class MotorColumns:
    """Order of the columns: those of `Column`, one for each other motor effect, then structure."""

    regressors: tuple[tuple[Effect, MotorRegressor], ...]
    """Motor effects with a separate column, in the order of the library."""

    @classmethod
    def of_library(cls) -> MotorColumns:
        """Return the columns of the effects in the library."""
        found = [(effect, effect.diagnostics.motor_regressor) for effect in EFFECTS.values()]
        return cls(
            regressors=tuple((effect, regressor) for effect, regressor in found if regressor is not None)
        )

    @property
    def terms(self) -> tuple[Term, ...]:
        """All effects of the motors."""
        own = (Term(effect, k) for k, (effect, _) in enumerate(self.regressors, start=len(Column)))
        return (*SIMULATED_TERMS, *own)

    @property
    def n(self) -> int:
        """Number of columns before those of structure."""
        return len(Column) + len(self.regressors)


@dataclass(frozen=True, kw_only=True, eq=False)
class DriveFit:
    """Fitted motors for a set of effects, and the linear system at the fit."""

    motors: MotorParameters
    regression: Regression
    solution: RegressionFit
    simulated: Floats
    """(2 n,)"""
    columns: Floats
    """(2 n, n_own + structure)"""

    @property
    def log_posterior(self) -> float:
        """[nats]"""
        return self.solution.log_posterior


class DriveModel:
    """One run's regression of odometry on commands."""

    def __init__(
        self, commands: CommandSignal, rows: DriveRows, robot: Robot, wheels: MotionDifference | None = None
    ) -> None:
        """Set up the regression.

        Parameters
        ----------
        wheels : Motion that the odometry channel explains by slip or structure; the wheels may have misread
            it.
        """
        self.rows, self.robot = rows, robot
        self.top_speed = commands.top_speed
        limits = robot.limits
        self.simulation = MotorSimulation(commands, rows, np.array([limits.a, limits.alpha]))
        self.clusters = clusters_of(rows.start)
        self.whitener = self.stated_noise()
        self.nominal = MotorParameters(tau=robot.actuators.tau, delay=robot.actuators.delay)
        self.structure: StructureFamily | None = None
        self.tested: TestedStructure | None = None
        """Test for structure, for the ledger."""
        self.layout = MotorColumns.of_library()
        self.library_terms = self.layout.terms
        self.misread = np.zeros((2 * rows.n, 0)) if wheels is None else _misread(rows, wheels)
        self.has_any_gain = False
        """Whether the gains have no bounds."""
        self.limits: tuple[AccelerationLimit, ...] = (AccelerationLimit.MOTORS, AccelerationLimit.NOWHERE)
        """Where the acceleration may be limited."""

    def with_ramped_set_point(self) -> DriveModel:
        """Return a model, with separate noise, of a base that ramps the commands to its motors."""
        model = self.with_any_gain(False)
        model.structure, model.limits = None, (AccelerationLimit.SET_POINT,)
        model.whitener = model.stated_noise()
        return model

    def stated_noise(self) -> Whitener:
        """Return white noise as specified in robot.yaml."""
        sigmas = (self.robot.wheels.sigma_v, self.robot.wheels.sigma_omega)
        first, second = (WhiteningFilter.white(FILTER_ORDER, sigma) for sigma in sigmas)
        return Whitener.plain((first, second), self.rows.valid)

    def with_any_gain(self, has_any: bool = True) -> DriveModel:
        """Return a copy of the model, with separate noise, whose gains have no bounds, or have bounds again."""
        model = copy(self)
        model.simulation, model.has_any_gain = copy(self.simulation), has_any
        return model

    @property
    def n_own(self) -> int:
        """Number of columns before those of structure."""
        return self.layout.n + int(self.misread.shape[1])

    @property
    def terms(self) -> list[Term]:
        """Effects that this run could show."""
        can_saturate = self.top_speed > MIN_TOP_SPEED
        return [term for term in self.library_terms if term.effect is not SPEED_SATURATION or can_saturate]

    def linearised(self, motors: MotorParameters) -> tuple[Floats, Floats]:
        """Return the simulated rows (2 n,) and the columns (2 n, n_own + structure)."""
        rates = self.simulation.rates
        base = rates(motors)
        step = QUOTIENT
        second = _second_lag(motors)
        in_series = replace(motors, tau=motors.tau - second, second=second)
        v, omega = both_kinds(base, self.rows.n)
        nothing = np.zeros(self.rows.n)
        by_v_max = np.zeros(2 * self.rows.n)
        if np.isfinite(motors.v_max):
            slower = replace(motors, v_max=max(motors.v_max - step, 1e-3))
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
        motion = MotorMotion(v=v, omega=omega, duration=self.rows.end - self.rows.start)
        own = [
            self.rows.masked(np.concatenate(regressor.column(motion)))
            for _, regressor in self.layout.regressors
        ]
        A = np.stack([*(columns[column] for column in Column), *own], axis=1)
        A = np.concatenate([A, self.misread], axis=1)
        if self.structure is not None:
            A = np.concatenate([A, self.structure.columns], axis=1)
        return base, A

    def prior(self, terms: Sequence[Term], motors: MotorParameters) -> BoundedPrior:
        """Return the prior of the columns, as steps from `motors`."""
        base = self.robot.wheels.base
        sigma = np.array(
            [
                LAG_SIGMA,
                self.rows.clock_sigma,
                GAIN_SIGMA,
                GAIN_SIGMA,
                TURN_SIGMA / base,
                SHUT_SIGMA,
                SECOND_LAG_SIGMA,
                *(regressor.tolerance for _, regressor in self.layout.regressors),
            ]
        )
        n_more = 0 if self.structure is None else self.structure.columns.shape[1]
        sigma = np.concatenate([sigma, np.ones(self.misread.shape[1] + n_more)])
        mean = np.zeros(len(sigma))
        mean[Column.LAG] = self.nominal.tau - motors.tau
        mean[Column.DELAY] = self.nominal.delay - motors.delay
        if self.has_any_gain:
            sigma[list(GAINS)] = EVIDENCE.scale_sigma / np.array([1.0, 1.0, base])
        prior = BoundedPrior.of(sigma, mean, EVIDENCE.max_tolerances)
        if self.has_any_gain:
            prior.reach[list(GAINS)] = np.inf
        return prior.freed([term.column for term in terms]).unbounded_from(self.layout.n)

    def fit(self, terms: Sequence[Term], start: MotorParameters | None = None) -> DriveFit:
        """Return the bounded optimum of a set of effects, by Gauss-Newton steps."""
        motors = start or self.nominal
        has_limit = any(term.effect is SPEED_SATURATION for term in terms)
        if has_limit and not np.isfinite(motors.v_max):
            motors = replace(motors, v_max=self._first_v_max())
        if not has_limit:
            motors = replace(motors, v_max=float("inf"))
        best: DriveFit | None = None
        for _ in range(MAX_STEPS):
            base, A = self.linearised(motors)
            regression = Regression.of(self.whitener(A), self.whitener(self.rows.y - base))
            solution = regression.solve(self.prior(terms, motors))
            here = DriveFit(
                motors=motors, regression=regression, solution=solution, simulated=base, columns=A
            )
            steps = solution.theta[[Column.LAG, Column.DELAY, Column.V_MAX]]
            is_small = bool((np.abs(steps) < CONVERGED).all())
            if best is None or is_small or here.log_posterior > best.log_posterior:
                best = here
            if is_small:
                break
            lag, delay, v_max = np.clip(steps, -MAX_STEP, MAX_STEP)
            motors = MotorParameters(
                tau=float(np.clip(motors.tau + lag, *TAU_RANGE)),
                delay=float(motors.delay + delay),
                v_max=float(max(motors.v_max + v_max, MIN_V_MAX)),
            )
        assert best is not None
        return best

    def _first_v_max(self) -> float:
        """Return the start value of the maximum speed: the highest measured one, at most the largest command."""
        v, _ = both_kinds(self.rows.y, self.rows.n)
        fastest = min(float(np.abs(v[self.rows.valid]).max()), self.top_speed)
        return max(fastest, MIN_V_MAX)

    def size_of(self, term: Term, fit: DriveFit) -> float:
        """Return the parameter of an effect in a fit."""
        motors, nominal = fit.motors, self.nominal
        simulated: dict[int, float] = {
            Column.LAG: motors.tau - nominal.tau,
            Column.DELAY: motors.delay - nominal.delay,
            Column.V_MAX: motors.v_max,
        }
        return float(simulated.get(term.column, 0.0) + fit.solution.theta[term.column])

    def blur_of(self, term: Term, fit: DriveFit) -> float:
        """Return the uncertainty [unit of the parameter] of an effect that more data does not reduce.

        The time constant of robot.yaml may contain a second lag in series, which bends the start of a step.
        Any share of it, from none to all, is equally likely; the RMS error is the second lag over sqrt 3.
        """
        if term.effect is DEAD_TIME:
            return CONTROL_STEP
        if term.effect is not ACTUATOR_LAG:
            return 0.0
        second = abs(float(fit.solution.theta[Column.SECOND_LAG])) * _second_lag(fit.motors)
        return second / float(np.sqrt(3))

    def fit_noise(self, residual: Floats) -> None:
        """Fit the noise to a residual (2 n,), and whiten with it afterwards."""
        first, second = (
            self.fitted_noise(k, part, self.rows.valid)
            for k, part in enumerate(both_kinds(residual, self.rows.n))
        )
        self.whitener = Whitener.robust((first, second), self.rows.valid, residual, EVIDENCE.huber_limit)

    def fitted_noise(self, kind: int, residual: Floats, valid: Bools) -> WhiteningFilter:
        """Return autoregressive noise, fitted to a residual (n,).

        Coarse ticks that are read at a high rate are 0 most of the time, and so is their robust scale. Noise
        as large as robot.yaml specifies is therefore never clipped.

        Parameters
        ----------
        kind : 0 for translation, 1 for rotation.
        """
        stated = (self.robot.wheels.sigma_v, self.robot.wheels.sigma_omega)[kind]
        limit = EVIDENCE.clip_limit
        cut = clipped(residual, valid, limit, max(limit * stated, 1e-9))
        found = fit_autoregression(cut, valid, FILTER_ORDER)
        return replace(found, sigma=max(found.sigma, 1e-6))

    def error_without(self, fit: DriveFit, missing: Floats) -> SimulationError:
        """Return the error of a simulation that lacks rates (2 n,) [m/s, rad/s] of a fit."""
        dt = self.rows.end - self.rows.start
        distance, turn = both_kinds(fit.simulated, self.rows.n)
        return simulation_error(
            distance * dt, turn * dt, missing * np.tile(dt, 2), dt, self.robot.wheels.base
        )

    def residual(self, fit: DriveFit) -> Floats:
        """Return the residual (2 n,) of a fit."""
        return self.rows.masked(self.rows.y - fit.simulated - fit.columns @ fit.solution.theta)


def _second_lag(motors: MotorParameters) -> float:
    """Return the second lag in series [s] that corresponds to a share of 1."""
    return min(MAX_SECOND_LAG, motors.tau / 2)


def _misread(rows: DriveRows, wheels: MotionDifference) -> Floats:
    """Return the columns (2 n, 2) of wheels that misread what the odometry channel explains, at coefficient 1."""
    middle, nothing = (rows.start + rows.end) / 2, np.zeros(rows.n)
    v, omega = (np.interp(middle, wheels.stamps, rate) for rate in wheels.rates.T)
    return rows.masked(np.stack([np.concatenate([v, nothing]), np.concatenate([nothing, omega])], axis=1))
