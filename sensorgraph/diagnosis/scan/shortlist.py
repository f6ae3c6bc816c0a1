"""The candidates of a round, from the score test and the proposals of effects.

An effect evaluates the residuals where it would show (`Diagnostics.propose`), or lists values to be cast
(`Diagnostics.sweep`). `model_selection` fits and compares the candidates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sensorgraph.diagnosis.scan.fit import Fitted, log_likelihood, start_state, thin, thin_state
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.score_test import Candidate, smooth_candidates
from sensorgraph.diagnosis.scan.search_memory import SearchMemory, name_at_place
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.worth import surely_stands
from sensorgraph.effects import EFFECTS, Amendment, Effect
from sensorgraph.effects.map_scale import MAP_SCALE
from sensorgraph.effects.proposals import PROPOSAL
from sensorgraph.effects.range_scale import RANGE_SCALE
from sensorgraph.world.sensor_parts import part_names, sensor_of_rays

STAGES_OF_ONE_SENSOR = ("detection", "noise")
"""Stages of effects on single readings that may apply to one of several sensors."""


def shortlist(
    data: ScanData,
    current: Fitted,
    gained: float,
    memory: SearchMemory,
) -> list[Candidate]:
    """Return the candidates to fit, best first.

    Parameters
    ----------
    gained : [nats] Gain of the model so far; the remainders that its effects may leave are a share of it.
    memory : Gains expected in the bare model are stored there, and dropped when they change.
    """
    smooth = smooth_candidates(data, current)
    sharp = [c for c in smooth if c.gain > PROPOSAL.min_gain]
    rough = proposed_candidates(FitResiduals(data, current))
    if data.clutter_nats:
        rough.sort(key=lambda c: not surely_stands(c.amendment, data))
    first = memory.first
    first.compare((*sharp, *rough), is_first=not current.model)
    first.note((*smooth, *rough))
    present = {name_at_place(a) for a in current.model}
    out: list[Candidate] = []
    seen: dict[str, int] = {}
    for group, most in ((sharp, 5), (rough, 8)):
        taken = 0
        for c in group:
            key = name_at_place(c.amendment)
            single = c.amendment.effect.place is None
            if key in present and (single or c.amendment.effect.place in ("wall", "obstacle")):
                continue
            if (c.amendment.name, c.amendment.place) in memory.struck:
                continue
            if not data.may_show(c.amendment.effect, c.amendment.place):
                continue
            if data.from_scans and _stretches(c.amendment) and any(map(_stretches, current.model)):
                continue  # the poses have been scaled with the map, so the scales of map and laser are equivalent
            if c.gain < least_gain(current.model, c.amendment, gained, first.has(c)):
                continue
            if any(is_same(c, o) for o in out) or seen.get(c.amendment.name, 0) >= 3:
                continue
            second_start = c.amendment.effect.diagnostics.second_start
            if second_start is not None:
                other = c.amendment.moved_to(second_start(data.span))
                out.append(Candidate(amendment=other, gain=c.gain))
            out.append(c)
            seen[c.amendment.name] = seen.get(c.amendment.name, 0) + 1
            taken += 1
            if taken == most:
                break
    return out[: SCAN.selection.max_candidates]


def _stretches(amendment: Amendment) -> bool:
    return amendment.effect in (MAP_SCALE, RANGE_SCALE)


def is_same(candidate: Candidate, other: Candidate) -> bool:
    """Return whether two starts are so close that a single fit is sufficient."""
    a, b = candidate.amendment, other.amendment
    if a.name != b.name or a.place != b.place:
        return False
    sizes = a.effect.sizes
    if not sizes:
        return True
    apart = sum(((a[k] - b[k]) / m) ** 2 for k, m in sizes.items()) ** 0.5
    return bool(apart < 3.0) and a.effect.place not in ("spot", "sector")


def least_gain(model: Sequence[Amendment], candidate: Amendment, gained: float, stood: bool) -> float:
    """Return the gain [nats] below which a candidate is only a remainder of the effects in the model.

    Parameters
    ----------
    stood : Whether the same gain was expected in the bare model. The candidate is then not a remainder, except of an
        effect with a coarse model.
    """
    known = [a.effect.diagnostics for a in model]
    by_name = [0.0 if stood and not d.leftover_share else d.leftovers.get(candidate.name, 0.0) for d in known]
    shares = [max(d.leftover_share, share) for d, share in zip(known, by_name, strict=True)]
    return max(shares, default=0.0) * gained


def proposed_candidates(residuals: FitResiduals) -> list[Candidate]:
    """Return the proposals of all effects, best first."""
    effects = [e for e in EFFECTS.values() if residuals.data.may_show(e)]
    found = [c for effect in effects for c in _proposed(effect, residuals)]
    found += _of_one_sensor(effects, residuals)
    found += _swept(effects, residuals)
    return sorted((c for c in found if c.gain > PROPOSAL.min_gain), key=lambda c: -c.gain)


def _proposed(effect: Effect, residuals: FitResiduals) -> list[Candidate]:
    """Return the proposals of one effect."""
    out = []
    if effect.diagnostics.propose is not None:
        for proposal in effect.diagnostics.propose(residuals):
            amendment = effect(**proposal.values)
            if proposal.place or proposal.xy is not None:
                amendment = amendment.at(proposal.place, proposal.xy)
            out.append(Candidate(amendment=amendment, gain=proposal.gain))
    return out


def _of_one_sensor(effects: list[Effect], residuals: FitResiduals) -> list[Candidate]:
    """Return the proposals of effects on single readings for each of several sensors separately."""
    own = [e for e in effects if e.stage in STAGES_OF_ONE_SENSOR and e.place is None]
    own = [e for e in own if not (e.diagnostics.is_lattice or e.diagnostics.explains)]
    owner = sensor_of_rays(residuals.sensor)
    found = []
    for number, name in enumerate(part_names(residuals.sensor)):
        view = residuals.of_rays(owner == number)
        found += [replace(c, amendment=c.amendment.at(name)) for e in own for c in _proposed(e, view)]
    return found


def _swept(effects: list[Effect], residuals: FitResiduals) -> list[Candidate]:
    """Return the best value of each group of values that effects request to be cast; of all groups, the best few.

    Values are cast on a part of the scans, with frozen nuisances. A group ends at a value whose gain is
    negative and below that of the previous value.
    """
    groups = [
        (effect, group)
        for effect in effects
        if effect.diagnostics.sweep is not None
        for group in effect.diagnostics.sweep(residuals)
    ]
    if not groups:
        return []
    data, fitted = residuals.data, residuals.fitted
    settings = SCAN.sweep
    every = max(1, data.n_scans // settings.n_scans)
    few = thin(data, every)
    state, nominal = thin_state(fitted.state, every), start_state(few, SCAN.noise)
    if state.noise.core > settings.max_core:
        state = nominal
    # at nominal nuisances the result depends on the model only, and a strained fit needs it twice
    key = b"swept|" + repr([(a.key, *a.parameters.items()) for a in fitted.model]).encode()
    if state is nominal and key in data.memo:
        kept = data.memo[key]
        assert isinstance(kept, list)
        return kept
    base = log_likelihood(few, fitted.model, state)
    found = []
    for effect, group in groups:
        tried = []
        for values in group:
            amendment = effect(**values)
            gain = (log_likelihood(few, (*fitted.model, amendment), state) - base) * every
            tried.append(Candidate(amendment=amendment, gain=gain))
            if len(tried) > 1 and gain < min(tried[-2].gain, 0.0):
                break
        found.append(max(tried, key=lambda c: c.gain))
    best = sorted(found, key=lambda c: -c.gain)[: settings.max_candidates]
    if state is nominal:
        data.memo[key] = best
    return best
