"""Speed, memory and losses: building a graph, MCAP beside mcap-ros2-support, and recording a robot live.

    OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python -m benchmarks.infrastructure build
    OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python -m benchmarks.infrastructure mcap
    python -m benchmarks.infrastructure live --minutes 10

`build`: 50,000 scans x 181 rays of the office on one core; compilation is done before (on 300 scans).

`mcap`: 10,000 scans, /scan only, zstd, with the peer's default chunk of 1 MiB and ours of 64 KiB; both end with ranges as
arrays. CPU time of this process, the best of the repeats, so that a loaded machine disturbs little.

`live`: what is lost, what it costs, and what is left after kill -9. A router, a robot of our own (`benchmarks.zenoh_robot`:
scan, pose, odometry and command, each at 40 Hz, 1,081 rays) and `sensorgraph record --live` in processes of their own; the
recorder is held on one core.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import time
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer

import logs
from benchmarks import zenoh_robot
from benchmarks.arguments import fastest, heads, parser_of, peak_memory, timed
from logs.ros.definitions import definition
from logs.run import RangeSensor, Run
from planners.maps import geojson
from sensorgraph.building.build import build
from sensorgraph.demo import check_run
from sensorgraph.world.robot import default_robot

N_BUILT, N_WRITTEN = 50_000, 10_000
"""Scans of a graph, and of an MCAP file."""
RAY_COUNTS = (181, 1081)
REPEATS = 2
"""Of each job; the fastest counts."""
RATE, N_LIVE_RAYS = 40.0, 1081
"""[Hz] of the scans of the robot that is recorded, and its rays."""
SENSORGRAPH = [sys.executable, "-c", "from sensorgraph.cli import main; main()"]


def recording(n: int) -> Run:
    """Return scans from n poses spread evenly over the office, with a sensor of 30 m."""
    arena = geojson.loads(files("sensorgraph.data").joinpath("office.geojson").read_text())
    robot = default_robot()
    sensor = RangeSensor(bearings=robot.sensor.bearings, range_max=30.0, sigma=0.01, rate=10.0)
    return check_run(arena, replace(robot, sensor=sensor), np.random.default_rng(0), n)


def time_build(_: argparse.Namespace) -> None:
    """Print time and memory of a build."""
    build([recording(300)])
    run = recording(N_BUILT)
    with timed() as took:
        graph = build([run])
    size = f"{N_BUILT:,} scans x {graph.sensor.n_rays} rays"
    print(f"{size}: {took.cpu:.2f} s of one core, {took.wall:.2f} s by the clock")
    print("; ".join(f"{label}: {text}" for label, text in graph.model.summary().items()))
    print(f"memory at its highest: {peak_memory():,.0f} MiB")


def make_run(n_scans: int, n_rays: int) -> logs.Run:
    rng = np.random.default_rng(0)
    smooth = 3 + np.cumsum(rng.normal(scale=0.01, size=(n_scans, n_rays)), axis=0)
    return logs.Run(
        sensor=logs.RangeSensor(bearings=np.linspace(-np.pi / 2, np.pi / 2, n_rays)),
        stamps=np.arange(n_scans) / 10,
        ranges=np.abs(smooth + rng.normal(scale=0.01, size=smooth.shape)).round(3),
        epoch_ns=1_700_000_000_000_000_000,
    )


def peer_write(run: logs.Run, path: Path) -> None:
    n = run.sensor.n_rays
    with path.open("wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef(
            "sensor_msgs/msg/LaserScan", definition("sensor_msgs/msg/LaserScan").decode()
        )
        for stamp, ranges in zip(run.stamps.tolist(), run.ranges, strict=True):
            ns = run.epoch_ns + round(stamp * 1e9)
            message = {
                "header": {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": "laser"},
                "angle_min": -np.pi / 2, "angle_max": np.pi / 2, "angle_increment": np.pi / (n - 1),
                "time_increment": 0.0, "scan_time": 0.1, "range_min": 0.05, "range_max": 8.0,
                "ranges": ranges.tolist(), "intensities": [],
            }  # fmt: skip
            writer.write_message("/scan", schema, message, log_time=ns, publish_time=ns)
        writer.finish()


def peer_read(path: Path) -> np.ndarray:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return np.stack(
            [np.asarray(m.ranges) for _, _, _, m in reader.iter_decoded_messages(log_time_order=False)]
        )


def time_mcap(_: argparse.Namespace) -> None:
    """Print the rates of writing and reading, as a table."""
    shown = "ours [scans/s]", "mcap-ros2-support [scans/s]", "ratio", "ours [MB]", "theirs [MB]"
    print(heads("rays", "job", *shown, text=2))
    with TemporaryDirectory() as folder:
        ours, theirs = Path(folder) / "ours.mcap", Path(folder) / "theirs.mcap"
        for n_rays in RAY_COUNTS:
            run = make_run(N_WRITTEN, n_rays)
            times = {
                "write": (
                    fastest(lambda run=run: logs.write(run, ours), REPEATS),
                    fastest(lambda run=run: peer_write(run, theirs), REPEATS),
                ),
                "read": (
                    fastest(lambda: logs.read(ours), REPEATS),
                    fastest(lambda: peer_read(theirs), REPEATS),
                ),
            }
            np.testing.assert_array_equal(
                logs.read(ours).ranges.astype(np.float32), np.float32(peer_read(theirs))
            )
            sizes = [path.stat().st_size / 1e6 for path in (ours, theirs)]
            for job, (mine, peer) in times.items():
                rates = f"{N_WRITTEN / mine:,.0f} | {N_WRITTEN / peer:,.0f} | {peer / mine:.1f} ×"
                print(f"| {n_rays} | {job} | {rates} | {sizes[0]:.2f} | {sizes[1]:.2f} |")


def record(folder: Path, seconds: float, *, kill: bool) -> Path:
    """Run robot and recorder; return the file that is left."""
    port = zenoh_robot.free_port()
    router = zenoh_robot.open_session("router", port)
    robot = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.zenoh_robot", "--port", str(port), "--duration", str(seconds),
         "--rate", str(RATE), "--rays", str(N_LIVE_RAYS)],
    )  # fmt: skip
    out = folder / ("killed.mcap" if kill else "run.mcap")
    recorder = subprocess.Popen(
        [*SENSORGRAPH, "record", "--live", "--router", f"127.0.0.1:{port}", "--domain", "0",
         "-o", str(out)],
        preexec_fn=lambda: os.sched_setaffinity(0, {sorted(os.sched_getaffinity(0))[0]}),
    )  # fmt: skip
    robot.wait()
    time.sleep(1.0)
    recorder.kill() if kill else recorder.send_signal(2)
    recorder.wait()
    router.close()
    return out.with_suffix(".mcap.part") if kill else out


def time_live(options: argparse.Namespace) -> None:
    """Print what was lost and what it cost."""
    seconds = 60 * options.minutes
    sent = round(seconds * RATE)
    with TemporaryDirectory() as name:
        folder = Path(name)
        with timed() as took:
            out = record(folder, seconds, kill=False)
        run = logs.read(out)
        counts = (run.n_scans, len(run.poses), len(run.odometry), len(run.commands))
        steps = np.diff(run.stamps)
        print(f"sent {sent:,} of each; in the file: scans {counts[0]:,}, poses {counts[1]:,}, odometry {counts[2]:,}, "
              f"commands {counts[3]:,}; longest step of the stamps {steps.max():.4f} s; {out.stat().st_size / 1e6:.1f} MB")  # fmt: skip
        most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e3
        print(
            f"robot and recorder together: {took.cpu:.1f} s of CPU in {seconds:.0f} s, at most {most:.0f} MB"
        )
        seconds = min(seconds, 20.0)
        part = record(folder, seconds, kill=True)
        saved = folder / "saved.mcap"
        subprocess.run([*SENSORGRAPH, "recover", str(part), "-o", str(saved)], check=True)
        found = logs.read(saved).n_scans
        print(f"kill -9 after {seconds:.0f} s: {found:,} of {round(seconds * RATE):,} scans saved")


def main() -> None:
    """Print one table."""
    parser = parser_of(__doc__)
    jobs = {"build": time_build, "mcap": time_mcap, "live": time_live}
    parser.add_argument("what", choices=jobs)
    parser.add_argument("--minutes", type=float, default=10.0, help="of live recording")
    options = parser.parse_args()
    jobs[options.what](options)


if __name__ == "__main__":
    main()
