"""Files that somebody made to do harm, or that were damaged: one line, little memory, nothing from outside their folder."""

from __future__ import annotations

import bz2
import gzip
import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard
from conftest import peak

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
from sensorgraph.building.build import build
from sensorgraph.cli import run as cli
from sensorgraph.errors import SensorgraphError
from sensorgraph.localization.patches import Patches, assign
from sensorgraph.recording.drive_source import open_drive
from sensorgraph.show.figures.sensorgraph import graph_picture
from sensorgraph.show.review.review import review
from sensorgraph.world.robot import parse_robot
from sensorgraph.world.wall_distance import WallDistance

GIB = 1 << 30
MAGIC = b"\x89MCAP0\r\n"


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
        with pytest.raises(LogError, match="more than it states or a file of this size can hold"):
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
        with pytest.raises(LogError, match="which exceeds the limit for a log"):
            logs.read(path)

    assert peak(read) < 15 << 20  # bzip2 and gzip work in blocks


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
    words = ["plan", str(path), "--start", "9,9,0", "-o", str(outside / "plan")]
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
    with pytest.raises(SensorgraphError, match="with its aliases expanded"):
        parse_robot("\n".join(lines))
    assert parse_yaml("a: &a [1, 2]\nb: *a") == {"a": [1, 2], "b": [1, 2]}


def test_a_message_of_an_error_is_one_line_of_readable_length() -> None:
    for kind in (LogError, PlanError, SensorgraphError):
        assert str(kind("a\n  b")) == "a b"
        assert len(str(kind("x" * 10_000))) < 1500


@pytest.mark.parametrize("rate", ["0", "-1", "nan", "inf"])
def test_a_table_whose_rate_cannot_be_is_refused(rate: str, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    logs.write(samples.some_run(), path)
    path.write_text(path.read_text().replace("# rate: 10.0", f"# rate: {rate}"))
    with pytest.raises(LogError, match="expected a number above 0"):
        logs.read(path)


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


def test_a_deeply_nested_json_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "deep.geojson"
    path.write_text("[" * 100_000)
    assert cli(["plan", str(path), "-o", str(tmp_path / "plan")]) == 2
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [[]] * 3}))
    assert cli(["plan", str(path), "-o", str(tmp_path / "plan")]) == 2
