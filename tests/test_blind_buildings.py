"""benchmarks/blind_buildings: shares no code with ours, repeats itself to the byte, and its logs mean what its truth says."""

from __future__ import annotations

import ast
import json
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from blind_cases import spread_over_sigma, walls_of

from benchmarks.blind_buildings import cases, generate
from benchmarks.blind_buildings.cases import effect_of, is_dirty_in_turn, make
from benchmarks.blind_buildings.floors import FOLDER, floor_files
from benchmarks.blind_buildings.foreign import FOREIGN
from benchmarks.blind_buildings.library import LIBRARY

GENERATOR = Path(cases.__file__).parent
ALLOWED = set(sys.stdlib_module_names) | {"numpy", "scipy", "shapely", "numba", "yaml", "mcap"}
WRITER = "benchmarks.blind_world.files"
"""What this world shares with another one by somebody who had not seen our code either."""
EFFECTS = {**dict.fromkeys(LIBRARY, "singles"), **dict.fromkeys(FOREIGN, "foreign")}
FAST = ("mount_xy", "g_restart", "g_crab", "g_markerswap", "g_slope")
"""At least one of each channel."""


@pytest.fixture
def floors() -> tuple[Path, ...]:
    if not FOLDER.exists():
        pytest.skip(f"the floors of KTH are not at {FOLDER}")
    return floor_files(FOLDER)


def _generate(monkeypatch: pytest.MonkeyPatch, *options: str) -> None:
    monkeypatch.setattr(sys, "argv", ["generate", *options])
    generate.main()


def test_blind_buildings_imports_nothing_of_ours_but_the_writer_of_the_blind_world() -> None:
    for path in GENERATOR.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [one.name for one in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                is_own = name.split(".")[:2] == ["benchmarks", "blind_buildings"]
                is_known = is_own or name.split(".")[0] in ALLOWED or name == WRITER
                assert is_known, f"{path}: {name}"


def test_readme_tells_of_each_foreign_kind() -> None:
    assert len(LIBRARY) == 35 and len(FOREIGN) == 43
    readme = (GENERATOR / "README.md").read_text()
    assert all(f"`{name}`" in readme for name in FOREIGN)


@pytest.mark.parametrize(("suite", "effects"), [("singles", LIBRARY), ("foreign", FOREIGN)])
def test_each_effect_comes_once_in_turn_clean_and_dirty(suite: str, effects: dict[str, type]) -> None:
    n = len(effects)
    for first in (0, 17, 50):
        assert {effect_of(suite, first + k).name for k in range(n)} == set(effects)
    assert len({(effect_of(suite, k), is_dirty_in_turn(suite, k)) for k in range(2 * n)}) == 2 * n


def test_absent_floors_are_said_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        _generate(monkeypatch, "--suite", "none", "--floors", str(tmp_path / "nowhere"), "-o", str(tmp_path))
    assert "nowhere: holds no FLOOR.geojson" in capsys.readouterr().err.splitlines()[-1]


def test_same_arguments_give_the_same_bytes(
    floors: tuple[Path, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder, first, n in (("one", 2, 2), ("two", 3, 1)):
        counts = ["--first", str(first), "--n", str(n)]
        _generate(monkeypatch, "--suite", "singles", *counts, "-o", str(tmp_path / folder))
    names = ("cases/0003/run.mcap", "cases/0003/arena.geojson", "cases/0003/robot.yaml", "truth/0003.json")
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_a_raster_map_has_the_walls_of_the_polygons(
    floors: tuple[Path, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for kind in ("raster", "polygon"):
        _generate(monkeypatch, "--suite", "none", "--n", "1", "--map", kind, "-o", str(tmp_path / kind))
    raster = tmp_path / "raster" / "cases" / "0000"
    facts = yaml.safe_load((raster / "arena.yaml").read_text())
    head, size, most, pixels = (raster / facts["image"]).read_bytes().split(b"\n", 3)
    nx, ny = (int(one) for one in size.split())
    image = np.frombuffer(pixels, np.uint8).reshape(ny, nx)[::-1]
    assert (head, most) == (b"P5", b"255") and set(np.unique(image)) == {0, 205, 254}
    arena = (tmp_path / "polygon" / "cases" / "0000" / "arena.geojson").read_text()
    corners = ((walls_of(arena)[:, :2] - facts["origin"][:2]) / facts["resolution"]).astype(int)
    assert (image[corners[:, 1], corners[:, 0]] == 0).all()
    assert not (raster / "arena.geojson").exists()


def test_an_empty_clean_case_fits_its_map(floors: tuple[Path, ...], tmp_path: Path) -> None:
    generate.save(make("none", 2, False, floors), tmp_path, 2)
    case = tmp_path / "cases" / "0002"
    assert 0.95 < spread_over_sigma(case) < 1.15  # poses are off by 3 mm and 2 mrad at range


@pytest.mark.parametrize(
    "name", [name if name in FAST else pytest.param(name, marks=pytest.mark.slow) for name in EFFECTS]
)
def test_each_effect_changes_its_channel_alone(name: str, floors: tuple[Path, ...]) -> None:
    case = make(EFFECTS[name], 0, False, floors, {**LIBRARY, **FOREIGN}[name])
    told = case.truth["foreign_effect"] or case.truth["effects"][0]
    assert told["name"] == name and told["material"]
    assert told["materiality_ratio"] is None or told["materiality_ratio"] > 1.5
    runs = case.runs
    changed = {
        "scan": not runs.scans.kept.all()
        or not np.array_equal(runs.scans.ranges, runs.plain_scans.ranges, equal_nan=True),
        "pose": not np.array_equal(runs.poses, runs.plain_poses),
        "odometry": not np.array_equal(runs.odometry.poses, runs.plain_odometry.poses),
        "drive": not np.array_equal(runs.run, case.scene.run),
    }
    assert changed[told["channel"]]
    if told["channel"] in ("scan", "pose"):  # the drive is the same, to the bit
        assert [channel for channel, is_changed in changed.items() if is_changed] == [told["channel"]]
    json.dumps(case.truth, default=float)
