"""How many terms to keep: information criteria, and cross-validation over folds of moments."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from robotmodic_ident.types import Floats

Criterion = Literal["aic", "bic", "ebic", "cv", "n_terms", "err_tol"]
Stop = Criterion | Literal["exhausted"]
"""Why a selection ended: its criterion, or `exhausted` where no term was left before it."""
INFORMATION = ("aic", "bic", "ebic")


def penalties(criterion: str, n_max: int, n_candidates: int, count: NDArray[np.int64]) -> Floats:
    """Return what 0, 1, ..., n_max terms cost (n_outputs, n_max + 1), beside N log(rss).

    AIC: Akaike 1974; BIC: Schwarz 1978; EBIC (gamma = 1): Chen and Chen 2008, which also counts how many
    models of that size the dictionary holds.
    """
    k = np.arange(n_max + 1, dtype=np.float64)
    N = np.asarray(count, dtype=np.float64)[:, None]
    if criterion == "aic":
        return np.broadcast_to(2.0 * k, (len(N), n_max + 1)).copy()
    cost = k * np.log(N)
    if criterion == "ebic":
        models = gammaln(n_candidates + 1) - gammaln(k + 1) - gammaln(n_candidates - k + 1)
        cost = cost + 2.0 * models
    return np.asarray(cost, dtype=np.float64)


def information(rest: Floats, cost: Floats, count: NDArray[np.int64]) -> Floats:
    """Return N log(rest) + cost (n_outputs, n_sizes) for unexplained shares `rest`; rounding counts as 0."""
    floor = 64 * rest.shape[1] * np.finfo(np.float64).eps  # below this the residual is rounding
    return np.asarray(count[:, None] * np.log(np.maximum(rest, floor)) + cost, dtype=np.float64)
