"""CDR: packing and unpacking are inverse, and agree with rosbags."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from logs import LogError
from logs.ros import cdr

STORE = get_typestore(Stores.ROS2_HUMBLE)
TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\x00"), max_size=9)


@given(frame=TEXT, n=st.integers(1, 4), n_rays=st.integers(0, 5), seed=st.integers(0, 999))
def test_scans_unpack_to_what_was_packed_and_rosbags_agrees(
    frame: str, n: int, n_rays: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    ranges = rng.normal(size=(n, n_rays)).astype(np.float32)
    limits = rng.normal(size=(n, 7)).astype(np.float32)
    sec, nanosec = rng.integers(-(2**31), 2**31, n), rng.integers(0, 10**9, n)
    rows = cdr.pack(
        "sensor_msgs/msg/LaserScan", n, strings={"frame_id": frame},
        columns={"sec": sec, "nanosec": nanosec, "limits": limits, "ranges": ranges},
    )  # fmt: skip
    (block,) = cdr.unpack([row.tobytes() for row in rows], "sensor_msgs/msg/LaserScan", "/scan")
    np.testing.assert_array_equal(block["ranges"], ranges)
    np.testing.assert_array_equal(block["limits"], limits)
    np.testing.assert_array_equal(block.stamps_ns, sec * 10**9 + nanosec)
    assert block.strings["frame_id"] == frame
    message = STORE.deserialize_cdr(rows[-1].tobytes(), "sensor_msgs/msg/LaserScan")
    assert message.header.frame_id == frame
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (sec[-1], nanosec[-1])
    np.testing.assert_array_equal(message.ranges, ranges[-1])
    assert np.float32(message.range_max) == limits[-1, 6]


@given(frames=st.lists(st.tuples(TEXT, TEXT), min_size=0, max_size=4), seed=st.integers(0, 999))
def test_transforms_unpack_part_by_part_and_rosbags_agrees(frames: list[tuple[str, str]], seed: int) -> None:
    values = np.random.default_rng(seed).normal(size=(len(frames), 7))
    strings = {f"{i}.frame_id": parent for i, (parent, _) in enumerate(frames)}
    strings |= {f"{i}.child_frame_id": child for i, (_, child) in enumerate(frames)}
    columns = {f"{i}.transform": values[i] for i in range(len(frames))}
    rows = cdr.pack("tf2_msgs/msg/TFMessage", 1, strings=strings, columns=columns, parts=len(frames))
    (block,) = cdr.unpack([rows[0].tobytes()], "tf2_msgs/msg/TFMessage", "/tf")
    message = STORE.deserialize_cdr(rows[0].tobytes(), "tf2_msgs/msg/TFMessage")
    assert block.n_parts == len(frames) == len(message.transforms)
    for i, (parent, child) in enumerate(frames):
        part = block.part(i)
        assert part.strings == {"frame_id": parent, "child_frame_id": child}
        np.testing.assert_array_equal(part["transform"], values[i : i + 1])
        assert message.transforms[i].header.frame_id == parent
        assert message.transforms[i].transform.rotation.w == values[i, 6]


@pytest.mark.parametrize("msgtype", [t for t in cdr.MESSAGE_FIELDS if t != "tf2_msgs/msg/TFMessage"])
def test_every_type_packs_to_bytes_that_rosbags_writes_too(msgtype: str) -> None:
    strings = {"frame_id": "map", "child_frame_id": "base_link"}
    names = [
        name for name, kind in cdr.MESSAGE_FIELDS[msgtype] if isinstance(kind, str) and kind.startswith("f8")
    ]
    columns = {
        name: np.arange(1.0, 1.0 + (36 if "cov" in name else 6 if name == "twist" else 7)) for name in names
    }
    row = cdr.pack(msgtype, 1, strings=strings, columns=columns)[0].tobytes()
    message = STORE.deserialize_cdr(row, msgtype)
    assert bytes(STORE.serialize_cdr(message, msgtype)) == row


def test_messages_of_several_layouts_come_back_in_their_places() -> None:
    msgtype = "geometry_msgs/msg/PoseStamped"
    frames = ["map", "odom", "map", "a_long_frame", "odom"]
    messages = [
        cdr.pack(msgtype, 1, strings={"frame_id": frame}, columns={"pose": np.full(7, float(i))})[0].tobytes()
        for i, frame in enumerate(frames)
    ]
    seen = {}
    for block in cdr.unpack(messages, msgtype, "/pose"):
        for i, values in zip(block.index.tolist(), block["pose"], strict=True):
            seen[i] = (block.strings["frame_id"], values[0])
    assert seen == {i: (frame, float(i)) for i, frame in enumerate(frames)}


@given(data=st.binary(max_size=200), msgtype=st.sampled_from(sorted(cdr.MESSAGE_FIELDS)))
def test_any_bytes_are_read_or_refused_in_one_sentence(data: bytes, msgtype: str) -> None:
    try:
        for block in cdr.unpack([b"\x00\x01\x00\x00" + data], msgtype, "/x"):
            for name in block.places:
                assert block[name].shape[0] == 1
    except LogError as exc:
        assert "\n" not in str(exc)
        assert "/x" in str(exc)


def test_cdr2_aligns_large_numbers_to_four_bytes() -> None:
    head = (
        struct.pack("<iII", 5, 6, 6) + b"a_map\0" + bytes(2)
    )  # 20 bytes, after which CDR leaves 4 bytes free
    values = np.arange(7.0)
    for code, gap in ((b"\x00\x01\x00\x00", 4), (b"\x00\x07\x00\x00", 0)):
        row = code + head + bytes(gap) + values.astype("<f8").tobytes()
        (block,) = cdr.unpack([row], "geometry_msgs/msg/PoseStamped", "/pose")
        np.testing.assert_array_equal(block["pose"][0], values)
    with pytest.raises(LogError, match="it starts with 00 0b 00 00, expected little-endian CDR or CDR2"):
        list(cdr.unpack([b"\x00\x0b\x00\x00" + row], "geometry_msgs/msg/PoseStamped", "/pose"))


def test_big_endian_is_refused_by_name() -> None:
    with pytest.raises(LogError, match="little-endian"):
        list(cdr.unpack([b"\x00\x00\x00\x00" + bytes(80)], "geometry_msgs/msg/PoseStamped", "/pose"))


@given(parts=st.lists(st.lists(st.binary(max_size=9), max_size=9), min_size=1, max_size=3), loose=st.binary())
def test_packed_messages_keep_their_order_and_come_out_by_size(
    parts: list[list[bytes]], loose: bytes
) -> None:
    packed = cdr.Messages(parts[0])
    for part in parts[1:]:
        more = cdr.Messages(part)
        packed.take(more)
        assert len(more) == 0
    packed.append(loose)
    expected = [*(message for part in parts for message in part), loose]
    assert list(packed) == expected and len(packed) == len(expected)
    by_size = {
        int(i): row.tobytes() for index, rows in packed.by_size() for i, row in zip(index, rows, strict=True)
    }
    assert [by_size[i] for i in range(len(expected))] == expected
