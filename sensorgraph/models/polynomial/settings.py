"""Settings of the model `polynomial`: every tuned number of `models/polynomial` with its unit and its meaning.

Numbers were set on the paper's arena and on the shipped office, by error and share of answered rays as printed by

    python -m benchmarks.paper environment -o DIR
    sensorgraph evaluate GRAPH RUN
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class FormSettings:
    """The choice of degree, harmonics and number of terms (`complexity`)."""

    folds: int = 5
    stretches: int = 50
    """Contiguous stretches of the log; stretch b is validation in fold b mod `folds`."""
    max_rays: int = 16
    """Rays that the choice looks at, evenly spread."""
    max_scans: int = 3000
    """Scans, alike."""
    max_degree: int = 6
    max_harmonics: int = 8
    max_terms: int = 80
    max_candidates: int = 260
    """Terms of a dictionary."""
    scans_per_candidate: int = 8
    """Training scans needed for each candidate term."""
    max_error_ratio: float = 0.99
    """A richer form must bring the error below this share of the poorer one's."""
    every_size_to: int = 12
    """Every number of terms is tried up to here, then steps of a fifth."""
    rows_per_term: int = 5
    """Returns of a ray for each of its terms; with fewer it gets its mean alone."""


@dataclass(frozen=True, kw_only=True)
class SupportSettings:
    """Poses that a prediction is trusted at (`support`, `model`)."""

    cell_sizes: tuple[float, ...] = (0.25, 0.5, 1.0, 2.0)
    """[m] sides of position cells, of which the smallest that suffices is taken."""
    n_sectors: int = 8
    """Of the heading."""
    min_supported: float = 0.95
    """Share of the training poses that their neighbours must support, for a cell size to be large enough."""
    full_circle: float = 1.95 * math.pi
    """[rad] of field of view above which the sensor sees all around."""
    leverage_quantile: float = 0.995
    """Of the training poses' leverage as new ones."""
    leverage_factor: float = 2.0
    """Times that quantile, above which a pose is unlike the training poses."""
    max_leverage: float = 1e12
    """That a standard deviation is widened by."""
    min_eigenvalue: float = 1e-10
    """Of the Gram over its largest: directions that the poses never left count as known so well."""
    min_sigma: float = 1e-6
    """[m] of a ray."""


@dataclass(frozen=True, kw_only=True)
class PolynomialSettings:
    """All tuned numbers of the model `polynomial`."""

    form: FormSettings = field(default_factory=FormSettings)
    support: SupportSettings = field(default_factory=SupportSettings)
    poses_per_block: int = 4096
    """Poses taken at a time, for the sake of memory."""
    max_gram_numbers: int = 1 << 23
    """Numbers (64 MB) that the Grams of missing returns may take; more rays go in several passes."""
    n_quantiles: int = 33
    """Shares at which the size of the residuals is kept."""


POLYNOMIAL = PolynomialSettings()
"""The settings of the model `polynomial`."""
