"""Open what the steps of the loop take: arenas and robots, from files, shipped examples, or what a run keeps."""

from __future__ import annotations

from dataclasses import replace
from importlib.resources import as_file, files
from pathlib import Path

from logs.run import Run
from planners import maps
from planners.arena import Arena
from planners.errors import PlanError
from planners.maps import geojson
from sensorgraph.building.build import is_same_sensor
from sensorgraph.errors import SensorgraphError, as_sensorgraph_error
from sensorgraph.graph import Sensorgraph
from sensorgraph.world.identified_arena import arena_of
from sensorgraph.world.robot import Robot, load_robot, parse_robot


@as_sensorgraph_error
def load_arena(source: str | Path) -> Arena:
    """Open an arena.

    Parameters
    ----------
    source : a GeoJSON file, a map_server yaml, a sensorgraph of faces (its identified walls), or the name of a
        shipped arena: `square`, `office`

    Raises
    ------
    SensorgraphError : there is no such file, or the sensorgraph holds no walls
    SensorgraphError : the file is no arena
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
            f"{name} does not exist; give a *.geojson, a map_server *.yaml, a *.sensorgraph, "
            f"or one of {', '.join(shipped)}"
        )
    if name.endswith(".sensorgraph"):
        return arena_of(Sensorgraph.load(Path(name)))
    return maps.load(Path(name))


def arena_in(run: Run) -> Arena | None:
    """Return the arena that a run keeps as an attachment; None if it keeps none.

    Raises
    ------
    SensorgraphError : the attachment is no arena
    """
    text = run.attachments.get("arena.geojson")
    if text is None:
        return None
    try:
        return geojson.loads(text.decode(errors="replace"))
    except PlanError as exc:
        raise SensorgraphError(f"the arena kept in the run cannot be used ({exc}); give another one") from exc


def robot_in(run: Run) -> Robot | None:
    """Return the robot that a run keeps as an attachment; None if it keeps none."""
    text = run.attachments.get("robot.yaml")
    if text is None:
        return None
    return parse_robot(text.decode(errors="replace"), name="robot.yaml in the run")


def robot_for(run: Run, source: str | Path | None = None) -> Robot:
    """Open a robot.yaml; without a source, the shipped robot with the sensor that the run itself describes."""
    robot = load_robot(source)
    if source is None and not is_same_sensor(run.sensor.bearings, robot.sensor.bearings):
        return replace(robot, sensor=replace(run.sensor, height=robot.sensor.height))
    return robot
