"""Speed residuals that last for seconds: the noise model absorbs them, although they matter to a user.

Noise is fitted to the run, so that a residual that is smooth in time costs little evidence. A sloped floor or
a link that loses commands may therefore be absorbed. The speed of a normal base is not off for two seconds by
more than the noise of its wheels and the waits of its commands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.diagnosis.motion.consequence import SimulationError
from sensorgraph.diagnosis.motion.motors.model import DriveModel
from sensorgraph.diagnosis.motion.motors.nuisances import delay_sigma
from sensorgraph.diagnosis.motion.motors.selection import MotorSelection
from sensorgraph.diagnosis.motion.motors.structure import drive_families
from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.motion.structure_test import AcceptedStructure, StructureFamily
from sensorgraph.diagnosis.motion.whitening import both_kinds
from sensorgraph.types import Floats, Ints

SLOW = "slow"
"""Kind of the family of slow residuals. Its only column (2 n, 1) is the residual itself, without a regression."""
SURE_SIGMAS = 2.0
"""Standard deviations of the mean of a block that do not count."""
TOLD_SHARE = 0.5
"""Minimum share of the slow residual that a family must explain for its statement to be used."""


def with_slow_leftover(model: DriveModel, selected: MotorSelection) -> MotorSelection:
    """Add the slow residual as structure if it matters to a user and there is no other structure."""
    if selected.structure is not None:
        return selected
    left = _slow_part(model, selected)
    size = replace(left.size, drift=0.0)
    if left.evidence < EVIDENCE.threshold or not size.is_material(model.robot.limits.v, left.evidence):
        return selected
    likely = _likely_families(left, drive_families(model, selected.fit))
    words = [family.statement for family in likely[:2]]
    statement = (
        "a speed error that lasts for seconds, beyond the noise of the wheels and the waits of commands"
    )
    return replace(
        selected,
        structure=AcceptedStructure(
            family=StructureFamily(
                kind=SLOW,
                columns=left.rates[:, None],
                sigma=1.0,
                statement=words[0] if words else statement,
            ),
            evidence=left.evidence,
            threshold=EVIDENCE.threshold,
            size=left.size,
            rivals=words[1:],
        ),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _SlowPart:
    """Means of the residual over blocks of two seconds."""

    block: Ints
    """(n,) block of each row; -1 for rows that do not count, as in blocks of few rows."""
    means: Floats
    """(2, n_blocks) [m/s, rad/s]"""
    evidence: float
    """[nats] beyond the noise of the wheels and the waits."""
    size: SimulationError
    rates: Floats
    """(2 n,) [m/s, rad/s] certain part of the residual of each row."""


def _slow_part(model: DriveModel, selected: MotorSelection) -> _SlowPart:
    rows, robot = model.rows, model.robot
    cluster = model.clusters[: rows.n]
    n_rows = np.bincount(cluster, rows.valid)
    block = np.where(rows.valid, cluster, -1)
    left = both_kinds(model.residual(selected.fit), rows.n)
    means = np.stack([_means(part, block, len(n_rows)) for part in left])
    stated = np.array([robot.wheels.sigma_v, robot.wheels.sigma_omega])[:, None]
    noise = stated / np.sqrt(np.maximum(n_rows, 1))
    sigma = np.hypot(noise, _by_waits(model, len(n_rows)))
    z2 = np.square(means / np.maximum(sigma, 1e-12))
    beyond = np.square(means) - np.square(SURE_SIGMAS * sigma)
    sure = np.sign(means) * np.sqrt(np.maximum(beyond, 0.0))
    enough = n_rows > 0.5 * np.median(n_rows[n_rows > 0])
    sure = np.where(enough, sure, 0.0)
    excess = np.maximum(z2, 1.0)[:, enough]
    rates = np.concatenate([part[cluster] for part in sure])
    return _SlowPart(
        block=np.where(enough[cluster], block, -1),
        means=np.where(enough, means, 0.0),
        evidence=0.5 * float((excess - 1 - np.log(excess)).sum()),
        size=model.error_without(selected.fit, rates),
        rates=rates,
    )


def _means(part: Floats, block: Ints, n_blocks: int) -> Floats:
    """Return the means (n_blocks,) of rows (n,) over their blocks; 0 for empty blocks."""
    some = block >= 0
    sums = np.bincount(block[some], part[some], minlength=n_blocks)
    return np.asarray(sums / np.maximum(np.bincount(block[some], minlength=n_blocks), 1))


def _by_waits(model: DriveModel, n_blocks: int) -> Floats:
    """Return the standard deviation of each block mean (2, n_blocks) due to the waits of the commands."""
    commands, tolerances = model.simulation.commands, model.robot.tolerances
    wait = delay_sigma(tolerances.control_period, tolerances.transport_jitter)
    block = np.floor((commands.stamps[1:] - model.rows.start[0]) / EVIDENCE.cluster).astype(np.intp)
    inside = (block >= 0) & (block < n_blocks)
    block, steps = block[inside], np.square(np.diff(commands.values, axis=0))[inside]
    return np.stack(
        [wait * np.sqrt(np.bincount(block, s, minlength=n_blocks)) / EVIDENCE.cluster for s in steps.T]
    )


def _likely_families(left: _SlowPart, families: Sequence[StructureFamily]) -> list[StructureFamily]:
    """Return the families that explain most of the slow residual, most likely first."""
    y, n_blocks, n = left.means.ravel(), left.means.shape[1], len(left.block)
    told: list[tuple[float, StructureFamily]] = []
    for family in families:
        columns = [
            np.concatenate([_means(part, left.block, n_blocks) for part in both_kinds(c, n)])
            for c in family.columns.T
        ]
        A = np.stack(columns, axis=1)
        coefficients = np.linalg.lstsq(A, y, rcond=1e-9)[0]
        freedom = max(len(y) - A.shape[1], 1) / len(y)
        share = (
            1
            - float(np.square(y - A @ coefficients).sum()) / max(float(np.square(y).sum()), 1e-300) / freedom
        )
        if share > TOLD_SHARE:
            told.append((share, family))
    best = sorted(told, key=lambda one: -one[0])
    out: dict[str, StructureFamily] = {}
    for _, family in best:
        out.setdefault(family.kind, family)
    return list(out.values())
