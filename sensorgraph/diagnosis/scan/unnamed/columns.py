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
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtri

from sensorgraph.diagnosis.result import Profile
from sensorgraph.diagnosis.scan.column_fit import fit_columns, inverse_of_whole, is_better_alone
from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt
from sensorgraph.robust import rms
from sensorgraph.types import Bools, Floats


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
    is_contrast: bool = False
    """Whether only differences between the values count, so that their mean over all readings is 0."""

    @property
    def price(self) -> float:
        """[nats] Complexity penalty."""
        return float(SCAN.selection.price * self.columns.shape[1])

    @property
    def least_z(self) -> float:
        """Amplitude in standard errors that it needs, given that its direction was chosen from k dimensions."""
        k, n = self.columns.shape[1], SCAN.constancy.n_parts
        return float(np.sqrt(k * fdtri(k, n - 1, SCAN.constancy.confidence)))

    @abstractmethod
    def words(self, estimate: ColumnEstimate, fitted: Fitted) -> Words | None:
        """Return what a report says of an estimate; None if something harmless explains it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ColumnEstimate:
    """The values of a difference, as estimated from a run."""

    of: Columns
    values: Floats
    """(k,)"""
    stderr: Floats
    """(k,) standard errors, from the scatter between parts of the run."""
    gain: float
    """[nats] increase of the penalised log-likelihood."""
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
    found = _sure(fitted, screened)
    if fitted.model and null is not None:
        least = SCAN.profiles.min_first_order_share * (fitted.j - null.j)
        alone = _sure(null, _screened(null, columns_of(null)), least)
        beside = 0.0 if found is None else found[0].gain - found[0].of.price
        if alone is not None and is_better_alone(alone[0].gain - alone[0].of.price, null, beside, fitted):
            found, failed = alone, frozenset(range(len(fitted.model)))
    unsure = [
        Doubt.unsure(one.family, gain, one.price)
        for one, gain in screened
        if found is None or one.family != found[0].of.family
    ]
    if found is None:
        return unsure
    best, words = found
    sure = Doubt(
        family=best.of.family,
        price=best.of.price,
        statement=words.statement,
        misfit=best.gain,
        statistic=best.amplitude_z,
        threshold=best.of.least_z,
        failed=failed,
        size=ScanError(offset=best.offset, affected=best.affected),
        causes=words.causes,
        profile=words.profile,
    )
    return [sure, *unsure]


def _sure(
    fitted: Fitted, screened: Sequence[tuple[Columns, float]], least: float = 0.0
) -> tuple[ColumnEstimate, Words] | None:
    """Return the most likely difference if the likelihood and the parts of the run support it; None otherwise.

    Parameters
    ----------
    screened : Differences, each with its gain [nats] to first order; only those with more than `least`, and than
        their complexity penalty, are fitted.
    """
    found = [estimated(fitted, one) for one, gain in screened if gain > max(least, one.price)]
    for one in sorted(found, key=lambda one: -one.gain):
        words = one.of.words(one, fitted)
        if words is None:
            continue
        is_sure = one.gain - one.of.price >= SCAN.selection.threshold and one.amplitude_z > one.of.least_z
        return (one, words) if is_sure else None
    return None


def used_readings(fitted: Fitted) -> Bools:
    """Return which readings (n_scans, n_rays) contribute to the size."""
    return fitted.solver.jacobian.valid & (fitted.solution.responsibilities.weight > 0)


def _screened(fitted: Fitted, columns: Sequence[Columns]) -> list[tuple[Columns, float]]:
    """Return the differences, each with its gain [nats] to first order."""
    return [(one, _first_order_gain(fitted, one)) for one in columns]


def _first_order_gain(fitted: Fitted, one: Columns) -> float:
    solver, solution = fitted.solver.with_columns(one.columns), fitted.solution
    system = solver.assemble(solution.responsibilities.weight, fitted.state.pose_scale)
    k = one.columns.shape[1]
    x = np.concatenate([fitted.state.g, solution.p, np.zeros(k)])
    score = (system.right - system.matrix @ x)[-k:]
    covariance = inverse_of_whole([(system.matrix, system.right)], solver, solution)[-k:, -k:]
    return 0.5 * float(score @ covariance @ score)


def estimated(fitted: Fitted, one: Columns) -> ColumnEstimate:
    """Fit a difference jointly with all other unknowns."""
    columns = one.columns
    got = fit_columns(fitted, columns, np.zeros(columns.shape[1]), rounds=SCAN.fit.column_rounds)
    used, values = used_readings(fitted), got.values
    if one.is_contrast:
        mass = np.einsum("nkm,nm->k", np.abs(columns) > 0, used)
        values = values - float(mass @ values) / max(float(mass.sum()), 1.0)
    along = got.information @ values / max(float(values @ got.information @ values), 1e-12)
    scatter = float(np.sqrt(np.square(got.each @ along).sum()))
    return ColumnEstimate(
        of=one,
        values=values,
        stderr=np.sqrt(np.square(got.each).sum(axis=0)),
        gain=got.gain,
        amplitude_z=1 / max(scatter, 1e-9),
        offset=rms(np.matmul(values, columns)[used]),
        affected=float(used.mean()),
    )
