"""Forward selection of effects by evidence: add one effect at a time, refit all jointly, remove superfluous ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from sensorgraph.diagnosis.scan.candidate_fits import CandidateFits, is_rough, searched
from sensorgraph.diagnosis.scan.first_gains import name_at_place
from sensorgraph.diagnosis.scan.fit import (
    Fitted,
    fit,
    start_state,
)
from sensorgraph.diagnosis.scan.merging import fewer_effects
from sensorgraph.diagnosis.scan.ranking import ranked
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.score_test import Candidate
from sensorgraph.diagnosis.scan.search_memory import SearchMemory
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.diagnosis.scan.shortlist import is_same, least_gain, shortlist
from sensorgraph.diagnosis.scan.site_variation import is_within_baseline
from sensorgraph.diagnosis.scan.standard_errors import standard_errors
from sensorgraph.diagnosis.scan.worth import led_on_plain_walls, price, worth
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import without
from sensorgraph.types import Progress, ProgressBars, no_progress


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """A round of the search: the effects that were tried, with their gains [nats]."""

    tried: tuple[tuple[Amendment, float], ...]
    chosen: str
    became: tuple[Amendment, ...] = ()
    """The model, if the chosen effect was merged with an earlier one or simplified."""


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


def explain(
    data: ScanData,
    noise_bounds: NoiseBounds,
    *,
    threshold: float = SCAN.selection.threshold,
    most: int = SCAN.selection.max_effects,
    progress: ProgressBars = no_progress,
) -> Explained:
    """Search for at most `most` effects with sufficient evidence; each round has a progress bar."""
    casts = 1 if data.posed is None else SCAN.fit.pose_casts
    with progress("fitting the simulator", ""):
        null = fit(data, (), start_state(data, noise_bounds), noise_bounds, outer=casts, inner=7)
    current, n_small = null, 0
    steps: list[Step] = []
    rivals: dict[str, tuple[Amendment, float]] = {}
    memory = SearchMemory()
    while len(current.model) < most:
        begun = current.j
        with progress(f"trying effects, round {len(steps) + 1}", "candidates") as tick:
            tried, also = _try(data, current, noise_bounds, memory, current.j - null.j, tick)
        tried = [t for t in tried if t[1] > SCAN.selection.hopeless_gain]
        if not tried:
            if not memory.repeat_in_full():
                break
            continue
        order = ranked(data, led_on_plain_walls(data, tried, current), threshold)
        best, gain = order[0]
        if gain >= threshold:
            again = fit(data, current.model, best.state, noise_bounds, outer=casts, inner=4)
            if again.j > current.j:
                current = again
                null = null if current.model else current
            gain = worth(data, best.model[-1], best, current)
        stood = memory.first.still_has(best.model[-1])
        enough = gain >= max(threshold, least_gain(current.model, best.model[-1], current.j - null.j, stood))
        steps.append(
            Step(
                tried=_best_of_each([*((f.model[-1], g) for f, g in order), *also]),
                chosen=best.model[-1].name if enough else "",
            )
        )
        if not enough and current.j > begun + SCAN.selection.min_refit_gain:
            continue  # the gains refer to a fit that had not converged
        if not enough:
            if not memory.repeat_in_full():
                break
            continue
        memory.is_lazy = True
        mine = name_at_place(best.model[-1])
        others = [*((f.model[-1], g) for f, g in order[1:]), *also]
        others = [(a, order[0][1] - g) for a, g in others if name_at_place(a) != mine]
        if others:
            rivals[mine] = min(others, key=lambda t: t[1])
        before, small = current, best.model[-1].ratio < current.state.map_scale
        pruned = _pruned(data, best, noise_bounds, threshold, memory.struck)
        current = _merged(data, pruned, noise_bounds)
        if current is not pruned:
            steps[-1] = replace(steps[-1], became=current.model)
        is_same = {name_at_place(a) for a in current.model} == {name_at_place(a) for a in before.model}
        if is_same and current.j < before.j + threshold:
            break
        n_small += small
        if n_small == 2:  # the remaining effects are smaller still
            break
    current = _without_usual(data, current, noise_bounds)
    gains, n = {}, len(current.model)
    with progress("weighing effects", "effects") as tick:
        for index in range(n):
            tick(index, n + 1)
            rest = fit(data, without(current.model, index), current.state, noise_bounds, outer=2, inner=4)
            one = current.model[index]
            gains[index] = worth(data, one, current, rest)
        tick(n, n + 1)
        errors = standard_errors(current, noise_bounds)
    kept = {i: rivals[name_at_place(a)] for i, a in enumerate(current.model) if name_at_place(a) in rivals}
    model = tuple(replace(a, stderr=e) for a, e in zip(current.model, errors, strict=True))
    final = replace(current, model=model)
    return Explained(
        null=null, final=final, gains=gains, steps=tuple(steps), rivals=kept, expected=memory.first.latest
    )


def _without_usual(data: ScanData, current: Fitted, noise_bounds: NoiseBounds) -> Fitted:
    """Remove sensor effects that are within the known-good runs of the site, the last found first.

    Next to a bias that exceeds the known-good runs, a drift within them would absorb half of it. A single effect is kept,
    because it absorbs nothing of another one.
    """
    for index in range(len(current.model) - 1, -1, -1):
        if len(current.model) > 1 and is_within_baseline(current, current.model[index]):
            current = fit(data, without(current.model, index), current.state, noise_bounds, outer=2, inner=4)
    return current


def _best_of_each(tried: Sequence[tuple[Amendment, float]]) -> tuple[tuple[Amendment, float], ...]:
    """Keep the best start of each effect and place, best first."""
    out: dict[str, tuple[Amendment, float]] = {}
    for a, gain in sorted(tried, key=lambda t: -t[1]):
        out.setdefault(name_at_place(a), (a, gain))
    return tuple(out.values())


def _try(
    data: ScanData,
    current: Fitted,
    noise_bounds: NoiseBounds,
    memory: SearchMemory,
    gained: float,
    tick: Progress,
) -> tuple[list[tuple[Fitted, float]], list[tuple[Amendment, float]]]:
    """Fit the most promising candidates; return (fit, gain [nats]), and (effect, gain) of those far behind."""
    memory.begin()
    candidates = shortlist(data, current, gained, memory)
    fits = CandidateFits(data, current, noise_bounds, memory, gained)
    fits.add(candidates, tick)
    if fits.is_strained:  # widened tolerances may hide an effect, so search again with the specified ones
        if memory.at_specified is not None and fits.has_sure_winner():
            memory.has_passed = True
        else:
            told = replace(noise_bounds, max_scale=1.0)
            tight = fit(data, current.model, start_state(data, told), told, outer=1, inner=4)
            memory.at_specified = shortlist(data, tight, gained, memory)
        more = [c for c in memory.specified(current.model) if not any(is_same(c, o) for o in candidates)]
        fits.add(more[: SCAN.selection.max_candidates // 2], tick)
    fits.search()
    return fits.to_all_scans(), fits.behind


def _pruned(
    data: ScanData, best: Fitted, noise_bounds: NoiseBounds, threshold: float, struck: set[tuple[str, str]]
) -> Fitted:
    """Remove earlier effects that the model no longer needs."""
    index = 0
    while len(best.model) > 1 and index < len(best.model) - 1:
        rest = fit(data, without(best.model, index), best.state, noise_bounds, outer=2, inner=4)
        one = best.model[index]
        if worth(data, one, best, rest) < threshold:
            struck.add((best.model[index].name, best.model[index].place))
            best = rest
            index = 0
        else:
            index += 1
    return best


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
