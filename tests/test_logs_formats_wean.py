"""The logs of CMU's Wean Hall: lines of centimetres and a fixed laser."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import logs


def test_wean_lines_become_metres_with_their_mount(tmp_path: Path) -> None:
    lines = []
    for i in range(4):
        ranges = " ".join(["8191"] * 2 + [str(100 + i)] * 178)
        lines += [f"O {100 * i} 0 0 {i}", f"L {100 * i} 0 0 {100 * i + 25} 0 0 {ranges} {i}.5"]
    (tmp_path / "robotdata.log").write_text("\n".join(lines) + "\n")
    run = logs.read(tmp_path / "robotdata.log")
    assert run.meta["format"] == "wean"
    assert np.isposinf(run.ranges[:, :2]).all()
    np.testing.assert_allclose(run.ranges[:, 2], [1.0, 1.01, 1.02, 1.03])
    np.testing.assert_allclose(run.sensor.mount, [0.25, 0, 0], atol=1e-12)
    np.testing.assert_allclose(run.poses[:, 0], np.arange(4))
    np.testing.assert_allclose(
        run.odom_stamps, np.arange(4)
    )  # of the O lines: those of L lines are older than their stamps
    np.testing.assert_allclose(run.odometry[:, 0], np.arange(4))
