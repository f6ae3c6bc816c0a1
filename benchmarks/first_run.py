"""Time line of the first `sensorgraph demo` and of one with compiled kernels; which kernels cost how much to compile.

    OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python -m benchmarks.first_run --picture first_run.png

Seconds of CPU include all processes. A kernel's seconds exclude the kernels that it calls, which are listed themselves.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.arguments import heads, parser_of, timed
from sensorgraph.show.figures.style import AMBER, INK, TEAL, TEXT, new_figure, save_figure

LISTENER = '''
import atexit, os, sys, time
from importlib.abc import MetaPathFinder

class Listening(MetaPathFinder):
    """Register a listener when the first module with kernels is imported."""

    is_done = False

    def find_spec(self, name, path, target=None):
        if name == "planners.kernel" and not Listening.is_done:
            Listening.is_done = True
            listen()

def listen():
    import numba.core.event as event
    log = open(os.path.join(os.environ["FIRST_RUN_LOG"], f"{os.getpid()}.tsv"), "a", buffering=1)
    log.write(f"{time.time()}\\n")

    def end():
        log.write(f"end\\t{time.time()}\\n")

    def leave(code, exit=os._exit):
        end()
        exit(code)

    atexit.register(end)
    os._exit = leave

    class Compiling(event.Listener):
        open_calls = []

        def on_start(self, what):
            self.open_calls.append([time.time(), time.process_time(), 0.0])

        def on_end(self, what):
            began, before, inside = self.open_calls.pop()
            spent = time.process_time() - before
            if self.open_calls:
                self.open_calls[-1][2] += spent
            made = what.data["dispatcher"].py_func
            columns = (len(self.open_calls), began, time.time(), spent - inside, f"{made.__module__}.{made.__name__}")
            log.write("\\t".join(map(str, columns)) + "\\n")

    event.register("numba:compile", Compiling())

sys.meta_path.insert(0, Listening())
'''
"""`sitecustomize.py` of every process of the demo."""
STAGE = re.compile(r"^\[\d+/\d+\] +(\d+) s +(\S+)", re.M)


@dataclass(frozen=True, kw_only=True)
class Timed:
    """One demo."""

    cpu: float
    """[s] of all processes."""
    wall: float
    """[s]"""
    stages: tuple[tuple[str, float], ...]
    """Name of each stage, and when its file could be opened [s]."""
    processes: tuple[tuple[float, float, tuple[tuple[float, float], ...]], ...]
    """When each process began to import [s], when it ended [s], and when it compiled [s]."""
    kernels: Counter[str]
    """[s] CPU of compiling each kernel."""


def timed_demo(folder: Path, name: str) -> Timed:
    """Run the demo with the cache of compiled kernels in `folder`."""
    log, site = folder / name, folder / "site"
    log.mkdir()
    site.mkdir(exist_ok=True)
    (site / "sitecustomize.py").write_text(LISTENER)
    paths = [str(site), str(Path.cwd()), os.environ.get("PYTHONPATH", "")]
    variables = {
        "PYTHONPATH": os.pathsep.join(filter(None, paths)),
        "NUMBA_CACHE_DIR": str(folder / "cache"),
        "FIRST_RUN_LOG": str(log),
    }
    command = [sys.executable, "-m", "sensorgraph", "demo", "-o", str(folder / f"{name}-demo")]
    began = time.time()
    with timed() as took:
        done = subprocess.run(
            command,
            env=os.environ | variables,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            check=True,
        )
    kernels: Counter[str] = Counter()
    processes = []
    for file in sorted(log.iterdir(), key=lambda file: float(file.read_text().split()[0])):
        first, *rows = file.read_text().splitlines()
        end = max(
            (float(row.split("\t")[1]) for row in rows if row.startswith("end")), default=began + took.wall
        )
        calls = [row.split("\t") for row in rows if not row.startswith("end")]
        for _, _, _, seconds, kernel in calls:
            kernels[kernel] += float(seconds)
        outer = tuple((float(a) - began, float(b) - began) for depth, a, b, *_ in calls if depth == "0")
        processes.append((float(first) - began, end - began, outer))
    return Timed(
        cpu=took.cpu,
        wall=took.wall,
        stages=tuple((stage, float(at)) for at, stage in STAGE.findall(done.stdout)),
        processes=tuple(processes),
        kernels=kernels,
    )


def picture(runs: dict[str, Timed], path: Path) -> None:
    """Draw a lane per process with its compiling, and a line per stage."""
    figure = new_figure(10.0, 1.2 + 0.5 * sum(len(run.processes) for run in runs.values()))
    charts = figure.subplots(
        len(runs), 1, squeeze=False, height_ratios=[len(run.processes) for run in runs.values()]
    )
    for chart, (label, run) in zip(charts[:, 0], runs.items(), strict=True):
        for lane, (began, end, compiling) in enumerate(run.processes):
            chart.barh(-lane, end - began, left=began, height=0.55, color=TEAL, alpha=0.35)
            chart.barh(
                [-lane] * len(compiling),
                [b - a for a, b in compiling],
                left=[a for a, _ in compiling],
                height=0.55,
                color=AMBER,
            )
        together: dict[float, list[str]] = {}
        for stage, at in run.stages:
            together.setdefault(at, []).append(stage)
        for at, names in together.items():
            chart.axvline(at, color=INK, lw=0.8)
            chart.text(at, 0.45, ", ".join(names), rotation=35, fontsize=TEXT - 1, color=INK)
        chart.set(xlim=(0, 1.04 * run.wall), ylim=(0.5 - len(run.processes), 1.3), yticks=[])
        chart.set_title(
            f"{label}: {run.cpu:.0f} s of CPU; compiling in amber", loc="left", fontsize=TEXT, color=INK
        )
        chart.spines[["top", "right", "left"]].set_visible(False)
    charts[-1, 0].set_xlabel("time [s]")
    save_figure(figure, path)


def main() -> None:
    """Print the table; draw the time line."""
    parser = parser_of(__doc__)
    parser.add_argument("--picture", type=Path, help="PNG of the time line")
    parser.add_argument("--kernels", type=int, default=25, help="number of kernels in the table")
    arguments = parser.parse_args()
    with TemporaryDirectory() as folder:
        runs = {label: timed_demo(Path(folder), label) for label in ("first", "second")}
    print(heads("demo", "CPU [s]", "of it compiling [s]", "wall [s]", *(s for s, _ in runs["first"].stages)))
    for label, run in runs.items():
        stages = " | ".join(f"{at:.0f} s" for _, at in run.stages)
        print(f"| {label} | {run.cpu:.0f} | {sum(run.kernels.values()):.0f} | {run.wall:.0f} | {stages} |")
    print("\n" + heads("kernel", "compiling [s]"))
    own, numba = Counter[str](), 0.0
    for kernel, seconds in runs["first"].kernels.items():
        if kernel.startswith("numba."):
            numba += seconds
        else:
            own[kernel] += seconds
    for kernel, seconds in own.most_common(arguments.kernels):
        print(f"| `{kernel}` | {seconds:.1f} |")
    others = sum(own.values()) - sum(seconds for _, seconds in own.most_common(arguments.kernels))
    print(f"| other kernels | {others:.1f} |\n| numba's own functions | {numba:.1f} |")
    if arguments.picture is not None:
        picture(runs, arguments.picture)


if __name__ == "__main__":
    main()
