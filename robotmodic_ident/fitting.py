"""`fit`: identify a model from records in one call."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

from robotmodic_ident.errors import IdentError
from robotmodic_ident.estimation.noise_model import best_order, noise_terms_of, with_noise, with_products
from robotmodic_ident.estimation.prediction_error import (
    DESCENT,
    Covariance,
    Estimate,
    LevenbergMarquardt,
    NonlinearLeastSquares,
)
from robotmodic_ident.estimation.rational import (
    RationalStructureSearch,
    as_ratio,
    times_output,
    with_noise_terms,
)
from robotmodic_ident.estimation.simulation_error import FreeRunLeastSquares
from robotmodic_ident.model import NO_TERMS, Estimator, Narmax
from robotmodic_ident.prediction.recursion import UNLIMITED
from robotmodic_ident.records import Record, Records, as_records, check_names
from robotmodic_ident.scale import Scale
from robotmodic_ident.selection.criteria import INFORMATION, Criterion
from robotmodic_ident.selection.model_size import Search
from robotmodic_ident.selection.process_terms import ProcessTermSelection
from robotmodic_ident.terms import Terms

ESTIMATORS: tuple[Estimator, ...] = ("ls", "els", "pem", "simulation")
"""Estimators supported by `fit`."""


def fit(
    records: Records,
    output: str,
    terms: Terms,
    *,
    n_terms: int | None = None,
    criterion: Criterion | None = None,
    err_tol: float = 1e-4,
    scale: Scale | None = None,
    search: Search = "exchange",
    keep: Sequence[str] = (),
    n_folds: int = 5,
    noise: int | Terms | Literal["auto"] = 0,
    denominator: Terms = NO_TERMS,
    estimator: Estimator | None = None,
    covariance: Covariance | None = None,
    limits: tuple[float, float] = UNLIMITED,
) -> Narmax:
    """Identify one output from records: select terms, estimate coefficients and their standard errors.

    Parameters
    ----------
    n_terms : Number of terms to keep (criterion `n_terms`), otherwise the maximum number.
    criterion : See `select`; default `ebic`, or `n_terms` if that is given.
    scale : Of the variables; None: Divide each by its largest magnitude, and centre it only if it is far from 0.
        Centring preserves the span of a full polynomial but changes its sparse representation.
    search : `exchange`, `restart` or `forward`
    keep : Names of terms that are always kept.
    n_folds : Number of contiguous blocks that criterion `cv` holds out in turn.
    noise : Number of lags of e(k), or terms with `e(k-1)`, ...; these are always kept in the predictor.
        `auto`: Add lags, and products such as `e(k-1)*u(k-1)`, while a residual test requires and EBIC accepts them.
    denominator : Candidate denominator terms of a rational model, without a constant.
    estimator : `ls`, `els`, `pem` (default with noise or a denominator), or `simulation` (least free-run error).
    covariance : `classical`, `sandwich`, or `hac` (default for `simulation`, whose residuals are correlated).
    limits : [units of the output] Saturation limits, such as the level of a full tank; see `output_limits`.

    Raises
    ------
    IdentError
        If a signal is missing, the output is never known, no row remains, a term contains the current output, or no
        numerator term is selected.
    ValueError
        If an option has an unknown value.
    """
    records = as_records(records)
    if noise == "auto":
        again = partial(
            fit, records, output, terms, n_terms=n_terms, criterion=criterion, err_tol=err_tol, scale=scale,
            search=search, keep=keep, n_folds=n_folds, denominator=denominator, estimator=estimator,
            covariance=covariance, limits=limits,
        )  # fmt: skip
        count = len(terms) + len(denominator)
        best = best_order(lambda order: again(noise=order), records, count)
        return with_products(best, lambda some: again(noise=some), records, count)
    noise_terms = noise_terms_of(noise)
    if estimator is None:
        estimator = "pem" if len(noise_terms) or len(denominator) else "ls"
    if estimator not in ESTIMATORS:
        raise ValueError(f"estimator is {estimator!r}, expected one of {', '.join(ESTIMATORS)}")
    criterion = criterion or ("ebic" if n_terms is None else "n_terms")
    _check_terms(terms, denominator, output)
    candidates = terms + times_output(denominator, output)
    selection = ProcessTermSelection(
        records=records, output=output, terms=candidates, n_terms=n_terms, criterion=criterion, err_tol=err_tol,
        search=search, keep=tuple(keep), n_folds=n_folds, scale=scale, is_ratio=len(denominator) > 0,
        limits=limits,
    )  # fmt: skip
    if len(denominator):
        model = with_noise_terms(as_ratio(selection.select(), records, denominator), noise_terms)
        if criterion in INFORMATION:
            model = RationalStructureSearch(records, terms, denominator, criterion).search(model)
    elif len(noise_terms):
        model = with_noise(selection, noise_terms)
    else:
        model = selection.select()
    kind: Covariance = covariance or ("hac" if estimator == "simulation" else "classical")
    if estimator != "ls" or kind != "classical":
        model = refined(model, records, estimator, kind)
    model = replace(model, notes=(*selection.notes, *model.notes))
    return model.without_widths() if any(model.scale.centres) else model.in_user_units()


def _check_terms(terms: Terms, denominator: Terms, output: str) -> None:
    """Refuse what is no `Terms`, and terms with the current output."""
    check_names(output)
    for what, given in (("terms", terms), ("denominator", denominator)):
        if not isinstance(given, Terms):
            raise IdentError(
                f"{what} is of type {type(given).__name__}, expected Terms, as `polynomial(...)` returns"
            )
    several = terms + denominator
    for term, name in zip(several, several.names, strict=True):
        if any(f.variable == output and not f.lag for f in term):
            raise IdentError(
                f"term {name} contains the current {output}; use past values, such as {output}(k-1)"
            )


def refined(
    model: Narmax,
    records: Sequence[Record],
    estimator: Estimator,
    kind: Covariance,
    descent: LevenbergMarquardt = DESCENT,
) -> Narmax:
    """Refine a model by Gauss-Newton (except for ls and els) and compute the requested covariance.

    Parameters
    ----------
    descent : settings for the free run; with no steps, only the covariance is computed
    """
    free = estimator == "simulation"
    try:
        if free:
            result, _ = FreeRunLeastSquares(model.recursion(), records).minimise(model.parameters, descent)
        elif estimator == "pem":
            result = NonlinearLeastSquares(model.recursion(), records).minimise(model.parameters)
        else:
            problem = NonlinearLeastSquares(model.recursion(), records)
            cost, residuals, gradients = problem.evaluate(model.parameters, gradient=True)
            result = Estimate(
                theta=model.parameters,
                rss=cost,
                count=problem.count,
                residuals=residuals,
                gradients=gradients,
                converged=True,
            )
    except IdentError as exc:
        if not free:
            raise
        return replace(model, notes=(*model.notes, f"not refined in free run: {exc}"))
    a, b = len(model.terms), len(model.terms) + len(model.denominator)
    notes = model.notes
    if not result.converged and descent.max_steps:
        notes = (*notes, "the descent did not converge; the coefficients may be inaccurate")
    return replace(
        model,
        theta=result.theta[:a],
        denominator_theta=result.theta[a:b],
        noise_theta=result.theta[b:],
        covariance=result.covariance(kind),
        sigma=result.sigma,
        n_samples=result.count,
        estimator=estimator,
        notes=notes,
    )
