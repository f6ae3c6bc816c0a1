"""Arena <- ROS map_server maps (yaml + pgm or png)."""

from __future__ import annotations

from pathlib import Path

from planners.arena import Arena
from planners.errors import PlanError


def read(path: Path) -> Arena:
    """Read a map_server map."""
    raise PlanError(f"{path}: not read yet")
