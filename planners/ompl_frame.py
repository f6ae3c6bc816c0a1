"""OMPL's frame, in which every plan is made: its state space, our checks of states and motions, driving time, a planner.

`drive_in_frame` sets up OMPL's problem for a task and lets a planner of the registry solve it as an `ob.Planner`
(`TaskPlanner`). The drive that it finds is a solution path of OMPL's, which passes OMPL's own `check()`.
Nothing here is imported before something is planned: all else of the package works where OMPL cannot be installed.

Of OMPL 2.0.1: what OMPL calls must not hold anything of OMPL's, or it leaks; an error must not pass through OMPL, so it
is kept and raised again outside; a state that `ProblemDefinition` hands out is freed with the Python object.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from planners.arena import wrap
from planners.clearance import Barriers
from planners.curve import Curve
from planners.errors import PlanError
from planners.joins.ompl_process import INSTALL_HINT
from planners.joins.settings import JOINS
from planners.reach import Reach
from planners.task import PlannedDrive, Task
from planners.types import Floats, Progress
from planners.vehicle import Vehicle

try:
    from ompl import base, geometric, util  # type: ignore[import-untyped]
except ImportError as exc:
    raise PlanError(INSTALL_HINT) from exc

STATE_PERIOD = 0.2
"""[s] between states of a path, at most."""
RADIUS_SLACK = 1e-3
"""Share by which OMPL's curves may be tighter than a car's, which meets states that are rounded."""
HALF_DIAGONAL = 0.5**0.5
"""Of a raster cell, in steps: the farthest that a place is from the nearest node."""


def drive_in_frame(task: Task, method: Callable[[Task], PlannedDrive], name: str) -> PlannedDrive:
    """Let a planner of the registry solve a task as a planner of OMPL.

    Parameters
    ----------
    method : the planner's function
    name : by which OMPL knows it

    Raises
    ------
    What the planner raises: PlanError, KeyboardInterrupt
    """
    level = util.getLogLevel()
    util.setLogLevel(util.LOG_NONE)
    try:
        outcome = _solved(task, method, name)
    finally:
        util.setLogLevel(level)
    if outcome.error is not None:
        if isinstance(outcome.error, PlanError | KeyboardInterrupt):
            raise outcome.error.with_traceback(None)  # whose frames would hold objects of OMPL's
        raise outcome.error
    if outcome.drive is None:
        raise PlanError(f"OMPL did not run the planner {name}; please report the arena and seed")
    return outcome.drive


def _solved(task: Task, method: Callable[[Task], PlannedDrive], name: str) -> PlannerOutcome:
    """Set up OMPL's problem and let OMPL solve it."""
    checks = FloorChecks.of(task.reach, task.barriers, task.vehicle)
    setup = setup_of(task.arena.bounds, checks)
    information = setup.getSpaceInformation()
    planner = TaskPlanner(information, task, method, name)
    if task.start is not None:
        setup.addStartState(state_of(information.getStateSpace(), task.start))
    setup.setGoal(CoverageGoal(information))
    setup.setPlanner(planner)
    setup.solve(base.PlannerTerminationCondition(_never))
    return planner.outcome


def setup_of(
    bounds: tuple[float, float, float, float], checks: FloorChecks, *, is_certified: bool = True
) -> Any:
    """Return a SimpleSetup in the robot's own state space, with our checks and the driving time as its objective.

    Parameters
    ----------
    bounds : x0, y0, x1, y1 [m] of the arena
    is_certified : motions are proven free; False: OMPL samples them, for its planners that ask how far a motion is valid,
        which OMPL 2.0.1 does not ask of Python
    """
    radius = (1.0 - RADIUS_SLACK) * checks.vehicle.limits.turning_radius
    space = {
        "diff": base.SE2StateSpace,
        "reeds_shepp": lambda: base.ReedsSheppStateSpace(radius),
        "dubins": lambda: base.DubinsStateSpace(radius),
    }[checks.vehicle.drive]()
    limits = base.RealVectorBounds(2)
    for axis in range(2):
        limits.setLow(axis, float(bounds[axis]))
        limits.setHigh(axis, float(bounds[axis + 2]))
    space.setBounds(limits)
    setup = geometric.SimpleSetup(space)
    information = setup.getSpaceInformation()
    setup.setStateValidityChecker(checks.is_valid)
    information.setStateValidityCheckingResolution(JOINS.check_step / space.getMaximumExtent())
    if is_certified:
        information.setMotionValidator(CertifiedMotion(information, checks))
    setup.setOptimizationObjective(DrivingTime(information, checks.vehicle))
    return setup


@dataclass(eq=False)
class PlannerOutcome:
    """What a planner returned or raised, kept outside of OMPL."""

    drive: PlannedDrive | None = None
    error: BaseException | None = None


class TaskPlanner(base.Planner):  # type: ignore[misc]  # ompl has no types that mypy can follow
    """A planner of the registry at work on a task."""

    def __init__(
        self, information: Any, task: Task, method: Callable[[Task], PlannedDrive], name: str
    ) -> None:
        super().__init__(information, name)
        self.name, self.task, self.method = name, task, method
        self.outcome = PlannerOutcome()

    def solve(self, condition: Any) -> Any:
        """Plan until the condition says stop; what was planned by then is kept."""
        status = base.PlannerStatus
        task = replace(self.task, progress=stop_when(condition, self.task.progress))
        try:
            drive = self.method(task)
        except BaseException as exc:
            self.outcome.error = exc
            kind = {KeyboardInterrupt: status.TIMEOUT, PlanError: status.INFEASIBLE}
            return status(kind.get(type(exc), status.CRASH))
        self.outcome.drive = drive
        path = path_of(self.getSpaceInformation(), drive.curve)
        self.getProblemDefinition().addSolutionPath(path, drive.interrupted, 0.0, self.name)
        return status(status.APPROXIMATE_SOLUTION if drive.interrupted else status.EXACT_SOLUTION)


class CoverageGoal(base.GoalRegion):  # type: ignore[misc]
    """Every bin met: a goal of a drive, not of a state, so that a drive may end in any."""

    def distanceGoal(self, state: Any) -> float:  # noqa: N802
        """Return 0: whichever state the last bin is met in."""
        return 0.0


class DrivingTime(base.OptimizationObjective):  # type: ignore[misc]
    """The time [s] of a drive at the robot's limits, accelerations left out: it drives and turns at once."""

    def __init__(self, information: Any, vehicle: Vehicle) -> None:
        super().__init__(information)
        self.limits = vehicle.limits
        self.space = information.getStateSpace() if vehicle.drive != "diff" else None

    def stateCost(self, state: Any) -> Any:  # noqa: N802
        """Return no cost: only motions take time."""
        return base.Cost(0.0)

    def motionCost(self, one: Any, other: Any) -> Any:  # noqa: N802
        """Return the time [s] from one state to another."""
        a, b = pose_of(one), pose_of(other)
        if self.space is not None:
            return base.Cost(float(self.space.distance(one, other)) / self.limits.v)
        turn = abs(float(wrap(np.float64(b[2] - a[2]))))
        return base.Cost(max(float(np.hypot(*(b - a)[:2])) / self.limits.v, turn / self.limits.omega))


@dataclass(frozen=True, kw_only=True, eq=False)
class FloorChecks:
    """Where the robot's rim is free, proven: by the raster of distances where that is enough, else exactly."""

    distance: Floats
    """(mx, my) [m] exact distance of each node of the raster to walls, cut off."""
    low: tuple[float, float]
    """[m] corner of the raster."""
    step: float
    """[m] between nodes."""
    barriers: Barriers
    vehicle: Vehicle
    clearance: float
    """[m] that the centre keeps on a path: the radius, less what a chord cuts off an arc."""

    @classmethod
    def of(cls, reach: Reach, barriers: Barriers, vehicle: Vehicle) -> FloorChecks:
        """Return the checks of a floor."""
        limits = vehicle.limits
        omega = limits.v / limits.turning_radius if vehicle.drive != "diff" else limits.omega
        sagitta = 0.0 if vehicle.drive != "diff" else limits.v * omega * STATE_PERIOD**2 / 8
        return cls(
            distance=reach.distance,
            low=(float(reach.origin[0]), float(reach.origin[1])),
            step=reach.step,
            barriers=barriers,
            vehicle=vehicle,
            clearance=vehicle.footprint_radius - sagitta - 1e-6,
        )

    def proven(self, x: float, y: float) -> float:
        """Return [m] a distance to walls that the raster proves; 0 off the raster."""
        i, k = int((x - self.low[0]) / self.step), int((y - self.low[1]) / self.step)
        if i < 0 or k < 0 or i >= self.distance.shape[0] or k >= self.distance.shape[1]:
            return 0.0
        return float(self.distance[i, k]) - HALF_DIAGONAL * self.step

    def is_valid(self, state: Any) -> bool:
        """Tell whether the rim is free at a state."""
        x, y = state.getX(), state.getY()
        if self.proven(x, y) >= self.clearance:
            return True
        return self.proven(x, y) > 0 and bool(
            self.barriers.distances(np.array([[x, y]]))[0] >= self.clearance
        )

    def is_clear(self, a: tuple[float, float], b: tuple[float, float], length: float) -> bool:
        """Tell whether the rim is proven free on any way of a length [m] between two places."""
        if 0.5 * (self.proven(*a) + self.proven(*b) - length) >= self.clearance:
            return True
        exact = self.barriers.distances(np.array([a, b]))
        return bool(self.proven(*b) > 0 and 0.5 * (exact.sum() - length) >= self.clearance)


class CertifiedMotion(base.MotionValidator):  # type: ignore[misc]
    """Proves motions free: no place on a way of length s is nearer to walls than the mean of its ends less s / 2.

    What that does not prove is halved, down to chords, whose distance to walls is exact.
    """

    def __init__(self, information: Any, checks: FloorChecks) -> None:
        super().__init__(information)
        self.checks = checks
        self.space = information.getStateSpace() if checks.vehicle.drive != "diff" else None

    def checkMotion(self, one: Any, other: Any) -> bool:  # noqa: N802
        """Tell whether the motion between two states, of which one is valid, is proven free."""
        a, b = (one.getX(), one.getY()), (other.getX(), other.getY())
        checks = self.checks
        if self.space is None:
            if checks.is_clear(a, b, float(np.hypot(b[0] - a[0], b[1] - a[1]))):
                return True
            return bool(checks.barriers.are_clear(np.array([a]), np.array([b]), checks.clearance)[0])
        length = float(self.space.distance(one, other))
        if checks.is_clear(a, b, length):
            return True
        if length < checks.step:
            sagitta = length**2 / (8 * checks.vehicle.limits.turning_radius)
            return bool(
                checks.barriers.are_clear(np.array([a]), np.array([b]), checks.clearance - sagitta)[0]
            )
        middle = self.space.allocState()
        self.space.interpolate(one, other, 0.5, middle)
        return self.checkMotion(one, middle) and self.checkMotion(middle, other)


def path_of(information: Any, curve: Curve) -> Any:
    """Return a drive as a path of OMPL's, with a state wherever a piece of it begins, and between."""
    stamps = np.append(curve.starts, curve.duration)
    parts = np.maximum(np.ceil(np.diff(stamps) / STATE_PERIOD - 1e-9), 1).astype(np.int64)
    owner = np.repeat(np.arange(len(parts)), parts)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)
    when = np.append(stamps[owner] + (number / parts[owner]) * np.diff(stamps)[owner], curve.duration)
    poses = curve.sample(when)[0]
    path = geometric.PathGeometric(information)
    state = information.getStateSpace().allocState()
    for x, y, phi in np.column_stack([poses[:, :2], wrap(poses[:, 2])]).tolist():
        state.setXY(x, y)
        state.setYaw(phi)
        path.append(state)
    return path


def pose_of(state: Any) -> Floats:
    """Return (3,) the pose of a state of SE2."""
    return np.array([state.getX(), state.getY(), state.getYaw()])


def state_of(space: Any, pose: Floats) -> Any:
    """Return a state of SE2 at a pose (3,)."""
    state = space.allocState()
    state.setXY(float(pose[0]), float(pose[1]))
    state.setYaw(float(wrap(np.float64(pose[2]))))
    return state


def stop_when(condition: Any, then: Progress | None = None) -> Progress:
    """Return a progress that ends the planning, as Ctrl-C would, once OMPL's condition says so."""

    def progress(done: int, total: int) -> None:
        if then is not None:
            then(done, total)
        if condition():
            raise KeyboardInterrupt

    return progress


def _never() -> bool:
    return False
