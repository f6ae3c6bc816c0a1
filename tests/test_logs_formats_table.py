"""CSV tables: written and read again, or refused in a sentence that says how to mend them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from logs_samples import assert_same_run, some_run

import logs
from logs import Run
from logs.transforms import dead_reckoning


def on_scan_stamps(run: Run) -> Run:
    """The run with every signal at the scans, as a table holds it."""
    fields = {name: getattr(run, name) for name in run.__dataclass_fields__}
    n = run.n_scans
    fields |= {
        "pose_stamps": run.stamps,
        "poses": run.poses[:n],
        "odom_stamps": run.stamps,
        "attachments": {},
    }
    return Run(**fields | {"odometry": run.odometry[:n], "odom_twists": run.odom_twists[:n]})


@pytest.mark.parametrize("pose_frame", ["base_link", "laser"])
def test_table_written_is_table_read(tmp_path: Path, pose_frame: str) -> None:
    run = on_scan_stamps(some_run(pose_frame=pose_frame))
    logs.write(run, tmp_path / "run.csv")
    assert_same_run(logs.read(tmp_path / "run.csv"), run)
    assert [p.name for p in tmp_path.iterdir()] == ["run.csv"]


def test_signals_of_their_own_rate_are_interpolated_at_the_scans(tmp_path: Path) -> None:
    run = some_run()
    logs.write(run, tmp_path / "run.csv")
    got = logs.read(tmp_path / "run.csv")
    np.testing.assert_allclose(got.poses, logs.pair(run).poses, atol=1e-12)
    np.testing.assert_allclose(
        got.odom_twists[:, 0], np.interp(run.stamps, run.odom_stamps, run.odom_twists[:, 0])
    )


def test_table_by_hand_needs_only_stamps_ranges_and_bearings(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        "# bearings: -0.5 0.0 0.75\nt,ray_0,ray_1,ray_2\n0.2,1.0,inf,3.0\n0.1,1.5,-inf,\n", encoding="utf-8"
    )
    run = logs.read(tmp_path / "a.csv")
    np.testing.assert_array_equal(run.stamps, [0.1, 0.2])
    np.testing.assert_array_equal(run.ranges, [[1.5, -np.inf, np.nan], [1.0, np.inf, 3.0]])
    np.testing.assert_array_equal(run.sensor.bearings, [-0.5, 0.0, 0.75])
    assert len(run.pose_stamps) == len(run.odom_stamps) == len(run.cmd_stamps) == 0


def test_twists_alone_are_integrated_to_odometry(tmp_path: Path) -> None:
    rows = "".join(f"{i / 10},1.0,0.5,2.0\n" for i in range(11))
    (tmp_path / "a.csv").write_text("# bearings: 0\nt,v,omega,r0\n" + rows)
    run = logs.read(tmp_path / "a.csv")
    np.testing.assert_allclose(run.odom_twists, np.tile([1.0, 0.5], (11, 1)))
    # after 1 s on a circle of radius v / omega = 2 m
    np.testing.assert_allclose(run.odometry[-1], [2 * np.sin(0.5), 2 - 2 * np.cos(0.5), 0.5], atol=1e-12)


@given(v=st.floats(-1, 1), omega=st.floats(-3, 3), n=st.integers(2, 40))
def test_dead_reckoning_of_a_constant_twist_is_a_circle(v: float, omega: float, n: int) -> None:
    stamps = np.linspace(0, 2, n)
    poses = dead_reckoning(stamps, np.tile([v, 0.0, omega], (n, 1)))
    chord = 2 * v * np.sinc(omega / np.pi)  # of the arc driven in 2 s
    np.testing.assert_allclose(poses[-1, :2], [chord * np.cos(omega), chord * np.sin(omega)], atol=1e-9)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t,r0,r1\n0,1,2\n", r"# bearings: -1\.5708 to 1\.5708 in 2"),
        ("# bearings: 0 1 2\nt,r0,r1\n0,1,2\n", "2 ray columns and 3 bearings"),
        ("# bearings: 0 1\nt,r0,r2\n0,1,2\n", "without a gap"),
        ("# bearings: 0 1\nt,r0,r1\n0,1\n", "row 1 cannot be read: it has 2 cells, expected 3"),
        ("# bearings: 0 1\nt,r0,r1\n0,1,x\n", "row 1 cannot be read"),
        ("# bearings: 0 1\nt,r0,r1\nnan,1,2\n", "not finite"),
        ("# bearings: 1 0\nt,r0,r1\n0,1,2\n", "increasing"),
        ("# bearings: 0 1\nt,r0,r1\n", "no rows"),
    ],
)
def test_table_that_cannot_be_read_says_how_to_mend_it(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(logs.LogError, match=words):
        logs.read(tmp_path / "a.csv")
