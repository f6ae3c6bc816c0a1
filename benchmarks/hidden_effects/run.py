"""Let `sensorgraph diagnose` look at every case of a folder, then score; cases already answered are skipped.

    python -m benchmarks.hidden_effects.run DIR [--workers 2] [--only 12,40] [--again] [--second]

Each worker is one process with one thread. CPU time is told of the diagnosis and of the whole command.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import shutil
import time
import traceback
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def diagnose_case(folder: Path, name: str, *, second: bool = False) -> str:
    """Diagnose one case in this process; keep report.json, timing.json, what was printed and the time."""
    from sensorgraph.cli import run  # in the worker, after its threads are set

    case, result = folder / "cases" / name, folder / "results" / name
    result.mkdir(parents=True, exist_ok=True)
    runs = [str(case / "run.mcap")]
    if second and (case / "second.mcap").exists():
        runs.append(str(case / "second.mcap"))
    drawn, pixels = case / "arena.geojson", case / "arena.yaml"
    files = ["--arena", str(drawn if drawn.exists() else pixels), "--robot", str(case / "robot.yaml")]
    printed = io.StringIO()
    wall, cpu = time.perf_counter(), time.process_time()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        try:
            code = run(["diagnose", *runs, *files, "-o", str(result / "out")])
        except BaseException as exc:
            code = 1
            traceback.print_exception(exc)
    spent = {
        "exit": code,
        "cpu_s": time.process_time() - cpu,
        "wall_s": time.perf_counter() - wall,
    }
    for kept in ("report.json", "timing.json"):
        if (result / "out" / kept).exists():
            shutil.copy(result / "out" / kept, result / kept)
    (result / "run.json").write_text(json.dumps(spent | {"printed": printed.getvalue()[-4000:]}, indent=1))
    shutil.rmtree(result / "out", ignore_errors=True)
    said = printed.getvalue().strip().splitlines()
    why = f": {said[-1]}" if code and said else ""
    return f"{name} exit {code}, {spent['cpu_s']:.1f} s{why}"


def main() -> None:
    """Read the command line, diagnose, score."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--only", help="case numbers, comma-separated")
    parser.add_argument("--again", action="store_true", help="also cases that have an answer")
    parser.add_argument("--second", action="store_true", help="give the second run too, where there is one")
    options = parser.parse_args()
    names = sorted(path.name for path in (options.folder / "cases").iterdir())
    if options.only:
        wanted = {f"{int(number):04d}" for number in options.only.split(",")}
        names = [name for name in names if name in wanted]
    if not options.again:
        names = [name for name in names if not (options.folder / "results" / name / "run.json").exists()]
    for name in names:
        shutil.rmtree(options.folder / "results" / name, ignore_errors=True)
    os.environ |= dict.fromkeys(THREADS, "1")  # before a worker imports numpy
    with ProcessPoolExecutor(options.workers) as pool:
        jobs = [pool.submit(diagnose_case, options.folder, name, second=options.second) for name in names]
        for job in jobs:
            print(job.result(), flush=True)

    from benchmarks.hidden_effects import results, score  # numpy, which the workers must not inherit

    print(score.text(results.load([options.folder])))


if __name__ == "__main__":
    main()
