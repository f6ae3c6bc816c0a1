"""A log streamed from its file, read whole or reduced on a cluster gives the same graph; bad logs are told apart."""

from __future__ import annotations

import socketserver
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import further

import logs
from logs import stream
from logs.run import RangeSensor, Run
from logs.stream import McapStream, open_log
from planners.arena import Arena
from sensorgraph.building import training_data
from sensorgraph.building.build import build
from sensorgraph.cli import run as command
from sensorgraph.dask_client import cluster_map, connected
from sensorgraph.errors import SensorgraphError
from sensorgraph.localization import kept
from sensorgraph.models.faces import reduction
from sensorgraph.world.raycast import cast


@pytest.fixture(scope="module")
def run(room: Arena, sensor: RangeSensor) -> Run:
    """Return 700 scans on a winding way through the room, with poses at 30 Hz and odometry."""
    rng = np.random.default_rng(3)

    def way(t: np.ndarray) -> np.ndarray:
        return np.column_stack([1.3 + 0.8 * np.sin(0.31 * t), 1.5 + 0.9 * np.sin(0.23 * t + 1), 0.7 * t])

    stamps, pose_stamps = np.arange(700) * 0.1, np.arange(-5, 2110) / 30
    ranges = cast(room, way(stamps), sensor).ranges
    ranges = ranges + 0.01 * rng.normal(size=ranges.shape)
    ranges[rng.random(ranges.shape) < 0.01] = np.inf
    poses = way(pose_stamps)
    poses[:, 2] = np.pi - (np.pi - poses[:, 2]) % (2 * np.pi)
    return Run(
        sensor=sensor, stamps=stamps, ranges=ranges, pose_stamps=pose_stamps, poses=poses,
        odom_stamps=pose_stamps, odometry=poses, odom_twists=np.zeros((len(poses), 2)), epoch_ns=10**18,
    )  # fmt: skip


@pytest.fixture(scope="module")
def path(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("stream") / "run.mcap"
    logs.write(run, out)
    return out


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cut logs into many pieces and blocks."""
    monkeypatch.setattr(stream, "PIECE", 90)
    monkeypatch.setattr(stream, "MARGIN_NS", 1_000_000_000)
    for module in (training_data, reduction):
        monkeypatch.setattr(module, "SCANS_PER_BLOCK", 128)


def test_a_log_without_poses_is_located_with_all_its_odometry(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stamps = np.linspace(run.stamps[0], run.stamps[-1], 3 * stream.FIRST_MESSAGES)
    wheels = run.poses_at(stamps)
    short = replace(
        run.take_scans(slice(0, stream.FIRST_MESSAGES)),
        pose_stamps=np.zeros(0),
        poses=np.zeros((0, 3)),
        pose_covariances=np.zeros((0, 3, 3)),
        odom_stamps=stamps,
        odometry=wheels,
        odom_twists=np.zeros((len(stamps), 2)),
    )
    logs.write(short, tmp_path / "short.mcap")
    given: list[Run] = []

    def located(path: Path, run: Run, *_: object, **__: object) -> kept.KeptRun:
        given.append(run)
        raise SensorgraphError("located")

    monkeypatch.setattr(kept, "located", located)
    command(["build", str(tmp_path / "short.mcap"), "-o", str(tmp_path / "x.sensorgraph")])
    assert len(given[0].odom_stamps) == len(stamps)
    assert given[0].n_scans == short.n_scans


def bytes_of(graph, path: Path) -> bytes:
    graph.save(path)
    return path.read_bytes()


@pytest.mark.usefixtures("small")
def test_pieces_are_the_run(path: Path) -> None:
    whole, log = logs.read(path), open_log(path)
    assert isinstance(log, McapStream)
    assert log.n_scans == whole.n_scans
    pieces = list(log.pieces())
    assert len(pieces) > 5
    np.testing.assert_array_equal(np.concatenate([p.stamps for p in pieces]), whole.stamps)
    np.testing.assert_array_equal(np.concatenate([p.ranges for p in pieces]), whole.ranges)
    found = np.concatenate([logs.pair(p).poses for p in pieces])
    np.testing.assert_array_equal(found, logs.pair(whole).poses)
    assert max(len(p.pose_stamps) for p in pieces) < len(whole.pose_stamps) / 3  # the rest is forgotten


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("split", [None, *further("every10", "block")])
def test_streamed_and_whole_give_the_same_bytes(path: Path, split: str | None, tmp_path: Path) -> None:
    streamed = build([open_log(path)], split=split, names=["a"])
    whole = build([logs.read(path)], split=split, names=["a"])
    assert bytes_of(streamed, tmp_path / "a") == bytes_of(whole, tmp_path / "b")


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
@pytest.mark.usefixtures("small")
def test_a_cluster_gives_the_same_bytes(run: Run, path: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is not installed: pip install '.[dask]'")
    other = tmp_path / "other.mcap"
    logs.write(replace(run, ranges=run.ranges + 0.001), other)
    plain = build([open_log(path), open_log(other)], names=["a", "b"])
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as local,
        cluster_map(local.scheduler_address) as map_blocks,
    ):
        graph = build([open_log(path), open_log(other)], names=["a", "b"], map_blocks=map_blocks)
    assert bytes_of(graph, tmp_path / "a") == bytes_of(plain, tmp_path / "b")


def test_no_scheduler_is_said_in_one_line(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed", reason="Dask is not installed: pip install '.[dask]'")
    monkeypatch.setattr("sensorgraph.dask_client.CONNECT_TIMEOUT", 0.5)
    out = tmp_path / "g.sensorgraph"
    assert command(["build", str(path), "--dask", "tcp://127.0.0.1:1", "-o", str(out)]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "dask scheduler" in line and not out.exists()


@pytest.mark.parametrize("answer", [b"HTTP/1.1 400 Bad Request\r\n\r\n", b""], ids=["other words", "silence"])
def test_a_server_that_is_no_scheduler_is_told_from_one(
    answer: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed", reason="Dask is not installed: pip install '.[dask]'")
    monkeypatch.setattr("sensorgraph.dask_client.CONNECT_TIMEOUT", 0.5)

    class Dashboard(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            self.request.sendall(answer)
            while self.request.recv(4096):
                pass

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Dashboard) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with pytest.raises(SensorgraphError, match="what answers is no scheduler"):
            connected(f"tcp://127.0.0.1:{server.server_address[1]}")
        server.shutdown()


def in_centimetres(run: Run) -> Run:
    return replace(run, ranges=100 * run.ranges)


def blind(run: Run) -> Run:
    return replace(run, ranges=np.full_like(run.ranges, np.inf))


def still(run: Run) -> Run:
    return replace(run, poses=np.tile(run.poses[:1], (len(run.poses), 1)))


def one_scan(run: Run) -> Run:
    return replace(run, stamps=run.stamps[:1], ranges=run.ranges[:1])


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            in_centimetres,
            "looks like centimetres or millimetres, expected metres .divide the ranges by 100 or",
        ),
        (blind, "no ray of the log returned; check range_max"),
        (still, "the pose never changes over 700 scans; check that the robot moved"),
        (one_scan, "1 scans to fit, expected 10 or more"),
    ],
)
def test_what_cannot_be_built_says_what_to_do(run: Run, spoil: Callable[[Run], Run], words: str) -> None:
    with pytest.raises(SensorgraphError, match=words) as caught:
        build([spoil(run)])
    assert "\n" not in str(caught.value)


def mirrored(run: Run) -> Run:
    return replace(run, ranges=run.ranges[:, ::-1])


def jumping(run: Run) -> Run:
    poses = run.poses.copy()
    poses[500:510, 0] += 4.0
    return replace(run, poses=poses)


def doubled(run: Run) -> Run:
    stamps = run.stamps.copy()
    stamps[1::2] = stamps[::2]
    return replace(run, stamps=stamps)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (mirrored, "fits itself better mirrored: check the sign of angle_increment"),
        (jumping, "the pose jumps 2 times, at most 4"),
        (doubled, "350 scan stamps are duplicates"),
    ],
)
def test_what_looks_wrong_is_warned_of(
    run: Run, spoil: Callable[[Run], Run], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs.write(spoil(run), tmp_path / "bad.mcap")
    force = ["--force"] if spoil is jumping else []
    quick = [
        "--model",
        "polynomial",
        "--degree",
        "1",
        "--terms",
        "3",
    ]  # the log is judged before any model is fitted
    graph = ["-o", str(tmp_path / "g.sensorgraph")]
    assert command(["build", str(tmp_path / "bad.mcap"), *force, *quick, *graph]) == 0
    assert words in capsys.readouterr().err


def test_a_good_log_brings_no_warning(path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command(["build", str(path), "-o", str(tmp_path / "g.sensorgraph")]) == 0
    assert "warning" not in capsys.readouterr().err
