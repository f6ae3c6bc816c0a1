"""Identify one signal from others: split, fit, score on what the fit has not seen, and say it all in one report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from robotmodic_ident import Narmax, Record, Terms, auto_fit, fit, lags, polynomial
from robotmodic_ident.errors import IdentError
from robotmodic_ident.records import check_names, cut
from robotmodic_ident.selection.criteria import Criterion
from robotmodic_ident.validation.residual_tests import validate
from robotmodic_ident.validation.score import Extrapolation, Score, extrapolation
from robotmodic_ident.validation.score import score as score_series
from sensorgraph.errors import SensorgraphError
from sensorgraph.identification.signals import SignalData, variable
from sensorgraph.types import Floats

Split = Literal["half", "block", "none"]
SPLITS: tuple[str, ...] = get_args(Split)
CRITERIA: tuple[str, ...] = get_args(Criterion)
N_BLOCKS = 10
"""Pieces that a record is cut into by `block`; every second one is held out."""
MAX_TERMS = 3000
MIN_SCORED_SAMPLES = 3
"""Samples that a score needs."""
ROWS_PER_NOISE_LAG = 10
TESTED_LAGS = (20, 10, 5, 2)
"""[samples] of the residual tests: the most that the data allow."""


@dataclass(frozen=True, kw_only=True)
class IdentificationSpec:
    """What is to be explained, by what, and in which form."""

    output: str
    inputs: Sequence[str]
    lags: int = 2
    """[samples] inputs are read at k, k-1, ..., k-lags."""
    output_lags: int = 0
    """[samples] past outputs k-1, ..., k-output_lags."""
    degree: int = 2
    noise_lags: int | Literal["auto"] = 0
    """[samples] past noise e(k-1), ..., e(k-noise_lags); `auto`: as many as the residual asks for."""
    split: Split = "half"
    criterion: Criterion | None = None
    n_terms: int | None = None
    auto: bool = False
    """Lags, degree, terms and limits are chosen by free runs over stretches left out; what is given here is not used."""

    def __post_init__(self) -> None:
        try:
            check_names(self.output, self.inputs)
        except IdentError as exc:
            raise SensorgraphError(str(exc)) from exc
        if self.split not in SPLITS:
            raise SensorgraphError(f"split is {self.split!r}, expected one of {', '.join(SPLITS)}")
        if self.criterion is not None and self.criterion not in CRITERIA:
            raise SensorgraphError(f"criterion is {self.criterion!r}, expected one of {', '.join(CRITERIA)}")
        if self.criterion == "n_terms" and self.n_terms is None:
            raise SensorgraphError("criterion n_terms needs `n_terms` N")
        if self.auto and (self.noise_lags or self.criterion or self.n_terms):
            raise SensorgraphError(
                "auto chooses the terms and has no noise terms; leave noise_lags, criterion and n_terms out"
            )
        if not self.inputs and not self.output_lags and not self.auto:
            raise SensorgraphError(
                "nothing to explain the output by; give `inputs`, or `output_lags` above 0"
            )
        if "record" in (self.output, *self.inputs):
            raise SensorgraphError("record separates records and is no signal; name others")
        if self.output in self.inputs:
            raise SensorgraphError(
                f"{self.output} cannot explain itself; its past is read with `output_lags` N"
            )
        if len(set(self.inputs)) < len(self.inputs):
            raise SensorgraphError(f"an input is given twice: {', '.join(self.inputs)}")

    @property
    def terms(self) -> Terms:
        """The dictionary: all products up to the degree."""
        signals = lags(variable(self.output), 1, self.output_lags) if self.output_lags else []
        for name in self.inputs:
            signals += lags(variable(name), 0, self.lags)
        size = math.comb(len(signals) + self.degree, self.degree)
        if size > MAX_TERMS:
            raise SensorgraphError(
                f"{len(signals)} lagged signals of degree {self.degree} make {size:,} candidate terms, more than "
                f"{MAX_TERMS:,}; lower `degree` or `lags`, or give fewer inputs"
            )
        return polynomial(signals, self.degree)

    @property
    def look_back(self) -> int:
        """[samples]"""
        return max(self.lags if self.inputs else 0, self.output_lags)


@dataclass(frozen=True, kw_only=True, eq=False)
class IdentifiedSignal:
    """The model, and how it does on the records held out."""

    model: Narmax
    question: IdentificationSpec
    data: SignalData
    test: list[Record]
    measured: list[Floats]
    one_step: list[Floats]
    free_run: list[Floats]
    scores: dict[str, Score]
    """`one_step`, `free_run`, `persistence` (the last measured value), `constant` (the mean of the training)."""
    validation: list[dict[str, Any]]
    outside: Extrapolation
    """What of the part that is scored lies where the model was not fitted."""
    n_train: int
    unknown: dict[str, float]
    """Signal -> share of its samples that are not known."""

    @property
    def varies(self) -> bool:
        """Whether what was measured varies at all in the part that is scored."""
        values = np.concatenate(self.measured)
        values = values[np.isfinite(values)]
        return bool(len(values)) and float(np.ptp(values)) > 0

    def report(self) -> dict[str, Any]:
        """Return the model file: the model itself, the question, and the scores."""
        q = self.question
        return {
            **self.model.to_dict(),
            "inputs": list(q.inputs),
            "one_step": finite_numbers(self.scores["one_step"]),
            "free_run": finite_numbers(self.scores["free_run"]),
            "baselines": {k: finite_numbers(self.scores[k]) for k in ("persistence", "constant")},
            "validation": self.validation,
            "split": q.split,
            "outside": finite_numbers(self.outside),
            "signals": dict(self.data.names),
            "period_s": self.data.period,
            "held": dict(self.data.held),
            "n_train": self.n_train,
            "unknown": self.unknown,
            "candidates": len(q.terms),
            "noise_lags": q.noise_lags,
            "auto": q.auto,
            "order": [q.output_lags, q.lags],
            "degree": q.degree,
        }


def identify(data: SignalData, question: IdentificationSpec) -> IdentifiedSignal:
    """Fit a model on one part of the records and score it on the other."""
    output = variable(question.output)
    unknown = _shares(data)
    train, test = split_records(data.records, question.split)
    if question.auto:
        question = replace(question, lags=1, output_lags=1, degree=1)
    _check(data, train, test, question, unknown)
    model, question = _fitted(train, output, question)
    measured = [np.asarray(r.signals[output], dtype=np.float64) for r in test]
    one_step = [model.predict_osa(r) for r in test]
    reads_past = output in model.terms.variables or len(model.noise_terms) > 0
    free_run = [model.predict_mpo(r) for r in test] if reads_past else one_step
    mean = float(np.nanmean(np.concatenate([r.signals[output] for r in train])))
    before = [_previous_value(r, output) for r in test]
    scores = {
        "one_step": score(measured, one_step),
        "free_run": score(measured, free_run),
        "persistence": score(measured, before),
        "constant": score(measured, [np.full(len(m), mean) for m in measured]),
    }
    return IdentifiedSignal(
        model=model, question=question, data=data, test=test, measured=measured, one_step=one_step,
        free_run=free_run, scores=scores, validation=_validated(model, test, question),
        outside=extrapolation(model, train, test), n_train=model.n_samples,
        unknown=unknown,
    )  # fmt: skip


def _fitted(
    train: list[Record], output: str, question: IdentificationSpec
) -> tuple[Narmax, IdentificationSpec]:
    """Return the model, and the question with the lags and the degree that were chosen."""
    if question.auto:
        found = auto_fit(train, output, [variable(name) for name in question.inputs])
        order, degree = found.chosen.order, found.chosen.degree
        return found.model, replace(question, lags=order, output_lags=order, degree=degree)
    n, criterion = question.n_terms, question.criterion
    model = fit(train, output, question.terms, n_terms=n, criterion=criterion, noise=question.noise_lags)
    return model, question


def _validated(model: Narmax, test: list[Record], question: IdentificationSpec) -> list[dict[str, Any]]:
    """Return the residual tests on what was held out; none where it is too short for any lag."""
    inputs = [variable(name) for name in question.inputs]
    for max_lag in TESTED_LAGS:
        try:
            checks = validate(model, test, max_lag=max_lag, inputs=inputs, fitted=question.split == "none")
        except IdentError:
            continue
        return [
            {"test": c.test, "statistic": c.statistic, "p_value": c.p_value, "max_lag": max_lag}
            for c in checks
        ]
    return []


def split_records(records: Sequence[Record], split: str) -> tuple[list[Record], list[Record]]:
    """Return what to train on and what to score on; no lag crosses from one into the other.

    `half`: the first half of every record trains, the second is scored. `block`: a record is cut in ten pieces,
    every second of which is held out. `none`: everything trains, and the same is scored.
    """
    if split == "none":
        return list(records), list(records)
    train: list[Record] = []
    test: list[Record] = []
    for record in records:
        n = len(record)
        n_pieces = 2 if split == "half" else N_BLOCKS
        edges = [round(i * n / n_pieces) for i in range(n_pieces + 1)]
        for i in range(n_pieces):
            piece = cut(record, slice(edges[i], edges[i + 1]))
            if len(piece):
                (test if i % 2 else train).append(piece)
    return train, test


def _shares(data: SignalData) -> dict[str, float]:
    """Return signal -> share of unknown samples, and refuse what is not known at all."""
    out = {}
    for key, name in data.names.items():
        values = np.concatenate([r.signals[key] for r in data.records])
        out[name] = float(np.mean(~np.isfinite(values)))
        if out[name] == 1.0:
            raise SensorgraphError(
                f"{name} has no known sample; leave it out, or look at the file with `inspect`"
            )
    return out


def _check(
    data: SignalData,
    train: list[Record],
    test: list[Record],
    question: IdentificationSpec,
    unknown: dict[str, float],
) -> None:
    output, need = variable(question.output), question.look_back + 1
    longest = [
        max((s.stop - s.start for r in part for s in r.segments()), default=0) for part in (train, test)
    ]
    if min(longest) < need:
        raise SensorgraphError(
            f"the longest stretch to train on has {longest[0]} samples, to test on {longest[1]}; lags of "
            f"{question.look_back} need {need} each; lower the lags, or give longer records"
        )
    known = np.concatenate([r.signals[output] for r in train])
    known = known[np.isfinite(known)]
    if not len(known) or float(np.ptp(known)) <= 1e-12 * max(float(np.abs(known).max()), 1e-300):
        raise SensorgraphError(
            f"{question.output} is constant in the training part; there is nothing to explain"
        )
    usable = _rows(train, question)
    if usable < len(question.terms):
        holes = ", ".join(f"{name} {share:.0%} unknown" for name, share in unknown.items() if share)
        raise SensorgraphError(
            f"{usable} whole samples cannot train a dictionary of {len(question.terms)} terms"
            f"{f' ({holes})' if holes else ''}; lower `degree` or `lags`, or give more data"
        )
    if question.noise_lags != "auto" and question.noise_lags > usable // ROWS_PER_NOISE_LAG:
        raise SensorgraphError(
            f"{usable} whole samples cannot tell {question.noise_lags} noise lags; give "
            f"{usable // ROWS_PER_NOISE_LAG} at most, or auto"
        )


def _rows(records: list[Record], question: IdentificationSpec) -> int:
    """Count samples at which every signal of the dictionary is known."""
    past = [(variable(question.output), 0)] + [
        (variable(question.output), lag) for lag in range(1, question.output_lags + 1)
    ]
    past += [(variable(name), lag) for name in question.inputs for lag in range(question.lags + 1)]
    total = 0
    for record in records:
        for piece in record.segments():
            k = np.arange(piece.start + question.look_back, piece.stop)
            total += int(np.all([np.isfinite(record.signals[v][k - lag]) for v, lag in past], axis=0).sum())
    return total


def _previous_value(record: Record, output: str) -> Floats:
    """Return the value before each sample (n,); nan at the start of a stretch."""
    out = np.full(len(record), np.nan)
    for piece in record.segments():
        out[piece.start + 1 : piece.stop] = record.signals[output][piece.start : piece.stop - 1]
    return out


def score(measured: Sequence[Floats], predicted: Sequence[Floats]) -> Score:
    """Score predictions of several records, where both are known."""
    x, y = np.concatenate(list(measured)), np.concatenate(list(predicted))
    n = int((np.isfinite(x) & np.isfinite(y)).sum())
    if n < MIN_SCORED_SAMPLES:  # a free run that left for infinity, records too short for a prediction
        nan = math.nan
        return Score(n=n, rmse=nan, rrse=nan, r=nan, r_low=nan, r_high=nan, p_value=nan, n_effective=nan)
    with np.errstate(over="ignore", invalid="ignore"):  # on its way to infinity
        return score_series(x, y)


def finite_numbers(s: Score | Extrapolation) -> dict[str, float | None]:
    """Return scores as plain data; what is not defined is None."""
    return {k: v if math.isfinite(v) else None for k, v in vars(s).items()}
