"""Nav2: map.yaml for map_server, keepout.yaml for the costmap filter, amcl.yaml with parameters estimated from a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import shapely

from logs.run import OccupancyMap, Run
from planners.arena import Arena
from planners.maps.ros_map import MAX_CELLS
from sensorgraph.amending.text import decimal
from sensorgraph.errors import SensorgraphError
from sensorgraph.exporting.amcl import (
    DEFAULTS,
    MOTION_NAMES,
    BootstrapEstimate,
    LaserModelChoice,
    compare_laser_models,
    estimate_amcl,
)
from sensorgraph.exporting.amcl_filter import LASER_MODELS
from sensorgraph.exporting.world import ExportedWorld
from sensorgraph.types import Floats
from sensorgraph.world.simulate import occupancy_map

RESOLUTION, MARGIN = 0.05, 10.0
"""[m] Side of a cell, which is enlarged if there would be more than `MAX_CELLS`; margin of the map around the walls."""
FREE, OCCUPIED, UNKNOWN = 254, 0, 205
"""Grey values of free, occupied and unknown cells for map_server in trinary mode."""


def write(
    world: ExportedWorld, folder: Path, *, no_go: Sequence[shapely.Polygon] = (), run: Run | None = None
) -> list[str]:
    """Write the map, the mask and AMCL's parameters; return what they leave out, one line each.

    Parameters
    ----------
    no_go : Zones that the robot may not enter.
    run : Run with poses in the frame of the arena; None: AMCL keeps Nav2's defaults.
    """
    grid = map_of(world.arena)
    grey = np.select([grid.data == 0, grid.data == 100], [FREE, OCCUPIED], UNKNOWN)
    _write_map(folder, "map", grey, grid)
    if no_go:
        _write_map(folder, "keepout", np.where(_cells_in(no_go, grid), OCCUPIED, FREE), grid)
    estimates = {} if run is None else estimate_amcl(run, world.arena, grid)
    model = None if run is None else compare_laser_models(run, grid, chosen(estimates))
    (folder / "amcl.yaml").write_text(amcl_yaml(estimates, model, world), encoding="utf-8")
    left_out = ["the sweep, the noise and the lag: a map does not contain them"]
    if run is None:
        left_out.append("AMCL's parameters: give a run with poses (--run) to estimate them")
    return left_out


def map_of(arena: Arena) -> OccupancyMap:
    """Return the exported map: cells of 5 cm, up to MARGIN around the walls."""
    return occupancy_map(arena, resolution=RESOLUTION, most=MAX_CELLS, margin=MARGIN)


def _write_map(folder: Path, name: str, grey: np.ndarray, grid: OccupancyMap) -> None:
    """Write NAME.pgm, with the first row at the top, and NAME.yaml."""
    pixels = grey[::-1].astype(np.uint8)
    header = f"P5\n{pixels.shape[1]} {pixels.shape[0]}\n255\n".encode()
    (folder / f"{name}.pgm").write_bytes(header + pixels.tobytes())
    x, y, phi = (float(value) for value in grid.origin)
    (folder / f"{name}.yaml").write_text(
        f"image: {name}.pgm\nmode: trinary\nresolution: {grid.resolution:g}\norigin: [{x:.6g}, {y:.6g}, {phi:g}]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n",
        encoding="utf-8",
    )


def _cells_in(zones: Sequence[shapely.Polygon], grid: OccupancyMap) -> np.ndarray:
    """Return which cells (ny, nx) a zone touches."""
    ny, nx = grid.data.shape
    x, y = np.meshgrid(
        grid.origin[0] + (np.arange(nx) + 0.5) * grid.resolution,
        grid.origin[1] + (np.arange(ny) + 0.5) * grid.resolution,
    )
    wide = shapely.union_all(list(zones)).buffer(grid.resolution / 2)
    return np.asarray(shapely.contains_xy(wide, x, y))


def chosen(estimates: Mapping[str, BootstrapEstimate]) -> dict[str, float]:
    """Return AMCL's parameters by name: Nav2's defaults, unless the interval of an estimate excludes them."""
    return {
        name: default
        if (found := estimates.get(name)) is None or found.low <= default <= found.high
        else found.value
        for name, default in DEFAULTS.items()
    }


def amcl_yaml(
    estimates: Mapping[str, BootstrapEstimate], model: LaserModelChoice | None, world: ExportedWorld
) -> str:
    """Return the text of amcl.yaml: Nav2's defaults, unless the interval of an estimate excludes them.

    `lambda_short`, `z_short` and `z_max` only affect the beam model; `laser_max_range` is that of the sensor.
    Numbers are written as floats: ROS 2 refuses an integer where a parameter is a double.
    """
    lines = []
    for name, default in DEFAULTS.items():
        found = estimates.get(name)
        if found is None:
            why = (
                "; the run has too few odometry steps with poses"
                if estimates and name in MOTION_NAMES
                else ""
            )
            lines.append(f"{name}: {decimal(default)}  # Nav2's default{why}")
        elif found.low <= default <= found.high:
            lines.append(f"{name}: {decimal(default)}  # Nav2's default; estimate {found}")
        else:
            value = decimal(float(f"{found.value:.3g}"))
            lines.append(f"{name}: {value}  # estimate {found}; Nav2's default is {default:g}")
    x, y, phi = world.start
    kind = "nav2_amcl::DifferentialMotionModel"
    comment = "Nav2's default" if model is None else str(model)
    laser_model = LASER_MODELS[0] if model is None else model.name
    body = "\n".join(f"    {line}" for line in lines)
    return (
        "# AMCL: part of Nav2's parameter file. Intervals are 95 %, from a bootstrap over segments of the run.\n"
        f"amcl:\n  ros__parameters:\n    robot_model_type: {kind}\n    laser_model_type: {laser_model}  # {comment}\n"
        f"    laser_min_range: {decimal(world.robot.sensor.range_min)}\n{body}\n"
        f"    set_initial_pose: true\n    initial_pose: {{x: {x:.3f}, y: {y:.3f}, z: 0.0, yaw: {phi:.3f}}}\n"
    )


def check_zones(zones: Sequence[shapely.Polygon], bounds: Floats | tuple[float, ...]) -> None:
    """Reject zones that are all outside the arena.

    Raises
    ------
    SensorgraphError : No zone intersects the arena.
    """
    if zones and not any(zone.intersects(shapely.box(*bounds)) for zone in zones):
        raise SensorgraphError("no no-go zone lies in the arena; check that its coordinates are in map [m]")
