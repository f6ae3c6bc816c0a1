"""Files that somebody made to do harm, or that were damaged: one line, little memory, nothing from outside their folder."""

from __future__ import annotations

import bz2
import gzip
import io
import json
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import pytest
import zstandard

import logs
from benchmarks.fuzz import samples
from logs import inflation
from logs.errors import LogError
from logs.inflation import ALLOWANCE
from logs.recovery import recover
from planners import maps
from planners.errors import PlanError
from planners.maps import geojson
from planners.yaml_text import parse_yaml
from robotmodic_ident import IdentError, Moments, Narmax
from sensorgraph.building.build import build
from sensorgraph.cli import run as cli
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.localization.patches import Patches, assign
from sensorgraph.recording.drive_source import open_drive
from sensorgraph.show.figures.sensorgraph import graph_picture
from sensorgraph.show.review.review import review
from sensorgraph.world.robot import parse_robot
from sensorgraph.world.wall_distance import WallDistance

GIB = 1 << 30
MAGIC = b"\x89MCAP0\r\n"


class Chunk(NamedTuple):
    """A chunk as rosbags describes it."""

    datasize: int
    datapos: int
    decompressor: Any


def peak(action: Callable[[], object]) -> int:
    """Return the most memory [bytes] that Python held meanwhile."""
    tracemalloc.start()
    try:
        action()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def zeros(size: int) -> bytes:
    """Pack so many zeros by zstd, without holding them."""
    packer = zstandard.ZstdCompressor(level=1).compressobj(size=size)
    return b"".join(packer.compress(bytes(1 << 20)) for _ in range(size >> 20)) + packer.flush()


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def chunk(kind: bytes, data: bytes, promised: int) -> bytes:
    head = struct.pack("<QQQI", 0, 0, promised, 0) + struct.pack("<I", len(kind)) + kind
    return record(6, head + struct.pack("<Q", len(data)) + data)


@pytest.mark.parametrize("promised", [1000, GIB])
def test_a_chunk_that_unpacks_to_a_gibibyte_is_refused_in_little_memory(
    tmp_path: Path, promised: int
) -> None:
    data = zeros(GIB)
    assert len(data) < 100_000
    path = tmp_path / "bomb.mcap"
    path.write_bytes(
        MAGIC + record(1, bytes(8)) + chunk(b"zstd", data, promised) + record(15, bytes(4)) + MAGIC
    )

    def read() -> None:
        with pytest.raises(LogError, match="more than it or a file of this size can hold"):
            logs.read(path)
        with pytest.raises(LogError):
            recover(path, tmp_path / "out.mcap")

    assert peak(read) < 2 * ALLOWANCE


@pytest.mark.parametrize(
    "pack", [lambda d: gzip.compress(d, 9), lambda d: bz2.compress(d, 9)], ids=["gzip", "bzip2"]
)
def test_a_packed_text_log_that_unpacks_without_end_is_refused(
    pack: Callable[[bytes], bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(inflation, "ALLOWANCE", 1 << 20)
    path = tmp_path / "bomb.log"
    path.write_bytes(pack(b"FLASER 1 1.0 0 0 0 0 0 0 0 h 0\n") + pack(b" " * (20 << 20)))

    def read() -> None:
        with pytest.raises(LogError, match="which no log does"):
            logs.read(path)

    assert peak(read) < 15 << 20  # bzip2 and gzip work in blocks


def test_a_sensorgraph_that_unpacks_to_gibibytes_is_refused_before_it_does(tmp_path: Path) -> None:
    path = tmp_path / "bomb.sensorgraph"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("header.json", "{}")
        with file.open("a.npy", "w", force_zip64=True) as member:
            for _ in range(128):
                member.write(bytes(1 << 20))

    def load() -> None:
        with pytest.raises(SensorgraphError, match="which no sensorgraph does"):
            Sensorgraph.load(path)

    assert peak(load) < 10_000_000


def test_an_array_that_promises_more_than_it_holds_is_refused(tmp_path: Path) -> None:
    array = io.BytesIO()
    np.lib.format.write_array_header_1_0(array, {"descr": "<f8", "fortran_order": False, "shape": (10**10,)})
    path = tmp_path / "bomb.sensorgraph"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("header.json", "{}")
        file.writestr("a.npy", array.getvalue() + bytes(80))
    with pytest.raises(SensorgraphError, match="holds 80 bytes"):
        Sensorgraph.load(path)


@pytest.fixture(scope="module")
def graphs() -> dict[str, bytes]:
    """Files of small graphs, one of each model."""
    return dict(zip(("faces", "polynomial", "cells"), samples.graphs(), strict=False))


def with_member(data: bytes, name: str, change: Callable[[Any], Any]) -> bytes:
    """Change one array, or what header.json says, in the file of a graph; checksums are right again."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as before, zipfile.ZipFile(out, "w") as after:
        for member in before.namelist():
            content = before.read(member)
            if member == name == "header.json":
                top = json.loads(content)
                content = json.dumps(change(top) or top).encode()
            elif member == name:
                array, file = np.load(io.BytesIO(content)), io.BytesIO()
                changed = change(array)
                np.save(file, array if changed is None else changed)
                content = file.getvalue()
            after.writestr(member, content)
    return out.getvalue()


def to(value: float, where: Any = (..., 0)) -> Callable[[Any], None]:
    """Return what puts a value into an array."""

    def change(array: Any) -> None:
        array[where] = value

    return change


def at(path: str, value: object) -> Callable[[Any], None]:
    """Return what puts a value into a header, by the names on the way to it."""

    def change(top: Any) -> None:
        *way, last = path.split(".")
        for step in way:
            top = top[step]
        top[last] = value

    return change


@pytest.mark.parametrize(
    ("model", "member", "change", "said"),
    [
        ("polynomial", "order.npy", to(99), "order is"),
        ("polynomial", "order.npy", to(0, ...), "order names a term of a ray twice"),
        ("polynomial", "theta.npy", to(np.nan, ...), "theta holds nan"),
        ("polynomial", "theta.npy", to(np.inf, ...), "theta holds inf"),
        ("polynomial", "theta.npy", lambda a: a.astype(complex), "theta holds complex128"),
        ("polynomial", "root.npy", to(1e200, ...), "root holds 1e[+]200"),
        ("polynomial", "returns.npy", to(-1), "returns is -1"),
        ("polynomial", "visited.npy", lambda a: np.tile(a, 2), "visited is not in increasing order"),
        (
            "polynomial",
            "header.json",
            at("state.scale", {"x": [0, 1e-200], "y": [0, 1]}),
            "a width of 1e-200",
        ),
        ("polynomial", "header.json", at("state.scale", {"x": [0, 1]}), "the scale is of x"),
        ("polynomial", "header.json", at("state.choice.degree", -4), "the form is"),
        ("polynomial", "header.json", at("state.support.cell", 0), "the support's cell is 0"),
        (
            "polynomial",
            "header.json",
            at("state.leverage_limit", float("nan")),
            "state.leverage_limit is nan",
        ),
        ("polynomial", "header.json", at("pose_frame", "hand"), "pose_frame is 'hand'"),
        ("polynomial", "header.json", at("origin.inputs", [1]), "the inputs are"),
        ("polynomial", "header.json", at("sensor.sigma", float("nan")), "the sensor has"),
        ("faces", "levels.npy", to(7.0, 0), "levels is"),
        ("faces", "levels.npy", to(0.5, -1), "beyond the last edge"),
        ("faces", "edges.npy", lambda a: a[::-1], "edges of a face are not in increasing order"),
        ("faces", "offsets.npy", to(1e20, 0), "offsets is"),
        ("faces", "normals.npy", to(0.0, ...), "has not length 1"),
        ("faces", "neighbour.npy", lambda a: a.astype(float), "neighbour has shape"),
        ("faces", "mount.npy", to(np.nan, ...), "mount holds nan"),
        ("faces", "hits.npy", lambda a: a[1:], "hits has shape"),
        ("faces", "crossed.counts.npy", lambda a: a[:0], "crossed.counts has shape"),
        ("faces", "memory.face.npy", to(10_000, ...), "memory.face is"),
        ("faces", "header.json", at("state.cell", 0), "cell is 0"),
        ("faces", "header.json", at("state.noise.sigma", 0), "noise.sigma is 0"),
        ("faces", "header.json", at("state.returns", 2), "returns is 2"),
        ("cells", "rate.npy", to(255, ...), "rate is 255"),
        ("cells", "rate.npy", lambda a: a.astype(float), "rate holds float64"),
        ("cells", "header.json", at("state.sigma", -1), "sigma is -1"),
    ],
)
def test_a_number_that_no_model_has_is_refused_when_its_graph_is_loaded(
    model: str, member: str, change: Callable[[Any], Any], said: str, graphs: dict[str, bytes], tmp_path: Path
) -> None:
    path = tmp_path / "odd.sensorgraph"
    path.write_bytes(with_member(graphs[model], member, change))
    with pytest.raises(SensorgraphError, match=rf"odd.sensorgraph: the sensorgraph is damaged .*{said}"):
        Sensorgraph.load(path)


def test_arrays_of_the_other_byte_order_predict_the_same(graphs: dict[str, bytes], tmp_path: Path) -> None:
    path, poses = tmp_path / "a.sensorgraph", np.array([[1.0, 1.0, 0.2], [1.1, 1.0, 2.0]])
    path.write_bytes(graphs["cells"])
    right = Sensorgraph.load(path).predict(poses)
    with zipfile.ZipFile(path) as file:
        names = [name for name in file.namelist() if name.endswith(".npy")]
    data = graphs["cells"]
    for name in names:
        data = with_member(data, name, lambda a: a.astype(a.dtype.newbyteorder(">")))
    path.write_bytes(data)
    np.testing.assert_array_equal(Sensorgraph.load(path).predict(poses).ranges, right.ranges)


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """A map whose image lies beside its folder, and a link to it."""
    (tmp_path / "maps").mkdir()
    (tmp_path / "secret.pgm").write_bytes(samples.PGM)
    return tmp_path / "maps"


@pytest.mark.parametrize("name", ["../secret.pgm", "{tmp}/secret.pgm", "link.pgm"])
def test_the_image_of_a_map_stays_in_its_folder_unless_allowed(
    name: str, outside: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (outside / "link.pgm").symlink_to(outside.parent / "secret.pgm")
    path = outside / "map.yaml"
    image = name.format(tmp=outside.parent)
    path.write_bytes(samples.MAP.replace(b"map.pgm", image.encode()))
    monkeypatch.delenv("SENSORGRAPH_ALLOW_OUTSIDE", raising=False)
    with pytest.raises(PlanError, match="outside the folder of the map"):
        maps.load(path)
    monkeypatch.setenv(
        "SENSORGRAPH_ALLOW_OUTSIDE", "0"
    )  # set again by the option, and put back by monkeypatch
    words = ["plan", str(path), "--start", "9,9,9", "-o", str(outside / "plan")]
    assert cli(words) == 2
    assert "outside the folder" in capsys.readouterr().err
    assert cli(["--allow-outside", *words]) == 2
    assert "outside the folder" not in capsys.readouterr().err


def test_a_map_and_its_image_that_are_links_into_one_folder_are_read(outside: Path) -> None:
    """As `colcon build --symlink-install` leaves them."""
    (outside.parent / "map.yaml").write_bytes(samples.MAP.replace(b"map.pgm", b"secret.pgm"))
    for name in ("map.yaml", "secret.pgm"):
        (outside / name).symlink_to(outside.parent / name)
    assert maps.load(outside / "map.yaml").free.area > 0


def test_a_bag_lists_only_files_of_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SENSORGRAPH_ALLOW_OUTSIDE", raising=False)
    bag = tmp_path / "bag"
    bag.mkdir()
    db3 = samples.small_bag()
    (tmp_path / "a.db3").write_bytes(db3)
    (bag / "metadata.yaml").write_bytes(samples.METADATA.replace(b"a.db3", b"../a.db3"))
    with pytest.raises(LogError, match="outside its folder"):
        logs.read(bag)
    monkeypatch.setenv("SENSORGRAPH_ALLOW_OUTSIDE", "1")
    assert logs.read(bag).n_scans == 12


def test_nine_lines_of_yaml_do_not_say_a_billion_words() -> None:
    lines = ["a0: &a0 [lol, lol, lol, lol, lol, lol, lol, lol, lol]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 10)]
    with pytest.raises(SensorgraphError, match="once its aliases are followed"):
        parse_robot("\n".join(lines))
    assert parse_yaml("a: &a [1, 2]\nb: *a") == {"a": [1, 2], "b": [1, 2]}


def test_a_message_of_an_error_is_one_line_of_readable_length() -> None:
    for kind in (LogError, PlanError, SensorgraphError):
        assert str(kind("a\n  b")) == "a b"
        assert len(str(kind("x" * 10_000))) < 1500


def test_ros_1_chunks_do_not_unpack_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inflation, "ALLOWANCE", 1 << 20)
    for pack in (bz2.compress, lz4.frame.compress):
        bomb = pack(bytes(20 << 20))
        reader = type("Bag", (), {})()
        reader.readers = [type("Inner", (), {"chunks": {0: Chunk(len(bomb), 0, None)}})()]
        logs.formats.rosbag.cap_chunks(reader, len(bomb))
        with pytest.raises(ValueError, match="unpacks to more than"):
            reader.readers[0].chunks[0].decompressor(bomb)


@pytest.mark.parametrize("rate", ["0", "-1", "nan", "inf"])
def test_a_table_whose_rate_cannot_be_is_refused(rate: str, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    logs.write(samples.some_run(), path)
    path.write_text(path.read_text().replace("# rate: 10.0", f"# rate: {rate}"))
    with pytest.raises(LogError, match="expected a number above 0"):
        logs.read(path)


@pytest.mark.parametrize(
    "change",
    [
        lambda arrays: arrays | {"gram": arrays["gram"][:1]},
        lambda arrays: arrays | {"power": np.array([b"x"])},
        lambda arrays: arrays | {"count": np.array([-1])},
        lambda arrays: arrays | {"missing_outputs": np.array([7]), "missing": np.zeros((1, 6, 6))},
        lambda arrays: {name: array for name, array in arrays.items() if name != "cross"},
    ],
)
def test_moments_whose_arrays_do_not_fit_are_refused(change: Callable[[Any], Any], tmp_path: Path) -> None:
    path = tmp_path / "sums.npz"
    path.write_bytes(samples.moments())
    with np.load(path) as data:
        arrays = dict(data)
    assert Moments.load(path).count.tolist() == [30]
    np.savez(path, **change(arrays))
    with pytest.raises(IdentError, match="not a file of moments"):
        Moments.load(path)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(IdentError, match="not a file of moments"):
        Moments.load(path)


def test_a_run_of_which_nothing_is_predicted_is_no_picture(tmp_path: Path) -> None:
    graph = build([samples.some_run()], calibrate=False)
    elsewhere = replace(samples.some_run(), ranges=samples.some_run().ranges * 0.3)
    with pytest.raises(SensorgraphError, match="nothing to draw"):
        graph_picture(graph, tmp_path / "a.png", run=elsewhere)


def test_points_find_no_patch_where_there_is_none() -> None:
    nothing = np.zeros((0, 2))
    patches = Patches(middles=nothing, normals=nothing, towards=nothing, side=0.1)
    assert assign(np.ones((3, 2)), np.ones((3, 2)), patches, 0.1).tolist() == [-1, -1, -1]


@pytest.mark.parametrize("x", [-1e308, 1e308, float("inf"), float("nan")])
def test_a_place_beyond_all_maps_is_outside_the_arena(x: float) -> None:
    assert WallDistance(geojson.loads(samples.GEOJSON.decode()))(x, 1.0) == 0.0


@pytest.mark.parametrize("key", ["output", "stop", "estimator"])
def test_a_model_whose_texts_are_none_is_refused(key: str, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    path.write_text(json.dumps(json.loads(samples.models()[0]) | {key: None}))
    with pytest.raises(IdentError, match=f"{key} is None"):
        Narmax.load(path)


@pytest.mark.parametrize("text", ["{", "[]", '{"coverage": "x"}', "[" * 5000])
def test_a_plan_report_that_is_none_is_refused_by_review_and_record(text: str, tmp_path: Path) -> None:
    logs.write(samples.some_run(), tmp_path / "run.mcap")
    (tmp_path / "plan").mkdir()
    (tmp_path / "plan" / "trajectory.csv").write_bytes(samples.TRAJECTORY)
    (tmp_path / "plan" / "plan.json").write_text(text)
    with pytest.raises(SensorgraphError, match=r"plan.json: (not JSON|holds no report)"):
        review(tmp_path / "run.mcap", plan=tmp_path / "plan", path=tmp_path / "a.rrd")
    with pytest.raises(SensorgraphError, match=r"plan.json: (not JSON|holds no report)"):
        open_drive(tmp_path / "plan").attachments()


@pytest.mark.parametrize(("theta", "said"), [(float("inf"), "theta is"), (1e308, "too large")])
def test_a_model_with_numbers_beyond_all_is_refused(theta: float, said: str, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    data = json.loads(samples.models()[0])
    data["scale"] = {"y": [0.0, 1e-9], "u": [0.0, 1e-9]}
    data["terms"][0]["theta"] = data["terms"][1]["theta"] = theta
    path.write_text(json.dumps(data))
    with pytest.raises(IdentError, match=said):
        Narmax.load(path).equation()


def test_a_deeply_nested_json_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "deep.geojson"
    path.write_text("[" * 100_000)
    assert cli(["plan", str(path), "-o", str(tmp_path / "plan")]) == 2
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [[]] * 3}))
    assert cli(["plan", str(path), "-o", str(tmp_path / "plan")]) == 2
