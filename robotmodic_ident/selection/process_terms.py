"""Select the process terms of one output by least squares, or by the prediction error if there are noise terms.

`scale_for` chooses widths that bound every column of the data, and centres for variables far from 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise
from operator import add
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from robotmodic_ident.errors import IdentError
from robotmodic_ident.estimation.prediction_error import NonlinearLeastSquares
from robotmodic_ident.model import Narmax, among
from robotmodic_ident.moments import MAX_OUTPUT, Moments
from robotmodic_ident.prediction.recursion import UNLIMITED
from robotmodic_ident.records import LaggedData, Record, lagged
from robotmodic_ident.scale import Scale
from robotmodic_ident.selection.criteria import INFORMATION, Criterion, information, penalties
from robotmodic_ident.selection.exact_dependence import independent
from robotmodic_ident.selection.model_size import Search
from robotmodic_ident.selection.select import Selection, select
from robotmodic_ident.terms import CONSTANT, Terms
from robotmodic_ident.types import Floats

Rows: TypeAlias = slice | NDArray[np.intp]
MIN_OUTPUT = 1 / MAX_OUTPUT
"""Minimum magnitude of an output other than 0; squares of smaller values underflow."""


@dataclass(kw_only=True)
class ProcessTermSelection:
    """The selection of process terms, which can be repeated with a noise model."""

    records: list[Record]
    output: str
    terms: Terms
    """Candidate terms; exactly dependent ones are removed at construction."""
    n_terms: int | None
    criterion: Criterion
    err_tol: float
    search: Search
    keep: tuple[str, ...]
    n_folds: int
    scale: Scale | None
    is_ratio: bool
    """Whether the candidates are those of the linear form of a rational model."""
    limits: tuple[float, float] = UNLIMITED
    """[units of the output] saturation limits; samples at a limit are excluded from least squares."""

    def __post_init__(self) -> None:
        self.rows = lagged(self.records, self.terms, [self.output])
        if self.limits != UNLIMITED:
            low, high = self.limits
            inside = (self.rows.targets > low) & (self.rows.targets < high)
            self.rows = replace(self.rows, targets=np.where(inside, self.rows.targets, np.nan))
        if not np.isfinite(self.rows.targets).any():
            raise IdentError(
                f"output {self.output} is unknown at all samples with known regressors; check the records"
            )
        self._shift_output()
        self.scale = self.scale or scale_for(self.terms, self.rows)
        moments = self._moments(slice(None))
        kept, found = independent(moments, self.output, moments.gram_of(0))
        names = {moments.terms.names[i] for i in kept.tolist()}
        if lost := set(self.keep) - names - (set(self.keep) - set(moments.terms.names)):
            raise IdentError(
                f"term {', '.join(sorted(lost))} cannot be kept, because it is an exact combination of other terms"
            )
        self.terms = self.terms[kept.tolist()]
        self.summed = moments.pick(terms=kept)
        self.notes = [str(dependence) for dependence in found] + self._remarks(int(moments.count[0]))
        if self.shift:
            self.notes.append(
                f"{self.output} is far from 0, so err refers to {self.output} - {self.shift:.15g}"
            )
        for name, centre in zip(self.scale.variables, self.scale.centres, strict=True):
            if centre:
                self.notes.append(f"{name} is far from 0, so {name} in the terms is {name} - {centre:.15g}")

    def _shift_output(self) -> None:
        """Subtract the middle of an output far from 0; reject an output whose squares underflow."""
        known = self.rows.targets[np.isfinite(self.rows.targets)]
        if 0.0 < (largest := float(np.abs(known).max())) < MIN_OUTPUT:
            raise IdentError(
                f"{self.output} is at most {largest:.3g}, whose square underflows; use smaller units"
            )
        self.shift = 0.0 if self.is_ratio or CONSTANT not in self.terms.names else middle_of(known)
        """Offset subtracted from the output; the constant term, which is then always kept, restores it."""
        if self.shift:
            self.rows = replace(self.rows, targets=self.rows.targets - self.shift)
            self.keep = tuple(dict.fromkeys((CONSTANT, *self.keep)))
            self.n_terms = self.n_terms and max(self.n_terms, len(self.keep))

    def _remarks(self, count: int) -> list[str]:
        out = []
        if count < 2 * len(self.terms):
            out.append(f"{count} samples for {len(self.terms)} candidate terms: the selection is unreliable")
        for i, record in enumerate(self.records):
            if not (self.rows.record == i).any():
                out.append(
                    f"record {i} gives no sample: {len(record)} samples, look back {self.terms.max_lag}"
                )
        return out

    def select(self) -> Narmax:
        """Select process terms by least squares."""
        blocks = np.array_split(np.arange(len(self.rows.sample)), self.n_folds)
        folds = [self._moments(block) for block in blocks] if self.criterion == "cv" else []
        selection = self._selection(self.summed, folds)
        self._judge(selection)
        return self._model(selection)

    def select_with_noise(self, model: Narmax) -> Narmax:
        """Select process terms by the prediction error, with the noise terms of a model included."""
        noise, n = model.noise_terms, len(self.terms)
        full = among(model, self.terms)
        parts = self._linearised(full)
        moments = reduce(add, parts)
        selection = self._selection(moments, parts if self.criterion == "cv" else [], noise.names)
        chosen = [i for i in selection.chosen(0).tolist() if i < n]
        if not chosen:  # noise terms alone are better, but a model requires a process term
            chosen = select(moments.pick(terms=range(n)), 1).chosen(0).tolist()
        alone = select(self.summed.pick(terms=chosen), len(chosen))
        return replace(self._model(alone), stop=selection.stop[0])

    def _model(self, selection: Selection) -> Narmax:
        """Return the model of a selection, with the offset of the output restored."""
        model = replace(Narmax.of(selection, 0, self.output), limits=self.limits)
        shift = np.where(np.array(model.terms.names) == CONSTANT, self.shift, 0.0)
        return replace(model, theta=model.theta + shift)

    def _moments(self, rows: Rows) -> Moments:
        """Return the moments of some rows of the data."""
        columns = {name: values[rows] for name, values in self.rows.columns.items()}
        return Moments(self.terms, 1, scale=self.scale).add(columns, self.rows.targets[rows])

    def _linearised(self, model: Narmax) -> list[Moments]:
        """Return the moments of the linearised prediction error in contiguous parts: the folds of cv, otherwise one.

        Gradients are held in memory for one block of samples at a time.
        """
        problem = NonlinearLeastSquares(model.recursion(), self.records)
        n_parts = self.n_folds if self.criterion == "cv" else 1
        parts = [Moments(self.terms + model.noise_terms, 1, scale=self.scale) for _ in range(n_parts)]
        ends = np.cumsum([len(block) for block in np.array_split(np.arange(problem.count), n_parts)])
        done = 0
        for J, target in problem.linearised(model.parameters):
            if self.shift:
                target = target - self.shift * J[:, self.terms.names.index(CONSTANT)]
            cuts = np.unique(np.clip(np.r_[done, ends, done + len(J)], done, done + len(J)))
            for first, last in pairwise(cuts.tolist()):
                rows = slice(first - done, last - done)
                parts[int(np.searchsorted(ends, first, side="right"))].add_rows(J[rows], target[rows])
            done += len(J)
        return parts

    def _selection(self, moments: Moments, folds: Sequence[Moments], noise: Sequence[str] = ()) -> Selection:
        """Select terms from moments; `folds` are moments of their parts, and `noise` names terms that are kept."""
        return select(
            moments,
            None if self.n_terms is None else self.n_terms + len(noise),
            criterion=self.criterion,
            err_tol=self.err_tol,
            keep=(*self.keep, *noise),
            search=self.search,
            folds=folds,
        )

    def _judge(self, selection: Selection) -> None:
        """Add a note if the single term of a model explains less than its complexity penalty."""
        if self.criterion in INFORMATION and selection.n_terms[0] == 1 and self.keep in ((), (CONSTANT,)):
            share, count = float(selection.err[0, 0]), selection.count[:1]
            cost = penalties(self.criterion, 1, len(self.terms), count)
            none, one = information(np.array([[1.0, 1.0 - share]]), cost, count)[0]
            if none < one:
                self.notes.append(
                    f"according to {self.criterion}, no term is significant; the term kept explains {100 * share:.1f} % of "
                    f"{self.output}, which may be chance"
                )


MAX_POWER_OFFSET = 1e5
"""A variable is centred if its middle is more than MAX_POWER_OFFSET^(1/degree) half-spans from 0.

Farther from 0, its powers are nearly collinear."""
MAX_OUTPUT_OFFSET = 100.0
"""The middle of the output is subtracted if it is more than this number of half-spans from 0.

Otherwise, the offset would dominate the sum of squares."""


def scale_for(terms: Terms, rows: LaggedData) -> Scale:
    """Return the scale that divides every variable by its magnitude, and centres it at a round number if far from 0."""
    names, centres, widths = [], [], []
    for variable in terms.variables:
        signals = {f.signal for term in terms for f in term if f.variable == variable and f.is_scaled}
        if not signals:
            continue
        low = min(float(rows.columns[name].min()) for name in signals)
        high = max(float(rows.columns[name].max()) for name in signals)
        middle, half = (low + high) / 2, (high - low) / 2
        centre = 0.0
        degree = max(sum(f.degree for f in term if f.variable == variable) for term in terms)
        if half > 0 and abs(middle) > MAX_POWER_OFFSET ** (1 / degree) * half:
            centre = _round(middle, half)
        width = max(abs(low - centre), abs(high - centre))
        names.append(variable)
        centres.append(centre)
        widths.append(_rounded_up(width) if width > 0 else 1.0)
    return Scale(tuple(names), tuple(centres), tuple(widths))


def middle_of(targets: Floats) -> float:
    """Return a round number near the middle of the output (n, 1); 0 if the middle is not far from 0."""
    low, high = float(np.nanmin(targets)), float(np.nanmax(targets))
    middle, half = low / 2 + high / 2, high / 2 - low / 2
    return _round(middle, half) if half > 0 and abs(middle) > MAX_OUTPUT_OFFSET * half else 0.0


def _round(middle: float, half: float) -> float:
    """Round the middle to a multiple of a power of ten that is at least the span."""
    unit = 10.0 ** np.ceil(np.log10(2 * half))
    return float(np.round(middle / unit) * unit)


def _rounded_up(width: float) -> float:
    """Round up to three digits, which keeps the domains of splines and wavelets readable."""
    unit = 10.0 ** (np.floor(np.log10(width)) - 2)
    return float(f"{np.ceil(width / unit * (1.0 - 1e-12)) * unit:.3g}")
