"""Checks of the terms and the scale of a stored polynomial."""

from __future__ import annotations

import math

import numpy as np

from robotmodic_ident import Scale
from sensorgraph.models.stored_numbers import check_range
from sensorgraph.types import Ints

MAX_POSITION, MAX_EXPONENT = 1e6, 280
"""[m] Distance from the origin of map within which powers of a stored scale stay finite; maximum power of ten."""


def check_order(order: Ints, n_terms: int) -> None:
    """Check the terms that each ray uses.

    Parameters
    ----------
    order : (n_rays, n_max) Terms in order of selection; -1: none.

    Raises
    ------
    ValueError : A term does not exist, occurs twice, or follows a gap.
    """
    check_range("order", order, -1, n_terms - 1)
    ranked = np.sort(order, axis=1)
    if ((ranked[:, 1:] == ranked[:, :-1]) & (ranked[:, 1:] >= 0)).any():
        raise ValueError("order holds a term of a ray twice")
    if ((order[:, 1:] >= 0) & (order[:, :-1] < 0)).any():
        raise ValueError("order has a gap before a term")


def check_scale(scale: Scale, degree: int) -> None:
    """Check the scale of poses.

    Raises
    ------
    ValueError : The scale is not of x and y, or the highest power of a scaled pose is too large.
    """
    if set(scale.variables) != {"x", "y"}:
        raise ValueError(f"the scale is of {', '.join(scale.variables) or 'nothing'}, expected x, y")
    for centre, width in zip(scale.centres, scale.widths, strict=True):
        exponent = degree * math.log10(max(MAX_POSITION, abs(centre)) / width)
        if exponent > MAX_EXPONENT:
            raise ValueError(
                f"a width of {width:g} m makes powers of 1e{exponent:.0f}, expected at most 1e{MAX_EXPONENT}"
            )
