"""The coverage planner, the default of `plan`: search each room by itself, and join the rooms by OMPL.

Robots that turn in place are planned in `coverage_spins`, cars in `coverage_cars`. Rooms do not wait for each other, so
they are searched in parallel (`parallel_search`), with the same result on any count of processors. `stop_and_spin` is the
older planner of robots that turn in place.
"""

from __future__ import annotations

from planners.methods.anytime import plan_anytime
from planners.methods.coverage_cars import plan_cars
from planners.methods.coverage_spins import plan_spins
from planners.task import PlannedDrive, Task


def plan_coverage(task: Task) -> PlannedDrive:
    """Visit every reachable bin that is still missing.

    Raises
    ------
    PlanError : every bin is covered already, or no room can be reached
    KeyboardInterrupt : Ctrl-C came before anything was found
    """
    if task.order == "anytime":
        return plan_anytime(task)
    return plan_spins(task) if task.vehicle.drive == "diff" else plan_cars(task)
