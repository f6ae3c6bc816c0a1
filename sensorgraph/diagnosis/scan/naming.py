"""Name the effects of an accepted model, with a probability each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import expit

from sensorgraph.diagnosis.engine.verdict import SURELY, Objection
from sensorgraph.diagnosis.report.quantities import brief
from sensorgraph.diagnosis.result import (
    ChannelResult,
    Deviation,
    Rival,
    Unknown,
    Withdrawn,
    without_close_calls,
)
from sensorgraph.diagnosis.scan.consequence import (
    SURELY_MATERIAL,
    is_map_error,
    material_chance,
    required_ratio,
)
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.goodness_of_fit import GoodnessOfFit
from sensorgraph.diagnosis.scan.model_selection import Explained
from sensorgraph.diagnosis.scan.observability import separation
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.standard_errors import evidence_beside_wander
from sensorgraph.diagnosis.scan.unnamed import Doubt, titles
from sensorgraph.diagnosis.scan.worth import is_within_baseline, n_parameters
from sensorgraph.effects import Amendment


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanNames:
    """Result of the scan channel, and the effects that it accepts."""

    result: ChannelResult
    complete: tuple[Amendment, ...] = ()
    """All effects of the model with evidence and probability, in its order."""
    small: Mapping[int, Objection] = field(default_factory=dict)
    """Index in `complete` -> why the effect is within tolerance; those that are not are left out."""
    chances: tuple[float, ...] = ()
    """Probability that each effect of `complete` is material."""
    accepted: tuple[Amendment, ...]
    """Fitted effects that are material and not contradicted by unmodelled structure, in the order of the model."""
    rivals: tuple[Amendment, ...]
    """The second-best explanations, in the order of `result.rivals`."""

    @property
    def named(self) -> list[Amendment]:
        """Accepted effects without an equally likely rival."""
        undecided = {(a.name, a.place) for a in self.result.undecided}
        return [a for a in self.accepted if (a.name, a.place) not in undecided]


def name_scan_effects(
    data: ScanData,
    explained: Explained,
    fit: GoodnessOfFit,
    deviations: Sequence[Deviation],
) -> ScanNames:
    """Sort an accepted model into named effects, effects within tolerance, rivals and unmodelled structure.

    An effect is *named* if it is reported as the cause of a difference.

    Parameters
    ----------
    fit : Goodness of fit of the accepted model.
    deviations : From the simulator without any effect.
    """
    final = explained.final
    chances = tuple(material_chance(final, a) for a in final.model)
    least = SCAN.selection.threshold
    beside_wander = [evidence_beside_wander(final, amendment) for amendment in final.model]
    complete = [
        replace(
            located(amendment, data),
            evidence=explained.gains[index] if beside_wander[index] >= least else beside_wander[index],
            probability=chances[index] * probability(explained, index, fit),
        )
        for index, amendment in enumerate(final.model)
    ]
    enough = [i for i, a in enumerate(complete) if (a.evidence or 0.0) >= least]
    why = {i: why_immaterial(final, final.model[i], chances[i]) for i in enough}
    small = {i: objection for i, objection in why.items() if objection is not None}
    rules = {i: why_withdrawn(explained, i, fit.told) for i in enough if i not in small}
    accepted = [i for i, rule in rules.items() if rule is None]
    order = sorted(accepted, key=lambda i: -(complete[i].evidence or 0.0))
    result = ChannelResult(
        channel="scan",
        effects=tuple(complete[i] for i in order),
        within_tolerance=tuple(complete[i] for i in small),
        withdrawn=tuple(
            Withdrawn(amendment=complete[i], objection=rule) for i, rule in rules.items() if rule is not None
        ),
        not_observable={
            a.name: f"{brief(a)} is within the possible mean error of a reference that drifts"
            for i, a in enumerate(complete)
            if i not in enough
        },
        unknown=_unknown(fit.told),
        rivals=tuple(_rival(data, complete[i], *explained.rivals[i]) for i in order if i in explained.rivals),
        deviations=tuple(deviations),
        notes={"immaterial": list(fit.immaterial)} if fit.immaterial else {},
    )
    return ScanNames(
        result=without_close_calls(result),
        complete=tuple(complete),
        small=small,
        chances=chances,
        accepted=tuple(final.model[i] for i in accepted),
        rivals=tuple(explained.rivals[i][0] for i in order if i in explained.rivals),
    )


def _rival(data: ScanData, a: Amendment, rival: Amendment, short: float) -> Rival:
    """Return the second best explanation of what an effect explains, `short` [nats] of it."""
    return Rival(
        name=rival.name,
        instead_of=a.name,
        evidence_nats=(a.evidence or 0.0) - short,
        separates=separation(a, rival),
        required_nats=_margin(data, a, rival),
    )


def _margin(data: ScanData, a: Amendment, rival: Amendment) -> float:
    """Return the lead [nats] that an effect needs over its rival.

    At a commissioned site, the lead must also exceed the evidence that clutter brings.
    """
    is_special = n_parameters(rival) > n_parameters(a)  # as a warm-up, which is a bias if it ends at once
    return max(SCAN.naming.rival_margin, 0.0 if is_special else data.site.lead(a, rival))


def located(amendment: Amendment, data: ScanData) -> Amendment:
    """Return an effect at the place that its fitted parameters give."""
    values = amendment.parameters
    if amendment.effect.place == "spot":
        return amendment.at("", (values["x"], values["y"]))
    if {"a", "b"} <= set(values) and amendment.place in data.arena.names:
        start, end = data.arena.walls[data.arena.names.index(amendment.place)]
        along = (end - start) / max(float(np.hypot(*(end - start))), 1e-9)
        return amendment.at(amendment.place, start + along * (values["a"] + values["b"]) / 2)
    return amendment


def why_immaterial(fitted: Fitted, amendment: Amendment, chance: float) -> Objection | None:
    """Return why an effect, which is material with a probability `chance`, is not named; None if it is large enough."""
    if is_within_baseline(fitted, amendment):
        return Objection("site_baseline", "it is within what the known-good runs of the site show")
    if is_map_error(fitted, amendment):
        return Objection("map_error", "it is within the errors of the map")
    required = SCAN.naming.min_material_probability
    if chance >= required:
        return None
    least = f"exceeds {required_ratio(fitted, amendment):.2g} times its materiality"
    if not amendment.effect.sizes:
        least = f"changes more than {100 * SCAN.goodness_of_fit.min_share:.2g} % of the readings"
    return Objection(
        SURELY_MATERIAL,
        f"the probability that it {least} is {100 * chance:.0f} %, and {100 * required:.0f} % is required",
    )


def why_withdrawn(explained: Explained, index: int, told: Doubt | None) -> Objection | None:
    """Return why unmodelled structure takes the name of an effect; None if it does not."""
    amendment, settings = explained.final.model[index], SCAN.goodness_of_fit
    if told is None:
        return None
    share = settings.failed_law_share if told.is_of_building else settings.min_share_of_gain
    is_lattice = amendment.effect.diagnostics.is_lattice
    if index not in told.failed and (is_lattice or told.misfit <= share * explained.gains[index]):
        return None
    cause = titles().get(told.family, told.statement)
    return Objection("part_of_unknown", f"it may be a part of what no effect explains: {cause}")


def probability(explained: Explained, index: int, fit: GoodnessOfFit) -> float:
    """Return the probability that a name is right, if its size is material."""
    gain = explained.gains[index]
    margin = explained.rivals[index][1] if index in explained.rivals else gain
    p = SURELY * float(expit(min(gain, margin)))
    if fit.told is not None and not fit.told.is_of_building:
        p /= 2  # what is unexplained may be the cause as well
    return p


def _unknown(told: Doubt | None) -> Unknown | None:
    if told is None:
        return None
    consequence = "" if told.size is None else told.size.sentence()
    size = f"; {consequence}" if consequence else ""
    return Unknown(
        statement=f"something no effect of the library explains: {told.statement}{size}",
        deviation=told.deviation,
        statistic=told.statistic,
        threshold=told.threshold,
        size={} if told.size is None else told.size.to_dict(),
        consequence=consequence,
        families=told.causes,
        family=told.family,
        profile=told.profile,
    )
