"""Drive controllers one after another in the same arena or identified world, for a comparison of their drives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from logs.run import Run
from planners.arena import Arena
from planners.trajectory import Trajectory
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.recording.controllers import CONTROLLERS, controller_label
from sensorgraph.recording.identified_world import (
    PLAN_CONTROLLER,
    ArenaWorld,
    IdentifiedWorld,
    record_in_world,
)
from sensorgraph.types import Floats, ProgressBars, no_progress
from sensorgraph.world.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosedLoopDrive:
    """Drive of one controller."""

    label: str
    run: Run
    n_rays: int | None
    """Number of rays drawn in the identified world; None: driven in an arena."""
    n_unanswered: int | None
    """Number of these rays that the sensorgraph does not answer; they are drawn nevertheless."""


def files_of_controllers(controllers: Sequence[str], path: Path) -> dict[str, Path]:
    """Return the file of each controller's run: `path` for the first, and next to it one per label for the others.

    Parameters
    ----------
    controllers : Each `plan`, one of CONTROLLERS, or a MODEL.json of `identify`.

    Raises
    ------
    SensorgraphError : A controller is unknown or given twice, or two share a label.
    """
    known = (PLAN_CONTROLLER, *CONTROLLERS)
    for name in controllers:
        if (name not in known and not name.endswith(".json")) or controllers.count(name) > 1:
            raise SensorgraphError(
                f"controller is {name!r}, expected {', '.join(known)}, or a MODEL.json, each at most once"
            )
    labels = [controller_label(name) for name in controllers]
    if len(set(labels)) < len(labels):
        raise SensorgraphError(
            f"controllers {', '.join(controllers)} share a file name; rename one of the files"
        )
    return {
        name: path if i == 0 else path.with_suffix(f".{label}.mcap")
        for i, (name, label) in enumerate(zip(controllers, labels, strict=True))
    }


def drive_closed_loop(
    files: Mapping[str, Path],
    trajectory: Trajectory,
    arena: Arena,
    robot: Robot,
    *,
    start: Floats | None = None,
    graph: Sensorgraph | None = None,
    graph_name: str = "",
    seed: int = 0,
    progress: ProgressBars = no_progress,
) -> Iterator[ClosedLoopDrive]:
    """Let each controller drive for the duration of a plan; all have the same start and the same noise.

    Parameters
    ----------
    files : Controller -> run to write, as returned by `files_of_controllers`.
    arena : Walls that stop the robot's body.
    start : (3,) [m, m, rad] Start pose; None: the start of the plan.
    graph : Sensorgraph from which readings are drawn; None: cast in the arena.
    graph_name : Name of the graph in the metadata of the runs.

    Raises
    ------
    SensorgraphError : A start is given for the controller `plan`.
    """
    if start is not None and PLAN_CONTROLLER in files:
        raise SensorgraphError(
            "`start` is given for the controller plan, which starts where the plan starts; leave out one of them"
        )
    for name, file in files.items():
        world = ArenaWorld(arena, robot, seed) if graph is None else IdentifiedWorld(graph, robot, seed)
        run = record_in_world(
            file, world, arena, robot, trajectory, name, start=start, name=graph_name, progress=progress
        )
        yield ClosedLoopDrive(
            label=controller_label(name),
            run=run,
            n_rays=world.n_rays if isinstance(world, IdentifiedWorld) else None,
            n_unanswered=world.unanswered if isinstance(world, IdentifiedWorld) else None,
        )
