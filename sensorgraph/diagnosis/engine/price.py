"""Occam factor of free parameters."""

from __future__ import annotations

import numpy as np


def occam_factor(n_parameters: int, n_data: int) -> float:
    """Return the complexity penalty [nats] of free parameters in a fit of `n_data` measurements.

        price = ½ k log n

    It is the Occam factor of a Gaussian prior that holds as much information on the k parameters as one of the n measurements
    (Schwarz 1978; Kass and Wasserman 1995, "A reference Bayesian test for nested hypotheses").
    """
    return 0.5 * n_parameters * float(np.log(max(n_data, 1)))
