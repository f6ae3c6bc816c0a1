"""The functions of `import sensorgraph`: one per step, taking objects or the paths of their files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, get_type_hints

from numpy.typing import ArrayLike

import logs
from logs.run import Run
from planners.arena import Arena
from planners.trajectory import Trajectory
from sensorgraph.arguments import AtLeastOne, Count
from sensorgraph.building import build as building
from sensorgraph.diagnosis import diagnose as diagnosing
from sensorgraph.diagnosis.commissioning import commission_all
from sensorgraph.diagnosis.report.files import Diagnosis, DrivingDiagnosis
from sensorgraph.diagnosis.simulation import diagnose_against_simulation
from sensorgraph.diagnosis.without_reference import drive_alone, driving_of, located_in, with_driving
from sensorgraph.effects import Amendment, effects_file
from sensorgraph.errors import SensorgraphError, as_sensorgraph_error, takes_options
from sensorgraph.evaluation.evaluate import Evaluation
from sensorgraph.evaluation.evaluate import evaluate as evaluate_run
from sensorgraph.exporting.export import export as write_world
from sensorgraph.exporting.world import ExportedWorld
from sensorgraph.graph import Sensorgraph
from sensorgraph.identification import identify as identifying
from sensorgraph.identification.signals import SignalData, is_table, signals_of_run, signals_of_table
from sensorgraph.loading import (
    arena_in,
    exported_arena,
    exported_robot,
    load_arena,
    open_place,
    read_poses,
    robot_for,
)
from sensorgraph.localization.locate import LocatedRun, located_run
from sensorgraph.localization.locate import locate as locate_run
from sensorgraph.models.base import Point, Prediction
from sensorgraph.planning.plan import CoveragePlan, plan
from sensorgraph.recording.drive_source import check_start, parts_of, start_of
from sensorgraph.recording.record import record as record_drive
from sensorgraph.show.review.contents import Review
from sensorgraph.show.review.review import review as write_review
from sensorgraph.types import RayChoice
from sensorgraph.world.described import with_robot
from sensorgraph.world.robot import Robot, default_robot, load_robot

__all__ = [
    "build", "diagnose", "evaluate", "identify", "locate", "plan", "predict", "read", "record", "review",
]  # fmt: skip

RunLike = Run | Path | str
"""A run, or its file."""
GraphLike = Sensorgraph | Path | str
"""A sensorgraph, or its file."""
ArenaLike = Arena | Path | str
"""An arena, its file, or the name of a shipped arena."""
RobotLike = Robot | Path | str
"""A robot, or its robot.yaml."""


@as_sensorgraph_error
def read(
    path: Path | str,
    *,
    topics: Mapping[str, str] | None = None,
    no_return: str | None = None,
    robot: RobotLike | None = None,
    slice: tuple[float, float] | None = None,
) -> Run:
    """Read a run: MCAP, a rosbag2 folder, a ROS 1 bag, a CARMEN log or a CSV table.

    Parameters
    ----------
    topics : Role (`scan`, `pose`, `odom`, `cmd`) -> topic, if the log has other names.
    no_return : Value of a missing return: `range_max`, `zero`, `inf` or `nan`. None: detected from its frequency.
    robot : Robot that recorded the log. The ray times and the mounts that it states are used, in place of the log's.
    slice : [m] Lowest and highest point of a PointCloud2 that is read as a laser. None: its ring nearest the horizontal.

    Raises
    ------
    SensorgraphError : The file is not a log, or is damaged, or the robot states other rays.
    """
    machine = default_robot() if robot is None else _robot(robot)
    run = logs.read(path, topics=topics, no_return=no_return, mounts=machine.mounts, slice=slice)
    return with_robot(run, machine, name=str(path))


@as_sensorgraph_error
def record(
    drive: CoveragePlan | Trajectory | Path | str,
    arena: ArenaLike | None = None,
    robot: RobotLike | None = None,
    *,
    effects: Sequence[Amendment] | Path | str = (),
    seed: Count = 0,
    path: Path | str | None = None,
) -> Run:
    """Drive a plan with the simulated robot and record the run.

    Parameters
    ----------
    drive : Plan, its folder, a trajectory or its CSV; or the file of a run, whose commands are replayed.
    arena, robot : Arena and robot. None: those of the plan.
    effects : Effects of robot, sensor and environment to simulate, or an effects.yaml.
    seed : Random seed of all noise. The same seed gives the same run, byte for byte.
    path : MCAP file to which the run is also written.

    Raises
    ------
    SensorgraphError : No arena is known, the drive starts in a wall, or the arena lacks the place of an effect.
    """
    commands, plan_arena, plan_robot, attachments = parts_of(drive)
    walls = plan_arena if arena is None else _arena(arena)
    if walls is None:
        raise SensorgraphError("a trajectory has no arena; give the arena to drive in")
    machine = (plan_robot or load_robot()) if robot is None else _robot(robot)
    known = effects_file.read(Path(effects), walls) if isinstance(effects, str | Path) else effects
    check_start(start_of(commands), walls, machine)
    file = None if path is None else Path(path)
    return record_drive(file, walls, machine, commands, effects=known, seed=seed, attachments=attachments)


@as_sensorgraph_error
def locate(
    run: RunLike, arena: ArenaLike | GraphLike | None = None, *, path: Path | str | None = None
) -> LocatedRun:
    """Estimate the pose of each scan of a run from scans and wheel odometry.

    Parameters
    ----------
    run : Run of a laser. Its reference poses are not used.
    arena : Known place: an arena, a sensorgraph of faces or cells, the file of one, or the name of a shipped arena.
        None: a map is built, and the first pose is that of the odometry.
    path : MCAP file to which the run with its poses is also written.

    Returns
    -------
    LocatedRun with poses (n_scans, 3), covariances (n_scans, 3, 3), status, and `run`, which `build` takes.

    Raises
    ------
    SensorgraphError : There are too few scans, the sensor has wide cones, or the scans fit nowhere in the arena.
    """
    log = _run(run)
    place = open_place(arena) if isinstance(arena, str | Path) else arena
    found = LocatedRun.of(log, locate_run(log, place, name="the map" if place is arena else str(arena)))
    if path is not None:
        logs.write(located_run(log, found), path)
    return found


@as_sensorgraph_error
@takes_options(building.option_types)
def build(
    runs: RunLike | Sequence[RunLike], *, arena: ArenaLike | None = None, update: GraphLike | None = None,
    **options: Any,
) -> Sensorgraph:  # fmt: skip
    """Fit a sensorgraph to one or several runs of the same sensor.

    Parameters
    ----------
    arena : Arena whose bounds scale x and y, so that graphs of several runs have the same scale.
    update : Graph of faces or cells to which the runs are added; its own runs are not needed.
    options : Options of `sensorgraph.building.build.build`: `model`, `split`, `calibrate`, `degree`, `memory`, ...

    Raises
    ------
    SensorgraphError : An option is unknown, too few scans have a pose, the poses jump, or the runs have different sensors.
    """
    several = [runs] if isinstance(runs, Run | Path | str) else list(runs)
    walls = None if arena is None else _arena(arena)
    old = None if update is None else _graph(update)
    return building.build(
        [_run(run) for run in several], arena=walls, update=old, **{"force": False, **options}
    )


@as_sensorgraph_error
def evaluate(
    graph: GraphLike,
    run: RunLike,
    *,
    split: str | None = None,
    point: Point | None = None,
    cap: float | None = None,
    force: bool = False,
) -> Evaluation:
    """Compare the predictions of a sensorgraph with the ranges measured in a run.

    Parameters
    ----------
    split : `every10` or `block`. Score only the held-out scans of this split.
    point : Point value for all scores: `mode`, `median` or `mean`. None: the best one for each score.
    cap : [m] Longest return that is scored. None: 10, or the sensor's range if shorter.
    force : Accept a run whose poses jump.

    Raises
    ------
    SensorgraphError : The run has another sensor, or no scan with a pose to score.
    """
    return evaluate_run(_graph(graph), _run(run), split=split, point=point, cap=cap, force=force)


@as_sensorgraph_error
def predict(
    graph: GraphLike, poses: ArrayLike | Path, *, rays: RayChoice = None, point: Point = "mode"
) -> Prediction:
    """Predict rays at given poses: arrays (n_poses, n_rays).

    Parameters
    ----------
    poses : (n_poses, 3) or (3,) [m, m, rad] in map, or others that `Sensorgraph.predict` takes; or a CSV with the columns
        x, y, phi.
    rays, point : Indices of the predicted rays (None: all), and point value of the mixture in `ranges`.

    Raises
    ------
    SensorgraphError : The poses have another shape, one is not finite or far from any arena, or a heading is in degrees.
    """
    where = read_poses(Path(poses)) if isinstance(poses, str | os.PathLike) else poses
    return _graph(graph).predict(where, rays=rays, point=point)


@as_sensorgraph_error
def diagnose(
    run: RunLike,
    second: RunLike | None = None,
    *,
    arena: ArenaLike | None = None,
    robot: RobotLike | None = None,
    effects: Sequence[Amendment] | Path | str = (),
    commissioning: Sequence[RunLike] = (),
    simulation: RunLike | None = None,
    seed: Count = 0,
    force: bool = False,
) -> Diagnosis | DrivingDiagnosis:
    """Find the physical effects that explain why measurement and simulation differ.

    A run without reference poses is located first. Without an arena, only wheels and mount are estimated.

    Parameters
    ----------
    second : Second run of the same place, used only to verify the result. Without an arena, the second run is
        compared with the first.
    arena, robot : Arena and robot. None: those kept in the run.
    effects : Effects that the simulation already includes, or an effects.yaml.
    commissioning : Runs known to be good. Only differences from them are reported.
    simulation : Run of your own simulator in the same arena. Only differences between the two runs are reported.
    seed : Random seed of the simulated replicates (parametric bootstrap). The same seed gives the same report.
    force : Accept a run whose poses jump.

    Raises
    ------
    SensorgraphError : A run has neither arena nor odometry, or the second run is of another place.
    """
    log = _run(run)
    walls = arena_in(log) if arena is None else _arena(arena)
    if walls is None:
        if effects or commissioning or simulation is not None:
            raise SensorgraphError("the run keeps no arena; give the arena in which it was recorded")
        several = [log] if second is None else [log, _run(second)]
        return DrivingDiagnosis.of(drive_alone(several, None if robot is None else _robot(robot)))
    machine = robot_for(log, robot)
    log = located_in(log, walls, machine)
    known = effects_file.read(Path(effects), walls) if isinstance(effects, str | Path) else effects
    effects_file.check_places(known, walls)
    good = [_run(one) for one in commissioning]
    if good and simulation is not None:
        raise SensorgraphError("simulation and commissioning are both given; give only one of them")
    options: dict[str, Any] = {
        "second": None if second is None else located_in(_run(second), walls, machine),
        "known": known,
        "baseline": commission_all(good, walls, machine, seed=seed) if good else None,
        "seed": seed,
        "force": force,
    }
    find: Any = diagnosing.diagnose
    if simulation is not None:
        find = partial(diagnose_against_simulation, simulation=located_in(_run(simulation), walls, machine))
    finding = with_driving(find(log, walls, machine, **options), driving_of(log, machine), machine)
    return Diagnosis.of(finding, walls, machine)


@as_sensorgraph_error
@takes_options(partial(get_type_hints, identifying.IdentificationSpec, include_extras=True))
def identify(
    data: RunLike | SignalData, *, output: str, inputs: Sequence[str] | str = (), every: AtLeastOne = 1,
    **options: Any,
) -> identifying.IdentifiedSignal:  # fmt: skip
    """Identify one signal of a run or a table as a polynomial of other signals.

    Parameters
    ----------
    data : Run, its file, or a CSV with a header line.
    output, inputs : Signals: `x y phi v omega cmd_v cmd_omega`, `L67`, `L45-90`, or columns; `"v,omega"` are two inputs.
    every : Use every n-th sample.
    options : Fields of `sensorgraph.identification.identify.IdentificationSpec`: `lags`, `output_lags`, `degree`, ...

    Raises
    ------
    SensorgraphError : A signal is unknown, or the data are too few to determine a model.
    """
    names = (output, *(map(str.strip, inputs.split(",")) if isinstance(inputs, str) else inputs))
    question = identifying.IdentificationSpec(output=output, inputs=names[1:], **options)
    if isinstance(data, SignalData):
        return identifying.identify(data, question)
    if isinstance(data, str | Path) and is_table(Path(data)):
        return identifying.identify(signals_of_table(Path(data), names, every=every), question)
    return identifying.identify(signals_of_run(_run(data), names, every=every), question)


@as_sensorgraph_error
def review(
    run: RunLike,
    path: Path | str,
    *,
    graph: GraphLike | None = None,
    plan: CoveragePlan | Path | str | None = None,
    arena: ArenaLike | None = None,
    ray: int | None = None,
    force: bool = False,
) -> Review:
    """Write a rerun recording of a run: coverage, and errors of a sensorgraph by place, heading and ray.

    Parameters
    ----------
    path : Recording to write, `*.rrd`.
    graph : Sensorgraph to compare with the run.
    plan, arena : Plan, or its folder, and arena that are drawn. Without an arena: the one kept in the run.
    ray : Index of the ray whose time series is shown. None: the ray straight ahead.
    force : Accept a run whose poses jump.

    Raises
    ------
    SensorgraphError : The path does not end in `.rrd`.
    """
    log = _run(run)
    walls = arena_in(log) if arena is None else _arena(arena)
    return write_review(log, path=path, graph=graph, plan=plan, arena=walls, ray=ray, force=force)


@as_sensorgraph_error
def export(
    source: Arena | Sensorgraph | Path | str,
    target: str,
    folder: Path | str,
    *,
    robot: RobotLike | None = None,
    effects: Sequence[Amendment] | Path | str = (),
    run: RunLike | None = None,
    name: str = "arena",
) -> list[str]:
    """Export an arena or a sensorgraph to another simulator or to Nav2; return the effects that are left out.

    Parameters
    ----------
    source : Arena, sensorgraph of faces, or the file or name of one; or a log with a map.
    target : `mujoco`, `irsim`, `gazebo` or `nav2`.
    folder : Folder to write. After an error, nothing is written.
    robot : Robot to export. None: that of the run, else the one kept in the log of `source`, else the shipped robot
        with the laser of the sensorgraph.
    effects : Effects to build in, as far as the target supports them, or an effects.yaml.
    run : Run with poses from which the AMCL parameters are estimated (`nav2`).
    name : Name of the world.

    Raises
    ------
    SensorgraphError : The target is unknown, the world has no walls, or the robot fits nowhere in it.
    """
    walls, graph, kept = exported_arena(source)
    log = None if run is None else _run(run)
    machine = exported_robot(robot, log, graph, kept=kept)
    known = effects_file.read(Path(effects), walls) if isinstance(effects, str | Path) else tuple(effects)
    effects_file.check_places(known, walls)
    world = ExportedWorld.of(walls, machine, known, name=name)
    return write_world(world, target, Path(folder), run=log)


def _run(run: RunLike) -> Run:
    return run if isinstance(run, Run) else logs.read(run)


def _graph(graph: GraphLike) -> Sensorgraph:
    return graph if isinstance(graph, Sensorgraph) else Sensorgraph.load(Path(graph))


def _arena(arena: ArenaLike) -> Arena:
    return arena if isinstance(arena, Arena) else load_arena(arena)


def _robot(robot: RobotLike) -> Robot:
    return robot if isinstance(robot, Robot) else load_robot(robot)
