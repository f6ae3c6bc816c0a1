"""Sobol indices of any simulation, from samples: the shares of the variance of a quantity that are due to each factor.

With quantities a of points A, b of points B, and c_i of points A with factor i from B:

* `first_i = mean(b (c_i - a)) / variance` (Saltelli et al., Comput. Phys. Commun. 181, 2010, table 2 (b)).
* `total_i = mean((a - c_i)²) / (2 variance)` (Jansen 1999; (f) in the same table).

Both need n (d + 2) runs for d factors. The intervals are from a bootstrap of the n rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robotmodic_ident.errors import IdentError
from robotmodic_ident.types import Floats

N_BOOTSTRAP = 1000
MIN_ROWS = 8
"""Minimum number of rows with a value in every run."""
LEVELS = (0.025, 0.975)
NO_VARIANCE = 1e-12
"""Standard deviation over magnitude of the mean up to which a quantity is constant except for rounding."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SampledSobol:
    """Shares of the variance of quantities due to factors."""

    first: Floats
    """(n_factors, n_quantities) share due to a factor alone; nan for a constant quantity."""
    first_interval: Floats
    """(n_factors, n_quantities, 2) limits of the 95 % interval."""
    total: Floats
    """(n_factors, n_quantities) share due to a factor, including its interactions."""
    total_interval: Floats
    """(n_factors, n_quantities, 2) limits of the 95 % interval."""
    mean: Floats
    """(n_quantities,)"""
    sigma: Floats
    """(n_quantities,) standard deviation due to all factors."""
    known: Floats
    """(n_quantities,) share of the rows with a value in every run."""


def saltelli_points(n: int, n_factors: int, rng: np.random.Generator) -> Floats:
    """Return points (n, n_factors + 2, n_factors) of the unit cube: A, B, and A with each factor from B.

    Parameters
    ----------
    n : number of rows of a scrambled Sobol sequence, a power of 2

    Raises
    ------
    IdentError
        If n is not a power of 2, or there is no factor.
    """
    if n < MIN_ROWS or n & (n - 1) or n_factors < 1:
        raise IdentError(
            f"n is {n}, with {n_factors} factors; expected a power of 2 of at least {MIN_ROWS}, and at least 1 factor"
        )
    from scipy.stats import qmc  # slow to import

    both = qmc.Sobol(2 * n_factors, scramble=True, rng=rng).random(n)
    A, B = both[:, :n_factors], both[:, n_factors:]
    points = np.repeat(A[:, None], n_factors + 2, axis=1)
    points[:, 1] = B
    for i in range(n_factors):
        points[:, 2 + i, i] = B[:, i]
    return points


def sampled_sobol(values: Floats, rng: np.random.Generator) -> SampledSobol:
    """Return the shares from the quantities at `saltelli_points`.

    Parameters
    ----------
    values : (n, n_factors + 2, n_quantities) Results of the runs.
        nan: The run has no value, and its row is left out for that quantity.
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
    centred = b - rows[:, :2].mean()  # centring keeps the expectation and lowers the variance of the estimate
    return (centred * (mixed - a)).mean(axis=0) / variance, ((a - mixed) ** 2).mean(axis=0) / (2 * variance)
