"""Settings of the model `polynomial`, with unit and meaning; the modules hold the constants of the algorithms.

The values were set on the paper's arena and on the shipped office. The criteria are error and share of answered rays,
as printed by

    python -m benchmarks.paper environment -o DIR
    sensorgraph evaluate GRAPH RUN
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class PolynomialSettings:
    """Forms that `auto` tries, and the cells in which poses are supported."""

    max_degree: int = 6
    max_harmonics: int = 8
    max_terms: int = 80
    max_candidates: int = 260
    """Maximum number of terms in the dictionary."""
    cell_sizes: tuple[float, ...] = (0.25, 0.5, 1.0, 2.0)
    """[m] Sides of position cells; the smallest is used in which enough training poses have neighbours."""


POLYNOMIAL = PolynomialSettings()
"""The settings that the modules use."""
