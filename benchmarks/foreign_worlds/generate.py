"""Make cases of a foreign world: what may be seen in DIR/cases, the truth in DIR/truth.

    python -m benchmarks.foreign_worlds.generate --world mujoco --suite none --kinds dev --n 10 -o DIR

Every other case is dirty: corners 4 mm off, mount 1.5 mm and 0.03 degrees off, poses whose noise lasts ten frames,
3 ms of stamp jitter, a tenth of the noise 2.5 times as wide, 0.1 % of the rays lost.
"""

from __future__ import annotations

import argparse
import importlib
import json
from pathlib import Path

from benchmarks.foreign_worlds.cases import KINDS, SUITES, Spec
from benchmarks.foreign_worlds.files import write_log

WORLDS = {"mujoco": "benchmarks.foreign_worlds.cases", "irsim": "benchmarks.foreign_worlds.irsim_world"}


def save(spec: Spec, folder: Path, number: int) -> str:
    """Make a case, write it under its number; return one line about it."""
    world = importlib.import_module(WORLDS[spec.world])  # each needs a simulator of its own
    log, arena, robot, truth = world.make(spec)
    case = folder / "cases" / f"{number:04d}"
    case.mkdir(parents=True, exist_ok=True)
    write_log(log, case / "run.mcap")
    (case / "arena.geojson").write_text(arena)
    (case / "robot.yaml").write_text(robot)
    (folder / "truth").mkdir(exist_ok=True)
    (folder / "truth" / f"{number:04d}.json").write_text(json.dumps(truth, indent=1))
    return f"{number:04d} {spec.suite} {truth['background']} {spec.hidden}"


def main() -> None:
    """Read the command line and make the cases."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--world", choices=list(WORLDS), default="mujoco")
    parser.add_argument("--suite", choices=SUITES, required=True)
    parser.add_argument("--kinds", choices=list(KINDS), default="dev")
    parser.add_argument("--n", type=int, required=True, help="count of cases")
    parser.add_argument("--first", type=int, default=0, help="skip this many")
    parser.add_argument("--hide", default="", help="this effect instead of all in turn")
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    taken = [int(path.stem) for path in options.output.glob("truth/*.json")]
    number = max(taken, default=-1) + 1
    for index in range(options.first, options.first + options.n):
        spec = Spec(
            suite=options.suite, kinds=options.kinds, index=index, world=options.world, name=options.hide
        )
        print(save(spec, options.output, number), flush=True)
        number += 1


if __name__ == "__main__":
    main()
