"""The planners of the registry as planners of OMPL, so that OMPL's Benchmark can compare them with others.

They solve an ordinary problem with a start and a goal. On the path between them, `CoveragePlanner` drives
through every reachable bin (x, y, phi). Nothing else imports this module, and it needs OMPL.

    setup = problem(arena, vehicle, start, goal)
    setup.setPlanner(CoveragePlanner(setup.getSpaceInformation(), arena, vehicle))
    setup.solve(60.0)

`registry_planners` makes all of them. The objective of a problem is the driving time (`DrivingTime`), by
which OMPL's Benchmark compares these planners and custom ones.

OMPL 2.0.1 has three restrictions in Python. A planner must not override `getPlannerData`: its argument cannot
be passed to Python, and the process ends. A planner must take start and goal
from its `PlannerInputStates`, because a state returned by `ProblemDefinition` is freed together with its
Python object. The option `simplify` must be off, or OMPL shortens the drive.
"""

from __future__ import annotations

import logging
from typing import Any

from planners.arena import Arena
from planners.clearance import Barriers
from planners.coverage import CELL, HEADINGS
from planners.errors import PlanError
from planners.joins.ompl_process import INSTALL_HINT
from planners.ompl_frame import FloorChecks, path_of, pose_of, setup_of, state_of, stop_when
from planners.planning import PLANNERS, Plan, plan
from planners.reach import reach
from planners.sections import check_pose
from planners.types import Floats
from planners.vehicle import Vehicle

try:
    from ompl import base  # type: ignore[import-untyped]
except ImportError as exc:
    raise PlanError(INSTALL_HINT) from exc

logger = logging.getLogger(__name__)

BASELINE_NAMES = ("random_bounce", "wall_following")


class CoveragePlanner(base.Planner):  # type: ignore[misc]  # ompl has no types that mypy can follow
    """OMPL planner that drives from start to goal by a planner of the registry; default: through every bin."""

    def __init__(
        self,
        information: Any,
        arena: Arena,
        vehicle: Vehicle,
        *,
        planner: str = "coverage",
        cell: float = CELL,
        headings: int = HEADINGS,
        seed: int = 0,
        **options: Any,
    ) -> None:
        """Wrap a planner of the registry.

        Parameters
        ----------
        planner : One of `planners.PLANNERS`.
        cell : [m] Side of a position cell; `headings`: number of heading bins.
        options : Further arguments of `planners.plan`.
        """
        name = planner.replace("_", " ").title().replace(" ", "")
        super().__init__(information, name)
        self.name, self.arena, self.vehicle = name, arena, vehicle
        self.planner, self.options = planner, options
        self.cell, self.headings, self.seed = cell, headings, seed
        self.plan: Plan | None = None
        """The last plan, with its coverage and report."""

    def clear(self) -> None:
        """Discard the last plan."""
        super().clear()
        self.plan = None

    def solve(self, condition: Any) -> Any:
        """Plan from the start to the goal until the condition is true; the plan so far is kept.

        An interrupted plan is an approximate solution. It leads to the goal; its difference is the share of
        missed bins.
        """
        status = base.PlannerStatus
        inputs = self.getPlannerInputStates()
        if not inputs.haveMoreStartStates():
            return status(status.INVALID_START)
        start = pose_of(inputs.nextStart())
        if not inputs.haveMoreGoalStates():
            return status(status.INVALID_GOAL)
        goal = pose_of(inputs.nextGoal())
        try:
            self.plan = plan(
                self.arena,
                self.vehicle,
                planner=self.planner,
                start=start,
                end=goal,
                cell=self.cell,
                headings=self.headings,
                seed=self.seed,
                progress=stop_when(condition),
                **self.options,
            )
        except KeyboardInterrupt:
            return status(status.TIMEOUT)
        except PlanError as exc:
            logger.warning("%s", exc)
            return status(status.INFEASIBLE)
        stopped = bool(self.plan.report.get("interrupted", False))
        missed = 1.0 - float(self.plan.report["coverage"])
        path = path_of(self.getSpaceInformation(), self.plan.curve)
        self.getProblemDefinition().addSolutionPath(path, stopped, missed if stopped else 0.0, self.name)
        return status(status.APPROXIMATE_SOLUTION if stopped else status.EXACT_SOLUTION)


def registry_planners(
    information: Any, arena: Arena, vehicle: Vehicle, *, duration: float | None = None, **options: Any
) -> list[CoveragePlanner]:
    """Return the planners of the registry that suit the vehicle, without `views`, which needs targets.

    Parameters
    ----------
    duration : [s] Duration of the baselines; None: the reference time of the coverage planner.
    options : `cell`, `headings`, `seed` and other arguments of `planners.plan`.
    """
    names = [name for name in PLANNERS if name != "views" and (vehicle.drive == "diff" or name == "coverage")]
    made = []
    for name in names:
        own = options | ({"duration": duration} if name in BASELINE_NAMES else {})
        made.append(CoveragePlanner(information, arena, vehicle, planner=name, **own))
    return made


def problem(arena: Arena, vehicle: Vehicle, start: Floats, goal: Floats) -> Any:
    """Return an OMPL SimpleSetup for a drive between two poses (3,), in the robot's state space.

    A state is valid where the robot's rim is free. Planners with a larger margin, such as `CoveragePlanner`,
    keep it.
    """
    barriers = Barriers(arena)
    free = reach(arena, barriers, clearance=vehicle.footprint_radius, cell=CELL, start=start)
    check_pose("goal", goal, arena, barriers, free)  # with an invalid goal, OMPL waits until its time is over
    setup = setup_of(arena.bounds, FloorChecks.of(free, barriers, vehicle), is_certified=False)
    space = setup.getSpaceInformation().getStateSpace()
    setup.setStartAndGoalStates(state_of(space, start), state_of(space, goal))
    return setup
