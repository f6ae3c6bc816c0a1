"""Make cases: what may be seen in DIR/cases, the truth in DIR/truth; more cases are added to those already there.

    python -m benchmarks.blind_world.generate --suite singles --kinds report --first 40 --n 20 -o DIR

Without --background every other case is dirty. A case depends on suite, kinds, its number in the suite and its
background only: `--first 40 --n 20` makes cases that `--first 0 --n 40` does not hold.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from benchmarks.blind_world.cases import BACKGROUNDS, KINDS, SUITES, Spec, make
from benchmarks.blind_world.files import write_log


def save(spec: Spec, folder: Path, number: int) -> str:
    """Make a case, write it under its number; return one line about it."""
    made = make(spec)
    case = folder / "cases" / f"{number:04d}"
    case.mkdir(parents=True, exist_ok=True)
    write_log(made.log, case / "run.mcap")
    (case / "arena.geojson").write_text(made.arena)
    (case / "robot.yaml").write_text(made.robot)
    (folder / "truth").mkdir(exist_ok=True)
    (folder / "truth" / f"{number:04d}.json").write_text(json.dumps(made.truth, indent=1))
    setup = made.truth["made"]
    hidden = "+".join(spec.names) or "nothing"
    return (
        f"{number:04d} {spec.suite} {made.truth['background']} {hidden}, {setup['robot']} in {setup['room']}"
    )


def main() -> None:
    """Read the command line and make the cases."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--suite", choices=SUITES, required=True)
    parser.add_argument("--kinds", choices=KINDS, default="development")
    parser.add_argument("--background", choices=BACKGROUNDS, default="", help="default: in turn")
    parser.add_argument("--first", type=int, default=0, help="skip this many cases of the suite")
    parser.add_argument("--n", type=int, required=True, help="count of cases")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    options = parser.parse_args()
    taken = [int(path.stem) for path in options.output.glob("truth/*.json")]
    start = max(taken, default=-1) + 1
    for k in range(options.n):
        spec = Spec(
            suite=options.suite,
            kinds=options.kinds,
            index=options.first + k,
            background=options.background,
        )
        print(save(spec, options.output, start + k), flush=True)


if __name__ == "__main__":
    main()
