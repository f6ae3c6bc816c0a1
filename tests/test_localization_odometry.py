"""The odometry of a CARMEN log, which states it in ODOM lines and again in each scan line: which of them was when."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from localization_samples import looking_about, seen

import logs
from logs.run import Run
from logs.types import Floats
from sensorgraph.localization.locate import located_run
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of, with_one_odometry
from sensorgraph.localization.result import Localization
from sensorgraph.localization.scan_lag import scan_lag
from sensorgraph.localization.tracked_run import track_run

BEARINGS = np.radians(np.arange(-90.0, 90.0))  # of 180 rays in a CARMEN log
PERIOD, SECONDS = 0.17, 40.0  # [s]


def carmen(path: Path, times: Floats, stamps: Floats, odom_times: Floats, in_scans: Floats) -> Run:
    """Write and read a log of scans taken at `times` with their `stamps`, and ODOM lines of the true poses, in the order of time.

    Parameters
    ----------
    in_scans : (n_scans, 3) odometry in the scan lines
    """
    rng = np.random.default_rng(0)
    ranges = seen(looking_about(times), BEARINGS) + rng.normal(0, 0.01, (len(times), len(BEARINGS)))
    lines = [
        (
            t,
            "ODOM "
            + " ".join(f"{v:.6f}" for v in looking_about(np.array([t]))[0])
            + f" 0 0 0 {t:.6f} host {t:.6f}",
        )
        for t in odom_times
    ]
    for stamp, scan, pose in zip(stamps, ranges, in_scans, strict=True):
        shown = " ".join(f"{v:.6f}" for v in pose)
        values = " ".join(f"{v:.3f}" for v in scan)
        lines.append((stamp, f"FLASER 180 {values} {shown} {shown} {stamp:.6f} host {stamp:.6f}"))
    path.write_text("\n".join(line for _, line in sorted(lines, key=lambda line: line[0])) + "\n")
    return logs.read(path)


def last_lines(stamps: Floats, odom_times: Floats) -> Floats:
    """Return the poses (n, 3) of the last ODOM lines before the stamps."""
    return looking_about(odom_times[np.searchsorted(odom_times, stamps, side="right") - 1])


def times_of_a_log(seed: int = 0) -> tuple[Floats, Floats]:
    """Return times of scans and of ODOM lines, which come at other, uneven times."""
    rng = np.random.default_rng(seed)
    odom_times, times = np.arange(0.0, SECONDS, PERIOD), np.arange(0.5, SECONDS - 0.5, PERIOD)
    odom_times, times = (one + rng.uniform(0.0, 0.4 * PERIOD, len(one)) for one in (odom_times, times))
    return times, odom_times


def errors(run: Run) -> Floats:
    """Return errors [m] of the odometry at the scans, of which the stamps are the times."""
    motion = odometry_of(run)
    assert motion is not None
    off = odometry_at_scans(run, motion) - looking_about(run.stamps)
    return np.hypot(off[:, 0], off[:, 1])


def test_poses_that_repeat_the_last_odom_line_have_its_time(tmp_path: Path) -> None:
    times, odom_times = times_of_a_log()
    run = carmen(tmp_path / "copies.log", times, times, odom_times, last_lines(times, odom_times))
    motion = odometry_of(run)
    assert motion is not None
    np.testing.assert_array_equal(motion.stamps, run.odom_stamps)
    assert errors(run).max() < 0.005
    late = np.hypot(*(run.poses - looking_about(run.stamps))[:, :2].T)
    assert late.max() > 0.04  # what the poses of the scan lines would be off by


def test_poses_that_the_logger_interpolated_are_those_of_the_scans(tmp_path: Path) -> None:
    times, odom_times = times_of_a_log()
    run = carmen(tmp_path / "interpolated.log", times, times, odom_times[::5], looking_about(times))
    assert errors(run).max() < 1e-5
    one = with_one_odometry(run)
    np.testing.assert_array_equal(one.odom_stamps, run.stamps)
    np.testing.assert_allclose(one.odometry[:, :2], looking_about(times)[:, :2], atol=1e-5)
    assert one.odom_twists.shape == (run.n_scans, 2)


def test_without_a_clock_a_pose_belongs_to_the_scan_in_its_line(tmp_path: Path) -> None:
    times, odom_times = times_of_a_log()
    run = carmen(tmp_path / "a.log", times, times, odom_times, last_lines(times, odom_times))
    path = tmp_path / "stopped.log"
    words = [line.split() for line in (tmp_path / "a.log").read_text().splitlines()]
    path.write_text("\n".join(" ".join([*one[:-3], "5.0", "host", "5.0"]) for one in words) + "\n")
    stopped = logs.read(path)
    motion = odometry_of(stopped)
    assert motion is not None and len(motion.stamps) == run.n_scans
    np.testing.assert_array_equal(motion.stamps, stopped.stamps)


def test_a_located_run_keeps_the_odometry_that_was_used(tmp_path: Path) -> None:
    times, odom_times = times_of_a_log()
    run = carmen(tmp_path / "interpolated.log", times, times, odom_times[::5], looking_about(times))
    n = run.n_scans
    found = Localization(
        t=run.stamps, poses=looking_about(times), covariances=np.zeros((n, 3, 3)), status=("ok",) * n
    )
    located = located_run(run, found)
    used, kept = odometry_of(run), odometry_of(located)
    assert used is not None and kept is not None
    np.testing.assert_array_equal(kept.stamps, used.stamps)
    np.testing.assert_allclose(kept.poses, used.poses, atol=1e-9)
    logs.write(located, tmp_path / "located.mcap")
    again = odometry_of(logs.read(tmp_path / "located.mcap"))
    assert again is not None
    np.testing.assert_allclose(again.stamps, used.stamps, atol=1e-6)


def test_other_logs_have_one_odometry(tmp_path: Path) -> None:
    times, odom_times = times_of_a_log()
    run = carmen(tmp_path / "interpolated.log", times, times, odom_times[::5], looking_about(times))
    other = replace(run, meta={**run.meta, "pose_source": "/amcl_pose"})
    assert with_one_odometry(other) is other
    motion = odometry_of(other)
    assert motion is not None and len(motion.stamps) == len(run.odom_stamps)


def test_the_lag_of_scans_is_found_where_their_lines_repeat_older_odometry(tmp_path: Path) -> None:
    """As on the log aces, whose scans are stamped 0.1 s late; by the poses in its scan lines, they would be early."""
    times, odom_times = times_of_a_log()
    lag = 0.1
    run = carmen(tmp_path / "late.log", times, times + lag, odom_times, last_lines(times + lag, odom_times))
    motion = odometry_of(run)
    assert motion is not None
    found = scan_lag(run, motion, track_run(replace(run, meta={**run.meta, "ray_times": "robot.yaml"})).track)
    assert found is not None
    assert found.value == pytest.approx(-lag, abs=0.01)
