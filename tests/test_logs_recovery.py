"""Damaged files of every kind: one clear sentence, never a traceback, never a silent loss."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from conftest import further
from logs_samples import some_run
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader

import logs
from logs.mcap.records import MAGIC
from logs.recovery import recover

N_SCANS, N_RAYS = 30, 721
ORIGINAL = some_run(N_SCANS, N_RAYS, seed=3)  # several chunks


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    logs.write(ORIGINAL, path)
    return path.read_bytes()


def boundaries(data: bytes) -> list[int]:
    """Where each record starts."""
    at, pos = [], 8
    while pos < len(data) - 8:
        at.append(pos)
        pos += 9 + struct.unpack_from("<Q", data, pos + 1)[0]
    return at


def assert_part_of_original(path: Path) -> int:
    """Every scan in the file is one of the original's, unchanged; return how many there are."""
    run = logs.read(path)
    places = np.searchsorted(ORIGINAL.stamps, run.stamps - 1e-6)
    np.testing.assert_allclose(run.stamps, ORIGINAL.stamps[places], atol=1e-9)
    np.testing.assert_array_equal(run.ranges, ORIGINAL.ranges[places].astype(np.float32))
    assert len(np.unique(places)) == run.n_scans
    return run.n_scans


def opens_elsewhere(path: Path) -> None:
    """Other readers open the file and count the same messages."""
    with path.open("rb") as file:
        n_mcap = sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())
    with AnyReader([path]) as reader:
        assert reader.message_count == n_mcap
        assert sum(1 for _ in reader.messages()) == n_mcap


@pytest.mark.parametrize("part", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 7))])
def test_every_cut_is_refused_when_read_and_recovered_without_a_false_scan(
    whole: bytes, tmp_path: Path, part: int
) -> None:
    rng = np.random.default_rng(5)
    cuts = {c + d for c in boundaries(whole) for d in (-1, 0, 1, 9)} | set(
        rng.integers(1, len(whole), 60).tolist()
    )
    cuts |= {1, 7, 8, 9, 40, len(whole) - 8, len(whole) - 1}
    path, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    saved_before = 0
    for cut in sorted(c for c in cuts if 0 < c < len(whole))[part::7]:
        path.write_bytes(whole[:cut])
        with pytest.raises(logs.LogError) as caught:
            logs.read(path)
        assert "\n" not in str(caught.value)
        try:
            saved = recover(path, out)
        except logs.LogError as exc:
            assert "nothing can be recovered" in str(exc) or cut < len(MAGIC)
            assert saved_before == 0
            continue
        assert not saved.is_whole
        n_scans = assert_part_of_original(out)
        assert n_scans >= saved_before  # a longer piece never gives less
        saved_before = n_scans
    assert saved_before == N_SCANS


def test_cut_at_a_chunk_boundary_keeps_every_scan_before(whole: bytes, tmp_path: Path) -> None:
    path, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    chunks = [pos for pos in boundaries(whole) if whole[pos] == 0x06]
    assert len(chunks) >= 2
    path.write_bytes(whole[: chunks[-1]])
    with path.open("rb") as file:
        stream = StreamReader(file)
        n_before = 0
        with pytest.raises(Exception):  # noqa: B017 - what it raises at the cut is not ours
            for record in stream.records:
                n_before += type(record).__name__ == "Message"
    assert sum(recover(path, out).written.values()) == n_before > 0
    opens_elsewhere(out)


@pytest.mark.parametrize("seed", [*range(8), *further(*range(8, 20))])
def test_flipped_bytes_are_noticed_and_recovery_gives_nothing_false(
    whole: bytes, tmp_path: Path, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    data = bytearray(whole)
    for pos in rng.integers(0, len(data), rng.integers(1, 4)).tolist():
        data[pos] ^= int(rng.integers(1, 256))
    path, out = tmp_path / "flipped.mcap", tmp_path / "out.mcap"
    path.write_bytes(data)
    with pytest.raises(logs.LogError) as caught:
        logs.read(path)
    assert "\n" not in str(caught.value)
    saved = recover(path, out)
    assert not saved.is_whole
    n_scans = assert_part_of_original(out) if "sensorgraph" in saved.metadata else saved.written["/scan"]
    assert n_scans + saved.lost.get("/scan", 0) >= N_SCANS - 25  # at most a chunk or two
    opens_elsewhere(out)


def test_one_flip_inside_a_chunk_costs_that_chunk_only_and_is_counted(whole: bytes, tmp_path: Path) -> None:
    chunks = [pos for pos in boundaries(whole) if whole[pos] == 0x06]
    for pos in chunks:
        data = bytearray(whole)
        data[pos + 200] ^= 0x10
        (tmp_path / "flipped.mcap").write_bytes(data)
        saved = recover(tmp_path / "flipped.mcap", tmp_path / "out.mcap")
        assert saved.bad_chunks == 1
        assert saved.lost["/scan"] + saved.written["/scan"] == N_SCANS
        assert saved.written["/scan"] > 0
        assert_part_of_original(tmp_path / "out.mcap")
        opens_elsewhere(tmp_path / "out.mcap")


@pytest.mark.parametrize("first_bit", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 8))])
def test_any_record_whose_kind_changed_is_noticed(whole: bytes, tmp_path: Path, first_bit: int) -> None:
    """A flipped opcode can make a private record, a message of an index, or hide the end of the data section.

    One bit of each record, another in the next; all eight bits of all records in all cases.
    """
    path, out = tmp_path / "flipped.mcap", tmp_path / "out.mcap"
    for i, pos in enumerate(boundaries(whole)):
        data = bytearray(whole)
        data[pos] ^= 1 << (first_bit + i) % 8
        path.write_bytes(data)
        with pytest.raises(logs.LogError):
            logs.read(path)
        assert not recover(path, out).is_whole
        assert assert_part_of_original(out) >= N_SCANS // 2


@pytest.mark.parametrize(
    "change", [(b"history: 1", b"history: 7"), (b"- history", b"} history"), (b"- history", b"- his:ory")]
)
def test_a_damaged_quality_of_service_is_restored(
    change: tuple[bytes, bytes], whole: bytes, tmp_path: Path
) -> None:
    (tmp_path / "bad.mcap").write_bytes(whole[:-100].replace(*change))
    recover(tmp_path / "bad.mcap", tmp_path / "out.mcap")
    opens_elsewhere(tmp_path / "out.mcap")
    assert change[0] in (tmp_path / "out.mcap").read_bytes()


def test_sensor_facts_that_changed_are_left_out_and_said(whole: bytes, tmp_path: Path) -> None:
    at = whole.index(repr(ORIGINAL.sensor.sigma).encode())
    data = whole[:at] + b"9" + whole[at + 1 :]
    (tmp_path / "bad.mcap").write_bytes(data)
    with pytest.raises(logs.LogError, match="checksum"):
        logs.read(tmp_path / "bad.mcap")
    saved = recover(tmp_path / "bad.mcap", tmp_path / "out.mcap")
    assert any("`sensorgraph` has changed" in line for line in saved.lines())
    run = logs.read(tmp_path / "out.mcap")
    assert run.meta["format"] == "mcap" and run.n_scans == N_SCANS
    np.testing.assert_allclose(run.sensor.mount, ORIGINAL.sensor.mount, atol=1e-12)


@pytest.mark.parametrize("byte", range(9))
def test_damaged_framing_of_a_chunk_is_stepped_over(whole: bytes, tmp_path: Path, byte: int) -> None:
    chunks = [pos for pos in boundaries(whole) if whole[pos] == 0x06]
    data = bytearray(whole)
    data[chunks[1] + byte] ^= 0x41
    (tmp_path / "flipped.mcap").write_bytes(data)
    with pytest.raises(logs.LogError, match="damaged at byte"):
        logs.read(tmp_path / "flipped.mcap")
    saved = recover(tmp_path / "flipped.mcap", tmp_path / "out.mcap")
    assert saved.written["/scan"] >= N_SCANS - 60 * 1024 // (4 * N_RAYS)
    assert_part_of_original(tmp_path / "out.mcap")
    opens_elsewhere(tmp_path / "out.mcap")


@pytest.mark.parametrize("part", ["head magic", "header", "summary", "footer", "end magic", "tail added"])
def test_damage_outside_the_chunks_loses_no_message(whole: bytes, tmp_path: Path, part: str) -> None:
    data = bytearray(whole)
    at = boundaries(whole)
    if part == "tail added":
        data += b"something else"
    else:
        place = {
            "head magic": 2, "header": at[0] + 10, "summary": at[-3] + 12, "footer": at[-1] + 12,
            "end magic": len(data) - 3,
        }[part]  # fmt: skip
        data[place] ^= 0xFF
    (tmp_path / "bad.mcap").write_bytes(data)
    with pytest.raises(logs.LogError):
        logs.read(tmp_path / "bad.mcap")
    saved = recover(tmp_path / "bad.mcap", tmp_path / "out.mcap")
    assert not saved.is_whole
    assert assert_part_of_original(tmp_path / "out.mcap") == N_SCANS
    opens_elsewhere(tmp_path / "out.mcap")


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("chunked", [True, False])
def test_files_of_other_writers_are_recovered_too(
    tmp_path: Path, compression: CompressionType, chunked: bool
) -> None:
    """One big chunk, cut in the middle: what is whole in it is kept, whatever its compression can give."""
    path, out = tmp_path / "other.mcap", tmp_path / "out.mcap"
    rng = np.random.default_rng(0)
    payloads = [rng.bytes(700) for _ in range(2000)]
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 30, compression=compression, use_chunking=chunked)
        writer.start("ros2", "test")
        schema = writer.register_schema("x/msg/Y", "ros2msg", b"")
        channel = writer.register_channel("/x", "cdr", schema)
        for i, payload in enumerate(payloads):
            writer.add_message(channel, i, payload, i)
        writer.finish()
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    saved = recover(path, out)
    assert saved.written["/x"] > 700
    with out.open("rb") as file:
        got = [message.data for _, _, message in make_reader(file).iter_messages()]
    assert got == payloads[: len(got)]


def test_whole_file_is_recovered_whole(whole: bytes, tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(whole)
    saved = recover(tmp_path / "run.mcap", tmp_path / "out.mcap")
    assert saved.is_whole and saved.bytes_lost == 0
    assert saved.lines()[-1] == "lost nothing: the file was intact"
    assert logs.read(tmp_path / "out.mcap").attachments == ORIGINAL.attachments


@pytest.mark.parametrize("out", ["", "."])
def test_recovery_into_a_folder_is_refused(out: str, whole: bytes, tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(whole)
    with pytest.raises(logs.LogError, match="is a folder; give the name of a file"):
        recover(tmp_path / "run.mcap", Path(out))


def test_recovery_never_overwrites_the_damaged_file(whole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(whole[:-100])
    with pytest.raises(logs.LogError, match="damaged file itself"):
        recover(path, path)
    assert path.read_bytes() == whole[:-100]
