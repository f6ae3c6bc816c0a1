"""Effects of the scans as hypotheses of the engine: try further effects, refit all jointly, merge what is one effect.

`engine.selection.select` adds and removes them by evidence.

Two effects of a model may be one: touching segments of a wall, or two sectors around an undisturbed one. Effects are added one at a time, so the search may split a single effect. For a pane, the first half may explain most, and
a black segment next to it the rest. For a bias of all rays except some, two sectors around these may be found.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, permutations

import numpy as np

from sensorgraph.diagnosis.engine.selection import select
from sensorgraph.diagnosis.scan.candidate_fits import CandidateFits, is_rough, ranked, searched
from sensorgraph.diagnosis.scan.fit import (
    Fitted,
    fit,
    start_state,
)
from sensorgraph.diagnosis.scan.gauss_newton import State
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.score_test import Candidate
from sensorgraph.diagnosis.scan.search_memory import SearchMemory, name_at_place
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.diagnosis.scan.shortlist import is_same, least_gain, shortlist
from sensorgraph.diagnosis.scan.standard_errors import standard_errors
from sensorgraph.diagnosis.scan.worth import price, worth
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import without
from sensorgraph.effects.places import in_sector
from sensorgraph.effects.range_bias import RANGE_BIAS
from sensorgraph.effects.sector_bias import SECTOR_BIAS
from sensorgraph.types import Progress, ProgressBars, no_progress

Model = tuple[Amendment, ...]
MAX_GAP = 0.2
"""[m] maximum gap between two segments of a wall that may be one; rays that end in the gap meet both."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """A round of the search: the effects that were tried, with their gains [nats]."""

    tried: tuple[tuple[Amendment, float], ...]
    chosen: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Explained:
    """The accepted model with its fit, and the steps of the search."""

    null: Fitted
    final: Fitted
    """Fit of the accepted model; its effects include their standard errors."""
    gains: dict[int, float]
    """Index in the final model -> evidence [nats] that is lost without this effect."""
    steps: tuple[Step, ...] = field(default_factory=tuple)
    rivals: dict[int, tuple[Amendment, float]] = field(default_factory=dict)
    """Index in the final model -> the second best explanation and its deficit [nats]."""
    expected: Mapping[str, Candidate] = field(default_factory=dict)
    """Name of each effect -> its best start in the last round, whether or not it was fitted."""


def explain(data: ScanData, noise_bounds: NoiseBounds, *, progress: ProgressBars = no_progress) -> Explained:
    """Search for effects with sufficient evidence; each round has a progress bar."""
    search = EffectSearch(data, noise_bounds, progress)
    select(search, threshold=SCAN.selection.threshold, most=SCAN.selection.max_effects)
    current, gains, n = search.current, {}, len(search.current.model)
    with progress("weighing effects", "effects") as tick:
        for index in range(n):
            tick(index, n + 1)
            gains[index] = worth(data, current.model[index], current, search.rest(index))
        tick(n, n + 1)
        errors = standard_errors(current, noise_bounds)
    rivals = search.rivals
    kept = {i: rivals[name_at_place(a)] for i, a in enumerate(current.model) if name_at_place(a) in rivals}
    model = tuple(replace(a, stderr=e) for a, e in zip(current.model, errors, strict=True))
    final = replace(current, model=model)
    return Explained(
        null=search.null,
        final=final,
        gains=gains,
        steps=tuple(search.steps),
        rivals=kept,
        expected=search.expected,
    )


class EffectSearch:
    """Effects as hypotheses about the scans; `current` is the fit of the present model. One loop over rounds of fits."""

    def __init__(self, data: ScanData, noise_bounds: NoiseBounds, progress: ProgressBars) -> None:
        self.data, self.noise_bounds, self.progress = data, noise_bounds, progress
        self.threshold = SCAN.selection.threshold
        self.casts = 1 if data.posed is None else SCAN.fit.casts
        with progress("fitting the simulator", ""):
            self.null = self._fit((), start_state(data, noise_bounds), self.casts, 7)
        self.current = self.null
        self.steps: list[Step] = []
        self.rivals: dict[str, tuple[Amendment, float]] = {}
        """Effect at its place -> the second best explanation when it entered, and its deficit [nats]."""
        self._memory = SearchMemory()
        self._chosen = self._before = self.null
        self._n_small = 0
        self._rests: dict[int, Fitted] = {}
        """Index in the model -> the fit without this effect."""

    @property
    def expected(self) -> Mapping[str, Candidate]:
        """Name of each effect -> its best start in the last round, whether or not it was fitted."""
        return self._memory.first.latest

    def best(self, model: Sequence[Amendment]) -> tuple[Amendment, float] | None:
        """Return the best further effect and its evidence [nats], in as many rounds of fits as this needs."""
        memory = self._memory
        while not self._has_ended():
            begun = self.current.j
            with self.progress(f"trying effects, round {len(self.steps) + 1}", "candidates") as tick:
                tried, also = self._try(tick)
            if not tried:
                if not memory.repeat_in_full():
                    return None
                continue
            order = ranked(self.data, tried)
            self._chosen, gain = order[0]
            effect = self._chosen.model[-1]
            if gain >= self.threshold:
                gain = self._against_refitted()
            stood = memory.first.still_has(effect)
            least = least_gain(self.current.model, effect, self._gained, stood)
            enough = gain >= max(self.threshold, least)
            weighed = _best_of_each([*((f.model[-1], g) for f, g in order), *also])
            self.steps.append(Step(tried=weighed, chosen=effect.name if enough else ""))
            if enough:
                memory.is_lazy = True
                mine = name_at_place(effect)
                others = [*((f.model[-1], g) for f, g in order[1:]), *also]
                others = [(a, order[0][1] - g) for a, g in others if name_at_place(a) != mine]
                if others:
                    self.rivals[mine] = min(others, key=lambda t: t[1])
                return effect, gain
            had_converged = self.current.j <= begun + self.threshold
            if had_converged and not memory.repeat_in_full():
                return None
        return None

    @property
    def _gained(self) -> float:
        """[nats] Gain of the present model over the bare simulator."""
        return self.current.j - self.null.j

    def _try(self, tick: Progress) -> tuple[list[tuple[Fitted, float]], list[tuple[Amendment, float]]]:
        """Fit the most promising candidates; return (fit, gain [nats]), and (effect, gain) of those far behind."""
        data, current, memory = self.data, self.current, self._memory
        memory.begin()
        candidates = shortlist(data, current, self._gained, memory)
        fits = CandidateFits(data, current, self.noise_bounds, memory, self._gained)
        fits.add(candidates, tick)
        if fits.is_strained:  # widened tolerances may hide an effect, so search again with the specified ones
            if memory.at_specified is not None and fits.has_sure_winner():
                memory.has_passed = True
            else:
                told = replace(self.noise_bounds, max_scale=1.0)
                tight = fit(data, current.model, start_state(data, told), told, outer=1, inner=4)
                memory.at_specified = shortlist(data, tight, self._gained, memory)
            more = [c for c in memory.specified(current.model) if not any(is_same(c, o) for o in candidates)]
            fits.add(more[: SCAN.selection.max_candidates // 2], tick)
        fits.search()
        return fits.to_all_scans(), fits.behind

    def _against_refitted(self) -> float:
        """Return the evidence [nats] of the chosen effect over the present model, fitted again from its state."""
        again = self._fit(self.current.model, self._chosen.state, self.casts, 4)
        if again.j > self.current.j:
            self.current = again
            self.null = self.null if again.model else again
        return worth(self.data, self._chosen.model[-1], self._chosen, self.current)

    def _has_ended(self) -> bool:
        """Tell whether the last effects changed nothing, or were so small that the remaining ones are smaller still."""
        before, now = ({name_at_place(a) for a in one.model} for one in (self._before, self.current))
        is_same = bool(before) and before == now
        return self._n_small == 2 or (is_same and self.current.j < self._before.j + self.threshold)

    def added(self, model: list[Amendment]) -> None:
        """Take the fit with the effect, and merge it with an earlier one that is the same."""
        self._before = self.current
        self._n_small += self._chosen.model[-1].ratio < self.current.state.map_scale
        self._take(_merged(self.data, self._chosen, self.noise_bounds), model)

    def removed(self, model: list[Amendment]) -> None:
        """Take the fit without the effect, which is not tried again."""
        (index,) = (k for k, a in enumerate(self.current.model) if all(a is not one for one in model))
        gone = self.current.model[index]
        self._memory.struck.add((gone.name, gone.place))
        self._take(self._rests[index], model)

    def _take(self, fitted: Fitted, model: list[Amendment]) -> None:
        self.current, self._rests = fitted, {}
        model[:] = fitted.model

    def rest(self, index: int) -> Fitted:
        """Return the fit of the present model without one of its effects."""
        if index not in self._rests:
            self._rests[index] = self._fit(without(self.current.model, index), self.current.state, 2, 4)
        return self._rests[index]

    def evidence(self, model: Sequence[Amendment], hypothesis: Amendment) -> float:
        """Return the evidence [nats] for an effect in addition to the others; the last one has just been weighed."""
        index = next(k for k, a in enumerate(model) if a is hypothesis)
        if index == len(model) - 1:
            return math.inf
        return worth(self.data, hypothesis, self.current, self.rest(index))

    def needed(self, model: Sequence[Amendment], hypothesis: Amendment) -> float:
        """Return the evidence [nats] that an effect needs to stay."""
        return self.threshold

    def _fit(self, model: tuple[Amendment, ...], state: State, outer: int, inner: int) -> Fitted:
        return fit(self.data, model, state, self.noise_bounds, outer=outer, inner=inner)


def _best_of_each(tried: Sequence[tuple[Amendment, float]]) -> tuple[tuple[Amendment, float], ...]:
    """Keep the best start of each effect and place, best first."""
    out: dict[str, tuple[Amendment, float]] = {}
    for a, gain in sorted(tried, key=lambda t: -t[1]):
        out.setdefault(name_at_place(a), (a, gain))
    return tuple(out.values())


def _merged(data: ScanData, current: Fitted, noise_bounds: NoiseBounds) -> Fitted:
    """Replace two effects by fewer where these explain as much."""

    def net(fitted: Fitted) -> float:
        return fitted.j - sum(price(a, data) for a in fitted.model)

    for model in fewer_effects(current.model, data):
        got = fit(data, model, current.state, noise_bounds, outer=3, inner=5)
        if is_rough(got.model[-1]):
            got = searched(data, got, noise_bounds, rounds=2, first=0.25, turns=1)
        if net(got) > net(current):
            return _merged(data, got, noise_bounds)
    return current


def fewer_effects(model: Sequence[Amendment], data: ScanData) -> Iterator[Model]:
    """Yield models with fewer or simpler effects that may replace this one; new effects come last."""
    for i, j in permutations(range(len(model)), 2):
        if (whole := _whole_part(model[i], model[j])) is not None:
            yield (*without(model, i, j), whole)
    for i, j in combinations(range(len(model)), 2):
        if (both := _all_but_the_rest(model[i], model[j], data)) is not None:
            common, rest = both
            others = without(model, i, j)
            known = sum(a["b"] for a in others if a.effect is RANGE_BIAS)
            others = tuple(a for a in others if a.effect is not RANGE_BIAS)
            yield (*others, common.moved_to({"b": common["b"] + known}), rest)


def _whole_part(one: Amendment, other: Amendment) -> Amendment | None:
    """Return the first effect on both segments of a wall; None if they do not touch."""
    if one.place != other.place or not (one.effect.on_part_of_wall and other.effect.on_part_of_wall):
        return None
    gap = max(one["a"], other["a"]) - min(one["b"], other["b"])
    if gap > MAX_GAP:
        return None
    return one.moved_to({"a": min(one["a"], other["a"]), "b": max(one["b"], other["b"])})


def _all_but_the_rest(one: Amendment, other: Amendment, data: ScanData) -> tuple[Amendment, Amendment] | None:
    """Replace two sectors with biases of the same sign by a bias of all rays and one opposite sector; None otherwise."""
    if one.effect is not SECTOR_BIAS or other.effect is not SECTOR_BIAS or one["b"] * other["b"] <= 0:
        return None
    bearings = data.sensor.bearings
    between = [(one["theta2"], other["theta1"]), (other["theta2"], one["theta1"])]
    first, last = max(between, key=lambda ends: int(in_sector(bearings, *ends).sum()))
    mean = float(np.mean([one["b"], other["b"]]))
    return RANGE_BIAS(b=mean), one.moved_to({"theta1": first, "theta2": last, "b": -mean})
