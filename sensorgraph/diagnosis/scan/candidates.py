"""The candidates of a round, from the score test and the proposals of effects; their search; the memory of earlier rounds.

An effect evaluates the residuals where it would show (`Diagnostics.propose`), or lists values to be cast
(`Diagnostics.sweep`). `model_selection` fits and compares the candidates. Readings do not depend smoothly on the rough parameters of
an effect, which are therefore searched along the likelihood.

The gain of an effect rarely grows as other effects enter the model, because they explain readings that it would explain.
The gain of an earlier round therefore bounds the present one, and a candidate whose bound is far below the best gain of a
round is not fitted (Minoux 1978, Accelerated greedy algorithms for maximizing submodular set functions). The bound is void where
the score test expects more than it did at that fit. It is used only next to a candidate that surely enters the model, so a search
ends with a round that fits every candidate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize_scalar

from sensorgraph.diagnosis.scan.fit import Fitted, fit, log_likelihood, start_state, thin
from sensorgraph.diagnosis.scan.nuisance import State
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.score_test import Candidate, smooth_candidates
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
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
    memory : The starts of each effect, and the gains expected in the bare model, are stored there.
    """
    smooth = smooth_candidates(data, current)
    sharp = [c for c in smooth if c.gain > PROPOSAL.min_gain]
    rough = proposed_candidates(FitResiduals(data, current))
    if data.site.is_known:
        rough.sort(key=lambda c: not surely_stands(c.amendment, data))
    memory.note_expected((*smooth, *rough), is_bare=not current.model)
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
            if c.gain < least_gain(current.model, c.amendment, gained, memory.stands(c)):
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
    """Return the best value of each group of values that effects request to be cast.

    Values are cast on a part of the scans, with nominal nuisances. A group ends at a value whose gain is
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
    model = residuals.fitted.model  # the gains depend on nothing else
    key = b"swept|" + repr([(a.key, *a.parameters.items()) for a in model]).encode()
    return residuals.data.kept(key, lambda: _best_casts(residuals.data, model, groups))


def _best_casts(
    data: ScanData,
    model: tuple[Amendment, ...],
    groups: Sequence[tuple[Effect, Sequence[Mapping[str, float]]]],
) -> list[Candidate]:
    """Return the best value of each group of values of an effect, cast beside a model."""
    every = max(1, data.n_scans // SCAN.selection.n_cast_scans)
    few = thin(data, every)
    state = start_state(few, SCAN.noise)  # fitted nuisances may have absorbed the effect
    base = log_likelihood(few, model, state)
    found = []
    for effect, group in groups:
        tried = []
        for values in group:
            amendment = effect(**values)
            gain = (log_likelihood(few, (*model, amendment), state) - base) * every
            tried.append(Candidate(amendment=amendment, gain=gain))
            if len(tried) > 1 and gain < min(tried[-2].gain, 0.0):
                break
        found.append(max(tried, key=lambda c: c.gain))
    return found


def name_at_place(amendment: Amendment) -> str:
    """Return the name of an effect with its place: `glass@hall/edge_2`."""
    return f"{amendment.name}@{amendment.place}"


@dataclass(eq=False)
class SearchMemory:
    """Candidates of the rounds so far."""

    struck: set[tuple[str, str]] = field(default_factory=set)
    """Effects and places that were removed from the model."""
    latest: dict[str, Candidate] = field(default_factory=dict)
    """Name of each effect -> the start with the largest gain that was expected last."""
    bare: dict[str, list[float]] = field(default_factory=dict)
    """Effect at its place -> gains [nats] expected of its starts in the bare model."""
    standing: set[str] = field(default_factory=set)
    """Effects at their places of which a start is expected to gain as much now."""
    is_lazy: bool = False
    """Whether the present round may pass candidates by."""
    has_passed: bool = False
    """Whether it has passed any by."""
    _fits: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Effect at its place -> gain [nats] of its best start, and the largest that was expected of its starts."""
    _this_round: dict[str, tuple[float, float]] = field(default_factory=dict)

    def note_expected(self, candidates: Sequence[Candidate], *, is_bare: bool) -> None:
        """Store the best start of each effect, and which starts have the gain that was expected in the bare model."""
        self.latest = {}
        for c in sorted(candidates, key=lambda c: -c.gain):
            self.latest.setdefault(c.amendment.name, c)
            if is_bare:
                self.bare.setdefault(name_at_place(c.amendment), []).append(c.gain)
        self.standing = {name_at_place(c.amendment) for c in candidates if self.stands(c)}

    def stands(self, candidate: Candidate) -> bool:
        """Return whether the same gain was expected of a start of this effect in the bare model; it is then no remainder."""
        ratio, gains = SCAN.selection.same_gain, self.bare.get(name_at_place(candidate.amendment), ())
        return any(ratio * gain < candidate.gain < gain / ratio for gain in gains)

    def begin(self) -> None:
        """Begin a round."""
        self._fits |= self._this_round
        self._this_round = {}
        self.has_passed = False

    def repeat_in_full(self) -> bool:
        """Let the next round fit every candidate, and return whether this round did not."""
        self.is_lazy = False
        return self.has_passed

    def note(self, candidate: Candidate, gain: float) -> None:
        """Store the gain [nats] of a fit in this round; of several starts of an effect at a place, the largest counts."""
        key = name_at_place(candidate.amendment)
        most, expected = self._this_round.get(key, (-math.inf, -math.inf))
        self._this_round[key] = max(most, gain), max(expected, candidate.gain)

    def bound(self, candidate: Candidate) -> float:
        """Return the gain [nats] that a candidate had at its last fit; inf without a fit, or if more is expected now."""
        gain, expected = self._fits.get(name_at_place(candidate.amendment), (math.inf, math.inf))
        return math.inf if candidate.gain > expected / SCAN.selection.same_gain else gain

    def most_promising_first(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """Return the candidates in the order in which they are fitted."""
        return sorted(candidates, key=lambda c: -self.bound(c)) if self.is_lazy else list(candidates)


# rough parameters -----------------------------------------------------------------------------------------------------


def searched(
    data: ScanData, got: Fitted, noise_bounds: NoiseBounds, *, rounds: int, first: float, turns: int
) -> Fitted:
    """Search the rough parameters of the last effect, then fit again."""
    for _ in range(turns):
        polished = polish(data, got.model, got.state, noise_bounds, rounds=rounds, first=first)
        better = fit(data, polished, got.state, noise_bounds)
        gained = better.j - got.j
        if gained > 0:
            got = better
        if gained < 2:
            break
    return got


def polish(
    data: ScanData,
    model: tuple[Amendment, ...],
    state: State,
    noise_bounds: NoiseBounds,
    *,
    rounds: int,
    first: float,
) -> tuple[Amendment, ...]:
    """Improve the rough parameters of the last effect, with fixed nuisances.

    An effect that widens or mixes the readings has one parameter and is correlated with the noise, so the noise is
    estimated again at every value. The parameters of other effects are improved one after another by a pattern search.

    Parameters
    ----------
    rounds : Number of rounds over all parameters; more are made while a step still grows.
    first : Scale of the first steps.
    """
    *others, best = model
    usual = best.search_steps
    steps = {k: first * step for k, step in usual.items()}
    if not steps:
        return model
    if best.effect.absorber:
        return _peaked(data, model, state, noise_bounds, factor=1 + 2 * first)
    most = log_likelihood(data, model, state)
    for turn in range(SCAN.fit.max_strides):
        if turn >= rounds and all(s <= first * usual[k] for k, s in steps.items()):
            break
        moved = False
        for name in steps:
            for sign in (1.0, -1.0):
                trial = best.moved_within_bounds({name: best[name] + sign * steps[name]})
                got = log_likelihood(data, (*others, trial), state)
                if got > most + 1e-6:
                    most, best, moved = got, trial, True
                    steps[name] *= 1.5
                    break
            else:
                steps[name] *= 0.4
        if not moved and all(s < SCAN.fit.settled_step * usual[k] for k, s in steps.items()):
            break
    return (*others, best)


def _peaked(
    data: ScanData,
    model: tuple[Amendment, ...],
    state: State,
    noise_bounds: NoiseBounds,
    *,
    factor: float,
) -> tuple[Amendment, ...]:
    """Move the single rough parameter of the last effect to its most likely value, by a factor of at most `factor`."""
    *others, start = model
    (name,) = start.search_steps

    def at(u: float) -> tuple[Amendment, ...]:
        return (*others, start.moved_within_bounds({name: start[name] * float(np.exp(u))}))

    reach = float(np.log(factor))
    found = minimize_scalar(
        lambda u: -log_likelihood(data, at(u), state, noise_bounds),
        bounds=(-reach, reach),
        method="bounded",
        options={"xatol": SCAN.fit.profile_tolerance},
    )
    return at(float(found.x))
