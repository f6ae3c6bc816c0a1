"""Whether scans differ from each other: some stamped late, some taken elsewhere than the reference says, each with an offset.

Mixtures of two normal distributions over the scans, fitted by expectation and maximisation (Dempster, Laird and Rubin 1977),
with the pose error of each scan integrated out under its prior: in the one each scan has one of two delays, in the other some
scans have a pose error that is many times larger. An offset of each scan is a random effect. What a stamp does follows the
motion: two delays are told where they leave little to the others, else the likelier of these.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sensorgraph.diagnosis.scan.column_fit import fit_columns, is_better_alone
from sensorgraph.diagnosis.scan.consequence import ScanError, length
from sensorgraph.diagnosis.scan.effect_laws import Doubt
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.nuisance import pose_prior
from sensorgraph.diagnosis.scan.replicates import replicate
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.types import Bools, Floats

LATE_CAUSES = (
    "scans that wait in a queue at times, and are stamped when they leave it",
    "two clocks of which now one and now the other stamps the scan",
)
STRETCH_CAUSES = (
    "two clocks that run apart, and are set again",
    "a queue that fills during the run",
)
OFFSET_CAUSES = (
    "mirror facets, or receivers, that take turns and differ",
    "a laser that finds its zero anew from scan to scan",
)
ELSEWHERE_CAUSES = (
    "a reference that loses track at times: markers hidden or exchanged, a pose that is extrapolated or old",
    "a laser that sways, or a robot that is lifted or nods",
)


@dataclass(frozen=True, kw_only=True)
class OddScans(ABC):
    """Scans that differ from the others."""

    share: float
    """Of the scans."""
    gain: float
    """[nats] that two kinds of scan are likelier than one."""
    offset: float
    """[m] root mean square of what the difference does to readings of these scans."""
    causes: ClassVar[tuple[str, ...]] = ()
    """What it may be, the likeliest first."""

    @abstractmethod
    def sentence(self) -> str:
        """Say it in words."""


@dataclass(frozen=True, kw_only=True)
class LateScans(OddScans):
    """Two delays of which each scan has one."""

    causes = LATE_CAUSES
    delay: float
    """[s] by which the stamps of the rarer kind are later, after the beam was measured, than those of the others."""

    @property
    def words(self) -> str:
        """How they are stamped."""
        late = "late" if self.delay > 0 else "early"
        return f"stamped {1e3 * abs(self.delay):.0f} ms too {late}"

    def sentence(self) -> str:
        """Say it in words."""
        return f"{100 * self.share:.0f} % of the scans are {self.words}, beside the others"


@dataclass(frozen=True, kw_only=True)
class LateStretches(LateScans):
    """Two delays of which each has stretches of the run: the delay changes."""

    causes = STRETCH_CAUSES

    def sentence(self) -> str:
        """Say it in words."""
        return (
            f"the delay of the scans changes during the run: in {100 * self.share:.0f} % of it they are {self.words}, "
            "beside the rest"
        )


@dataclass(frozen=True, kw_only=True)
class ScansElsewhere(OddScans):
    """Scans that were taken elsewhere than the reference says."""

    causes = ELSEWHERE_CAUSES
    distance: float
    """[m] root mean square of how far."""
    turn: float
    """[rad] the same of the heading."""

    def sentence(self) -> str:
        """Say it in words."""
        return (
            f"{100 * self.share:.0f} % of the scans were taken elsewhere than the reference says, by {length(self.distance)} "
            f"and {np.degrees(self.turn):.2g}°"
        )


@dataclass(frozen=True, kw_only=True)
class ScansWithOffsets(OddScans):
    """Scans that read longer or shorter as a whole, each by a length of its own."""

    causes = OFFSET_CAUSES

    def sentence(self) -> str:
        """Say it in words."""
        return f"every scan reads longer or shorter than the others by an offset of its own, {length(self.offset)} (rms)"


@dataclass(frozen=True, kw_only=True, eq=False)
class _OneColumn:
    """Normal equations of each scan in one number, its pose error integrated out."""

    score: Floats
    """(n_scans,) [1/unit]"""
    information: Floats
    """(n_scans,) [1/unit²]"""

    def log_p(self, value: float) -> Floats:
        """Return how much likelier (n_scans,) [nats] a value makes each scan."""
        return self.score * value - 0.5 * self.information * value**2

    def log_p_of_spread(self, sd: float) -> Floats:
        """Return how much likelier (n_scans,) [nats] values of this standard deviation make each scan."""
        return 0.5 * self.score**2 / (self.information + 1 / sd**2) - 0.5 * np.log1p(sd**2 * self.information)


@dataclass(frozen=True, kw_only=True, eq=False)
class _EachScan:
    """Normal equations of each scan in its pose error, in a delay and in an offset; the rest is as fitted."""

    block: Floats
    """(n_scans, 3, 3)"""
    right: Floats
    """(n_scans, 3)"""
    prior: Floats
    """(n_scans, 3, 3) covariance of the pose error."""
    delay: _OneColumn
    """[s]"""
    offset: _OneColumn
    """[m] beside a pose error that is free: what no wrong pose could have done."""

    def poses(self, prior: Floats) -> Floats:
        """Return the likeliest pose errors (n_scans, 3) under a prior."""
        return np.asarray(np.linalg.solve(self.block + np.linalg.inv(prior), self.right[..., None])[..., 0])

    def log_p_of_prior(self, prior: Floats) -> Floats:
        """Return the log-likelihood (n_scans,) [nats] of each scan under a prior of its pose error, up to a constant."""
        _, volume = np.linalg.slogdet(np.eye(3) + np.matmul(prior, self.block))
        return np.asarray(0.5 * (self.right * self.poses(prior)).sum(axis=1) - 0.5 * volume)


def odd_scans(fitted: Fitted) -> OddScans | None:
    """Look for scans that differ, beside the effects and nuisances of a fit; None where they are all of one kind."""
    each = each_scan(fitted)
    late, is_late = _two_delays(each)
    elsewhere, is_elsewhere, prior = _two_priors(each)
    shifted, spread, is_rough = _offsets(each)
    # scans far apart see other walls, each with an error of its own
    is_offset = is_rough and spread >= fitted.solver.data.grain
    if is_offset and shifted > max(least_gain(), SCAN.odd_scans.clear_lead * max(late, elsewhere)):
        return ScansWithOffsets(share=1.0, gain=shifted, offset=spread)
    if late > least_gain() and is_late.sum() >= SCAN.odd_scans.min_scans:
        found, left = _late(fitted, is_late)
        if found.gain > least_gain() and left < SCAN.odd_scans.left_share * max(late, elsewhere):
            return found
    if elsewhere < least_gain() or is_elsewhere.sum() < SCAN.odd_scans.min_scans:
        return None
    return _elsewhere(fitted, each, is_elsewhere, prior, elsewhere)


def odd_scan_doubts(fitted: Fitted, null: Fitted | None = None, *, rng: np.random.Generator) -> list[Doubt]:
    """Doubt scans of which a share is late, or elsewhere, by more than scans drawn from the fit are.

    Parameters
    ----------
    null : the fit without effects: where two kinds of scan alone explain more than all effects, they stand for them
    rng : of the drawn scans
    """
    found, failed = _sure(fitted), frozenset[int]()
    beside = 0.0 if found is None else found.gain
    if found is not None and not _is_beyond_replicates(found, fitted, rng):
        found = None
    if isinstance(found, LateScans):  # a delay of all scans that is the mean of two has no one size
        is_delay = [Nuisance.DELAY in a.effect.nuisances for a in fitted.model]
        failed = frozenset(np.flatnonzero(is_delay).tolist())
    if fitted.model and null is not None:
        alone = _sure(null)
        stands_alone = alone is not None and is_better_alone(alone.gain, null, beside, fitted)
        if alone is not None and stands_alone and _is_beyond_replicates(alone, null, rng):
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
            causes=found.causes,
        )
    ]


def least_gain() -> float:
    """Return the evidence [nats] that a second kind of scan, its size and its share, take."""
    return SCAN.selection.threshold + 2 * SCAN.selection.price


def _sure(fitted: Fitted) -> OddScans | None:
    found = odd_scans(fitted)
    return found if found is not None and found.gain > least_gain() else None


def _is_beyond_replicates(found: OddScans, fitted: Fitted, rng: np.random.Generator) -> bool:
    """Tell whether scans differ more than those of replicates: rays to one wall are rounded alike, for instance."""
    for _ in range(SCAN.odd_scans.n_replicates):
        _, drawn = replicate(fitted.solver.data, fitted, rng)
        usual = odd_scans(drawn)
        if usual is not None and found.gain < SCAN.odd_scans.replicate_factor * usual.gain:
            return False
    return True


def each_scan(fitted: Fitted) -> _EachScan:
    """Assemble the equations of every scan by itself."""
    solver, solution = fitted.solver, fitted.solution
    weight = np.where(solver.jacobian.valid, solution.responsibilities.weight, 0.0)
    state = solution.state.copy()
    state.delta[:] = 0.0
    left = solver.y - solver.shift(state, solution.p)
    prior, posed = pose_prior(solver.data, state.pose_scale), solver.jacobian.pose * weight[:, None, :]
    block = np.matmul(posed, solver.jacobian.pose.transpose(0, 2, 1))
    by_left = np.matmul(posed, left[:, :, None])[..., 0]

    def of(column: Floats, widened: float) -> _OneColumn:
        inner = np.linalg.inv(block + np.linalg.inv(widened**2 * prior))
        by_column = np.matmul(posed, column[:, :, None])[..., 0]
        given = np.matmul(inner, by_column[..., None])[..., 0]
        return _OneColumn(
            score=(column * weight * left).sum(axis=1) - (given * by_left).sum(axis=1),
            information=(column**2 * weight).sum(axis=1) - (given * by_column).sum(axis=1),
        )

    return _EachScan(
        block=block,
        right=by_left,
        prior=prior,
        delay=of(solver.stack[:, Nuisance.DELAY], 1.0),
        offset=of(solver.stack[:, Nuisance.BIAS], SCAN.odd_scans.wider[0]),
    )


def _mixed(first: Floats, second: Floats, share: float) -> tuple[Floats, Floats]:
    """Return log-likelihoods (n_scans,) of a mixture, and the chance that each scan is of the second kind."""
    a, b = np.log1p(-share) + first, np.log(share) + second
    both = np.logaddexp(a, b)
    return both, np.exp(b - both)


def _two_delays(each: _EachScan) -> tuple[float, Bools]:
    """Fit two delays; return the gain [nats] over one, and which scans have the rarer one."""
    settings, delay = SCAN.odd_scans, each.delay
    common = float(delay.score.sum() / max(float(delay.information.sum()), 1e-12))
    best, is_late = -np.inf, np.zeros(len(delay.score), dtype=np.bool_)
    for start in settings.delays:
        first, second, share = common, common + start, settings.first_share
        for _ in range(settings.rounds):
            both, chance = _mixed(delay.log_p(first), delay.log_p(second), share)
            share = float(np.clip(chance.mean(), settings.min_share, 1 - settings.min_share))
            first, second = (
                float((w * delay.score).sum() / max(float((w * delay.information).sum()), 1e-12))
                for w in (1 - chance, chance)
            )
        if both.sum() > best:
            best, is_late = float(both.sum()), (chance > 0.5) == (share <= 0.5)
    return best - float(delay.log_p(common).sum()), is_late


def _offsets(each: _EachScan) -> tuple[float, float, bool]:
    """Fit the standard deviation [m] of an offset of each scan; return the gain [nats], it, and whether neighbours differ.

    An error that depends on range or place makes offsets, too, which change slowly along the way (von Neumann 1941, ratio
    of the mean square successive difference to the variance; 2 where neighbours have nothing in common).
    """
    gain, sd = max((float(each.offset.log_p_of_spread(sd).sum()), sd) for sd in SCAN.odd_scans.offsets)
    likely = each.offset.score / (each.offset.information + 1 / sd**2)
    ratio = float(np.square(np.diff(likely)).mean() / max(float(likely.var()), 1e-18))
    return gain, sd, ratio > SCAN.odd_scans.min_roughness


def _two_priors(each: _EachScan) -> tuple[float, Bools, Floats]:
    """Fit a second, wider prior of the pose error; return the gain [nats], which scans have it, and that prior."""
    settings, plain = SCAN.odd_scans, each.log_p_of_prior(each.prior)
    best, is_odd, widest = -np.inf, np.zeros(len(plain), dtype=np.bool_), each.prior
    for wider in settings.wider:
        share, prior = settings.first_share, wider**2 * each.prior
        wide = each.log_p_of_prior(prior)
        for _ in range(settings.rounds):
            both, chance = _mixed(plain, wide, share)
            share = float(np.clip(chance.mean(), settings.min_share, 1 - settings.min_share))
        if both.sum() > best:
            best, is_odd, widest = float(both.sum()), chance > 0.5, prior
    return best - float(plain.sum()), is_odd, widest


def _late(fitted: Fitted, is_late: Bools) -> tuple[LateScans, float]:
    """Fit the delay of some scans together with all else; return it, and what is left to wrong poses [nats]."""
    solver, share = fitted.solver, float(is_late.mean())
    column = solver.stack[:, Nuisance.DELAY]
    columns = (column * is_late[:, None])[:, None, :]
    got = fit_columns(fitted, columns, np.zeros(1), rounds=SCAN.odd_scans.refit_rounds)
    used = solver.jacobian.valid & solver.data.returned & is_late[:, None]
    delay = float(got.values[0])
    then = each_scan(replace(fitted, solution=got.solution, solver=solver.with_columns(columns)))
    changes, by_chance = np.count_nonzero(np.diff(is_late)), 2 * share * (1 - share) * len(is_late)
    kind = LateStretches if changes < SCAN.odd_scans.max_changes_share * by_chance else LateScans
    found = kind(
        share=share,
        gain=got.gain - len(is_late) * _entropy(share),
        offset=abs(delay) * float(np.sqrt(np.square(column[used]).mean())) if used.any() else 0.0,
        delay=delay,
    )
    return found, _two_priors(then)[0]


def _elsewhere(
    fitted: Fitted, each: _EachScan, is_odd: Bools, prior: Floats, gain: float
) -> ScansElsewhere | None:
    """Say how far from the reference some scans were taken."""
    solver, delta = fitted.solver, each.poses(prior)
    used = solver.jacobian.valid & solver.data.returned & is_odd[:, None]
    if not used.any():
        return None
    off = np.matmul(delta[:, None, :], solver.jacobian.pose)[:, 0][used]
    x, y, phi = delta[is_odd].T
    return ScansElsewhere(
        share=float(is_odd.mean()),
        gain=gain,
        offset=float(np.sqrt(np.square(off).mean())),
        distance=float(np.sqrt((x**2 + y**2).mean())),
        turn=float(np.sqrt((phi**2).mean())),
    )


def _entropy(share: float) -> float:
    """Return what it takes to say which of two kinds a scan is [nats]."""
    some = [x for x in (share, 1 - share) if x > 0]
    return -float(sum(x * np.log(x) for x in some))
