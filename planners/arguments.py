"""Check the arguments of `planning.plan`; each error is one line."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from importlib import import_module

import numpy as np

from planners.errors import PlanError
from planners.joins.ompl_process import JOIN_PLANNERS
from planners.task import ORDERS
from planners.types import Floats
from planners.vehicle import Vehicle


@dataclass(frozen=True, kw_only=True, eq=False)
class DriveEnds:
    """Start and end poses of a drive, and its time limits."""

    start: Floats | None
    """(3,) [m, m, rad]; the dock if there is a battery."""
    end: Floats | None
    budget: float | None
    """[s]"""
    battery: float | None
    """[s]"""
    is_dock: bool
    """Whether the start is a dock."""

    @classmethod
    def of(
        cls,
        *,
        start: Floats | None,
        end: Floats | None,
        dock: Floats | None,
        budget: float | None,
        battery: float | None,
    ) -> DriveEnds:
        """Check the times and poses, and return them.

        Raises
        ------
        PlanError : A time is not positive, or the poses contradict each other.
        """
        start, end, dock = _pose("start", start), _pose("end", end), _pose("dock", dock)
        for name, value in (("budget", budget), ("battery", battery)):
            if value is not None and not (np.isfinite(value) and value > 0):
                raise PlanError(f"{name} is {value}, expected a positive number")
        if dock is not None and battery is None:
            raise PlanError("a dock needs a battery; give `battery` too, or use `start` and `end` instead")
        if battery is not None and (end is not None or budget is not None):
            raise PlanError(
                "every run on a battery ends at the dock; leave out `end` and `budget`, and drive as many runs "
                "as time allows: the coverage after each run is in the report"
            )
        if dock is not None and start is not None and not np.allclose(start, dock):
            raise PlanError("every run on a battery starts at the dock; leave out `start` or `dock`")
        return cls(
            start=start if dock is None else dock,
            end=end,
            budget=budget,
            battery=battery,
            is_dock=dock is not None,
        )


def check_planner(
    planner: str,
    known: Collection[str],
    order: str,
    vehicle: Vehicle,
    *,
    has_duration: bool,
    has_targets: bool,
) -> None:
    """Reject an unknown planner, and arguments that do not apply to it."""
    if order not in ORDERS:
        raise PlanError(f"order {order!r} is unknown; expected one of {', '.join(ORDERS)}")
    if order != "fast" and planner != "coverage":
        raise PlanError(f"order {order} needs the planner coverage; the planner is {planner}")
    if order != "fast" and vehicle.drive != "diff":
        raise PlanError(
            f"order {order} needs turns on the spot, which drive {vehicle.drive!r} cannot do; use order fast"
        )
    if planner not in known:
        raise PlanError(f"planner {planner!r} is unknown; expected one of {', '.join(known)}")
    if has_duration and planner in ("coverage", "stop_and_spin", "views"):
        raise PlanError(f"planner {planner} ends when all bins are visited; duration is for the baselines")
    if has_targets != (planner == "views"):
        raise PlanError(f"the planner views needs targets, and only that planner; the planner is {planner}")


def check_join_planner(name: str) -> str:
    """Check that OMPL has the planner, or that a custom one can be imported and called; return its name."""
    module, _, kind = name.rpartition(":")
    if not module:
        if name not in JOIN_PLANNERS:
            raise PlanError(
                f"join planner {name!r} is unknown; expected module:Class or one of {', '.join(JOIN_PLANNERS)}"
            )
        return name
    try:
        imported = import_module(module)
    except Exception as exc:
        is_absent = isinstance(exc, ModuleNotFoundError) and module.startswith(str(exc.name))
        advice = "put its folder on PYTHONPATH" if is_absent else "fix the error in its module"
        raise PlanError(
            f"join planner {name!r} cannot be imported ({type(exc).__name__}: {exc}); {advice}"
        ) from exc
    if not hasattr(imported, kind):
        raise PlanError(f"join planner {name!r}: module {module} has no {kind!r}; give the name of its class")
    own = getattr(imported, kind)
    if not callable(own):
        raise PlanError(f"join planner {name!r} is not a class; expected one that takes a SpaceInformation")
    return name


def check_numbers(
    *, cell: float, rate: float, headings: int, seed: int, margin: float, duration: float | None
) -> None:
    for name, value in (("cell", cell), ("rate", rate), ("duration", 1.0 if duration is None else duration)):
        if not (np.isfinite(value) and value > 0):
            raise PlanError(f"{name} is {value}, expected a positive number")
    if not 1 <= headings <= 3600 or headings != int(headings):
        raise PlanError(f"headings is {headings}, expected a whole number from 1 to 3600")
    if seed < 0:
        raise PlanError(f"seed is {seed}, expected 0 or more")
    if not (np.isfinite(margin) and margin >= 0):
        raise PlanError(f"margin is {margin}, expected 0 or more")


def _pose(name: str, pose: Floats | None) -> Floats | None:
    if pose is None:
        return None
    pose = np.asarray(pose, dtype=np.float64)
    if pose.shape != (3,) or not np.isfinite(pose).all():
        raise PlanError(f"{name} is {pose.tolist()}, expected three finite numbers x, y, phi")
    return pose
