"""Propose start values of effects from the residuals of a fit.

An effect evaluates the residuals where it would show (`Diagnostics.propose`), or lists values to be cast
(`Diagnostics.sweep`). `model_selection` fits and compares the candidates.
"""

from __future__ import annotations

from dataclasses import replace

from sensorgraph.diagnosis.scan.fit import log_likelihood, start_state, thin, thin_state
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.score_test import Candidate
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import EFFECTS, Effect
from sensorgraph.effects.proposals import PROPOSAL
from sensorgraph.world.sensor_parts import part_names, sensor_of_rays

STAGES_OF_ONE_SENSOR = ("detection", "noise")
"""Stages of effects on single readings that may apply to one of several sensors."""


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
