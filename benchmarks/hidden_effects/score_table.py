"""The table of scores: shares, gaps, calibration and CPU time, each with its target."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.hidden_effects.results import Case, found_effects, is_placed, parameters_within

STRETCHED = 1.3
"""Times the stated tolerances, from which a report says that they are wrong."""


@dataclass(frozen=True, kw_only=True)
class ScoreRow:
    """A number and what it should be."""

    what: str
    value: float | None
    of: str
    target: str
    is_met: bool | None

    def text(self) -> str:
        """Return the row as a line."""
        mark = {True: "ok", False: "SHORT", None: "-"}[self.is_met]
        value = "-" if self.value is None else f"{self.value:.3f}" if self.value < 10 else f"{self.value:.1f}"
        return f"{self.what:62s} {value:>8s}  {self.of:>12s}  {self.target:>9s}  {mark}"


def _share(
    what: str,
    cases: Sequence[Any],
    good: Callable[[Any], bool],
    *,
    least: float | None = None,
    most: float | None = None,
) -> ScoreRow:
    n, k = len(cases), sum(bool(good(case)) for case in cases)
    value = k / n if n else None
    met: bool | None = None
    if value is not None and (least is not None or most is not None):
        met = (least is None or value >= least) and (most is None or value <= most)
    target = (
        f">= {100 * least:g} %" if least is not None else f"<= {100 * most:g} %" if most is not None else ""
    )
    return ScoreRow(what=what, value=value, of=f"{k} of {n}", target=target, is_met=met)


def _below(
    what: str, values: Sequence[float], bound: float | None, statistic: Callable[[Any], float]
) -> ScoreRow:
    value = float(statistic(np.array(values))) if len(values) else None
    met = None if value is None or bound is None else value <= bound
    return ScoreRow(
        what=what,
        value=value,
        of=f"n = {len(values)}",
        target="" if bound is None else f"<= {bound:g}",
        is_met=met,
    )


def table(cases: Sequence[Case]) -> list[ScoreRow]:
    """Return all rows."""
    return [
        *_single_rows([c for c in cases if c.suite == "singles"]),
        *_none_rows([c for c in cases if c.suite == "none"]),
        *_several_rows(cases),
        *_foreign_rows(cases),
        *_gap_rows(cases),
        *_parameter_rows(cases),
        *_time_rows(cases),
        _share("no report", cases, lambda c: c.report is None, most=0.0),
    ]


def _single_rows(singles: Sequence[Case]) -> list[ScoreRow]:
    """Is the one hidden effect named, and nothing else?"""
    material = [c for c in singles if c.is_material]
    unmarked = [c for c in singles if not c.is_material and not c.is_below_materiality]
    rows = []
    for background, least in (("clean", 0.97), ("dirty", 0.93), ("wrong_tolerances", None)):
        chosen = [c for c in material if c.background == background]
        effects = len({c.names[0] for c in chosen})
        what = f"material single, first name right, {background} ({effects} effects)"
        rows.append(_share(what, chosen, lambda c: c.is_first_right, least=least))
    for background, least in (("dirty", 0.99), ("clean", None)):
        of_background = [c for c in material if c.background == background]
        twice = [c for c in of_background if (c.hidden[0]["materiality_ratio"] or 0) >= 2]
        what = f"... at twice the materiality or more, {background}"
        rows.append(_share(what, twice, lambda c: c.is_first_right, least=least))
    for background in ("clean", "dirty"):
        of_background = [c for c in material if c.background == background]
        sizeless = [c for c in of_background if c.hidden[0]["materiality_ratio"] is None]
        rows.append(_share(f"... effects without a size, {background}", sizeless, lambda c: c.is_first_right))
    below = [c for c in singles if c.is_below_materiality]
    return [
        *rows,
        _share("... below it: silent", below, lambda c: not c.reported_names, least=0.98),
        _share("no mark in the run: silent or right", unmarked, lambda c: not c.wrong_names),
        _share("named wrongly first (singles)", singles, lambda c: c.is_first_wrong, most=0.005),
        _share("any wrong name (singles)", singles, lambda c: bool(c.wrong_names)),
    ]


def _none_rows(none: Sequence[Case]) -> list[ScoreRow]:
    """Is nothing named where nothing is hidden?"""
    rows = []
    for background, most in (("clean", 0.0), ("dirty", 0.0), ("wrong_tolerances", 0.02)):
        chosen = [c for c in none if c.background == background]
        what = f"false name on none, {background}"
        rows.append(_share(what, chosen, lambda c: bool(c.reported_names), most=most))
    wrong = [c for c in none if c.background == "wrong_tolerances"]
    return [
        *rows,
        _share("unknown said on none", none, lambda c: c.is_unknown),
        _share("tolerances 2-3 x wrong: agrees without saying so", wrong, _agrees_as_stated, most=0.0),
    ]


def _agrees_as_stated(case: Case) -> bool:
    """Tell whether a report says that all is well with the tolerances of the robot file."""
    scales = [(case.report or {}).get(key) for key in ("map_scale", "pose_scale")]
    said = any(isinstance(scale, (int, float)) and scale >= STRETCHED for scale in scales)
    return not (case.reported_names or case.is_unknown or said)


def _several_rows(cases: Sequence[Case]) -> list[ScoreRow]:
    """Are all of two or three hidden effects named?"""
    rows = []
    for suite, n, all_named, exactly in (("pairs", "both", 0.95, 0.90), ("triples", "all", 0.80, None)):
        chosen = [c for c in cases if c.suite == suite]
        rows += [
            _share(
                f"{suite}: {n} named",
                chosen,
                lambda c: set(c.names) <= set(c.reported_names),
                least=all_named,
            ),
            _share(f"{suite}: exactly these", chosen, lambda c: c.is_right, least=exactly),
        ]
    return rows


def _foreign_rows(cases: Sequence[Case]) -> list[ScoreRow]:
    """Is an effect outside the library said to be unknown, and no other?"""
    foreign = [c for c in cases if c.suite == "foreign"]
    right = [c for c in cases if c.hidden and c.is_right]
    return [
        _share("outside the library: said to be unknown", foreign, lambda c: c.is_unknown, least=0.95),
        _share("... with no library name left", foreign, lambda c: not c.reported_names, least=0.80),
        _share("... right answers wrongly doubted", right, lambda c: c.is_unknown, most=0.02),
    ]


def _gap_rows(cases: Sequence[Case]) -> list[ScoreRow]:
    after, before = _gaps(cases)
    return [
        _below("gap before over the none floor, median", before, None, np.median),
        _below("gap after over the none floor, median", after, 1.03, np.median),
        _below("gap after over the none floor, 95 %", after, 1.08, lambda v: np.quantile(v, 0.95)),
    ]


def _parameter_rows(cases: Sequence[Case]) -> list[ScoreRow]:
    """Are place, parameters and probabilities of the effects that were named right?"""
    found = list(found_effects(cases))
    placed = [(true, said) for _, true, said in found if true["location"]]
    inside = [ok for _, true, said in found for _, ok in parameters_within(true, said)]
    _, error, n_stated = calibration(cases)
    return [
        _share(
            "place (wall, obstacle or spot within 0.3 m)", placed, lambda pair: is_placed(*pair), least=0.99
        ),
        _share("true parameters within 2 s.e.", inside, bool, least=0.95),
        ScoreRow(
            what="calibration error of the stated probability",
            value=error,
            of=f"n = {n_stated}",
            target="<= 0.03",
            is_met=None if error is None else error <= 0.03,
        ),
    ]


def _time_rows(cases: Sequence[Case]) -> list[ScoreRow]:
    bounds = {"none": 2.0, "singles": 3.0, "pairs": 5.0, "triples": None, "foreign": None}
    rows = []
    for suite, bound in bounds.items():
        seconds = [c.cpu_s for c in cases if c.suite == suite and c.cpu_s is not None]
        rows.append(_below(f"CPU time [s], {suite}, median", seconds, bound, np.median))
    diagnosis = [c.cpu_s for c in cases if c.cpu_s is not None]
    command = [c.command_s for c in cases if c.command_s is not None]
    return [
        *rows,
        _below("CPU time [s], all, 95 %", diagnosis, None, lambda v: np.quantile(v, 0.95)),
        _below("CPU time [s] of the command with its pictures, all, median", command, None, np.median),
    ]


def _gaps(cases: Sequence[Case]) -> tuple[list[float], list[float]]:
    """Return gap after and before over the none floor, of right answers on deterministic material effects."""
    floors: dict[str, list[float]] = defaultdict(list)
    for case in cases:
        value = _normalised(case, "after")
        if case.suite == "none" and value is not None:
            floors[case.background].append(value)
    after, before = [], []
    for case in cases:
        if not (case.hidden and case.is_material and case.is_right):
            continue
        if not all(effect["deterministic"] and effect["channel"] == "scan" for effect in case.hidden):
            continue
        own, now, then = (_normalised(case, key) for key in ("noise_floor", "after", "before"))
        floor = float(np.median(floors[case.background])) if floors[case.background] else own
        if floor and now is not None and then is not None:
            after.append(now / floor)
            before.append(then / floor)
    return after, before


def _normalised(case: Case, key: str) -> float | None:
    block = ((case.report or {}).get("gap") or {}).get(key)
    value = block.get("normalised") if isinstance(block, dict) else block
    return float(value) if isinstance(value, (int, float)) and math.isfinite(value) else None


def calibration(cases: Sequence[Case]) -> tuple[list[tuple[float, float, float, int]], float | None, int]:
    """Return reliability bins (edge, mean stated, share right, count), the calibration error, the count."""
    stated = [
        (float(said["probability"]), float(said["name"] in case.names))
        for case in cases
        for said in case.reported
        if said.get("probability") is not None
    ]
    if not stated:
        return [], None, 0
    p, right = np.array(stated).T
    edges = np.array([0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0 + 1e-9])
    bins, error = [], 0.0
    for low, high in itertools.pairwise(edges):
        inside = (p >= low) & (p < high)
        if inside.any():
            bins.append((float(low), float(p[inside].mean()), float(right[inside].mean()), int(inside.sum())))
            error += inside.mean() * abs(p[inside].mean() - right[inside].mean())
    return bins, float(error), len(p)
