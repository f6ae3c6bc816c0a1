"""Where to drive so that (x, y, phi) is filled; knows no sensor, no log and no model.

`plan(arena, vehicle)` plans with one of `PLANNERS`; `planners.maps.load(path)` reads the arena.

`planning` makes a `task.Task`, and OMPL (`ompl_frame`) runs a planner of `methods` on it. That planner searches rooms (`search`, `cars`), joins
them (`joins`), and answers with a `task.PlannedDrive`. `sections` and `battery` cut the drive to the time there is;
`report`, `check` and `holes` measure it; `export` writes it for others. `ompl_planner` is the whole as a planner of OMPL.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from planners.errors import PlanError

if TYPE_CHECKING:
    from planners.planning import PLANNERS, Plan, plan

__all__ = ["PLANNERS", "Plan", "PlanError", "plan"]


def __getattr__(name: str) -> Any:
    """Import what plans when it is asked for: the processes in which OMPL works start without it."""
    if name in __all__:
        from planners import planning

        return getattr(planning, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
