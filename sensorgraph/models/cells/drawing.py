"""Drawing of readings among cells: each is a quantile of the ray's mixture."""

from __future__ import annotations

import numpy as np

from sensorgraph.models.base import OFF_DISTANCE, Model
from sensorgraph.types import Floats, Ints

SMALLEST = 1e-12
"""Smallest probability of a quantile."""


def draw_readings(model: Model, poses: Floats, rays: Ints, uniform: Floats, normal: Floats) -> Floats:
    """Draw one reading (n_poses, n_rays) [m] of rays (n_rays,) at poses (n_poses, 3); +inf: no return.

    `uniform` and `normal` (n_poses, n_rays) are the random numbers; equal numbers give equal readings. The uniform number
    selects the outcome: no return, then readings off the mode from far to near, as often as `predict` says, then readings
    near it. The normal number selects the quantile among the readings near the mode.
    """
    from scipy.special import ndtr  # imported here, since it takes long and only drawing needs it

    out, said = np.empty(uniform.shape), model.predict(poses, rays, "mode")
    for i in range(len(poses)):  # one pose at a time, since the arrays of a mixture are large
        mixture, mode, p_off = model.mixture(poses[i : i + 1], rays), said.mode[i], said.p_off[i]
        none = mixture.p_no_return[0]
        below = mixture.cdf(mode - OFF_DISTANCE)[0]
        above = 1.0 - mixture.cdf(mode + OFF_DISTANCE)[0]
        number = (uniform[i] - none) / np.maximum(1.0 - none, 1e-300)
        share = (below + above) * number / np.maximum(p_off, 1e-300)
        off = np.where(share < above, 1.0 - share, share - above)
        near = below + (1.0 - below - above) * ndtr(normal[i])
        is_off = (number < p_off) & (below + above > SMALLEST)
        reading = mixture.quantile(np.clip(np.where(is_off, off, near), SMALLEST, 1.0 - SMALLEST))[0]
        out[i] = np.where(number < 0, np.inf, reading)
    return out
