"""Planning as an OMPL problem: state space, checks of states and motions, driving time as objective, planner.

`drive_in_frame` sets up the OMPL problem of a task, and a planner of the registry solves it as an
`ob.Planner` (`TaskPlanner`). The resulting drive is an OMPL solution path, which passes OMPL's own `check()`.
This module is imported only when a drive is planned; the rest of the package works without OMPL.

OMPL 2.0.1 has three restrictions in Python. Callbacks must hold no OMPL object, or it leaks. An exception
must not pass through OMPL; it is stored and raised again outside. A state returned by `ProblemDefinition` is
freed together with its Python object.
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
from planners.groups import members
from planners.joins.ompl_process import CHECK_STEP, INSTALL_HINT
from planners.reach import Reach
from planners.task import PlannedDrive, Task
from planners.types import Floats, Progress
from planners.vehicle import Vehicle

try:
    from ompl import base, geometric, util  # type: ignore[import-untyped]
except ImportError as exc:
    raise PlanError(INSTALL_HINT) from exc

STATE_PERIOD = 0.2
"""[s] maximum time between states of a path."""
RADIUS_SLACK = 1e-3
"""Share by which OMPL's curves may be tighter than the car's, because they end in rounded states."""
HALF_DIAGONAL = 0.5**0.5
"""Half the diagonal of a raster cell, in steps: the largest distance of a place from its nearest node."""


def drive_in_frame(task: Task, method: Callable[[Task], PlannedDrive], name: str) -> PlannedDrive:
    """Solve a task with a planner of the registry that runs as a planner of OMPL.

    Parameters
    ----------
    method : Function of the planner.
    name : Name of the planner in OMPL.

    Raises
    ------
    PlanError, KeyboardInterrupt : Raised by the planner.
    """
    level = util.getLogLevel()
    util.setLogLevel(util.LOG_NONE)
    try:
        outcome = _solved(task, method, name)
    finally:
        util.setLogLevel(level)
    if outcome.error is not None:
        if isinstance(outcome.error, PlanError | KeyboardInterrupt):
            raise outcome.error.with_traceback(None)  # its frames would keep OMPL objects alive
        raise outcome.error
    if outcome.drive is None:
        raise PlanError(f"OMPL did not run the planner {name}; please report the arena and the seed")
    return outcome.drive


def _solved(task: Task, method: Callable[[Task], PlannedDrive], name: str) -> PlannerOutcome:
    """Set up the OMPL problem and solve it."""
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
    """Return a SimpleSetup in the robot's state space, with the checks and the driving time as the objective.

    Parameters
    ----------
    bounds : x0, y0, x1, y1 [m] of the arena.
    is_certified : Whether motions are proven free. False: OMPL samples them. OMPL planners that query the
        last valid
        state of a motion need this, because OMPL 2.0.1 does not pass that query to Python.
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
    information.setStateValidityCheckingResolution(CHECK_STEP / space.getMaximumExtent())
    if is_certified:
        information.setMotionValidator(CertifiedMotion(information, checks))
    setup.setOptimizationObjective(DrivingTime(information, checks.vehicle))
    return setup


@dataclass(eq=False)
class PlannerOutcome:
    """Result or exception of a planner, stored outside OMPL."""

    drive: PlannedDrive | None = None
    error: BaseException | None = None


class TaskPlanner(base.Planner):  # type: ignore[misc]  # ompl has no types that mypy can follow
    """OMPL planner that runs a planner of the registry on a task."""

    def __init__(
        self, information: Any, task: Task, method: Callable[[Task], PlannedDrive], name: str
    ) -> None:
        super().__init__(information, name)
        self.name, self.task, self.method = name, task, method
        self.outcome = PlannerOutcome()

    def solve(self, condition: Any) -> Any:
        """Plan until the condition is true; the plan so far is kept."""
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
    """Goal of a coverage drive: it is reached in any state, since it depends on the drive and not on the state."""

    def distanceGoal(self, state: Any) -> float:  # noqa: N802
        """Return 0: the drive may end in any state."""
        return 0.0


class DrivingTime(base.OptimizationObjective):  # type: ignore[misc]
    """Driving time [s] at the robot's limits, without accelerations; driving and turning are simultaneous."""

    def __init__(self, information: Any, vehicle: Vehicle) -> None:
        super().__init__(information)
        self.limits = vehicle.limits
        self.space = information.getStateSpace() if vehicle.drive != "diff" else None

    def stateCost(self, state: Any) -> Any:  # noqa: N802
        """Return zero cost: only motions take time."""
        return base.Cost(0.0)

    def motionCost(self, one: Any, other: Any) -> Any:  # noqa: N802
        """Return the time [s] from one state to another: length / v for a car, else max(length / v, turn / omega)."""
        a, b = pose_of(one), pose_of(other)
        if self.space is not None:
            return base.Cost(float(self.space.distance(one, other)) / self.limits.v)
        turn = abs(float(wrap(np.float64(b[2] - a[2]))))
        return base.Cost(max(float(np.hypot(*(b - a)[:2])) / self.limits.v, turn / self.limits.omega))


@dataclass(frozen=True, kw_only=True, eq=False)
class FloorChecks:
    """Proof that the robot's rim is free, from the distance raster where that suffices, else from exact distances."""

    distance: Floats
    """(mx, my) [m] exact distance of each raster node to walls, capped."""
    low: tuple[float, float]
    """[m] lower left corner of the raster."""
    step: float
    """[m] between nodes."""
    barriers: Barriers
    vehicle: Vehicle
    clearance: float
    """[m] required distance of the centre on a path: the radius minus the sagitta between a chord and its arc."""

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

    def distance_bound(self, x: float, y: float) -> float:
        """Return a lower bound [m] on the distance to walls, from the raster; 0 outside the raster."""
        i, k = int((x - self.low[0]) / self.step), int((y - self.low[1]) / self.step)
        if i < 0 or k < 0 or i >= self.distance.shape[0] or k >= self.distance.shape[1]:
            return 0.0
        return float(self.distance[i, k]) - HALF_DIAGONAL * self.step

    def is_valid(self, state: Any) -> bool:
        """Return whether the rim is free at a state."""
        x, y = state.getX(), state.getY()
        if self.distance_bound(x, y) >= self.clearance:
            return True
        return self.distance_bound(x, y) > 0 and bool(
            self.barriers.distances(np.array([[x, y]]))[0] >= self.clearance
        )

    def is_clear(self, a: tuple[float, float], b: tuple[float, float], length: float) -> bool:
        """Return whether the rim is proven free on every path of a length [m] between two places.

        On a path of length s, no place is nearer to walls than (d(a) + d(b) - s) / 2.
        """
        if 0.5 * (self.distance_bound(*a) + self.distance_bound(*b) - length) >= self.clearance:
            return True
        exact = self.barriers.distances(np.array([a, b]))
        return bool(self.distance_bound(*b) > 0 and 0.5 * (exact.sum() - length) >= self.clearance)


class CertifiedMotion(base.MotionValidator):  # type: ignore[misc]
    """Proof that a motion is free: on a path of length s, no place is nearer to walls than (d(a) + d(b) - s) / 2.

    A motion for which this fails is halved, down to chords, whose distance to walls is exact.
    """

    def __init__(self, information: Any, checks: FloorChecks) -> None:
        super().__init__(information)
        self.checks = checks
        self.space = information.getStateSpace() if checks.vehicle.drive != "diff" else None

    def checkMotion(self, one: Any, other: Any) -> bool:  # noqa: N802
        """Return whether the motion between two states, of which one is valid, is proven free."""
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
    """Return a drive as an OMPL path, with a state at each piece's start and at most `STATE_PERIOD` between states."""
    stamps = np.append(curve.starts, curve.duration)
    parts = np.maximum(np.ceil(np.diff(stamps) / STATE_PERIOD - 1e-9), 1).astype(np.int64)
    owner, number = members(parts)
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
    """Return the pose (3,) of an SE2 state."""
    return np.array([state.getX(), state.getY(), state.getYaw()])


def state_of(space: Any, pose: Floats) -> Any:
    """Return an SE2 state at a pose (3,)."""
    state = space.allocState()
    state.setXY(float(pose[0]), float(pose[1]))
    state.setYaw(float(wrap(np.float64(pose[2]))))
    return state


def stop_when(condition: Any, then: Progress | None = None) -> Progress:
    """Return a progress callback that interrupts the planning, as Ctrl-C would, once OMPL's condition is true."""

    def progress(done: int, total: int) -> None:
        if then is not None:
            then(done, total)
        if condition():
            raise KeyboardInterrupt

    return progress


def _never() -> bool:
    return False
