"""Differences that are linear in a few unknown values.

    reading += Σ_k value_k column_k

They are screened to first order, with all other unknowns free, and the likely ones are then fitted jointly.

    gain = ½ s' C s

s is the score of the values and C their covariance. A difference is sure if its gain exceeds the complexity penalty and the
evidence that an effect needs, and if the parts of the run agree: the amplitude of the whole exceeds its standard error, which is
estimated from the scatter between parts (Ibragimov and Mueller 2010), by more than the largest of k directions would by chance.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtri

from sensorgraph.diagnosis.result import Profile
from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.gauss_newton import Solution, Solver, iterate
from sensorgraph.diagnosis.scan.normal_equations import System, with_prior
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt
from sensorgraph.robust import rms
from sensorgraph.types import Bools, Floats, Ints

N_PARTS = 16
"""Number of parts of the run whose scatter gives the standard error."""
CONFIDENCE = 0.99
"""Confidence level of the agreement between the parts."""


@dataclass(frozen=True, kw_only=True)
class Words:
    """What a report says of an estimate."""

    statement: str
    causes: tuple[str, ...] = ()
    """Possible causes, most likely first."""
    profile: Profile | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Columns(ABC):
    """A difference that is linear in k values."""

    family: str
    """Name of its kind."""
    columns: Floats
    """(n_scans, k, n_rays) derivative of the readings by each value."""
    fails: frozenset[int] = frozenset()
    """Indices of the effects of the model that it contradicts."""
    is_contrast: bool = False
    """Whether only differences between the values count, so that their mean over all readings is 0."""

    @property
    def n_values(self) -> int:
        """Number of values that count for the complexity penalty."""
        return int(self.columns.shape[1])

    @property
    def least_z(self) -> float:
        """Amplitude in standard errors that it needs, given that its direction was chosen from k dimensions."""
        k = self.columns.shape[1]
        return float(np.sqrt(k * fdtri(k, N_PARTS - 1, CONFIDENCE)))

    @abstractmethod
    def words(self, estimate: ColumnEstimate, fitted: Fitted) -> Words | None:
        """Return what a report says of an estimate; None if something harmless explains it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ColumnEstimate:
    """The values of a difference, fitted jointly with all unknowns of a fit."""

    of: Columns
    values: Floats
    """(k,)"""
    stderr: Floats
    """(k,) standard errors, from the scatter between parts of the run."""
    information: Floats
    """(k, k) Information on the values if rays are independent: the inverse of their covariance."""
    gain: float
    """[nats] increase of the penalised log-likelihood."""
    price: float
    """[nats] Complexity penalty of the values."""
    amplitude_z: float
    """Amplitude of the whole over its standard error, from the scatter between parts of the run."""
    offset: float
    """[m] root mean square of its contribution to the readings."""
    affected: float
    """Share of the readings."""


def find_columns(checked: Checked, columns_of: Callable[[Fitted], Sequence[Columns]]) -> list[Doubt]:
    """Test differences that exclude each other; at most one is sure.

    If one of them alone explains more than all effects together with it, the effects only imitate it.

    Parameters
    ----------
    columns_of : Returns the differences that a fit can show.
    """
    fitted, null, failed = checked.fitted, checked.null, frozenset[int]()
    screened = _screened(fitted, columns_of(fitted))
    estimates = _estimates(fitted, screened)
    found = _sure(fitted, estimates)
    if fitted.model and null is not None:
        alone = _sure(null, _estimates(null, _screened(null, columns_of(null))))
        beside = 0.0 if found is None else found[0].gain - found[0].price
        if alone is not None and is_better_alone(alone[0].gain - alone[0].price, null, beside, fitted):
            found, failed = alone, frozenset(range(len(fitted.model)))
    fits = {id(fit.of): fit for fit in estimates}
    unsure = [
        _unsure(fitted, one, gain, fits.get(id(one)))
        for one, gain in screened
        if found is None or one.family != found[0].of.family
    ]
    if found is None:
        return unsure
    best, words = found
    sure = Doubt(
        family=best.of.family,
        price=best.price,
        statement=words.statement,
        misfit=best.gain,
        statistic=best.amplitude_z,
        threshold=best.of.least_z,
        failed=failed | best.of.fails,
        size=ScanError(offset=best.offset, affected=best.affected),
        causes=words.causes,
        profile=words.profile,
    )
    return [sure, *unsure]


def _unsure(fitted: Fitted, one: Columns, gain: float, fit: ColumnEstimate | None) -> Doubt:
    """Return a difference that is not sure, with the gain and the amplitude of its fit, or else its gain [nats] to first order."""
    price = fitted.solver.data.price(one.n_values)
    if fit is None:
        return Doubt.unsure(one.family, gain, price)
    doubt = Doubt.unsure(one.family, fit.gain, price)
    return replace(doubt, statistic=fit.amplitude_z, threshold=one.least_z)


def is_better_alone(alone: float, null: Fitted, beside: float, fitted: Fitted) -> bool:
    """Return whether a structure explains more without any effect than together with the effects.

    The effects then only imitate the structure.

    Parameters
    ----------
    alone : [nats] Gain of the structure over the fit without effects.
    beside : [nats] Gain of the structure over the fit with effects.
    """
    return null.j + alone > fitted.j + beside + SCAN.selection.threshold


def _estimates(fitted: Fitted, screened: Sequence[tuple[Columns, float]]) -> list[ColumnEstimate]:
    """Fit the differences with a gain [nats] to first order above their complexity penalty."""
    data = fitted.solver.data
    return [estimated(fitted, one) for one, gain in screened if gain > data.price(one.n_values)]


def _sure(fitted: Fitted, estimates: Sequence[ColumnEstimate]) -> tuple[ColumnEstimate, Words] | None:
    """Return the most likely difference if the likelihood and the parts of the run support it; None otherwise."""
    for one in sorted(estimates, key=lambda one: -one.gain):
        words = one.of.words(one, fitted)
        if words is None:
            continue
        is_sure = one.gain - one.price >= SCAN.selection.threshold and one.amplitude_z > one.of.least_z
        return (one, words) if is_sure else None
    return None


def used_readings(fitted: Fitted) -> Bools:
    """Return which readings (n_scans, n_rays) contribute to the size."""
    return fitted.solver.jacobian.valid & (fitted.solution.responsibilities.weight > 0)


def _screened(fitted: Fitted, columns: Sequence[Columns]) -> list[tuple[Columns, float]]:
    """Return the differences, each with its gain [nats] to first order."""
    out = []
    for one in columns:
        solver, k = fitted.solver.with_columns(one.columns), one.columns.shape[1]
        weight = fitted.solution.responsibilities.weight
        system = solver.assemble(weight, fitted.state.pose_scale)
        x = np.concatenate([fitted.state.g, fitted.solution.p, np.zeros(k)])
        score = (system.right - system.matrix @ x)[-k:]
        inverse = inverted(*with_priors(system.matrix, solver, fitted.solution))
        out.append((one, 0.5 * float(score @ inverse[-k:, -k:] @ score)))
    return out


def estimated(fitted: Fitted, one: Columns) -> ColumnEstimate:
    """Fit a difference jointly with all other unknowns.

    Poses and map restart within their tolerances, or within the tolerances that the fit has widened, because the fit may
    have absorbed the columns in them.
    """
    columns, state = one.columns, fitted.state.copy()
    k, solver = columns.shape[1], fitted.solver.with_columns(columns)
    bounds = replace(SCAN.noise, max_scale=state.stretch)
    state.delta = solver.data.pose_start
    state.pose_scale = state.map_scale = 1.0
    start = np.concatenate([fitted.solution.p, np.zeros(k)])
    solution = iterate(solver, state, start, bounds)
    weight, scale = solution.responsibilities.weight, solution.state.pose_scale
    _, systems = systems_of_parts(solver, weight, scale)
    x = np.concatenate([solution.state.g, solution.p])
    scores = np.array([system.right - system.matrix @ x for system in systems])
    total, free = with_priors(np.sum([system.matrix for system in systems], axis=0), solver, solution)
    inverse, information = inverted(total, free), _information(total, free, k)
    each = (scores - scores.mean(axis=0)) @ inverse[:, -k:]  # change that each part would cause
    used, values = used_readings(fitted), solution.p[-k:]
    if one.is_contrast:
        mass = np.einsum("nkm,nm->k", np.abs(columns) > 0, used)
        values = values - float(mass @ values) / max(float(mass.sum()), 1.0)
    along = information @ values / max(float(values @ information @ values), 1e-12)
    scatter = float(np.sqrt(np.square(each @ along).sum()))
    return ColumnEstimate(
        of=one,
        values=values,
        stderr=np.sqrt(np.square(each).sum(axis=0)),
        information=information,
        gain=solution.j - fitted.j,
        price=solver.data.price(one.n_values),
        amplitude_z=1 / max(scatter, 1e-9),
        offset=rms(np.matmul(values, columns)[used]),
        affected=float(used.mean()),
    )


def systems_of_parts(solver: Solver, weight: Floats, pose_scale: float) -> tuple[list[Ints], list[System]]:
    """Return the scans of each of `N_PARTS` parts of the run, and their normal equations for weights (n_scans, n_rays) [1/m²]."""
    parts = np.array_split(np.arange(solver.data.n_scans), N_PARTS)
    return parts, [solver.of_scans(some).assemble(weight[some], pose_scale) for some in parts]


def with_priors(matrix: Floats, solver: Solver, solution: Solution) -> tuple[Floats, Bools]:
    """Return normal equations (m, m) with their priors, and which unknowns (m,) are neither held nor at a bound."""
    tau, g = solver.scaled(solution.state), solution.state.g
    total = with_prior(matrix, tau)
    at_bound = np.abs(g) > (1 - 1e-3) * SCAN.nuisance.max_tolerances * tau
    free = np.concatenate([~(solver.locked | at_bound), np.ones(len(total) - len(tau), dtype=np.bool_)])
    return total, free


def inverted(total: Floats, free: Bools) -> Floats:
    """Return the inverse (m, m) of normal equations, as `with_priors` returns them; 0 for unknowns that are not free."""
    inverse = np.zeros(total.shape)
    inverse[np.ix_(free, free)] = np.linalg.inv(total[np.ix_(free, free)])
    return inverse


def _information(total: Floats, free: Bools, k: int) -> Floats:
    """Return the information (k, k) on the last k unknowns, which exists even if another unknown is collinear with them."""
    others = free.copy()
    others[-k:] = False
    across = total[others][:, -k:]
    return np.asarray(total[-k:, -k:] - across.T @ np.linalg.solve(total[np.ix_(others, others)], across))
