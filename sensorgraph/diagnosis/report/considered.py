"""What was considered, and what decided: the table of the page, the last line of the terminal, and effects that wide tolerances hide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from html import escape

import numpy as np

from sensorgraph.diagnosis.engine.ledger import Entry, Ledger
from sensorgraph.diagnosis.engine.verdict import DecidedBy, Verdict
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.ledger import not_observable
from sensorgraph.diagnosis.report.quantities import minus
from sensorgraph.diagnosis.scan.nuisance import corners_of, prior_widths
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import EFFECTS, Amendment, Effect
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.show.page_shell import without_breaks
from sensorgraph.world.robot import Tolerances

OPEN = (DecidedBy.OBJECTION, DecidedBy.IMMATERIAL, DecidedBy.BEATEN)
"""Deciding facts of silent hypotheses that are listed in any case."""
N_WEAK = 6
"""Number of other silent hypotheses that are listed first."""
SHORT = "a simulation without it is "
WIDE = 2.0
"""Largest hidden size of an effect, in units of its materiality, above which a tolerance is called wide. The defaults of
robot.yaml stay below 1.2."""


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
        "Evidence of a beaten hypothesis is that of its last fit. <code>sensorgraph why</code> explains each row.</p>"
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
        list(Verdict).index(entry.verdict),
        entry.decided_by not in OPEN,
        -(float("-inf") if evidence is None else evidence),
    )


def _folded(entries: Sequence[Entry], words: str) -> str:
    if not entries:
        return ""
    return f"<details><summary>{len(entries)} {words}</summary>{_table(entries)}</details>"


def _table(entries: Sequence[Entry]) -> str:
    head = (
        "<tr><th>hypothesis</th><th>best place and size</th><th class='n'>evidence [nats]</th><th class='n'>price [nats]</th>"
        "<th>verdict</th></tr>"
    )
    return f"<table class='ledger'>{head}{''.join(map(_row, entries))}</table>"


def _row(entry: Entry) -> str:
    best = f"{entry.where}: {entry.estimate}" if entry.where and entry.estimate else entry.estimate
    cost = entry.consequence.removeprefix(SHORT)
    said = without_breaks(best) + (f"<br><small>cost: {without_breaks(cost)}</small>" if cost else "")
    verdict = f"<b>{entry.verdict.value}</b>: " if entry.verdict is not Verdict.SILENT else ""
    ruled_out = f"; {without_breaks(entry.materiality)} is ruled out" if entry.is_ruled_out else ""
    return (
        f"<tr class='{entry.verdict.value}'><td>{escape(entry.title)}<br><code>{escape(entry.name)}</code></td>"
        f"<td>{said}</td><td class='n'>{_number(entry.facts.evidence)}</td><td class='n'>{_number(entry.price)}</td>"
        f"<td>{verdict}{without_breaks(entry.reason)}{ruled_out}</td></tr>"
    )


def _number(value: float | None) -> str:
    return "–" if value is None else minus(f"{value:,.0f}" if abs(value) >= 99.5 else f"{value:.1f}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Tolerated:
    """An effect that a tolerance hides."""

    tolerance: str
    """Its key in robot.yaml."""
    most: Amendment
    """The largest hidden size."""
    taken: Amendment | None
    """The size absorbed in this run, if it exceeds the materiality."""


def tolerated(finding: Finding) -> list[Tolerated]:
    """List the effects that the tolerances of this run hide."""
    tolerances = finding.data.tolerances
    present = {a.name for a in finding.effects}
    out = []
    for effect in _tolerated_effects():
        most = _largest(effect, tolerances)
        if effect.name in present or most.ratio <= WIDE:
            continue
        taken = _taken(effect, finding)
        is_material = taken is not None and taken.ratio >= 1.0
        out.append(
            Tolerated(tolerance=effect.diagnostics.tolerance, most=most, taken=taken if is_material else None)
        )
    return out


def _tolerated_effects() -> list[Effect]:
    """Return the effects that a tolerance can hide, in the order of the keys in robot.yaml."""
    keys = [f.name for f in fields(Tolerances)]
    own = [effect for effect in EFFECTS.values() if effect.diagnostics.tolerance]
    return sorted(own, key=lambda effect: keys.index(effect.diagnostics.tolerance))


def _largest(effect: Effect, tolerances: Tolerances) -> Amendment:
    """Return the largest size of an effect that its tolerance hides, along its first parameter."""
    first, *others = effect.steps
    if effect.nuisances:
        bound = SCAN.nuisance.max_tolerances * prior_widths(tolerances)[effect.nuisances[0]]
    else:
        bound = SCAN.nuisance.max_tolerances * getattr(tolerances, effect.diagnostics.tolerance)
    return effect(**{first: float(bound)}, **dict.fromkeys(others, 0.0))


def _taken(effect: Effect, finding: Finding) -> Amendment | None:
    """Return the error that a tolerance absorbed in this run, expressed as the effect."""
    if finding.explained is None:
        return None
    g = finding.explained.final.state.g
    corners = corners_of(finding.data).shifts(g[len(Nuisance) :])
    values = g[list(effect.nuisances)] if effect.nuisances else [np.abs(corners).max(initial=0.0)]
    return effect(**dict(zip(effect.steps, map(float, values), strict=True)))
