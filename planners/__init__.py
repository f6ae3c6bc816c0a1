"""Where to drive so that (x, y, phi) is filled; knows no sensor, no log and no model.

`plan(arena, robot)` plans with one of `PLANNERS`; `planners.maps.load(path)` reads the arena.
"""

from __future__ import annotations

from planners.errors import PlanError
from planners.planning import PLANNERS, Plan, plan

__all__ = ["PLANNERS", "Plan", "PlanError", "plan"]
