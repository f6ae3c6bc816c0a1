"""Compare answers with the truth: scores with their targets, confusion, calibration, failures; entrants side by side.

A case without a report counts as silent and is listed. Below materiality means a size below it; effects without a mark in
the run stand apart. A target belongs to the product of this repository.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from benchmarks.hidden_effects.results import Case, found_effects, is_placed, parameters_within

STRETCHED = 1.3
"""Times the stated tolerances, from which a report says that they are wrong."""
PROBABILITY_BINS = np.array([0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0 + 1e-9])
Claim = Callable[[Case], bool]
Row = tuple[str, float | None, str, str, bool | None]
"""What, value, of how many, target, whether it is met."""


def _line(row: Row) -> str:
    what, value, of, target, is_met = row
    number = "-" if value is None else f"{value:.3f}" if value < 10 else f"{value:.1f}"
    return f"{what:62s} {number:>8s}  {of:>12s}  {target:>9s}  { {True: 'ok', False: 'SHORT', None: '-'}[is_met] }"


def _share(what: str, right: Iterable[bool], least: float | None = None, most: float | None = None) -> Row:
    """Return a row about the share of what is right, at least or at most so much."""
    answers = list(right)
    k, n = sum(answers), len(answers)
    value = k / n if n else None
    target = (
        f">= {100 * least:g} %" if least is not None else f"<= {100 * most:g} %" if most is not None else ""
    )
    is_met = None
    if value is not None and target:
        is_met = (least is None or value >= least) and (most is None or value <= most)
    return what, value, f"{k} of {n}", target, is_met


def _statistic(
    what: str, values: Sequence[float], most: float | None, of: Callable[[Any], Any] = np.median
) -> Row:
    value = float(of(np.array(values))) if values else None
    is_met = None if value is None or most is None else value <= most
    return what, value, f"n = {len(values)}", "" if most is None else f"<= {most:g}", is_met


def _agrees_as_stated(case: Case) -> bool:
    """Tell whether a report says that all is well with the tolerances of the robot file."""
    scales = [(case.report or {}).get(key) for key in ("map_scale", "pose_scale")]
    said = any(isinstance(scale, (int, float)) and scale >= STRETCHED for scale in scales)
    return not (case.reported_names or case.is_unknown or said)


def table(cases: Sequence[Case]) -> list[Row]:
    """Return all rows."""
    by: dict[str, list[Case]] = defaultdict(list)
    for case in cases:
        by[case.suite].append(case)
    material = [c for c in by["singles"] if c.is_material]
    unmarked = [c for c in by["singles"] if not c.is_material and not c.is_below_materiality]

    def of(chosen: Iterable[Case], background: str, is_so: Claim = lambda c: True) -> list[Case]:
        return [c for c in chosen if c.background == background and is_so(c)]

    def ratio(case: Case) -> float | None:
        return case.hidden[0]["materiality_ratio"]  # type: ignore[no-any-return]

    rows = []
    for background, least in (("clean", 0.97), ("dirty", 0.93), ("wrong_tolerances", None)):
        chosen = of(material, background)
        what = (
            f"material single, first name right, {background} ({len({c.names[0] for c in chosen})} effects)"
        )
        rows.append(_share(what, (c.is_first_right for c in chosen), least))
    for background, least in (("dirty", 0.99), ("clean", None)):
        chosen = of(material, background, lambda c: (ratio(c) or 0) >= 2)
        rows.append(
            _share(
                f"... at twice the materiality or more, {background}",
                (c.is_first_right for c in chosen),
                least,
            )
        )
    for background in ("clean", "dirty"):
        chosen = of(material, background, lambda c: ratio(c) is None)
        rows.append(_share(f"... effects without a size, {background}", (c.is_first_right for c in chosen)))
    below = [c for c in by["singles"] if c.is_below_materiality]
    rows += [
        _share("... below it: silent", (not c.reported_names for c in below), 0.98),
        _share("no mark in the run: silent or right", (not c.wrong_names for c in unmarked)),
        _share("named wrongly first (singles)", (c.is_first_wrong for c in by["singles"]), most=0.005),
        _share("any wrong name (singles)", (bool(c.wrong_names) for c in by["singles"])),
    ]
    for background, most in (("clean", 0.0), ("dirty", 0.0), ("wrong_tolerances", 0.02)):
        rows.append(
            _share(
                f"false name on none, {background}",
                (bool(c.reported_names) for c in of(by["none"], background)),
                most=most,
            )
        )
    wrong = of(by["none"], "wrong_tolerances")
    rows += [
        _share("unknown said on none", (c.is_unknown for c in by["none"])),
        _share("tolerances 2-3 x wrong: agrees without saying so", map(_agrees_as_stated, wrong), most=0.0),
    ]
    for suite, n, named, exactly in (("pairs", "both", 0.95, 0.90), ("triples", "all", 0.80, None)):
        rows.append(
            _share(f"{suite}: {n} named", (set(c.names) <= set(c.reported_names) for c in by[suite]), named)
        )
        rows.append(_share(f"{suite}: exactly these", (c.is_right for c in by[suite]), exactly))
    right = [c for c in cases if c.hidden and c.is_right]
    return [
        *rows,
        _share("outside the library: said to be unknown", (c.is_unknown for c in by["foreign"]), 0.95),
        _share("... with no library name left", (not c.reported_names for c in by["foreign"]), 0.80),
        _share("... right answers wrongly doubted", (c.is_unknown for c in right), most=0.02),
        *_rows_of_sizes(cases),
        *[
            _statistic(
                f"CPU time [s], {suite}, median", [c.cpu_s for c in by[suite] if c.cpu_s is not None], None
            )
            for suite in ("none", "singles", "pairs", "triples", "foreign")
        ],
        _share("no report", (c.report is None for c in cases), most=0.0),
    ]


def _rows_of_sizes(cases: Sequence[Case]) -> list[Row]:
    """Are gap, place, parameters and probabilities of the effects that were named right?"""
    after, before = _gaps(cases)
    found = list(found_effects(cases))
    placed = [is_placed(true, said) for _, true, said in found if true["location"]]
    inside = [ok for _, true, said in found for _, ok in parameters_within(true, said)]
    _, error, n_stated = calibration(cases)
    is_met = None if error is None else error <= 0.03
    return [
        _statistic("gap before over the none floor, median", before, None),
        _statistic("gap after over the none floor, median", after, 1.03),
        _statistic("gap after over the none floor, 95 %", after, 1.08, lambda v: np.quantile(v, 0.95)),
        _share("place (wall, obstacle or spot within 0.3 m)", placed, 0.99),
        _share("true parameters within 2 s.e.", inside, 0.95),
        ("calibration error of the stated probability", error, f"n = {n_stated}", "<= 0.03", is_met),
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
    bins, error = [], 0.0
    for low, high in itertools.pairwise(PROBABILITY_BINS):
        inside = (p >= low) & (p < high)
        if inside.any():
            bins.append((float(low), float(p[inside].mean()), float(right[inside].mean()), int(inside.sum())))
            error += inside.mean() * abs(p[inside].mean() - right[inside].mean())
    return bins, float(error), len(p)


def confusion(cases: Sequence[Case]) -> list[str]:
    """Return one line per true single effect (all marked ones): what was said first, and how often."""
    rows: dict[tuple[int, str], Counter[str]] = defaultdict(Counter)
    for case in cases:
        if case.suite == "singles":
            kind = (1, case.names[0]) if case.is_material else (0, f"({case.names[0]}: below or no mark)")
        elif case.suite in ("none", "foreign"):
            is_none = case.suite == "none"
            kind = (2, f"none, {case.background}") if is_none else (3, f"foreign {case.truth['foreign']}")
        else:
            continue
        silent = "NO REPORT" if case.report is None else "UNKNOWN" if case.is_unknown else "silent"
        rows[kind][case.reported_names[0] if case.reported_names else silent] += 1
    return [
        f"{name:46s} {said[name]:3d} of {sum(said.values()):3d}   "
        + ", ".join(f"{answer} {count}" for answer, count in said.most_common())
        for (_, name), said in sorted(rows.items())
    ]


def is_good(case: Case) -> bool:
    """Tell whether a case is answered as it should be."""
    if case.report is None:
        return False
    if case.suite == "foreign":
        return case.is_unknown and not case.reported_names
    if case.suite == "none" or (case.suite == "singles" and case.is_below_materiality):
        return not case.reported_names and not case.is_unknown
    if case.suite == "singles" and not case.is_material:
        return not case.wrong_names and not case.is_unknown
    placed = all(is_placed(t, s) for _, t, s in found_effects([case]) if t["location"])
    return case.is_right and not case.is_unknown and placed


def failures(cases: Sequence[Case]) -> list[str]:
    """Return a line for every case that is not answered as it should be."""
    return [f"{c.label} {_truth_text(c)}  ->  {_said_text(c)}" for c in cases if not is_good(c)]


def _effect_text(effect: dict[str, Any]) -> str:
    values = (effect.get("parameters") or {}).items()
    numbers = " ".join(f"{key}={value:.4g}" for key, value in values if isinstance(value, (int, float)))
    place = (effect.get("location") or {}).get("name") or ""
    return f"{effect['name']}[{numbers}]{place and '@' + place}"


def _truth_text(case: Case) -> str:
    if case.truth["foreign"]:
        return f"{case.background} foreign {_effect_text(case.truth['foreign_effect'])}"
    parts = []
    for effect in case.hidden:
        ratio, mark = effect["materiality_ratio"], effect["mark"]
        size = "no size" if ratio is None else f"{ratio:.1f}x"
        changed = f"{100 * mark['changed_share']:.2g} % changed, rmse {mark['rmse_over_sigma']:.2f}"
        parts.append(f"{_effect_text(effect)} ({size}, {changed})")
    return f"{case.background} " + (" + ".join(parts) or "none")


def _said_text(case: Case) -> str:
    if case.report is None:
        return "no report"
    parts = [_effect_text(said) for said in case.reported] + ["UNKNOWN"] * case.is_unknown
    return " + ".join(parts) or "silent"


def text(cases: Sequence[Case]) -> str:
    """Return everything about one entrant."""
    bins, _, _ = calibration(cases)
    inside: dict[tuple[str, str], list[bool]] = defaultdict(list)
    for _, true, said in found_effects(cases):
        for key, ok in parameters_within(true, said):
            inside[true["name"], key].append(ok)
    return "\n".join(
        [
            f"{len(cases)} cases: {dict(Counter((c.suite, c.background) for c in cases))}",
            "",
            *map(_line, table(cases)),
            "",
            "stated probability (bin from, mean stated, share right, count)",
            *[f"  {low:.2f}  {mean:.3f}  {share:.3f}  {n}" for low, mean, share, n in bins],
            "",
            "parameters within 2 s.e.",
            *[f"  {name:22s} {key:10s} {sum(ok)} of {len(ok)}" for (name, key), ok in sorted(inside.items())],
            "",
            "confusion (truth: right of all, what was said first)",
            *["  " + line for line in confusion(cases)],
            "",
            "failures",
            *["  " + line for line in failures(cases)],
        ]
    )


def _is_material(background: str, case: Case) -> bool:
    return case.suite == "singles" and case.background == background and case.is_material


COMPARED: Mapping[str, tuple[Claim, Claim]] = {
    "nothing hidden: silent": (lambda c: c.suite == "none", is_good),
    "material single, clean: named first": (partial(_is_material, "clean"), lambda c: c.is_first_right),
    "material single, dirty: named first": (partial(_is_material, "dirty"), lambda c: c.is_first_right),
    "single named wrongly first": (lambda c: c.suite == "singles", lambda c: c.is_first_wrong),
    "several: exactly these": (lambda c: c.suite in ("pairs", "triples"), lambda c: c.is_right),
    "outside the library: unknown": (lambda c: c.suite == "foreign", lambda c: c.is_unknown),
    "outside the library: unknown without a name": (lambda c: c.suite == "foreign", is_good),
}
"""Row of the comparison -> which cases it is about, and what is counted."""


def comparison(entrants: Mapping[str, Sequence[Case]]) -> str:
    """Return a table of entrants, one column each."""
    lines = [f"{'':44s}" + "".join(f"{name:>20s}" for name in entrants)]
    for what, (concerns, counts) in COMPARED.items():
        cells = []
        for cases in entrants.values():
            chosen = [case for case in cases if concerns(case)]
            cells.append(f"{sum(map(counts, chosen))} of {len(chosen)}" if chosen else "-")
        lines.append(f"{what:44s}" + "".join(f"{cell:>20s}" for cell in cells))
    seconds = [[case.cpu_s for case in cases if case.cpu_s is not None] for cases in entrants.values()]
    lines.append(
        f"{'CPU time, median':44s}"
        + "".join(f"{np.median(s):>18.1f} s" if s else f"{'-':>20s}" for s in seconds)
    )
    return "\n".join(lines)
