"""What several commands read: arenas, topics, poses; every mistake becomes one line."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sensorgraph.errors import SensorgraphError
from sensorgraph.files import whole

if TYPE_CHECKING:
    from logs.run import RangeSensor, Run
    from planners.arena import Arena
    from sensorgraph.types import Floats
    from sensorgraph.world.robot import Robot


def check_output(path: Path, *inputs: Path) -> None:
    """Refuse an output path that cannot be written, or is one of the inputs, before any work is done."""
    if path.is_dir():
        raise SensorgraphError(f"{path} is a folder; give the name of a file to write")
    if not path.parent.is_dir():
        raise SensorgraphError(f"the folder {path.parent} does not exist; make it first, or write elsewhere")
    for given in inputs:
        if path.exists() and given.exists() and path.samefile(given):
            raise SensorgraphError(f"{path} is the input itself and would be lost; write to another name")
    probe = path.with_name(path.name + ".part")
    if not probe.exists():
        probe.open("wb").close()  # says now, not after the work, that the folder cannot be written
        probe.unlink()


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be written in, before any work is done; make it if it is not there."""
    if folder.exists() and not folder.is_dir():
        raise SensorgraphError(f"{folder} is a file; give the name of a folder")
    folder.mkdir(parents=True, exist_ok=True)
    probe = folder / ".part"
    probe.open("wb").close()
    probe.unlink()


def read_robot_sensor(path: Path, sensors: Sequence[tuple[str, RangeSensor]]) -> None:
    """Check that a robot file describes the sensor that recorded."""
    from sensorgraph.building.build import is_same_sensor
    from sensorgraph.world.robot import load_robot

    described = load_robot(path).sensor
    for name, sensor in sensors:
        if not is_same_sensor(sensor.bearings, described.bearings):
            raise SensorgraphError(
                f"{name} has {sensor.n_rays} rays, {path} describes {described.n_rays} or other bearings; "
                "give the robot that recorded the run"
            )


def read_poses(path: Path) -> Floats:
    """Read columns x, y, phi of a CSV file; (n_poses, 3) [m, m, rad]."""
    import numpy as np

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
                try:
                    rows.append([float(row[name]) for name in ("x", "y", "phi")])
                except (TypeError, ValueError):
                    raise SensorgraphError(
                        f"{path}: line {reader.line_num}: cannot read numbers in {list(row.values())}; "
                        "expected x,y,phi"
                    ) from None
    except (UnicodeDecodeError, csv.Error) as exc:
        raise SensorgraphError(f"{path}: not a CSV file ({exc}); expected a header line x,y,phi") from exc
    poses = np.array(rows, dtype=np.float64).reshape(-1, 3)
    if len(poses) == 0:
        raise SensorgraphError(f"{path}: no pose below the header; expected lines of x,y,phi")
    if not np.isfinite(poses).all():
        line = 2 + int(np.flatnonzero(~np.isfinite(poses).all(axis=1))[0])
        raise SensorgraphError(f"{path}: line {line}: a number is not finite; leave such poses out")
    return poses


def write_json(path: Path, data: Any) -> None:
    """Write JSON under a temporary name, then rename; a number that is not finite is refused."""
    import json

    with whole(path) as part:
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


def named_arena(name: str) -> Arena:
    """Read an arena from a file, a shipped one by its name, or the one that a sensorgraph of faces holds."""
    from importlib.resources import as_file, files

    from planners import maps

    shipped = sorted(
        p.name.removesuffix(".geojson")
        for p in files("sensorgraph.data").iterdir()
        if p.name.endswith(".geojson")
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
        from sensorgraph.graph import Sensorgraph
        from sensorgraph.world.identified_arena import arena_of

        return arena_of(Sensorgraph.load(Path(name)))
    return maps.load(Path(name))


def named_robot(path: Path | None) -> Robot:
    """Read robot.yaml, or the shipped robot where none is named."""
    from importlib.resources import files

    from sensorgraph.world.robot import load_robot, parse_robot

    if path is None:
        return parse_robot((files("sensorgraph.data") / "radix.yaml").read_text(), name="radix.yaml")
    return load_robot(path)


def kept_robot(run: Run) -> Robot | None:
    """Return the robot kept in a run, if there is one."""
    from sensorgraph.world.robot import parse_robot

    text = run.attachments.get("robot.yaml")
    return None if text is None else parse_robot(text.decode(errors="replace"), name="robot.yaml in the run")


def robot_for(run: Run, path: Path | None) -> Robot:
    """Read robot.yaml; where none is named, the shipped robot with the sensor that the run itself describes."""
    from dataclasses import replace

    from sensorgraph.building.build import is_same_sensor

    robot = named_robot(path)
    if path is None and not is_same_sensor(run.sensor.bearings, robot.sensor.bearings):
        return replace(robot, sensor=replace(run.sensor, height=robot.sensor.height))
    return robot


def kept_arena(run: Run) -> Arena | None:
    """Return the arena kept in a run, if there is one."""
    from planners.errors import PlanError
    from planners.maps import geojson

    text = run.attachments.get("arena.geojson")
    if text is None:
        return None
    try:
        return geojson.loads(text.decode(errors="replace"))
    except PlanError as exc:
        raise SensorgraphError(
            f"the arena kept in the run cannot be used ({exc}); give another with --arena"
        ) from exc
