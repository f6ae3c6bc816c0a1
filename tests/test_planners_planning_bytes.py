"""The same seed gives the same trajectory.csv, byte by byte: in every process, on one processor or two, whatever ran before."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

import pytest

from planners.vehicle import Drive

SCRIPT = """
import hashlib, os, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
drive, folder, own, before, processors = sys.argv[2], Path(sys.argv[3]), *map(int, sys.argv[4:7])
os.cpu_count = lambda: processors
from planners import plan
from planners.vehicle import Limits, Vehicle
from planners_samples import door_arena
vehicle = Vehicle(drive=drive, limits=Limits(turning_radius=0.0 if drive == "diff" else 0.3))
for seed in [7] * before + [own]:
    made = plan(door_arena(1.2), vehicle, seed=seed, cell=0.5, headings=8)
made.trajectory.write_csv(folder / "trajectory.csv")
print(made.report["coverage"], len(made.trajectory.poses))
"""


def run(drive: Drive, folder: Path, *, seed: int = 5, before: int = 0, processors: int = 2) -> str:
    """Plan in a process of its own, after so many plans of another seed; return the hash of trajectory.csv."""
    folder.mkdir()
    tests = Path(__file__).parent
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            SCRIPT,
            str(tests),
            drive,
            str(folder),
            str(seed),
            str(before),
            str(processors),
        ],
        capture_output=True,
        text=True,
        check=False,
        cwd=tests.parent,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return hashlib.sha256((folder / "trajectory.csv").read_bytes()).hexdigest()


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["diff", "reeds_shepp", "dubins"])
def test_same_seed_same_trajectory_csv(drive: Drive, tmp_path: Path) -> None:
    first = run(drive, tmp_path / "first")
    assert run(drive, tmp_path / "second", before=1, processors=1) == first


@pytest.mark.slow
def test_another_seed_is_another_drive(tmp_path: Path) -> None:
    """So that the test above does not compare what no seed could change."""
    assert run("diff", tmp_path / "first") != run("diff", tmp_path / "second", seed=6)
