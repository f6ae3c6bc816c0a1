"""Settings of the model `polynomial`: every tuned number of `models/polynomial` with unit and meaning.

The values were set on the paper's arena and on the shipped office. The criteria are error and share of answered rays,
as printed by

    python -m benchmarks.paper environment -o DIR
    sensorgraph evaluate GRAPH RUN
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class FormSettings:
    """Selection of degree, harmonics and number of terms (`complexity`)."""

    folds: int = 5
    stretches: int = 50
    """Number of contiguous stretches of the log; stretch b is held out in fold b mod `folds`."""
    max_rays: int = 16
    """Maximum number of rays used in the selection, evenly spread."""
    max_scans: int = 3000
    """Maximum number of scans used in the selection, evenly spread."""
    max_degree: int = 6
    max_harmonics: int = 8
    max_terms: int = 80
    max_candidates: int = 260
    """Maximum number of terms in the dictionary."""
    scans_per_candidate: int = 8
    """Minimum number of training scans per candidate term."""
    max_error_ratio: float = 0.99
    """A form with more candidates must reduce the error to less than this share."""
    every_size_to: int = 12
    """Every number of terms is tried up to this one, then steps of a fifth."""
    rows_per_term: int = 5
    """Minimum number of returns per term of a ray; with fewer it has only its mean."""


@dataclass(frozen=True, kw_only=True)
class SupportSettings:
    """Poses at which a prediction is supported by data (`support`, `model`)."""

    cell_sizes: tuple[float, ...] = (0.25, 0.5, 1.0, 2.0)
    """[m] Sides of position cells; the smallest sufficient one is used."""
    n_sectors: int = 8
    """Number of heading sectors."""
    min_supported: float = 0.95
    """Minimum share of the training poses that their neighbours support, for a cell size to be sufficient."""
    full_circle: float = 1.95 * math.pi
    """[rad] Field of view above which the sensor sees all around."""
    leverage_quantile: float = 0.995
    """Quantile of the leverage of training poses, as if each were a new pose."""
    leverage_factor: float = 2.0
    """Factor on that quantile above which a pose is an extrapolation."""
    max_leverage: float = 1e12
    """Upper limit of the leverage that widens a standard deviation."""
    min_eigenvalue: float = 1e-10
    """Lower limit of the eigenvalues of the Gram matrix relative to the largest: precision of unvaried directions."""
    min_sigma: float = 1e-6
    """[m] Lower limit of a ray's standard deviation."""


@dataclass(frozen=True, kw_only=True)
class PolynomialSettings:
    """All tuned numbers of the model `polynomial`."""

    form: FormSettings = field(default_factory=FormSettings)
    support: SupportSettings = field(default_factory=SupportSettings)
    poses_per_block: int = 4096
    """Number of poses processed at a time; it limits memory."""
    max_gram_numbers: int = 1 << 23
    """Maximum number of entries (64 MB) of the Gram matrices with missing returns; more rays take several passes."""
    n_quantiles: int = 33
    """Number of stored quantiles of the absolute residual."""


POLYNOMIAL = PolynomialSettings()
"""The settings that the modules use."""
