"""Verdict on a hypothesis, as a function of facts that the ledger keeps.

    named      accepted, has a name,  P(size is material) >= required,  no objection,  |E - E_rival| >= required lead
    undecided  as named, but  |E - E_rival| < required lead
    unknown    accepted, has no name, is material, and no objection
    silent     otherwise

E is the evidence [nats]. A hypothesis is accepted if the search added it to the model, which requires E >= threshold
in addition to the others. An objection is a rule that takes a name away; it has a name itself, so that
`benchmarks.ablation` can count the answers that depend on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

SURELY = 0.975
"""Probability that a size exceeds a bound by about two standard errors."""
OBSERVABLE_SIZE = 3.0
"""Size of an effect that a run should show, in materialities."""


class Verdict(StrEnum):
    """Answer about one hypothesis."""

    NAMED = "named"
    UNDECIDED = "undecided"
    """Another hypothesis explains the data almost as well."""
    UNKNOWN = "unknown"
    """A difference that no effect of the library explains."""
    SILENT = "silent"
    """Not reported as a cause."""


class DecidedBy(StrEnum):
    """Fact that decided a verdict."""

    EVIDENCE = "sufficient evidence"
    CLOSE_RIVAL = "close rival"
    NOT_OBSERVABLE = "not observable"
    NOT_TRIED = "not tried"
    WEAK = "insufficient evidence"
    BEATEN = "explained by another hypothesis"
    OBJECTION = "objection"
    IMMATERIAL = "immaterial"


@dataclass(frozen=True)
class Objection:
    """Why an accepted hypothesis is not reported."""

    rule: str
    """Name of the rule, the same in all runs."""
    words: str
    """Reason in this run, as a clause."""


@dataclass(frozen=True, kw_only=True)
class Facts:
    """What the verdict on a hypothesis depends on."""

    has_name: bool
    """Whether it is an effect of the library; a nameless one can only be unknown or silent."""
    accepted: bool = False
    """Whether the search added it to the model."""
    evidence: float | None = None
    """[nats] Log Bayes factor in addition to the accepted effects, less its price; None if it was not fitted."""
    threshold: float = 0.0
    """[nats] Evidence that it needs."""
    is_significant: bool = True
    """Whether a second test supports it: simulated replicates, or the scatter between parts of the run."""
    is_material: bool = True
    """Whether its size matters to a user."""
    material_probability: float | None = None
    """Probability that its size matters; None if `is_material` states it."""
    required_probability: float = 0.0
    """Minimum of this probability."""
    objection: Objection | None = None
    """Rule that takes its name away."""
    lead: float | None = None
    """[nats] Distance of the evidence from that of its rival; None without a rival that could replace it."""
    required_lead: float = 0.0
    """[nats] Minimum distance from the rival."""
    not_observable: str = ""
    """Reason why this run could not have shown it; empty if it could."""
    not_tried: str = ""
    """Reason why it was not fitted; empty if it was."""


def judge(facts: Facts) -> tuple[Verdict, DecidedBy]:
    """Return the verdict on a hypothesis, and the fact that decided it."""
    if not facts.accepted:
        return Verdict.SILENT, _why_not_accepted(facts)
    if facts.objection is not None:
        return Verdict.SILENT, DecidedBy.OBJECTION
    chance = facts.material_probability
    if not facts.is_material or (chance is not None and chance < facts.required_probability):
        return Verdict.SILENT, DecidedBy.IMMATERIAL
    if not facts.has_name:
        return Verdict.UNKNOWN, DecidedBy.EVIDENCE
    if facts.lead is not None and facts.lead < facts.required_lead:
        return Verdict.UNDECIDED, DecidedBy.CLOSE_RIVAL
    return Verdict.NAMED, DecidedBy.EVIDENCE


def _why_not_accepted(facts: Facts) -> DecidedBy:
    if facts.evidence is not None and facts.evidence >= facts.threshold and facts.is_significant:
        return DecidedBy.BEATEN
    if facts.not_observable:
        return DecidedBy.NOT_OBSERVABLE
    return DecidedBy.NOT_TRIED if facts.evidence is None else DecidedBy.WEAK
