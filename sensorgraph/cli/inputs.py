"""What several commands read: arenas, topics, poses; every mistake becomes one line."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sensorgraph.errors import SensorgraphError
from sensorgraph.files import whole

if TYPE_CHECKING:
    from logs.run import RangeSensor
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
