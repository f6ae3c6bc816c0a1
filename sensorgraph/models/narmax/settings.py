"""Settings of the model `narmax`: every tuned number of `models/narmax` with its unit and its meaning.

Their defaults were set on the shipped arenas, by what `python -m benchmarks.lagged_rays` prints.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class NarmaxSettings:
    """All tuned numbers of the model `narmax`."""

    lags: int = 3
    """[scans] default look back."""
    degree: int = 3
    """Default degree in poses and twist."""
    neighbours: int = 3
    """Rays on each side whose lagged readings a ray may use."""
    turn_quantile: float = 0.95
    """Of the turns from scan to scan [rad], as far as which the neighbours reach."""
    max_spacing: int = 10
    """[rays] between neighbours."""
    noise_lags: int = 2
    """[scans] lags of the noise, where the residual is correlated."""
    max_terms: int = 25
    """Terms of a ray that the search goes to."""
    max_lags: int = 20
    """[scans] look back that may be asked for."""
    max_candidates: int = 4000
    """Candidates that all rays share; more lags or a higher degree would take too long."""
    max_search_rows: int = 20_000
    """Scans that the search for terms looks at, evenly spread; coefficients are estimated on all."""
    rows_per_block: int = 2048
    """Rows whose products are taken together, for the sake of memory."""
    rays_per_block: int = 32
    """Rays, alike."""
    rows_per_term: int = 5
    """Rows that a ray needs for each term; with fewer it keeps fewer terms, at least its mean."""
    alarm: float = 0.05
    """p-value of the test of autocorrelation below which a ray gets noise terms; the convention."""
    tested_lags: int = 10
    """[scans] of the tests of residuals."""
    max_steps: int = 3
    """Gauss-Newton steps of the prediction error, from a consistent start (Hannan and Rissanen 1982)."""
    converged: float = 1e-3
    """Relative gain of a step below which the next one is not taken."""
    largest_root: float = 0.98
    """Of the noise polynomial: closer to the unit circle a start is drawn back, so that residuals do not ring."""
    max_dropout_memory: float = 0.98
    """Largest share of a dropout that lasts into the next scan."""
    scored_scans: int = 5000
    """First training scans whose one-step and free-run errors give the standard deviations."""
    min_sigma: float = 1e-6
    """[m] of a ray."""


NARMAX = NarmaxSettings()
"""The settings of the model `narmax`."""
