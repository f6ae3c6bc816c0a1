"""Identify one signal from others: split, fit, score on what the fit has not seen, and say it all in one report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from scipy.special import stdtr

from planners.arena import Floats
from robotmodic_ident import Narmax, Record, Terms, fit, lags, polynomial
from robotmodic_ident.criteria import Criterion
from sensorgraph.errors import GapError
from sensorgraph.signals import Data, variable

Split = Literal["half", "block", "none"]
SPLITS: tuple[str, ...] = get_args(Split)
CRITERIA: tuple[str, ...] = get_args(Criterion)
BLOCKS = 10
"""Pieces that a record is cut into by `block`; every second one is held out."""
MOST_TERMS = 3000


@dataclass(frozen=True, kw_only=True)
class Question:
    """What is to be explained, by what, and in which form."""

    output: str
    inputs: Sequence[str]
    lags: int = 2
    """[samples] inputs are read at k, k-1, ..., k-lags."""
    output_lags: int = 0
    """[samples] past outputs k-1, ..., k-output_lags."""
    degree: int = 2
    noise_lags: int = 0
    split: Split = "half"
    criterion: Criterion | None = None
    n_terms: int | None = None

    def __post_init__(self) -> None:
        if self.split not in SPLITS:
            raise GapError(f"split is {self.split!r}, expected one of {', '.join(SPLITS)}")
        if self.criterion is not None and self.criterion not in CRITERIA:
            raise GapError(f"criterion is {self.criterion!r}, expected one of {', '.join(CRITERIA)}")
        if self.criterion == "n_terms" and self.n_terms is None:
            raise GapError("criterion n_terms needs --terms N")
        if not self.inputs and not self.output_lags:
            raise GapError("nothing to explain the output by; give --inputs, or --output-lags above 0")
        if self.output in self.inputs:
            raise GapError(f"{self.output} cannot explain itself; its past is read with --output-lags N")
        if len(set(self.inputs)) < len(self.inputs):
            raise GapError(f"an input is given twice: {', '.join(self.inputs)}")

    @property
    def terms(self) -> Terms:
        """The dictionary: all products up to the degree."""
        signals = lags(variable(self.output), 1, self.output_lags) if self.output_lags else []
        for name in self.inputs:
            signals += lags(variable(name), 0, self.lags)
        size = math.comb(len(signals) + self.degree, self.degree)
        if size > MOST_TERMS:
            raise GapError(
                f"{len(signals)} lagged signals of degree {self.degree} make {size:,} candidate terms, more than "
                f"{MOST_TERMS:,}; lower --degree or --lags, or give fewer inputs"
            )
        return polynomial(signals, self.degree)

    @property
    def look_back(self) -> int:
        """[samples]"""
        return max(self.lags if self.inputs else 0, self.output_lags)


@dataclass(frozen=True, kw_only=True)
class Score:
    """How well a series is predicted."""

    rmse: float
    rrse: float
    """RMSE over that of the mean of what was measured: 1 is no better than the mean."""
    r: float
    """Pearson's correlation; nan where one of both does not vary."""
    r_low: float
    r_high: float
    """95 % interval of r, by the effective sample size."""
    p_value: float
    """Of no correlation, by the effective sample size."""
    n: int
    n_effective: float
    """How many independent samples the autocorrelated series are worth."""

    def to_dict(self) -> dict[str, float | None]:
        """Return plain data; what is not defined is None."""
        return {k: v if math.isfinite(v) else None for k, v in vars(self).items()}


@dataclass(frozen=True, kw_only=True, eq=False)
class Identified:
    """The model, and how it does on the records held out."""

    model: Narmax
    question: Question
    data: Data
    test: list[Record]
    measured: list[Floats]
    one_step: list[Floats]
    free_run: list[Floats]
    scores: dict[str, Score]
    """`one_step`, `free_run`, `persistence` (the last measured value), `constant` (the mean of the training)."""
    validation: list[dict[str, Any]]
    n_train: int
    unknown: dict[str, float]
    """Signal -> share of its samples that are not known."""

    def report(self) -> dict[str, Any]:
        """Return the model file: the model itself, the question, and the scores."""
        q = self.question
        return {
            **self.model.to_dict(),
            "inputs": list(q.inputs),
            "one_step": self.scores["one_step"].to_dict(),
            "free_run": self.scores["free_run"].to_dict(),
            "baselines": {k: self.scores[k].to_dict() for k in ("persistence", "constant")},
            "validation": self.validation,
            "split": q.split,
            "signals": dict(self.data.names),
            "period_s": self.data.period,
            "held": dict(self.data.held),
            "n_train": self.n_train,
            "unknown": self.unknown,
            "candidates": len(q.terms),
        }


def identify(data: Data, question: Question) -> Identified:
    """Fit a model on one part of the records and score it on the other."""
    output = variable(question.output)
    unknown = _shares(data)
    train, test = split_records(data.records, question.split)
    _check(data, train, test, question, unknown)
    terms = question.terms
    model = _fitted(train, output, terms, question)
    measured = [np.asarray(r.signals[output], dtype=np.float64) for r in test]
    one_step = [model.predict_osa(r) for r in test]
    free_run = [model.predict_mpo(r) for r in test] if output in model.terms.variables else one_step
    mean = float(np.nanmean(np.concatenate([r.signals[output] for r in train])))
    before = [_last(r, output) for r in test]
    scores = {
        "one_step": score(measured, one_step),
        "free_run": score(measured, free_run),
        "persistence": score(measured, before),
        "constant": score(measured, [np.full(len(m), mean) for m in measured]),
    }
    return Identified(
        model=model, question=question, data=data, test=test, measured=measured, one_step=one_step,
        free_run=free_run, scores=scores, validation=_validated(model, test), n_train=model.n_samples,
        unknown=unknown,
    )  # fmt: skip


def _fitted(train: list[Record], output: str, terms: Terms, question: Question) -> Narmax:
    n, criterion = question.n_terms, question.criterion
    return fit(train, output, terms, n_terms=n, criterion=criterion, noise=question.noise_lags)


def _validated(model: Narmax, test: list[Record]) -> list[dict[str, Any]]:
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
        n_pieces = 2 if split == "half" else BLOCKS
        edges = [round(i * n / n_pieces) for i in range(n_pieces + 1)]
        for i in range(n_pieces):
            piece = cut(record, slice(edges[i], edges[i + 1]))
            if len(piece):
                (test if i % 2 else train).append(piece)
    return train, test


def cut(record: Record, piece: slice) -> Record:
    """Return a stretch of a record; what counts as a gap stays as it was."""
    gap = record.max_gap
    if gap is None and record.stamps is not None and len(record) > 1:
        gap = 1.5 * float(np.median(np.diff(record.stamps)))
    return replace(
        record,
        signals={name: values[piece] for name, values in record.signals.items()},
        stamps=None if record.stamps is None else record.stamps[piece],
        max_gap=gap,
    )


def _shares(data: Data) -> dict[str, float]:
    """Return signal -> share of unknown samples, and refuse what is not known at all."""
    out = {}
    for key, name in data.names.items():
        values = np.concatenate([r.signals[key] for r in data.records])
        out[name] = float(np.mean(~np.isfinite(values)))
        if out[name] == 1.0:
            raise GapError(f"{name} has no known sample; leave it out, or look at the file with `inspect`")
    return out


def _check(
    data: Data, train: list[Record], test: list[Record], question: Question, unknown: dict[str, float]
) -> None:
    output, need = variable(question.output), question.look_back + 1
    longest = max((s.stop - s.start for r in train for s in r.segments()), default=0)
    if longest < need or not any(s.stop - s.start >= need for r in test for s in r.segments()):
        raise GapError(
            f"the longest stretch to train on has {longest} samples, lags of {question.look_back} need {need} "
            "in training and test each; lower the lags, or give longer records"
        )
    known = np.concatenate([r.signals[output] for r in train])
    known = known[np.isfinite(known)]
    if not len(known) or float(np.ptp(known)) <= 1e-12 * max(float(np.abs(known).max()), 1e-300):
        raise GapError(f"{question.output} is constant in the training part; there is nothing to explain")
    usable = _rows(train, question)
    if usable < len(question.terms):
        holes = ", ".join(f"{name} {share:.0%} unknown" for name, share in unknown.items() if share)
        raise GapError(
            f"{usable} whole samples cannot train a dictionary of {len(question.terms)} terms"
            f"{f' ({holes})' if holes else ''}; lower --degree or --lags, or give more data"
        )


def _rows(records: list[Record], question: Question) -> int:
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


def _last(record: Record, output: str) -> Floats:
    """Return the value before each sample (n,); nan at the start of a stretch."""
    out = np.full(len(record), np.nan)
    for piece in record.segments():
        out[piece.start + 1 : piece.stop] = record.signals[output][piece.start : piece.stop - 1]
    return out


def score(measured: Sequence[Floats], predicted: Sequence[Floats]) -> Score:
    """Score predictions, record by record, where both are known."""
    parts = [
        (m[ok], p[ok])
        for m, p in zip(measured, predicted, strict=True)
        for ok in [np.isfinite(m) & np.isfinite(p)]
        if ok.any()
    ]
    if not parts:
        nan = math.nan
        return Score(rmse=nan, rrse=nan, r=nan, r_low=nan, r_high=nan, p_value=nan, n=0, n_effective=0.0)
    x, y = (np.concatenate(side) for side in zip(*parts, strict=True))
    rmse = float(np.sqrt(np.mean((x - y) ** 2)))
    spread = float(x.std())
    vary = spread > 0 and float(y.std()) > 1e-12 * max(spread, float(np.abs(y).max()))
    n_effective = effective_samples(parts) if vary else float(len(x))
    r = float(np.corrcoef(x, y)[0, 1]) if vary else math.nan
    low, high, p_value = interval(r, n_effective)
    return Score(
        rmse=rmse, rrse=rmse / spread if spread > 0 else math.nan, r=r, r_low=low, r_high=high,
        p_value=p_value, n=len(x), n_effective=n_effective,
    )  # fmt: skip


def effective_samples(parts: Sequence[tuple[Floats, Floats]]) -> float:
    """Return how many independent pairs a set of autocorrelated series is worth.

    n / (1 + 2 Σ (1 - k/n) ρx(k) ρy(k)), Bartlett 1946; the sum ends where the product is no longer positive.
    """
    n = sum(len(x) for x, _ in parts)
    longest = max(len(x) for x, _ in parts)
    rho = np.ones(longest)
    for side in range(2):
        centre = np.concatenate([part[side] for part in parts]).mean()
        total = np.zeros(longest)
        for part in parts:
            z = part[side] - centre
            size = 1 << (2 * len(z) - 1).bit_length()
            power = np.abs(np.fft.rfft(z, size)) ** 2
            total[: len(z)] += np.fft.irfft(power, size)[: len(z)]
        rho *= total / total[0]
    end = int(np.argmax(rho <= 0)) if (rho <= 0).any() else longest
    worth = 1.0 + 2.0 * float(((1 - np.arange(1, end) / n) * rho[1:end]).sum())
    return float(min(max(n / worth, 2.0), n))


def interval(r: float, n: float) -> tuple[float, float, float]:
    """Return the 95 % interval of a correlation (Fisher 1915), and the p-value of no correlation."""
    if not math.isfinite(r) or n <= 3.0:
        return math.nan, math.nan, math.nan
    z, half = math.atanh(min(max(r, -1 + 1e-15), 1 - 1e-15)), 1.96 / math.sqrt(n - 3.0)
    t = abs(r) * math.sqrt((n - 2.0) / max(1.0 - r * r, 1e-300))
    return math.tanh(z - half), math.tanh(z + half), float(2.0 * stdtr(n - 2.0, -t))
