"""Effects of the scans as hypotheses of the engine: try further effects, and refit all jointly.

The candidates of a round that may win are fitted to a part of the scans, and those close to the best to all scans. They are ranked by
evidence; at a known site, what may be clutter comes last. `engine.selection.select` adds and removes them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sensorgraph.diagnosis.engine.selection import select
from sensorgraph.diagnosis.scan.candidates import SearchMemory, least_gain, name_at_place, searched, shortlist
from sensorgraph.diagnosis.scan.fit import Fitted, bare_cast, bare_fit, fit, thin, thin_state
from sensorgraph.diagnosis.scan.nuisance import State
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.score_test import Candidate
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.diagnosis.scan.standard_errors import standard_errors
from sensorgraph.diagnosis.scan.worth import evidence, price, surely_stands, worth
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import without
from sensorgraph.effects.places import named_walls
from sensorgraph.types import Bools, Progress, ProgressBars, no_progress


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
        with progress("fitting the simulator", ""):
            self.null = bare_fit(data, noise_bounds)
        self.current = self.null
        self.steps: list[Step] = []
        self.rivals: dict[str, tuple[Amendment, float]] = {}
        """Effect at its place -> the second best explanation when it entered, and its deficit [nats]."""
        self._memory = SearchMemory()
        self._chosen = self.null
        self._rests: dict[int, Fitted] = {}
        """Index in the model -> the fit without this effect."""

    @property
    def expected(self) -> Mapping[str, Candidate]:
        """Name of each effect -> its best start in the last round, whether or not it was fitted."""
        return self._memory.latest

    def best(self, model: Sequence[Amendment]) -> tuple[Amendment, float] | None:
        """Return the best further effect and its evidence [nats], in as many rounds of fits as this needs."""
        memory = self._memory
        while True:
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
            stood = name_at_place(effect) in memory.standing
            enough = gain >= max(self.threshold, least_gain(self.current.model, effect, self._gained, stood))
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
        fits.search()
        return fits.to_all_scans(), fits.behind

    def _against_refitted(self) -> float:
        """Return the evidence [nats] of the chosen effect over the present model, fitted again from its state."""
        again = self._fit(self.current.model, self._chosen.state)
        if again.j > self.current.j:
            self.current = again
            self.null = self.null if again.model else again
        return worth(self.data, self._chosen.model[-1], self._chosen, self.current)

    def added(self, model: list[Amendment]) -> None:
        """Take the fit with the effect; the one without it is that which it was compared with."""
        rest = self.current
        self._take(self._chosen, model)
        self._rests[len(model) - 1] = rest

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
            self._rests[index] = self._fit(without(self.current.model, index), self.current.state)
        return self._rests[index]

    def evidence(self, model: Sequence[Amendment], hypothesis: Amendment) -> float:
        """Return the evidence [nats] for an effect in addition to the others; the last one has just been weighed."""
        index = next(k for k, a in enumerate(model) if a is hypothesis)
        if index == len(model) - 1:
            return math.inf
        return worth(self.data, hypothesis, self.current, self.rest(index))

    def _fit(self, model: tuple[Amendment, ...], state: State) -> Fitted:
        return fit(self.data, model, state, self.noise_bounds)


def _best_of_each(tried: Sequence[tuple[Amendment, float]]) -> tuple[tuple[Amendment, float], ...]:
    """Keep the best start of each effect and place, best first."""
    out: dict[str, tuple[Amendment, float]] = {}
    for a, gain in sorted(tried, key=lambda t: -t[1]):
        out.setdefault(name_at_place(a), (a, gain))
    return tuple(out.values())


class CandidateFits:
    """Fits of a round, each to the model so far with one candidate."""

    def __init__(
        self,
        data: ScanData,
        current: Fitted,
        noise_bounds: NoiseBounds,
        memory: SearchMemory,
        gained: float,
    ) -> None:
        self.data, self.current, self.noise_bounds, self.memory = data, current, noise_bounds, memory
        self._gained = gained
        self.quick: list[tuple[float, Fitted]] = []
        """Gains [nats] and fits to a part of the scans."""
        self.behind: list[tuple[Amendment, float]] = []
        """Effects far behind the best, with their gains [nats]."""
        by_readings = -(-data.ranges.size // SCAN.selection.n_readings)
        self._every = max(1, data.n_scans // SCAN.selection.n_scans, by_readings)
        self._base: Fitted | None = None

    @property
    def best(self) -> float:
        """[nats] Largest gain of the fits to a part of the scans."""
        return max((gain for gain, _ in self.quick), default=-math.inf)

    def has_sure_winner(self) -> bool:
        """Return whether an effect surely enters the model, even if the fit to all scans gains less."""
        if not self.memory.is_lazy or not self.quick:
            return False
        _, got = max(self.quick, key=lambda pair: pair[0])
        least = least_gain(self.current.model, got.model[-1], self._gained, stood=False)
        return self._limit() >= max(SCAN.selection.threshold, least)

    def add(self, candidates: Sequence[Candidate], tick: Progress) -> None:
        """Fit candidates to a part of the scans, except for those whose earlier gain is far behind the best."""
        few = thin(self.data, self._every)
        for done, candidate in enumerate(self.memory.most_promising_first(candidates)):
            tick(done, len(candidates))
            bound = self.memory.bound(candidate)
            if self.has_sure_winner() and bound < self._limit():
                self.behind.append((candidate.amendment, bound))
                self.memory.has_passed = True
                continue
            self._fit(few, candidate)

    def _fit(self, few: ScanData, candidate: Candidate) -> None:
        """Fit one candidate to a part of the scans."""
        if self._base is None:
            state = thin_state(self.current.state, self._every)
            self._base = fit(few, self.current.model, state, self.noise_bounds)
        model = (*self.current.model, candidate.amendment)
        got = fit(few, model, self._base.state, self.noise_bounds)
        gain = evidence(few, got.model[-1], got, self._base) * self._every
        gain -= price(candidate.amendment, self.data)
        self.memory.note(candidate, gain)
        self.quick.append((gain, got))

    def _limit(self) -> float:
        """Return the gain [nats] that comes close to the best one, less the error of gains of a part of the scans."""
        return SCAN.selection.finalist_share * self.best - SCAN.selection.gain_margin

    def search(self) -> None:
        """Search the rough parameters of the best candidates."""
        self.quick.sort(key=lambda pair: -pair[0])
        few, limit = thin(self.data, self._every), self._limit()
        for k, (gain, got) in enumerate(self.quick[: SCAN.selection.max_finalists]):
            if gain > limit and got.model[-1].search_steps:
                turns = 3 if got.model[-1].effect.absorber else 1
                better = searched(few, got, self.noise_bounds, rounds=4, first=1.0, turns=turns)
                self.quick[k] = (gain + (better.j - got.j) * self._every, better)
        self.quick.sort(key=lambda pair: -pair[0])

    def to_all_scans(self) -> list[tuple[Fitted, float]]:
        """Fit the candidates that come close to the best to all scans; return the fits with their gains [nats]."""
        finalists = self.quick[: SCAN.selection.max_finalists]
        plain = [q for q in self.quick if not q[1].model[-1].effect.absorber]
        if finalists and finalists[0][1].model[-1].effect.absorber and plain and plain[0] not in finalists:
            finalists.append(plain[0])
        out = []
        for gain, got in finalists:
            if gain < self._limit():
                self.behind.append((got.model[-1], gain))
                continue
            full = fit(self.data, got.model, self.current.state, self.noise_bounds)
            if full.model[-1].search_steps:
                full = searched(self.data, full, self.noise_bounds, rounds=2, first=0.25, turns=1)
            out.append((full, worth(self.data, full.model[-1], full, self.current)))
        return out


def ranked(data: ScanData, tried: Sequence[tuple[Fitted, float]]) -> list[tuple[Fitted, float]]:
    """Return the tried effects in order of their evidence; at a known site, possible clutter comes only if nothing else does.

    Parameters
    ----------
    tried : Fits, each with the gain [nats] of the last effect in its model.
    """
    order = sorted(without_ends(data, tried), key=lambda pair: -pair[1])
    if not data.site.is_known:
        return order
    certain = [pair for pair in order if not _may_be_clutter(pair, data)]
    # possible clutter waits, because it would absorb the readings of other effects
    if any(gain >= SCAN.selection.threshold for _, gain in certain):
        order = certain
    return order


def _may_be_clutter(pair: tuple[Fitted, float], data: ScanData) -> bool:
    """Return whether an object in the room may be clutter of the building."""
    amendment = pair[0].model[-1]
    return amendment.effect.place == "spot" and not surely_stands(amendment, data)


def without_ends(data: ScanData, tried: Sequence[tuple[Fitted, float]]) -> Sequence[tuple[Fitted, float]]:
    """Compare panes, mirrors and black parts of one wall on the rays that clearly meet or clearly miss them.

    A ray near an end may be on either side of it. That costs an effect with certain loss more likelihood than
    one with probable loss.
    """
    order = sorted(tried, key=lambda pair: -pair[1])
    best, gain = order[0]
    if not best.model[-1].effect.on_part_of_wall:
        return tried
    out = [order[0]]
    for got, nats in order[1:]:
        a = got.model[-1]
        if a.effect.on_part_of_wall and a.place == best.model[-1].place:
            clear = ~(_near_ends(data, best) | _near_ends(data, got))
            nats = gain - float(
                (best.solution.responsibilities.log_p - got.solution.responsibilities.log_p)[clear].sum()
            )
        out.append((got, nats))
    return out


def _near_ends(data: ScanData, fitted: Fitted) -> Bools:
    """Return which rays (n_scans, n_rays) meet the wall of the last effect within a few blur widths of one of its ends."""
    a, t, scene = fitted.model[-1], data.tolerances, fitted.cast.scene
    bare = bare_cast(scene)
    on = np.isin(bare.wall, named_walls(data.arena, a.place))
    blur = (t.pose_xy + t.pose_yaw * bare.ranges) / np.maximum(bare.cosine, 0.1) + t.map
    with np.errstate(invalid="ignore"):
        along = bare.along(scene.walls)
        near = (
            np.minimum(np.abs(along - a["a"]), np.abs(along - a["b"])) < SCAN.nuisance.max_tolerances * blur
        )
    return np.asarray(on & near)
