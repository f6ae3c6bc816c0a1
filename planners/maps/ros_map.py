"""Arena <- ROS map_server maps: a yaml file with a pgm or png; free space is the union of the free cells.

Walls are the borders of occupied cells, merged into the longest straight segments and named by their order,
`map/edge_0` first. Unknown cells are neither free nor wall. In a trinary map, the grey value 205 that
map_saver writes for unknown cells is unknown for any free_thresh: with map_saver's usual 0.25 it would count
as free.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from shapely.geometry import MultiPolygon, Polygon

from planners.arena import Arena
from planners.errors import PlanError
from planners.types import Bools, Floats
from planners.yaml_text import parse_yaml

REQUIRED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
MODES = ("trinary", "scale", "raw")
ALLOW_OUTSIDE = "SENSORGRAPH_ALLOW_OUTSIDE"
"""Environment variable; 1 allows an image outside the folder of its map."""
MAX_CELLS = 100_000_000
GRID_FREE, GRID_OCCUPIED = 25, 65
"""[%] occupancy up to which map_saver writes a cell of a grid as free, and from which as occupied."""
UNKNOWN_OCCUPANCY = 50
"""[1/255] occupancy that map_saver writes for an unknown cell: grey 205, or 50 in a negated image."""


def read(path: Path) -> Arena:
    """Read a map_server map.

    Raises
    ------
    PlanError : The yaml or its image is invalid, no cell is free, or no cell is occupied.
    """
    facts = _facts(path)
    pixels, opaque = _pixels(path, _image(path, facts["image"]))
    occupied, free = classify(pixels, opaque, facts)
    for name, cells in (("free", free), ("occupied", occupied)):
        if not cells.any():
            raise PlanError(
                f"{path}: no cell is {name} ({_summary(pixels, occupied, free, facts)}); "
                f"check negate, {name}_thresh and the image"
            )
    note = f"{path.name}: {_summary(pixels, occupied, free, facts)}"
    return _arena(occupied, free, facts["resolution"], facts["origin"], str(path), note)


def of_grid(data: NDArray[np.int8], resolution: float, origin: Sequence[float], name: str) -> Arena:
    """Return the arena of a ROS occupancy grid, with the thresholds of map_saver.

    Parameters
    ----------
    data : (ny, nx) [%] occupancy, -1: unknown; row 0 has the lowest y
    resolution : [m]
    origin : x, y, yaw [m, m, rad] of the lower left corner
    name : name of the grid in messages

    Raises
    ------
    PlanError : No cell is free, or no cell is occupied.
    """
    free, occupied = ((data >= 0) & (data <= GRID_FREE)).T, (data >= GRID_OCCUPIED).T
    shares = ", ".join(
        f"{100 * cells.mean():.1f} % {what}"
        for what, cells in (("free", free), ("occupied", occupied), ("unknown", ~(free | occupied)))
    )
    for what, cells in (("free", free), ("occupied", occupied)):
        if not cells.any():
            raise PlanError(f"{name}: no cell is {what} ({shares}); expected a map of walls and free space")
    nx, ny = free.shape
    note = f"{name}: {nx} x {ny} cells of {resolution:g} m, {shares}"
    return _arena(occupied, free, resolution, origin, name, note)


def _arena(
    occupied: Bools, free: Bools, resolution: float, origin: Sequence[float], name: str, note: str
) -> Arena:
    """Return the arena of occupied and free cells, each (nx, ny)."""
    x, y, yaw = origin
    turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])  # row vectors

    def place(corners: NDArray[np.float64]) -> Floats:
        return np.asarray(corners * resolution @ turn + (x, y), dtype=np.float64)

    walls = place(_borders(occupied))
    area = shapely.transform(_union(free), place)
    if not isinstance(area, Polygon | MultiPolygon):
        raise PlanError(f"{name}: the free cells form a {area.geom_type}, expected an area")
    return Arena(
        free=area,
        walls=walls,
        names=tuple(f"map/edge_{i}" for i in range(len(walls))),
        surfaces=("wall",) * len(walls),
        notes=(note,),
    )


def read_image(path: Path) -> Arena:
    """Read the map of an image: that of the yaml in the same folder which names it.

    Raises
    ------
    PlanError : No yaml names the image, or several do.
    """
    beside = sorted(file for file in path.parent.iterdir() if file.suffix.lower() in (".yaml", ".yml"))
    naming = [file for file in beside if _names_image(file, path)]
    own = [file for file in naming if file.stem == path.stem] or naming
    if len(own) != 1:
        found = f"{', '.join(file.name for file in own)} name it" if own else "no yaml in its folder names it"
        raise PlanError(
            f"{path} is the image of a map, but {found}; give the map_server yaml with its resolution and origin"
        )
    return read(own[0])


def _names_image(file: Path, image: Path) -> bool:
    """Return whether a yaml is a map of the image."""
    try:
        data = parse_yaml(file.read_text(encoding="utf-8"))
    except ValueError:
        return False
    name = data.get("image") if isinstance(data, dict) else None
    return isinstance(name, str) and (file.parent / name).resolve() == image.resolve()


def _summary(pixels: NDArray[np.uint8], occupied: Bools, free: Bools, facts: Mapping[str, Any]) -> str:
    """Return the shares of free, occupied and unknown cells, with their ranges of grey values, as text."""
    grey = pixels[::-1].T
    parts = []
    for name, cells in (("free", free), ("occupied", occupied), ("unknown", ~(free | occupied))):
        values = np.unique(grey[cells])
        span = (
            f" (grey {values[0]}" + (f" to {values[-1]})" if len(values) > 1 else ")") if len(values) else ""
        )
        parts.append(f"{100 * cells.mean():.1f} % {name}{span}")
    text = f"{', '.join(parts)}; {facts['mode']}"
    if facts["mode"] == "trinary":
        share = UNKNOWN_OCCUPANCY / 255
        if share < facts["free_thresh"] and (_occupancy(grey, facts) == UNKNOWN_OCCUPANCY).any():
            text += f", grey {50 if facts['negate'] else 205} is unknown although free_thresh is {facts['free_thresh']:g}"
    return text


def _facts(path: Path) -> dict[str, Any]:
    """Read and check the yaml."""
    try:
        data = parse_yaml(path.read_text(encoding="utf-8"))
    except ValueError as exc:
        raise PlanError(f"{path}: not YAML: {exc}; expected a map_server map") from exc
    if not isinstance(data, dict):
        raise PlanError(f"{path}: holds a {type(data).__name__}, expected keys {', '.join(REQUIRED)}")
    missing = [key for key in REQUIRED if key not in data]
    if len(missing) == len(REQUIRED):
        robot = "; is it a robot.yaml?" if {"drive", "sensor", "wheels", "limits"} & set(data) else ""
        raise PlanError(
            f"{path} is not a map_server map (keys {', '.join(map(str, [*data][:4])) or 'none'}); "
            f"expected {', '.join(REQUIRED)}"
            f"{robot}"
        )
    if missing:
        raise PlanError(f"{path}: no key {', '.join(missing)}; expected {', '.join(REQUIRED)}")
    facts = dict(data)
    for key, low, high in (
        ("resolution", 1e-6, 100.0),
        ("occupied_thresh", 0.0, 1.0),
        ("free_thresh", 0.0, 1.0),
    ):
        facts[key] = _number(path, key, data[key])
        if not low <= facts[key] <= high:
            raise PlanError(f"{path}: {key} is {facts[key]}, expected {low:g} to {high:g}")
    if facts["free_thresh"] > facts["occupied_thresh"]:
        raise PlanError(
            f"{path}: free_thresh {facts['free_thresh']} is above occupied_thresh {facts['occupied_thresh']}; "
            "expected free_thresh at or below it"
        )
    if not isinstance(data["image"], str) or not data["image"]:
        raise PlanError(f"{path}: image is {data['image']!r}, expected the name of a pgm or png")
    if data["negate"] not in (0, 1, False, True):
        raise PlanError(f"{path}: negate is {data['negate']!r}, expected 0 or 1")
    origin = data["origin"]
    if not isinstance(origin, list) or len(origin) != 3:
        raise PlanError(f"{path}: origin is {origin!r}, expected [x, y, yaw]")
    facts["origin"] = [_number(path, "origin", value) for value in origin]
    facts["mode"] = data.get("mode", "trinary")
    if facts["mode"] not in MODES:
        raise PlanError(f"{path}: mode is {facts['mode']!r}, expected one of {', '.join(MODES)}")
    return facts


def _image(path: Path, name: str) -> Path:
    """Return the path of a map's image; reject an image outside the folder of the yaml."""
    image = path.parent / name
    folders = (path.parent.resolve(), path.resolve().parent)  # they differ if the yaml is a link
    if os.environ.get(ALLOW_OUTSIDE) != "1" and not any(
        image.resolve().is_relative_to(folder) for folder in folders
    ):
        raise PlanError(
            f"{path}: image is {name[:100]!r}, outside the folder of the map; copy it next to the yaml, or, if you "
            f"trust the map, set {ALLOW_OUTSIDE}=1"
        )
    return image


def _number(path: Path, key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise PlanError(f"{path}: {key} is {value!r}, expected a finite number")
    return float(value)


def _pixels(path: Path, image: Path) -> tuple[NDArray[np.uint8], Bools]:
    """Return grey values 0 to 255, and whether each pixel is opaque, both (height, width) with row 0 on top."""
    if not image.is_file():
        raise PlanError(f"{path}: no image {image}; expected it next to the yaml, or its path in `image`")
    try:
        with Image.open(image) as picture:
            if picture.width * picture.height > MAX_CELLS:
                raise PlanError(
                    f"{image}: {picture.width} x {picture.height} pixels, expected at most {MAX_CELLS:,}"
                )
            if picture.mode.startswith(("I", "F")):
                raise PlanError(f"{image}: has {picture.mode} pixels, expected 8 bits each")
            alpha = "A" in picture.getbands() or "transparency" in picture.info
            colour = np.asarray(picture.convert("RGBA" if alpha else "RGB"), dtype=np.uint16)
    except UnidentifiedImageError as exc:
        raise PlanError(f"{image}: not a readable image; expected pgm or png") from exc
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as exc:
        if isinstance(exc, PlanError):
            raise
        raise PlanError(f"{image}: broken ({exc}); expected pgm or png") from exc
    grey = (colour[..., :3].sum(axis=2) // 3).astype(np.uint8)  # map_server averages the colours too
    opaque = colour[..., 3] > 0 if colour.shape[2] == 4 else np.ones(grey.shape, dtype=np.bool_)
    return grey, np.asarray(opaque, dtype=np.bool_)


def classify(pixels: NDArray[np.uint8], opaque: Bools, facts: Mapping[str, Any]) -> tuple[Bools, Bools]:
    """Return the occupied and the free cells, each (nx, ny) with cell (0, 0) in the lower left corner.

    A cell between the thresholds is neither. A transparent pixel is unknown; so is, in trinary mode, the grey
    value that map_saver writes for unknown cells. In raw mode the pixel value is the occupancy in percent;
    above 100 is unknown.
    """
    if facts["mode"] == "raw":
        share = pixels / 100.0
        known = (pixels <= 100) & opaque
    else:
        share = _occupancy(pixels, facts) / 255.0
        known = opaque
        if facts["mode"] == "trinary":
            known = opaque & (_occupancy(pixels, facts) != UNKNOWN_OCCUPANCY)
    occupied = known & (share > facts["occupied_thresh"])
    free = known & (share < facts["free_thresh"])
    if facts["mode"] == "raw":
        occupied = known & (share >= facts["occupied_thresh"])
        free = known & (share <= facts["free_thresh"])
    return occupied[::-1].T, free[::-1].T


def _occupancy(pixels: NDArray[np.uint8], facts: Mapping[str, Any]) -> NDArray[np.uint8]:
    """Return the occupancy of each cell in 1/255."""
    return np.asarray(pixels if facts["negate"] else 255 - pixels, dtype=np.uint8)


def _borders(cells: Bools) -> Floats:
    """Return the borders (n, 2, 2) [cells] between True and False cells, as the longest straight segments."""
    padded = np.pad(cells, 1)
    segments = []
    for axis in (0, 1):  # borders across x run along y
        grid = padded if axis == 0 else padded.T
        change = np.diff(grid.astype(np.int8), axis=0)[:, 1:-1]  # (n + 1, m): +1 cells begin, -1 they end
        marked = np.pad(change, ((0, 0), (1, 1)))
        starts = np.argwhere((marked[:, 1:] != marked[:, :-1]) & (marked[:, 1:] != 0))
        ends = np.argwhere((marked[:, 1:] != marked[:, :-1]) & (marked[:, :-1] != 0))
        lines = np.stack([starts, ends], axis=1).astype(np.float64)  # (k, 2, 2): border, along
        segments.append(lines if axis == 0 else lines[:, :, ::-1])
    return np.concatenate(segments)


def _union(cells: Bools) -> Polygon | MultiPolygon:
    """Return the union of the True cells [cells], built from its border lines."""
    lines = shapely.linestrings(_borders(cells))
    faces = shapely.get_parts(shapely.polygonize([shapely.union_all(lines)]))
    inside = shapely.point_on_surface(faces)
    i, j = np.floor(shapely.get_x(inside)).astype(int), np.floor(shapely.get_y(inside)).astype(int)
    kept = faces[cells[i, j]]
    return kept[0] if len(kept) == 1 else MultiPolygon(list(kept))
