"""Compare what was said (DIR/results) with the truth (DIR/truth): table, confusion, calibration, failures.

    python -m benchmarks.hidden_effects.score DIR [DIR ...] [--json FILE]

Several folders count as one. A row reads `share (k of n), bound`; a case without a report counts as silent
and is listed. Below materiality means a size below it; effects without a mark in the run stand apart.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.hidden_effects.results import Case, found_effects, is_placed, load, parameters_within
from benchmarks.hidden_effects.score_table import calibration, table


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
    if case.reported_names:
        return case.reported_names[0]
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
        return not case.reported_names and not case.is_unknown
    if case.suite == "foreign":
        return case.is_unknown and not case.reported_names
    if case.suite == "singles" and case.is_below_materiality:
        return not case.reported_names and not case.is_unknown
    if case.suite == "singles" and not case.is_material:
        return not case.wrong_names and not case.is_unknown
    placed = all(is_placed(t, s) for _, t, s in found_effects([case]) if t["location"])
    return case.is_right and not case.is_unknown and placed


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
    for said in case.reported:
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
    for _, true, said in found_effects(cases):
        for key, ok in parameters_within(true, said):
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
    parser.add_argument("--answers", default="results", help="folder in DIR that holds the answers")
    parser.add_argument("--json", type=Path, help="the table as JSON")
    options = parser.parse_args()
    cases = load(options.folders, options.answers)
    if not cases:
        parser.error(
            f"no results in {', '.join(map(str, options.folders))}; run `benchmarks.hidden_effects.run` first"
        )
    print(text(cases))
    if options.json:
        options.json.write_text(json.dumps([vars(row) for row in table(cases)], indent=1))


if __name__ == "__main__":
    main()
