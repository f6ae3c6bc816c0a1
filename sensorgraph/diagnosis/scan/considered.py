"""Entries of the ledger for the scans: the effects of the model, the best start of each other one, and differences without a name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import replace

from sensorgraph.diagnosis.engine.ledger import Competitor, Entry
from sensorgraph.diagnosis.engine.verdict import Facts, Objection
from sensorgraph.diagnosis.ledger import effect_entry
from sensorgraph.diagnosis.report.quantities import minus
from sensorgraph.diagnosis.scan.consequence import SURELY_MATERIAL, ScanError, scan_change
from sensorgraph.diagnosis.scan.fit import Cast, cast, thin
from sensorgraph.diagnosis.scan.goodness_of_fit import GoodnessOfFit
from sensorgraph.diagnosis.scan.model_selection import Explained, Step
from sensorgraph.diagnosis.scan.observability import separation
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed import titles
from sensorgraph.diagnosis.scan.unnamed.family import Doubt
from sensorgraph.diagnosis.scan.worth import price
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.effects.effect import without

USUAL = Objection("site_baseline", "the known-good runs of the site show as much")
"""Why a significant difference is not reported."""


def effect_entries(
    data: ScanData,
    explained: Explained,
    complete: Sequence[Amendment],
    small: Mapping[int, Objection],
    chances: Sequence[float],
) -> tuple[Entry, ...]:
    """Return the entries of all effects that the search fitted, or whose gain it predicted.

    Parameters
    ----------
    complete : Effects of the model with their evidence, in the order of the model.
    small : Index in the model -> why the effect is within tolerance.
    chances : Probability that each effect is material.
    """
    few = thin(data, max(1, data.n_scans // SCAN.selection.n_cast_scans))
    model = explained.final.model
    whole = cast(few, model)
    out = []
    for index, a in enumerate(complete):
        why = small.get(index)
        is_size = why is not None and why.rule == SURELY_MATERIAL
        facts = Facts(
            has_name=True,
            accepted=(a.evidence or 0.0) >= SCAN.selection.threshold,
            evidence=a.evidence,
            threshold=SCAN.selection.threshold,
            material_probability=chances[index],
            required_probability=SCAN.naming.min_material_probability,
            objection=None if is_size else why,
        )
        entry = effect_entry(a, facts, price=price(a, data))
        entry = replace(
            entry, alone=_alone(explained.steps, a), remark=why.words if why is not None and is_size else ""
        )
        out.append(_with_size(entry, whole, cast(few, without(model, index))))
    accepted = frozenset(a.name for a in model)
    names = set(accepted)
    for name, (a, gain, round_) in _best_fits(explained.steps).items():
        if name in names:
            continue
        facts = Facts(has_name=True, evidence=gain, threshold=SCAN.selection.threshold)
        entry = replace(effect_entry(a, facts, price=price(a, data)), alone=_alone(explained.steps, a))
        entry = _with_winner(entry, a, explained.steps[round_:], accepted)
        out.append(_with_size(entry, cast(few, (*model, a)), whole))
        names.add(name)
    for name, candidate in explained.expected.items():
        if name not in names:
            out.append(_expected(candidate.amendment, candidate.gain, data))
    return tuple(out)


def _best_fits(steps: Sequence[Step]) -> dict[str, tuple[Amendment, float, int]]:
    """Return the last fit of each effect at its best place, with its evidence [nats] and the number of the round."""
    out: dict[str, tuple[Amendment, float, int]] = {}
    for number, step in enumerate(steps):
        best: dict[str, tuple[Amendment, float, int]] = {}
        for a, gain in step.tried:
            if a.name not in best or gain > best[a.name][1]:
                best[a.name] = (a, gain, number)
        out |= best
    return out


def _alone(steps: Sequence[Step], a: Amendment) -> float | None:
    """Return the evidence [nats] of an effect at its place in the bare model; None if it was not fitted there."""
    first = steps[0].tried if steps else ()
    return max((gain for b, gain in first if (b.name, b.place) == (a.name, a.place)), default=None)


def _with_winner(entry: Entry, a: Amendment, steps: Sequence[Step], accepted: Set[str]) -> Entry:
    """Add the effect that the first of these rounds of the search chose instead, or why it chose none.

    Parameters
    ----------
    accepted : Names of the effects of the final model.
    """
    step, *later = steps
    if not step.chosen:
        return replace(entry, remark="the accepted effects are approximate, and may leave as much")
    if step.chosen == entry.name:
        found = [EFFECTS[one.chosen].title for one in later if one.chosen in accepted] or ["another effect"]
        verb = "explains" if len(found) == 1 else "explain"
        return replace(entry, remark=f"{' and '.join(found)}, found later, {verb} the same data")
    won, gain = max((one for one in step.tried if one[0].name == step.chosen), key=lambda one: one[1])
    return replace(
        entry, rival=Competitor(title=won.effect.title, evidence=gain, separates=separation(a, won))
    )


def _expected(a: Amendment, gain: float, data: ScanData) -> Entry:
    """Return the entry of an effect whose expected gain [nats] was too small for a fit."""
    paid = price(a, data)
    facts = Facts(
        has_name=True, evidence=gain - paid, threshold=SCAN.selection.threshold, is_significant=False
    )
    remark = f"it was not fitted, because a fit was expected to gain only {gain:.1f} nats before its price"
    return replace(effect_entry(a, facts, price=paid), remark=remark)


def _with_size(entry: Entry, with_it: Cast, without_it: Cast) -> Entry:
    """Add the error of a simulation without the effect."""
    size = scan_change(with_it, without_it)
    sentence = size.sentence() if size.to_dict() else ""
    return replace(entry, size=size.to_dict(), consequence=sentence)


def family_entries(fit: GoodnessOfFit, sigma: float) -> tuple[Entry, ...]:
    """Return the entry of each tested family at its most likely place.

    Parameters
    ----------
    sigma : [m] Standard deviation of a reading.
    """
    best: dict[str, Doubt] = {}
    for doubt in sorted(fit.tested, key=lambda d: (not d.is_sure, -d.misfit)):
        best.setdefault(doubt.family, doubt)
    names = [name for name in titles() if name in best or (fit.told is not None and fit.told.family == name)]
    return tuple(_family_entry(name, best.get(name), fit, sigma) for name in names)


def _family_entry(name: str, doubt: Doubt | None, fit: GoodnessOfFit, sigma: float) -> Entry:
    is_told = fit.told is not None and fit.told.family == name
    told = fit.told if is_told or doubt is None else doubt
    assert told is not None  # one of the two, by the choice of names
    is_sure = doubt is None or doubt.is_sure
    size = ScanError() if told.size is None or told.misfit <= 0 else told.size
    price = 0.0 if doubt is None else doubt.price
    evidence, least = told.misfit - price, fit.least - price
    is_material = is_told or told.size is None or told.size.is_material(sigma)
    is_accepted = is_told or (is_sure and told.misfit > fit.least)
    facts = Facts(
        has_name=False,
        accepted=is_accepted,
        evidence=evidence,
        threshold=max(least, SCAN.selection.threshold) if price else least,
        is_significant=is_told or is_sure,
        is_material=is_material,
        objection=USUAL if is_accepted and is_material and fit.told is None else None,
    )
    return Entry(
        name=name,
        channel="scan",
        title=titles()[name],
        facts=facts,
        estimate=minus(told.statement),
        price=price or None,
        size=size.to_dict(),
        consequence=size.sentence() if size.to_dict() else "",
        remark="" if is_told or doubt is None or doubt.is_sure else _unlike(doubt, evidence),
    )


def _unlike(doubt: Doubt, evidence: float) -> str:
    """Return why a difference may be due to chance; empty if its evidence [nats] states it."""
    if not doubt.price:
        return f"its test statistic is {doubt.statistic:.3g}, and {doubt.threshold:.3g} is required"
    if evidence < SCAN.selection.threshold:
        return ""
    if doubt.statistic < doubt.threshold:
        return (
            f"the parts of the run disagree about it: it is {doubt.statistic:.1f} standard errors of their scatter large, and "
            f"{doubt.threshold:.1f} are required"
        )
    return "runs that are simulated without it, or the cells of the map, explain as much"
