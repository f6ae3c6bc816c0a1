"""Fit the candidates of a round: to a part of the scans those that may win, to all scans those close to the best.

They are ranked by evidence; at a known site, what may be clutter comes last.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted, bare_cast, fit, polish, start_state, thin, thin_state
from sensorgraph.diagnosis.scan.materiality import is_short_of_pixels
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.score_test import Candidate
from sensorgraph.diagnosis.scan.search_memory import SearchMemory
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.diagnosis.scan.shortlist import least_gain
from sensorgraph.diagnosis.scan.worth import evidence, price, surely_stands, worth
from sensorgraph.effects import Amendment
from sensorgraph.effects.places import named_walls
from sensorgraph.types import Bools, Progress

logger = logging.getLogger(__name__)


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
        noise = current.state.noise
        stretched = current.state.stretch > SCAN.nuisance.stretched_scale
        self.is_strained = noise_bounds.max_scale > 1.0 and (stretched or noise.core > SCAN.sweep.max_core)
        """Whether widened tolerances may hide an effect. All fits then start at the specified ones."""
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
        return self._limit(SCAN.selection.finalist_share) >= max(SCAN.selection.threshold, least)

    def add(self, candidates: Sequence[Candidate], tick: Progress) -> None:
        """Fit candidates to a part of the scans, except for those whose earlier gain is far behind the best."""
        few = thin(self.data, self._every)
        for done, candidate in enumerate(self.memory.most_promising_first(candidates)):
            tick(done, len(candidates))
            bound = self.memory.bound(candidate)
            if self.has_sure_winner() and bound < self._limit(SCAN.selection.searched_share):
                self.behind.append((candidate.amendment, bound))
                self.memory.has_passed = True
                continue
            self._fit(few, candidate)

    def _fit(self, few: ScanData, candidate: Candidate) -> None:
        """Fit one candidate to a part of the scans."""
        if self._base is None:
            state = thin_state(self.current.state, self._every)
            self._base = fit(few, self.current.model, state, self.noise_bounds, outer=1, inner=2)
        start = start_state(few, self.noise_bounds) if self.is_strained else self._base.state
        model = (*self.current.model, candidate.amendment)
        got = fit(few, model, start, self.noise_bounds, outer=3, inner=3 if self.is_strained else 2)
        if self.data.grain > 0 and is_short_of_pixels(self.data, got.model[-1]):
            return
        gain = evidence(few, got.model[-1], got, self._base) * self._every
        gain -= price(candidate.amendment, self.data)
        self.memory.note(candidate, gain)
        self.quick.append((gain, got))

    def _limit(self, share: float) -> float:
        """Return the gain [nats] of a share of the best one, less the error of gains of a part of the scans."""
        return share * self.best - SCAN.selection.gain_margin

    def search(self) -> None:
        """Search the rough parameters of the best candidates."""
        self.quick.sort(key=lambda pair: -pair[0])
        few, limit = thin(self.data, self._every), self._limit(SCAN.selection.searched_share)
        for k, (gain, got) in enumerate(self.quick[: SCAN.selection.max_searched]):
            if gain > limit and is_rough(got.model[-1]):
                turns = 3 if got.model[-1].effect.absorber else 1
                better = searched(few, got, self.noise_bounds, rounds=4, first=1.0, turns=turns)
                self.quick[k] = (gain + (better.j - got.j) * self._every, better)
        self.quick.sort(key=lambda pair: -pair[0])
        logger.debug("quick %s", [(f.model[-1].name, f.model[-1].place, round(g)) for g, f in self.quick])

    def to_all_scans(self) -> list[tuple[Fitted, float]]:
        """Fit the candidates that come close to the best to all scans; return the fits with their gains [nats]."""
        finalists = self.quick[: SCAN.selection.max_finalists]
        plain = [q for q in self.quick if not q[1].model[-1].effect.absorber]
        if finalists and finalists[0][1].model[-1].effect.absorber and plain and plain[0] not in finalists:
            finalists.append(plain[0])
        out = []
        for gain, got in finalists:
            if gain < self._limit(SCAN.selection.finalist_share):
                self.behind.append((got.model[-1], gain))
                continue
            begin = start_state(self.data, self.noise_bounds) if self.is_strained else self.current.state
            inner = 5 if self.is_strained else 3
            full = fit(self.data, got.model, begin, self.noise_bounds, outer=3, inner=inner)
            if is_rough(full.model[-1]):
                full = searched(self.data, full, self.noise_bounds, rounds=2, first=0.25, turns=1)
            out.append((full, worth(self.data, full.model[-1], full, self.current)))
        return out


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


def ranked(data: ScanData, tried: Sequence[tuple[Fitted, float]]) -> list[tuple[Fitted, float]]:
    """Return the tried effects in order of their evidence; at a known site, possible clutter comes only if nothing else does.

    Parameters
    ----------
    tried : Fits, each with the gain [nats] of the last effect in its model.
    """
    order = sorted(without_ends(data, tried), key=lambda pair: -pair[1])
    if not data.clutter_nats:
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
        near = np.minimum(np.abs(along - a["a"]), np.abs(along - a["b"])) < SCAN.selection.end_blur * blur
    return np.asarray(on & near)
