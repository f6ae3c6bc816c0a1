"""Settings of the model `narmax`: every tuned number of `models/narmax` with unit and meaning.

The defaults were set on the shipped arenas, by the scores of `sensorgraph evaluate` (docs: how-to/lagged-rays).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class NarmaxSettings:
    """All tuned numbers of the model `narmax`."""

    lags: int = 3
    """[scans] Default number of lags."""
    degree: int = 3
    """Default degree in poses and twist."""
    neighbours: int = 3
    """Number of rays on each side whose lagged readings a ray may use."""
    turn_quantile: float = 0.95
    """Quantile of the turns between scans [rad] up to which the neighbours reach."""
    max_spacing: int = 10
    """[rays] Maximum distance between neighbours."""
    noise_lags: int = 2
    """[scans] Number of noise lags of rays with a correlated residual."""
    max_terms: int = 25
    """Maximum number of terms of a ray."""
    max_lags: int = 20
    """[scans] Maximum number of lags that may be specified."""
    max_candidates: int = 4000
    """Maximum number of shared candidates; more lags or a higher degree would take too long."""
    max_search_rows: int = 20_000
    """Maximum number of scans in the search for terms, evenly spread; coefficients are estimated on all scans."""
    rays_per_block: int = 32
    """Number of rays processed at a time; it limits memory."""
    rows_per_term: int = 5
    """Minimum number of rows per term of a ray; with fewer rows it has fewer terms, at least the mean."""
    test_level: float = 0.05
    """p-value of the test for autocorrelation below which a ray has noise terms; the usual level."""
    tested_lags: int = 10
    """[scans] Number of lags in residual tests."""
    max_steps: int = 3
    """Maximum number of Gauss-Newton steps, from a consistent start (Hannan and Rissanen 1982)."""
    converged: float = 1e-3
    """Relative gain of a step below which the iteration ends."""
    max_root: float = 0.98
    """Largest modulus of the roots of the noise polynomial; it avoids slowly decaying residuals."""
    max_dropout_memory: float = 0.98
    """Maximum increase of the probability of no return after a missing return."""
    scored_scans: int = 5000
    """Number of training scans, from the start, whose errors determine the standard deviations."""
    min_sigma: float = 1e-6
    """[m] Lower limit of a ray's standard deviation."""


NARMAX = NarmaxSettings()
"""The settings that the modules use."""
