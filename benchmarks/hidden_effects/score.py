"""Compare what was said (DIR/results) with the truth (DIR/truth): table, confusion, calibration, failures.

    python -m benchmarks.hidden_effects.score DIR [DIR ...] [--json FILE]

Several folders count as one. A row reads `share (k of n), bound`; a case without a report counts as silent
and is listed. Below materiality means a size below it; effects without a mark in the run stand apart.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

NEAR = 0.3
"""[m] a spot counts as found."""
SYNONYMS = {
    "s_rel": "s",
    "scale": "s",
    "bias": "b",
    "yaw": "delta",
    "radius": "r",
    "theta_1": "theta1",
    "theta_2": "theta2",
    "r_0": "r0",
    "theta_0": "theta0",
    "alpha_return": "alpha_ret",
    "v_sat": "v_max",
    "sweep": "T",
    "b_1": "b1",
}
"""Other keys a report may use -> ours."""
ANGLES = {"theta1", "theta2", "theta0"}
PLACEMENT = {("wheel_slip", "x"), ("wheel_slip", "y"), ("wheel_slip", "r")}
"""Where an effect is, scored as a place and not as a parameter."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """One case: the truth and the answer."""

    label: str
    truth: dict[str, Any]
    report: dict[str, Any] | None
    command_s: float | None
    """[s] CPU time of the whole command, pictures and recordings included."""

    @property
    def cpu_s(self) -> float | None:
        """CPU time of the diagnosis alone [s]."""
        return None if self.report is None else float(sum(self.report["cpu_s"].values()))

    @property
    def suite(self) -> str:
        """Suite of the case."""
        return str(self.truth["suite"])

    @property
    def background(self) -> str:
        """Background of the case."""
        return str(self.truth["background"])

    @property
    def hidden(self) -> list[dict[str, Any]]:
        """Library effects in it."""
        return list(self.truth["effects"])

    @property
    def names(self) -> list[str]:
        """Names of the library effects in it."""
        return [effect["name"] for effect in self.hidden]

    @property
    def said(self) -> list[dict[str, Any]]:
        """Effects named, first first."""
        return list((self.report or {}).get("effects") or [])

    @property
    def said_names(self) -> list[str]:
        """Names said, first first."""
        return [effect["name"] for effect in self.said]

    @property
    def is_unknown(self) -> bool:
        """The answer says that something unknown is there."""
        unknown = (self.report or {}).get("unknown")
        if isinstance(unknown, dict) and isinstance(unknown.get("said"), bool):
            return bool(unknown["said"])
        return bool(unknown)

    @property
    def is_first_right(self) -> bool:
        """The first name said is a true one."""
        return bool(self.said_names) and self.said_names[0] in self.names

    @property
    def wrong_names(self) -> list[str]:
        """Names said that are not there."""
        return [name for name in self.said_names if name not in self.names]

    @property
    def is_material(self) -> bool:
        """All its effects are material and marked."""
        return bool(self.hidden) and all(effect["material"] for effect in self.hidden)

    @property
    def is_below(self) -> bool:
        """Its (single) effect has a size below the materiality."""
        ratio = self.hidden[0]["materiality_ratio"] if len(self.hidden) == 1 else None
        return ratio is not None and ratio < 1.0


def load(folders: Iterable[Path]) -> list[Case]:
    """Read truth and answers; cases whose answer was never asked for are left out."""
    cases = []
    for folder in folders:
        for path in sorted(folder.glob("truth/*.json")):
            result = folder / "results" / path.stem
            if not result.exists():
                continue
            report, run = result / "report.json", result / "run.json"
            cases.append(
                Case(
                    label=f"{folder.name}/{path.stem}",
                    truth=json.loads(path.read_text()),
                    report=json.loads(report.read_text()) if report.exists() else None,
                    command_s=json.loads(run.read_text()).get("cpu_s") if run.exists() else None,
                )
            )
    return cases


@dataclass(frozen=True, kw_only=True)
class Row:
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
) -> Row:
    n, k = len(cases), sum(bool(good(case)) for case in cases)
    value = k / n if n else None
    met: bool | None = None
    if value is not None and (least is not None or most is not None):
        met = (least is None or value >= least) and (most is None or value <= most)
    target = (
        f">= {100 * least:g} %" if least is not None else f"<= {100 * most:g} %" if most is not None else ""
    )
    return Row(what=what, value=value, of=f"{k} of {n}", target=target, is_met=met)


def _below(what: str, values: Sequence[float], bound: float | None, statistic: Callable[[Any], float]) -> Row:
    value = float(statistic(np.array(values))) if len(values) else None
    met = None if value is None or bound is None else value <= bound
    return Row(
        what=what,
        value=value,
        of=f"n = {len(values)}",
        target="" if bound is None else f"<= {bound:g}",
        is_met=met,
    )


def table(cases: Sequence[Case]) -> list[Row]:
    """Return the numbers."""
    singles = [c for c in cases if c.suite == "singles"]
    material = [c for c in singles if c.is_material]
    unmarked = [c for c in singles if not c.is_material and not c.is_below]
    none = [c for c in cases if c.suite == "none"]
    rows = []
    for background, least in (("clean", 0.97), ("dirty", 0.93), ("wrong_tolerances", None)):
        chosen = [c for c in material if c.background == background]
        effects = len({c.names[0] for c in chosen})
        rows.append(
            _share(
                f"material single, first name right, {background} ({effects} effects)",
                chosen,
                lambda c: c.is_first_right,
                least=least,
            )
        )
    for background, least in (("dirty", 0.99), ("clean", None)):
        twice = [
            c for c in material if c.background == background and (c.hidden[0]["materiality_ratio"] or 0) >= 2
        ]
        rows.append(
            _share(
                f"... at twice the materiality or more, {background}",
                twice,
                lambda c: c.is_first_right,
                least=least,
            )
        )
    for background in ("clean", "dirty"):
        sizeless = [
            c for c in material if c.background == background and c.hidden[0]["materiality_ratio"] is None
        ]
        rows.append(_share(f"... effects without a size, {background}", sizeless, lambda c: c.is_first_right))
    rows.append(
        _share(
            "... below it: silent", [c for c in singles if c.is_below], lambda c: not c.said_names, least=0.98
        )
    )
    rows.append(_share("no mark in the run: silent or right", unmarked, lambda c: not c.wrong_names))
    rows.append(
        _share(
            "named wrongly first (singles)",
            singles,
            lambda c: bool(c.said_names) and not c.is_first_right,
            most=0.005,
        )
    )
    rows.append(_share("any wrong name (singles)", singles, lambda c: bool(c.wrong_names)))
    for background, most in (("clean", 0.0), ("dirty", 0.0), ("wrong_tolerances", 0.02)):
        chosen = [c for c in none if c.background == background]
        rows.append(
            _share(f"false name on none, {background}", chosen, lambda c: bool(c.said_names), most=most)
        )
    rows.append(_share("unknown said on none", none, lambda c: c.is_unknown))
    for suite, n, both, exactly in (("pairs", "both", 0.95, 0.90), ("triples", "all", 0.80, None)):
        chosen = [c for c in cases if c.suite == suite]
        rows.append(
            _share(f"{suite}: {n} named", chosen, lambda c: set(c.names) <= set(c.said_names), least=both)
        )
        rows.append(
            _share(
                f"{suite}: exactly these",
                chosen,
                lambda c: sorted(c.names) == sorted(c.said_names),
                least=exactly,
            )
        )
    foreign = [c for c in cases if c.suite == "foreign"]
    rows.append(
        _share("outside the library: said to be unknown", foreign, lambda c: c.is_unknown, least=0.95)
    )
    rows.append(_share("... with no library name left", foreign, lambda c: not c.said_names, least=0.80))
    right = [c for c in cases if c.hidden and sorted(c.names) == sorted(c.said_names)]
    rows.append(_share("... right answers wrongly doubted", right, lambda c: c.is_unknown, most=0.02))
    after, before = _gaps(cases)
    rows.append(_below("gap before over the none floor, median", before, None, np.median))
    rows.append(_below("gap after over the none floor, median", after, 1.03, np.median))
    rows.append(_below("gap after over the none floor, 95 %", after, 1.08, lambda v: np.quantile(v, 0.95)))
    found = list(_found(cases))
    placed = [(t, s) for _, t, s in found if t["location"]]
    rows.append(
        _share(
            "place (wall, obstacle or spot within 0.3 m)", placed, lambda pair: is_placed(*pair), least=0.99
        )
    )
    inside = [ok for _, t, s in found for _, ok in _parameters(t, s)]
    rows.append(_share("true parameters within 2 s.e.", inside, bool, least=0.95))
    _, error, n_stated = calibration(cases)
    rows.append(
        Row(
            what="calibration error of the stated probability",
            value=error,
            of=f"n = {n_stated}",
            target="<= 0.03",
            is_met=None if error is None else error <= 0.03,
        )
    )
    for suite, bound in (
        ("none", 2.0),
        ("singles", 3.0),
        ("pairs", 5.0),
        ("triples", None),
        ("foreign", None),
    ):
        seconds = [c.cpu_s for c in cases if c.suite == suite and c.cpu_s is not None]
        rows.append(_below(f"CPU time [s], {suite}, median", seconds, bound, np.median))
    everything = [c.cpu_s for c in cases if c.cpu_s is not None]
    rows.append(_below("CPU time [s], all, 95 %", everything, None, lambda v: np.quantile(v, 0.95)))
    command = [c.command_s for c in cases if c.command_s is not None]
    rows.append(
        _below("CPU time [s] of the command with its pictures, all, median", command, None, np.median)
    )
    rows.append(_share("no report", cases, lambda c: c.report is None, most=0.0))
    return rows


def _gaps(cases: Sequence[Case]) -> tuple[list[float], list[float]]:
    """Return gap after and before over the none floor, of right answers on deterministic material effects."""
    floors: dict[str, list[float]] = defaultdict(list)
    for case in cases:
        value = _normalised(case, "after")
        if case.suite == "none" and value is not None:
            floors[case.background].append(value)
    after, before = [], []
    for case in cases:
        if not (case.hidden and case.is_material and sorted(case.names) == sorted(case.said_names)):
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


def _found(cases: Sequence[Case]) -> Iterable[tuple[Case, dict[str, Any], dict[str, Any]]]:
    """Yield (case, true effect, the one said) for every material effect that was named."""
    for case in cases:
        for true in case.hidden:
            same = [said for said in case.said if said["name"] == true["name"]]
            if same and true["material"]:
                yield case, true, same[0]


def is_placed(true: dict[str, Any], said: dict[str, Any]) -> bool:
    """Tell whether the place said is the wall, the obstacle or within NEAR of the spot."""
    place, told = true["location"], said.get("location") or {}
    if place["name"] and told.get("name") == place["name"]:
        return True
    if place["xy"] is None or told.get("xy") is None:
        return False
    return math.dist(place["xy"], told["xy"]) <= NEAR


def _parameters(true: dict[str, Any], said: dict[str, Any]) -> Iterable[tuple[str, bool]]:
    """Yield (parameter, true value within two standard errors) for those that both know."""
    values = {SYNONYMS.get(key, key): value for key, value in (said.get("parameters") or {}).items()}
    errors = said.get("stderr") or {}
    if isinstance(errors, dict):
        errors = {SYNONYMS.get(key, key): value for key, value in errors.items()}
    else:
        errors = dict.fromkeys(values, errors)
    for key, value in true["parameters"].items():
        told, error = values.get(key), errors.get(key)
        if (true["name"], key) in PLACEMENT or value is None or told is None or error is None:
            continue
        off = told - value
        if key in ANGLES:
            off = math.remainder(off, 2 * math.pi)
        if not (math.isfinite(error) and math.isfinite(off)):
            yield key, False
        else:
            yield key, abs(off) <= 2 * error + 1e-9


def calibration(cases: Sequence[Case]) -> tuple[list[tuple[float, float, float, int]], float | None, int]:
    """Return reliability bins (edge, mean stated, share right, count), the calibration error, the count."""
    stated = [
        (float(said["probability"]), float(said["name"] in case.names))
        for case in cases
        for said in case.said
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


def confusion(cases: Sequence[Case]) -> list[str]:
    """Return one line per true single effect (all marked ones): what was said first, and how often."""
    rows: dict[str, Counter[str]] = defaultdict(Counter)
    for case in cases:
        if case.suite == "singles" and case.is_material:
            rows[case.names[0]][_answer(case)] += 1
        elif case.suite == "singles":
            rows[f"({case.names[0]}: below or no mark)"][_answer(case)] += 1
        elif case.suite == "none":
            rows[f"none, {case.background}"][_answer(case)] += 1
        elif case.suite == "foreign":
            rows[f"foreign {case.truth['foreign']}"][_answer(case)] += 1
    lines = []
    for name in sorted(
        rows, key=lambda key: (key.startswith("foreign"), key.startswith("none"), key.startswith("("), key)
    ):
        said = rows[name]
        text = ", ".join(f"{answer} {count}" for answer, count in said.most_common())
        lines.append(f"{name:46s} {said[name]:3d} of {sum(said.values()):3d}   {text}")
    return lines


def _answer(case: Case) -> str:
    if case.report is None:
        return "NO REPORT"
    if case.said_names:
        return case.said_names[0]
    return "UNKNOWN" if case.is_unknown else "silent"


def failures(cases: Sequence[Case]) -> list[str]:
    """Return a line for every case that is not answered as it should be."""
    return [
        f"{case.label} {_truth_text(case)}  ->  {_said_text(case)}" for case in cases if not _is_good(case)
    ]


def _is_good(case: Case) -> bool:
    if case.report is None:
        return False
    if case.suite == "none":
        return not case.said_names and not case.is_unknown
    if case.suite == "foreign":
        return case.is_unknown and not case.said_names
    right = sorted(case.names) == sorted(case.said_names)
    if case.suite == "singles" and case.is_below:
        return not case.said_names and not case.is_unknown
    if case.suite == "singles" and not case.is_material:
        return not case.wrong_names and not case.is_unknown
    placed = all(is_placed(t, s) for _, t, s in _found([case]) if t["location"])
    return right and not case.is_unknown and placed


def _values(parameters: dict[str, Any]) -> str:
    return " ".join(
        f"{key}={value:.4g}" for key, value in parameters.items() if isinstance(value, (int, float))
    )


def _truth_text(case: Case) -> str:
    if case.truth["foreign"]:
        foreign = case.truth["foreign_effect"]
        return f"{case.background} foreign {foreign['name']} [{_values(foreign['parameters'])}]"
    parts = []
    for effect in case.hidden:
        ratio, mark = effect["materiality_ratio"], effect["mark"]
        size = "no size" if ratio is None else f"{ratio:.1f}x"
        place = (effect["location"] or {}).get("name") or ""
        parts.append(
            f"{effect['name']}[{_values(effect['parameters'])}]{place and '@' + place} "
            f"({size}, {100 * mark['changed_share']:.2g} % changed, rmse {mark['rmse_over_sigma']:.2f})"
        )
    return f"{case.background} " + (" + ".join(parts) or "none")


def _said_text(case: Case) -> str:
    if case.report is None:
        return "no report"
    parts = []
    for said in case.said:
        evidence, place = said.get("evidence_nats"), (said.get("location") or {}).get("name") or ""
        nats = f", {evidence:.0f} nats" if isinstance(evidence, (int, float)) else ""
        parts.append(f"{said['name']}[{_values(said.get('parameters') or {})}{nats}]{place and '@' + place}")
    if case.is_unknown:
        parts.append("UNKNOWN")
    runner_up = case.report.get("runner_up")
    if isinstance(runner_up, dict) and runner_up.get("name"):
        parts.append(f"(runner-up {runner_up['name']})")
    return " + ".join(parts) or "silent"


def text(cases: Sequence[Case]) -> str:
    """Return the whole report."""
    bins, _, _ = calibration(cases)
    inside: dict[tuple[str, str], list[bool]] = defaultdict(list)
    for _, true, said in _found(cases):
        for key, ok in _parameters(true, said):
            inside[true["name"], key].append(ok)
    return "\n".join(
        [
            f"{len(cases)} cases: {dict(Counter((c.suite, c.background) for c in cases))}",
            "",
            *[row.text() for row in table(cases)],
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


def main() -> None:
    """Read the command line and print the report."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+", metavar="DIR")
    parser.add_argument("--json", type=Path, help="the table as JSON")
    options = parser.parse_args()
    cases = load(options.folders)
    if not cases:
        parser.error(
            f"no results in {', '.join(map(str, options.folders))}; run `benchmarks.hidden_effects.run` first"
        )
    print(text(cases))
    if options.json:
        options.json.write_text(json.dumps([vars(row) for row in table(cases)], indent=1))


if __name__ == "__main__":
    main()
