"""What the search needs to know of cars: how one comes to a heading of the table, and the curve of a drive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import ndimage

from planners.cars.arc_path import Drive, Ground, drive_of, ground_of
from planners.cars.reeds_shepp import NONE, Arcs, part_of
from planners.cars.shortcuts import shorter
from planners.curve import Curve, curve_of_pieces
from planners.priority import urgency, worth
from planners.rooms import rooms
from planners.search.area import SearchArea, search_area
from planners.search.kernel_world import MAX_BINS_PER_PRIMITIVE, is_safe
from planners.search.log_phases import missed
from planners.search.motion_primitives import GEARS, MotionPrimitives, car_primitives
from planners.search.room_drive import RoomDrive
from planners.search.search import CoverageSearch, SearchResult
from planners.search.settings import SearchSettings
from planners.task import Task
from planners.types import Bools, Floats
from planners.vehicle import Limits

MOST_STEPS = 3
"""Headings of the table that a car may pass before it takes one."""
STILL = 1e-9
"""[rad] pieces that turn less are straight."""
SAME = 1e-5
"""[rad] headings closer than this are the same."""
WAYPOINT = 0.005
"""[m] between the places at which an arc is looked at."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Entry:
    """The arc from where a car is to a heading of the table by which it is searched for."""

    primitives: MotionPrimitives
    pose: Floats
    """(3,) where the car is."""
    length: float
    """[m] 0 where its heading is one already."""
    bend: int
    """1 turns counter-clockwise, 0 not, -1 clockwise."""
    gear: int
    """1 forward, -1 backward."""
    state: Floats
    """(4,) x, y [m], heading step, mode where the search begins."""


def begin(
    pose: Floats, area: SearchArea, limits: Limits, headings: int, rate: float, gears: tuple[int, ...]
) -> Entry:
    """Return how a car at `pose` (3,) comes to a table.

    Where walls leave no arc to it, or for a car of one gear none back, as in a corridor that just holds the car, the
    heading of the pose is one of the table.
    """
    senses = [gears] if len(gears) > 1 else [gears, (-gears[0],)]
    found = [
        entry(pose, area, car_primitives(limits, headings, rate, sense), rate, limits) for sense in senses
    ]
    if found[0] is not None and all(found):
        return found[0]
    primitives = car_primitives(limits, headings, rate, gears, float(pose[2]))
    return Entry(
        primitives=primitives, pose=pose, length=0.0, bend=0, gear=gears[0], state=state_at(primitives, pose)
    )


def entry(
    pose: Floats, area: SearchArea, primitives: MotionPrimitives, rate: float, limits: Limits
) -> Entry | None:
    """Return the shortest clear arc of the least radius that leads from `pose` (3,) to where the search can begin.

    None where walls leave no such arc.
    """
    apart = float((pose[2] - primitives.first_heading) / abs(primitives.heading_step))
    steps = np.arange(-MOST_STEPS, MOST_STEPS + 1) + np.round(apart) - apart
    turns = abs(primitives.heading_step) * steps[np.argsort(abs(steps), kind="stable")]
    if abs(turns[0]) < SAME:
        return Entry(
            primitives=primitives, pose=pose, length=0.0, bend=0, gear=1, state=state_at(primitives, pose)
        )
    search = CoverageSearch(area, primitives, np.zeros((*area.inner.shape, 1), dtype=np.bool_), rate)
    arrays, covered = search.primitive_arrays(), np.empty(MAX_BINS_PER_PRIMITIVE, dtype=np.int64)
    for turn in turns.tolist():
        for mode, gear in enumerate(np.sign(primitives.speeds).astype(int).tolist()):
            length, bend = abs(turn) * limits.turning_radius, int(np.sign(turn))
            arc = geared(pose, np.array([length]), np.array([bend]), np.array([gear]), limits)
            n = int(np.ceil(length / WAYPOINT))
            poses = arc.sample(np.arange(1, n + 1) / n * arc.duration)[0]
            nodes = (poses[:, :2] - area.origin) / area.step - 0.5
            if ndimage.map_coordinates(area.distance, nodes.T, order=1).min() < area.clearance:
                continue
            x, y, h, _ = state = state_at(primitives, poses[-1], mode)
            if is_safe(x, y, int(h), mode, primitives.safe_depth, search.world, arrays, covered):
                return Entry(
                    primitives=primitives, pose=pose, length=length, bend=bend, gear=gear, state=state
                )
    return None


def car_curve(found: SearchResult, begun: Entry, limits: Limits) -> Curve:
    """Return the curve of a car's drive: as fast as v and a allow from rest to rest in each gear.

    Arcs and straight pieces follow each other at full speed, so omega jumps where the steering does; within a piece
    alpha holds.
    """
    primitives = begun.primitives
    then, turn = primitives.next_mode.tolist(), primitives.turned_steps.tolist()
    gears, turns, units = [begun.gear], [begun.bend], list[float]()
    mode = int(found.start[3])
    for j in found.sequence.tolist():
        turns.append(int(np.sign(turn[mode][j])))
        units.append(primitives.sample_period[mode, j])
        mode = then[mode][j]
        gears.append(int(np.sign(primitives.speeds[mode])))
    v = float(abs(primitives.speeds[0]))
    length = np.append(begun.length, np.array(units) * (primitives.offsets.shape[3] - 1) * v)  # [m]
    some = length > 0
    return geared(begun.pose, length[some], np.array(turns)[some], np.array(gears)[some], limits, v)


def geared(
    pose: Floats, length: Floats, bend: np.ndarray, gear: np.ndarray, limits: Limits, v: float | None = None
) -> Curve:
    """Return the curve of a car that starts at `pose` (3,) and drives arcs (m,) and straight pieces, from rest to rest.

    Parameters
    ----------
    length : (m,) [m]
    bend : (m,) 1 turns counter-clockwise, 0 not, -1 clockwise
    gear : (m,) 1 forward, -1 backward; the car stops where it changes
    v : [m/s] default: the fastest that the limits allow
    """
    top = min(limits.v, limits.omega * limits.turning_radius) if v is None else v
    a = limits.a_on_arc
    runs = np.flatnonzero(np.diff(gear, prepend=gear[:1] - 1, append=gear[-1:] + 1))
    parts = [
        _run(length[i:k], bend[i:k], top, a, float(gear[i]), limits.turning_radius)
        for i, k in pairwise(runs.tolist())
    ]
    dt, twists, rates = (np.concatenate(column) for column in zip(*parts, strict=True))
    return curve_of_pieces(pose, dt, twists, rates, np.full(len(dt), "drive" if v is not None else "join"))


def redriven(curve: Curve, first: int, last: int, limits: Limits) -> Curve:
    """Drive pieces `first` up to `last`, not included, of a car's curve again, starting and stopping on them."""
    arcs = part_of(arcs_of(curve), slice(first, last))
    top = float(abs(curve.twists[:, 0]).max())
    return geared(curve.poses[first], arcs.length, arcs.bend, arcs.gear, limits, top)


def arcs_of(curve: Curve) -> Arcs:
    """Return the arcs (n,) of a car's curve, one for each piece."""
    dt = np.diff(np.append(curve.starts, curve.duration))[:, None]
    way, turn = (curve.twists * dt + 0.5 * curve.rates * dt * dt).T
    bend = np.where(abs(turn) > STILL, np.sign(turn), 0.0)
    return Arcs(abs(way), bend.astype(np.int64), np.sign(way).astype(np.int64))


def drive_on(curve: Curve, todo: Bools, task: Task, speed: float) -> tuple[Drive, Ground]:
    """Return a car's curve as a drive at some speed [m/s], and the ground on which it wins the bins `todo`."""
    limits, is_backward = task.vehicle.limits, len(GEARS[task.vehicle.drive]) > 1
    ground = ground_of(task.reach, todo, limits, speed, task.rate, is_backward=is_backward)
    arcs = arcs_of(curve)
    drive, _ = drive_of(curve.poses[0], part_of(arcs, arcs.length > NONE), ground)
    return drive, ground


def shortened(curve: Curve, todo: Bools, task: Task, speed: float) -> tuple[Curve, bool]:
    """Return a shorter drive of a car that wins all of the bins `todo` (nx, ny, n_phi) that it won.

    Parameters
    ----------
    speed : [m/s]

    Returns
    -------
    curve, and whether Ctrl-C ended the work: what was found by then
    """
    limits, (begun, ground) = task.vehicle.limits, drive_on(curve, todo, task, speed)
    best, interrupted = begun, False
    try:
        for drive in shorter(begun, ground):
            best = drive
    except KeyboardInterrupt:
        interrupted = True
    if best is begun:
        return curve, interrupted
    return geared(curve.poses[0], best.length, best.bend, best.gear, limits, speed), interrupted


def _run(
    length: Floats, bend: np.ndarray, v: float, a: float, gear: float, radius: float
) -> tuple[Floats, Floats, Floats]:
    """Return dt (n,), twists (n, 2) and rates (n, 2) of pieces (m,) driven in one gear from rest to rest."""
    ends = np.concatenate([[0.0], np.cumsum(length)])
    total = ends[-1]
    ramp = min(v * v / (2 * a), total / 2)
    marks = np.concatenate([ends, [ramp, total - ramp]])
    marks = np.sort(marks)
    marks = marks[np.concatenate([[True], np.diff(marks) > 1e-9])]
    marks[-1] = total
    low, high = marks[:-1], marks[1:]
    middle = 0.5 * (low + high)
    owner = np.clip(np.searchsorted(ends, middle, side="right") - 1, 0, len(length) - 1)

    def speed(s: Floats) -> Floats:
        return np.asarray(np.sqrt(2 * a * np.minimum(np.minimum(s, total - s).clip(0.0), ramp)))

    before, after = speed(low), speed(high)
    dt = 2 * (high - low) / (before + after)
    rate = (after - before) / dt
    kappa = bend[owner] / radius
    return (
        dt,
        np.stack([gear * before, kappa * before], axis=1),
        np.stack([gear * rate, kappa * rate], axis=1),
    )


def state_at(primitives: MotionPrimitives, pose: Floats, mode: int = 0) -> Floats:
    """Return (4,) the state at a pose whose heading the table has."""
    step = (
        round(float((pose[2] - primitives.first_heading) / primitives.heading_step)) % primitives.n_headings
    )
    return np.array([pose[0], pose[1], step, mode])


def search_floor(
    todo: Bools, task: Task, start: Floats, seed: int, tick: Callable[[int], bool], settings: SearchSettings
) -> RoomDrive | None:
    """Drive a car through the bins `todo` (nx, ny, n_phi), one room after the other; None where it gets to none."""
    vehicle, grid = task.vehicle, task.coverage
    area = search_area(task.reach)
    begun = begin(start, area, vehicle.limits, grid.headings, task.rate, GEARS[vehicle.drive])
    value = worth(task.priority, todo)
    search = CoverageSearch(
        area, begun.primitives, todo, task.rate, seed=seed, value=value, settings=settings
    )
    search.start_at(begun.state)
    missing, given_up = todo, np.zeros_like(todo)
    curve: Curve | None = None
    for part, patience in [
        *((room, 1.0) for room in room_order(todo, start, task)),
        (None, 1.0),
        (None, 1.3),
        (None, 1.6),
    ]:
        wanted = (missing if part is None else missing & part[:, :, None]) & ~given_up
        if not wanted.any():
            continue
        others = int(missing.sum() - wanted.sum())
        search.want(wanted, patience, inner=False)

        def said(left: int, others: int = others) -> bool:
            return tick(others + left)

        search.run(said)
        found = search.result()
        given_up |= found.left
        if len(found.sequence):
            curve = car_curve(found, begun, vehicle.limits)
            missing = missed(curve, todo, grid, task.rate)
    return None if curve is None else RoomDrive(curve=curve, stops=cusps(curve), left=int(missing.sum()))


def cusps(curve: Curve) -> Floats:
    """Return (n, 4) x, y, phi where a car starts or changes gear, and 0 [rad] that it turns there."""
    gear = np.sign(curve.twists[:, 0] + curve.rates[:, 0] * 1e-6)
    at = np.flatnonzero(np.diff(gear, prepend=0.0))
    return np.column_stack([curve.poses[at], np.zeros(len(at))])


def room_order(todo: Bools, start: Floats, task: Task) -> list[Bools]:
    """Return the rooms (nx, ny), those of high priority first, and else each next to the one before."""
    reach, here, out = task.reach, start[:2], list[Bools]()
    found = rooms(reach, np.asarray(todo.any(axis=2)))
    bands = urgency(task.priority, todo, found)
    for band in np.unique(bands).tolist():
        left = [room for room, own in zip(found, bands.tolist(), strict=True) if own == band]
        while left:
            middles = [reach.origin + (np.argwhere(room).mean(axis=0) + 0.5) * reach.cell for room in left]
            nearest = int(np.argmin([np.hypot(*(middle - here)) for middle in middles]))
            here = middles[nearest]
            out.append(left.pop(nearest))
    return out
