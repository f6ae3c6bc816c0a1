"""Logging a run to rerun: one call a scan against columns in blocks, as `sensorgraph review` does it.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.rerun_logging

The frame is that of the review: end points of 181 rays, the robot's arrow and one scalar. Both ways write the same
points to a file in one process, in turn; the fastest of three repeats counts.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rerun as rr

from benchmarks.arguments import parser_of

N_LOGGED_RAYS = 181


def per_scan(
    recording: rr.RecordingStream, points: np.ndarray, poses: np.ndarray, series: np.ndarray
) -> None:
    """Log every scan by calls of its own."""
    for k in range(len(points)):
        recording.set_time("time", duration=0.1 * k)
        recording.log("plan/measured", rr.Points2D(points[k]))
        arrow = rr.Arrows2D(origins=poses[k : k + 1, :2], vectors=poses[k : k + 1, :2])
        recording.log("plan/robot", arrow)
        recording.log("ray/measured", rr.Scalars(series[k]))


def in_columns(block: int) -> Callable[..., None]:
    """Return a logger that sends blocks of scans as columns."""

    def work(
        recording: rr.RecordingStream, points: np.ndarray, poses: np.ndarray, series: np.ndarray
    ) -> None:
        for start in range(0, len(points), block):
            part = slice(start, start + block)
            n = len(points[part])
            time_column = [rr.TimeColumn("time", duration=0.1 * np.arange(start, start + n))]
            flat = points[part].reshape(-1, 2)
            columns = rr.Points2D.columns(positions=flat).partition([N_LOGGED_RAYS] * n)
            recording.send_columns("plan/measured", time_column, columns)
            arrows = rr.Arrows2D.columns(origins=poses[part, :2], vectors=poses[part, :2])
            recording.send_columns("plan/robot", time_column, arrows)
            recording.send_columns("ray/measured", time_column, rr.Scalars.columns(scalars=series[part]))

    return work


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--scans", type=int, default=5000)
    n = parser.parse_args().scans
    rng = np.random.default_rng(0)
    data = rng.uniform(0, 8, (n, N_LOGGED_RAYS, 2)), rng.uniform(0, 8, (n, 3)), rng.uniform(0, 8, n)
    ways = {
        "`log` for each scan": per_scan,
        "columns, blocks of 200": in_columns(200),
        "**columns, blocks of 500 (ours)**": in_columns(500),
        "columns, whole run": in_columns(n),
    }
    best = dict.fromkeys(ways, np.inf)
    size = {}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(3):
            for name, work in ways.items():
                path = Path(folder) / "a.rrd"
                recording = rr.RecordingStream("benchmark")
                recording.save(path)
                start = time.perf_counter()
                work(recording, *data)
                recording.disconnect()
                best[name] = min(best[name], time.perf_counter() - start)
                size[name] = path.stat().st_size / 1e6
    slow = best["`log` for each scan"]
    print(f"{n:,} scans of {N_LOGGED_RAYS} rays, with arrow and scalar\n")
    print("| way | scans/s | faster by | file MB |\n|---|---|---|---|")
    for name, seconds in best.items():
        print(f"| {name} | {n / seconds:,.0f} | {slow / seconds:.1f}x | {size[name]:.1f} |")


if __name__ == "__main__":
    main()
