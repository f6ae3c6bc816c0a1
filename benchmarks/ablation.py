"""Take each rule, hypothesis and constant out of the verdicts of stored ledgers, and count the answers that change.

    python -m benchmarks.hidden_effects answer --entrant sensorgraph DIR...
    python -m benchmarks.ablation DIR... [--entrant sensorgraph] [--json FILE]

DIR is a folder of `benchmarks.hidden_effects` with cases, truth and answers. A verdict is a function of the facts in its
ledger, so nothing is diagnosed again. What a change would do to the search is not part of it: an effect that was not fitted
stays so, and the evidence beside other effects stays as it was.

`right` is the change of the share of right answers, with the 95 % interval of a paired comparison (exact, of the cases that
changed). An answer is right if it names exactly the hidden effects, of which immaterial ones may be left out, and does not say
unknown; for an effect outside the library, if it says unknown and names nothing.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from benchmarks.arguments import existing, parser_of
from benchmarks.hidden_effects.results import Case, load
from sensorgraph.diagnosis.engine.ledger import Entry, Ledger
from sensorgraph.diagnosis.engine.verdict import DecidedBy, Facts, Verdict
from sensorgraph.diagnosis.scan.consequence import material_probability
from sensorgraph.effects import EFFECTS

DUE_TO_UNKNOWN = ("absorbed_by_unknown", "part_of_unknown")
"""Rules that take a name because of a difference that no effect explains."""
FACTORS = (0.5, 2.0)
Change = Callable[[Ledger], Ledger]


@dataclass(frozen=True)
class Answer:
    """What a ledger says about a run."""

    names: tuple[str, ...]
    is_unknown: bool

    def kind(self, case: Case) -> str:
        """Return what the answer is beside the truth: right, wrong, unknown, undecided or silent."""
        is_foreign = case.suite == "foreign"
        if is_foreign and self.is_unknown and not self.names:
            return "right"
        needed = {one["name"] for one in case.hidden if one.get("material", True)}
        if not is_foreign and needed <= set(self.names) <= set(case.names) and not self.is_unknown:
            return "right"
        if set(self.names) - set(case.names):
            return "wrong"
        if self.is_unknown:
            return "unknown"
        return "incomplete" if self.names else "silent"


@dataclass(frozen=True)
class Comparison:
    """Answers with and without a rule, hypothesis or limit."""

    what: str
    changed: int
    """Answers of another kind than before."""
    lost: int
    """Right answers that no longer are."""
    gained: int
    wrong: int
    """Wrong names that are new, minus those that went."""
    difference: float
    """Change of the share of right answers."""
    interval: tuple[float, float]
    """95 % of it."""

    def row(self) -> str:
        """Return the line of the table."""
        low, high = self.interval
        return (
            f"{self.what:48s} {self.changed:7d} {self.lost:5d} {self.gained:6d} {self.wrong:+6d} "
            f"{100 * self.difference:+7.1f} %  {100 * low:+.1f} to {100 * high:+.1f}"
        )


def answer(ledger: Iterable[Entry]) -> Answer:
    """Return what the verdicts of a ledger say."""
    entries = list(ledger)
    named = [e for e in entries if e.verdict is Verdict.NAMED]
    named.sort(key=lambda e: -(e.facts.evidence or 0.0))
    return Answer(tuple(e.name for e in named), any(e.verdict is Verdict.UNKNOWN for e in entries))


def with_facts(change: Callable[[Facts], Facts], ledger: Ledger) -> Ledger:
    """Return a ledger with changed facts."""
    return Ledger(entries=tuple(replace(e, facts=change(e.facts)) for e in ledger))


def without_rules(rules: Sequence[str], facts: Facts) -> Facts:
    """Return facts without the objections of some rules."""
    is_gone = facts.objection is not None and facts.objection.rule in rules
    return replace(facts, objection=None) if is_gone else facts


def without_hypothesis(name: str, ledger: Ledger) -> Ledger:
    """Return a ledger that has never considered a hypothesis: it has no verdict, and is nobody's rival."""
    gone = [e for e in ledger if e.name == name]
    titles = {e.title for e in gone} | ({EFFECTS[name].title} if name in EFFECTS else set())
    freed = {e.channel for e in gone if e.verdict is Verdict.UNKNOWN}
    out = []
    for entry in ledger:
        if entry.name == name:
            continue
        facts = entry.facts
        if entry.rival is not None and entry.rival.title in titles:
            facts = replace(facts, lead=None)
        if entry.channel in freed:
            facts = without_rules(DUE_TO_UNKNOWN, facts)
            if entry.decided_by is DecidedBy.BEATEN and not facts.has_name:
                facts = replace(facts, accepted=True)
        out.append(replace(entry, facts=facts))
    return Ledger(entries=tuple(out))


def scaled(key: str, factor: float, facts: Facts) -> Facts:
    """Return facts with a limit multiplied: `threshold`, `lead`, or `doubt`, the admitted chance of an immaterial size."""
    if key == "lead":
        return replace(facts, required_lead=factor * facts.required_lead)
    if key == "doubt":
        doubt = min(factor * (1.0 - facts.required_probability), 1.0)
        return replace(facts, required_probability=1.0 - doubt)
    return weighed(facts, facts.evidence, factor * facts.threshold)


def weighed(facts: Facts, evidence: float | None, least: float) -> Facts:
    """Return facts with another evidence, or another evidence that is required [nats]."""
    is_weak = not facts.accepted and facts.is_significant and (facts.evidence or 0.0) < facts.threshold
    enough = evidence is None or evidence >= least
    accepted = enough if facts.accepted or (is_weak and evidence is not None) else False
    return replace(facts, evidence=evidence, threshold=least, accepted=accepted)


def priced(factor: float, ledger: Ledger) -> Ledger:
    """Return a ledger with the complexity penalties multiplied; those in the evidence of rivals stay."""
    out = []
    for entry in ledger:
        facts = entry.facts
        if entry.price is not None and facts.evidence is not None:
            facts = weighed(facts, facts.evidence + (1.0 - factor) * entry.price, facts.threshold)
        out.append(replace(entry, facts=facts))
    return Ledger(entries=tuple(out))


def of_size(factor: float, ledger: Ledger) -> Ledger:
    """Return a ledger with the materiality of the effects of the scans multiplied, where tolerances did not raise it."""
    out = []
    for entry in ledger:
        facts, effect = entry.facts, EFFECTS.get(entry.name)
        if effect is not None and entry.channel == "scan" and facts.material_probability is not None:
            usual, then = (
                material_probability(effect(**entry.parameters), entry.stderr, one) for one in (1.0, factor)
            )
            if math.isclose(usual, facts.material_probability, abs_tol=1e-6):
                facts = replace(facts, material_probability=then)
        out.append(replace(entry, facts=facts))
    return Ledger(entries=tuple(out))


def changes(ledgers: Iterable[Ledger]) -> Iterator[tuple[str, Change]]:
    """Yield each change with its description: rules that occur in the ledgers, hypotheses, constants."""
    entries = [e for ledger in ledgers for e in ledger]
    for rule in sorted({e.facts.objection.rule for e in entries if e.facts.objection is not None}):
        yield f"rule {rule} out", partial(with_facts, partial(without_rules, [rule]))
    for name in sorted({e.name for e in entries if e.facts.accepted}):
        yield f"hypothesis {name} out", partial(without_hypothesis, name)
    yield (
        "rule surely_material out",
        partial(with_facts, lambda f: replace(f, material_probability=None, is_material=True)),
    )
    for key, words in (
        ("threshold", "evidence required"),
        ("lead", "lead over the rival required"),
        ("doubt", "chance of an immaterial size admitted"),
    ):
        for factor in FACTORS:
            yield f"{words} x {factor:g}", partial(with_facts, partial(scaled, key, factor))
    for factor in FACTORS:
        yield f"complexity penalty x {factor:g}", partial(priced, factor)
        yield f"materiality x {factor:g}", partial(of_size, factor)


def compared(
    what: str, cases: Sequence[Case], before: Sequence[Answer], after: Sequence[Answer]
) -> Comparison:
    """Compare the answers before and after a change."""
    kinds = [(a.kind(c), b.kind(c)) for c, a, b in zip(cases, before, after, strict=True)]
    lost = sum(a == "right" != b for a, b in kinds)
    gained = sum(b == "right" != a for a, b in kinds)
    wrong = Counter(b for _, b in kinds)["wrong"] - Counter(a for a, _ in kinds)["wrong"]
    low, high = paired_interval(lost, gained, len(cases))
    changed = sum(a != b for a, b in kinds)
    return Comparison(what, changed, lost, gained, wrong, (gained - lost) / len(cases), (low, high))


def paired_interval(lost: int, gained: int, n: int) -> tuple[float, float]:
    """Return the 95 % interval of (gained - lost) / n: Clopper and Pearson (1934) of the share gained of all that moved.

    Without any that moved, the interval is that of a share of n of which none was seen on either side.
    """
    moved = lost + gained
    if moved == 0:
        most = binomtest(0, n).proportion_ci().high
        return -most, most
    low, high = binomtest(gained, moved).proportion_ci()
    return (2 * low - 1) * moved / n, (2 * high - 1) * moved / n


def read(folders: Sequence[Path], entrant: str) -> tuple[list[Case], list[Ledger]]:
    """Return the cases that have a ledger, with it."""
    cases = [c for c in load(folders, entrant) if c.report is not None and c.report.get("ledger")]
    return cases, [Ledger.from_list((c.report or {})["ledger"]) for c in cases]


def ablate(cases: Sequence[Case], ledgers: Sequence[Ledger]) -> list[Comparison]:
    """Return what each change does, the most effective first."""
    before = [answer(ledger) for ledger in ledgers]
    found = [
        compared(what, cases, before, [answer(change(ledger)) for ledger in ledgers])
        for what, change in changes(ledgers)
    ]
    return sorted(found, key=lambda e: (-e.changed, e.what))


def disagreements(cases: Sequence[Case], ledgers: Sequence[Ledger]) -> list[str]:
    """Return the labels of cases whose ledger gives other names than the report."""
    return [
        c.label
        for c, ledger in zip(cases, ledgers, strict=True)
        if sorted(answer(ledger).names) != sorted(c.reported_names)
    ]


def report(cases: Sequence[Case], ledgers: Sequence[Ledger], found: Sequence[Comparison]) -> str:
    """Return the tables as text."""
    kinds = Counter(answer(ledger).kind(c) for c, ledger in zip(cases, ledgers, strict=True))
    differ = disagreements(cases, ledgers)
    lines = [
        f"{len(cases)} cases: " + ", ".join(f"{n} {kind}" for kind, n in kinds.most_common()),
        f"ledger and report disagree on the names in {len(differ)} cases" + "".join(f" {x}" for x in differ),
        "",
        f"{'change':48s} changed  lost gained  wrong   right      95 %",
        *(e.row() for e in found if e.changed),
        "",
        "No answer depends on: " + ", ".join(re.sub(" out$", "", e.what) for e in found if not e.changed),
    ]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the ledgers, and print what depends on what."""
    parser = parser_of(__doc__)
    parser.add_argument("folders", nargs="+", type=existing, metavar="DIR")
    parser.add_argument("--entrant", default="sensorgraph")
    parser.add_argument("--json", type=Path, metavar="FILE")
    told = parser.parse_args(arguments)
    cases, ledgers = read(told.folders, told.entrant)
    if not cases:
        parser.error(
            f"no answer of {told.entrant} with a ledger; first: python -m benchmarks.hidden_effects answer"
        )
    found = ablate(cases, ledgers)
    print(report(cases, ledgers, found))
    if told.json is not None:
        rows: list[Mapping[str, Any]] = [asdict(e) for e in found]
        told.json.write_text(json.dumps({"n_cases": len(cases), "changes": rows}, indent=1))


if __name__ == "__main__":
    main()
