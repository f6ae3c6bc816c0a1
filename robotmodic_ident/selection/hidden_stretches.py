"""Records of which one stretch after another has its output hidden: what a model does there in free run.

A free run needs the inputs alone, so what is hidden splits no record, and no state is lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from robotmodic_ident.model import Narmax
from robotmodic_ident.records import Record
from robotmodic_ident.types import Floats


@dataclass(frozen=True, kw_only=True)
class WarmUp:
    """The start of every record, whose outputs a free run may use."""

    samples: int = 50
    max_share: float = 0.25
    """Of a record, where it is short."""

    def of(self, n: int) -> int:
        """Return how many of a record's n samples it takes."""
        return min(self.samples, int(self.max_share * n))


WARM_UP = WarmUp()


@dataclass(frozen=True, kw_only=True, eq=False)
class HiddenStretches:
    """The folds of a cross-validation in free run."""

    records: Sequence[Record]
    output: str
    n_folds: int
    warm_up: WarmUp

    @cached_property
    def shown(self) -> list[list[Record]]:
        """The records of every fold, nan where the output is hidden."""
        return [
            [_hidden(record, self.output, self._stretch(len(record), fold)) for record in self.records]
            for fold in range(self.n_folds)
        ]

    def mean_square(self, model: Narmax, fold: int) -> float:
        """Return the mean square of the free run's residual over what a fold hides; inf where it ends early."""
        hidden = [self._stretch(len(record), fold) for record in self.records]
        return free_run_mean_square(model, self.records, self.shown[fold], hidden, self.warm_up)

    def _stretch(self, n: int, fold: int) -> slice:
        """Return the samples of a record of n that one fold hides."""
        edges = np.linspace(self.warm_up.of(n), n, self.n_folds + 1).round().astype(int)
        return slice(int(edges[fold]), int(edges[fold + 1]))


def whole_mean_square(model: Narmax, records: Sequence[Record], warm_up: WarmUp) -> float:
    """Return the mean square of the free run's residual over whole records; inf where it ends early."""
    rows = [slice(warm_up.of(len(record)), None) for record in records]
    return free_run_mean_square(model, records, records, rows, warm_up)


def free_run_mean_square(
    model: Narmax,
    records: Sequence[Record],
    shown: Sequence[Record],
    rows: Sequence[slice],
    warm_up: WarmUp,
) -> float:
    """Return the mean square over some rows of each record of what a free run through `shown` leaves."""
    squares: list[Floats] = []
    for record, part, some in zip(records, shown, rows, strict=True):
        measured = np.asarray(record.signals[model.output], dtype=np.float64)[some]
        predicted = model.predict_mpo(part, warm_up=warm_up.of(len(record)))[some]
        with np.errstate(over="ignore"):
            squares.append(np.nan_to_num((measured - predicted)[np.isfinite(measured)] ** 2, nan=np.inf))
    whole = np.concatenate(squares)
    return float(whole.mean()) if len(whole) else float("inf")


def _hidden(record: Record, output: str, rows: slice) -> Record:
    values = np.array(record.signals[output], dtype=np.float64)
    values[rows] = np.nan
    return replace(record, signals={**record.signals, output: values})
