"""Narmax: a model of one output as a sum of terms, with its equation, its predictions and its file."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from textwrap import shorten
from typing import Any, Literal

import numpy as np
from scipy.linalg import block_diag

from robotmodic_ident.errors import IdentError
from robotmodic_ident.estimation.simulation_error import initial_outputs, with_signs
from robotmodic_ident.files import atomic_file
from robotmodic_ident.notation.expand import expand, unscaled
from robotmodic_ident.notation.model_file import from_plain, to_plain
from robotmodic_ident.notation.printing import (
    limited_text,
    max_cancellation,
    ratio_text,
    sum_text,
    total_size,
)
from robotmodic_ident.prediction.recursion import UNLIMITED, Recursion, Segment
from robotmodic_ident.records import Record, as_records, padded_before
from robotmodic_ident.scale import UNSCALED, Scale
from robotmodic_ident.selection.criteria import Stop
from robotmodic_ident.selection.select import Selection
from robotmodic_ident.terms import CONSTANT, Terms
from robotmodic_ident.types import Floats

NO_TERMS = Terms(())
Estimator = Literal["ls", "els", "pem", "simulation", "orbit"]
"""Least squares, extended least squares, prediction error, simulation error, or the orbit of `without_noise`."""
REPR_WIDTH = 200
"""[characters] maximum length of the equation in `repr`."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Narmax:
    """A model of one output: ŷ(k) = Σ theta terms / (1 + Σ denominator_theta denominator) + Σ noise_theta noise_terms.

    Noise terms contain past residuals e(k-1), ... of the one-step prediction. Denominator and noise terms are usually
    empty. Without lags, the model is a static equation.

    This is one class, because the equation, the predictions and the file use the same few fields.
    """

    output: str
    """Name of the output, as used in the terms."""
    terms: Terms
    theta: Floats
    """(n_terms,) coefficients of the scaled terms."""
    covariance: Floats
    """(n_parameters, n_parameters) of theta, then denominator_theta, then noise_theta."""
    err: Floats
    """(n_terms,) error reduction ratio of each term at its selection, 0...1."""
    sigma: float
    """[units of the output] standard deviation of the one-step residual."""
    n_samples: int
    """Number of rows in the fit."""
    scale: Scale = field(default=UNSCALED)
    stop: Stop = "n_terms"
    """Reason why the selection ended."""
    denominator: Terms = NO_TERMS
    """Denominator terms of a rational model, without the constant 1."""
    denominator_theta: Floats = field(default_factory=lambda: np.empty(0))
    """(len(denominator),)"""
    noise_terms: Terms = NO_TERMS
    """Terms with past residuals e(k-1), ... in the predictor."""
    noise_theta: Floats = field(default_factory=lambda: np.empty(0))
    """(len(noise_terms),)"""
    estimator: Estimator = "ls"
    spans: Mapping[str, float] = field(default_factory=dict)
    """Variable -> half its span in the fit, if the scale no longer contains it; needed to detect cancellation."""
    limits: tuple[float, float] = UNLIMITED
    """[units of the output] saturation limits of the output, such as a full tank or an end stop."""
    is_magnitude: bool = False
    """Whether only the magnitude of the output is measured; the terms then describe the signed output."""
    notes: tuple[str, ...] = ()
    """Notes for the user: dependent terms left out, few samples, ..."""

    def __post_init__(self) -> None:
        k = len(self.terms)
        shapes = (self.theta.shape, self.err.shape, self.denominator_theta.shape, self.noise_theta.shape)
        if shapes != ((k,), (k,), (len(self.denominator),), (len(self.noise_terms),)):
            raise ValueError(
                f"theta, err, denominator_theta, noise_theta have shapes {shapes}, expected one value per term of "
                f"{k} terms, {len(self.denominator)} in the denominator and {len(self.noise_terms)} of noise"
            )
        n = len(self.parameters)
        if self.covariance.shape != (n, n):
            raise ValueError(f"covariance has shape {self.covariance.shape}, expected ({n}, {n})")

    @classmethod
    def of(cls, selection: Selection, index: int, output: str) -> Narmax:
        """Return the model of one output of a selection, with the terms in order of selection."""
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
    def parameters(self) -> Floats:
        """(n_parameters,) theta, denominator_theta, noise_theta."""
        return np.concatenate([self.theta, self.denominator_theta, self.noise_theta])

    @property
    def stderr(self) -> Floats:
        """(n_terms,) standard error of theta."""
        return np.sqrt(np.diagonal(self.covariance))[: len(self.terms)]

    @property
    def noise_stderr(self) -> Floats:
        """(len(noise_terms),) standard error of noise_theta."""
        return np.sqrt(np.diagonal(self.covariance))[len(self.terms) + len(self.denominator) :]

    @property
    def is_dynamic(self) -> bool:
        """Return whether any term has a lag."""
        groups = (self.terms, self.denominator, self.noise_terms)
        return any(f.lag is not None for terms in groups for term in terms for f in term)

    def recursion(self) -> Recursion:
        """Return the model in the form that runs sample by sample."""
        return Recursion(
            self.output,
            self.terms,
            self.denominator,
            self.noise_terms,
            self.scale,
            self.parameters,
            self.limits,
        )

    def in_user_units(self) -> Narmax:
        """Return the same model in the units of the user, with the scaling multiplied out.

        `err` is preserved if variables are only divided by a width. With centring, it is nan.
        """
        terms, theta, linear = expand(self.terms, self.theta, self.scale)
        below, below_theta, below_linear = expand(self.denominator, self.denominator_theta, self.scale)
        noise, noise_theta, noise_linear = expand(self.noise_terms, self.noise_theta, self.scale)
        constant = [i for i, name in enumerate(below.names) if name == CONSTANT]
        if constant:  # centring adds a constant to the denominator, whose constant must be 1
            raise IdentError(
                "a rational model of centred variables has no form in the units of the user; fit it without centring"
            )
        total = block_diag(linear, below_linear, noise_linear)
        return replace(
            self,
            terms=terms,
            theta=theta,
            covariance=total @ self.covariance @ total.T,
            err=self.err
            if len(terms) == len(self.terms) and not any(self.scale.centres)
            else np.full(len(terms), np.nan),
            scale=UNSCALED,
            denominator=below,
            denominator_theta=below_theta,
            noise_terms=noise,
            noise_theta=noise_theta,
        )

    def without_widths(self) -> Narmax:
        """Return the same model with variables still centred, but no longer divided by their widths."""
        below, below_factor = unscaled(self.denominator, self.scale)
        terms, factor = unscaled(self.terms, self.scale)
        noise, noise_factor = unscaled(self.noise_terms, self.scale)
        total = np.concatenate([factor, below_factor, noise_factor])
        return replace(
            self,
            terms=terms,
            theta=self.theta * factor,
            covariance=self.covariance * np.outer(total, total),
            scale=Scale(self.scale.variables, self.scale.centres, tuple(1.0 for _ in self.scale.widths)),
            spans=dict(zip(self.scale.variables, self.scale.widths, strict=True)),
            denominator=below,
            denominator_theta=self.denominator_theta * below_factor,
            noise_terms=noise,
            noise_theta=self.noise_theta * noise_factor,
        )

    def readable(self, most: float) -> Narmax:
        """Return the form to print: in the units of the user, or in (x - centre) if the former would lose digits.

        Parameters
        ----------
        most : maximum ratio of cancelling terms to the model itself
        """
        if not any(self.scale.centres):
            return self.in_user_units()
        centred = self.without_widths()
        if len(self.denominator):  # multiplied out, its denominator would have another constant
            return centred
        plain = self.in_user_units()
        own = total_size(centred.terms, centred.theta, self.scale, self.spans, around_zero=False)
        multiplied = total_size(plain.terms, plain.theta, self.scale, self.spans, around_zero=True)
        return centred if multiplied > most * own else plain

    def equation(self, *, digits: int = 6, scaled: bool = False) -> str:
        """Return the equation as text, accurate to 1 %, in the units of the user or in scaled variables if `scaled`.

        Far from 0, powers of x cancel and their coefficients need more digits, so (x - centre) is printed.
        """
        form = self if scaled else self.readable(max_cancellation(digits))
        scale = UNSCALED if scaled else form.scale
        text = sum_text(form.terms, form.theta, digits=digits, scale=scale, spans=form.spans)
        text = ratio_text(text, form.denominator, form.denominator_theta, digits=digits, scale=scale)
        if len(form.noise_terms):
            tail = sum_text(form.noise_terms, form.noise_theta, digits=digits, scale=scale)
            text += f" - {tail[1:]}" if tail.startswith("-") else f" + {tail}"
        text = limited_text(text, self.limits)
        if self.is_magnitude:
            return f"|{form.output}(k)| is measured, {form.output}(k) = {text}"
        return f"{form.output}(k) = {text}" if form.is_dynamic else f"{form.output} = {text}"

    def __repr__(self) -> str:
        """Return the equation, shortened if it is long, and one line on its estimation."""
        equation = shorten(self.equation(), REPR_WIDTH, placeholder=" ...")
        groups = (
            (self.terms, "terms"),
            (self.denominator, "denominator terms"),
            (self.noise_terms, "noise terms"),
        )
        counts = ", ".join(f"{len(terms)} {name}" for terms, name in groups if len(terms))
        return (
            f"Narmax: {equation}\n"
            f"  {counts}; {self.estimator} of {self.n_samples:,} samples, sigma {self.sigma:.3g}, "
            f"selection stopped by {self.stop}"
        )

    def predict_osa(self, record: Record | Mapping[str, Floats]) -> Floats:
        """Predict each sample (n,) one step ahead, from past measurements and past residuals; nan if unknown.

        Raises
        ------
        IdentError
            If the record lacks a signal of the model.
        """
        return self._predict(record, lambda recursion, segment: recursion.run(segment, free=False)[0])

    def predict_mpo(self, record: Record | Mapping[str, Floats], *, warm_up: int = 0) -> Floats:
        """Predict in free run (n,): past outputs are predictions; measured outputs only start each segment.

        The first `max_lag` samples of a segment are nan, and noise terms are 0. At an unknown input there is no
        prediction, and later samples use the measured output instead.

        Parameters
        ----------
        warm_up : [samples] Start of each segment whose measured outputs may be used.
            The run starts from the outputs that fit these samples best, and includes the first sample. If there are at
            most `max_lag` of them, the signals are assumed to be constant before the record. 0: The run starts from
            the first `max_lag` measured outputs.
        """
        (record,) = as_records(record)
        recursion = self.recursion()
        before = recursion.look_back if 0 < warm_up <= recursion.look_back else 0

        def run(recursion: Recursion, segment: Segment) -> Floats:
            initial = initial_outputs(recursion, segment, before + warm_up)
            return recursion.run(segment, free=True, initial=initial)[0]

        return self._predict(padded_before(record, before), run)[before:]

    def predict_k(self, record: Record | Mapping[str, Floats], steps: int) -> Floats:
        """Predict each sample (n,) `steps` ahead, from outputs measured up to `steps` samples before; inputs are known.

        Raises
        ------
        ValueError
            If `steps` is below 1.
        IdentError
            If the record lacks a signal of the model.
        """
        if steps < 1:
            raise ValueError(f"steps is {steps}, expected 1 or more")
        return self._predict(record, lambda recursion, segment: recursion.run_ahead(segment, steps))

    def residuals(self, record: Record | Mapping[str, Floats]) -> Floats:
        """Return measured - predict_osa (n,)."""
        (record,) = as_records(record)
        return np.asarray(record.signals[self.output], dtype=np.float64) - self.predict_osa(record)

    def leverage(self, record: Record | Mapping[str, Floats]) -> Floats:
        """Return the leverage (hat value) `g' (covariance / sigma²) g` of each sample (n,); nan if unknown.

        With g the gradient of the one-step prediction, it is the variance of the prediction due to the errors of the
        coefficients, in units of the residual variance. Over the rows of a least-squares fit, it sums to the number of
        terms. Above the largest leverage of the fit, the model extrapolates (Weisberg 2005, sec. 8.4). For a fit
        without residual, it is nan.
        """
        if not self.sigma > 0:
            return np.full(len(as_records(record)[0]), np.nan)
        shape = self.covariance / self.sigma**2

        def hat(recursion: Recursion, segment: Segment) -> Floats:
            out, _, slopes = recursion.run(segment, free=False, gradient=True)
            size = np.abs(slopes).max(axis=1, initial=0.0)
            unit = slopes / np.where(size > 0, size, 1.0)[:, None]
            with np.errstate(over="ignore"):  # inf is a valid leverage
                return np.where(np.isfinite(out), ((unit @ shape) * unit).sum(axis=1) * size * size, np.nan)

        return self._predict(record, hat)

    def _predict(
        self, record: Record | Mapping[str, Floats], run: Callable[[Recursion, Segment], Floats]
    ) -> Floats:
        (record,) = as_records(record)
        out = np.full(len(record), np.nan)
        recursion = self.recursion()
        for segment in recursion.segments(record):
            some = with_signs(recursion, segment) if self.is_magnitude else segment
            out[segment.piece] = run(recursion, some)
        return np.abs(out) if self.is_magnitude else out

    def to_dict(self) -> dict[str, Any]:
        """Return the model as plain data."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        return to_plain(values, np.sqrt(np.diagonal(self.covariance)))

    def save(self, path: Path | str) -> None:
        """Write the model as JSON; `load` reads it.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        with atomic_file(Path(path)) as part:
            part.write_text(json.dumps(self.to_dict(), indent=1) + "\n")

    @classmethod
    def load(cls, path: Path | str) -> Narmax:
        """Read a model written by `save`.

        Raises
        ------
        IdentError
            If the file is not a model.
        OSError
            If the file cannot be read.
        """
        try:
            data = json.loads(Path(path).read_text())
            return cls.from_dict(data)
        except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as exc:
            if isinstance(exc, IdentError):
                raise
            raise IdentError(
                f"{path}: not a model ({exc}); expected the JSON of an identified model"
            ) from exc

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Narmax:
        """Restore a model from the data of `to_dict`."""
        return cls(**from_plain(data))


def among(model: Narmax, terms: Terms) -> Narmax:
    """Return the same model with another set of process terms; the coefficients of new terms are 0."""
    found = dict(zip(model.terms.names, model.theta.tolist(), strict=True))
    n = len(terms) + len(model.denominator) + len(model.noise_terms)
    return replace(
        model,
        terms=terms,
        theta=np.array([found.get(name, 0.0) for name in terms.names]),
        err=np.full(len(terms), np.nan),
        covariance=np.zeros((n, n)),
    )
