"""Cells that the end points of located scans fill, by what is taken for the times of the rays; fewer are sharper.

    python -m benchmarks.sharpness LOG... [--topic scan=NAME]

As found: by `locate`. As stated: those of the log, untested. The log is located again for each. The count is that of
`inspect` (300 scans, cells of 10 cm).
"""

from __future__ import annotations

from dataclasses import replace

import logs
from benchmarks.arguments import parser_of
from logs.run import Run
from sensorgraph.cli.inputs import read_options
from sensorgraph.localization.locate import locate, located_run
from sensorgraph.world.orientation import orientation
from sensorgraph.world.sweep import FROM_ROBOT, RAY_TIMES


def with_sweep(run: Run, sweep_time: float) -> Run:
    """Return the run with another sweep [s] that no localization tests; the ray that is taken first keeps its time."""
    sensor = replace(run.sensor, sweep_time=sweep_time)
    later = sensor.ray_0_after_first - run.sensor.ray_0_after_first
    return replace(run, sensor=sensor, stamps=run.stamps + later, meta={**run.meta, RAY_TIMES: FROM_ROBOT})


def cells(run: Run) -> float:
    """Return the number of filled cells of the located run."""
    found = orientation(located_run(run, locate(run)), None)
    return float("nan") if found is None else found.fits["as logged"]


def main() -> None:
    """Print a row a log."""
    parser = parser_of(__doc__)
    parser.add_argument("logs", nargs="+")
    parser.add_argument("--topic", action="append")
    given = parser.parse_args()
    print("| log | as found | as stated | 0 | reversed |\n|---|---:|---:|---:|---:|")
    for path in given.logs:
        run = logs.read(path, **read_options(given.topic, None, None, None))
        stated = run.sensor.sweep_time
        counts = [
            cells(run), *(cells(with_sweep(run, sweep)) for sweep in (stated, 0.0, -(stated or 1 / run.sensor.rate)))
        ]  # fmt: skip
        print(f"| {path.rstrip('/').split('/')[-1]} | {' | '.join(f'{n:,.0f}' for n in counts)} |")


if __name__ == "__main__":
    main()
