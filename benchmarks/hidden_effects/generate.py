"""Make cases with hidden effects: what the diagnoser may see in DIR/cases, the truth in DIR/truth.

python -m benchmarks.hidden_effects.generate --suite singles --seeds dev --n 70 -o DIR
"""

from __future__ import annotations

import argparse
import json
import logging
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

from benchmarks.hidden_effects.cases import BACKGROUNDS, STREAMS, SUITES, CaseSpec, make_case, make_specs
from logs import write


def save(spec: CaseSpec, folder: Path, number: int) -> str:
    """Make a case and write it under its number; return one line about it."""
    run, second, arena, robot, truth = make_case(spec)
    case = folder / "cases" / f"{number:04d}"
    case.mkdir(parents=True, exist_ok=True)
    write(run, case / "run.mcap")
    if second is not None:
        write(second, case / "second.mcap")
    (case / "arena.geojson").write_text(arena)
    (case / "robot.yaml").write_text(robot)
    (folder / "truth").mkdir(exist_ok=True)
    (folder / "truth" / f"{number:04d}.json").write_text(json.dumps(truth, indent=1))
    return f"{number:04d} {spec.suite} {spec.background}"


def main() -> None:
    """Read the command line and make the cases."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--suite", choices=SUITES, required=True)
    parser.add_argument("--seeds", choices=list(STREAMS), default="dev")
    parser.add_argument("--n", type=int, required=True, help="count of cases")
    parser.add_argument("--first", type=int, default=0, help="skip this many cases of the stream")
    parser.add_argument("--background", choices=BACKGROUNDS, help="default: clean and dirty in turn")
    parser.add_argument("--effect", help="this single or foreign effect instead of all in turn")
    parser.add_argument("--strength", type=float, help="0...1 of a single instead of strata in turn")
    parser.add_argument("--second", action="store_true", help="a second run of each, on another path")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    logging.getLogger("logs").setLevel(logging.ERROR)
    count = options.first + options.n
    specs = make_specs(
        options.suite, options.seeds, count, background=options.background, second=options.second
    )[options.first :]
    specs = [replace(spec, effect=options.effect, strength=options.strength) for spec in specs]
    taken = [int(path.stem) for path in options.output.glob("truth/*.json")]
    start = max(taken, default=-1) + 1
    numbers = range(start, start + len(specs))
    folders = [options.output] * len(specs)
    if options.workers > 1:
        with ProcessPoolExecutor(options.workers) as pool:
            for line in pool.map(save, specs, folders, numbers):
                print(line, flush=True)
    else:
        for line in map(save, specs, folders, numbers):
            print(line, flush=True)


if __name__ == "__main__":
    main()
