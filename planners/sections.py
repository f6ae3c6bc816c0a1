"""Cut a drive into sections that fit a time limit, and plan the transit from a section's end to a target pose.

The drive of a robot that turns in place is cut only where v is zero. If it is turning there, the section ends
with a braking turn on the spot, and the next section begins with an accelerating turn. Both stay in place,
and every heading bin is still passed. A car's drive can be cut between any two arcs: it brakes and
accelerates on arcs of the drive.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planners.arena import Arena, wrap
from planners.cars.car_curve import car_section, cusps
from planners.clearance import Barriers
from planners.curve import Curve, CurveBuilder, join_curves
from planners.errors import PlanError
from planners.joins.car_paths import connect_car
from planners.joins.paths import join
from planners.reach import Reach, check_free
from planners.task import JoinCounts, PlannedDrive, Task
from planners.types import ROUND_OFF, Floats, Ints
from planners.vehicle import Vehicle

MAX_STUCK = 8
"""Number of places without a path home after which the cut fails."""
STEP_BACK = 2.0
"""[s] by which each attempt ends earlier than the one before."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Transit:
    """A drive from one pose to another, without a requirement on coverage."""

    curve: Curve | None
    """None if the poses are the same."""
    joins: JoinCounts

    @property
    def duration(self) -> float:
        """[s]"""
        return 0.0 if self.curve is None else self.curve.duration


def check_pose(name: str, pose: Floats, arena: Arena, barriers: Barriers, reach: Reach) -> None:
    """Reject a pose (3,) that the robot cannot take or reach.

    Raises
    ------
    PlanError : The pose is outside the arena, too near to a wall, or out of reach; `name` is its name in the
        message.
    """
    if not np.isfinite(pose).all():
        raise PlanError(f"{name} is {pose.tolist()}, expected three finite numbers x, y, phi")
    check_free(name, pose, arena, barriers, reach.clearance)
    if reach.nearest(pose[:2]) is None:
        raise PlanError(
            f"{name} ({pose[0]:g}, {pose[1]:g}) cannot be reached from the start; move the pose or the start into the "
            "same part of the floor"
        )


def cut_points(curve: Curve, vehicle: Vehicle) -> Ints:
    """Return the pieces (m,) before which the curve can be cut; the last entry is the number of pieces."""
    still = abs(curve.twists[:, 0]) < ROUND_OFF
    if vehicle.drive != "diff":
        still[:] = True
    return np.append(np.flatnonzero(still), len(curve.starts))


def section_of(curve: Curve, first: int, last: int, vehicle: Vehicle) -> Curve:
    """Return pieces `first` to `last` (excluded) from rest to rest; both must be among `cut_points`."""
    if vehicle.drive == "diff":
        return _spin_section(curve, first, last, vehicle.limits.alpha)
    return car_section(curve, first, last, vehicle.limits)


def _spin_section(curve: Curve, first: int, last: int, alpha: float) -> Curve:
    """Return a section that begins and ends with a turn on the spot at `alpha` [rad/s²] where the robot is turning."""
    whole = curve if last == len(curve.starts) else curve.until(float(curve.starts[last]), alpha)
    omega = float(curve.twists[first, 1])
    if abs(omega) < ROUND_OFF:
        return replace(
            whole,
            starts=whole.starts[first:] - whole.starts[first],
            duration=whole.duration - float(whole.starts[first]),
            poses=whole.poses[first:],
            twists=whole.twists[first:],
            rates=whole.rates[first:],
            labels=whole.labels[first:],
        )
    ramp = abs(omega) / alpha
    shift = ramp - float(whole.starts[first])
    pose = whole.poses[first] - [0.0, 0.0, 0.5 * omega * ramp]
    return Curve(
        starts=np.append(0.0, whole.starts[first:] + shift),
        duration=whole.duration + shift,
        poses=np.vstack([pose, whole.poses[first:]]),
        twists=np.vstack([np.zeros(2), whole.twists[first:]]),
        rates=np.vstack([[0.0, np.copysign(alpha, omega)], whole.rates[first:]]),
        labels=np.append("turn", whole.labels[first:]),
    )


def end_poses(curve: Curve) -> tuple[Floats, Floats]:
    """Return the poses (3,) at the start and at the end, with phi wrapped."""
    first, last = curve.sample(np.array([0.0, curve.duration]))[0]
    return first, last


def turning_stops(curve: Curve) -> Floats:
    """Return the stops (n, 4) [m, m, rad, rad] of a drive: pose at the start of each turn on the spot, and its angle.

    A continuous spin has one stop per revolution. Turning between two stops is added to the first, so that
    the angles add up to the total turn of the drive.
    """
    end = curve.end
    phi = np.append(curve.poses[:, 2], 0.0)
    phi[-1] = phi[-2] + wrap(np.float64(end[2] - phi[-2]))
    turning = (abs(curve.twists[:, 1]) > ROUND_OFF) | (abs(curve.rates[:, 1]) > ROUND_OFF)
    onset = turning & ~np.append(False, turning[:-1])
    onset |= turning & (curve.labels != np.append("", curve.labels[:-1]))
    marks: list[int] = []
    for k in np.flatnonzero(turning).tolist():
        if onset[k] or abs(phi[k] - phi[marks[-1]]) >= 2 * np.pi - 1e-6:
            marks.append(k)
    return np.column_stack([curve.poses[marks], np.diff(phi[[*marks, -1]])]) if marks else np.zeros((0, 4))


def stops_of(curve: Curve, task: Task) -> Floats:
    """Return the stops (n, 4) of any vehicle; those of a car are its cusps, where it changes gear and does not turn."""
    if task.vehicle.drive == "diff":
        return turning_stops(curve)
    return cusps(curve)


class NoPathError(PlanError):
    """OMPL found no path between two poses."""


class PathCache:
    """Transits between poses: direct if that is clear, else by OMPL; each path is planned once and reused."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self._paths: dict[tuple[float, ...], tuple[Floats, JoinCounts]] = {}

    def transit(self, begin: Floats, end: Floats) -> Transit:
        """Return the transit from one pose (3,) to another, at rest at both.

        Raises
        ------
        NoPathError : OMPL found no path.
        """
        if self.task.vehicle.drive != "diff":
            return self._by_car(begin, end)
        path, joins = self._path(begin[:2], end[:2])
        builder = CurveBuilder(begin, self.task.vehicle.limits)
        builder.follow(path)
        builder.face(float(end[2]))
        return Transit(curve=builder.curve() if builder.clock > 0 else None, joins=joins)

    def _by_car(self, begin: Floats, end: Floats) -> Transit:
        task = self.task
        path, joins = connect_car(
            begin,
            end[None],
            reach=task.reach,
            barriers=task.barriers,
            vehicle=task.vehicle,
            seed=task.seed,
        )
        if path is None:
            raise NoPathError(_no_path(begin, end))
        return Transit(curve=path.curve, joins=joins)

    def _path(self, begin: Floats, end: Floats) -> tuple[Floats, JoinCounts]:
        key = (*begin.tolist(), *end.tolist())
        back = (*end.tolist(), *begin.tolist())
        if key not in self._paths and back in self._paths:
            path, joins = self._paths[back]
            return path[::-1], joins
        if key not in self._paths:
            paths, joins = join(self.task, begin[None], end[None])
            if paths[0] is None:
                raise NoPathError(_no_path(begin, end))
            self._paths[key] = paths[0], joins
        return self._paths[key]


def _no_path(begin: Floats, end: Floats) -> str:
    return f"no path was found from {_place(begin)} to {_place(end)}; choose another place to start, to end or to dock"


def _place(pose: Floats) -> str:
    return f"({', '.join(f'{value:.2f}' for value in pose)})"


@dataclass(frozen=True, kw_only=True, eq=False)
class DriveSection:
    """A section of the drive, and the transit from its end."""

    last: int
    """Index of the next piece of the drive."""
    part: Curve
    home: Transit | None

    @property
    def duration(self) -> float:
        """[s] of section and transit."""
        return self.part.duration + (0.0 if self.home is None else self.home.duration)


def section_up_to(
    curve: Curve, first: int, last: int, home: Floats | None, cache: PathCache | None, vehicle: Vehicle
) -> DriveSection:
    """Return pieces `first` to `last` (excluded), and the transit from there to `home` (3,)."""
    part = section_of(curve, first, last, vehicle)
    back = None if home is None or cache is None else cache.transit(end_poses(part)[1], home)
    return DriveSection(last=last, part=part, home=back)


def longest_section(
    curve: Curve, first: int, left: float, home: Floats | None, cache: PathCache | None, vehicle: Vehicle
) -> DriveSection | None:
    """Return the longest section from piece `first` that, with its transit to `home` (3,), fits into `left` [s].

    The section is shortened by its excess time until it fits. A longer section may exist where transits home
    differ much between neighbouring places. The result is None if not even the shortest section fits.

    Raises
    ------
    NoPathError : No path leads home from several successive places.
    """
    choice, stamps = cut_points(curve, vehicle), np.append(curve.starts, curve.duration)
    nearest, last = int(choice[choice > first][0]), first
    allowed, stuck = left, 0
    while True:
        fits = choice[(choice > first) & (stamps[choice] - stamps[first] <= allowed)]
        if not len(fits) and last == nearest:
            return None
        last = int(fits[-1]) if len(fits) else nearest
        try:
            cut = section_up_to(curve, first, last, home, cache, vehicle)
        except NoPathError:
            if (stuck := stuck + 1) > MAX_STUCK:
                raise
            allowed = float(stamps[last] - stamps[first]) - STEP_BACK
            continue
        over = cut.duration - left
        if over <= ROUND_OFF:
            return cut
        allowed = float(stamps[last] - stamps[first]) - over


def fit_to_budget(
    driven: PlannedDrive, task: Task, *, budget: float | None, end: Floats | None
) -> PlannedDrive:
    """Cut a drive to `budget` [s], and add the transit to `end` (3,) if an end pose is given.

    Raises
    ------
    PlanError : The budget is too short for the first stop, or no path leads to the end pose.
    """
    if budget is None and end is None:
        return driven
    curve, vehicle = driven.curve, task.vehicle
    cache = None if end is None else PathCache(task)
    whole = section_up_to(curve, 0, len(curve.starts), end, cache, vehicle)
    cut = whole
    if budget is not None and whole.duration > budget + ROUND_OFF:
        found = longest_section(curve, 0, budget, end, cache, vehicle)
        if found is None:
            choice = cut_points(curve, vehicle)
            first = section_up_to(curve, 0, int(choice[choice > 0][0]), end, cache, vehicle)
            raise PlanError(
                f"a budget of {budget / 60:g} min is too short: to the first stop"
                f"{'' if end is None else ' and on to the end pose'} takes {minutes(first.duration)} min"
            )
        cut = found
    if cut is whole and cut.home is None:
        return driven
    joins = driven.joins if cut.home is None else driven.joins + cut.home.joins
    return drive_along(
        [part for part in (cut.part, cut.home and cut.home.curve) if part],
        joins,
        task,
        interrupted=driven.interrupted,
    )


def minutes(seconds: float) -> str:
    """Return the duration in minutes, rounded up to a tenth."""
    return f"{np.ceil(seconds / 6) / 10:g}"


def drive_along(
    curves: list[Curve], joins: JoinCounts, task: Task, *, interrupted: bool = False
) -> PlannedDrive:
    """Return the drive along consecutive curves."""
    curve = join_curves(curves)
    return PlannedDrive(curve=curve, stops=stops_of(curve, task), joins=joins, interrupted=interrupted)
