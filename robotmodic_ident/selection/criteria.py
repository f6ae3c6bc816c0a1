"""Criteria for the number of terms: minimise N log(rss) + penalty, or the error on folds of moments.

Penalties for k of m candidate terms and N rows:

* AIC: `2 k` (Akaike 1974).
* BIC: `k log N` (Schwarz 1978).
* EBIC with gamma = 1: `k log N + 2 log C(m, k)` (Chen and Chen 2008).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from robotmodic_ident.types import Floats

Criterion = Literal["aic", "bic", "ebic", "cv", "n_terms", "err_tol"]
Stop = Criterion | Literal["exhausted"]
"""Reason why a selection ended: its criterion, or `exhausted` if no candidate term remained."""
INFORMATION = ("aic", "bic", "ebic")
PATIENCE = 2
"""Number of consecutive larger models without a gain after which a search ends; of two lags, the first may bring none."""
CONVERGED = 1e-10
"""Relative gain below which a step or an exchange of terms brings nothing, and an iteration ends."""
MAX_STEPS = 30
"""Maximum number of steps of an iteration that ends when a step brings no gain."""
MAX_TERMS = 30
"""Maximum number of terms of a search that adds terms one by one."""


def penalties(criterion: str, n_max: int, n_candidates: int, count: NDArray[np.int64]) -> Floats:
    """Return the penalties of 0, 1, ..., n_max terms (n_outputs, n_max + 1), in addition to N log(rss).

    EBIC also counts the models of each size in the dictionary.
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
    """Return N log(rest) + cost (n_outputs, n_sizes) for unexplained shares `rest`, bounded below by rounding."""
    floor = 64 * rest.shape[1] * np.finfo(np.float64).eps  # below this the residual is rounding
    return np.asarray(count[:, None] * np.log(np.maximum(rest, floor)) + cost, dtype=np.float64)
