"""Report of a motion channel: named effects with sizes, rivals, gap, unobservable effects, and entries of the ledger.

The channels of wheels and motors fit their models differently. What they found has one form (`AcceptedEffect`,
`TriedEffect`, `TestedStructure`), from which `channel_result` makes the result.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import ndtr

from sensorgraph.diagnosis.engine.ledger import (
    OBSERVABLE_SIZE,
    SURELY,
    Competitor,
    Entry,
    Facts,
    Objection,
    Verdict,
)
from sensorgraph.diagnosis.ledger import accepted_entry, effect_entry
from sensorgraph.diagnosis.motion.consequence import SimulationError
from sensorgraph.diagnosis.motion.families import FAMILIES_OF
from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.motion.structure_test import AcceptedStructure, TestedStructure
from sensorgraph.diagnosis.motion.whitening import Whitener
from sensorgraph.diagnosis.result import (
    BOTH_SIDES,
    ChannelResult,
    Deviation,
    FitQuality,
    Gap,
    MotionDifference,
    Rival,
    Unknown,
    Withdrawn,
)
from sensorgraph.effects import Amendment, Effect
from sensorgraph.types import Floats

ABSORBED = Objection("absorbed_by_unknown", "a difference that no effect explains absorbs it")
"""Why an effect next to structure is not named."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TriedEffect:
    """An effect that is not in the model, at its most likely size."""

    amendment: Amendment
    """With its evidence [nats] in addition to the model."""
    price: float
    """[nats] complexity penalty."""
    variance: float = 0.0
    """Of its size, if it were in the model; decides whether the run could have shown it."""

    @property
    def entry(self) -> Entry:
        """Its entry of the ledger."""
        a = self.amendment
        facts = Facts(has_name=True, evidence=a.evidence, threshold=EVIDENCE.threshold)
        return effect_entry(a, facts, price=self.price)


@dataclass(frozen=True, kw_only=True, eq=False)
class AcceptedEffect:
    """An effect of the model."""

    sized: Amendment
    """With size, standard error and evidence [nats]."""
    price: float
    """[nats] complexity penalty."""
    alternatives: Mapping[Effect, float]
    """Evidence [nats] of each effect that could replace it."""
    error: SimulationError
    """Of a simulation without it."""
    is_material: bool
    is_absorbed: bool = False
    """Whether structure that no effect explains may be the cause of all of it."""
    due_to_loop: float = 0.0
    """[s] part of its size that the control loop of the base may cause."""
    fit_error: float = 0.0
    """[s] standard error of the size by the fit alone, for that part."""
    late_clock: Rival | None = None
    """Its rival where no alternative would be named instead."""

    @cached_property
    def amendment(self) -> Amendment:
        """The effect with its probability, against its alternatives and no effect, whose evidence is 0.

        p = exp(evidence / temperature) / sum over candidates of exp(evidence_i / temperature)
        """
        values = np.array([self.sized.evidence, *self.alternatives.values(), 0.0]) / EVIDENCE.temperature
        share = np.exp(values - values.max())
        return replace(self.sized, probability=float(share[0] / share.sum()))

    @property
    def rival(self) -> Rival | None:
        """The alternative with the most evidence, if it would be named instead."""
        effect, evidence = self.sized.effect, self.alternatives
        best = max(evidence, key=lambda other: evidence[other], default=None)
        if best is None or evidence[best] < EVIDENCE.threshold:
            return self.late_clock
        advice = effect.rivals.get(best.name) or best.rivals.get(effect.name) or effect.varies
        return Rival(name=best.name, instead_of=effect.name, evidence_nats=evidence[best], separates=advice)

    @cached_property
    def entry(self) -> Entry:
        """Its entry of the ledger, with the probability that its size exceeds what the loop of the base may cause.

        P = Phi((|size| - loop) / standard error)
        """
        a, loop = self.amendment, self.due_to_loop
        entry = accepted_entry(a, EVIDENCE.threshold, self.price, self.error)
        facts = replace(entry.facts, is_material=self.is_material)
        if not (self.is_material and loop):
            return replace(entry, facts=facts)
        (size,) = a.parameters.values()
        chance = float(ndtr((abs(size) - loop) / max(self.fit_error, 1e-12)))
        return replace(
            entry,
            facts=replace(facts, material_probability=chance, required_probability=SURELY),
            remark=f"the control loop of the base may cause {1000 * loop:.0f} ms of it",
        )


def exceeds_sizes(a: Amendment) -> bool:
    """Tell whether an effect exceeds its materiality."""
    return all(abs(a.parameters[key]) >= limit for key, limit in a.effect.sizes.items())


def channel_result(
    channel: str,
    *,
    accepted: Sequence[AcceptedEffect],
    tried: Iterable[TriedEffect],
    structures: Iterable[AcceptedStructure],
    tested: Sequence[TestedStructure],
    gap: Gap,
    not_observable: Mapping[str, str],
    notes: Mapping[str, object],
    motion: MotionDifference | None = None,
) -> ChannelResult:
    """Return the result of a channel.

    Parameters
    ----------
    structures : Structure that matters to a user; that with the most evidence is reported.
    tested : Tests for structure.
    not_observable : Effects that the run could not have shown, with the reason, for other reasons than variance.
    """
    order, tried = sorted(accepted, key=lambda one: -(one.sized.evidence or 0.0)), list(tried)
    kept = [one for one in order if not one.is_absorbed]
    named = [one for one in kept if one.entry.verdict is Verdict.NAMED]
    return ChannelResult(
        channel=channel,
        effects=tuple(one.amendment for one in named),
        within_tolerance=tuple(one.amendment for one in kept if one not in named),
        withdrawn=tuple(
            Withdrawn(amendment=one.amendment, objection=ABSORBED) for one in order if one.is_absorbed
        ),
        unknown=_unknown(channel, tested, structures, gap.n_rays),
        rivals=tuple(rival for one in named if (rival := one.rival) is not None),
        gap=gap,
        not_observable={**_unseen_effects(tried), **not_observable},
        considered=(
            *(one.entry for one in order),
            *(one.entry for one in tried),
            *_structure_entries(channel, tested),
        ),
        notes=notes,
        motion=motion,
    )


def _unseen_effects(tried: Iterable[TriedEffect]) -> dict[str, str]:
    """Return the effects that would not show at three times their materiality, with the reason."""
    out = {}
    for one in tried:
        effect = one.amendment.effect
        if not one.variance or not effect.sizes:
            continue
        size = OBSERVABLE_SIZE * next(iter(effect.sizes.values()))
        expected = 0.5 * size**2 / one.variance
        if expected - EVIDENCE.price < EVIDENCE.threshold:
            out[effect.name] = (
                f"{effect.diagnostics.why_unseen}: at three times its materiality, the expected log Bayes factor is "
                f"{expected:.0f}"
            )
    return out


def fit_quality(whitener: Whitener, residual: Floats, rates: Iterable[Floats], base: float) -> FitQuality:
    """Return the quality of a residual (2 n,): RMS speed of body and wheels, and log-likelihood [nats].

    Parameters
    ----------
    rates : (k,), (k,) [m/s, rad/s] The residual as speeds and turn rates.
    base : [m] Wheelbase.
    """
    v, omega = rates
    nats, rms = whitener.nats_and_rms(residual)
    rmse = float(np.sqrt(np.mean(v**2 + (base / 2 * omega) ** 2)))
    return FitQuality(rmse_m=rmse, normalised=rms, nats_per_ray=nats)


# structure -----------------------------------------------------------------------------------------------------------


def _structure_entries(channel: str, tests: Iterable[TestedStructure]) -> Iterator[Entry]:
    """Yield each tested family of a channel at its most likely."""
    for tested in tests:
        best = tested.best
        own = [] if best is None else [best.family.kind]
        for kind in dict.fromkeys([*own, *tested.families]):
            name, title = FAMILIES_OF[channel][kind]
            screened = tested.families.get(kind)
            entry = Entry(
                name=name,
                channel=channel,
                title=title,
                facts=Facts(has_name=False, threshold=tested.threshold),
                price=None if screened is None else screened.price,
            )
            if best is not None and best.family.kind == kind:
                yield replace(
                    entry,
                    facts=replace(
                        entry.facts, accepted=True, evidence=best.evidence, is_material=tested.is_material
                    ),
                    estimate=best.family.statement,
                    size=best.size.to_dict(),
                    consequence=best.size.sentence(),
                )
            elif screened is not None:
                yield replace(
                    entry,
                    facts=replace(entry.facts, evidence=screened.evidence),
                    estimate=screened.family.statement,
                    rival=None
                    if best is None
                    else Competitor(title=best.family.statement, evidence=best.evidence),
                )


def _unknown(
    channel: str, tests: Sequence[TestedStructure], structures: Iterable[AcceptedStructure], n_rows: int
) -> Unknown | None:
    """Describe the structure with the most evidence as a difference that no effect explains; None without any.

    Parameters
    ----------
    n_rows : Number of rows of the channel.
    """
    order = sorted(structures, key=lambda one: -one.evidence)
    if not order:
        return None
    first, rivals = order[0], [one.family.statement for one in order[1:]]
    family, evidence, size = first.family, first.evidence, first.size
    name, _ = FAMILIES_OF[channel][family.kind]
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
        families=(family.statement, *[*rivals, *first.rivals][:2]),
        threshold=first.threshold,
    )
