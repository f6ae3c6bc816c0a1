"""ROS 1 bags of every age: what is whole is read, what is cut is recovered, and only what is damaged is called so."""

from __future__ import annotations

import bz2
import lzma
from dataclasses import replace
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import pytest
from bag1_samples import bag12, bag20, bag_header, chunks_of, drive, laser, record, twist, u4
from conftest import further, peak
from mcap.reader import make_reader

import logs
from logs import inflation
from logs.formats.bag_records import BagWalk
from logs.mcap.records import Loss
from logs.notes import notes_of
from logs.recovery import recover

N = 25
FIRST = np.float32(1 + np.arange(N) / 100)


def drive_chunk() -> bytes:
    """A chunk of other messages."""
    return chunks_of([laser(2e9, [9, 9, 9, 9, 9])] * 3, compression="bz2")[0][0]


def read(path: Path, data: bytes) -> logs.Run:
    path.write_bytes(data)
    return logs.read(path)


def bag_notes(run: logs.Run) -> list[str]:
    return [note for note in notes_of(run) if "bag" in note]


def assert_all_there(run: logs.Run) -> None:
    np.testing.assert_array_equal(run.ranges[:, 0], FIRST)
    np.testing.assert_allclose(run.stamps, np.arange(N) / 10, atol=1e-6)
    np.testing.assert_allclose(run.commands[:, 0], 0.1 * np.arange(N))


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_chunks_of_every_compression_are_read(compression: str, tmp_path: Path) -> None:
    run = read(tmp_path / "a.bag", bag20(drive(), compression=compression))
    assert_all_there(run)
    assert bag_notes(run) == []


@pytest.mark.parametrize("order", [("time", "conn", "op"), ("conn", "op", "time")])
def test_fields_of_a_message_may_have_any_order(order: tuple[str, ...], tmp_path: Path) -> None:
    assert_all_there(read(tmp_path / "a.bag", bag20(drive(), order=order)))


def test_an_index_of_2010_that_states_twenty_bytes_for_twelve_is_no_damage(tmp_path: Path) -> None:
    for entry in (20, 12):
        run = read(tmp_path / "a.bag", bag20(drive(), entry=entry))
        assert_all_there(run)
        assert bag_notes(run) == []


@pytest.mark.parametrize("with_header", [True, False])
def test_version_1_2_without_chunks_is_read(with_header: bool, tmp_path: Path) -> None:
    assert_all_there(read(tmp_path / "a.bag", bag12(drive(), with_header=with_header)))


def test_a_bag_that_was_not_closed_but_is_whole_is_read_with_one_note(tmp_path: Path) -> None:
    run = read(tmp_path / "a.bag.active", bag20(drive(), is_closed=False))
    assert_all_there(run)
    assert bag_notes(run) == [
        "the bag was not closed by its recorder and has no index, but all 50 messages were read"
    ]


def test_a_bag_whose_index_alone_is_cut_is_read_with_one_note(tmp_path: Path) -> None:
    whole = bag20(drive())
    for cut in (5, 60, 300):
        run = read(tmp_path / "a.bag", whole[:-cut])
        assert_all_there(run)
        assert len(bag_notes(run)) == 1 and "index at the end of the bag is incomplete" in bag_notes(run)[0]


@pytest.mark.parametrize("junk", [bytes(700), drive_chunk()[:150]], ids=["zeros", "part of a chunk"])
def test_bytes_that_reindexing_left_before_the_index_are_no_damage(junk: bytes, tmp_path: Path) -> None:
    """`rosbag reindex` of a truncated bag does so (ros_comm#2282); rosbag plays it by the index."""
    run = read(tmp_path / "a.bag", bag20(drive(), junk=junk))
    assert_all_there(run)
    assert (
        len(bag_notes(run)) == 1
        and "bytes that the index of the bag does not list were skipped" in bag_notes(run)[0]
    )


@pytest.mark.parametrize("is_closed", [True, False])
@pytest.mark.parametrize("version", ["2.0", *further("1.2")])
def test_every_cut_is_refused_or_whole_and_its_messages_are_recovered(
    version: str, is_closed: bool, tmp_path: Path
) -> None:
    """A cut file gives a start of the messages, in order and unchanged, and the more the later it is cut."""
    whole = bag20(drive(), is_closed=is_closed) if version == "2.0" else bag12(drive(), with_header=is_closed)
    path, out = tmp_path / "cut.bag", tmp_path / "out.mcap"
    saved_before = 0
    for cut in np.unique(np.random.default_rng(3).integers(14, len(whole), 40)).tolist():
        path.write_bytes(whole[:cut])
        try:
            n_read = logs.read(path).n_scans
        except logs.LogError as exc:
            assert "\n" not in str(exc)
            assert (
                "truncated" in str(exc) or "no scans" in str(exc) or "no Range and no LaserScan" in str(exc)
            )
            n_read = -1
        try:
            saved = recover(path, out)
        except logs.LogError as exc:
            assert "nothing can be recovered" in str(exc)
            assert saved_before == 0
            continue
        n_saved = saved.written.get("/scan", 0)
        assert n_saved >= max(saved_before, n_read)
        saved_before = n_saved
        if n_saved:
            run = logs.read(out)
            np.testing.assert_array_equal(run.ranges[:, 0], FIRST[:n_saved])
    assert saved_before > N / 2


def test_a_recovered_bag_opens_in_other_tools_with_its_types(tmp_path: Path) -> None:
    path, out = tmp_path / "a.bag", tmp_path / "out.mcap"
    path.write_bytes(bag20(drive())[:-900])
    saved = recover(path, out)
    with out.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        assert {schema.encoding for schema in summary.schemas.values()} == {"ros1msg"}
        assert {schema.name for schema in summary.schemas.values()} == {
            "sensor_msgs/LaserScan", "geometry_msgs/Twist"
        }  # fmt: skip
        assert summary.statistics.message_count == sum(saved.written.values())
        assert reader.get_header().profile == "ros1"


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_a_flipped_chunk_is_lost_alone(compression: str, tmp_path: Path) -> None:
    """The framing of one chunk is broken: the others are saved, and the loss is given by topic."""
    path, out = tmp_path / "a.bag", tmp_path / "out.mcap"
    data = bytearray(bag20(drive(), compression=compression, per_chunk=10))
    second = data.index(b"compression=" + compression.encode(), data.index(b"op=\x04"))
    data[second + 60 : second + 90] = bytes(30)
    path.write_bytes(data)
    with pytest.raises(logs.LogError, match=f"is damaged at byte .* sensorgraph recover {path}"):
        logs.read(path)
    saved = recover(path, out)
    assert saved.losses and saved.written["/scan"] >= N - 5
    assert set(logs.read(out).ranges[:, 0]) < set(FIRST)
    if compression != "none":
        assert saved.lost == {"/scan": 5, "/cmd_vel": 5}


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"#ROSBAG V1.1\n" + bytes(50), "version 1.1, expected 1.2 or 2.0"),
        (b"#ROSBAG V3.0\n" + bytes(50), "version 3.0"),
        (
            b"#ROSBAG V2.0\n"
            + record({"op": b"\x03", "index_pos": bytes(8), "encryptor": b"rosbag/AesCbcEncryptor"}, b""),
            "is encrypted",
        ),
    ],
)
def test_what_cannot_be_read_is_named(data: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(data)
    for use in (logs.read, lambda file: recover(file, tmp_path / "out.mcap")):
        with pytest.raises(logs.LogError, match=words):
            use(path)


@pytest.mark.parametrize("pack", [bz2.compress, lz4.frame.compress], ids=["bz2", "lz4"])
@pytest.mark.parametrize("stated", [1000, 20 << 20])
def test_a_chunk_does_not_unpack_without_end(
    pack: object, stated: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(inflation, "ALLOWANCE", 1 << 20)
    monkeypatch.setattr(inflation, "MAX_RATIO", 10)
    kind = b"bz2" if pack is bz2.compress else b"lz4"
    bomb = pack(bytes(20 << 20))  # type: ignore[operator]
    chunk = record({"op": b"\x05", "compression": kind, "size": u4(stated)}, bomb)
    losses: list[Loss] = []

    def walk() -> None:
        data = b"#ROSBAG V2.0\n" + bag_header(0, 0, 0) + chunk
        assert list(BagWalk(data, lambda *_: None, losses.append).steps())

    assert peak(walk) < 15 << 20  # bz2 works in blocks
    assert any("unpacks to more than" in loss.why for loss in losses)


def test_an_unknown_compression_is_named(tmp_path: Path) -> None:
    chunk = record({"op": b"\x05", "compression": b"xz", "size": u4(5)}, lzma.compress(b"hello"))
    path = tmp_path / "a.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + bag_header(0, 0, 1) + chunk)
    with pytest.raises(logs.LogError, match=r"compression b'xz' is unknown; expected none, bz2 or lz4"):
        logs.read(path)


def test_two_types_on_one_topic_are_two_topics(tmp_path: Path) -> None:
    samples = [replace(twist(1e9 + i / 10, 0.1 * i), topic="/scan") for i in range(5)]
    run = read(tmp_path / "a.bag", bag20([*(laser(1e9 + i / 10, [1 + i, 2]) for i in range(5)), *samples]))
    assert run.n_scans == 5
    np.testing.assert_allclose(run.commands[:, 0], 0.1 * np.arange(5))


def test_two_publishers_of_one_topic_stay_in_the_order_of_the_file(tmp_path: Path) -> None:
    """Two connections share /scan; their messages alternate, and their stamps do not go back."""
    samples = [replace(laser(1e9 + i / 10, [1 + i, 2]), publisher=i % 2) for i in range(8)]
    run = read(tmp_path / "a.bag", bag20(samples))
    np.testing.assert_array_equal(run.ranges[:, 0], 1 + np.arange(8))
    assert not any("go back" in note for note in notes_of(run))
