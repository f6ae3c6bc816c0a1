"""Load arenas and robots from files, shipped examples or the attachments of a run."""

from __future__ import annotations

import csv
import json
import logging
import math
from dataclasses import replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np

from logs.errors import LogError
from logs.formats import format_of
from logs.recorded_map import RecordedMap, read_map
from logs.run import Run
from planners import maps
from planners.arena import Arena
from planners.errors import PlanError
from planners.maps import geojson, ros_map
from sensorgraph.errors import SensorgraphError, as_sensorgraph_error
from sensorgraph.graph import Sensorgraph
from sensorgraph.quantities import ANGLE, is_number, pose_of, quantity, split_unit
from sensorgraph.types import Floats
from sensorgraph.world.described import completed, rays_text
from sensorgraph.world.identified_arena import arena_of
from sensorgraph.world.ray_order import ray_order
from sensorgraph.world.robot import Robot, default_robot, load_robot, parse_robot

logger = logging.getLogger(__name__)


@as_sensorgraph_error
def load_arena(source: str | Path) -> Arena:
    """Load an arena.

    Parameters
    ----------
    source : A GeoJSON file, a map_server yaml, a log with a map (its attached arena, or the last grid in /map), a
        sensorgraph of faces (its identified walls), or the name of a shipped arena: `square` or `office`.

    Raises
    ------
    SensorgraphError : The file does not exist or is not an arena, or the sensorgraph holds no walls.
    """
    name = str(source)
    shipped = sorted(
        entry.name.removesuffix(".geojson")
        for entry in files("sensorgraph.data").iterdir()
        if entry.name.endswith(".geojson")
    )
    if name in shipped:
        with as_file(files("sensorgraph.data") / f"{name}.geojson") as path:
            return maps.load(path)
    if not Path(name).exists():
        raise SensorgraphError(
            f"{name} does not exist; give a *.geojson, a map_server *.yaml, a log with /map, a *.sensorgraph, "
            f"or one of {', '.join(shipped)}"
        )
    if name.endswith(".sensorgraph"):
        return arena_of(Sensorgraph.load(Path(name)))
    return _arena_of_log(Path(name), read_map(Path(name))) if _is_log(Path(name)) else maps.load(Path(name))


def open_place(source: str | Path) -> Arena | Sensorgraph:
    """Open a sensorgraph by its file, or load an arena as `load_arena` does."""
    is_graph = str(source).endswith(".sensorgraph") and Path(source).exists()
    return Sensorgraph.load(Path(source)) if is_graph else load_arena(source)


def _is_log(path: Path) -> bool:
    """Return whether a file is a log and no map."""
    if path.is_file() and path.suffix.lower() in maps.MAPS:
        return False
    try:
        return bool(format_of(path))
    except LogError:
        return False


def _arena_of_log(path: Path, found: RecordedMap) -> Arena:
    """Return the map that was recorded in a log."""
    logger.warning("%s: the arena is %s", path, found.source)
    if found.arena is not None:
        return geojson.loads(found.arena.decode(errors="replace"))
    assert found.grid is not None
    name = f"{path.name}: {found.source}"
    return ros_map.of_grid(found.grid.data, found.grid.resolution, found.grid.origin.tolist(), name)


def read_poses(path: Path) -> Floats:
    """Read columns x, y, phi of a CSV file, numbers in m and rad or with a unit (`1.5 deg`); (n_poses, 3) [m, m, rad].

    Raises
    ------
    SensorgraphError : A column is missing, a line holds no numbers, phi is more than a full turn (degrees?), or there
        is no pose.
    """
    rows: list[list[float]] = []
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            names = [name.strip() for name in reader.fieldnames or []]
            reader.fieldnames = names
            missing = [name for name in ("x", "y", "phi") if name not in names]
            if missing:
                raise SensorgraphError(
                    f"{path}: no column {', '.join(missing)}; expected a header line x,y,phi"
                )
            for row in reader:
                texts = [row[name] for name in ("x", "y", "phi")]
                try:
                    pose = [float(text) for text in texts]
                except (TypeError, ValueError):
                    if not all(is_number(split_unit(text)[0]) for text in texts):
                        raise SensorgraphError(
                            f"{path}: line {reader.line_num}: expected numbers, found {list(row.values())}; "
                            "each line needs x,y,phi"
                        ) from None
                    pose = pose_of(texts, f"{path}: line {reader.line_num}")
                if math.isfinite(pose[2]) and abs(pose[2]) > ANGLE.most:
                    quantity(pose[2], f"{path}: line {reader.line_num}: phi", ANGLE)
                rows.append(pose)
    except (UnicodeDecodeError, csv.Error) as exc:
        raise SensorgraphError(f"{path}: not a CSV file ({exc}); expected a header line x,y,phi") from exc
    poses = np.array(rows, dtype=np.float64).reshape(-1, 3)
    if len(poses) == 0:
        raise SensorgraphError(f"{path}: no pose below the header; expected lines of x,y,phi")
    if not np.isfinite(poses).all():
        line = 2 + int(np.flatnonzero(~np.isfinite(poses).all(axis=1))[0])
        raise SensorgraphError(f"{path}: line {line}: a number is not finite; remove such poses")
    return poses


def read_plan_report(path: Path) -> dict[str, Any]:
    """Read plan.json.

    Raises
    ------
    SensorgraphError : The file is not JSON, or not an object whose coverage is a number.
    """
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as exc:
        raise SensorgraphError(f"{path}: not JSON ({exc}); plan again or remove the file") from exc
    if not isinstance(report, dict) or not isinstance(report.get("coverage", 0.0), int | float):
        raise SensorgraphError(f"{path}: holds no report of a plan; plan again or remove the file")
    return report


def arena_in(run: Run) -> Arena | None:
    """Return the arena kept in a run as an attachment; None if it has no such attachment.

    Raises
    ------
    SensorgraphError : The attachment is not an arena.
    """
    text = run.attachments.get("arena.geojson")
    if text is None:
        return None
    try:
        return geojson.loads(text.decode(errors="replace"))
    except PlanError as exc:
        raise SensorgraphError(f"the arena kept in the run is invalid ({exc}); pass another arena") from exc


def robot_in(run: Run) -> Robot | None:
    """Return the robot kept in a run as an attachment; None if it has no such attachment."""
    return _robot_of(run.attachments.get("robot.yaml"), "the run")


def _robot_of(text: bytes | None, name: str) -> Robot | None:
    """Return the robot of an attachment."""
    return None if text is None else parse_robot(text.decode(errors="replace"), name=f"robot.yaml in {name}")


def attachments_of(arena: Arena | None, robot: Robot | None) -> dict[str, bytes]:
    """Return the files by which a run or a plan keeps its arena and robot, which `arena_in` and `robot_in` read."""
    kept = {} if arena is None else {"arena.geojson": geojson.dumps(arena).encode()}
    return kept if robot is None else {**kept, "robot.yaml": robot.text.encode()}


def robot_for(run: Run, source: Robot | str | Path | None = None) -> Robot:
    """Return a robot, else the one kept in the run, else defaults; values that it does not state are the run's.

    Parameters
    ----------
    source : A robot, or the path of a robot.yaml.

    Raises
    ------
    SensorgraphError : A file is invalid or contradicts the run.
    """
    if isinstance(source, Robot):
        robot = source
    else:
        robot = load_robot(source) if source is not None else robot_in(run) or default_robot()
    return completed(robot, run.sensor)


def exported_arena(
    source: Arena | Sensorgraph | Path | str,
) -> tuple[Arena, Sensorgraph | None, Robot | None]:
    """Return the arena of an export, the sensorgraph that it is from, and the robot that is kept with it in a log."""
    if isinstance(source, str | Path) and Path(source).exists() and _is_log(Path(source)):
        found = read_map(Path(source))
        return _arena_of_log(Path(source), found), None, _robot_of(found.robot, str(source))
    place = open_place(source) if isinstance(source, str | Path) else source
    return (arena_of(place), place, None) if isinstance(place, Sensorgraph) else (place, None, None)


def exported_robot(
    source: Robot | str | Path | None,
    run: Run | None,
    graph: Sensorgraph | None,
    *,
    kept: Robot | None = None,
) -> Robot:
    """Return the robot of an export: the given one, else that of a run, else the kept or the shipped one.

    The shipped robot gets the laser of a graph.

    Raises
    ------
    SensorgraphError : A file is invalid or contradicts the run, or robot.yaml cannot describe the laser of the graph.
    """
    if run is not None:
        return robot_for(run, source)
    if isinstance(source, Robot):
        return source
    if source is None and kept is not None:
        return kept
    robot = load_robot(source)
    return robot if source is not None or graph is None else with_laser_of(graph, robot)


def robot_in_graph(
    graph: Sensorgraph, source: str | Path | None = None, *, kept: Robot | None = None
) -> Robot:
    """Return a robot that drives in a graph: the given one, else the kept or the shipped one, with the laser of the graph.

    A robot with the rays of the graph keeps its own laser.

    Raises
    ------
    SensorgraphError : A file is invalid, or robot.yaml cannot describe the laser of the graph.
    """
    if source is not None:
        return load_robot(source)
    robot = kept or load_robot()
    is_same = ray_order(graph.sensor.bearings, robot.sensor.bearings) is not None
    return robot if is_same else with_laser_of(graph, robot)


def with_laser_of(graph: Sensorgraph, robot: Robot) -> Robot:
    """Return a robot with the laser of a graph.

    Raises
    ------
    SensorgraphError : robot.yaml cannot describe this laser.
    """
    if not rays_text(graph.sensor.bearings):
        raise SensorgraphError(
            "the rays of the graph are not evenly spaced, so that robot.yaml cannot describe them; give a robot"
        )
    of_base = frozenset(key for key in robot.stated if not key.startswith("sensor"))
    return completed(replace(robot, stated=of_base), graph.sensor)
