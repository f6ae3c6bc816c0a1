"""Settings of the model `narmax`, with unit and meaning; the modules hold the constants of the algorithms.

The defaults were set on the shipped arenas, by the scores of `sensorgraph evaluate` (docs: how-to/lagged-rays).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class NarmaxSettings:
    """Defaults and limits of the options of the model."""

    lags: int = 3
    """[scans] Default number of lags."""
    degree: int = 3
    """Default degree in poses and twist."""
    neighbours: int = 3
    """Number of rays on each side whose lagged readings a ray may use."""
    noise_lags: int = 2
    """[scans] Number of noise lags of rays with a correlated residual."""
    n_terms: int = 25
    """Maximum number of terms of a ray."""
    max_lags: int = 20
    """[scans] Maximum number of lags that may be specified."""
    max_spacing: int = 10
    """[rays] Maximum distance between neighbours."""
    max_candidates: int = 4000
    """Maximum number of shared candidates; more lags or a higher degree would take too long."""


NARMAX = NarmaxSettings()
"""The settings that the modules use."""
