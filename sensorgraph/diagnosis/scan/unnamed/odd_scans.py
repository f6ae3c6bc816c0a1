"""Test whether scans differ from each other: late stamps, wrong poses, or a separate offset in each scan.

    J = Σ_i log[(1 - share) p_i(first) + share p_i(second)]

    log p_i(value) = score_i value - information_i value² / 2
    log p_i(sd)    = score_i² / (information_i + sd⁻²) / 2 - log(1 + sd² information_i) / 2
    log p_i(prior) = right_i' (block_i + prior⁻¹)⁻¹ right_i / 2 - log |I + prior block_i| / 2

J is the log-likelihood of a mixture of two kinds of scan, fitted by expectation maximisation (Dempster, Laird
and Rubin 1977). The two kinds have different delays (value), or pose errors with a narrow and a much wider
prior. A range offset per scan is a random effect with standard deviation sd. The pose error of each scan is
integrated out under its prior.

Offsets are reported if their gain is at least twice that of the other two. Two delays are reported if, next to
them, wrong poses retain less than half of that larger gain. A wrong stamp acts in proportion to the motion, which
wrong poses do not. Otherwise, wrong poses are reported.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.diagnosis.scan.column_fit import fit_columns, is_better_alone
from sensorgraph.diagnosis.scan.consequence import ScanError, length
from sensorgraph.diagnosis.scan.each_scan import EachScan, each_scan
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.replicates import replicate
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.robust import rms
from sensorgraph.types import Bools, Floats

LATE, ELSEWHERE, OFFSETS = "late_scans", "scans_elsewhere", "scan_offsets"
"""Kinds of odd scan."""

LATE_CAUSES = (
    "scans that sometimes wait in a queue, and are stamped when they leave it",
    "two clocks that stamp the scans in turn",
)
STRETCH_CAUSES = (
    "two clocks that drift apart and are synchronised at times",
    "a queue that fills during the run",
)
OFFSET_CAUSES = (
    "mirror facets or receivers that alternate and differ",
    "a laser that calibrates its zero again in every scan",
)
ELSEWHERE_CAUSES = (
    "a reference that sometimes loses track: hidden or swapped markers, extrapolated or outdated poses",
    "a laser that sways, or a robot that pitches or is lifted",
)


@dataclass(frozen=True, kw_only=True)
class OddScans:
    """Scans that differ from the others."""

    family: str
    """LATE, ELSEWHERE or OFFSETS."""
    statement: str
    causes: tuple[str, ...]
    """Possible causes, most likely first."""
    share: float
    """Share of the scans."""
    gain: float
    """[nats] Log-likelihood ratio of two kinds of scan to one."""
    offset: float
    """[m] RMS change of the readings of these scans."""


def odd_scans(fitted: Fitted) -> tuple[OddScans | None, dict[str, float]]:
    """Search for scans that differ from the others, given the effects and nuisances of a fit.

    Returns
    -------
    The most likely kind, None without a likely one; and the gain [nats] of each kind over one kind of scan.
    """
    settings, least, each = SCAN.odd_scans, least_gain(), each_scan(fitted)
    late, is_late = _two_delays(each)
    elsewhere, is_elsewhere, prior = _two_priors(each)
    shifted, spread, is_rough = _offsets(each)
    gains = {LATE: late, ELSEWHERE: elsewhere, OFFSETS: shifted}
    # scans at distant places observe different walls with different map errors
    is_offset = is_rough and spread >= fitted.solver.data.grain
    if is_offset and shifted > max(least, settings.clear_lead * max(late, elsewhere)):
        statement = f"each scan has a different range offset, {length(spread)} (rms)"
        found = OddScans(
            family=OFFSETS, statement=statement, causes=OFFSET_CAUSES, share=1.0, gain=shifted, offset=spread
        )
        return found, gains
    if late > least and is_late.sum() >= settings.min_scans:
        found, left = _late(fitted, is_late)
        if found.gain > least and left < settings.left_share * max(late, elsewhere):
            return found, gains
    if elsewhere > least and is_elsewhere.sum() >= settings.min_scans:
        return _elsewhere(fitted, each, is_elsewhere, prior, elsewhere), gains
    return None, gains


def find(checked: Checked) -> list[Doubt]:
    """Return the kinds of odd scan; at most one is sure, if scans differ more than in simulated replicates.

    If two kinds of scan alone explain more than all effects, they replace the effects.
    """
    fitted, null, rng, price = checked.fitted, checked.null, checked.rng, 2 * SCAN.selection.price
    found, gains = odd_scans(fitted)
    failed, beside = frozenset[int](), 0.0 if found is None else found.gain
    if found is not None and not _is_beyond_replicates(found, fitted, rng):
        found = None
    if found is not None and found.family == LATE:
        # a common delay is then the mean of two, and its size is not valid
        is_delay = [Nuisance.DELAY in a.effect.nuisances for a in fitted.model]
        failed = frozenset(np.flatnonzero(is_delay).tolist())
    if fitted.model and null is not None:
        alone, _ = odd_scans(null)
        stands_alone = alone is not None and is_better_alone(alone.gain, null, beside, fitted)
        if alone is not None and stands_alone and _is_beyond_replicates(alone, null, rng):
            found, failed = alone, frozenset(range(len(fitted.model)))
    unsure = [
        Doubt.unsure(family, gain, price)
        for family, gain in gains.items()
        if found is None or family != found.family
    ]
    if found is None:
        return unsure
    valid = fitted.solver.jacobian.valid & fitted.solver.data.returned
    sure = Doubt(
        family=found.family,
        price=price,
        statement=found.statement,
        misfit=found.gain,
        statistic=found.gain,
        threshold=SCAN.selection.threshold,
        failed=failed,
        size=ScanError(offset=found.offset, affected=found.share * float(valid.mean())),
        causes=found.causes,
    )
    return [sure, *unsure]


def least_gain() -> float:
    """Return the evidence [nats] that a second kind of scan requires, including penalties for its size and its share."""
    return SCAN.selection.threshold + 2 * SCAN.selection.price


def _is_beyond_replicates(found: OddScans, fitted: Fitted, rng: np.random.Generator) -> bool:
    """Return whether scans differ more than in simulated replicates.

    Replicates contain, for example, rounding that is the same for all rays to one wall.
    """
    for _ in range(SCAN.odd_scans.n_replicates):
        _, drawn = replicate(fitted.solver.data, fitted, rng)
        usual, _ = odd_scans(drawn)
        if usual is not None and found.gain < SCAN.odd_scans.replicate_factor * usual.gain:
            return False
    return True


def _mixed(first: Floats, second: Floats, share: float) -> tuple[Floats, Floats]:
    """Return the log-likelihoods (n_scans,) of a mixture and the probability that each scan is of the second kind."""
    a, b = np.log1p(-share) + first, np.log(share) + second
    both = np.logaddexp(a, b)
    return both, np.exp(b - both)


def _two_delays(each: EachScan) -> tuple[float, Bools]:
    """Fit two delays; return the gain [nats] over one, and the scans that have the rarer one."""
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


def _offsets(each: EachScan) -> tuple[float, float, bool]:
    """Fit the standard deviation [m] of an offset of each scan.

    Errors over range or place also produce offsets, but these change slowly along the path. The ratio of the
    mean square successive difference to the variance detects them (von Neumann 1941). It is 2 if neighbouring
    scans are independent.

    Returns
    -------
    The gain [nats], the standard deviation, and whether neighbouring scans differ.
    """
    gain, sd = max((float(each.offset.log_p_of_spread(sd).sum()), sd) for sd in SCAN.odd_scans.offsets)
    likely = each.offset.score / (each.offset.information + 1 / sd**2)
    ratio = float(np.square(np.diff(likely)).mean() / max(float(likely.var()), 1e-18))
    return gain, sd, ratio > SCAN.odd_scans.min_roughness


def _two_priors(each: EachScan) -> tuple[float, Bools, Floats]:
    """Fit a second, wider prior of the pose error; return the gain [nats], the scans that have it, and that prior."""
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


def _late(fitted: Fitted, is_late: Bools) -> tuple[OddScans, float]:
    """Fit the delay of some scans jointly with all other unknowns; return it, and the remaining gain [nats] of wrong poses."""
    solver, share = fitted.solver, float(is_late.mean())
    column = solver.stack[:, Nuisance.DELAY]
    columns = (column * is_late[:, None])[:, None, :]
    got = fit_columns(fitted, columns, np.zeros(1), rounds=SCAN.fit.column_rounds)
    used = solver.jacobian.valid & solver.data.returned & is_late[:, None]
    delay = float(got.values[0])
    then = each_scan(replace(fitted, solution=got.solution, solver=solver.with_columns(columns)))
    changes, by_chance = np.count_nonzero(np.diff(is_late)), 2 * share * (1 - share) * len(is_late)
    stamped = f"stamped {1e3 * abs(delay):.0f} ms too {'late' if delay > 0 else 'early'}"
    if changes < SCAN.odd_scans.max_changes_share * by_chance:
        causes, statement = (
            STRETCH_CAUSES,
            (
                f"the delay of the scans changes during the run: in {100 * share:.0f} % of it they are {stamped}, relative to the "
                "rest"
            ),
        )
    else:
        causes = LATE_CAUSES
        statement = f"{100 * share:.0f} % of the scans are {stamped}, relative to the others"
    found = OddScans(
        family=LATE,
        statement=statement,
        causes=causes,
        share=share,
        gain=got.gain - len(is_late) * _entropy(share),
        offset=abs(delay) * rms(column[used]),
    )
    return found, _two_priors(then)[0]


def _elsewhere(fitted: Fitted, each: EachScan, is_odd: Bools, prior: Floats, gain: float) -> OddScans:
    """Return the distance of some scans from their reference poses."""
    solver, delta, share = fitted.solver, each.poses(prior), float(is_odd.mean())
    used = solver.jacobian.valid & solver.data.returned & is_odd[:, None]
    x, y, phi = delta[is_odd].T
    return OddScans(
        family=ELSEWHERE,
        statement=f"{100 * share:.0f} % of the scans were taken away from their reference pose, by "
        f"{length(rms(np.hypot(x, y)))} and {np.degrees(rms(phi)):.2g}° (rms)",
        causes=ELSEWHERE_CAUSES,
        share=share,
        gain=gain,
        offset=rms(np.matmul(delta[:, None, :], solver.jacobian.pose)[:, 0][used]),
    )


def _entropy(share: float) -> float:
    """Return the entropy per scan [nats] of the choice between two kinds."""
    some = [x for x in (share, 1 - share) if x > 0]
    return -float(sum(x * np.log(x) for x in some))


ODD_SCANS = Unnamed(
    titles={
        LATE: "scans of which some are late",
        ELSEWHERE: "scans taken away from their reference pose",
        OFFSETS: "scans with different range offsets",
    },
    find=find,
    is_cause=True,
)
