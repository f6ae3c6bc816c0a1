"""Whether a share of the scans carries stamps that are late, or early, by the same time: a queue, a clock that is read twice.

Two delays in place of one, each scan having one or the other: a mixture of two normal distributions in the delay of each
scan, fitted by expectation and maximisation (Dempster, Laird and Rubin 1977), with the pose error of each scan integrated
out under its prior.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.scan.column_fit import fit_columns
from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.effect_laws import Doubt
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.nuisance import pose_prior
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.types import Floats

CAUSES = (
    "scans that wait in a queue at times, and are stamped when they leave it",
    "two clocks of which now one and now the other stamps the scan",
)


@dataclass(frozen=True, kw_only=True)
class LateScans:
    """Two delays of which each scan has one."""

    share: float
    """Of the scans that have the rarer one."""
    delay: float
    """[s] by which their stamps are later, after the beam was measured, than those of the others."""
    gain: float
    """[nats] that two delays are likelier than one."""
    offset: float
    """[m] root mean square of what the difference does to readings of these scans."""

    def sentence(self) -> str:
        """Say it in words."""
        late = "late" if self.delay > 0 else "early"
        return f"{100 * self.share:.0f} % of the scans are stamped {1e3 * abs(self.delay):.0f} ms too {late}, beside the others"


def late_scans(fitted: Fitted) -> LateScans | None:
    """Fit two delays beside the effects and nuisances of a fit; None where one is enough."""
    score, information = _delay_of_each_scan(fitted)
    settings = SCAN.late_scans

    def log_p(delay: float) -> Floats:
        return score * delay - 0.5 * information * delay**2

    common = float(score.sum() / max(float(information.sum()), 1e-12))
    best, is_late = -np.inf, np.zeros(len(score))
    for start in settings.starts:
        first, second, share = common, common + start, settings.first_share
        for _ in range(settings.rounds):
            a, b = np.log1p(-share) + log_p(first), np.log(share) + log_p(second)
            both = np.logaddexp(a, b)
            is_second = np.exp(b - both)
            share = float(np.clip(is_second.mean(), settings.min_share, 1 - settings.min_share))
            first, second = (
                float((w * score).sum() / max(float((w * information).sum()), 1e-12))
                for w in (1 - is_second, is_second)
            )
        if both.sum() > best:
            best, is_late = float(both.sum()), is_second if share <= 0.5 else 1 - is_second
    late = np.round(is_late)
    if best - float(log_p(common).sum()) < _least_gain() or not late.any():
        return None
    solver = fitted.solver
    column = solver.stack[:, Nuisance.DELAY]
    got = fit_columns(
        fitted, column[:, None, :] * late[:, None, None], np.zeros(1), rounds=settings.refit_rounds
    )
    used = solver.jacobian.valid & solver.data.returned & (late[:, None] > 0)
    (delay,) = got.values
    price = float(len(late) * _entropy(late.mean()))
    return LateScans(
        share=float(late.mean()),
        delay=float(delay),
        gain=got.gain - price,
        offset=abs(float(delay)) * float(np.sqrt(np.square(column[used]).mean())) if used.any() else 0.0,
    )


def _entropy(share: float) -> float:
    """Return what it takes to say which of two kinds a scan is [nats]."""
    some = [x for x in (share, 1 - share) if x > 0]
    return -float(sum(x * np.log(x) for x in some))


def _delay_of_each_scan(fitted: Fitted) -> tuple[Floats, Floats]:
    """Return score [1/s] and information [1/s²] (n_scans,) of the delay of each scan, pose errors integrated out."""
    solver, solution = fitted.solver, fitted.solution
    weight = np.where(solver.jacobian.valid, solution.responsibilities.weight, 0.0)
    state = solution.state.copy()
    state.delta[:] = 0.0
    left = solver.y - solver.shift(state, solution.p)
    delayed = solver.stack[:, Nuisance.DELAY]
    posed = solver.jacobian.pose * weight[:, None, :]
    h = np.matmul(posed, solver.jacobian.pose.transpose(0, 2, 1))
    h += np.linalg.inv(pose_prior(solver.data, state.pose_scale))
    by_delay, by_left = (np.matmul(posed, column[:, :, None]) for column in (delayed, left))
    given = np.linalg.solve(h, by_delay)[..., 0]
    score = (delayed * weight * left).sum(axis=1) - (given * by_left[..., 0]).sum(axis=1)
    information = (delayed**2 * weight).sum(axis=1) - (given * by_delay[..., 0]).sum(axis=1)
    return score, information


def late_stamps(fitted: Fitted, null: Fitted | None = None) -> list[Doubt]:
    """Doubt scans of which a share is late by a time that matters.

    Parameters
    ----------
    null : the fit without effects: where two delays alone explain more than all effects, they stand for them
    """
    found, failed = _sure(fitted), frozenset[int]()
    if found is not None:  # a delay of all scans that is the mean of two has no one size
        is_delay = [Nuisance.DELAY in a.effect.nuisances for a in fitted.model]
        failed = frozenset(np.flatnonzero(is_delay).tolist())
    if fitted.model and null is not None:
        alone = _sure(null)
        if alone is not None and null.j + alone.gain > fitted.j:
            found, failed = alone, frozenset(range(len(fitted.model)))
    if found is None:
        return []
    valid = fitted.solver.jacobian.valid & fitted.solver.data.returned
    return [
        Doubt(
            statement=found.sentence(),
            misfit=found.gain,
            statistic=found.gain,
            threshold=SCAN.selection.threshold,
            failed=failed,
            size=ScanError(offset=found.offset, affected=found.share * float(valid.mean())),
            causes=CAUSES,
        )
    ]


def _sure(fitted: Fitted) -> LateScans | None:
    """Return two delays that the likelihood speaks for; None where one is enough."""
    found = late_scans(fitted)
    return found if found is not None and found.gain > _least_gain() else None


def _least_gain() -> float:
    """Return the evidence [nats] that a second delay and its share take."""
    return SCAN.selection.threshold + 2 * SCAN.selection.price
