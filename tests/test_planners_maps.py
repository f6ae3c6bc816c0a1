"""Arenas come out of files exactly as drawn, and every fault of a file is one line."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from PIL import Image

from planners.arena import Arena
from planners.errors import PlanError
from planners.maps import MAPS, geojson, load, ros_map

SQUARE = [[0, 0], [4, 0], [4, 3], [0, 3], [0, 0]]
BOX = [[1, 1], [2, 1], [2, 2], [1, 2], [1, 1]]


def feature(name: Any, kind: Any, rings: Any, shape: str = "Polygon", **more: Any) -> dict[str, Any]:
    geometry = {"type": shape, "coordinates": rings}
    return {"type": "Feature", "properties": {"name": name, "kind": kind, **more}, "geometry": geometry}


def collection(*features: Any, **more: Any) -> str:
    return json.dumps({"type": "FeatureCollection", "features": list(features), **more})


def assert_equal(one: Arena, other: Arena) -> None:
    assert one.names == other.names
    assert one.surfaces == other.surfaces
    np.testing.assert_array_equal(one.walls, other.walls)
    assert one.free.wkb == other.free.wkb


def test_walls_follow_the_vertices_of_the_file() -> None:
    text = collection(
        feature("room", "arena", [SQUARE], surfaces={"2": "glass"}), feature("box", "obstacle", [BOX])
    )
    arena = geojson.loads(text)
    assert arena.names == (*(f"room/edge_{i}" for i in range(4)), *(f"box/edge_{i}" for i in range(4)))
    np.testing.assert_array_equal(arena.walls[2], [[4, 3], [0, 3]])
    np.testing.assert_array_equal(arena.walls[4], [[1, 1], [2, 1]])
    assert arena.surfaces == ("wall", "wall", "glass", *["wall"] * 5)
    assert arena.free.area == pytest.approx(11.0)


def test_holes_are_walls_too() -> None:
    arena = geojson.loads(collection(feature("room", "arena", [SQUARE, BOX], surfaces={"ring_1/1": "glass"})))
    assert arena.names[4:] == tuple(f"room/ring_1/edge_{i}" for i in range(4))
    assert arena.surfaces[5] == "glass"
    assert not arena.contains(np.array([1.5, 1.5]))


def test_obstacles_may_overlap_and_stick_out() -> None:
    high = [[1.5, 1.5], [5, 1.5], [5, 2.5], [1.5, 2.5], [1.5, 1.5]]
    arena = geojson.loads(
        collection(
            feature("room", "arena", [SQUARE]),
            feature("a", "obstacle", [BOX]),
            feature("b", "obstacle", [high]),
        )
    )
    assert arena.n_walls == 12
    assert arena.free.area == pytest.approx(12 - 1 - 2.5 + 0.25)


@pytest.mark.parametrize("name", ["square", "office"])
def test_shipped_arenas_survive_a_round_trip(name: str) -> None:
    text = (files("sensorgraph.data") / f"{name}.geojson").read_text()
    arena = geojson.loads(text)
    again = geojson.dumps(arena)
    assert_equal(arena, geojson.loads(again))
    assert {f["properties"]["kind"] for f in json.loads(again)["features"]} == {"arena", "obstacle"}


@pytest.mark.parametrize("seed", range(20))
def test_any_arena_survives_a_round_trip(seed: int) -> None:
    """Walls named, ordered and placed at will, free space of several parts with holes."""
    rng = np.random.default_rng(seed)
    parts = [shapely.box(6 * k, 0, 6 * k + 5, 5) for k in range(int(rng.integers(1, 3)))]
    free = shapely.MultiPolygon(parts).difference(
        shapely.Point(2.5, 2.5).buffer(float(rng.uniform(0.2, 1.0)), quad_segs=2)
    )
    n = int(rng.integers(0, 9))
    names = [f"w/edge_{i}" for i in range(n)]
    if seed % 3 == 1:
        names = rng.permutation(names).tolist()
    if seed % 3 == 2:
        names = [f"wall {i} of /edge_x" for i in range(n)]
    arena = Arena(
        free=free if len(parts) > 1 else shapely.get_parts(free)[0],
        walls=rng.normal(size=(n, 2, 2)),
        names=tuple(names),
        surfaces=tuple(rng.choice(["wall", "glass"], n).tolist()),
    )
    assert_equal(arena, geojson.loads(geojson.dumps(arena)))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "not JSON"),
        ("[1]", "expected a GeoJSON FeatureCollection"),
        (collection(), "no features"),
        (collection(feature("box", "obstacle", [BOX])), "0 features of kind arena"),
        (collection(feature("a", "arena", [SQUARE]), feature("b", "arena", [SQUARE])), "2 features of kind arena"),
        (collection(feature("a", "arena", [SQUARE]), feature("a", "obstacle", [BOX])), "two features are named 'a'"),
        (collection(feature("a", "arean", [SQUARE])), "did you mean 'arena'"),
        (collection(feature("", "arena", [SQUARE])), "has no name"),
        (collection(feature("a", "arena", SQUARE, "LineString")), "is a LineString, expected Polygon"),
        (collection(feature("a", "arena", [SQUARE[:-1]])), "open ring"),
        (collection(feature("a", "arena", [[[0, 0], [1, 1], [1, 0], [0, 1], [0, 0]]])), "crosses or touches itself"),
        (collection(feature("a", "arena", [[[0, 0], [1, 0], [2, 0], [0, 0]]])), "crosses or touches itself"),
        (collection(feature("a", "arena", [[[0, 0], [4, 0], [float("nan"), 3], [0, 0]]])), "expected finite"),
        (collection(feature("a", "arena", [[[0, 0], [4, 0], ["x", 3], [0, 0]]])), "expected a list of [x, y]"),
        (collection(feature("a", "arena", [[[0, 0], [4, 0], [4, 0], [4, 3], [0, 0]]])), "vertex 2 repeats"),
        (collection(feature("a", "arena", [SQUARE], surfaces={"4": "glass"})), "its edges are 0 to 3"),
        (collection(feature("a", "arena", [SQUARE], surface={"1": "glass"})), "did you mean 'surfaces'"),
        (collection(feature("a", "arena", [SQUARE]), crs={"properties": {"name": "EPSG:4326"}}), "degrees"),
        (collection(feature("a", "arena", [[[8e-4, 0], [9e-4, 0], [9e-4, 1e-4], [8e-4, 0]]])), "looks like degrees"),
        (collection(feature("a", "arena", [SQUARE]), feature("b", "obstacle", [SQUARE])), "no free space"),
        (collection(feature("a", "arena", None)), "expected a list"),
        (collection(5), "has no name"),
    ],
)  # fmt: skip
def test_faults_of_geojson_are_one_line(text: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "arena.geojson"
    path.write_text(text)
    with pytest.raises(PlanError) as caught:
        load(path)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value) or "no free space" in says


def write_map(folder: Path, pixels: Any, name: str = "map.pgm", **changes: Any) -> Path:
    facts = {
        "image": name,
        "resolution": 0.5,
        "origin": [0.0, 0.0, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    } | changes
    if pixels is not None:
        Image.fromarray(np.array(pixels, dtype=np.uint8)).save(folder / name)
    path = folder / "map.yaml"
    path.write_text("".join(f"{k}: {v}\n" for k, v in facts.items() if v is not None))
    return path


@pytest.mark.parametrize("name", ["map.pgm", "floor.png"])
def test_the_image_of_a_map_is_read_through_the_yaml_that_names_it(name: str, tmp_path: Path) -> None:
    path = write_map(tmp_path, HAND, name=name)
    (tmp_path / "robot.yaml").write_text("name: radix\n")
    assert_equal(load(tmp_path / name), load(path))
    other = path.rename(tmp_path / "other.yaml")
    assert_equal(load(tmp_path / name), load(other))
    path.write_bytes(other.read_bytes())
    (tmp_path / "third.yaml").write_bytes(other.read_bytes())
    if name == "map.pgm":  # that of the same name
        assert_equal(load(tmp_path / name), load(path))
    else:
        with pytest.raises(PlanError, match=r"but map\.yaml, other\.yaml, third\.yaml name it"):
            load(tmp_path / name)
    for file in (path, other, tmp_path / "third.yaml"):
        file.unlink()
    with pytest.raises(PlanError, match=r"no yaml in its folder names it; give the map_server yaml"):
        load(tmp_path / name)


HAND = [[254, 254, 254], [254, 0, 205], [254, 0, 254]]  # top row first; occupied column, one unknown cell


def test_map_server_cells_become_free_space_and_the_longest_walls(tmp_path: Path) -> None:
    arena = load(write_map(tmp_path, HAND))
    assert arena.free.area == pytest.approx(6 * 0.25)  # nine cells, two occupied, one unknown
    assert arena.contains(np.array([[0.25, 0.25], [1.25, 0.25], [0.75, 1.25]])).all()
    assert not arena.contains(np.array([[0.75, 0.25], [0.75, 0.75], [1.25, 0.75]])).any()
    found = {tuple(sorted(map(tuple, wall.tolist()))) for wall in arena.walls}
    assert found == {
        ((0.5, 0.0), (0.5, 1.0)),  # left of both occupied cells, in one piece
        ((1.0, 0.0), (1.0, 1.0)),
        ((0.5, 0.0), (1.0, 0.0)),
        ((0.5, 1.0), (1.0, 1.0)),
    }
    assert arena.names == tuple(f"map/edge_{i}" for i in range(4))


@pytest.mark.parametrize("mode", ["trinary", "scale"])
def test_map_server_negate_swaps_free_and_occupied(mode: str, tmp_path: Path) -> None:
    plain = load(write_map(tmp_path, HAND, mode=mode))
    negated = load(write_map(tmp_path, 255 - np.array(HAND, dtype=np.uint8), negate=1, mode=mode))
    assert_equal(plain, negated)


def test_map_server_thresholds_are_strict(tmp_path: Path) -> None:
    """255 - value over 255 above occupied_thresh is occupied, below free_thresh free, else unknown."""
    grey = [[255, 204, 206, 51, 50]]  # 0, 0.2, 0.192.., 0.8, 0.8039..
    arena = load(write_map(tmp_path, grey, occupied_thresh=0.8, free_thresh=0.2, resolution=1.0))
    assert arena.free.area == pytest.approx(2.0)  # 255 and 206
    assert arena.contains(np.array([[0.5, 0.5], [1.5, 0.5], [2.5, 0.5]])).tolist() == [True, False, True]
    assert arena.walls[:, :, 0].min() == 4.0  # only the last cell is occupied


@pytest.mark.parametrize("free_thresh", [0.196, 0.25, 0.4])
@pytest.mark.parametrize("negate", [0, 1])
def test_unknown_cells_of_a_trinary_map_are_never_free(
    free_thresh: float, negate: int, tmp_path: Path
) -> None:
    """map_saver of Nav2 writes unknown as 205 and free_thresh 0.25: (255 - 205) / 255 is below it."""
    pixels = 255 - np.array(HAND, dtype=np.uint8) if negate else np.array(HAND, dtype=np.uint8)
    arena = load(write_map(tmp_path, pixels, free_thresh=free_thresh, negate=negate))
    assert arena.free.area == pytest.approx(6 * 0.25)
    (note,) = arena.notes
    assert "66.7 % free" in note and "22.2 % occupied" in note and "11.1 % unknown" in note
    assert ("is unknown although free_thresh is" in note) == (free_thresh > 0.2)
    grey = load(write_map(tmp_path, pixels, free_thresh=free_thresh, negate=negate, mode="scale"))
    assert grey.free.area == pytest.approx((7 if free_thresh > 0.2 else 6) * 0.25)


def test_map_server_raw_values_are_percent(tmp_path: Path) -> None:
    arena = load(write_map(tmp_path, [[0, 100, 101, 30]], mode="raw", resolution=1.0))
    assert arena.free.area == pytest.approx(1.0)
    assert arena.walls[:, :, 0].tolist() != []
    assert set(arena.walls[:, :, 0].ravel().tolist()) == {1.0, 2.0}


def test_map_server_yaw_turns_the_map_about_its_origin(tmp_path: Path) -> None:
    flat = load(write_map(tmp_path, HAND, origin=[0.0, 0.0, 0.0]))
    turned = load(write_map(tmp_path, HAND, origin=[3.0, -1.0, np.pi / 2]))
    expected = np.stack([3.0 - flat.walls[..., 1], -1.0 + flat.walls[..., 0]], axis=-1)
    np.testing.assert_allclose(turned.walls, expected, atol=1e-12)  # float64 at a few metres
    assert turned.free.area == pytest.approx(flat.free.area)
    assert turned.contains(np.array([3.0 - 0.25, -1.0 + 0.25]))


@pytest.mark.parametrize("name", ["map.png", "map.pgm"])
def test_map_server_images_may_be_grey_rgb_or_transparent(name: str, tmp_path: Path) -> None:
    grey = np.array(HAND, dtype=np.uint8)
    plain = load(write_map(tmp_path, grey, name))
    if name == "map.png":
        rgb = np.repeat(grey[:, :, None], 3, axis=2)
        assert_equal(plain, load(write_map(tmp_path, rgb, name)))
        clear = np.dstack([rgb, np.full(grey.shape, 255)])
        clear[1, 2, :3] = 254  # free by colour, but transparent: unknown
        clear[1, 2, 3] = 0
        assert_equal(plain, load(write_map(tmp_path, clear, name)))


def test_plain_text_pgm_reads_like_the_binary_one(tmp_path: Path) -> None:
    binary = load(write_map(tmp_path, HAND))
    rows = "\n".join(" ".join(map(str, row)) for row in HAND)
    (tmp_path / "map.pgm").write_text(f"P2\n# made by hand\n3 3\n255\n{rows}\n")
    assert_equal(binary, load(tmp_path / "map.yaml"))


@pytest.mark.parametrize("seed", range(5))
def test_free_space_of_a_random_map_is_its_free_cells(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    pixels = rng.choice([0, 205, 254], (12, 17), p=[0.2, 0.1, 0.7])
    arena = load(write_map(tmp_path, pixels, origin=[1.0, 2.0, 0.7]))
    assert arena.free.is_valid
    i, j = np.meshgrid(np.arange(17) + 0.5, np.arange(12) + 0.5)
    local = 0.5 * np.stack([i, j], axis=-1)
    turn = np.array([[np.cos(0.7), np.sin(0.7)], [-np.sin(0.7), np.cos(0.7)]])
    np.testing.assert_array_equal(arena.contains(local @ turn + [1.0, 2.0]), pixels[::-1] == 254)
    assert arena.free.area == pytest.approx(0.25 * (pixels == 254).sum())
    occupied = np.pad(pixels == 0, 1).astype(int)
    borders = abs(np.diff(occupied, axis=0)).sum() + abs(np.diff(occupied, axis=1)).sum()
    assert np.hypot(*(arena.walls[:, 1] - arena.walls[:, 0]).T).sum() == pytest.approx(0.5 * borders)
    assert_equal(arena, geojson.loads(geojson.dumps(arena)))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"image": "none.pgm"}, "no image"),
        ({"image": "map.yaml"}, "not a readable image"),
        ({"resolution": 0}, "resolution is 0"),
        ({"resolution": None}, "no key resolution"),
        ({"origin": [0, 0]}, "expected [x, y, yaw]"),
        ({"origin": [0, 0, "north"]}, "expected a finite number"),
        ({"negate": 2}, "expected 0 or 1"),
        ({"mode": "grey"}, "expected one of trinary"),
        ({"free_thresh": 0.9}, "is above occupied_thresh"),
        ({"free_thresh": 0.001}, "no cell is free"),
        ({"occupied_thresh": 1.0}, "no cell is occupied (66.7 % free (grey 254), 0.0 % occupied"),
    ],
)
def test_faults_of_map_server_maps_are_one_line(changes: dict[str, Any], says: str, tmp_path: Path) -> None:
    pixels = [[250]] if "free_thresh" in changes else HAND
    path = write_map(tmp_path, pixels)
    path = write_map(tmp_path, None, **changes)
    with pytest.raises(PlanError) as caught:
        load(path)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_robot_given_as_a_map_is_told(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text("name: radix\nsensor: {n_rays: 91}\n")
    with pytest.raises(PlanError, match=r"is not a map_server map \(keys name, sensor\).*is it a robot"):
        load(tmp_path / "robot.yaml")


def test_a_broken_image_is_one_line(tmp_path: Path) -> None:
    path = write_map(tmp_path, HAND)
    (tmp_path / "map.pgm").write_bytes((tmp_path / "map.pgm").read_bytes()[:-4])
    with pytest.raises(PlanError, match="broken"):
        ros_map.read(path)


def test_a_large_map_reads_in_seconds(tmp_path: Path) -> None:
    """2000 x 2000 cells with 300 boxes; runs of cells, not cells, are what costs."""
    rng = np.random.default_rng(0)
    pixels = np.full((2000, 2000), 254, dtype=np.uint8)
    for i, j in rng.integers(50, 1900, (300, 2)).tolist():
        pixels[i : i + 30, j : j + 40] = 0
    arena = load(write_map(tmp_path, pixels, resolution=0.05))
    assert arena.free.area == pytest.approx((pixels == 254).sum() * 0.0025)
    assert arena.n_walls < 3000


def test_unknown_suffixes_and_missing_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match=r"no reader for '\.dxf'"):
        load(tmp_path / "a.dxf")
    with pytest.raises(PlanError, match=r"is a folder; expected a map file: \*\.geojson"):
        load(tmp_path)
    for suffix in MAPS:
        with pytest.raises(PlanError, match="no such file"):
            load(tmp_path / f"a{suffix}")
