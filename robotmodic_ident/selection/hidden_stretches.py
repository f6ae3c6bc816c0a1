"""Cross-validation in free run: each fold holds out the output of one block of every record.

A free run requires only the inputs, so a held-out block does not split a record, and no initial state is lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from robotmodic_ident.model import Narmax
from robotmodic_ident.records import Record
from robotmodic_ident.types import Floats

WARM_UP, MAX_WARM_UP_SHARE = 50, 0.25
"""[samples] length of the start of every record, whose measured outputs a free run may use; maximum share of a short
record."""


def warm_up_of(n: int) -> int:
    """Return the number of warm-up samples of a record with n samples."""
    return min(WARM_UP, int(MAX_WARM_UP_SHARE * n))


@dataclass(frozen=True, kw_only=True, eq=False)
class HiddenStretches:
    """The folds of a cross-validation in free run; hidden stretches are the held-out blocks."""

    records: Sequence[Record]
    output: str
    n_folds: int

    @cached_property
    def shown(self) -> list[list[Record]]:
        """The records of every fold; the held-out outputs are nan."""
        return [
            [_hidden(record, self.output, self._stretch(len(record), fold)) for record in self.records]
            for fold in range(self.n_folds)
        ]

    def mean_square(self, model: Narmax, fold: int) -> float:
        """Return the mean square of the free-run residual over the held-out samples of a fold; inf if it diverges."""
        hidden = [self._stretch(len(record), fold) for record in self.records]
        return free_run_mean_square(model, self.records, self.shown[fold], hidden)

    def _stretch(self, n: int, fold: int) -> slice:
        """Return the held-out samples of one fold in a record of n samples."""
        edges = np.linspace(warm_up_of(n), n, self.n_folds + 1).round().astype(int)
        return slice(int(edges[fold]), int(edges[fold + 1]))


def whole_mean_square(model: Narmax, records: Sequence[Record]) -> float:
    """Return the mean square of the free-run residual over whole records; inf if it diverges."""
    rows = [slice(warm_up_of(len(record)), None) for record in records]
    return free_run_mean_square(model, records, records, rows)


def free_run_mean_square(
    model: Narmax,
    records: Sequence[Record],
    shown: Sequence[Record],
    rows: Sequence[slice],
) -> float:
    """Return the mean square of the residual of a free run through `shown`, over some rows of each record."""
    squares: list[Floats] = []
    for record, part, some in zip(records, shown, rows, strict=True):
        measured = np.asarray(record.signals[model.output], dtype=np.float64)[some]
        predicted = model.predict_mpo(part, warm_up=warm_up_of(len(record)))[some]
        with np.errstate(over="ignore"):
            squares.append(np.nan_to_num((measured - predicted)[np.isfinite(measured)] ** 2, nan=np.inf))
    whole = np.concatenate(squares)
    return float(whole.mean()) if len(whole) else float("inf")


def _hidden(record: Record, output: str, rows: slice) -> Record:
    values = np.array(record.signals[output], dtype=np.float64)
    values[rows] = np.nan
    return replace(record, signals={**record.signals, output: values})
