"""Runs for the tests of `logs`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from logs import RangeSensor, Run

DATA = Path(__file__).parents[2] / "shared" / "data"


def some_run(
    n_scans: int = 40,
    n_rays: int = 19,
    *,
    seed: int = 1,
    pose_frame: str = "base_link",
    epoch_ns: int = 1_700_000_000_123_456_789,
    with_odometry: bool = True,
) -> Run:
    """A run with every signal, every kind of missing return, and stamps that are whole nanoseconds."""
    rng = np.random.default_rng(seed)
    stamps = np.arange(n_scans) / 10 + 0.05
    ranges = rng.uniform(0.1, 7.9, (n_scans, n_rays)).astype(np.float32).astype(np.float64)
    if n_scans:
        ranges[0, :4] = [np.inf, -np.inf, np.nan, 0.125]
    pose_stamps = np.arange(3 * n_scans + 3) / 30
    pose_stamps = np.round(pose_stamps, 9)
    odom_stamps = np.arange(2 * n_scans + 2) / 20
    if not with_odometry:
        odom_stamps = odom_stamps[:0]
    return Run(
        sensor=RangeSensor(
            bearings=np.linspace(-1.5, 1.7, n_rays),
            range_min=0.05,
            range_max=8.0,
            mount=np.array([0.1, -0.02, 0.03]),
            sigma=0.012,
            resolution=0.001,
            rate=10.0,
            sweep_time=0.04,
            height=0.3,
        ),
        stamps=stamps,
        ranges=ranges,
        pose_stamps=pose_stamps,
        poses=_walk(rng, len(pose_stamps)),
        odom_stamps=odom_stamps,
        odometry=_walk(rng, len(odom_stamps)),
        odom_twists=rng.normal(size=(len(odom_stamps), 2)),
        cmd_stamps=stamps,
        commands=rng.normal(size=(n_scans, 2)),
        pose_frame=pose_frame,
        epoch_ns=epoch_ns,
        meta={"source": "test", "note": "Grüße, a=b: c"},
        attachments={"scene.geojson": b'{"type": "FeatureCollection"}', "blob": bytes(range(256))},
    )


def _walk(rng: np.random.Generator, n: int) -> np.ndarray:
    poses = np.cumsum(rng.normal(scale=0.05, size=(n, 3)), axis=0)
    poses[:, 2] = np.pi - (np.pi - 20 * poses[:, 2]) % (2 * np.pi)
    return poses


def assert_same_run(got: Run, want: Run, *, pose_tol: float = 1e-12) -> None:
    """Ranges to float32, stamps to 1 ns, all else exact but headings, which pass through a quaternion."""
    for name in (
        "range_min",
        "range_max",
        "sigma",
        "resolution",
        "rate",
        "sweep_time",
        "height",
    ):
        assert getattr(got.sensor, name) == getattr(want.sensor, name), name
    np.testing.assert_array_equal(got.sensor.bearings, want.sensor.bearings)
    np.testing.assert_array_equal(got.sensor.mount, want.sensor.mount)
    for name in ("stamps", "pose_stamps", "odom_stamps", "cmd_stamps"):
        np.testing.assert_allclose(getattr(got, name), getattr(want, name), rtol=0, atol=1e-9, err_msg=name)
    np.testing.assert_array_equal(got.ranges, want.ranges.astype(np.float32))
    for name in ("poses", "odometry", "odom_twists", "commands"):
        np.testing.assert_allclose(
            getattr(got, name), getattr(want, name), rtol=0, atol=pose_tol, err_msg=name
        )
    assert got.pose_frame == want.pose_frame
    assert got.epoch_ns == want.epoch_ns
    assert dict(got.meta) == dict(want.meta)
    assert dict(got.attachments) == dict(want.attachments)
