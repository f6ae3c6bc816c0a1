"""Report of a motion channel: named effects with sizes, rivals, gap, unobservable effects, and entries of the ledger."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from sensorgraph.diagnosis.engine.ledger import Entry
from sensorgraph.diagnosis.engine.verdict import OBSERVABLE_SIZE, SURELY, Facts, Objection, Verdict
from sensorgraph.diagnosis.ledger import accepted_entry, effect_entry
from sensorgraph.diagnosis.motion.consequence import SimulationError
from sensorgraph.diagnosis.motion.motor_model import due_to_loop
from sensorgraph.diagnosis.motion.regression import TEMPERATURE, Fit, Term
from sensorgraph.diagnosis.motion.selection import FAMILIES_OF, MotionModel
from sensorgraph.diagnosis.motion.structure_test import StructureFamily, TestedFamily
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
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment, Effect
from sensorgraph.types import Floats

ABSORBED = Objection("absorbed_by_unknown", "a difference that no effect explains absorbs it")
"""Why an effect next to structure is not named."""
Alternatives = Callable[[Sequence[Term], Term], Mapping[Effect, float]]
"""Returns the evidence of further effects that could replace an effect, given the other hypotheses."""
EVEN_PART = 0.5
"""Share of the contribution of a whole-run effect, above which structure takes its name."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TriedEffect:
    """An effect that is not in the model, at its most likely size."""

    amendment: Amendment
    evidence: float
    """[nats] in addition to the model, less the price."""
    price: float
    """[nats] complexity penalty."""
    variance: float = 0.0
    """Of its size, if it were in the model; decides whether the run could have shown it."""

    @property
    def has_expectation(self) -> bool:
        """Whether the evidence that it would have at a given size is known."""
        return bool(self.variance and self.amendment.effect.sizes)

    def expected(self, materialities: float) -> float:
        """Return the log Bayes factor [nats] that it would have in this run at a size, before its price."""
        size = materialities * next(iter(self.amendment.effect.sizes.values()))
        return float(0.5 * size**2 / self.variance)

    @property
    def entry(self) -> Entry:
        """Its entry of the ledger."""
        facts = Facts(has_name=True, evidence=self.evidence, threshold=SCAN.selection.threshold)
        return effect_entry(replace(self.amendment, evidence=self.evidence), facts, price=self.price)


@dataclass(frozen=True, kw_only=True, eq=False)
class AcceptedEffect:
    """An effect of the model."""

    amendment: Amendment
    entry: Entry
    """Of the ledger."""
    rival: Rival | None
    is_absorbed: bool
    """Whether structure that no effect explains may be the cause of all of it."""


def _accepted(
    model: MotionModel,
    terms: Sequence[Term],
    fit: Fit,
    term: Term,
    error: float,
    *,
    instead: Alternatives,
    usual_rival: Callable[[Amendment], Rival | None],
) -> AcceptedEffect:
    """Return an effect of the model, with its probability against its alternatives and no effect, whose evidence is 0.

        p = exp(evidence / temperature) / sum over candidates of exp(evidence_i / temperature)

    Parameters
    ----------
    error : Standard error of its coefficient.
    """
    rest_terms = [other for other in terms if other != term]
    rest = model.fit(rest_terms, fit)
    price = model.rows.price(term.n_parameters)
    evidence = fit.log_posterior - rest.log_posterior - price
    alternatives = {
        other.effect: model.fit([*rest_terms, other], fit).log_posterior
        - rest.log_posterior
        - model.rows.price(other.n_parameters)
        for other in model.terms
        if other not in terms and other.effect is not None
    } | dict(instead(rest_terms, term))
    values = np.array([evidence, *alternatives.values(), 0.0]) / TEMPERATURE
    share = np.exp(values - values.max())
    sized = model.sized(term, fit, error)
    a = replace(sized, evidence=evidence, probability=float(share[0] / share.sum()))
    missing = fit.simulated - rest.simulated + fit.explained([term.column])
    return AcceptedEffect(
        amendment=a,
        entry=_judged_entry(a, price, model.error_without(fit, missing), due_to_loop(model.robot, a), error),
        rival=_rival(a, alternatives) or usual_rival(a),
        is_absorbed=a.location is None and _takes(model, fit, missing),
    )


def _rival(a: Amendment, alternatives: Mapping[Effect, float]) -> Rival | None:
    """Return the alternative with the most evidence [nats], if it would be named instead."""
    best = max(alternatives, key=lambda other: alternatives[other], default=None)
    if best is None or alternatives[best] < SCAN.selection.threshold:
        return None
    advice = a.effect.rivals.get(best.name) or best.rivals.get(a.name) or a.effect.varies
    return Rival(name=best.name, instead_of=a.name, evidence_nats=alternatives[best], separates=advice)


def exceeds_sizes(a: Amendment) -> bool:
    """Tell whether an effect exceeds its materiality."""
    return all(abs(a.parameters[key]) >= limit for key, limit in a.effect.sizes.items())


def _judged_entry(a: Amendment, price: float, size: SimulationError, loop: float, error: float) -> Entry:
    """Return the entry of an accepted effect, with the probability that its size exceeds what the loop of the base may cause.

    P = Phi((|size| - loop) / standard error)
    """
    is_material = exceeds_sizes(a)
    entry = accepted_entry(a, SCAN.selection.threshold, price, size)
    facts = replace(entry.facts, is_material=is_material)
    if not (is_material and loop):
        return replace(entry, facts=facts)
    (value,) = a.parameters.values()
    chance = float(ndtr((abs(value) - loop) / max(error, 1e-12)))
    return replace(
        entry,
        facts=replace(facts, material_probability=chance, required_probability=SURELY),
        remark=f"the control loop of the base may cause {1000 * loop:.0f} ms of it",
    )


def channel_result(
    model: MotionModel,
    terms: Sequence[Term],
    fit: Fit,
    *,
    instead: Alternatives = lambda rest, term: {},
    also_tried: Sequence[TriedEffect] = (),
    usual_rival: Callable[[Amendment], Rival | None] = lambda a: None,
    not_observable: Mapping[str, str],
    notes: Mapping[str, object],
    motion: MotionDifference | None = None,
) -> ChannelResult:
    """Return the result of a channel for the selected hypotheses and their fit.

    Parameters
    ----------
    instead : Returns the evidence of further effects that could replace an effect, given the other hypotheses.
    usual_rival : Returns the rival of an effect where no alternative would be named instead.
    not_observable : Effects that the run could not have shown, with the reason, for other reasons than variance.
    """
    channel, errors = model.channel, fit.regression.clustered_errors(fit.solution, model.clusters)
    accepted = [
        _accepted(
            model, terms, fit, term, float(errors[term.column]),
            instead=instead, usual_rival=usual_rival,
        )
        for term in terms
        if term.effect is not None
    ]  # fmt: skip
    tried = [
        *(_tried(model, terms, fit, term) for term in model.terms if term not in terms and term.effect),
        *also_tried,
    ]
    order = sorted(accepted, key=lambda one: -(one.amendment.evidence or 0.0))
    kept = [one for one in order if not one.is_absorbed]
    named = [one for one in kept if one.entry.verdict is Verdict.NAMED]
    gap = _gap(model, terms, fit)
    structures = [*_freed(model, terms, fit), *([] if model.structure is None else [model.structure])]
    return ChannelResult(
        channel=channel,
        effects=tuple(one.amendment for one in named),
        within_tolerance=tuple(one.amendment for one in kept if one not in named),
        withdrawn=tuple(
            Withdrawn(amendment=one.amendment, objection=ABSORBED) for one in order if one.is_absorbed
        ),
        unknown=_unknown(channel, structures, gap.n_rays),
        rivals=tuple(rival for one in named if (rival := one.rival) is not None),
        gap=gap,
        not_observable={**_unseen_effects(tried), **not_observable},
        at_materiality={
            one.amendment.name: one.expected(1.0) - one.price for one in tried if one.has_expectation
        },
        considered=(
            *(one.entry for one in order),
            *(one.entry for one in tried),
            *(one.entry(channel, *FAMILIES_OF[channel][one.family.kind]) for one in model.tested),
        ),
        notes=notes,
        motion=motion,
    )


def _tried(model: MotionModel, terms: Sequence[Term], fit: Fit, term: Term) -> TriedEffect:
    """Return an effect that is not in the model."""
    more = [*terms, term]
    with_it = model.fit(more, fit)
    error = float(np.sqrt(max(float(with_it.solution.covariance[term.column, term.column]), 0.0)))
    price = model.rows.price(term.n_parameters)
    return TriedEffect(
        amendment=model.sized(term, with_it, error),
        evidence=with_it.log_posterior - fit.log_posterior - price,
        price=price,
        variance=float(fit.regression.solve(model.prior(more, fit)).covariance[term.column, term.column]),
    )


def _takes(model: MotionModel, fit: Fit, missing: Floats) -> bool:
    """Tell whether structure absorbs a whole-run effect, because its contribution is at least half as large.

    The effect may be the even part of another cause. For example, a floor that takes a share of left turns only is
    equivalent to half a wheelbase error and half a difference between left and right.
    """
    if model.structure is None:
        return False
    n = fit.columns.shape[1]
    structure = fit.explained(range(n - model.structure.family.columns.shape[1], n))
    own, other = (float(np.linalg.norm(model.whitener(rows))) for rows in (missing, structure))
    return other > EVEN_PART * own


def _unseen_effects(tried: Iterable[TriedEffect]) -> dict[str, str]:
    """Return the effects that would not show at three times their materiality, with the reason."""
    out = {}
    for one in tried:
        effect = one.amendment.effect
        if not one.has_expectation:
            continue
        expected = one.expected(OBSERVABLE_SIZE)
        if expected - one.price < SCAN.selection.threshold:
            out[effect.name] = (
                f"{effect.diagnostics.why_unseen}: at three times its materiality, the expected log Bayes factor is "
                f"{expected:.0f}"
            )
    return out


def _gap(model: MotionModel, terms: Sequence[Term], fit: Fit) -> Gap:
    """Return the gap, by fits to every other cluster of errors and measurements on the rest, and vice versa."""
    rows, k = model.rows, fit.columns.shape[1]
    n = 2 * rows.n_valid
    stamps = rows.stamps
    after = fit.held_out_residual(model.prior(terms, fit), stamps)

    def quality(residual: Floats) -> FitQuality:
        use = rows.masked(residual)
        v, omega = model.rates_of(use)
        nats, rms = model.whitener.first(2).nats_and_rms(use[: 2 * rows.n])
        speed = np.sqrt(np.mean(v**2 + (model.robot.wheels.base / 2 * omega) ** 2))
        return FitQuality(rmse_m=float(speed), normalised=rms, nats_per_ray=nats)

    return Gap(
        before=quality(model.nominal_residual),
        after=quality(after),
        noise_floor=quality(fit.residual * np.sqrt(n / max(n - k, 1))),
        n_rays=n,
    )


# structure -----------------------------------------------------------------------------------------------------------


def _freed(model: MotionModel, terms: Sequence[Term], fit: Fit) -> list[TestedFamily]:
    """Return the tolerances beyond their bounds as one difference without a name, if there are any.

    The ledger keeps it, or else the best one that the evidence does not suffice for.
    """
    freed = [term for term in terms if term.effect is None]
    rest_terms = [term for term in terms if term.effect is not None]
    tried = [[term] for term in model.terms if term.effect is None]
    found = list[TestedFamily]()
    for some in [freed] if freed else tried:
        with_it = fit if freed else model.fit([*rest_terms, *some], fit)
        rest = model.fit(rest_terms, fit) if freed else fit
        columns = [term.column for term in some]
        price = model.rows.price(sum(term.n_parameters for term in some))
        family = StructureFamily(
            kind=some[0].family,
            columns=with_it.columns[:, columns],
            statement=model.words_of({k: float(with_it.solution.theta[k]) for k in columns}),
        )
        evidence = with_it.log_posterior - rest.log_posterior - price
        missing = with_it.simulated - rest.simulated + with_it.explained(columns)
        size = model.error_without(with_it, missing) if freed else None
        found.append(TestedFamily(family=family, evidence=evidence, price=price, size=size))
    best = max(found, key=lambda one: one.evidence, default=None)
    if best is not None:
        model.tested.append(best)
    return [] if best is None or best.size is None else [best]


def _unknown(channel: str, structures: Iterable[TestedFamily], n_rows: int) -> Unknown | None:
    """Describe the structure with the most evidence as a difference that no effect explains; None without any."""
    order = sorted(structures, key=lambda one: -one.evidence)
    if not order:
        return None
    first, rivals = order[0], [one.family.statement for one in order[1:]]
    family, evidence, size = first.family, first.evidence, first.size
    assert size is not None
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
