"""Drive the simulated robot, scan, and write the run; used by `record` and `demo`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import logs
from logs.run import Run
from planners.arena import Arena
from planners.trajectory import Trajectory
from sensorgraph.effects import Amendment
from sensorgraph.effects.effects_file import check_places, dumps
from sensorgraph.loading import attachments_of
from sensorgraph.types import Floats, ProgressBars, no_progress
from sensorgraph.world.drive import ExecutedDrive, follow, replay
from sensorgraph.world.drivetrain import Drivetrain
from sensorgraph.world.robot import Robot
from sensorgraph.world.simulate import occupancy_map, simulate
from sensorgraph.world.wall_distance import WallDistance


@dataclass(frozen=True, kw_only=True, eq=False)
class Commands:
    """Commands for an open-loop drive."""

    stamps: Floats
    """(n,) [s]"""
    twists: Floats
    """(n, 2) [m/s, rad/s] Each holds until the next."""
    start: Floats
    """(3,) [m, m, rad] Pose in map."""


def record(
    path: Path | None,
    arena: Arena,
    robot: Robot,
    way: Trajectory | Commands,
    *,
    effects: Sequence[Amendment] = (),
    seed: int = 0,
    attachments: Mapping[str, bytes] | None = None,
    progress: ProgressBars = no_progress,
) -> Run:
    """Drive along a trajectory or by commands, and return the run; the same seed gives the same bytes.

    Parameters
    ----------
    path : MCAP file to write; None: no file.
    effects : Deviations of robot, sensor and room from robot.yaml and map. The run stores them as
        `effects.yaml`, next to arena and robot.
    """
    check_places(effects, arena)
    rng = np.random.default_rng(seed)
    drivetrain = Drivetrain.of(robot, (a for a in effects if a.effect.channel != "scan"))
    clearance = WallDistance(arena)
    with progress("driving", "commands") as tick:
        driven: ExecutedDrive
        if isinstance(way, Trajectory):
            driven = follow(way, robot, clearance=clearance, rng=rng, drivetrain=drivetrain, progress=tick)
        else:
            driven = replay(
                way.stamps,
                way.twists,
                way.start,
                robot,
                clearance=clearance,
                drivetrain=drivetrain,
                progress=tick,
            )
    kept = attachments_of(arena, robot)
    meta = {"simulated": "true", "seed": str(seed), "contacts": str(driven.contacts)}
    if effects:
        kept["effects.yaml"] = dumps(effects).encode()
        meta["effects"] = ", ".join(a.name for a in effects)
    with progress("scanning", "scans") as tick:
        run = simulate(
            driven,
            arena,
            robot,
            rng=rng,
            effects=[a for a in effects if a.effect.channel == "scan"],
            seed=seed,
            drivetrain=drivetrain,
            meta=meta,
            attachments={**kept, **(attachments or {})},
            progress=tick,
        )
    if path is not None:
        with progress("writing", "messages") as tick:
            logs.write(run, path, occupancy=occupancy_map(arena), progress=tick)
    return run
