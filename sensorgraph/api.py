"""What `import sensorgraph` offers: one function for each step, taking objects or the paths of their files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import logs
from logs.run import Run
from planners.arena import Arena
from planners.trajectory import Trajectory
from sensorgraph.building import build as building
from sensorgraph.diagnosis import diagnose as diagnosing
from sensorgraph.diagnosis.against_simulation import diagnose_against_simulation
from sensorgraph.diagnosis.commissioning import commission_all
from sensorgraph.diagnosis.report.diagnosis import Diagnosis
from sensorgraph.diagnosis.report.driving_files import DrivingDiagnosis
from sensorgraph.diagnosis.without_reference import drive_alone, driving_of, located_in, with_driving
from sensorgraph.effects import Amendment, effects_file
from sensorgraph.errors import SensorgraphError, as_sensorgraph_error
from sensorgraph.evaluation.evaluate import Evaluation
from sensorgraph.evaluation.evaluate import evaluate as evaluate_run
from sensorgraph.exporting.export import export as write_world
from sensorgraph.exporting.world import ExportedWorld
from sensorgraph.graph import Sensorgraph
from sensorgraph.identification import identify as identifying
from sensorgraph.identification.signals import SignalData, is_table, signals_of_run, signals_of_table
from sensorgraph.loading import arena_in, load_arena, read_poses, robot_for, robot_in
from sensorgraph.localization.locate import LocatedRun, has_reference, located_run
from sensorgraph.localization.locate import locate as locate_run
from sensorgraph.models.base import Point, Prediction
from sensorgraph.planning.plan import CoveragePlan, plan
from sensorgraph.recording.drive_source import check_start, kept_plan, open_drive, start_of
from sensorgraph.recording.record import Commands
from sensorgraph.recording.record import record as record_drive
from sensorgraph.show.review.contents import Review
from sensorgraph.show.review.review import review as write_review
from sensorgraph.world.identified_arena import arena_of
from sensorgraph.world.robot import Robot, load_robot

__all__ = [
    "build", "diagnose", "evaluate", "identify", "locate", "plan", "predict", "read", "record", "review",
]  # fmt: skip

RunLike = Run | Path | str
"""A run, or a file of one."""
GraphLike = Sensorgraph | Path | str
"""A sensorgraph, or its file."""
ArenaLike = Arena | Path | str
"""An arena, its file, or the name of a shipped one."""
RobotLike = Robot | Path | str
"""A robot, or its robot.yaml."""


@as_sensorgraph_error
def read(
    path: Path | str,
    *,
    topics: Mapping[str, str] | None = None,
    no_return: str | None = None,
    robot: RobotLike | None = None,
) -> Run:
    """Read a run: MCAP, a rosbag2 folder, a ROS 1 bag, a CARMEN log or a CSV table.

    Parameters
    ----------
    topics : role (`scan`, `pose`, `odom`, `cmd`) -> topic, where a log names them otherwise
    no_return : how a missing return was logged: `range_max`, `zero`, `inf` or `nan`; None: noticed from its frequency
    robot : whose `sensors` sit where no transform in the log says

    Raises
    ------
    SensorgraphError : the file is no log, or is damaged
    """
    mounts = None if robot is None else _robot(robot).mounts
    return logs.read(path, topics=topics, no_return=no_return, mounts=mounts)


@as_sensorgraph_error
def record(
    drive: CoveragePlan | Trajectory | Path | str,
    arena: ArenaLike | None = None,
    robot: RobotLike | None = None,
    *,
    effects: Sequence[Amendment] | Path | str = (),
    seed: int = 0,
    path: Path | str | None = None,
) -> Run:
    """Let the embedded robot drive a plan, and record what it perceives.

    Parameters
    ----------
    drive : a plan, its folder, a trajectory or its CSV; or the file of a run, whose commands are driven again
    arena, robot : None: those of the plan
    effects : what robot, sensor and room have beyond robot.yaml and the map; or an effects.yaml
    seed : of all noise; the same seed gives the same run, byte for byte
    path : also write the run there, as MCAP

    Raises
    ------
    SensorgraphError : no arena is known, the drive starts in a wall, or an effect names a place that the arena lacks
    """
    way, plan_arena, plan_robot, attachments = _drive(drive)
    walls = plan_arena if arena is None else _arena(arena)
    if walls is None:
        raise SensorgraphError("a trajectory alone names no arena; give the arena to drive in")
    machine = (plan_robot or load_robot()) if robot is None else _robot(robot)
    amendments = effects_file.read(Path(effects), walls) if isinstance(effects, str | Path) else effects
    check_start(start_of(way), walls, machine)
    file = None if path is None else Path(path)
    return record_drive(file, walls, machine, way, effects=amendments, seed=seed, attachments=attachments)


@as_sensorgraph_error
def locate(
    run: RunLike, arena: ArenaLike | GraphLike | None = None, *, path: Path | str | None = None
) -> LocatedRun:
    """Find where each scan of a run was taken, from scans and wheels alone.

    Parameters
    ----------
    run : of a laser; its own reference poses, if it has any, are left aside
    arena : the place, where it is known: an arena, a sensorgraph of faces or cells, the file of one, or a shipped arena; None:
        it is mapped, and the first pose is that of the odometry
    path : also write the run with its poses there, as MCAP

    Returns
    -------
    LocatedRun with poses (n_scans, 3), covariances (n_scans, 3, 3), status, and `run`, which `build` takes

    Raises
    ------
    SensorgraphError : too few scans, wide cones, or scans that fit nowhere in the arena
    """
    log = _run(run)
    place = arena
    if isinstance(arena, str | Path):
        is_graph = str(arena).endswith(".sensorgraph") and Path(arena).exists()
        place = _graph(arena) if is_graph else _arena(arena)
    name = str(arena) if isinstance(arena, str | Path) else "the map"
    assert place is None or isinstance(place, Arena | Sensorgraph)
    found = LocatedRun.of(log, locate_run(log, place, name=name))
    if path is not None:
        logs.write(located_run(log, found), path)
    return found


@as_sensorgraph_error
def build(
    runs: RunLike | Sequence[RunLike], *, arena: ArenaLike | None = None, **options: Any
) -> Sensorgraph:
    """Fit a sensorgraph to one run or several of the same sensor.

    Parameters
    ----------
    arena : its bounds scale x and y, so that graphs of several runs share them
    options : of `sensorgraph.building.build.build`: `model`, `split`, `calibrate`, `degree`, `update`, `force`, ...

    Raises
    ------
    SensorgraphError : too few scans have a pose, the poses jump, or the runs are of different sensors
    """
    several = [runs] if isinstance(runs, Run | Path | str) else list(runs)
    walls = None if arena is None else _arena(arena)
    return building.build([_run(run) for run in several], arena=walls, **{"force": False, **options})


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
    """Compare what a sensorgraph predicts with what a run measured.

    Parameters
    ----------
    split : `every10` or `block`: score only the scans that this split held out of the fit
    point : `mode`, `median` or `mean`; None: to each number its own
    cap : [m] longest return that counts; None: 10, or the sensor's range
    force : compare a run whose poses jump, too

    Raises
    ------
    SensorgraphError : the run is of another sensor, or has no scan with a pose to score
    """
    return evaluate_run(_graph(graph), _run(run), split=split, point=point, cap=cap, force=force)


@as_sensorgraph_error
def predict(graph: GraphLike, poses: ArrayLike | Path, *, point: Point = "mode") -> Prediction:
    """Predict every ray at given poses.

    Parameters
    ----------
    poses : (n_poses, 3) or (3,) [m, m, rad] x, y, phi of the graph's `pose_frame` in map; or a CSV with these columns
    point : which value of the mixture `ranges` is

    Returns
    -------
    Prediction with arrays (n_poses, n_rays)

    Raises
    ------
    SensorgraphError : a pose is not finite, or is far from any arena
    """
    where = read_poses(Path(poses)) if isinstance(poses, str | Path) else np.asarray(poses, dtype=np.float64)
    return _graph(graph).predict(np.atleast_2d(where), point=point)


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
    seed: int = 0,
    force: bool = False,
) -> Diagnosis | DrivingDiagnosis:
    """Find where simulation and measurement disagree, and name the missing physical effect.

    A run without a reference is located first. Without an arena, too, only wheels and mount can be told, from driving alone.

    Parameters
    ----------
    second : a further run of the same place, used for nothing but the proof; without arena and reference: to compare with
    arena, robot : None: those that the run keeps
    effects : what is part of the model already; or an effects.yaml
    commissioning : runs known to be good; what differs from them is found
    simulation : a run of your own simulator in the same arena; what differs between the two is found
    seed : of the replicates; the same seed gives the same report
    force : diagnose a run whose poses jump, too

    Raises
    ------
    SensorgraphError : no arena is known of a run with a reference, no odometry of one without, or the second is of another place
    """
    log = _run(run)
    walls = arena_in(log) if arena is None else _arena(arena)
    if walls is None:
        if has_reference(log) or effects or commissioning or simulation is not None:
            raise SensorgraphError("the run keeps no arena; give the arena it was driven in")
        several = [log] if second is None else [log, _run(second)]
        return DrivingDiagnosis.of(drive_alone(several, None if robot is None else _robot(robot)))
    machine = (robot_in(log) or robot_for(log)) if robot is None else _robot(robot)
    log = located_in(log, walls, machine)
    known = effects_file.read(Path(effects), walls) if isinstance(effects, str | Path) else effects
    effects_file.check_places(known, walls)
    good = [_run(one) for one in commissioning]
    if good and simulation is not None:
        raise SensorgraphError("simulation and commissioning are both given; compare with one or the other")
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
def identify(
    data: RunLike | SignalData, *, output: str, inputs: Sequence[str] = (), every: int = 1, **options: Any
) -> identifying.IdentifiedSignal:
    """Identify one signal of a run or a table as a polynomial of others.

    Parameters
    ----------
    data : a run, the file of one, or a CSV with a header line
    output, inputs : `x y phi v omega cmd_v cmd_omega`, `L67`, `L45-90`, or the columns of the CSV
    every : take every n-th sample
    options : of `sensorgraph.identification.identify.IdentificationSpec`: `lags`, `output_lags`, `degree`, `noise_lags`, ...

    Raises
    ------
    SensorgraphError : a signal is unknown, the data are too few, or they do not determine a model
    """
    question = identifying.IdentificationSpec(output=output, inputs=tuple(inputs), **options)
    names = [output, *question.inputs]
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
    path : the recording to write, `*.rrd`
    graph : a sensorgraph to compare with the run
    plan : a plan, or its folder, whose path is drawn
    arena : walls to draw; None: those that the run keeps
    ray : index of the ray whose series is shown; None: the one straight ahead
    force : show a run whose poses jump, too

    Raises
    ------
    SensorgraphError : the path does not end in `.rrd`
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
    """Write an arena or a sensorgraph as a world for another simulator, or for Nav2; return what the target cannot do.

    Parameters
    ----------
    source : an arena, a sensorgraph of faces, or the file or name of one
    target : `mujoco`, `irsim`, `gazebo` or `nav2`
    folder : to write; all of it or nothing
    robot : None: the shipped one
    effects : what the world, the laser and the wheels have beyond map and robot.yaml; or an effects.yaml
    run : one with poses, from which AMCL's parameters are estimated (`nav2`)
    name : of the world

    Raises
    ------
    SensorgraphError : an unknown target, a world without walls, or a robot that fits nowhere in it
    """
    walls = arena_of(source) if isinstance(source, Sensorgraph) else _arena(source)
    machine = load_robot() if robot is None else _robot(robot)
    known = effects_file.read(Path(effects), walls) if isinstance(effects, str | Path) else tuple(effects)
    effects_file.check_places(known, walls)
    world = ExportedWorld.of(walls, machine, known, name=name)
    return write_world(world, target, Path(folder), run=None if run is None else _run(run))


def _run(run: RunLike) -> Run:
    return run if isinstance(run, Run) else logs.read(run)


def _graph(graph: GraphLike) -> Sensorgraph:
    return graph if isinstance(graph, Sensorgraph) else Sensorgraph.load(Path(graph))


def _arena(arena: ArenaLike) -> Arena:
    return arena if isinstance(arena, Arena) else load_arena(arena)


def _robot(robot: RobotLike) -> Robot:
    return robot if isinstance(robot, Robot) else load_robot(robot)


def _drive(
    drive: CoveragePlan | Trajectory | Path | str,
) -> tuple[Trajectory | Commands, Arena | None, Robot | None, dict[str, bytes]]:
    """Return what to drive, the arena and the robot that it was planned for if they are known, and what a run keeps."""
    if isinstance(drive, CoveragePlan):
        return drive.trajectory, drive.arena, drive.robot, kept_plan(drive.to_dict())
    if isinstance(drive, Trajectory):
        return drive, None, None, {}
    source = open_drive(Path(drive))
    return source.way, source.arena(), source.robot(), source.attachments()
