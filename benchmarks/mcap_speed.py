"""Writing and reading laser scans in MCAP, ours beside mcap-ros2-support, in one run; prints a markdown table.

    OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python -m benchmarks.mcap_speed [--scans 10000]

Both write /scan only, zstd, with the peer's default chunk of 1 MiB and ours of 64 KiB; both end with ranges as
arrays. CPU time of this process, the best of the repeats, so that a loaded machine disturbs little.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer

import logs
from benchmarks.arguments import parser_of
from benchmarks.measures import fastest
from logs.ros.definitions import definition

RAY_COUNTS = (181, 1081)
REPEATS = 2
"""Of each job; the fastest counts."""


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


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--scans", type=int, default=10_000)
    options = parser.parse_args()
    print("| rays | job | ours [scans/s] | mcap-ros2-support [scans/s] | ratio | ours [MB] | theirs [MB] |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        ours, theirs = Path(folder) / "ours.mcap", Path(folder) / "theirs.mcap"
        for n_rays in RAY_COUNTS:
            run = make_run(options.scans, n_rays)
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
                rates = f"{options.scans / mine:,.0f} | {options.scans / peer:,.0f} | {peer / mine:.1f} ×"
                print(f"| {n_rays} | {job} | {rates} | {sizes[0]:.2f} | {sizes[1]:.2f} |")


if __name__ == "__main__":
    main()
