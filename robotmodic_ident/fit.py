"""fit: from records to a model, in one call."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from robotmodic_ident.criteria import Criterion
from robotmodic_ident.model import Narmax
from robotmodic_ident.moments import Moments
from robotmodic_ident.records import Record, lagged
from robotmodic_ident.scale import Scale
from robotmodic_ident.select import select
from robotmodic_ident.terms import Floats, Terms


def fit(
    records: Record | Mapping[str, Floats] | Iterable[Record | Mapping[str, Floats]],
    output: str,
    terms: Terms,
    *,
    n_terms: int | None = None,
    criterion: Criterion | None = None,
    err_tol: float = 1e-4,
    scale: Scale | None = None,
) -> Narmax:
    """Identify one output from records by forward selection among `terms`.

    Variables are divided by their largest size but not centred unless `scale` says so: centring keeps
    the span of a full polynomial but changes which few terms describe it. Without centring the result
    is in the user's units.
    """
    rows = lagged(records, terms, [output])
    if scale is None:
        sizes: dict[str, list[Floats]] = {}
        for term in terms:
            for f in term:
                if f.function not in ("cos", "sin"):
                    sizes.setdefault(f.variable, []).append(rows.columns[f.signal])
        scale = Scale.of({name: np.concatenate(parts) for name, parts in sizes.items()}, centre=False)
    moments = Moments(terms, 1, scale=scale).add(rows.columns, rows.targets)
    model = Narmax.of(select(moments, n_terms, criterion=criterion, err_tol=err_tol), 0, output)
    return model if any(scale.centres) else model.in_user_units()
