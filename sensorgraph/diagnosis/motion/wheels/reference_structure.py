"""Families of structure in the reference poses: distorted over the place, or jumping."""

from __future__ import annotations

import numpy as np
from scipy.special import gammaln

from sensorgraph.diagnosis.motion.structure_test import StructureFamily
from sensorgraph.diagnosis.motion.wheels.rows import OdometryRows
from sensorgraph.robust import robust_sigma
from sensorgraph.types import Floats

REFERENCE_YAW, REFERENCE_PLACE = "reference yaw", "reference place"
BENT_REFERENCE = (REFERENCE_YAW, REFERENCE_PLACE)
"""Kinds of the families of a reference that is distorted over the place."""

HIGHEST_WAVE = 5
"""Exclusive upper limit of the half waves of a distorted yaw along each axis."""
HIGHEST_WAVES = 7
"""Exclusive upper limit of the half waves of both axes together."""
HIGHEST_POWER = 4
"""Exclusive upper limit of the powers of a distorted position, along each axis and of both together."""
N_REFERENCE_JUMPS = (1, 2, 4, 8, 16)
"""Numbers of jumps of the reference that are tried, each within a tenth of a second."""
YAW_SIGMA = 0.02
"""[rad] prior standard deviation of each wave of a distorted heading."""


def distorted_reference(rows: OdometryRows, distance: Floats) -> list[StructureFamily]:
    """Return families of a reference that is distorted over the place.

        yaw:       cos(pi a u) cos(pi b v)
        position:  (u - 1/2)^a (v - 1/2)^b

    u and v are the position in units of the extent of the run. A column is the change over each row.

    Parameters
    ----------
    distance : (n,) [m] Of the wheels. Steps of the reference itself would bring its noise into the columns.
    """
    xy = (rows.averages[1:, :2] + rows.averages[:-1, :2]) / 2
    low, size = xy.min(axis=0), float(np.ptp(xy, axis=0).max())
    u, v = ((xy - low) / size).T
    c, s = np.cos(rows.poses[:, 2]), np.sin(rows.poses[:, 2])
    du, dv = distance * c / size, distance * s / size
    # change over a row of the waves cos(π a u) cos(π b v), and of the powers u^a v^b about the middle
    waves = [
        -np.pi * a * np.sin(np.pi * a * u) * np.cos(np.pi * b * v) * du
        - np.pi * b * np.cos(np.pi * a * u) * np.sin(np.pi * b * v) * dv
        for a in range(HIGHEST_WAVE)
        for b in range(HIGHEST_WAVE)
        if 0 < a + b < HIGHEST_WAVES
    ]
    u, v = u - 0.5, v - 0.5
    powers = [
        a * u ** max(a - 1, 0) * v**b * du + b * u**a * v ** max(b - 1, 0) * dv
        for a in range(HIGHEST_POWER)
        for b in range(HIGHEST_POWER)
        if 0 < a + b < HIGHEST_POWER
    ]
    nothing = np.zeros(rows.n)
    yaw = [rows.masked(np.concatenate([nothing, wave])) for wave in waves]
    position = [rows.masked(np.concatenate([axis * p, nothing])) for p in powers for axis in (c, s)]
    return [
        StructureFamily(
            kind=REFERENCE_YAW,
            columns=np.stack(yaw, axis=1),
            sigma=YAW_SIGMA,
            statement="a yaw error of the reference that depends on the place",
            is_of_reference=True,
        ),
        StructureFamily(
            kind=REFERENCE_PLACE,
            columns=np.stack(position, axis=1),
            statement="a position error of the reference that depends on the place",
            is_of_reference=True,
        ),
    ]


def reference_jumps(rows: OdometryRows, residual: Floats) -> list[StructureFamily]:
    """Return families of a reference that jumps at 1, 2, 4, ... moments: those with the largest residual.

    A camera that takes over from another has a constant offset before and after. The loss on a slippery patch
    lasts as long as the patch.

    Parameters
    ----------
    residual : (2 n,) Residual of a model without patches.
    """
    parts = [residual[: rows.n], residual[rows.n :]]
    spreads = [robust_sigma(part[rows.valid]) + 1e-12 for part in parts]
    size = sum((part / spread) ** 2 for part, spread in zip(parts, spreads, strict=True))
    largest = np.argsort(-np.where(rows.valid, size, 0.0))
    out = []
    for k in N_REFERENCE_JUMPS:
        columns = np.zeros((2 * rows.n, 2 * k))
        columns[largest[:k], np.arange(k)] = columns[rows.n + largest[:k], k + np.arange(k)] = 1.0
        out.append(
            StructureFamily(
                kind="reference jumps",
                columns=columns,
                statement="jumps of the reference at single moments, or wheel counts that were lost then",
                is_of_reference=True,
                choice_price=float(gammaln(rows.n + 1) - gammaln(k + 1) - gammaln(rows.n - k + 1)),
            )
        )
    return out
