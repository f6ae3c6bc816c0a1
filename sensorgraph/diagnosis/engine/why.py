"""Explain an entry of the ledger in one paragraph."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

from sensorgraph.diagnosis.engine.ledger import Entry, Ledger, as_name, nats
from sensorgraph.diagnosis.engine.verdict import DecidedBy, Verdict
from sensorgraph.errors import SensorgraphError

MAX_FACTOR = 100.0
"""Factor of readings above which more of the same run is no advice."""


def why(ledger: Ledger, name: str) -> str:
    """Return the explanations of all entries with a name, one paragraph each.

    Raises
    ------
    SensorgraphError
        No entry has this name; the message lists the known names.
    """
    check_known(name, ledger.names)
    found = ledger.of(name)
    return "\n\n".join(paragraph(entry) for entry in found)


class UnknownHypothesisError(SensorgraphError):
    """A hypothesis with this name is not known; the message lists all names."""

    max_text = 4000


def check_known(name: str, known: Sequence[str]) -> None:
    """Refuse an unknown name.

    Raises
    ------
    UnknownHypothesisError
        The message has the nearest names, and all.
    """
    if as_name(name) in known:
        return
    near = difflib.get_close_matches(as_name(name), known, n=3, cutoff=0.5)
    hint = f"did you mean {' or '.join(near)}? " if near else ""
    raise UnknownHypothesisError(
        f"{name!r} is no effect or family; {hint}expected one of: {', '.join(known)}"
    )


def paragraph(entry: Entry) -> str:
    """Return why an entry was or was not reported: best size, evidence, what beat it, and what would decide."""
    parts = [_answer(entry), _best(entry), _evidence(entry), _material(entry), _rival(entry), _next(entry)]
    return " ".join(part for part in parts if part)


def _answer(entry: Entry) -> str:
    """Return the verdict with its reason."""
    title = entry.title[:1].upper() + entry.title[1:]
    said = {
        Verdict.NAMED: "was named",
        Verdict.UNDECIDED: "was not named, but is undecided",
        Verdict.UNKNOWN: "was reported as unknown",
        Verdict.SILENT: "was not named" if entry.facts.has_name else "was not reported",
    }[entry.verdict]
    return f"{title} ({entry.name}) {said}: {entry.reason}."


def _best(entry: Entry) -> str:
    """Return the best place and size, and what they cost a simulation."""
    if not entry.estimate:
        return "Its size was not estimated."
    cost = f"; {entry.consequence}" if entry.consequence else ""
    if not entry.where:
        return f"Best size: {entry.estimate}{cost}."
    return f"Best place and size: {entry.where}, {entry.estimate}{cost}."


def _evidence(entry: Entry) -> str:
    """Return the evidence with its threshold, unless the reason states them, and its price."""
    facts = entry.facts
    if facts.evidence is None:
        return "There is no evidence about it."
    paid = "" if entry.price is None else f"a price of {nats(entry.price)} for its parameters and its place"
    if f"its evidence is {nats(facts.evidence)}" in entry.reason:
        text = f"This evidence is after {paid}." if paid else ""
    else:
        needed = f"; {nats(facts.threshold)} are needed" if facts.threshold > 0 else ""
        text = f"Its evidence is {nats(facts.evidence)}{', after ' if paid else ''}{paid}{needed}."
    if entry.alone is not None and abs(entry.alone - facts.evidence) >= 1.0:
        text += f" Before any effect was accepted, it had {nats(entry.alone)}."
    return text


def _material(entry: Entry) -> str:
    """Return the evidence that an effect without evidence would have at the smallest size that matters."""
    if entry.at_materiality is None or entry.decided_by not in (DecidedBy.WEAK, DecidedBy.NOT_OBSERVABLE):
        return ""
    text = f"At {entry.materiality}, the smallest size that matters, this run would give it {nats(entry.at_materiality)}"
    return f"{text}; such a size is ruled out." if entry.is_ruled_out else f"{text}."


def _rival(entry: Entry) -> str:
    """Return the strongest other explanation."""
    if entry.rival is None or entry.decided_by is DecidedBy.BEATEN:
        return ""
    return f"The strongest rival is {entry.rival.title} with {nats(entry.rival.evidence)}."


def _next(entry: Entry) -> str:
    """Return what the next run would have to show; of a named effect, what would confirm it against its rival."""
    if entry.is_ruled_out:
        return ""
    separates = "" if entry.rival is None else entry.rival.separates
    more = "" if entry.verdict is Verdict.NAMED else _more_readings(entry)
    if separates:
        return f"The next run can tell the two apart: {separates}.{more}"
    if entry.verdict is Verdict.NAMED or not entry.needs:
        return more.strip()
    return f"The next run would have to show: {entry.needs}.{more}"


def _more_readings(entry: Entry) -> str:
    """Return how many times as many readings would suffice; evidence before the price grows in proportion."""
    facts, price = entry.facts, entry.price
    if (
        entry.decided_by is not DecidedBy.WEAK
        or facts.evidence is None
        or price is None
        or facts.evidence + price <= 0
    ):
        return ""
    factor = (facts.threshold + price) / (facts.evidence + price)
    if not 1.0 < factor <= MAX_FACTOR:
        return ""
    return f" If the size is right, {factor:.1f} times as many such readings would suffice."
