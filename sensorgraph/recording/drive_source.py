"""Source of a drive: the trajectory of a plan, or the commands of a run to replay."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

import logs
from logs.run import Run
from planners.arena import Arena
from planners.maps import MAPS, load
from planners.trajectory import Trajectory, read_csv
from planners.types import SAME_PLACE
from sensorgraph.errors import SensorgraphError
from sensorgraph.loading import arena_in, read_plan_report, robot_in
from sensorgraph.planning.plan import CoveragePlan
from sensorgraph.recording.record import Commands
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot, load_robot
from sensorgraph.world.wall_distance import WallDistance


@dataclass(frozen=True, kw_only=True, eq=False)
class DriveSource:
    """A drive read from a file, with the arena and robot stored next to it or in the run."""

    path: Path
    way: Trajectory | Commands
    run: Run | None = None
    """Run whose commands are replayed."""

    @property
    def start(self) -> Floats:
        """(3,) [m, m, rad] Start of the drive."""
        return start_of(self.way)

    def arena(self) -> Arena | None:
        """Return the arena of the plan or the run; None if neither folder nor run contains one."""
        if self.run is not None:
            return arena_in(self.run)
        kept = self._kept("arena.geojson")
        return None if kept is None else load(kept)

    def robot(self) -> Robot | None:
        """Return the robot of the plan or the run; None if neither folder nor run contains one."""
        if self.run is not None:
            return robot_in(self.run)
        kept = self._kept("robot.yaml")
        return None if kept is None else load_robot(kept)

    def mismatch(self, *, arena: Arena | None = None, robot: Robot | None = None) -> list[str]:
        """Return a line each if the arena and the robot differ from those of the drive."""
        out = []
        planned = None if arena is None else self.arena()
        if arena is not None and planned is not None and not is_same_arena(planned, arena):
            out.append(f"{self.path} was planned for another arena")
        machine = None if robot is None else self.robot()
        differing = [] if robot is None or machine is None else differing_keys(machine, robot)
        if differing:
            out.append(f"{self.path} was planned for another robot: {', '.join(differing)} differ")
        return out

    def _kept(self, name: str) -> Path | None:
        """Return the path of a file of the plan; for a run of a battery it may be one folder up."""
        folder = self.path if self.path.is_dir() else self.path.parent
        places = [folder, folder.parent] if folder.name.startswith("run_") else [folder]
        return next((place / name for place in places if (place / name).is_file()), None)

    def attachments(self) -> dict[str, bytes]:
        """Return plan.json as an attachment for a run.

        Raises
        ------
        SensorgraphError : plan.json is not JSON.
        """
        path = self.path / "plan.json" if self.path.is_dir() else self.path.with_name("plan.json")
        if not isinstance(self.way, Trajectory) or not path.is_file():
            return {}
        return kept_plan(read_plan_report(path))


def kept_plan(report: Mapping[str, Any]) -> dict[str, bytes]:
    """Return plan.json as an attachment, without the planning time: the same seed gives the same bytes."""
    kept = {key: value for key, value in report.items() if key != "planning_s"}
    return {"plan.json": (json.dumps(kept, indent=1) + "\n").encode()}


def start_of(way: Trajectory | Commands) -> Floats:
    """Return the start (3,) [m, m, rad] of a drive."""
    return way.poses[0] if isinstance(way, Trajectory) else way.start


def parts_of(
    drive: CoveragePlan | Trajectory | Path | str,
) -> tuple[Trajectory | Commands, Arena | None, Robot | None, dict[str, bytes]]:
    """Return the trajectory or commands, their arena and robot if known, and the attachments of the run."""
    if isinstance(drive, CoveragePlan):
        return drive.trajectory, drive.arena, drive.robot, kept_plan(drive.to_dict())
    if isinstance(drive, Trajectory):
        return drive, None, None, {}
    source = open_drive(Path(drive))
    return source.way, source.arena(), source.robot(), source.attachments()


def open_drive(path: Path, *, start: Floats | None = None) -> DriveSource:
    """Open a plan's folder, its trajectory.csv, or a run whose commands are replayed.

    Parameters
    ----------
    start : (3,) [m, m, rad] Start of a replay; None: the first pose of the run.

    Raises
    ------
    SensorgraphError : The file does not exist, the run has no commands or no pose, or a plan is given a
        start.
    """
    trajectory = _trajectory(path)
    if trajectory is not None:
        if start is not None:
            raise SensorgraphError(
                "`start` is given for a plan, which has its own start; use it only for a replay of commands"
            )
        return DriveSource(path=path, way=trajectory)
    if not path.exists():
        raise SensorgraphError(
            f"{path} does not exist; expected a plan's folder (from `sensorgraph plan`) or a run"
        )
    if path.suffix.lower() in MAPS:
        raise SensorgraphError(
            f"{path} is an arena or a robot, expected a plan's folder (from `sensorgraph plan`), its trajectory.csv or a run"
        )
    run = logs.read(path)
    if len(run.cmd_stamps) < 2:
        raise SensorgraphError(
            f"{path} has {len(run.cmd_stamps)} commands, expected a plan, or a run with /cmd_vel"
        )
    if start is None:
        if not len(run.poses):
            raise SensorgraphError("the run has no pose to start from; give `start` X,Y,PHI")
        start = np.asarray(run.poses[0])
    way = Commands(stamps=run.cmd_stamps, twists=run.commands, start=start)
    return DriveSource(path=path, way=way, run=run)


def _trajectory(path: Path) -> Trajectory | None:
    inside = path / "trajectory.csv"
    if path.is_dir() and inside.is_file():
        return read_csv(inside)
    return read_csv(path) if path.suffix.lower() == ".csv" else None


def check_start(pose: Floats, arena: Arena, robot: Robot, *, arena_name: str = "the arena") -> None:
    """Check that the robot is clear of walls at the start (3,) of a drive.

    Raises
    ------
    SensorgraphError : It is not.
    """
    distance = float(WallDistance(arena)(float(pose[0]), float(pose[1])))
    if distance < robot.footprint_radius:
        raise SensorgraphError(
            f"the start ({pose[0]:.2f}, {pose[1]:.2f}) is {distance:.2f} m from a wall of {arena_name}, less than the "
            f"footprint_radius of {robot.footprint_radius} m; check that this is the arena of the plan"
        )


def is_same_arena(a: Arena, b: Arena) -> bool:
    """Tell whether two arenas have the same walls."""
    return a.walls.shape == b.walls.shape and bool(abs(a.walls - b.walls).max(initial=0.0) <= SAME_PLACE)


def differing_keys(a: Robot, b: Robot) -> list[str]:
    """Return the keys of robot.yaml that differ between two robots, except names and comments."""
    return _differing(a, b, "", skip=("name", "text", "mounts", "stated"))


def _differing(a: Any, b: Any, where: str, skip: tuple[str, ...] = ()) -> list[str]:
    out = []
    for f in fields(a):
        mine, other = getattr(a, f.name), getattr(b, f.name)
        if f.name in skip:
            continue
        if is_dataclass(mine):
            out += _differing(mine, other, f"{where}{f.name}.")
        elif not np.array_equal(mine, other):
            out.append(f"{where}{f.name}")
    return out
