"""Narmax: one output as a sum of terms; its equation, its predictions, its file."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from robotmodic_ident.errors import IdentError
from robotmodic_ident.expand import expand
from robotmodic_ident.moments import Moments
from robotmodic_ident.records import Record, as_records, lagged
from robotmodic_ident.scale import UNSCALED, Scale
from robotmodic_ident.select import Criterion, Selection, select
from robotmodic_ident.terms import Factor, Floats, Terms

FORMAT = "robotmodic-narmax-1"


@dataclass(frozen=True, kw_only=True, eq=False)
class Narmax:
    """A polynomial model of one output; without lagged inputs it is a static equation."""

    output: str
    """Name of the output, as the terms call it."""
    terms: Terms
    theta: Floats
    """(n_terms,) coefficients of the scaled terms."""
    covariance: Floats
    """(n_terms, n_terms) of theta."""
    err: Floats
    """(n_terms,) error reduction ratio when the term was chosen, 0...1."""
    sigma: float
    """Standard deviation of the one-step residual."""
    n_samples: int
    """Rows it was fitted on."""
    scale: Scale = field(default=UNSCALED)
    stop: str = "n_terms"
    """Why the selection ended."""

    def __post_init__(self) -> None:
        k = len(self.terms)
        shapes = (self.theta.shape, self.covariance.shape, self.err.shape)
        if shapes != ((k,), (k, k), (k,)):
            raise ValueError(f"theta, covariance, err have shapes {shapes} with {k} terms")

    @classmethod
    def of(cls, selection: Selection, index: int, output: str) -> Narmax:
        """Take one output out of a selection, terms in order of choice."""
        chosen = selection.chosen(index)
        return cls(
            output=output,
            terms=selection.terms[chosen.tolist()],
            theta=selection.theta[index, chosen],
            covariance=selection.covariance(index),
            err=selection.err[index, : len(chosen)],
            sigma=float(selection.sigma[index]),
            n_samples=int(selection.count[index]),
            scale=selection.scale,
            stop=selection.stop[index],
        )

    @property
    def stderr(self) -> Floats:
        """(n_terms,) standard error of theta."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def is_dynamic(self) -> bool:
        """Tell whether any term has a lag."""
        return any(f.lag is not None for term in self.terms for f in term)

    def in_user_units(self) -> Narmax:
        """Return the same model with the scaling multiplied out.

        `err` stays with its term where variables are only divided by a width; terms that centring creates
        have none (nan).
        """
        terms, theta, linear = expand(self.terms, self.theta, self.scale)
        kept = terms.names == self.terms.names
        return replace(
            self,
            terms=terms,
            theta=theta,
            covariance=linear @ self.covariance @ linear.T,
            err=self.err if kept else np.full(len(terms), np.nan),
            scale=UNSCALED,
        )

    def equation(self, *, digits: int = 6, scaled: bool = False) -> str:
        """Print the model; in the user's units, or in the scaled variables if `scaled`."""
        terms, theta = (self.terms, self.theta) if scaled else expand(self.terms, self.theta, self.scale)[:2]
        left = f"{self.output}(k)" if self.is_dynamic else self.output
        return f"{left} = {sum_text(terms, theta, digits=digits)}"

    def predict_osa(self, record: Record | Mapping[str, Floats]) -> Floats:
        """Predict each sample from the measured past (n,); nan where that is not known."""
        (record,) = as_records(record)
        out = np.full(len(record), np.nan)
        signals = dict(record.signals)
        name = self.output if self.output in signals else next(iter(signals))  # static: any signal will do
        rows = lagged(
            Record(signals=signals, stamps=record.stamps, max_gap=record.max_gap), self.terms, [name]
        )
        out[rows.sample] = self.terms.matrix(rows.columns, self.scale, n=len(rows.sample)) @ self.theta
        return out

    def predict_mpo(self, record: Record | Mapping[str, Floats]) -> Floats:
        """Predict in free run (n,): past outputs are predictions, measured ones only start each stretch.

        The first `max_lag` samples of a stretch are nan. Where an input is not known the prediction stops,
        and starts again from measured outputs.
        """
        (record,) = as_records(record)
        if self.output not in {f.variable for term in self.terms for f in term}:
            return self.predict_osa(record)
        out = np.full(len(record), np.nan)
        measured = np.asarray(record.signals[self.output], dtype=np.float64)
        fixed, feedback = self._split(record)
        for piece in record.segments():
            self._free_run(out[piece], measured[piece], fixed[piece], feedback)
        return out

    def _split(self, record: Record) -> tuple[Floats, list[list[tuple[int, Callable[[float], float]]]]]:
        """Return what each term owes to inputs (n, n_terms), and its factors of past outputs."""
        n = len(record)
        fixed = np.ones((n, len(self.terms)))
        feedback: list[list[tuple[int, Callable[[float], float]]]] = []
        for j, term in enumerate(self.terms):
            past: list[tuple[int, Callable[[float], float]]] = []
            for f in term:
                if f.variable == self.output:
                    if not f.lag:
                        raise IdentError(f"term {self.terms.names[j]} explains {self.output} by itself")
                    past.append((f.lag, _scalar(f, self.scale)))
                    continue
                values = np.full(n, np.nan)
                lag = f.lag or 0
                source = np.asarray(record.signals[f.variable], dtype=np.float64)
                values[lag:] = source[: n - lag] if lag else source
                fixed[:, j] *= Terms(((f,),)).matrix({f.signal: values}, self.scale)[:, 0]
            feedback.append(past)
        return fixed, feedback

    def _free_run(
        self,
        out: Floats,
        measured: Floats,
        fixed: Floats,
        feedback: list[list[tuple[int, Callable[[float], float]]]],
    ) -> None:
        """Fill `out` (a view of one stretch) sample by sample."""
        look_back = self.terms.max_lag
        lags = sorted({lag for past in feedback for lag, _ in past})
        weights = self.theta.tolist()
        for k in range(look_back, len(out)):
            past = {lag: out[k - lag] if np.isfinite(out[k - lag]) else measured[k - lag] for lag in lags}
            total = 0.0
            for weight, base, factors in zip(weights, fixed[k].tolist(), feedback, strict=True):
                value = weight * base
                for lag, function in factors:
                    value *= function(past[lag])
                total += value
            if not math.isfinite(total):
                total = math.nan
            elif abs(total) > 1e150:  # diverged: nothing after it means anything
                return
            out[k] = total

    def to_dict(self) -> dict[str, Any]:
        """Return the model as plain data."""
        rows = zip(
            self.terms.names, self.theta.tolist(), self.stderr.tolist(), self.err.tolist(), strict=True
        )
        return {
            "format": FORMAT,
            "output": self.output,
            "terms": [
                {"name": a, "theta": b, "stderr": c, "err": None if math.isnan(d) else d}
                for a, b, c, d in rows
            ],
            "covariance": self.covariance.tolist(),
            "sigma": self.sigma if math.isfinite(self.sigma) else None,
            "n_samples": self.n_samples,
            "scale": self.scale.to_dict(),
            "stop": self.stop,
        }

    def save(self, path: Path) -> None:
        """Write JSON."""
        part = path.with_name(path.name + ".part")
        part.write_text(json.dumps(self.to_dict(), indent=1) + "\n")
        part.replace(path)

    @classmethod
    def load(cls, path: Path) -> Narmax:
        """Read what `save` wrote."""
        try:
            data = json.loads(path.read_text())
            if data["format"] != FORMAT:
                raise IdentError(f"{path}: format {data['format']!r}, expected {FORMAT!r}")
            terms = data["terms"]
            return cls(
                output=data["output"],
                terms=Terms.parse(*(t["name"] for t in terms)),
                theta=np.array([t["theta"] for t in terms], dtype=np.float64),
                covariance=np.array(data["covariance"], dtype=np.float64).reshape(len(terms), len(terms)),
                err=np.array([math.nan if t["err"] is None else t["err"] for t in terms], dtype=np.float64),
                sigma=math.nan if data["sigma"] is None else float(data["sigma"]),
                n_samples=int(data["n_samples"]),
                scale=Scale.from_dict(data["scale"]),
                stop=data["stop"],
            )
        except (KeyError, TypeError, ValueError) as exc:
            if isinstance(exc, IdentError):
                raise
            raise IdentError(f"{path}: not a model ({exc}); write one with Narmax.save") from exc


def _scalar(f: Factor, scale: Scale) -> Callable[[float], float]:
    """Return a factor as a function of one number; a power that overflows is infinite."""
    if f.function:
        wave = math.cos if f.function == "cos" else math.sin
        return lambda v: wave(f.harmonic * v) ** f.power
    centre, width = scale.pair(f.variable)

    def power(v: float) -> float:
        try:
            return float((v - centre) / width) ** f.power
        except OverflowError:
            return math.inf

    return power


def sum_text(terms: Terms, theta: Sequence[float] | Floats, *, digits: int = 6) -> str:
    """Print a sum of terms with signs between them: `0.5*y(k-1) + u(k-2) - 0.1*u(k-1)^2`."""
    parts: list[str] = []
    for name, value in zip(terms.names, np.asarray(theta, dtype=np.float64).tolist(), strict=True):
        size = f"{abs(value):.{digits}g}"
        body = size if name == "1" else (name if size == "1" else f"{size}*{name}")
        sign = "-" if value < 0 else "+"
        parts.append(f"{sign} {body}" if parts else (f"-{body}" if value < 0 else body))
    return " ".join(parts) or "0"


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
                if not f.function:
                    sizes.setdefault(f.variable, []).append(rows.columns[f.signal])
        scale = Scale.of({name: np.concatenate(parts) for name, parts in sizes.items()}, centre=False)
    moments = Moments(terms, 1, scale=scale).add(rows.columns, rows.targets)
    model = Narmax.of(select(moments, n_terms, criterion=criterion, err_tol=err_tol), 0, output)
    return model if any(scale.centres) else model.in_user_units()
