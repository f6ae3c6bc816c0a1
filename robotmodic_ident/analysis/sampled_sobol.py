"""Sobol indices of anything that can be run: which factor, alone and with others, makes a quantity vary.

First-order shares by the estimator of Saltelli et al., Computer Physics Communications 181 (2010), table 2 (b); total ones
by that of Jansen (1999), (f) there. Both need n (d + 2) runs for d factors. Intervals by bootstrap of the n rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from robotmodic_ident.errors import IdentError
from robotmodic_ident.types import Floats

N_BOOTSTRAP = 1000
MIN_ROWS = 8
"""Rows with a value in every run that shares need."""
LEVELS = (0.025, 0.975)
NO_VARIANCE = 1e-12
"""Standard deviation over mean size below which a quantity does not vary: rounding."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SampledSobol:
    """Shares of the variance of quantities by factors."""

    first: Floats
    """(n_factors, n_quantities) share that a factor explains alone; nan where the quantity does not vary."""
    first_interval: Floats
    """(n_factors, n_quantities, 2) 95 %."""
    total: Floats
    """(n_factors, n_quantities) share that it has any part in."""
    total_interval: Floats
    """(n_factors, n_quantities, 2) 95 %."""
    mean: Floats
    """(n_quantities,)"""
    sigma: Floats
    """(n_quantities,) standard deviation that all factors cause."""
    known: Floats
    """(n_quantities,) share of the rows that have a value in every run."""


def saltelli_points(n: int, n_factors: int, rng: np.random.Generator) -> Floats:
    """Return points (n, n_factors + 2, n_factors) of the unit cube: A, B, and A with each factor as in B.

    n : rows, a power of 2 (a scrambled Sobol sequence)

    Raises
    ------
    IdentError
        if n is no power of 2, or there is no factor
    """
    if n < MIN_ROWS or n & (n - 1) or n_factors < 1:
        raise IdentError(
            f"n is {n}, with {n_factors} factors; expected a power of 2 from {MIN_ROWS} on, and 1 or more"
        )
    both = qmc.Sobol(2 * n_factors, scramble=True, rng=rng).random(n)
    A, B = both[:, :n_factors], both[:, n_factors:]
    points = np.repeat(A[:, None], n_factors + 2, axis=1)
    points[:, 1] = B
    for i in range(n_factors):
        points[:, 2 + i, i] = B[:, i]
    return points


def sampled_sobol(values: Floats, rng: np.random.Generator) -> SampledSobol:
    """Return the shares from what was found at `saltelli_points`.

    Parameters
    ----------
    values : (n, n_factors + 2, n_quantities); nan where a run has no value: its row is left out for that quantity
    """
    n, width, n_quantities = values.shape
    shape = (width - 2, n_quantities)
    first, total = np.full(shape, np.nan), np.full(shape, np.nan)
    intervals = np.full((2, *shape, 2), np.nan)
    mean, sigma, known = (np.full(n_quantities, np.nan) for _ in range(3))
    for q in range(n_quantities):
        rows = values[np.isfinite(values[:, :, q]).all(axis=1), :, q]
        known[q] = len(rows) / n
        if len(rows) < MIN_ROWS:
            continue
        mean[q], sigma[q] = rows[:, :2].mean(), rows[:, :2].std()
        if sigma[q] <= NO_VARIANCE * max(abs(mean[q]), 1e-300):
            continue
        first[:, q], total[:, q] = _shares(rows)
        drawn = [_shares(rows[rng.integers(len(rows), size=len(rows))]) for _ in range(N_BOOTSTRAP)]
        intervals[:, :, q] = np.moveaxis(np.nanquantile(np.array(drawn), LEVELS, axis=0), 0, -1)
    return SampledSobol(
        first=first, first_interval=intervals[0], total=total, total_interval=intervals[1], mean=mean,
        sigma=sigma, known=known,
    )  # fmt: skip


def _shares(rows: Floats) -> tuple[Floats, Floats]:
    """Return first and total shares (n_factors,) of rows (n, n_factors + 2)."""
    a, b, mixed = rows[:, :1], rows[:, 1:2], rows[:, 2:]
    variance = rows[:, :2].var()
    if variance == 0:
        return np.full(mixed.shape[1], np.nan), np.full(mixed.shape[1], np.nan)
    centred = b - rows[:, :2].mean()  # the same expectation, less variance
    return (centred * (mixed - a)).mean(axis=0) / variance, ((a - mixed) ** 2).mean(axis=0) / (2 * variance)
