"""`fit`: from records to a model, in one call."""

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
"""Those that `fit` offers."""


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
    """Identify one output from records: choose among `terms`, estimate, and say how sure it is.

    Parameters
    ----------
    n_terms : terms to keep (criterion `n_terms`), else the most to look at
    criterion : see `select`; default `ebic`, or `n_terms` where that is given
    scale : of the variables; None: each is divided by its largest size, and centred only where it lies far from 0
        (centring keeps the span of a full polynomial but changes which few terms describe it)
    search : `exchange`, `restart` or `forward`
    keep : names of terms that stay
    n_folds : contiguous blocks that criterion `cv` leaves out in turn
    noise : lags of e(k), or terms that hold `e(k-1)`, ...; they stay in the predictor; `auto`: as many lags as the
        residual's own test asks for and EBIC agrees to, and products such as `e(k-1)*u(k-1)`, alike; see the notes
    denominator : candidate terms below the line of a rational model, without a constant
    estimator : `ls`; `els`; `pem` (the default with noise or a denominator); `simulation` (least error in free run)
    covariance : `classical`; `sandwich`; `hac` (the default for `simulation`, whose residuals are correlated)
    limits : [units of the output] between which the output is held, as a full tank holds its level; see `output_limits`

    Raises
    ------
    IdentError
        if the records do not allow it: a signal is missing, the output is never known, no row is left, a term
        explains the output by itself, or a ratio would have nothing above its line
    ValueError
        if an option is none of those listed
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
    _check_causal(terms + denominator, output)
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


def _check_causal(terms: Terms, output: str) -> None:
    check_names(output)
    for term, name in zip(terms, terms.names, strict=True):
        if any(f.variable == output and not f.lag for f in term):
            raise IdentError(f"term {name} explains {output} by itself; use its past, {output}(k-1)")


def refined(
    model: Narmax,
    records: Sequence[Record],
    estimator: Estimator,
    kind: Covariance,
    descent: LevenbergMarquardt = DESCENT,
) -> Narmax:
    """Finish a model by Gauss-Newton (not for ls and els) and give the covariance asked for.

    descent : of the free run; without steps, only the covariance is found
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
        return replace(model, notes=(*model.notes, f"no refinement in free run: {exc}"))
    a, b = len(model.terms), len(model.terms) + len(model.denominator)
    notes = model.notes
    if not result.converged and descent.max_steps:
        notes = (*notes, "the descent did not come to rest; theta may still move")
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
