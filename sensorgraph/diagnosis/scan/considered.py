"""Entries of the ledger for the effects of the scans: those of the model, and the best start of each other one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from sensorgraph.diagnosis.engine.ledger import Competitor, Entry
from sensorgraph.diagnosis.engine.verdict import Facts, Objection
from sensorgraph.diagnosis.hypotheses import effect_entry
from sensorgraph.diagnosis.scan.consequence import scan_change
from sensorgraph.diagnosis.scan.fit import Cast, cast, thin
from sensorgraph.diagnosis.scan.materiality import SURELY_MATERIAL
from sensorgraph.diagnosis.scan.model_selection import Explained, Step
from sensorgraph.diagnosis.scan.observability import separation
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.worth import price
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import without

N_SCANS = 40
"""Number of scans that are cast for the consequence of an effect."""


def effect_entries(
    data: ScanData,
    explained: Explained,
    complete: Sequence[Amendment],
    small: Mapping[int, Objection],
    chances: Sequence[float],
    threshold: float,
) -> tuple[Entry, ...]:
    """Return the entries of all effects that the search fitted, or whose gain it predicted.

    Parameters
    ----------
    complete : Effects of the model with their evidence, in the order of the model.
    small : Index in the model -> why the effect is within tolerance.
    chances : Probability that each effect is material.
    threshold : [nats] Evidence that a name requires.
    """
    few = thin(data, max(1, data.n_scans // N_SCANS))
    model = explained.final.model
    whole = cast(few, model)
    out = []
    for index, a in enumerate(complete):
        why = small.get(index)
        is_size = why is not None and why.rule == SURELY_MATERIAL
        facts = Facts(
            has_name=True,
            accepted=True,
            evidence=a.evidence,
            threshold=threshold,
            material_probability=chances[index],
            required_probability=SCAN.naming.min_material_probability,
            objection=None if is_size else why,
        )
        entry = effect_entry(a, facts, price=price(a, data))
        entry = replace(
            entry, alone=_alone(explained.steps, a), remark=why.words if why is not None and is_size else ""
        )
        out.append(_with_size(entry, whole, cast(few, without(model, index))))
    names = {a.name for a in model}
    for name, (a, gain, round_) in _best_fits(explained.steps).items():
        if name in names:
            continue
        facts = Facts(has_name=True, evidence=gain, threshold=threshold)
        entry = replace(effect_entry(a, facts, price=price(a, data)), alone=_alone(explained.steps, a))
        entry = _with_winner(entry, a, explained.steps[round_])
        out.append(_with_size(entry, cast(few, (*model, a)), whole))
        names.add(name)
    for name, candidate in explained.expected.items():
        if name not in names:
            out.append(_expected(candidate.amendment, candidate.gain, data, threshold))
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


def _with_winner(entry: Entry, a: Amendment, step: Step) -> Entry:
    """Add the effect that a round of the search chose instead, or why it chose none."""
    if not step.chosen:
        return replace(entry, remark="the accepted effects are approximate, and may leave as much")
    if step.chosen == entry.name:
        return replace(entry, remark="effects that were found later explain the same data")
    won, gain = max((one for one in step.tried if one[0].name == step.chosen), key=lambda one: one[1])
    return replace(
        entry, rival=Competitor(title=won.effect.title, evidence=gain, separates=separation(a, won))
    )


def _expected(a: Amendment, gain: float, data: ScanData, threshold: float) -> Entry:
    """Return the entry of an effect whose expected gain [nats] was too small for a fit."""
    paid = price(a, data)
    facts = Facts(has_name=True, evidence=gain - paid, threshold=threshold, is_significant=False)
    remark = f"it was not fitted, because a fit was expected to gain only {gain:.1f} nats before its price"
    return replace(effect_entry(a, facts, price=paid), remark=remark)


def _with_size(entry: Entry, with_it: Cast, without_it: Cast) -> Entry:
    """Add the error of a simulation without the effect."""
    size = scan_change(with_it, without_it)
    sentence = size.sentence() if size.to_dict() else ""
    return replace(entry, size=size.to_dict(), consequence=sentence)
