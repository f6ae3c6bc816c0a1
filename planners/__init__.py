"""Plan drives that cover the reachable (x, y, phi) bins; independent of sensors, logs and models.

`plan(arena, vehicle)` plans with one of `PLANNERS`; `planners.maps.load(path)` reads the arena.

`planning` checks the arguments, makes a `task.Task`, runs a planner, and measures the result.
`ompl_frame` poses the task as an OMPL problem and runs the planner as an `ob.Planner`.
`methods` contains the planners; each returns a `task.PlannedDrive`.
`search` and `cars` search rooms over motion primitives and plan arc paths of cars.
`joins` finds paths between the parts of a drive.
`sections` and `battery` cut a drive to a time budget or to battery runs.
`report`, `check` and `holes` give coverage, constraint violations, and uncovered bins.
`export` writes waypoints and commands for other software.
`ompl_planner` offers the planners as planners of OMPL, for its benchmark.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from planners.errors import PlanError

if TYPE_CHECKING:
    from planners.planning import PLANNERS, Plan, plan

__all__ = ["PLANNERS", "Plan", "PlanError", "plan"]


def __getattr__(name: str) -> Any:
    """Import the planning modules on first use, so that OMPL's worker processes start without them."""
    if name in __all__:
        from planners import planning

        return getattr(planning, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
