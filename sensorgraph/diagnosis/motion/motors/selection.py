"""Select the effects of the motors by evidence, in competition with structure that no effect explains.

Ticks of the control loop of the base and jitter of the transport are no effect. Every model that is tested for structure
contains columns for these, in units of their prior standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.diagnosis.engine import selection as engine
from sensorgraph.diagnosis.motion.consequence import sure_share
from sensorgraph.diagnosis.motion.motors.model import GAINS, Column, DriveFit, DriveModel
from sensorgraph.diagnosis.motion.motors.simulation import AccelerationLimit
from sensorgraph.diagnosis.motion.motors.structure import OTHER_MOTORS, drive_families
from sensorgraph.diagnosis.motion.regression import Term
from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.motion.structure_test import (
    AcceptedStructure,
    StructureFamily,
    StructureTest,
    TestedStructure,
)
from sensorgraph.effects import Amendment
from sensorgraph.effects.actuator_lag import ACTUATOR_LAG
from sensorgraph.effects.dead_time import DEAD_TIME
from sensorgraph.effects.speed_saturation import SPEED_SATURATION
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot

TIMING = (ACTUATOR_LAG, DEAD_TIME)
"""Effects that delay the response of the motors to a command."""
BEAT_TIME = 5.0
"""[s] over which the control loop of the base and the stamps of the commands keep their phase."""
MAX_BEATS = 24
"""Maximum number of pieces of the run with separate delays; in a longer run they are longer."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MotorSelection:
    """Selected effects of the motors, and their fit."""

    terms: tuple[Term, ...]
    fit: DriveFit
    structure: AcceptedStructure | None = None

    def log_likelihood(self, model: DriveModel) -> float:
        """Return the log-likelihood with the fitted noise, less the complexity penalty, without constants [nats]."""
        n = len(self.terms) + (len(GAINS) if model.has_any_gain else 0)
        n += 0 if self.structure is None else self.structure.family.columns.shape[1]
        return self.fit.log_posterior + model.whitener.log_likelihood - EVIDENCE.price * n


def select(model: DriveModel) -> MotorSelection:
    """Fit the noise with all effects free; then add and remove effects by evidence."""
    _fit_noise_with_all_effects(model)
    channel = MotorChannel(model, model.fit([]))
    terms = engine.select(channel, threshold=EVIDENCE.threshold, most=len(model.terms))
    return MotorSelection(terms=tuple(terms), fit=channel.fit)


class MotorChannel:
    """Effects of the motors, as hypotheses about the response to commands; `fit` is that of the present model."""

    def __init__(self, model: DriveModel, fit: DriveFit) -> None:
        self.model, self.fit = model, fit
        self._fits: dict[frozenset[Term], DriveFit] = {}

    def best(self, model: Sequence[Term]) -> tuple[Term, float] | None:
        """Return the best further effect and its evidence [nats]."""
        gains = {
            term: self._fit([*model, term]).log_posterior for term in self.model.terms if term not in model
        }
        if not gains:
            return None
        best = max(gains, key=lambda term: gains[term])
        return best, gains[best] - self.fit.log_posterior - EVIDENCE.price

    def added(self, model: Sequence[Term]) -> None:
        """Fit a changed model from the present motors."""
        self.fit = self._fit(model)
        self._fits = {}

    removed = added

    def _fit(self, model: Sequence[Term]) -> DriveFit:
        key = frozenset(model)
        if key not in self._fits:
            self._fits[key] = self.model.fit(model, self.fit.motors)
        return self._fits[key]

    def evidence(self, model: Sequence[Term], hypothesis: Term) -> float:
        """Return the evidence [nats] for an effect in addition to the others."""
        rest = [term for term in model if term != hypothesis]
        return self.fit.log_posterior - self._fit(rest).log_posterior - EVIDENCE.price

    def needed(self, model: Sequence[Term], hypothesis: Term) -> float:
        """Return the evidence [nats] that an effect needs."""
        return EVIDENCE.threshold


def _fit_noise_with_all_effects(model: DriveModel) -> None:
    """Choose where the acceleration is limited, and fit the noise with all effects free."""
    fits: dict[AccelerationLimit, DriveFit] = {}
    for limit in model.limits:
        model.simulation.limit = limit
        fits[limit] = model.fit(model.terms)
    model.simulation.limit = max(fits, key=lambda limit: fits[limit].log_posterior)
    full = fits[model.simulation.limit]
    for _ in range(2):
        model.fit_noise(model.residual(full))
        full = model.fit(model.terms, full.motors)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Leftover:
    """Residual of some motor effects, prepared for the test for structure."""

    terms: list[Term]
    fit: DriveFit
    own: Floats
    """(2 n, k) columns of the model."""
    test: StructureTest
    families: list[StructureFamily]


def _left_by(model: DriveModel, terms: Sequence[Term], here: DriveFit) -> _Leftover:
    has_limit = any(term.effect is SPEED_SATURATION for term in terms)
    own = here.columns[:, [k for k in range(model.n_own) if has_limit or k != Column.V_MAX]]
    left = model.rows.masked(model.rows.y - here.simulated)
    test = StructureTest(model.rows.valid, left, model.fitted_noise, drive_nuisances(model, here))
    return _Leftover(terms=list(terms), fit=here, own=own, test=test, families=drive_families(model, here))


def _without_timing(model: DriveModel, beside: _Leftover, family: StructureFamily) -> _Leftover | None:
    """Return the residual without lag and dead time, if motors of another kind explain the run better than both.

    A shorter lag and a longer dead time would absorb part of the response of a base that rings.
    """
    others = [term for term in beside.terms if term.effect not in TIMING]
    if family.kind not in OTHER_MOTORS or len(others) == len(beside.terms):
        return None
    plain = _left_by(model, others, model.fit(others))
    alone = max(plain.test.evidence(plain.own, one) for one in plain.families if one.kind == family.kind)
    with_timing = beside.test.evidence(beside.own)
    return plain if alone > with_timing + EVIDENCE.threshold else None


def with_structure(model: DriveModel, selected: MotorSelection) -> MotorSelection:
    """Let structure that no effect explains enter the model, in addition to the effects or instead of them."""
    beside, stands_for_material = _left_by(model, selected.terms, selected.fit), False
    family, gain = beside.test.best(beside.own, beside.families)
    if gain >= EVIDENCE.threshold and (plain := _without_timing(model, beside, family)) is not None:
        gone = [term for term in beside.terms if term not in plain.terms]
        stands_for_material = any(_is_large(model, term, beside.fit) for term in gone)
        beside = plain
        family, gain = beside.test.best(beside.own, beside.families)
    terms, here, own, test, families = beside.terms, beside.fit, beside.own, beside.test, beside.families
    model.tested = TestedStructure(families=dict(test.tested), threshold=EVIDENCE.threshold)
    if gain < EVIDENCE.threshold:
        return selected
    size = model.error_without(here, test.explained(own, [family]))
    is_material = stands_for_material or size.is_material(model.robot.limits.v, gain)
    changed = _coefficients(test, own, family) if family.least_change else np.zeros(0)
    if family.least_change:
        sure_change = sure_share(gain) * float(np.ptp(np.append(changed, 0.0)))
        is_material = stands_for_material or sure_change >= family.least_change
    found = AcceptedStructure(family=family, evidence=gain, threshold=EVIDENCE.threshold, size=size)
    model.tested = replace(model.tested, best=found, is_material=is_material)
    if not is_material:
        return selected
    rivals = [text for other in test.ranking(own, families) if (text := other.statement) != family.statement]
    if len(changed) == 1:
        family = replace(family, statement=f"{family.statement}, by {1000 * changed[0]:+.0f} ms")
    model.structure = family
    full = model.fit(terms, here.motors)
    model.fit_noise(model.residual(full))
    channel = MotorChannel(model, model.fit(terms, full.motors))
    engine.remove_superfluous(channel, terms)
    return MotorSelection(
        terms=tuple(terms), fit=channel.fit, structure=replace(found, family=family, rivals=rivals[:2])
    )


def _is_large(model: DriveModel, term: Term, fit: DriveFit) -> bool:
    return abs(model.size_of(term, fit)) >= max(term.effect.sizes.values())


def _coefficients(test: StructureTest, own: Floats, family: StructureFamily) -> Floats:
    """Return the coefficients (k,) of a family, fitted together with the model's own columns (2 n, .)."""
    columns = np.concatenate([own, test.nuisances, family.columns], axis=1)
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
    explained = test.explained(own, [family])
    found = np.linalg.lstsq(columns / scale, explained, rcond=None)[0] / scale
    return np.asarray(found[-family.columns.shape[1] :])


def drive_nuisances(model: DriveModel, fit: DriveFit) -> Floats:
    """Return the columns (2 n, m) of normal differences between commands and odometry."""
    rows = model.rows
    delays = delay_sigma(model.robot.tolerances.control_period, model.robot.tolerances.transport_jitter)
    n = int(np.clip(np.ptp(rows.end) / BEAT_TIME, 1, MAX_BEATS))
    piece = np.clip(n * (rows.end - rows.end[0]) / np.ptp(rows.end), 0, n - 1).astype(np.intp)
    by_delay = fit.columns[:, Column.DELAY] * delays
    return rows.masked(np.stack([by_delay * np.tile(piece == k, 2) for k in range(n)], axis=1))


def delay_sigma(control_period: float, transport_jitter: float) -> float:
    """Return the standard deviation of a command's delay [s].

        delay_sigma² = control_period² / 12 + transport_jitter²

    The wait for a tick of the base is uniform over one period.
    """
    return float(np.hypot(control_period / np.sqrt(12), transport_jitter))


def due_to_loop(robot: Robot, a: Amendment) -> float:
    """Return the part of a delay or a lag [s] that the control loop of the base may cause; 0 for other effects."""
    if a.effect is DEAD_TIME:
        return longest_wait(robot)
    return stated_smear(robot) if a.effect is ACTUATOR_LAG and a["tau"] > 0 else 0.0


def longest_wait(robot: Robot) -> float:
    """Return the maximum delay [s] of all commands beyond robot.yaml, if they are in phase with the control loop.

    Commands wait for a tick for up to a period. If `delay` contains the mean wait, the excess is half a
    period. If the period is specified and `delay` is too short to contain the mean wait, the excess is a
    whole period.
    """
    period = robot.tolerances.control_period
    is_beside = _is_period_stated(robot) and robot.actuators.delay < period / 2
    return period if is_beside else period / 2


def stated_smear(robot: Robot) -> float:
    """Return the apparent lag [s] of commands that each wait for the next tick of the specified loop.

    Waits that are uniform over a period smear a step like a lag equal to their standard deviation. The result
    is 0 if no period is specified.
    """
    return robot.tolerances.control_period / float(np.sqrt(12)) if _is_period_stated(robot) else 0.0


def _is_period_stated(robot: Robot) -> bool:
    return "tolerances.control_period" in robot.stated
