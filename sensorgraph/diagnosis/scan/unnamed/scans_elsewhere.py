"""Scans that were taken away from their reference poses, or at another time than their stamps say.

    J = Σ_i log[(1 - share) p_i(prior) + share p_i(wider² prior)]

J is the log-likelihood of a mixture of two kinds of scan, fitted by expectation maximisation (Dempster, Laird and Rubin
1977): the pose errors of the second kind have a much wider prior. The pose error of each scan is integrated out
(`each_scan`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.scan.consequence import ScanError, length
from sensorgraph.diagnosis.scan.each_scan import each_scan
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.replicates import replicate
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
ROUNDS = 40
"""Number of rounds of expectation maximisation."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Elsewhere:
    """A second kind of scan."""

    gain: float
    """[nats] Log-likelihood ratio of two kinds of scan to one."""
    is_odd: Bools
    """(n_scans,) Whether the scan is of the second kind."""
    delta: Floats
    """(n_scans, 3) [m, m, rad] Pose errors under the prior of the second kind."""

    @property
    def is_likely(self) -> bool:
        """Whether the likelihood supports it, after the complexity penalty, in more than single scans."""
        is_enough = self.is_odd.sum() >= SCAN.goodness_of_fit.min_blocks
        return bool(self.gain > SCAN.selection.threshold + _price() and is_enough)


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
        return [Doubt.unsure(NAME, gain, _price())]
    share, solver = float(found.is_odd.mean()), view.solver
    used = solver.jacobian.valid & solver.data.returned
    x, y, phi = found.delta[found.is_odd].T
    moved = np.matmul(found.delta[:, None, :], solver.jacobian.pose)[:, 0]
    return [
        Doubt(
            family=NAME,
            price=_price(),
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
    out = []
    for wider in WIDER:
        wide, share = each.log_p_of_prior(wider**2 * each.prior), 0.5
        for _ in range(ROUNDS):
            first, second = np.log1p(-share) + plain, np.log(share) + wide
            both = np.logaddexp(first, second)
            chance = np.exp(second - both)
            share = float(np.clip(chance.mean(), 0.5 / n, 1 - 0.5 / n))
        gain = float((both - plain).sum())
        out.append(Elsewhere(gain=gain, is_odd=chance > 0.5, delta=each.poses(wider**2 * each.prior)))
    return max(out, key=lambda one: one.gain)


def _price() -> float:
    """Return the complexity penalty [nats] of the width and the share of the second kind."""
    return 2 * SCAN.selection.price


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
