"""What several commands read: arenas, topics, poses; every mistake becomes one line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any

import typer

from logs.files import atomic_file
from sensorgraph.cli.messages import with_flags
from sensorgraph.errors import SensorgraphError

if TYPE_CHECKING:
    from logs.run import Run
    from planners.arena import Arena
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.types import Floats


def check_output(path: Path, *inputs: Path) -> None:
    """Refuse an output path that cannot be written, or is one of the inputs, before any work is done."""
    if path.is_dir():
        raise SensorgraphError(f"{path} is a folder; give the name of a file to write")
    if not path.parent.is_dir():
        raise SensorgraphError(f"the folder {path.parent} does not exist; make it first, or write elsewhere")
    for given in inputs:
        if path.exists() and given.exists() and path.samefile(given):
            raise SensorgraphError(f"{path} is the input itself and would be lost; write to another name")
    _probe(path.parent, path)


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be made or written in, before any work is done; nothing is made yet."""
    nearest = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not nearest.is_dir():
        raise SensorgraphError(f"{nearest} is a file; give the name of a folder")
    _probe(nearest, folder)


def check_runs(runs: Sequence[Path]) -> None:
    """Refuse a run that is named twice: its scans would count twice."""
    known: dict[tuple[int, int], Path] = {}
    for path in (path for path in runs if path.exists()):
        stat = path.stat()
        if (stat.st_dev, stat.st_ino) in known:
            raise SensorgraphError(
                f"{path} is given twice, and its scans would count twice; name each run once"
            )
        known[stat.st_dev, stat.st_ino] = path


def _probe(folder: Path, output: Path) -> None:
    """Say now, not after the work, that a folder cannot be written in."""
    try:
        TemporaryFile(dir=folder).close()
    except OSError as exc:
        raise OSError(exc.errno, exc.strerror, str(output)) from exc


def mounts_of(robot: Path | None) -> Mapping[str, Floats]:
    """Return where the named sensors of a robot.yaml sit, for logs without transforms."""
    from sensorgraph.world.robot import load_robot

    return {} if robot is None else load_robot(robot).mounts


def with_robot(run: Run, name: str, path: Path | None) -> Run:
    """Return a run with the sweep of a robot file, which must describe the sensor that recorded; None: as it is."""
    from sensorgraph.world.ray_order import bearings_text, ray_order
    from sensorgraph.world.robot import load_robot
    from sensorgraph.world.sweep import sweep_warning, with_sweep_of

    if path is None:
        return run
    robot = load_robot(path)
    if ray_order(run.sensor.bearings, robot.sensor.bearings) is None:
        raise SensorgraphError(
            f"{name} has other rays than {path} describes "
            f"({bearings_text(run.sensor.bearings, robot.sensor.bearings)}); "
            "give the robot that recorded the run"
        )
    warning = sweep_warning(run, robot, name=str(path))
    if warning is not None:
        typer.echo(f"warning: {name}: {warning}", err=True)
    return with_sweep_of(run, robot)


def with_mount_of(run: Run, path: Path | None) -> Run:
    """Return a run of one laser that sits where a robot file states it, whatever the log's transforms say or lack."""
    from sensorgraph.world.robot import load_robot

    if path is None or run.sensor.is_composite:
        return run
    robot = load_robot(path)
    is_stated = "sensor.mount" in robot.stated
    return replace(run, sensor=replace(run.sensor, mount=robot.sensor.mount)) if is_stated else run


def check_poses(poses: str | None) -> None:
    """Refuse a word that --poses does not know."""
    if poses not in (None, "log", "locate"):
        raise SensorgraphError(
            f"--poses is {poses!r}, expected log (as they are) or locate (from scans and wheels)"
        )


def with_poses(
    run: Run,
    path: Path,
    poses: str | None,
    place: Arena | Sensorgraph | None = None,
    *,
    name: str = "",
    n_scans: int | None = None,
    options: Mapping[str, Any] | None = None,
) -> Run:
    """Return the run as located, where `--poses` asks for it or it has no reference; else the run itself.

    Parameters
    ----------
    place, name : where it is to be located; None: in a place of its own
    n_scans : of the whole run, where `run` is only its start
    options : with which it was read
    """
    import logs
    from sensorgraph.cli.progress import progress
    from sensorgraph.localization.kept import kept_beside, located, needs_locating

    if not needs_locating(run, run.n_scans if n_scans is None else n_scans, poses):
        return run
    settings = options or {}
    if n_scans is not None and n_scans != run.n_scans:
        run = replace(logs.read(path, **settings), sensor=run.sensor)
    why = "as asked" if poses == "locate" else "it has no reference"
    where = f"in {name}" if place is not None else "in a map of its own"
    typer.echo(
        f"{path.name}: {why}: located {where} from scans and wheels (--poses log takes the log's poses)"
    )
    found = located(path, run, place, name=name, options={**settings, **_ray_times(run)}, progress=progress)
    for line in found.lines:
        typer.echo(f"  {line}")
    if found.path is not None:
        typer.echo(f"  {'kept as' if found.lines else 'taken from'} {kept_beside(path)}")
    return found.run


def with_poses_of_graph(
    run: Run, path: Path, poses: str | None, graph: Sensorgraph, graph_name: str, options: Mapping[str, Any]
) -> Run:
    """Return the run as located in a graph, or as it was located when the graph was built from it."""
    from sensorgraph.localization.kept import kept_own, needs_locating

    if not needs_locating(run, run.n_scans, poses):
        return run
    if any(entry.get("name") == path.name for entry in graph.origin.get("inputs", ())):
        own = kept_own(path, {**options, **_ray_times(run)})
        if own is not None:
            typer.echo(f"{path.name}: poses as located when {graph_name} was built from it")
            return own
    return with_poses(run, path, poses, graph, name=graph_name, options=options)


def _ray_times(run: Run) -> dict[str, Any]:
    """Return what a log or a robot file says of the times of rays: a run located without it was located otherwise."""
    from logs.run import rare_times

    return (
        {"sweep_time": run.sensor.sweep_time, **rare_times(run.sensor)} if run.sensor.has_ray_delays else {}
    )


def say_ray_order(name: str, bearings: Floats, other_name: str, other: Floats) -> None:
    """Say in one line where a log numbers the same rays (n_rays,) otherwise than a graph or a robot does."""
    from sensorgraph.world.ray_order import ray_order_line

    line = ray_order_line(bearings, other, other_name)
    if line:
        typer.echo(f"{name}: {line}")


def say_log_notes(*runs: Run) -> None:
    """Say what was taken for granted of logs, beside the result: an error before stays one line."""
    from sensorgraph.intake import log_notes

    say_warnings(log_notes(*runs))


def say_warnings(notes: Sequence[str]) -> None:
    """Say what was taken for granted, a line each."""
    for note in notes:
        typer.echo(f"warning: {with_flags(note)}", err=True)


def write_json(path: Path, data: Any) -> None:
    """Write JSON under a temporary name, then rename; a number that is not finite is refused."""
    import json

    with atomic_file(path) as part:
        part.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n")


def parse_pose(text: str, option: str = "--start") -> Floats:
    """Read `--start X,Y,PHI`; (3,) [m, m, rad]."""
    import numpy as np

    try:
        pose = np.array([float(part) for part in text.split(",")])
    except ValueError:
        pose = np.zeros(0)
    if pose.shape != (3,) or not np.isfinite(pose).all():
        raise SensorgraphError(f"{option} is {text!r}, expected X,Y,PHI such as 1.0,2.0,0.5")
    return pose
