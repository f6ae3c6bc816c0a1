"""Record a robot live, all on this machine: what is lost, what it costs, and what is left after kill -9.

A router, a robot of our own (`benchmarks.zenoh_robot`: scan, pose, odometry and command, each at the scans' rate) and
`sensorgraph record --live` in processes of their own; the recorder is held on one core.
    python -m benchmarks.live_recording --minutes 10
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import logs
from benchmarks import zenoh_robot
from benchmarks.arguments import parser_of

SENSORGRAPH = [sys.executable, "-c", "from sensorgraph.cli import main; main()"]


def record(folder: Path, seconds: float, rate: float, n_rays: int, *, kill: bool) -> Path:
    """Run robot and recorder; return the file that is left."""
    port = zenoh_robot.free_port()
    router = zenoh_robot.open_session("router", port)
    robot = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.zenoh_robot", "--port", str(port), "--duration", str(seconds),
         "--rate", str(rate), "--rays", str(n_rays)],
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


def main() -> None:
    """Print what was lost and what it cost."""
    parser = parser_of(__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=40.0, help="Hz of scans")
    parser.add_argument("--rays", type=int, default=1081)
    options = parser.parse_args()
    seconds = 60 * options.minutes
    sent = round(seconds * options.rate)
    with TemporaryDirectory() as name:
        folder = Path(name)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        out = record(folder, seconds, options.rate, options.rays, kill=False)
        run = logs.read(out)
        counts = (run.n_scans, len(run.poses), len(run.odometry), len(run.commands))
        steps = np.diff(run.stamps)
        print(f"sent {sent:,} of each; in the file: scans {counts[0]:,}, poses {counts[1]:,}, odometry {counts[2]:,}, "
              f"commands {counts[3]:,}; longest step of the stamps {steps.max():.4f} s; {out.stat().st_size / 1e6:.1f} MB")  # fmt: skip
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        print(f"robot and recorder together: {cpu:.1f} s of CPU in {seconds:.0f} s, at most {after.ru_maxrss / 1e3:.0f} MB")  # fmt: skip
        seconds = min(seconds, 20.0)
        part = record(folder, seconds, options.rate, options.rays, kill=True)
        saved = folder / "saved.mcap"
        subprocess.run([*SENSORGRAPH, "recover", str(part), "-o", str(saved)], check=True)
        found = logs.read(saved).n_scans
        print(f"kill -9 after {seconds:.0f} s: {found:,} of {round(seconds * options.rate):,} scans saved")


if __name__ == "__main__":
    main()
