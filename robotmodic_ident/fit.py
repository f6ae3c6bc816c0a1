"""fit: from records to a model, in one call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from robotmodic_ident.criteria import INFORMATION, Criterion, information, penalties
from robotmodic_ident.dependence import independent
from robotmodic_ident.errors import IdentError
from robotmodic_ident.estimate import Covariance, Descent, Estimate
from robotmodic_ident.model import NO_TERMS, Narmax
from robotmodic_ident.moments import Moments
from robotmodic_ident.noise import best_order, noise_terms_of, with_noise
from robotmodic_ident.ratio import Structure, as_ratio, times_output
from robotmodic_ident.records import Lagged, Record, Records, as_records, lagged
from robotmodic_ident.scale import Scale
from robotmodic_ident.select import Selection, select
from robotmodic_ident.sizes import Search
from robotmodic_ident.terms import CONSTANT, Floats, Terms

Estimator = Literal["ls", "els", "pem", "simulation"]
Rows: TypeAlias = slice | NDArray[np.intp]

FAR = 1e5
"""A variable is centred when its middle lies FAR^(1/degree) half-spans from 0: beyond, its powers look alike."""


FAR_OUTPUT = 100.0
"""The output is taken from its middle when that lies so many half-spans from 0: squares of it hold nothing else."""


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
        residual's own test asks for and EBIC agrees to (the notes of the model say how many were tried)
    denominator : candidate terms below the line of a rational model, without a constant
    estimator : `ls`; `els`; `pem` (the default with noise or a denominator); `simulation` (least error in free run)
    covariance : `classical`; `sandwich`; `hac` (the default for `simulation`, whose residuals are correlated)
    """
    records = as_records(records)
    if len(denominator) and noise:
        raise IdentError("a rational model with noise terms is not offered; leave one of them out")
    if noise == "auto":
        again = partial(
            fit, records, output, terms, n_terms=n_terms, criterion=criterion, err_tol=err_tol, scale=scale,
            search=search, keep=keep, n_folds=n_folds, denominator=denominator, estimator=estimator,
            covariance=covariance,
        )  # fmt: skip
        return best_order(lambda order: again(noise=order), records, len(terms))
    noise_terms = noise_terms_of(noise)
    if estimator is None:
        estimator = "pem" if len(noise_terms) or len(denominator) else "ls"
    if estimator not in get_args(Estimator):
        raise ValueError(f"estimator is {estimator!r}, expected one of {', '.join(get_args(Estimator))}")
    criterion = criterion or ("ebic" if n_terms is None else "n_terms")
    _check_causal(terms + denominator, output)
    candidates = terms + times_output(denominator, output)
    choice = _Choice(
        records,
        output,
        candidates,
        n_terms,
        criterion,
        err_tol,
        search,
        tuple(keep),
        n_folds,
        scale,
        len(denominator) > 0,
    )
    if len(denominator):
        model = as_ratio(choice.select(), records, denominator)
        if criterion in INFORMATION:
            model = Structure(records, terms, denominator, criterion).settle(model)
    elif len(noise_terms):
        model = with_noise(choice, noise_terms)
    else:
        model = choice.select()
    kind: Covariance = covariance or ("hac" if estimator == "simulation" else "classical")
    if estimator != "ls" or kind != "classical":
        model = _refined(model, records, estimator, kind)
    model = replace(model, notes=(*choice.notes, *model.notes))
    return model.without_widths() if any(model.scale.centres) else model.in_user_units()


@dataclass
class _Choice:
    """The selection of process terms, which noise found later may repeat."""

    records: list[Record]
    output: str
    terms: Terms
    n_terms: int | None
    criterion: Criterion
    err_tol: float
    search: Search
    keep: tuple[str, ...]
    n_folds: int
    scale: Scale | None
    is_ratio: bool

    def __post_init__(self) -> None:
        self.rows = lagged(self.records, self.terms, [self.output])
        if not np.isfinite(self.rows.targets).any():
            raise IdentError(f"output {self.output} is not known at any sample whose regressors are known")
        self.shift = (
            0.0 if self.is_ratio or CONSTANT not in self.terms.names else _middle_of(self.rows.targets)
        )
        """What is subtracted from the output, and given back by the constant, which then stays."""
        if self.shift:
            self.rows = replace(self.rows, targets=self.rows.targets - self.shift)
            self.keep = tuple(dict.fromkeys((CONSTANT, *self.keep)))
            self.n_terms = self.n_terms and max(self.n_terms, len(self.keep))
        self.scale = self.scale or _scale_of(self.terms, self.rows)
        moments = self._moments(slice(None))
        kept, found = independent(moments, self.output, moments.gram_of(0))
        names = {moments.terms.names[i] for i in kept.tolist()}
        if lost := set(self.keep) - names - (set(self.keep) - set(moments.terms.names)):
            raise IdentError(f"term {', '.join(sorted(lost))} is to be kept but is given exactly by others")
        self.terms = self.terms[kept.tolist()]
        self.summed = moments.pick(terms=kept)
        self.notes = [str(dependence) for dependence in found] + self._remarks(int(moments.count[0]))
        if self.shift:
            self.notes.append(f"{self.output} lies far from 0: err is of {self.output} - {self.shift:.15g}")
        for name, centre in zip(self.scale.variables, self.scale.centres, strict=True):
            if centre:
                self.notes.append(
                    f"{name} lies far from 0: in the terms it stands for {name} - {centre:.15g}"
                )

    def _remarks(self, count: int) -> list[str]:
        out = []
        if count < 2 * len(self.terms):
            out.append(f"{count} samples for {len(self.terms)} candidate terms: the choice is weakly founded")
        for i, record in enumerate(self.records):
            if not (self.rows.record == i).any():
                out.append(
                    f"record {i} gives no sample: {len(record)} samples, look back {self.terms.max_lag}"
                )
        return out

    def select(self) -> Narmax:
        """Choose process terms by least squares."""
        selection = self._selection(self.summed, self._moments, len(self.rows.sample))
        self._judge(selection)
        return self._model(selection)

    def select_beside(self, model: Narmax) -> Narmax:
        """Choose process terms by the prediction error, with the noise terms of a model beside them."""
        noise, n = model.noise_terms, len(self.terms)
        full = _among(model, self.terms)
        phi, target = Descent(full.recursion(), self.records, free=False).linearised(full.parameters)
        if self.shift:
            target -= self.shift * phi[:, self.terms.names.index(CONSTANT)]

        def part(rows: Rows) -> Moments:
            return Moments(self.terms + noise, 1, scale=self.scale).add_rows(phi[rows], target[rows])

        moments = part(slice(None))
        selection = self._selection(moments, part, len(target), noise.names)
        chosen = [i for i in selection.chosen(0).tolist() if i < n]
        if not chosen:  # the noise alone is the better model, but a model has a term
            chosen = select(moments.pick(terms=range(n)), 1).chosen(0).tolist()
        alone = select(self.summed.pick(terms=chosen), len(chosen))
        return replace(self._model(alone), stop=selection.stop[0])

    def _model(self, selection: Selection) -> Narmax:
        """Return the model of a selection, with what was subtracted from the output given back."""
        model = Narmax.of(selection, 0, self.output)
        shift = np.where(np.array(model.terms.names) == CONSTANT, self.shift, 0.0)
        return replace(model, theta=model.theta + shift)

    def _moments(self, rows: Rows) -> Moments:
        """Sum up some rows of the data."""
        columns = {name: values[rows] for name, values in self.rows.columns.items()}
        return Moments(self.terms, 1, scale=self.scale).add(columns, self.rows.targets[rows])

    def _selection(
        self, moments: Moments, part: Callable[[Rows], Moments], n: int, noise: Sequence[str] = ()
    ) -> Selection:
        """Select from moments; `part` sums up some of their n rows, `noise` names terms that are there anyway."""
        blocks = np.array_split(np.arange(n), self.n_folds) if self.criterion == "cv" else []
        return select(
            moments,
            None if self.n_terms is None else self.n_terms + len(noise),
            criterion=self.criterion,
            err_tol=self.err_tol,
            keep=(*self.keep, *noise),
            search=self.search,
            folds=[part(block) for block in blocks],
        )

    def _judge(self, selection: Selection) -> None:
        """Note where the one term that a model has explains less than it costs."""
        if self.criterion in INFORMATION and selection.n_terms[0] == 1 and not self.keep:
            share, count = float(selection.err[0, 0]), selection.count[:1]
            cost = penalties(self.criterion, 1, len(self.terms), count)
            none, one = information(np.array([[1.0, 1.0 - share]]), cost, count)[0]
            if none < one:
                self.notes.append(
                    f"by {self.criterion} no term is worth its cost; the one kept explains {share:.1%} of "
                    f"{self.output}, as chance may"
                )


def _among(model: Narmax, candidates: Terms) -> Narmax:
    """Return the same model written in all candidates; the coefficients of those it does not have are 0."""
    found = dict(zip(model.terms.names, model.theta.tolist(), strict=True))
    n = len(candidates) + len(model.noise_terms)
    return replace(
        model,
        terms=candidates,
        theta=np.array([found.get(name, 0.0) for name in candidates.names]),
        err=np.full(len(candidates), np.nan),
        covariance=np.zeros((n, n)),
    )


def _check_causal(terms: Terms, output: str) -> None:
    for term, name in zip(terms, terms.names, strict=True):
        if any(f.variable == output and not f.lag for f in term):
            raise IdentError(f"term {name} explains {output} by itself; use its past, {output}(k-1)")


def _refined(model: Narmax, records: Sequence[Record], estimator: Estimator, kind: Covariance) -> Narmax:
    """Finish by Gauss-Newton (not for ls and els) and give the covariance asked for."""
    free = estimator == "simulation"
    try:
        descent = Descent(model.recursion(), records, free=free)
        if estimator in ("ls", "els"):
            cost, residuals, gradients = descent.at(model.parameters, gradient=True)
            result = Estimate(
                theta=model.parameters,
                rss=cost,
                count=descent.count,
                residuals=residuals,
                gradients=gradients,
                converged=True,
            )
        else:
            result = descent.minimise(model.parameters)
    except IdentError as exc:
        if not free:
            raise
        return replace(model, notes=(*model.notes, f"no refinement in free run: {exc}"))
    a, b = len(model.terms), len(model.terms) + len(model.denominator)
    notes = model.notes
    if not result.converged:
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


def _scale_of(terms: Terms, rows: Lagged) -> Scale:
    """Divide every variable by its size; centre it, at a round number, where it lies far from 0."""
    names, centres, widths = [], [], []
    for variable in terms.variables:
        signals = {
            f.signal
            for term in terms
            for f in term
            if f.variable == variable and f.function not in ("cos", "sin") and f.domain is None
        }
        if not signals:
            continue
        low = min(float(rows.columns[name].min()) for name in signals)
        high = max(float(rows.columns[name].max()) for name in signals)
        middle, half = (low + high) / 2, (high - low) / 2
        centre = 0.0
        degree = max(sum(f.degree for f in term if f.variable == variable) for term in terms)
        if half > 0 and abs(middle) > FAR ** (1 / degree) * half:
            centre = _round(middle, half)
        width = max(abs(low - centre), abs(high - centre))
        names.append(variable)
        centres.append(centre)
        widths.append(_rounded_up(width) if width > 0 else 1.0)
    return Scale(tuple(names), tuple(centres), tuple(widths))


def _middle_of(targets: Floats) -> float:
    """Return a round number in the middle of the output (n, 1), 0 where that is not far from 0."""
    low, high = float(np.nanmin(targets)), float(np.nanmax(targets))
    middle, half = low / 2 + high / 2, high / 2 - low / 2
    return _round(middle, half) if half > 0 and abs(middle) > FAR_OUTPUT * half else 0.0


def _round(middle: float, half: float) -> float:
    """Return a round number within the span."""
    unit = 10.0 ** np.ceil(np.log10(2 * half))
    return float(np.round(middle / unit) * unit)


def _rounded_up(width: float) -> float:
    """Round up to three digits: domains of splines and wavelets stay readable."""
    unit = 10.0 ** (np.floor(np.log10(width)) - 2)
    return float(f"{np.ceil(width / unit * (1.0 - 1e-12)) * unit:.3g}")
