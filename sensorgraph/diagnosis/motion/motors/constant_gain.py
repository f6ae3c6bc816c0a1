"""A base that drives, or turns, a constant share of what it is told: more than a tolerance, and no effect of the library.

How far the odometry misreads the wheels is a tolerance of the model (`DRIVE.gain_sigma`), within bounds. A gain beyond
these is the base's own, unless wheels that are counted wrongly, as the odometry channel has named them, make it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.motion.consequence import simulation_error
from sensorgraph.diagnosis.motion.motors.model import GAINS, Column, DriveModel
from sensorgraph.diagnosis.motion.motors.selection import MotorSelection, select
from sensorgraph.diagnosis.motion.settings import DRIVE, EVIDENCE
from sensorgraph.diagnosis.motion.structure_test import AcceptedStructure, StructureFamily
from sensorgraph.diagnosis.motion.whitening import both_kinds
from sensorgraph.effects import Amendment
from sensorgraph.effects.wheel_base import WHEEL_BASE
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS

MOTIONS = {Column.GAIN_V: "drives {:.2f} times the speed", Column.GAIN_OMEGA: "turns {:.2f} times the rate"}
"""What a gain is of, in words."""
AT_BOUND = 1 - 1e-6
"""Share of a bound from which on a coefficient lies at it."""


def select_under_any_gain(model: DriveModel) -> tuple[DriveModel, MotorSelection]:
    """Select effects under gains within tolerance; under any gain, where one lies at its bound and that is likelier.

    What a gain may not take at its bound is left for effects to explain.
    """
    within = select(model)
    gains = within.fit.solution.theta[list(GAINS)]
    if (np.abs(gains) < AT_BOUND * _tolerance()).all():
        return model, within
    free = model.with_any_gain()
    found = select(free)
    return (free, found) if _lead(free, found, within) > EVIDENCE.threshold else (model, within)


def with_constant_gain(
    model: DriveModel, selected: MotorSelection, wheels: Iterable[Amendment]
) -> MotorSelection:
    """Let a gain stand beside the effects that is surely beyond tolerance as the odometry reads it, and is so, too, without
    the named errors of the wheels.

    Parameters
    ----------
    wheels : what the odometry channel has named
    """
    if not model.has_any_gain or selected.structure is not None:
        return selected
    fit, tolerance = selected.fit, _tolerance()
    covariance = fit.regression.clustered_covariance(fit.solution, model.clusters)
    read, beyond = _read_by_wheels(wheels), list[Column]()
    for column in GAINS:
        gain, doubt = 1 + float(fit.solution.theta[column]), 2 * float(np.sqrt(covariance[column, column]))
        if min(abs(gain - 1), abs(gain / read[column] - 1)) - doubt > tolerance:
            beyond.append(column)
    if not beyond:
        return selected
    said = " and ".join(MOTIONS[column].format(1 + fit.solution.theta[column]) for column in beyond)
    columns, dt = fit.columns[:, beyond], model.rows.end - model.rows.start
    distance, turn = both_kinds(fit.simulated, model.rows.n)
    missing = columns @ fit.solution.theta[beyond] * np.concatenate([dt, dt])
    structure = AcceptedStructure(
        family=StructureFamily(
            kind="constant gain",
            columns=columns,
            labels=[],
            sigma=DRIVE.structure.gain_sigma,
            statement=f"by a constant gain: the base {said} commanded",
        ),
        evidence=_lead(model, selected, selected),
        threshold=EVIDENCE.threshold,
        size=simulation_error(distance * dt, turn * dt, missing, dt, model.robot.wheels.base),
    )
    return replace(selected, structure=structure)


def _tolerance() -> float:
    """Return by how much a gain may differ from 1 and be a tolerance of a careful set-up."""
    return EVIDENCE.max_tolerances * DRIVE.gain_sigma


def _lead(free: DriveModel, found: MotorSelection, within: MotorSelection) -> float:
    """Return how much likelier [nats] the run is under any gain, less the price of gains and effects, under one noise."""
    held = free.with_any_gain(False).fit(within.terms, within.fit.motors)
    price = EVIDENCE.price * (len(GAINS) + len(found.terms) - len(within.terms))
    return found.fit.log_posterior - held.log_posterior - price


def _read_by_wheels(wheels: Iterable[Amendment]) -> dict[Column, float]:
    """Return how many times the base's way and turn the odometry reads, by what is named of the wheels."""
    read = dict.fromkeys(GAINS, 1.0)
    for amendment in wheels:
        if amendment.effect is WHEEL_RADIUS:
            read = {column: gain * (1 + amendment["s"]) for column, gain in read.items()}
        if amendment.effect is WHEEL_BASE:
            read[Column.GAIN_OMEGA] /= 1 + amendment["s"]
    return read
