"""Rational models y = N / D + e: initialise structure and coefficients from the linear form, then remove its bias.

Multiplied out, y = N - y (D - 1) + D e is linear in all coefficients. However, y (D - 1) contains the noise of y, which
biases least squares (Billings and Zhu 1991). Dividing the rows by the last D (Sanathanan and Koerner 1963) removes most
of the bias, and Gauss-Newton on e (`prediction_error`) removes the rest. Terms are then added and dropped by their
effect on e. With noise terms C, the model is y = N / D + C + e; C is kept during the search of the structure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from robotmodic_ident.errors import IdentError
from robotmodic_ident.estimation.prediction_error import Estimate, NonlinearLeastSquares
from robotmodic_ident.model import Narmax
from robotmodic_ident.records import Record, lagged
from robotmodic_ident.selection.criteria import CONVERGED, MAX_STEPS, MAX_TERMS, penalties
from robotmodic_ident.terms import CONSTANT, Terms
from robotmodic_ident.types import Floats

START_UP = 10
"""[samples] after the largest lag that are not scored, because the noise before the start is unknown.
All structures are compared on the same samples, also those with smaller lags."""


def times_output(denominator: Terms, output: str) -> Terms:
    """Return the columns y(k) * term that represent denominator terms in the linear form."""
    if CONSTANT in denominator.names:
        raise IdentError("the denominator has the constant 1 already; remove it from the candidates")
    return Terms.parse(*(f"{output}(k)*{name}" for name in denominator.names))


def with_noise_terms(model: Narmax, noise: Terms) -> Narmax:
    """Add noise terms with initial coefficients of 0 to a rational model."""
    n = len(model.parameters) + len(noise)
    return replace(model, noise_terms=noise, noise_theta=np.zeros(len(noise)), covariance=np.zeros((n, n)))


def as_ratio(model: Narmax, records: Sequence[Record], denominator: Terms) -> Narmax:
    """Convert a model of the linear form to a rational model with initial coefficients."""
    if any(model.scale.centres):
        raise IdentError(
            "a rational model cannot be centred; subtract an offset from variables that are far from 0"
        )
    linear = times_output(denominator, model.output).names
    below = dict(zip(linear, denominator.names, strict=True))
    upper = [name for name in model.terms.names if name not in below]
    lower = [below[name] for name in model.terms.names if name in below]
    if not upper:
        raise IdentError("no numerator term was selected; keep one, for example keep=['1']")
    return _reweighted(model, records, Terms.parse(*upper), Terms.parse(*lower))


def _reweighted(model: Narmax, records: Sequence[Record], upper: Terms, lower: Terms) -> Narmax:
    """Solve the linear form with rows divided by the denominator of the last solution; return the best solution."""
    rows = lagged(records, upper + lower, [model.output])
    known = np.isfinite(rows.targets[:, 0])
    y = rows.targets[known, 0]
    top = upper.matrix(rows.columns, model.scale, n=len(known))[known]
    bottom = lower.matrix(rows.columns, model.scale, n=len(known))[known]
    d, least = np.ones(len(y)), np.inf
    best: Floats = np.zeros(len(upper) + len(lower))
    for _ in range(MAX_STEPS):
        phi = np.column_stack([top, -y[:, None] * bottom])
        theta = np.linalg.lstsq(phi / d[:, None], y / d, rcond=None)[0]
        d = 1.0 + bottom @ theta[len(upper) :]
        cost = float(np.sum((y - top @ theta[: len(upper)] / d) ** 2))
        if not np.isfinite(cost) or cost >= least * (1.0 - CONVERGED):
            break
        best, least = theta, cost
    err = dict(zip(model.terms.names, model.err.tolist(), strict=True))
    return replace(
        model,
        terms=upper,
        theta=best[: len(upper)],
        denominator=lower,
        denominator_theta=best[len(upper) :],
        err=np.array([err[name] for name in upper.names]),
        covariance=np.zeros((len(best), len(best))),
    )


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A structure with its estimate and the value of the criterion."""

    model: Narmax
    result: Estimate
    value: float


@dataclass(frozen=True, eq=False)
class RationalStructureSearch:
    """Search for the terms of numerator and denominator by the prediction error."""

    records: Sequence[Record]
    upper: Terms
    lower: Terms
    criterion: str

    def search(self, model: Narmax) -> Narmax:
        """Add the most promising term and drop the least significant ones until the criterion stops decreasing.

        Afterwards, terms are dropped one by one down to the last, even through worse structures. Terms that substitute
        for one another must be removed together.
        """
        best = self._grown(self._trial(model, model.parameters))
        while (fewer := self._least_of_fewer(best)) is not best:
            best = self._grown(fewer)
        return best.model

    def _grown(self, best: _Candidate) -> _Candidate:
        for _ in range(MAX_TERMS):
            name, start = self._most_promising(best)
            if start is None:
                break
            grown = self._trial(start, start.parameters)
            while (
                shrunk := self._without_least(grown, keep=name)
            ) is not None and shrunk.value < grown.value:
                grown = shrunk
            if not grown.value < best.value - CONVERGED * abs(best.value):
                break
            best = grown
        return best

    def _least_of_fewer(self, best: _Candidate) -> _Candidate:
        """Return the best structure found while dropping terms one by one, or the given one."""
        least, now = best, self._without_least(best)
        while now is not None:
            if now.value < least.value - CONVERGED * abs(least.value):
                least = now
            now = self._without_least(now)
        return least

    def _problem(self, model: Narmax) -> NonlinearLeastSquares:
        """Return the least squares of a structure on the samples that all structures predict, if there are enough."""
        longest = (self.upper + self.lower + model.noise_terms).max_lag
        first = longest + (START_UP if len(model.noise_terms) else 0)
        longest_part = max(s.stop - s.start for record in self.records for s in record.segments())
        return NonlinearLeastSquares(
            model.recursion(), self.records, first if longest_part > 10 * first else 0
        )

    def _trial(self, model: Narmax, start: Floats) -> _Candidate:
        problem = self._problem(model)
        result = problem.minimise(start)
        size, candidates = len(start), len(self.upper) + len(self.lower) + len(model.noise_terms)
        cost = penalties(self.criterion, size, candidates, np.array([result.count]))[0, size]
        n, m = len(model.terms), len(model.denominator)
        model = replace(
            model,
            theta=result.theta[:n],
            denominator_theta=result.theta[n : n + m],
            noise_theta=result.theta[n + m :],
        )
        return _Candidate(model, result, result.count * np.log(max(result.rss, 1e-300)) + float(cost))

    def _most_promising(self, trial: _Candidate) -> tuple[str, Narmax | None]:
        """Return the absent term whose gradient explains most of the residual, and the model with this term."""
        model = trial.model
        above, below = model.terms + self.upper, model.denominator + self.lower
        full = _with_zeros(model, above, below)
        n, m, q = len(model.terms), len(model.denominator), len(model.noise_terms)
        present = np.r_[np.arange(n), len(above) + np.arange(m), len(above) + len(below) + np.arange(q)]
        absent = np.setdiff1d(np.arange(len(full.parameters)), present)
        if len(absent) == 0:
            return "", None
        gains = self._problem(full).gains(full.parameters, absent)
        best = int(absent[gains.argmax()])
        if best < len(above):
            return above.names[best], _with_zeros(model, model.terms + above[[best]], model.denominator)
        new = below[[best - len(above)]]
        return f"/{new.names[0]}", _with_zeros(model, model.terms, model.denominator + new)

    def _without_least(self, trial: _Candidate, keep: str = "") -> _Candidate | None:
        """Drop the least significant term except `keep`; return None if no term can be dropped."""
        model = trial.model
        names = (*model.terms.names, *(f"/{name}" for name in model.denominator.names))
        k = len(names)
        spread = np.sqrt(np.maximum(np.diagonal(trial.result.covariance("classical")), 1e-300))
        score = np.abs(model.parameters) / spread
        score[[i for i, name in enumerate(names) if name == keep]] = np.inf
        score[k:] = np.inf  # noise terms are kept
        if len(model.terms) == 1:
            score[0] = np.inf
        i = int(score.argmin())
        if not np.isfinite(score[i]):
            return None
        stay = [j for j in range(k) if j != i]
        n = len(model.terms)
        above, below = [j for j in stay if j < n], [j - n for j in stay if j >= n]
        smaller = replace(
            model,
            terms=model.terms[above],
            theta=model.theta[above],
            err=model.err[above],
            denominator=model.denominator[below],
            denominator_theta=model.denominator_theta[below],
            covariance=np.zeros((len(model.parameters) - 1,) * 2),
        )
        return self._trial(smaller, smaller.parameters)


def _with_zeros(model: Narmax, above: Terms, below: Terms) -> Narmax:
    """Return the model with additional terms, whose coefficients are 0."""
    n, m = len(above), len(below)
    return replace(
        model,
        terms=above,
        theta=np.r_[model.theta, np.zeros(n - len(model.theta))],
        err=np.r_[model.err, np.full(n - len(model.err), np.nan)],
        denominator=below,
        denominator_theta=np.r_[model.denominator_theta, np.zeros(m - len(model.denominator_theta))],
        covariance=np.zeros((n + m + len(model.noise_terms),) * 2),
    )
