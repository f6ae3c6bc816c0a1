"""Hidden effects: make cases, let an entrant answer them, compare the answers with the truth.

python -m benchmarks.hidden_effects generate --world own --suite singles --kinds dev --n 70 -o DIR
python -m benchmarks.hidden_effects answer DIR --entrant sensorgraph --workers 2
python -m benchmarks.hidden_effects score DIR
"""

from __future__ import annotations

import argparse
import importlib
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from benchmarks.hidden_effects.case import BACKGROUNDS, KINDS, Spec, save
from benchmarks.hidden_effects.worlds import WORLDS

SUITES = ("none", "singles", "pairs", "triples", "foreign")
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def make_and_save(world: str, spec: Spec, folder: Path, number: int) -> str:
    """Make a case and write it under its number; return one line about it."""
    case = importlib.import_module(WORLDS[world]).make(spec)
    save(case, folder, number)
    hidden = case.truth["foreign"] or "+".join(one["name"] for one in case.truth["effects"]) or "nothing"
    return f"{number:04d} {spec.suite} {case.truth['background']} {hidden}"


def generate(options: argparse.Namespace) -> None:
    """Make cases; they are added to those already there."""
    suites = importlib.import_module(WORLDS[options.world]).SUITES
    if options.suite not in suites:
        raise SystemExit(
            f"world {options.world} has no suite {options.suite}; expected one of {', '.join(suites)}"
        )
    start = max((int(path.stem) for path in options.output.glob("truth/*.json")), default=-1) + 1
    in_pool(
        options.workers,
        make_and_save,
        [(options.world, spec_of(options, k), options.output, start + k) for k in range(options.n)],
    )


def in_pool(workers: int, work: Callable[..., str], jobs: Iterable[tuple[Any, ...]]) -> None:
    """Do jobs in processes; print the line of each, in the order of the jobs."""
    with ProcessPoolExecutor(workers) as pool:
        for job in [pool.submit(work, *arguments) for arguments in jobs]:
            print(job.result(), flush=True)


def spec_of(options: argparse.Namespace, k: int) -> Spec:
    """Return the k-th case of a command line."""
    return Spec(
        suite=options.suite,
        index=options.first + k,
        kinds=options.kinds,
        background=options.background,
        effect=options.effect,
        strength=options.strength,
        floors=options.floors,
    )


def answer(options: argparse.Namespace) -> None:
    """Let an entrant answer cases; those that it has answered are skipped."""
    from benchmarks.hidden_effects.entrants import answer_case

    names = sorted(path.name for path in (options.folder / "cases").iterdir())
    if options.only:
        wanted = {f"{int(number):04d}" for number in options.only.split(",")}
        names = [name for name in names if name in wanted]
    if not options.again:
        done = options.folder / "answers" / options.entrant
        names = [name for name in names if not (done / name / "run.json").exists()]
    in_pool(options.workers, answer_case, [(options.entrant, options.folder, name) for name in names])


def score(options: argparse.Namespace) -> None:
    """Print how the answers compare with the truth."""
    from benchmarks.hidden_effects import results, score

    entrants = options.answers or results.entrants(options.folders)
    cases = {name: results.load(options.folders, name) for name in entrants}
    if not any(cases.values()):
        raise SystemExit(f"no answers in {', '.join(map(str, options.folders))}; run `answer` first")
    print(score.comparison(cases) if len(cases) > 1 else score.text(cases[entrants[0]]))


def main() -> None:
    """Read the command line."""
    os.environ |= dict.fromkeys(THREADS, "1")  # before a worker imports numpy
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.hidden_effects",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser(
        "generate", help="make cases: what may be seen in DIR/cases, the truth in DIR/truth"
    )
    one.add_argument("--world", choices=list(WORLDS), required=True)
    one.add_argument("--suite", choices=SUITES, required=True)
    one.add_argument(
        "--kinds", choices=KINDS, default="dev", help="stream of seeds, and effects outside the library"
    )
    one.add_argument("--n", type=int, required=True, help="count of cases")
    one.add_argument("--first", type=int, default=0, help="skip this many cases of the suite")
    one.add_argument("--background", choices=BACKGROUNDS, default="", help="default: clean and dirty in turn")
    one.add_argument("--effect", default="", help="this effect instead of all in turn")
    one.add_argument("--strength", type=float, help="own: 0...1 of a single instead of strata in turn")
    one.add_argument("--floors", type=Path, help="floors, pixels: folder of the floors of KTH")
    one.add_argument("--workers", type=int, default=1)
    one.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    one.set_defaults(run=generate)
    one = commands.add_parser("answer", help="let an entrant answer, into DIR/answers/ENTRANT")
    one.add_argument("folder", type=Path, metavar="DIR")
    one.add_argument(
        "--entrant", default="sensorgraph", help="sensorgraph, least_squares or largest_residual"
    )
    one.add_argument("--only", help="case numbers, comma-separated")
    one.add_argument("--again", action="store_true", help="also cases that have an answer")
    one.add_argument("--workers", type=int, default=1)
    one.set_defaults(run=answer)
    one = commands.add_parser("score", help="one entrant in detail, or several side by side")
    one.add_argument("folders", type=Path, nargs="+", metavar="DIR", help="several count as one")
    one.add_argument("--answers", nargs="+", metavar="ENTRANT", help="default: all that are there")
    one.set_defaults(run=score)
    options = parser.parse_args()
    try:
        options.run(options)
    except FileNotFoundError as exc:  # no floors, no cases
        raise SystemExit(str(exc)) from None
