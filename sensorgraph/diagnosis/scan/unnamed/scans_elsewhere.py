"""Scans that were taken away from their reference poses, or at another time than their stamps say.

    J = Σ_i log[(1 - share) p_i(prior) + share p_i(wider² prior)]

J is the log-likelihood of a mixture of two kinds of scan, fitted by expectation maximisation (Dempster, Laird and Rubin
1977): the pose errors of the second kind have a much wider prior. The normal equations of each scan for its pose error
(`each_scan`) give the likelihood under a prior, with the error integrated out.

    log p_i(prior) = right_i' (block_i + prior⁻¹)⁻¹ right_i / 2 - log |I + prior block_i| / 2

`tolerance_scale` is the ratio of one part of the reference error to its tolerance: the jitter of stamps, or the heading.

    gain(of_rest, of_part) = Σ_i clip(log p_i(of_rest² rest + of_part² part) - log p_i(common² (rest + part)), ±MOST)

Here `rest` and `part` are the prior covariances of the pose error of scan i: of everything else, and of this
part; `common` is the pose scale of the fit.

A fit has one scale for the whole reference error. If poses are better than specified and stamps are worse,
that scale shows neither: the error from stamp jitter grows with speed, and the pose error does not. The same
applies to a heading that is worse than specified while the position is not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sensorgraph.diagnosis.scan.consequence import ScanError, length
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.nuisance import pose_prior
from sensorgraph.diagnosis.scan.residuals import replicate
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.columns import is_better_alone
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed
from sensorgraph.robust import rms
from sensorgraph.types import Bools, Floats

NAME = "scans_elsewhere"
CAUSES = (
    "a reference that sometimes loses track: hidden or swapped markers, extrapolated or outdated poses",
    "a laser that sways, or a robot that pitches or is lifted",
    "scans that sometimes wait in a queue or are repeated, and are stamped late; two clocks that stamp in turn",
)
WIDER = (10.0, 30.0, 100.0)
"""Ratios of the pose error of the second kind to its tolerance that are tried."""
REST_SCALES = np.geomspace(0.25, 4.0, 7)
"""Multiples of the rest of the pose error that are tried, for each multiple of the part."""
PART_SCALES = np.geomspace(0.25, 8.0, 16)
MOST = SCAN.naming.rival_margin
"""[nats] Maximum contribution of one scan to a comparison of scales, because a few scans at wrong poses are not jitter."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Elsewhere:
    """A second kind of scan."""

    gain: float
    """[nats] Log-likelihood ratio of two kinds of scan to one."""
    price: float
    """[nats] Complexity penalty of the width and the share of the second kind."""
    is_odd: Bools
    """(n_scans,) Whether the scan is of the second kind."""
    delta: Floats
    """(n_scans, 3) [m, m, rad] Pose errors under the prior of the second kind."""

    @property
    def is_likely(self) -> bool:
        """Whether the likelihood supports it, after the complexity penalty, in more than single scans."""
        is_enough = self.is_odd.sum() >= SCAN.goodness_of_fit.min_blocks
        return bool(self.gain > SCAN.selection.threshold + self.price and is_enough)


def find(checked: Checked) -> list[Doubt]:
    """Return scans away from their poses; sure if they differ more than in simulated replicates.

    If two kinds of scan alone explain more than all effects, they replace the effects.
    """
    fitted, null, rng = checked.fitted, checked.null, checked.rng
    found, failed, view = elsewhere(fitted), frozenset[int](), fitted
    gain, is_sure = found.gain, _is_sure(found, fitted, rng)
    if fitted.model and null is not None:
        alone = elsewhere(null)
        beside = gain if found.is_likely else 0.0
        if is_better_alone(alone.gain, null, beside, fitted) and _is_sure(alone, null, rng):
            found, failed, view, is_sure = alone, frozenset(range(len(fitted.model))), null, True
    if not is_sure:
        return [Doubt.unsure(NAME, gain, found.price)]
    share, solver = float(found.is_odd.mean()), view.solver
    used = solver.jacobian.valid & solver.data.returned
    x, y, phi = found.delta[found.is_odd].T
    moved = np.matmul(found.delta[:, None, :], solver.jacobian.pose)[:, 0]
    return [
        Doubt(
            family=NAME,
            price=found.price,
            statement=f"{100 * share:.0f} % of the scans were taken away from their reference pose, by "
            f"{length(rms(np.hypot(x, y)))} and {np.degrees(rms(phi)):.2g}° (rms)",
            misfit=found.gain,
            statistic=found.gain,
            threshold=SCAN.selection.threshold,
            failed=failed,
            size=ScanError(
                offset=rms(moved[used & found.is_odd[:, None]]), affected=share * float(used.mean())
            ),
            causes=CAUSES,
        )
    ]


def elsewhere(fitted: Fitted) -> Elsewhere:
    """Fit a second, wider prior of the pose error, given the effects and nuisances of a fit."""
    each = each_scan(fitted)
    plain, n = each.log_p_of_prior(each.prior), len(each.prior)
    price = fitted.solver.data.price(2)
    out = []
    for wider in WIDER:
        wide, share = each.log_p_of_prior(wider**2 * each.prior), 0.5
        for _ in range(SCAN.fit.max_rounds):
            first, second = np.log1p(-share) + plain, np.log(share) + wide
            both = np.logaddexp(first, second)
            chance = np.exp(second - both)
            share = float(np.clip(chance.mean(), 0.5 / n, 1 - 0.5 / n))
        gain = float((both - plain).sum())
        out.append(
            Elsewhere(gain=gain, price=price, is_odd=chance > 0.5, delta=each.poses(wider**2 * each.prior))
        )
    return max(out, key=lambda one: one.gain)


def _is_sure(found: Elsewhere, fitted: Fitted, rng: np.random.Generator) -> bool:
    """Return whether scans are likely to differ, and do so more than in simulated replicates.

    Replicates contain, for example, rounding that is the same for all rays to one wall.
    """
    if not found.is_likely:
        return False
    settings = SCAN.goodness_of_fit
    for _ in range(settings.n_slow_replicates):
        usual = elsewhere(replicate(fitted.solver.data, fitted, rng)[1])
        if usual.is_likely and found.gain < settings.min_ratio_of_scans * usual.gain:
            return False
    return True


SCANS_ELSEWHERE = Unnamed(
    titles={NAME: "scans taken away from their reference pose"}, find=find, is_cause=True
)


@dataclass(frozen=True, kw_only=True, eq=False)
class EachScan:
    """Normal equations of each scan for its pose error; everything else is as fitted."""

    block: Floats
    """(n_scans, 3, 3)"""
    right: Floats
    """(n_scans, 3)"""
    prior: Floats
    """(n_scans, 3, 3) Covariance of the pose error."""

    def poses(self, prior: Floats) -> Floats:
        """Return the most likely pose errors (n_scans, 3) under a prior."""
        return np.asarray(np.linalg.solve(self.block + np.linalg.inv(prior), self.right[..., None])[..., 0])

    def log_p_of_prior(self, prior: Floats) -> Floats:
        """Return the log-likelihood (n_scans,) [nats] of each scan under a prior of its pose error, up to a constant."""
        _, volume = np.linalg.slogdet(np.eye(3) + np.matmul(prior, self.block))
        return np.asarray(0.5 * (self.right * self.poses(prior)).sum(axis=1) - 0.5 * volume)


def each_scan(fitted: Fitted) -> EachScan:
    """Assemble the normal equations of each scan separately."""
    solver, solution = fitted.solver, fitted.solution
    weight = np.where(solver.jacobian.valid, solution.responsibilities.weight, 0.0)
    state = solution.state.copy()
    state.delta[:] = 0.0
    left = solver.y - solver.shift(state, solution.p)
    prior = pose_prior(solver.data, state.pose_scale).covariance
    posed = solver.jacobian.pose * weight[:, None, :]
    return EachScan(
        block=np.matmul(posed, solver.jacobian.pose.transpose(0, 2, 1)),
        right=np.matmul(posed, left[:, :, None])[..., 0],
        prior=prior,
    )


def tolerance_scale(fitted: Fitted, name: Literal["stamp", "pose_yaw"]) -> float:
    """Return the ratio of one part of the pose error to its tolerance, at least 1; also 1 if it is undetermined.

    The result is the scale of the part in the most likely pair of scales of part and rest. The pair must be
    more likely than the common scale of the fit by the evidence that one parameter requires.

    Parameters
    ----------
    name : Tolerance of the part: stamps of the scans, or heading of the reference.
    """
    each, data, common = each_scan(fitted), fitted.solver.data, fitted.state.pose_scale
    without = replace(data.tolerances, **{name: 0.0})
    rest = pose_prior(replace(data, tolerances=without, memo={}), 1.0).covariance
    part = pose_prior(data, 1.0).covariance - rest
    told = each.log_p_of_prior(common**2 * (rest + part))

    def gain(of_rest: float, of_part: float) -> float:
        better = each.log_p_of_prior(of_rest**2 * rest + of_part**2 * part) - told
        return float(np.clip(better, -MOST, MOST).sum())

    gains = np.array([[gain(a, b) for b in PART_SCALES] for a in REST_SCALES])
    found = float(PART_SCALES[gains.max(axis=0).argmax()])
    held = max(gain(a, min(common, found)) for a in REST_SCALES)
    is_sure = gains.max() - max(held, 0.0) > SCAN.selection.threshold + data.price(1)
    return max(found, 1.0) if is_sure else 1.0
