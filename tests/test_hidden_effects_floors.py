"""Hidden effects on real floors: the world repeats itself to the byte, and its logs mean what its truth says."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from blind_cases import spread_over_sigma, walls_of

import benchmarks.hidden_effects as hidden_effects
from benchmarks.hidden_effects import command
from benchmarks.hidden_effects.case import Spec
from benchmarks.hidden_effects.library import LIBRARY
from benchmarks.hidden_effects.worlds.floors.cases import make, turns
from benchmarks.hidden_effects.worlds.floors.effects import FOREIGN
from benchmarks.hidden_effects.worlds.floors.rooms import FOLDER

EFFECTS = {**dict.fromkeys(LIBRARY, "singles"), **dict.fromkeys(FOREIGN, "foreign")}
FAST = ("mount_xy", "g_restart", "g_crab", "g_markerswap", "g_slope")
"""At least one of each channel."""


@pytest.fixture
def floors() -> None:
    if not FOLDER.exists():
        pytest.skip(f"the floors of KTH are not at {FOLDER}")


def _generate(world: str, folder: Path, *specs: Spec) -> None:
    for spec in specs:
        command.make_and_save(world, spec, folder, spec.index)


def test_readme_tells_of_each_foreign_kind() -> None:
    assert len(LIBRARY) == 35 and len(FOREIGN) == 43
    readme = (Path(hidden_effects.__file__).parent / "README.md").read_text()
    assert all(f"`{name}`" in readme for name in FOREIGN)


@pytest.mark.parametrize(("suite", "effects"), [("singles", LIBRARY), ("foreign", FOREIGN)])
def test_each_effect_comes_once_in_turn_clean_and_dirty(suite: str, effects: tuple[str, ...]) -> None:
    n = len(effects)
    for first in (0, 17, 50):
        assert {turns(suite)[(first + k) % n] for k in range(n)} == set(effects)
    specs = [Spec(suite=suite, index=k) for k in range(2 * n)]
    assert len({(turns(suite)[spec.index % n], spec.background_in_turn(n)) for spec in specs}) == 2 * n


def test_absent_floors_are_said_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = [
        "generate",
        "--world",
        "floors",
        "--suite",
        "none",
        "--n",
        "1",
        "--floors",
        str(tmp_path / "nowhere"),
    ]
    monkeypatch.setattr(sys, "argv", ["hidden_effects", *arguments, "-o", str(tmp_path)])
    with pytest.raises(SystemExit, match=r"nowhere: holds no FLOOR\.geojson"):
        command.main()


@pytest.mark.slow
def test_same_arguments_give_the_same_bytes(floors: None, tmp_path: Path) -> None:
    for folder, indices in (("one", (2, 3)), ("two", (3,))):
        _generate("floors", tmp_path / folder, *(Spec(suite="singles", index=k) for k in indices))
    names = ("cases/0003/run.mcap", "cases/0003/arena.geojson", "cases/0003/robot.yaml", "truth/0003.json")
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


@pytest.mark.slow
def test_a_raster_map_has_the_walls_of_the_polygons(floors: None, tmp_path: Path) -> None:
    for world in ("pixels", "floors"):
        _generate(world, tmp_path / world, Spec(suite="none", index=0))
    raster = tmp_path / "pixels" / "cases" / "0000"
    facts = yaml.safe_load((raster / "arena.yaml").read_text())
    head, size, most, pixels = (raster / facts["image"]).read_bytes().split(b"\n", 3)
    nx, ny = (int(one) for one in size.split())
    image = np.frombuffer(pixels, np.uint8).reshape(ny, nx)[::-1]
    assert (head, most) == (b"P5", b"255") and set(np.unique(image)) == {0, 205, 254}
    arena = (tmp_path / "floors" / "cases" / "0000" / "arena.geojson").read_text()
    corners = ((walls_of(arena)[:, :2] - facts["origin"][:2]) / facts["resolution"]).astype(int)
    assert (image[corners[:, 1], corners[:, 0]] == 0).all()
    assert not (raster / "arena.geojson").exists()


def test_an_empty_clean_case_fits_its_map(floors: None, tmp_path: Path) -> None:
    _generate("floors", tmp_path, Spec(suite="none", index=2, background="clean"))
    case = tmp_path / "cases" / "0002"
    assert 0.95 < spread_over_sigma(case) < 1.15  # poses are off by 3 mm and 2 mrad at range


@pytest.mark.parametrize(
    "name", [name if name in FAST else pytest.param(name, marks=pytest.mark.slow) for name in EFFECTS]
)
def test_each_effect_changes_its_channel_alone(name: str, floors: None) -> None:
    case = make(Spec(suite=EFFECTS[name], index=0, background="clean", effect=name))
    told = case.truth["foreign_effect"] or case.truth["effects"][0]
    assert told["name"] == name and told["material"]
    assert told["materiality_ratio"] is None or told["materiality_ratio"] > 1.5
    runs = case.facts["runs"]
    changed = {
        "scan": not runs.scans.kept.all()
        or not np.array_equal(runs.scans.ranges, runs.plain_scans.ranges, equal_nan=True),
        "pose": not np.array_equal(runs.poses, runs.plain_poses),
        "odometry": not np.array_equal(runs.odometry.poses, runs.plain_odometry.poses),
        "drive": not np.array_equal(runs.run, case.facts["scene"].run),
    }
    assert changed[told["channel"]]
    if told["channel"] in ("scan", "pose"):  # the drive is the same, to the bit
        assert [channel for channel, is_changed in changed.items() if is_changed] == [told["channel"]]
    json.dumps(case.truth, default=float)
