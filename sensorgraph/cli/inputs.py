"""Read and check what several commands share: runs, robots, poses, outputs; each error is one line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any

import typer

from logs.files import atomic_file
from sensorgraph.cli.messages import print_warnings
from sensorgraph.errors import SensorgraphError

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from logs.run import Run
    from planners.arena import Arena
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.types import Floats, Progress, ProgressBars
    from sensorgraph.world.robot import Robot


def check_output(path: Path, *inputs: Path | None, suffix: str | None = None) -> None:
    """Refuse an output path that cannot be written, is one of the given inputs or lacks its suffix, before any work is done."""
    if path.is_dir():
        raise SensorgraphError(f"{path} is a folder; give the name of a file to write")
    if not path.parent.is_dir():
        raise SensorgraphError(
            f"the folder {path.parent} does not exist; create it or write to another folder"
        )
    for given in inputs:
        if given is not None and path.exists() and given.exists() and path.samefile(given):
            raise SensorgraphError(
                f"{path} is also the input and would be overwritten; write to another file"
            )
    if suffix is not None and path.suffix != suffix:
        raise SensorgraphError(
            f"{path}: the file is written as *{suffix}; name it {path.with_suffix(suffix).name}"
        )
    _probe(path.parent, path)


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be created or written to, before any work is done; the folder is not created here."""
    nearest = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not nearest.is_dir():
        raise SensorgraphError(f"{nearest} is a file; give the name of a folder")
    _probe(nearest, folder)


def check_runs(runs: Sequence[Path]) -> None:
    """Refuse a run that is given twice, because its scans would count twice."""
    known: dict[tuple[int, int], Path] = {}
    for path in (path for path in runs if path.exists()):
        stat = path.stat()
        if (stat.st_dev, stat.st_ino) in known:
            raise SensorgraphError(
                f"{path} is given twice and its scans would count twice; give each run once"
            )
        known[stat.st_dev, stat.st_ino] = path


def _probe(folder: Path, output: Path) -> None:
    """Raise if a folder cannot be written to."""
    try:
        TemporaryFile(dir=folder).close()
    except OSError as exc:
        raise OSError(exc.errno, exc.strerror, str(output)) from exc


def read_options(
    topics: Sequence[str] | None, no_return: str | None, robot: Path | None, heights: str | None
) -> dict[str, Any]:
    """Return the options of `logs.read` for --topic, --no-return, --robot and --slice of a command."""
    from logs import parse_topics

    roles = parse_topics(topics or [])
    return {"topics": roles, "no_return": no_return, "mounts": _mounts_of(robot), **_parse_slice(heights)}


def read_run(
    path: Path, reading: Mapping[str, Any], robot: Path | None = None, *, name: str | None = None
) -> Run:
    """Read a log with a progress bar, and with what the robot states; `reading` is from `read_options`.

    Parameters
    ----------
    name : Name of the log in messages; by default its path.
    """
    from logs import read
    from sensorgraph.cli.progress import reading_bar

    with reading_bar() as tick:
        run = read(path, **reading, progress=tick)
    return with_robot(run, name or str(path), robot)


def _mounts_of(robot: Path | None) -> Mapping[str, Floats]:
    """Return the mount of each named sensor of a robot.yaml, for logs without transforms."""
    from sensorgraph.world.robot import load_robot

    return {} if robot is None else load_robot(robot).mounts


def _parse_slice(text: str | None) -> dict[str, tuple[float, float]]:
    """Return the option of `read` for Z0,Z1 of --slice; empty if it is not given."""
    if text is None:
        return {}
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise SensorgraphError(f"--slice is {text!r}, expected Z0,Z1 in metres such as 0.1,0.5") from None
    return {"slice": (low, high)}


def with_robot(run: Run, name: str, robot: Robot | Path | None, robot_name: str | None = None) -> Run:
    """Return a run with the ray times and the mount that a robot states; without a robot, the run.

    Parameters
    ----------
    name, robot_name : Names for messages; the robot's is by default its path.

    Raises
    ------
    SensorgraphError : The robot states other rays than those of the run.
    """
    from sensorgraph.world.described import with_robot as as_stated
    from sensorgraph.world.robot import load_robot
    from sensorgraph.world.sweep import sweep_warning

    if robot is None:
        return run
    machine, described = (load_robot(robot) if isinstance(robot, Path) else robot), robot_name or str(robot)
    stated = as_stated(run, machine, name=name, robot_name=described)
    warning = sweep_warning(run, machine, name=described)
    if warning is not None:
        typer.echo(f"warning: {name}: {warning}", err=True)
    return stated


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
    """Return the located run if `--poses locate` is given or it has no reference poses, else the run itself.

    Parameters
    ----------
    place, name : Arena or graph to locate the run in, with its name. None: a new map.
    n_scans : Number of scans of the whole run, if `run` is only its start.
    options : Options with which the run was read.
    """
    import logs
    from sensorgraph.cli.progress import progress
    from sensorgraph.localization.kept import kept_beside, located, needs_locating

    if not needs_locating(run, run.n_scans if n_scans is None else n_scans, poses):
        return run
    settings = {**(options or {}), **_stated(run)}
    if n_scans is not None:  # the start may hold all scans, but not all odometry
        whole, sensor = logs.read(path, **(options or {})), run.sensor
        later = sensor.ray_0_after_first - whole.sensor.ray_0_after_first
        run = replace(whole, sensor=sensor, stamps=whole.stamps + later, meta={**run.meta, **whole.meta})
    why = "--poses locate" if poses == "locate" else "no reference poses"
    where = f"in {name}" if place is not None else "in a new map"
    typer.echo(
        f"{path.name}: {why}: locating {where} from scans and wheels (--poses log uses the poses in the log)"
    )
    found = located(path, run, place, name=name, options=settings, progress=noted(progress, run))
    for line in found.lines:
        typer.echo(f"  {line}")
    if found.path is not None:
        typer.echo(f"  {'saved to' if found.lines else 'read from'} {kept_beside(path)}")
    return found.run


def with_poses_of_graph(
    run: Run, path: Path, poses: str | None, graph: Sensorgraph, graph_name: str, options: Mapping[str, Any]
) -> Run:
    """Return the run located in a graph, or with the poses from which the graph was built."""
    from sensorgraph.localization.kept import kept_own, needs_locating

    if not needs_locating(run, run.n_scans, poses):
        return run
    if any(entry.get("name") == path.name for entry in graph.origin.get("inputs", ())):
        own = kept_own(path, {**options, **_stated(run)})
        if own is not None:
            typer.echo(f"{path.name}: using the poses from which {graph_name} was built")
            return own
    return with_poses(run, path, poses, graph, name=graph_name, options=options)


def _stated(run: Run) -> dict[str, Any]:
    """Return ray times, and what a robot file states, which are part of the key of a kept located run."""
    from logs.run import rare_times
    from sensorgraph.world.described import MOUNT
    from sensorgraph.world.sweep import RAY_TIMES

    sensor = run.sensor
    times = {"sweep_time": sensor.sweep_time, **rare_times(sensor)} if sensor.has_ray_delays else {}
    stated = {key: run.meta[key] for key in (RAY_TIMES, MOUNT) if key in run.meta}
    return {**times, **stated, **({"laser": sensor.mount.tolist()} if MOUNT in stated else {})}


def print_ray_order(name: str, bearings: Floats, other_name: str, other: Floats) -> None:
    """Print one line if a log numbers the same rays (n_rays,) differently from a graph or a robot."""
    from sensorgraph.world.ray_order import ray_order_line

    line = ray_order_line(bearings, other, other_name)
    if line:
        typer.echo(f"{name}: {line}")


def print_log_notes(*runs: Run) -> None:
    """Print the notes on assumed and repaired data of runs that this command has not printed yet."""
    from sensorgraph.intake import log_notes

    print_warnings(log_notes(*runs))


def noted(progress: ProgressBars, *runs: Run) -> ProgressBars:
    """Return stages of which the first begins with the notes on runs: an error of a check before stays one line."""
    from sensorgraph.intake import log_notes

    notes = log_notes(*runs)  # without the runs, which may be large

    def stage(label: str, unit: str) -> AbstractContextManager[Progress]:
        print_warnings(notes)
        return progress(label, unit)

    return stage


def write_json(path: Path, data: Any) -> None:
    """Write JSON to a temporary file and rename it; refuse numbers that are not finite."""
    import json

    with atomic_file(path) as part:
        part.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n")


def parse_pose(text: str, option: str = "--start") -> Floats:
    """Parse X,Y,PHI of an option, each in m or rad or with a unit, into a pose (3,) [m, m, rad]."""
    import numpy as np

    from sensorgraph.quantities import is_number, pose_of, split_unit

    parts = text.split(",")
    if len(parts) != 3 or not all(is_number(split_unit(part)[0]) for part in parts):
        raise SensorgraphError(
            f"{option} is {text!r}, expected X,Y,PHI such as 1.0,2.0,0.5 in m, m and rad, or 1.0,2.0,30 deg"
        )
    return np.array(pose_of(parts, option))
