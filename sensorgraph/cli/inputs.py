"""What several commands read: arenas, topics, poses; every mistake becomes one line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any

import typer

from sensorgraph.errors import SensorgraphError
from sensorgraph.files import atomic_file

if TYPE_CHECKING:
    from logs.run import Run
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
    from sensorgraph.loading import sweep_warning, with_sweep_of
    from sensorgraph.world.ray_order import bearings_text, ray_order
    from sensorgraph.world.robot import load_robot

    if path is None:
        return run
    robot = load_robot(path)
    if ray_order(run.sensor.bearings, robot.sensor.bearings) is None:
        raise SensorgraphError(
            f"{name} has {run.sensor.n_rays} rays, {path} describes {robot.sensor.n_rays} or other bearings "
            f"({bearings_text(run.sensor.bearings, robot.sensor.bearings)}); "
            "give the robot that recorded the run"
        )
    warning = sweep_warning(run, robot, name=str(path))
    if warning is not None:
        typer.echo(f"warning: {name}: {warning}: that of the robot was taken", err=True)
    return with_sweep_of(run, robot)


def say_ray_order(name: str, bearings: Floats, other_name: str, other: Floats) -> None:
    """Say in one line where a log numbers the same rays (n_rays,) otherwise than a graph or a robot does."""
    from sensorgraph.world.ray_order import ray_order_line

    line = ray_order_line(bearings, other, other_name)
    if line:
        typer.echo(f"{name}: {line}")


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
