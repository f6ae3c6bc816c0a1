"""Entries of the ledger for structure that was tested in the odometry or the drive channel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from sensorgraph.diagnosis.engine.ledger import Competitor, Entry
from sensorgraph.diagnosis.engine.verdict import Facts
from sensorgraph.diagnosis.motion.families import FAMILIES_OF
from sensorgraph.diagnosis.motion.structure_test import AcceptedStructure, TestedStructure

NAMELESS = Facts(has_name=False)


def structure_entries(channel: str, tests: Sequence[TestedStructure]) -> Iterator[Entry]:
    """Yield each tested family of a channel at its most likely."""
    for tested in tests:
        own = [] if tested.best is None else [tested.best.family.kind]
        for kind in dict.fromkeys([*own, *tested.families]):
            name, title = FAMILIES_OF[channel][tested.prefix + kind]
            yield _tested(Entry(name=name, channel=channel, title=title, facts=NAMELESS), tested, kind)


def _tested(entry: Entry, tested: TestedStructure, kind: str) -> Entry:
    """Return the entry of a family with the numbers of its test."""
    best = tested.best
    screened = tested.families.get(kind)
    price = None if screened is None else screened.price
    if best is not None and best.family.kind == kind:
        facts = Facts(
            has_name=False,
            accepted=True,
            evidence=best.evidence,
            threshold=tested.threshold,
            is_material=tested.is_material,
            objection=tested.objection,
        )
        size, words = best.size.to_dict(), best.size.sentence()
        return replace(
            entry, facts=facts, price=price, estimate=best.family.statement, size=size, consequence=words
        )
    assert screened is not None
    facts = Facts(has_name=False, evidence=screened.evidence, threshold=tested.threshold)
    rival = None if best is None else Competitor(title=best.family.statement, evidence=best.evidence)
    return replace(entry, facts=facts, price=price, estimate=screened.family.statement, rival=rival)


def name_of(channel: str, tests: Sequence[TestedStructure], structure: AcceptedStructure) -> str:
    """Return the name of accepted structure in the ledger."""
    prefix = next((one.prefix for one in tests if one.best is structure), "")
    return FAMILIES_OF[channel][prefix + structure.family.kind][0]
