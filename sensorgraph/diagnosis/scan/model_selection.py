"""Forward selection of effects by evidence: add one effect at a time, refit all jointly, remove superfluous ones."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from sensorgraph.diagnosis.scan.first_gains import FirstGains, name_at_place
from sensorgraph.diagnosis.scan.fit import (
    Fitted,
    fit,
    polish,
    start_state,
    thin,
    thin_state,
)
from sensorgraph.diagnosis.scan.materiality import is_short_of_pixels
from sensorgraph.diagnosis.scan.merging import fewer_effects
from sensorgraph.diagnosis.scan.propose import proposed_candidates
from sensorgraph.diagnosis.scan.ranking import ranked
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.score_test import Candidate, smooth_candidates
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.diagnosis.scan.site_clutter import surely_stands
from sensorgraph.diagnosis.scan.site_variation import is_within_baseline
from sensorgraph.diagnosis.scan.spread_evidence import evidence
from sensorgraph.diagnosis.scan.standard_errors import standard_errors
from sensorgraph.diagnosis.scan.worth import led_on_plain_walls, price, worth
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import without
from sensorgraph.effects.shared import STRETCHED
from sensorgraph.types import Progress, ProgressBars, no_progress

logger = logging.getLogger(__name__)


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
    struck, first = set[tuple[str, str]](), FirstGains()
    while len(current.model) < most:
        begun = current.j
        with progress(f"trying effects, round {len(steps) + 1}", "candidates") as tick:
            tried, also = _try(data, current, noise_bounds, struck, first, current.j - null.j, tick)
        tried = [t for t in tried if t[1] > SCAN.selection.hopeless_gain]
        if not tried:
            break
        order = ranked(data, led_on_plain_walls(data, tried, current), threshold)
        best, gain = order[0]
        if gain >= threshold:
            again = fit(data, current.model, best.state, noise_bounds, outer=casts, inner=4)
            if again.j > current.j:
                current = again
                null = null if current.model else current
            gain = worth(data, best.model[-1], best, current)
        stood = first.still_has(best.model[-1])
        enough = gain >= max(threshold, _least(current.model, best.model[-1], current.j - null.j, stood))
        steps.append(
            Step(
                tried=_best_of_each([*((f.model[-1], g) for f, g in order), *also]),
                chosen=best.model[-1].name if enough else "",
            )
        )
        if not enough and current.j > begun + SCAN.selection.min_refit_gain:
            continue  # the gains refer to a fit that had not converged
        if not enough:
            break
        mine = best.model[-1]
        others = [*((f.model[-1], g) for f, g in order[1:]), *also]
        others = [(a, g) for a, g in others if (a.name, a.place) != (mine.name, mine.place)]
        if others:
            rival, nats = max(others, key=lambda t: t[1])
            rivals[name_at_place(mine)] = (rival, order[0][1] - nats)
        before, small = current, best.model[-1].ratio < current.state.map_scale
        pruned = _pruned(data, best, noise_bounds, threshold, struck)
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
        null=null, final=final, gains=gains, steps=tuple(steps), rivals=kept, expected=first.latest
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


def _least(model: Sequence[Amendment], candidate: Amendment, gained: float, stood: bool) -> float:
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


def _try(
    data: ScanData,
    current: Fitted,
    noise_bounds: NoiseBounds,
    struck: set[tuple[str, str]],
    first: FirstGains,
    gained: float,
    tick: Progress,
) -> tuple[list[tuple[Fitted, float]], list[tuple[Amendment, float]]]:
    """Fit the most promising candidates; return (fit, gain [nats]), and (effect, gain) of those far behind.

    All candidates are fitted to a part of the scans. The rough parameters of the best ones are searched, and only those
    that come close to the best are fitted to all scans.
    """
    noise = current.state.noise
    stretched = current.state.stretch > SCAN.nuisance.stretched_scale
    strained = noise_bounds.max_scale > 1.0 and (
        stretched or noise.core > SCAN.sweep.max_core or noise.tail > SCAN.sweep.max_tail
    )
    short = shortlist(data, current, struck, gained, first)
    if strained:  # widened tolerances may hide an effect, so search again with the specified ones
        told = replace(noise_bounds, max_scale=1.0)
        tight = fit(data, current.model, start_state(data, told), told, outer=1, inner=4)
        more = shortlist(data, tight, struck, gained, first)
        short += [c for c in more if not any(_same(c.amendment, o.amendment) for o in short)][
            : SCAN.selection.max_candidates // 2
        ]
    if not short:
        return [], []
    every = max(1, data.n_scans // SCAN.selection.n_scans, -(-data.ranges.size // SCAN.selection.n_readings))
    few = thin(data, every)
    base = fit(few, current.model, thin_state(current.state, every), noise_bounds, outer=1, inner=2)
    fresh = start_state(few, noise_bounds) if strained else base.state
    quick: list[tuple[float, Fitted]] = []
    for done, candidate in enumerate(short):
        tick(done, len(short))
        got = fit(
            few,
            (*current.model, candidate.amendment),
            fresh,
            noise_bounds,
            outer=3,
            inner=3 if strained else 2,
        )
        if data.grain > 0 and is_short_of_pixels(data, got.model[-1]):
            continue
        gain = evidence(few, got.model[-1], got, base) * every
        quick.append((gain - price(candidate.amendment, data), got))
    if not quick:
        return [], []
    quick.sort(key=lambda pair: -pair[0])
    for k, (gain, got) in enumerate(quick[: SCAN.selection.max_searched]):
        if gain > SCAN.selection.searched_share * quick[0][0] - SCAN.selection.gain_margin and is_rough(
            got.model[-1]
        ):
            better = searched(
                few, got, noise_bounds, rounds=4, first=1.0, turns=3 if got.model[-1].effect.absorber else 1
            )
            quick[k] = (gain + (better.j - got.j) * every, better)
    quick.sort(key=lambda pair: -pair[0])
    logger.debug("quick %s", [(f.model[-1].name, f.model[-1].place, round(g)) for g, f in quick])
    finalists = quick[: SCAN.selection.max_finalists]
    plain = [q for q in quick if not q[1].model[-1].effect.absorber]
    if finalists[0][1].model[-1].effect.absorber and plain and plain[0] not in finalists:
        finalists.append(plain[0])
    out, also = [], []
    for gain, got in finalists:
        if gain < SCAN.selection.finalist_share * finalists[0][0] - SCAN.selection.gain_margin:
            also.append((got.model[-1], gain))
            continue
        begin = start_state(data, noise_bounds) if strained else current.state
        full = fit(data, got.model, begin, noise_bounds, outer=3, inner=5 if strained else 3)
        if is_rough(full.model[-1]):
            full = searched(data, full, noise_bounds, rounds=2, first=0.25, turns=1)
        out.append((full, worth(data, full.model[-1], full, current)))
    return out, also


def is_rough(amendment: Amendment) -> bool:
    """Return whether an effect has parameters that are found by search instead of the linear solve."""
    return bool(amendment.search_steps)


def searched(
    data: ScanData, got: Fitted, noise_bounds: NoiseBounds, *, rounds: int, first: float, turns: int
) -> Fitted:
    """Search the rough parameters of the last effect, then fit again."""
    strained = got.state.stretch > SCAN.nuisance.stretched_scale
    for _ in range(turns):
        polished = polish(
            data, got.model, len(got.model) - 1, got.state, noise_bounds, rounds=rounds, first=first
        )
        better = fit(data, polished, got.state, noise_bounds, outer=1, inner=4 if strained else 2)
        gained = better.j - got.j
        if gained > 0:
            got = better
        if gained < 2:
            break
    return got


def shortlist(
    data: ScanData,
    current: Fitted,
    struck: set[tuple[str, str]],
    gained: float,
    first: FirstGains | None = None,
) -> list[Candidate]:
    """Return the candidates to fit, best first.

    Parameters
    ----------
    struck : Effects and places that were removed from the model.
    gained : [nats] Gain of the model so far; the remainders that its effects may leave are a share of it.
    first : Gains expected in the bare model. They are stored there, and dropped when they change.
    """
    smooth = smooth_candidates(data, current)
    sharp = [c for c in smooth if c.gain > SCAN.selection.min_expected_gain]
    broad = [
        c
        for c in smooth_candidates(data, current, broad=True)
        if c.gain > 2 * SCAN.selection.min_expected_gain
    ]
    rough = proposed_candidates(FitResiduals(data, current))
    if data.clutter_nats:
        rough.sort(key=lambda c: not surely_stands(c.amendment, data))
    first = FirstGains() if first is None else first
    first.compare((*sharp, *rough, *broad), is_first=not current.model)
    first.note((*smooth, *rough))
    present = {name_at_place(a) for a in current.model}
    out: list[Candidate] = []
    seen: dict[str, int] = {}
    for group, most in ((sharp, 5), (rough, 8), (broad, 4)):
        taken = 0
        for c in group:
            key = name_at_place(c.amendment)
            single = c.amendment.effect.place is None
            if key in present and (single or c.amendment.effect.place in ("wall", "obstacle")):
                continue
            if (c.amendment.name, c.amendment.place) in struck:
                continue
            if not data.may_show(c.amendment.effect, c.amendment.place):
                continue
            if data.from_scans and _stretches(c.amendment) and any(map(_stretches, current.model)):
                continue  # the poses have been scaled with the map, so the scales of map and laser are equivalent
            if c.gain < _least(current.model, c.amendment, gained, first.has(c)):
                continue
            if any(_same(c.amendment, o.amendment) for o in out) or seen.get(c.amendment.name, 0) >= 3:
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
    return amendment.effect.diagnostics.telltale == STRETCHED


def _same(a: Amendment, b: Amendment) -> bool:
    """Return whether two starts are so close that a single fit is sufficient."""
    if a.name != b.name or a.place != b.place:
        return False
    sizes = a.effect.sizes
    if not sizes:
        return True
    apart = sum(((a[k] - b[k]) / m) ** 2 for k, m in sizes.items()) ** 0.5
    return bool(apart < 3.0) and a.effect.place not in ("spot", "sector")


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
