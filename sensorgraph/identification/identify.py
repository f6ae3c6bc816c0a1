"""Identify one signal from others: split the records, fit a model, score it on held-out records, report."""

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
from sensorgraph.arguments import Count
from sensorgraph.errors import SensorgraphError
from sensorgraph.identification.signals import SignalData, variable
from sensorgraph.types import Floats

Split = Literal["half", "block", "none"]
SPLITS: tuple[str, ...] = get_args(Split)
CRITERIA: tuple[str, ...] = get_args(Criterion)
N_BLOCKS = 10
"""Number of pieces into which `block` cuts a record; every second piece is held out."""
MAX_TERMS = 3000
"""Maximum number of candidate terms."""
MIN_SCORED_SAMPLES = 3
"""Minimum number of samples for a score."""
ROWS_PER_NOISE_LAG = 10
"""Minimum number of samples per noise lag."""
TESTED_LAGS = (20, 10, 5, 2)
"""[samples] Maximum lags of the residual tests; the largest that the data allow is used."""


@dataclass(frozen=True, kw_only=True)
class IdentificationSpec:
    """The output, the inputs, and the structure of the model."""

    output: str
    inputs: Sequence[str]
    lags: Count = 2
    """[samples] Inputs are used at k, k-1, ..., k-lags."""
    output_lags: Count = 0
    """[samples] Past outputs are used at k-1, ..., k-output_lags."""
    degree: Count = 2
    noise_lags: Count | Literal["auto"] = 0
    """[samples] Past noise is used at k-1, ..., k-noise_lags; `auto` chooses the number from the residual."""
    split: Split = "half"
    criterion: Criterion | None = None
    n_terms: int | None = None
    auto: bool = False
    """Choose lags, degree, terms and limits by free runs over held-out intervals; the values given here are ignored."""

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
                "auto chooses the terms and has no noise terms; leave out noise_lags, criterion and n_terms"
            )
        if not self.inputs and not self.output_lags and not self.auto:
            raise SensorgraphError(
                "the output has no explanatory signal; give `inputs`, or `output_lags` above 0"
            )
        if "record" in (self.output, *self.inputs):
            raise SensorgraphError("column record separates records and is not a signal; give other signals")
        if self.output in self.inputs:
            raise SensorgraphError(
                f"{self.output} is output and input; to use its past, give `output_lags` N"
            )
        if len(set(self.inputs)) < len(self.inputs):
            raise SensorgraphError(f"an input is given twice: {', '.join(self.inputs)}")

    @property
    def terms(self) -> Terms:
        """Candidate terms: all products of the lagged signals up to the degree."""
        signals = lags(variable(self.output), 1, self.output_lags) if self.output_lags else []
        for name in self.inputs:
            signals += lags(variable(name), 0, self.lags)
        size = math.comb(len(signals) + self.degree, self.degree)
        if size > MAX_TERMS:
            raise SensorgraphError(
                f"{len(signals)} lagged signals of degree {self.degree} give {size:,} candidate terms, expected at most "
                f"{MAX_TERMS:,}; lower `degree` or `lags`, or give fewer inputs"
            )
        return polynomial(signals, self.degree)

    @property
    def look_back(self) -> int:
        """[samples] Largest lag."""
        return max(self.lags if self.inputs else 0, self.output_lags)


@dataclass(frozen=True, kw_only=True, eq=False)
class IdentifiedSignal:
    """The model and its performance on the held-out records."""

    model: Narmax
    question: IdentificationSpec
    data: SignalData
    test: list[Record]
    measured: list[Floats]
    one_step: list[Floats]
    free_run: list[Floats]
    scores: dict[str, Score]
    """`one_step`, `free_run`, `persistence` (the last measured value), `constant` (the mean of the training data)."""
    validation: list[dict[str, Any]]
    outside: Extrapolation
    """Share and errors of the scored samples outside the range of the training data."""
    n_train: int
    unknown: dict[str, float]
    """Signal -> share of unknown samples."""

    def __repr__(self) -> str:
        """Summarise the model in a few lines."""
        return (
            f"IdentifiedSignal of {self.question.output}, {self.n_train:,} training samples\n{self.model!r}"
        )

    @property
    def varies(self) -> bool:
        """Whether the measured output varies in the scored records."""
        values = np.concatenate(self.measured)
        values = values[np.isfinite(values)]
        return bool(len(values)) and float(np.ptp(values)) > 0

    def report(self) -> dict[str, Any]:
        """Return the content of the model file: the model, the specification, and the scores."""
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
    """Fit a model to one part of the records and score it on the other part."""
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
    """Return the model, and the specification with the chosen lags and degree."""
    if question.auto:
        found = auto_fit(train, output, [variable(name) for name in question.inputs])
        order, degree = found.chosen.order, found.chosen.degree
        return found.model, replace(question, lags=order, output_lags=order, degree=degree)
    n, criterion = question.n_terms, question.criterion
    model = fit(train, output, question.terms, n_terms=n, criterion=criterion, noise=question.noise_lags)
    return model, question


def _validated(model: Narmax, test: list[Record], question: IdentificationSpec) -> list[dict[str, Any]]:
    """Return the residual tests on the held-out records; empty if these are too short for every lag."""
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
    """Return training and test records; no lag crosses from one into the other.

    - `half`: The first half of each record is for training, the second half for scores.
    - `block`: Each record is cut into ten pieces, and every second piece is held out.
    - `none`: All records are used for training and for scores.
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
    """Return signal -> share of unknown samples; refuse a signal without a known sample."""
    out = {}
    for key, name in data.names.items():
        values = np.concatenate([r.signals[key] for r in data.records])
        out[name] = float(np.mean(~np.isfinite(values)))
        if out[name] == 1.0:
            raise SensorgraphError(
                f"{name} has no known sample; leave it out, or check the file with `sensorgraph inspect`"
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
            f"the longest interval without a gap has {longest[0]} samples for training and {longest[1]} for testing; "
            f"lags of {question.look_back} need {need} each; lower the lags, or give longer records"
        )
    known = np.concatenate([r.signals[output] for r in train])
    known = known[np.isfinite(known)]
    if not len(known) or float(np.ptp(known)) <= 1e-12 * max(float(np.abs(known).max()), 1e-300):
        raise SensorgraphError(
            f"{question.output} is constant in the training data; expected a signal that varies"
        )
    usable = _rows(train, question)
    if usable < len(question.terms):
        holes = ", ".join(f"{name} {100 * share:.0f} % unknown" for name, share in unknown.items() if share)
        raise SensorgraphError(
            f"{usable} complete samples are too few for {len(question.terms)} candidate terms"
            f"{f' ({holes})' if holes else ''}; lower `degree` or `lags`, or give more data"
        )
    if question.noise_lags != "auto" and question.noise_lags > usable // ROWS_PER_NOISE_LAG:
        raise SensorgraphError(
            f"{usable} complete samples are too few for {question.noise_lags} noise lags; give at most "
            f"{usable // ROWS_PER_NOISE_LAG}, or auto"
        )


def _rows(records: list[Record], question: IdentificationSpec) -> int:
    """Count the samples at which all lagged signals are known."""
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
    """Return the value before each sample (n,); nan after a gap."""
    out = np.full(len(record), np.nan)
    for piece in record.segments():
        out[piece.start + 1 : piece.stop] = record.signals[output][piece.start : piece.stop - 1]
    return out


def score(measured: Sequence[Floats], predicted: Sequence[Floats]) -> Score:
    """Score predictions of several records at the samples where measurement and prediction are known."""
    x, y = np.concatenate(list(measured)), np.concatenate(list(predicted))
    n = int((np.isfinite(x) & np.isfinite(y)).sum())
    if n < MIN_SCORED_SAMPLES:  # the free run diverged, or the records are too short for a prediction
        nan = math.nan
        return Score(n=n, rmse=nan, rrse=nan, r=nan, r_low=nan, r_high=nan, p_value=nan, n_effective=nan)
    with np.errstate(over="ignore", invalid="ignore"):  # the free run may diverge
        return score_series(x, y)


def finite_numbers(s: Score | Extrapolation) -> dict[str, float | None]:
    """Return scores as plain data; an undefined score is None."""
    return {k: v if math.isfinite(v) else None for k, v in vars(s).items()}
