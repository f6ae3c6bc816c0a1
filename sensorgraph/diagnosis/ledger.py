"""Ledger of a finding: the hypotheses of all channels, with the verdicts that the channels reached."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Set
from dataclasses import replace

from sensorgraph.diagnosis.engine.ledger import Competitor, Entry, Ledger
from sensorgraph.diagnosis.engine.verdict import DecidedBy, Facts, Verdict, judge
from sensorgraph.diagnosis.engine.why import check_known
from sensorgraph.diagnosis.motion.consequence import SimulationError
from sensorgraph.diagnosis.motion.selection import FAMILIES_OF
from sensorgraph.diagnosis.report.quantities import quantity, symbol, title_of
from sensorgraph.diagnosis.result import ChannelResult
from sensorgraph.diagnosis.scan.unnamed import titles
from sensorgraph.effects import EFFECTS, Amendment, Effect

UNLISTED = "unexplained"
"""Name of a difference that belongs to no family, as two logs that do not belong together."""


def families_of(channel: str) -> Mapping[str, str]:
    """Return the differences without a name that a channel tests, each with a noun phrase."""
    return titles() if channel == "scan" else dict(FAMILIES_OF[channel].values())


def check_name(name: str) -> None:
    """Refuse a name that is neither of an effect nor of a family.

    Raises
    ------
    UnknownHypothesisError
        The message has the nearest names, and all.
    """
    families = (name for channel in ("scan", *FAMILIES_OF) for name in families_of(channel))
    check_known(name, [*EFFECTS, *families, UNLISTED])


def ledger_of(channels: Mapping[str, ChannelResult]) -> Ledger:
    """Return the ledger of the channels of a finding, each with all effects of the library that it knows.

    An effect that another channel considered in place of its own is listed once, as in the calibration from driving alone.
    """
    tried = {channel: {one.name for one in result.considered} for channel, result in channels.items()}
    entries = list[Entry]()
    for channel, result in channels.items():
        elsewhere = set[str]().union(*(names for other, names in tried.items() if other != channel))
        entries += _entries(result, elsewhere - tried[channel])
    return Ledger(entries=tuple(entries))


def _entries(result: ChannelResult, elsewhere: Set[str]) -> Iterator[Entry]:
    """Yield the effects of a channel that were accepted, then the others, then families without a name.

    Parameters
    ----------
    elsewhere : Effects that only other channels considered.
    """
    taken = set(elsewhere)
    for entry in _accepted(result):
        taken.add(entry.name)
        yield entry
    others = {one.name: one for one in result.considered if one.facts.has_name and not one.facts.accepted}
    for name, effect in EFFECTS.items():
        if name in taken or (effect.channel != result.channel and name not in others):
            continue
        yield _not_accepted(result, effect, others.get(name))
    tested = {one.name: one for one in result.considered if not one.facts.has_name}
    if result.unknown is not None and result.unknown.family not in tested:
        yield _unlisted(result)
    for name, title in families_of(result.channel).items():
        yield _judged(result, tested[name]) if name in tested else _untested(result, name, title)


def _accepted(result: ChannelResult) -> Iterator[Entry]:
    """Yield the effects whose evidence is sufficient, with the facts that decided about their names."""
    known = {_key(one): one for one in result.considered if one.facts.accepted}
    withdrawn = [(one.amendment, one.objection) for one in result.withdrawn]
    listed = [(a, None) for a in (*result.effects, *result.undecided, *result.within_tolerance)]
    for a, objection in (*listed, *withdrawn):
        plain = effect_entry(a, Facts(has_name=True, accepted=True, evidence=a.evidence))
        entry = known.get(_key(plain), plain)
        facts = replace(entry.facts, objection=objection or entry.facts.objection)
        if facts.material_probability is None and facts.objection is None:
            facts = replace(facts, is_material=all(a is not one for one in result.within_tolerance))
        rival = next((one for one in result.rivals if one.instead_of == a.name), None)
        if rival is not None:
            is_open = any(a is one for one in result.undecided)
            lead = abs((a.evidence or 0.0) - rival.evidence_nats)
            facts = replace(facts, lead=lead, required_lead=rival.required_nats if is_open else 0.0)
            entry = replace(
                entry,
                rival=Competitor(
                    title=title_of(rival.name), evidence=float(rival.evidence_nats), separates=rival.separates
                ),
            )
        if judge(facts)[1] is DecidedBy.IMMATERIAL and a.effect.sizes:
            entry = replace(entry, needs=f"a size of at least {least_size(a.effect)}")
        yield replace(entry, facts=facts)


def _key(entry: Entry) -> tuple[str, str, float | None]:
    return entry.name, entry.place, entry.facts.evidence


def _not_accepted(result: ChannelResult, effect: Effect, entry: Entry | None) -> Entry:
    """Return the entry of an effect that is not in the model, with the reason if this run could not show it."""
    why = result.not_observable.get(effect.name, "")
    is_local = effect.place in ("wall", "obstacle") and ":" in why  # only at the places that it lists
    everywhere = "" if is_local else why
    if entry is None:
        idle = _why_idle(result, "its search found no start in the residuals")
        facts = Facts(has_name=True, not_tried=idle, not_observable=everywhere)
        return Entry(
            name=effect.name,
            channel=result.channel,
            title=effect.title,
            facts=facts,
            needs=needs_of(effect),
        )
    entry = replace(entry, facts=replace(entry.facts, not_observable=everywhere))
    expected = result.at_materiality.get(effect.name)
    if expected is None:
        return entry
    return replace(
        entry,
        materiality=least_size(effect),
        at_materiality=expected,
        is_ruled_out=_is_surely_immaterial(entry, effect, expected),
    )


def _is_surely_immaterial(entry: Entry, effect: Effect, expected: float) -> bool:
    """Return whether a size is below its materiality by two standard errors, with sufficient evidence for a material size.

    Parameters
    ----------
    expected : [nats] Evidence at its materiality, after its price. It gives the standard error of a size without one.
    """
    least = entry.facts.threshold
    if expected < least:
        return False
    share = 1 / math.sqrt(2 * (expected + (entry.price or 0.0)))  # standard error in materialities
    return all(
        abs(entry.parameters.get(name, 0.0)) + 2 * max(entry.stderr.get(name, 0.0), share * limit) < limit
        for name, limit in effect.sizes.items()
    )


def _why_idle(result: ChannelResult, usual: str) -> str:
    """Return why a hypothesis was not tried: the usual reason, unless the channel tried none."""
    if "calibration" in result.notes:
        return "the calibration from driving alone shows no material size"
    if result.unknown is None or result.considered:
        return result.skipped or usual
    return (
        result.skipped or result.unknown.statement
    )  # an arena of another place, odometry that counts backwards


def _unlisted(result: ChannelResult) -> Entry:
    """Return the entry of an unexplained difference that belongs to no family."""
    assert result.unknown is not None
    unknown = result.unknown
    facts = Facts(
        has_name=False, accepted=True, evidence=unknown.statistic or None, threshold=unknown.threshold
    )
    return Entry(
        name=unknown.family or UNLISTED,
        channel=result.channel,
        title="a difference that no effect explains",
        facts=facts,
        estimate=unknown.statement,
        size=dict(unknown.size),
        consequence=unknown.consequence,
        remark="no effect of the library explains it",
    )


def _untested(result: ChannelResult, name: str, title: str) -> Entry:
    """Return the entry of a family that was not tested."""
    facts = Facts(has_name=False, not_tried=_why_idle(result, "nothing in this run suggests it"))
    return Entry(name=name, channel=result.channel, title=title, facts=facts)


def _judged(result: ChannelResult, family: Entry) -> Entry:
    """Return a family, beaten by the reported difference if this is another one."""
    unknown = result.unknown
    if unknown is not None and unknown.family == family.name:
        causes = "; or ".join(unknown.families)
        return replace(family, needs=f"which of these is the cause: {causes}" if causes else "")
    if family.verdict is not Verdict.UNKNOWN:
        return family
    cause = "" if unknown is None else families_of(result.channel).get(unknown.family, unknown.statement)
    remark = f"{cause}, which is reported, may cause it" if cause else family.remark
    return replace(family, facts=replace(family.facts, accepted=False), remark=remark)


def not_observable(ledger: Ledger) -> list[Entry]:
    """Return the effects that this run could not have shown anywhere."""
    return [one for one in ledger if one.facts.has_name and one.decided_by is DecidedBy.NOT_OBSERVABLE]


def effect_entry(a: Amendment, facts: Facts, *, price: float | None = None) -> Entry:
    """Return the entry of an effect with fitted or expected parameters.

    Parameters
    ----------
    price : [nats] Complexity penalty.
    """
    place, xy = ("", None) if a.location is None else (a.location.name, a.location.xy)
    return Entry(
        name=a.name,
        channel=a.effect.channel,
        title=a.effect.title,
        facts=facts,
        place=place,
        xy=None if xy is None else (float(xy[0]), float(xy[1])),
        parameters={k: float(v) for k, v in a.parameters.items()},
        stderr={k: float(v) for k, v in a.stderr.items() if math.isfinite(v)},
        estimate=", ".join(f"{symbol(name)} = {quantity(a, name)}" for name in a.parameters),
        price=price,
        needs=needs_of(a.effect),
    )


def accepted_entry(a: Amendment, threshold: float, price: float, size: SimulationError) -> Entry:
    """Return the entry of an effect of a motion channel that is in the model.

    Parameters
    ----------
    threshold, price : [nats] Evidence that it needs, and its complexity penalty.
    size : Error of a simulation without it.
    """
    facts = Facts(has_name=True, accepted=True, evidence=a.evidence, threshold=threshold)
    return replace(
        effect_entry(a, facts, price=price),
        size=size.to_dict(),
        consequence=size.sentence(),
        remark=f"its size is not surely material (at least {least_size(a.effect)})",
    )


def least_size(effect: Effect) -> str:
    """Return the materiality of an effect in words; empty if it has no size."""
    limits = effect(**effect.sizes)
    words = ", ".join(quantity(limits, name).lstrip("+") for name in limits.parameters)
    return re.sub(r"(\.\d*?)0+(?!\d)", lambda m: m[1].rstrip("."), words)  # 0.50 cm is 0.5 cm


def needs_of(effect: Effect) -> str:
    """Return what a run must show to decide about an effect."""
    return f"residuals that vary with {effect.varies}"
