"""Motion across the heading, which the wheels do not measure and no effect of the library explains.

A body may slide outward in a curve, the floor may carry it sideways, or the heading of the reference may
change. All of these move the body to its left or right, which neither distance nor turn shows. A constant
heading error of the reference, and a centre of rotation ahead of or behind `base_link`, belong to the setup
and are free in every model here. An angle is reported only if it is larger than the usual misalignment of
markers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.diagnosis.motion.consequence import SimulationError, simulation_error, sure_share
from sensorgraph.diagnosis.motion.reference_noise import LimitedNoiseFitter, NoiseLimits, noise_limits
from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.motion.structure_test import (
    AcceptedStructure,
    ScreenedFamily,
    StructureFamily,
    StructureTest,
    TestedStructure,
)
from sensorgraph.diagnosis.motion.wheels.model import STRUCTURE_THRESHOLD, WheelModel, clock_sigma
from sensorgraph.diagnosis.motion.wheels.rows import OdometryRows
from sensorgraph.types import Floats

MAX_ASKEW = 0.035
"""[rad] maximum misalignment of the heading of a reference that counts as setup: 2°."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SidewaysRows:
    """Motion of the body across its heading, row by row, and the variables that explain it."""

    y: Floats
    """(n,) [m] to the left, less the part that the wheels explain; 0 where not valid."""
    distance: Floats
    """(n,) [m] of the wheels."""
    turn: Floats
    """(n,) [rad] of the wheels."""
    rate: Floats
    """(n,) [rad/s] of the wheels' turns."""
    heading: Floats
    """(n,) [rad] in the map."""


def sideways_rows(model: WheelModel) -> SidewaysRows:
    """Return the rows of a model across the heading."""
    rows, wheels = model.rows, model.motion
    turn = rows.D_yaw @ wheels.turn
    return SidewaysRows(
        y=rows.masked(rows.across - rows.D_across @ wheels.distance),
        distance=rows.D_along @ wheels.distance,
        turn=turn,
        rate=turn / np.gradient(rows.stamps),
        heading=rows.poses[:, 2],
    )


def sideways_structure(model: WheelModel, *, heading_is_of_base: bool) -> AcceptedStructure | None:
    """Return the structure with the most evidence that moves the body sideways; None if none is material.

    Parameters
    ----------
    heading_is_of_base : The reference measures the heading of the base itself, and not that of a laser whose
        mount may be wrong.
    """
    aside = sideways_rows(model)
    limits = noise_limits(model.robot, model.wheels, model.rows.stamps)
    found = [_sliding(model, aside, limits), _askew(model, aside, limits) if heading_is_of_base else None]
    return max((one for one in found if one is not None), key=lambda one: one.evidence, default=None)


def _askew(
    model: WheelModel, aside: SidewaysRows, limits: tuple[NoiseLimits, NoiseLimits]
) -> AcceptedStructure | None:
    """Return a body that moves at an angle to its heading, if it exceeds the usual misalignment of markers."""
    rows = model.rows
    test = StructureTest(rows.valid, aside.y, LimitedNoiseFitter(limits))
    own, distance = rows.masked(aside.turn[:, None]), rows.masked(aside.distance)
    family = StructureFamily(kind="askew", columns=distance[:, None], statement="")
    gain, missing = test.gain(own, family), test.explained(own, [family])
    angle = float(distance @ missing) / max(float(distance @ distance), 1e-12)
    needed = STRUCTURE_THRESHOLD * test.dispersion(EVIDENCE.cluster, limits[0].period)
    side = "left" if angle > 0 else "right"
    words = f"a direction of travel {np.degrees(abs(angle)):.1f}° to the {side} of the body's heading"
    family = replace(family, statement=f"{words}: the axle or the markers of the reference are misaligned")
    size = _size(model, aside, missing)
    found = AcceptedStructure(family=family, evidence=gain, threshold=needed, size=size)
    is_large = sure_share(gain) * abs(angle) >= MAX_ASKEW
    best = found if gain >= needed else None
    model.tested.append(
        TestedStructure(
            families={family.kind: ScreenedFamily(family=family, evidence=gain, price=0.0)},
            threshold=needed,
            best=best,
            is_material=is_large,
        )
    )
    return best if is_large else None


def _sliding(
    model: WheelModel, aside: SidewaysRows, limits: tuple[NoiseLimits, NoiseLimits]
) -> AcceptedStructure | None:
    """Return sideways motion other than a constant angle, if it matters to a user."""
    rows = model.rows
    # positions older than the headings also look like sliding in curves; allow the tolerance of a clock
    nuisance = clock_sigma(model.robot) * (aside.distance * aside.rate)[:, None]
    noise = LimitedNoiseFitter(limits)
    test = StructureTest(rows.valid, aside.y, noise, rows.masked(nuisance))
    own = rows.masked(np.stack([aside.distance, aside.turn], axis=1))
    families = sideways_families(rows, aside)
    family, gain = test.best(own, families)
    needed = STRUCTURE_THRESHOLD * test.dispersion(EVIDENCE.cluster, limits[0].period)
    if gain < needed:
        model.tested.append(TestedStructure(families=test.tested, threshold=needed))
        return None
    # the size of all sliding; with the nuisance, the clock would absorb a part
    missing = StructureTest(rows.valid, aside.y, noise).explained(own, [family])
    size = _size(model, aside, missing)
    is_material = size.is_material(model.robot.limits.v, gain)
    rivals = (
        [one.statement for one in test.ranking(own, families) if one is not family] if is_material else []
    )
    found = AcceptedStructure(
        family=family, evidence=gain, threshold=needed, size=size, rivals=tuple(rivals[:2])
    )
    model.tested.append(
        TestedStructure(families=test.tested, threshold=needed, best=found, is_material=is_material)
    )
    return found if is_material else None


def sideways_families(rows: OdometryRows, aside: SidewaysRows) -> list[StructureFamily]:
    """Return the families of sideways motion, with columns (n, k)."""
    backward, to_right = aside.distance < 0, aside.turn < 0
    way = np.abs(aside.distance)
    piece = np.arange(len(aside.y)) * EVIDENCE.n_pieces // len(aside.y)
    pieces = [piece == k for k in range(1, EVIDENCE.n_pieces)]
    kinds: list[tuple[str, str, list[Floats]]] = [
        (
            "sideways curve",
            "sideways sliding in curves, or positions that are older than the headings",
            [aside.distance * aside.rate],
        ),
        (
            "sideways direction",
            "a sideways motion that differs forward and backward, or to the left and to the right",
            [aside.distance * backward, aside.turn * to_right],
        ),
        (
            "sideways heading",
            "a sideways motion that depends on the heading",
            [-way * np.sin(aside.heading), way * np.cos(aside.heading)],
        ),
        (
            "sideways time",
            "a sideways motion from a heading error that changes over time",
            [aside.distance * part for part in pieces],
        ),
    ]
    return [
        StructureFamily(
            kind=kind,
            columns=rows.masked(np.stack(columns, axis=1)),
            statement=statement,
        )
        for kind, statement, columns in kinds
    ]


def _size(model: WheelModel, aside: SidewaysRows, missing: Floats) -> SimulationError:
    """Return the error of a simulation that lacks the motion (n,) [m] across the heading."""
    return simulation_error(
        aside.distance,
        aside.turn,
        np.zeros(2 * len(missing)),
        np.gradient(model.rows.stamps),
        model.robot.wheels.base,
        missing,
    )
