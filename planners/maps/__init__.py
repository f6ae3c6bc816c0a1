"""Map formats -> Arena, one module each; registry MAPS."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from planners.arena import Arena
from planners.errors import PlanError
from planners.maps import geojson, ros_map

MAPS: dict[str, Callable[[Path], Arena]] = {
    ".geojson": geojson.read,
    ".json": geojson.read,
    ".yaml": ros_map.read,
    ".yml": ros_map.read,
    ".pgm": ros_map.read_image,
    ".png": ros_map.read_image,
}


def load(path: Path) -> Arena:
    """Read an arena in the format given by its suffix.

    Raises
    ------
    PlanError : There is no reader for the suffix, no such file, or the file is invalid.
    """
    path = Path(path)
    if path.is_dir():
        raise PlanError(
            f"{path} is a folder; expected a map file: {', '.join(f'*{suffix}' for suffix in MAPS)}"
        )
    reader = MAPS.get(path.suffix.lower())
    if reader is None:
        raise PlanError(f"{path}: no reader for '{path.suffix}'; expected one of {', '.join(MAPS)}")
    if not path.is_file():
        raise PlanError(f"{path}: no such file; expected an arena (*.geojson) or a map_server map (*.yaml)")
    return reader(path)
