"""Candidate terms of a free-run model of one output, and the saturation limits of the output."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robotmodic_ident.bases import polynomial
from robotmodic_ident.prediction.recursion import UNLIMITED
from robotmodic_ident.records import Records, as_records, lags
from robotmodic_ident.terms import Terms
from robotmodic_ident.types import Floats

NEAR_VALUES = 10
"""Number of distinct values next to a limit with which it is compared."""
LIMIT_RATIO = 5
"""Minimum ratio of the count of a limit to that of any near value, and its minimum count; neighbouring quantised levels have
similar counts."""


def dictionary(output: str, inputs: Sequence[str], order: int, degree: int, max_product_lag: int) -> Terms:
    """Return the candidates: all signals up to lag `order`, and products of those up to `max_product_lag`."""
    near = min(order, max_product_lag)
    products = lags(output, 1, near)
    linear = lags(output, 1, order)
    for name in inputs:
        products += lags(name, 0, near)
        linear += lags(name, 0, order)
    return polynomial(linear, 1) + polynomial(products, degree)


def linear_part(terms: Terms) -> Terms:
    """Return the terms of degree 1 and the constant."""
    return Terms(tuple(term for term in terms if sum(f.power for f in term) <= 1))


def output_limits(records: Records, output: str) -> tuple[float, float]:
    """Return the apparent saturation limits of an output; infinite if there is no limit.

    A limit is the largest or smallest value if it is far more frequent than the values near it. Examples are a full
    tank, an end stop, or the range of a converter.
    """
    parts = [np.asarray(record.signals[output], dtype=np.float64) for record in as_records(records)]
    known = np.concatenate([part[np.isfinite(part)] for part in parts])
    if len(known) == 0 or np.ptp(known) == 0:
        return UNLIMITED
    return -_upper_limit(-known), _upper_limit(known)


def _upper_limit(values: Floats) -> float:
    distinct, counts = np.unique(values, return_counts=True)
    near = int(counts[-1 - NEAR_VALUES : -1].max(initial=1))
    return float(distinct[-1]) if counts[-1] >= LIMIT_RATIO * near else float("inf")
