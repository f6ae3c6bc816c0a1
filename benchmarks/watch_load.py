"""Load, latency and memory of `watch`: a laser of 1,081 rays at 40 Hz in the shipped office, for hours.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.watch_load --minutes 4 --hours 2
    OPENBLAS_NUM_THREADS=1 python -m benchmarks.watch_load --minutes 4 --hours 0.1 --carried 20 --paced

A simulated robot drives through viewpoints of the office for `--minutes`, twice with other noise: the first drive makes the
graph, the second one is watched, forward and backward in turn, until `--hours` of driving have passed. Prints

- the CPU time over the time driven: the load on one core
- the time from a scan to its end, for scans without and with a statement: the latency
- the resident memory after each tenth of the hours, with its slope from the second tenth on

With `--carried`, the robot is carried to another place every so many seconds, believes that it was not, and is searched for. With
`--paced`, each scan arrives at its stamp, as live, so that the searches compete with the scans as they do on a robot.
"""

from __future__ import annotations

import gc
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

import logs
import sensorgraph as sg
from benchmarks.arguments import parser_of
from benchmarks.particle_filter import driven
from logs.run import Run
from logs.transforms import compose, invert
from sensorgraph.watching.observation import Observation
from sensorgraph.watching.watcher import Watcher

ROBOT = """\
drive: diff
sensor: {{n_rays: 1081, fov: 4.71238898, range_max: 30.0, sigma: 0.01, rate: {rate}}}
"""


def memory() -> float:
    """Return the resident memory [MB] of this process, without the mapped files."""
    (line,) = (
        line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("RssAnon")
    )
    return float(line.split()[1]) / 1e3


class Latencies:
    """Counts of times in steps of 0.1 ms: their memory does not grow with the hours."""

    STEP = 1e-4  # [s]

    def __init__(self) -> None:
        self.counts, self.longest = np.zeros(10_000, int), 0.0

    def add(self, seconds: float) -> None:
        """Count one time [s]; those of a second and more are counted in the last step."""
        self.counts[min(int(seconds / self.STEP), len(self.counts) - 1)] += 1
        self.longest = max(self.longest, seconds)

    def quantile(self, share: float) -> float:
        """Return the upper end [ms] of the step below which a share of the times lies."""
        total = np.cumsum(self.counts)
        return 1e3 * self.STEP * (1 + int(np.searchsorted(total, share * total[-1])))


def make(folder: Path, minutes: float, rate: float) -> None:
    """Write the graph of one drive, and the arrays of another."""
    (folder / "robot.yaml").write_text(ROBOT.format(rate=rate))
    plan = sg.plan("office", robot=folder / "robot.yaml", views=40, seed=0)
    first, second = (_shortened(sg.record(plan, seed=seed), minutes) for seed in (0, 1))
    sg.build(first).save(folder / "office.sensorgraph")
    poses = logs.pair(second).poses
    known = np.isfinite(poses[:, 0])
    for name, rows in (("ranges", second.ranges), ("odometry", driven(second)), ("poses", poses)):
        np.save(folder / f"{name}.npy", rows[known])


def _shortened(run: Run, minutes: float) -> Run:
    return run.take_scans(np.arange(np.searchsorted(run.stamps, run.stamps[0] + 60 * minutes)))


def to_and_fro(folder: Path, rate: float, seconds: float, carried: float) -> Iterator[Observation]:
    """Yield the scans of a drive forward and backward in turn, with odometry and the true pose as belief.

    Every `carried` seconds the drive goes on at a random scan, of which odometry and belief know nothing.
    """
    ranges, odometry, poses = (
        np.load(folder / f"{name}.npy", mmap_mode="r") for name in ("ranges", "odometry", "poses")
    )
    n, rng, k, ahead, next_time = len(ranges), np.random.default_rng(0), 0, 1, carried
    moved = [np.zeros(3), np.zeros(3)]  # from odometry and pose of the drive to those of the robot
    for stamp in np.arange(0.0, seconds, 1.0 / rate):
        if stamp >= next_time:
            there, next_time = int(rng.integers(n)), next_time + carried
            moved = [
                compose(compose(off, one[k]), invert(one[there]))
                for off, one in zip(moved, (odometry, poses), strict=True)
            ]
            k = there
        yield Observation(
            stamp=float(stamp),
            ranges=np.array(ranges[k]),
            odometry=compose(moved[0], odometry[k]),
            believed=compose(moved[1], poses[k]),
        )
        if not 0 <= k + ahead < n:
            ahead = -ahead
        k += ahead


def watch(folder: Path, rate: float, hours: float, *, carried: float, paced: bool) -> None:
    """Watch the drive and print the tables."""
    watcher, seconds = Watcher(sg.load(folder / "office.sensorgraph"), waits=not paced), 3600 * hours
    plain, stating, told, wrong = Latencies(), Latencies(), [], 0
    mark, began, last, first = 0.1, time.process_time(), 0.0, time.perf_counter()
    for one in to_and_fro(folder, rate, seconds, carried):
        if paced:
            time.sleep(max(first + one.stamp - time.perf_counter(), 0.0))
        start = time.perf_counter()
        status = watcher.add(one)
        (plain if status is None else stating).add(time.perf_counter() - start)
        last = one.stamp
        wrong += status is not None and status.pose.status in ("off", "lost")
        if one.stamp >= mark * seconds:
            gc.collect()
            told.append(memory())
            print(f"{one.stamp / 3600:5.2f} h driven: {told[-1]:.0f} MB")
            mark += 0.1
    n_statements = int(stating.counts.sum())
    cpu, n_rays = time.process_time() - began, watcher.readings.sensor.n_rays
    print(
        f"load: {cpu / last:.1%} of a core at {rate:g} Hz x {n_rays} rays; {wrong} of {n_statements} statements are wrong"
    )
    for name, each in (("without", plain), ("with", stating)):
        print(f"latency {name} a statement: median below {each.quantile(0.5):.1f} ms, 99 % {each.quantile(0.99):.1f} ms, "
              f"99.9 % {each.quantile(0.999):.1f} ms, longest {1e3 * each.longest:.1f} ms, {each.counts.sum():,} scans")  # fmt: skip
    slope = np.polyfit(np.arange(1, len(told)), told[1:], 1)[0] / (0.1 * hours) if len(told) > 3 else np.nan
    print(f"memory: {told[-1]:.0f} MB, {slope:+.1f} MB an hour of driving")


def main() -> None:
    """Print the tables."""
    parser = parser_of(__doc__)
    parser.add_argument("--minutes", type=float, default=4.0)
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--rate", type=float, default=40.0, help="[Hz] of the laser")
    parser.add_argument("--carried", type=float, default=np.inf, help="[s] of driving between two kidnaps")
    parser.add_argument("--paced", action="store_true", help="each scan arrives at its stamp")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with ProcessPoolExecutor(
            1, mp_context=get_context("spawn")
        ) as maker:  # its memory is not that of `watch`
            maker.submit(make, folder, options.minutes, options.rate).result()
        watch(folder, options.rate, options.hours, carried=options.carried, paced=options.paced)


if __name__ == "__main__":
    main()
