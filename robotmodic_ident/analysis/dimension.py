"""Correlation dimension D = d log C(r) / d log r of a series, with a confidence interval and a surrogate test.

C(r) is the share of pairs of embedded points that are closer than r (Grassberger and Procaccia, Physica D 9, 1983).
Pairs close in time are excluded (Theiler, Phys. Rev. A 34, 1986). If surrogates of linear noise give the same value, it
is not the dimension of an attractor (Theiler et al., Physica D 58, 1992).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from robotmodic_ident.analysis.embedding import embed, surrogate
from robotmodic_ident.errors import IdentError
from robotmodic_ident.types import Floats

N_RADII = 24
"""Number of radii at which pairs are counted."""
SLOPE_REGION = (1e-4, 0.1)
"""Default range of C(r) in which the slope is fitted."""
N_REFERENCE = 4000
"""Default number of reference points."""
N_REFERENCE_BLOCKS = 20
"""Number of contiguous blocks of reference points for the bootstrap of the interval."""
N_BOOTSTRAP = 200
"""Number of bootstrap samples for the interval."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CorrelationDimension:
    """A correlation dimension with its interval, and the values for linear noise of the same spectrum."""

    value: float
    interval: tuple[float, float]
    """95 % interval over blocks of the series, extended to the slopes of both halves of the region."""
    surrogates: Floats
    """(n,) dimensions of the surrogates."""
    p_value: float | None
    """p-value of the hypothesis that the series is linear noise; None without surrogates."""
    radii: Floats
    """(n_radii,) radii r."""
    correlation: Floats
    """(n_radii,) C(r), the share of pairs closer than each radius."""


def correlation_dimension(
    series: ArrayLike,
    *,
    dimension: int,
    lag: int = 1,
    theiler: int,
    n_surrogates: int = 0,
    n_reference: int = N_REFERENCE,
    region: tuple[float, float] = SLOPE_REGION,
    rng: np.random.Generator,
) -> CorrelationDimension:
    """Return the correlation dimension of a series (n,) or (n, n_signals).

    Parameters
    ----------
    dimension, lag : Dimension and lag [samples] of the embedding.
    theiler : [samples] Pairs closer in time are excluded.
    n_surrogates : 0, or at least 19 for a test at the 5 % level.
    n_reference : Number of reference points, which are compared with all others.
    region : Range of C(r) in which the slope is fitted.
    """
    points = embed(series, dimension, lag)
    radii, counts, pairs = _counts(points, theiler, n_reference)
    correlation = counts.sum(axis=0) / pairs.sum()
    value, used = _slope(radii, correlation, region)
    spread = [_resampled(radii[used], counts[:, used], pairs, rng) for _ in range(N_BOOTSTRAP)]
    half = len(radii[used]) // 2
    ends = [
        float(np.polyfit(np.log(radii[used][part]), np.log(correlation[used][part]), 1)[0])
        for part in (slice(0, half + 1), slice(half, None))
    ]
    low, high = np.quantile(spread, [0.025, 0.975])
    table = np.asarray(series, dtype=np.float64)
    others = []
    for _ in range(n_surrogates):
        r, c, n = _counts(embed(surrogate(table, rng), dimension, lag), theiler, n_reference)
        others.append(_slope(r, c.sum(axis=0) / n.sum(), region)[0])
    surrogates = np.array(others, dtype=np.float64)
    p_value = (
        float((1 + (surrogates <= value).sum()) / (n_surrogates + 1)) if n_surrogates else None
    )  # one-sided: structure has a lower dimension than noise
    return CorrelationDimension(
        value=value,
        interval=(float(min(low, *ends)), float(max(high, *ends))),
        surrogates=surrogates,
        p_value=p_value,
        radii=radii,
        correlation=correlation,
    )


def _counts(points: Floats, theiler: int, most: int) -> tuple[Floats, Floats, Floats]:
    """Return the radii, the pairs closer than each (n_blocks, n_radii), and all pairs (n_blocks,), per block."""
    n = len(points)
    if n < 10 * N_REFERENCE_BLOCKS or n <= 4 * theiler:
        raise IdentError(
            f"{n} embedded samples are too few; expected at least {10 * N_REFERENCE_BLOCKS}, and above 4 * theiler"
        )
    reference = np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.intp))
    some = reference[:: max(1, len(reference) // 200)]
    sample = np.concatenate([np.linalg.norm(points - points[i], axis=1) for i in some])
    largest = float(np.quantile(sample, 0.5))
    least = max(float(np.quantile(sample[sample > 0], 1e-5)), 1e-9 * largest)
    radii = np.geomspace(least, largest, N_RADII)
    counts, pairs = np.zeros((N_REFERENCE_BLOCKS, N_RADII)), np.zeros(N_REFERENCE_BLOCKS)
    when = np.arange(n)
    for b, block in enumerate(np.array_split(reference, N_REFERENCE_BLOCKS)):
        for i in block.tolist():
            gap = np.linalg.norm(points - points[i], axis=1)[np.abs(when - i) > theiler]
            counts[b] += np.searchsorted(np.sort(gap), radii, side="right")
            pairs[b] += len(gap)
    return radii, counts, pairs


def _slope(radii: Floats, correlation: Floats, region: tuple[float, float]) -> tuple[float, slice]:
    inside = np.flatnonzero((correlation >= region[0]) & (correlation <= region[1]))
    if len(inside) < 4:
        raise IdentError(
            "fewer than 4 radii are in the region of the slope; use a longer series or a wider region"
        )
    used = slice(int(inside[0]), int(inside[-1]) + 1)
    return float(np.polyfit(np.log(radii[used]), np.log(correlation[used]), 1)[0]), used


def _resampled(radii: Floats, counts: Floats, pairs: Floats, rng: np.random.Generator) -> float:
    pick = rng.integers(0, len(pairs), len(pairs))
    share = np.maximum(counts[pick].sum(axis=0), 1.0) / pairs[pick].sum()
    return float(np.polyfit(np.log(radii), np.log(share), 1)[0])
