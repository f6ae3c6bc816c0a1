"""What was considered, and what decided: the table of the page, and the last line of the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from sensorgraph.diagnosis.engine.ledger import Entry, Ledger
from sensorgraph.diagnosis.engine.verdict import DecidedBy, Verdict
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.ledger import not_observable
from sensorgraph.diagnosis.report.page_shell import without_breaks
from sensorgraph.diagnosis.report.quantities import minus
from sensorgraph.effects import EFFECTS

ORDER = {
    Verdict.NAMED: 0,
    Verdict.UNDECIDED: 1,
    Verdict.UNKNOWN: 2,
    Verdict.SILENT: 3,
}
OPEN = (DecidedBy.OBJECTION, DecidedBy.IMMATERIAL, DecidedBy.BEATEN)
"""Deciding facts of silent hypotheses that are listed in any case."""
N_WEAK = 6
"""Number of other silent hypotheses that are listed first."""
SHORT = "a simulation without it is "


def considered_section(ledger: Ledger) -> str:
    """Return the section: reported hypotheses first, then those with the most evidence; the others are folded."""
    order = sorted(ledger, key=_rank)
    told = [one for one in order if one.verdict is not Verdict.SILENT or one.decided_by in OPEN]
    weak = [one for one in order if one.decided_by is DecidedBy.WEAK]
    hidden = [one for one in order if one.decided_by is DecidedBy.NOT_OBSERVABLE]
    rest = [one for one in order if one.decided_by is DecidedBy.NOT_TRIED]
    shown = [*told, *(one for one in weak[:N_WEAK] if (one.facts.evidence or 0.0) > 0.0)]
    more = [one for one in weak if one not in shown]
    if not shown:
        return ""
    lead = (
        f"<p>{len(ledger)} hypotheses: the effects of the library, and families of differences without a name. Evidence "
        "is the log Bayes factor in addition to the accepted effects, less the price of the parameters and the place. "
        "<code>sensorgraph why</code> explains each row.</p>"
    )
    return (
        f"<h2>What was considered, and what decided</h2>{lead}{_table(shown)}"
        + _folded(more, "with less evidence")
        + _folded(hidden, "that this run could not have shown")
        + _folded(rest, "that nothing in this run suggests")
    )


def unobservable_line(finding: Finding) -> str:
    """Report the effects that the run could not have shown; empty if the arena does not fit it, or without any."""
    hidden = [one.title for one in not_observable(finding.ledger)]
    skipped = {name for name, result in finding.channels.items() if result.skipped}
    hidden += [effect.title for effect in EFFECTS.values() if effect.channel in skipped]
    if finding.explained is None or not hidden:
        return ""
    are = "is" if len(hidden) == 1 else "are"
    return f"{len(hidden)} of {len(EFFECTS)} effects {are} not observable in this run: {', '.join(hidden)}"


def _rank(entry: Entry) -> tuple[int, bool, float]:
    evidence = entry.facts.evidence
    return (
        ORDER[entry.verdict],
        entry.decided_by not in OPEN,
        -(float("-inf") if evidence is None else evidence),
    )


def _folded(entries: Sequence[Entry], words: str) -> str:
    if not entries:
        return ""
    return f"<details><summary>{len(entries)} {words}</summary>{_table(entries)}</details>"


def _table(entries: Sequence[Entry]) -> str:
    head = (
        "<tr><th>hypothesis</th><th>best place and size</th><th class='n'>evidence</th><th class='n'>price</th>"
        "<th>verdict</th></tr>"
    )
    return f"<table class='ledger'>{head}{''.join(map(_row, entries))}</table>"


def _row(entry: Entry) -> str:
    best = f"{entry.where}: {entry.estimate}" if entry.where and entry.estimate else entry.estimate
    cost = entry.consequence.removeprefix(SHORT)
    said = without_breaks(best) + (f"<br><small>cost: {without_breaks(cost)}</small>" if cost else "")
    verdict = f"<b>{entry.verdict.value}</b>: " if entry.verdict is not Verdict.SILENT else ""
    return (
        f"<tr class='{entry.verdict.value}'><td>{escape(entry.title)}<br><code>{escape(entry.name)}</code></td>"
        f"<td>{said}</td><td class='n'>{_number(entry.facts.evidence)}</td><td class='n'>{_number(entry.price)}</td>"
        f"<td>{verdict}{without_breaks(entry.reason)}</td></tr>"
    )


def _number(value: float | None) -> str:
    return "–" if value is None else minus(f"{value:,.0f}" if abs(value) >= 99.5 else f"{value:.1f}")
