"""The tuned numbers of floors, orders, priorities and checks: what they mean, and the command that set them.

The wings keep their own: `search.settings`, `cars.settings`, `joins.settings`, `methods.settings`.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ReachSettings:
    """The raster of free space; set with `python benchmarks/coverage_planners.py` (clearance, coverage, memory)."""

    step: float = 0.02
    """[m] between nodes, or a little less so that a cell is a whole number of steps."""
    max_nodes: int = 6_000_000
    """Nodes of a raster; above that its step grows."""
    max_cells: int = 1_000_000
    """Cells of a grid; larger grids are refused."""
    distance_cap: float = 0.45
    """[m] beyond the clearance, above which distances to walls are cut off."""
    min_share: float = 0.04
    """Share of a cell's area that must be reachable for the cell to count."""


@dataclass(frozen=True, kw_only=True)
class RoomSettings:
    """How a floor is cut into rooms; set with `python benchmarks/coverage_planners.py --arena --random 10 --first 1`."""

    passage: float = 0.25
    """[m] beyond the clearance; a place narrower than this separates two rooms."""
    min_cells: int = 60
    """Smaller rooms join a neighbour."""
    max_cells: int = 900
    """Larger rooms are halved."""


@dataclass(frozen=True, kw_only=True)
class TourSettings:
    """How long the order of lanes is improved.

    Set with `python benchmarks/coverage_planners.py --planner stop_and_spin` and `python -m benchmarks.large_floor`.
    """

    kicks: int = 60
    """Random perturbations of a finished order, each kept if it helps."""
    max_moves: int = 4000
    """Improving moves after which an order is good enough."""
    many_ends: int = 1000
    """Ends of lanes above which paths are searched only nearby, and orders are improved by windows."""
    near: float = 8.0
    """[m] of a path that is searched among many ends."""
    window: int = 160
    """Lanes improved together when there are many."""


@dataclass(frozen=True, kw_only=True)
class PrioritySettings:
    """What comes first; set with `python -m benchmarks.doubt_first`."""

    bands: int = 4
    """Levels of priority, driven one after the other."""
    median_radius: float = 0.75
    """[m] within which a cell takes the median band: scattered cells cost more driving than they are worth."""
    value_range: float = 3.0
    """How much more than the last bin the first one is worth to a car's search."""


@dataclass(frozen=True, kw_only=True)
class CheckSettings:
    """What counts as a violation; set by the rounding of trajectory.csv (6 decimals at 50 Hz)."""

    limit_share: float = 0.01
    """Share of a limit that may be exceeded."""
    slip: float = 2e-4
    """[m, rad] that a pose may differ from the integral of the twists over one sample."""
    anchor_stride: int = 10
    """Samples from one exact distance to the next. Between them a bound is used, unless it matters."""
    exact_margin: float = 0.01
    """[m] above the least exact distance within which bounds are replaced by exact distances."""


@dataclass(frozen=True, kw_only=True)
class LogSettings:
    """What a log needs of a drive."""

    dwell_periods: float = 1.25
    """Log periods that a drive stays in a heading bin, at least. One is enough for a log of any phase; a quarter more covers
    where the bin is entered and left between two samples of the planner (`python benchmarks/coverage_planners.py`)."""
    min_poses: float = 2.0
    """Logged poses of each passage through a bin below which a warning is given: one would be lost with its scan."""


@dataclass(frozen=True, kw_only=True)
class StartSettings:
    """What is said of a start; set with `python benchmarks/coverage_planners.py --arena --random 10 --first 1`."""

    min_dubins_share: float = 0.05
    """A start from which a Dubins car can cover a smaller share of the bins is refused."""
    warn_below: float = 0.99
    """A warning is given if the start reaches a smaller share of the places where the robot fits."""
    propose_above: float = 1.2
    """Another part of the arena is proposed if it is so many times as large as the one that the start reaches."""


@dataclass(frozen=True, kw_only=True)
class SectionSettings:
    """How a drive is cut; set with `sensorgraph plan office --battery 40` and the drives of `--drive dubins`."""

    max_stuck: int = 8
    """Places from which OMPL finds no path home, before that is said."""
    step_back: float = 2.0
    """[s] that each such place is earlier than the one before."""


JOIN_PLANNERS = (
    "RRTConnect", "BFMT", "BITstar", "BKPIECE1", "FMT", "InformedRRTstar", "KPIECE1", "LBKPIECE1", "RRT", "RRTstar", "SORRTstar",
)  # fmt: skip
"""Planners of ompl.geometric 2.0.1 in Python; the first is used unless another is asked for. Not PRM and PRMstar, whose threads
never end when they call Python, nor AORRTC, which crashes."""
REACH = ReachSettings()
ROOMS = RoomSettings()
TOURS = TourSettings()
PRIORITY = PrioritySettings()
CHECK = CheckSettings()
SECTIONS = SectionSettings()
LOG = LogSettings()
STARTS = StartSettings()
