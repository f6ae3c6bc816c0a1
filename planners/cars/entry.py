"""Entry of a car into a search: one short arc to a heading of the primitives; and the curve of such a search."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from planners.cars.arc_path import BIN_STEP
from planners.cars.car_curve import curve_of_arcs
from planners.curve import Curve
from planners.search.area import SearchArea
from planners.search.kernel_world import find_escape, new_scratch
from planners.search.motion_primitives import MotionPrimitives, car_primitives
from planners.search.search import CoverageSearch, SearchResult
from planners.types import Floats
from planners.vehicle import Limits

MAX_STEPS = 3
"""Maximum number of headings of the primitives within the arc."""
SAME_HEADING = 1e-5
"""[rad] Headings closer than this are equal."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EntryArc:
    """The arc from a car's pose to the start state of a search."""

    primitives: MotionPrimitives
    pose: Floats
    """(3,) pose of the car."""
    length: float
    """[m] length; 0 if the car already has a heading of the primitives."""
    bend: int
    """1 counter-clockwise, 0 straight, -1 clockwise."""
    gear: int
    """1 forward, -1 backward."""
    state: Floats
    """(4,) start state of the search: x, y [m], heading step, mode."""


def entry_arc(
    pose: Floats, area: SearchArea, limits: Limits, headings: int, rate: float, gears: tuple[int, ...]
) -> EntryArc:
    """Return the arc by which a car at `pose` (3,) reaches a heading of its primitives.

    In some places walls block every such arc (for a car with one gear, also every arc back), such as in a
    corridor just wide enough for the car. The primitives then include the heading of the pose.
    """
    senses = [gears] if len(gears) > 1 else [gears, (-gears[0],)]
    found = [
        shortest_entry_arc(pose, area, car_primitives(limits, headings, rate, sense), rate, limits)
        for sense in senses
    ]
    if found[0] is not None and all(found):
        return found[0]
    primitives = car_primitives(limits, headings, rate, gears, float(pose[2]))
    return EntryArc(
        primitives=primitives, pose=pose, length=0.0, bend=0, gear=gears[0], state=state_at(primitives, pose)
    )


def shortest_entry_arc(
    pose: Floats, area: SearchArea, primitives: MotionPrimitives, rate: float, limits: Limits
) -> EntryArc | None:
    """Return the shortest clear arc of minimum radius from `pose` (3,) to a start state of the search.

    None if walls block every such arc.
    """
    apart = float((pose[2] - primitives.first_heading) / abs(primitives.heading_step))
    steps = np.arange(-MAX_STEPS, MAX_STEPS + 1) + np.round(apart) - apart
    turns = abs(primitives.heading_step) * steps[np.argsort(abs(steps), kind="stable")]
    if abs(turns[0]) < SAME_HEADING:
        return EntryArc(
            primitives=primitives, pose=pose, length=0.0, bend=0, gear=1, state=state_at(primitives, pose)
        )
    nothing = np.zeros((*area.inner.shape, int(primitives.heading_bin.max()) + 1), dtype=np.bool_)
    search = CoverageSearch(area, primitives, nothing, rate)
    scratch = new_scratch(abs(primitives.safe_depth))
    for turn in turns.tolist():
        for mode, gear in enumerate(np.sign(primitives.speeds).astype(int).tolist()):
            length, bend = abs(turn) * limits.turning_radius, int(np.sign(turn))
            arc = curve_of_arcs(pose, np.array([length]), np.array([bend]), np.array([gear]), limits)
            n = int(np.ceil(length / BIN_STEP))
            poses = arc.sample(np.arange(1, n + 1) / n * arc.duration)[0]
            nodes = (poses[:, :2] - area.origin) / area.step - 0.5
            if ndimage.map_coordinates(area.distance, nodes.T, order=1).min() < area.clearance:
                continue
            x, y, h, _ = state = state_at(primitives, poses[-1], mode)
            if find_escape(x, y, int(h), mode, primitives.safe_depth, search.world, primitives, scratch) >= 0:
                return EntryArc(
                    primitives=primitives, pose=pose, length=length, bend=bend, gear=gear, state=state
                )
    return None


def state_at(primitives: MotionPrimitives, pose: Floats, mode: int = 0) -> Floats:
    """Return the state (4,) at a pose whose heading is one of the primitives'."""
    step = (
        round(float((pose[2] - primitives.first_heading) / primitives.heading_step)) % primitives.n_headings
    )
    return np.array([pose[0], pose[1], step, mode])


def curve_of_search(found: SearchResult, entered: EntryArc, limits: Limits) -> Curve:
    """Return the curve of a car's drive: as fast as v and a allow, from rest to rest in each gear.

    Arcs and straight pieces follow each other at full speed, so omega jumps where the curvature does. Within
    a piece alpha holds.
    """
    primitives = entered.primitives
    then, turn = primitives.next_mode.tolist(), primitives.turned_steps.tolist()
    gears, turns, units = [entered.gear], [entered.bend], list[float]()
    mode = int(found.start[3])
    for j in found.sequence.tolist():
        turns.append(int(np.sign(turn[mode][j])))
        units.append(primitives.sample_period[mode, j])
        mode = then[mode][j]
        gears.append(int(np.sign(primitives.speeds[mode])))
    v = float(abs(primitives.speeds[0]))
    length = np.append(entered.length, np.array(units) * (primitives.offsets.shape[3] - 1) * v)  # [m]
    some = length > 0
    return curve_of_arcs(entered.pose, length[some], np.array(turns)[some], np.array(gears)[some], limits, v)
