"""Score a model one step ahead, several steps ahead and in free run, compared with persistence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from robotmodic_ident.errors import IdentError
from robotmodic_ident.model import Narmax
from robotmodic_ident.records import Record, Records, as_records
from robotmodic_ident.scale import root_mean_square, size_of
from robotmodic_ident.types import Floats

Horizon = int | Literal["free"]
SOKAL_WINDOW = 5.0
"""The sum over lags ends when it spans this number of correlation times (Sokal 1997)."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """The agreement of a prediction with measurements."""

    n: int
    """Number of samples compared."""
    rmse: float
    """[units of the output] root mean square error."""
    rrse: float
    """RMSE over the standard deviation of the measurements; 1 corresponds to predicting the mean."""
    r: float
    """Pearson correlation."""
    r_low: float
    r_high: float
    """Limits of the 95 % interval of r."""
    p_value: float
    """p-value of the hypothesis r = 0, with the effective number of samples."""
    n_effective: float
    """Number of independent samples with the same information on r."""


@dataclass(frozen=True, kw_only=True)
class HorizonScore:
    """The scores of a model and of persistence at one horizon."""

    horizon: Horizon
    model: Score
    persistence: Score
    """Score of the last known output as the prediction; in free run, the output before its first prediction."""


@dataclass(frozen=True, kw_only=True)
class Extrapolation:
    """The share of samples outside the training data of a model, and its errors inside and outside."""

    share: float
    """Share of the samples with a leverage above `largest`, 0...1; nan for a fit without residual."""
    largest: float
    """Largest leverage of the samples of the fit."""
    rmse_inside: float
    rmse_outside: float
    """[units of the output] RMSE of the one-step prediction; nan without such samples."""


def extrapolation(model: Narmax, fitted: Records, records: Records) -> Extrapolation:
    """Compare the leverage of `records` with the largest leverage of the `fitted` records."""
    own = np.concatenate([_leverage(model, record) for record in as_records(fitted)])
    largest = float(np.max(own, initial=-np.inf, where=np.isfinite(own)))
    records = as_records(records)
    leverage = np.concatenate([_leverage(model, record) for record in records])
    residual = np.concatenate([model.residuals(record) for record in records])
    known = ~np.isnan(leverage) & np.isfinite(residual)
    beyond = leverage[known] > largest * (1.0 + 1e-9)
    residual = residual[known]
    return Extrapolation(
        share=_mean(beyond) if np.isfinite(largest) else float("nan"),
        largest=largest if np.isfinite(largest) else float("nan"),
        rmse_inside=root_mean_square(residual[~beyond]),
        rmse_outside=root_mean_square(residual[beyond]),
    )


def _leverage(model: Narmax, record: Record | Mapping[str, Floats]) -> Floats:
    """Return the leverage of the samples (n,) with a known output, which a fit can use; nan for the others."""
    (record,) = as_records(record)
    return np.where(np.isfinite(record.signals[model.output]), model.leverage(record), np.nan)


def _mean(values: NDArray[Any]) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


def score(measured: Floats, predicted: Floats) -> Score:
    """Compare two series (n,); samples that are unknown in either series are left out.

    Raises
    ------
    IdentError
        If fewer than 3 samples are known in both.
    """
    known = np.isfinite(measured) & np.isfinite(predicted)
    if (n := int(known.sum())) < 3:
        raise IdentError(f"{n} samples are known in both series; a score needs 3 or more")
    unit = size_of(measured[known], predicted[known])
    y, f = measured[known] / unit, predicted[known] / unit
    error, spread = root_mean_square(y - f), root_mean_square(y - y.mean())
    rmse, rrse = unit * error, error / spread if spread > 0 else float("nan")
    if np.ptp(y) == 0 or np.ptp(f) == 0:
        nan = float("nan")
        return Score(
            n=len(y), rmse=rmse, rrse=rrse, r=nan, r_low=nan, r_high=nan, p_value=nan, n_effective=nan
        )
    r = correlation(y, f)
    n_effective = effective_samples(y, f)
    low, high, p_value = _interval(r, n_effective)
    return Score(
        n=len(y), rmse=rmse, rrse=rrse, r=r, r_low=low, r_high=high, p_value=p_value, n_effective=n_effective
    )


def correlation(a: Floats, b: Floats) -> float:
    """Return the Pearson correlation of two series (n,) that are not constant, without overflow."""
    a, b = a - a.mean(), b - b.mean()
    a, b = a / size_of(a), b / size_of(b)
    return float(np.clip(a @ b / np.sqrt((a @ a) * (b @ b)), -1.0, 1.0))


def effective_samples(a: Floats, b: Floats) -> float:
    """Return the effective number of samples n / (1 + 2 Σ rho_a rho_b) for the correlation of two series (n,).

    rho_a and rho_b are the autocorrelations at each lag (Bartlett 1935; Pyper and Peterman 1998).
    """
    n = len(a)
    product = autocorrelation(a, n // 2) * autocorrelation(b, n // 2)
    time = 1.0 + 2.0 * np.cumsum((1.0 - np.arange(1, len(product)) / n) * product[1:])
    enough = np.arange(1, len(product)) >= SOKAL_WINDOW * time
    whole = time[enough.argmax()] if enough.any() else time.max(initial=1.0)
    return float(np.clip(n / max(whole, 1.0 / n), 2.0, n))


def autocorrelation(series: Floats, max_lag: int) -> Floats:
    """Return the autocorrelation at lags 0 to max_lag (max_lag + 1,), by FFT."""
    centred = series - series.mean()
    centred = centred / size_of(centred)
    size = 1 << int(2 * len(series) - 1).bit_length()
    power = np.abs(np.fft.rfft(centred, size)) ** 2
    value = np.fft.irfft(power, size)[: max_lag + 1]
    return np.asarray(value / value[0], dtype=np.float64)


def _interval(r: float, n: float) -> tuple[float, float, float]:
    """Return the 95 % interval of r by the Fisher z-transformation, and the p-value of a t-test."""
    if n <= 3.5:
        return -1.0, 1.0, 1.0
    z, half = np.arctanh(np.clip(r, -1 + 1e-15, 1 - 1e-15)), 1.96 / np.sqrt(n - 3)
    t = abs(r) * np.sqrt((n - 2) / max(1 - r * r, 1e-300))
    return float(np.tanh(z - half)), float(np.tanh(z + half)), float(2 * stdtr(n - 2, -t))


def scores(model: Narmax, records: Records, horizons: Sequence[Horizon] = (1, "free")) -> list[HorizonScore]:
    """Score a model and persistence at horizons [samples, or `free`], on the same samples."""
    records = as_records(records)
    out = []
    for horizon in horizons:
        predicted, last, measured = [], [], []
        for record in records:
            y = np.asarray(record.signals[model.output], dtype=np.float64)
            f = model.predict_mpo(record) if horizon == "free" else model.predict_k(record, horizon)
            hold = np.full(len(y), np.nan)
            for piece in record.segments():
                hold[piece] = _held(y[piece], f[piece], horizon)
            both = np.isfinite(f) & np.isfinite(hold)
            measured.append(np.where(both, y, np.nan))
            predicted.append(f)
            last.append(hold)
        y, f, hold = map(np.concatenate, (measured, predicted, last))
        out.append(HorizonScore(horizon=horizon, model=score(y, f), persistence=score(y, hold)))
    return out


def _held(y: Floats, predicted: Floats, horizon: Horizon) -> Floats:
    """Return the last known output at each sample of a segment (n,)."""
    out = np.full(len(y), np.nan)
    if horizon != "free":
        out[horizon:] = y[: max(len(y) - horizon, 0)]
        return out
    known = np.flatnonzero(np.isfinite(predicted))
    if len(known):
        start = max(int(known[0]), 1)
        out[start:] = y[start - 1]
    return out
