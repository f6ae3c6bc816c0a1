"""What both motion channels report: structure that was tested, for the ledger and as unknown, and unseen effects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.engine.ledger import Competitor, Entry
from sensorgraph.diagnosis.engine.verdict import Facts, Objection
from sensorgraph.diagnosis.motion.families import FAMILIES_OF
from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.motion.structure_test import AcceptedStructure, TestedStructure
from sensorgraph.diagnosis.result import BOTH_SIDES, Deviation, Unknown
from sensorgraph.effects import Effect

NAMELESS = Facts(has_name=False)
ABSORBED = Objection("absorbed_by_unknown", "a difference that no effect explains absorbs it")
"""Why an effect next to structure is not named."""


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


def unknown_structure(channel: str, name: str, structure: AcceptedStructure, n_rows: int) -> Unknown:
    """Describe accepted structure as a difference that no effect explains.

    Parameters
    ----------
    name : Of its family in the ledger.
    n_rows : Number of rows of the channel.
    """
    family, evidence, size = structure.family, structure.evidence, structure.size
    return Unknown(
        statement=f"{BOTH_SIDES[channel]} differ by {family.statement}, which no effect of the library explains; "
        f"{size.sentence()}",
        deviation=Deviation(
            family="bias",
            partition=family.kind,
            label=f"by {family.statement}",
            z=float(np.sqrt(2 * evidence)),
            evidence_nats=evidence,
            size=0.0,
            n_rays=n_rows,
            channel=channel,
        ),
        statistic=evidence,
        size=size.to_dict(),
        consequence=size.sentence(),
        family=name,
        families=(family.statement, *structure.rivals),
        threshold=structure.threshold,
    )


def unseen_effects(variances: Mapping[Effect, float]) -> dict[str, str]:
    """Return the effects that would not show at three times their materiality, with the reason.

    Parameters
    ----------
    variances : Effect -> variance of its size, if it were in the model.
    """
    out = {}
    for effect, variance in variances.items():
        size = EVIDENCE.observable_size * next(iter(effect.sizes.values()))
        expected = 0.5 * size**2 / max(variance, 1e-18)
        if expected - EVIDENCE.price < EVIDENCE.threshold:
            out[effect.name] = (
                f"{effect.diagnostics.why_unseen}: at three times its materiality, the expected log Bayes factor is "
                f"{expected:.0f}"
            )
    return out
