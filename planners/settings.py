"""Tuned parameters of the floor raster, tours, priorities and checks, with the command that set each.

The subpackages have their own: `search.settings`, `cars.settings`, `joins.settings`, `methods.settings`.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ReachSettings:
    """The raster of free space; set with `python -m benchmarks.coverage_planners` (clearance, coverage, memory)."""

    step: float = 0.02
    """[m] Upper bound of the node spacing; reduced so that a cell is a whole number of steps."""
    max_nodes: int = 6_000_000
    """Maximum number of raster nodes; a larger floor gets a larger step."""
    max_cells: int = 1_000_000
    """Maximum number of grid cells; larger grids are rejected."""
    distance_cap: float = 0.45
    """[m] beyond the clearance, at which distances to walls are capped."""
    min_share: float = 0.04
    """Minimum reachable share of a cell's area for the cell to count as reachable."""


@dataclass(frozen=True, kw_only=True)
class RoomSettings:
    """Division of a floor into rooms.

    Set with `python -m benchmarks.coverage_planners --arena --random 10 --first 1`.
    """

    passage: float = 0.25
    """[m] beyond the clearance; a passage narrower than this separates two rooms."""
    min_cells: int = 60
    """Minimum number of cells of a room; smaller rooms are merged with a neighbour."""
    max_cells: int = 900
    """Maximum number of cells of a room; larger rooms are halved."""


@dataclass(frozen=True, kw_only=True)
class TourSettings:
    """Effort spent on the order of lanes.

    Set with `python -m benchmarks.coverage_planners --planner stop_and_spin` and
    `python -m benchmarks.coverage_planners --large 50 36`.
    """

    kicks: int = 60
    """Random perturbations of a finished order; each is kept if it shortens the tour."""
    max_moves: int = 4000
    """Maximum number of improving moves."""
    many_ends: int = 1000
    """Number of lane ends above which paths are searched only nearby and orders are improved by windows."""
    near: float = 8.0
    """[m] Search radius of a path when there are many lane ends."""
    window: int = 160
    """Number of lanes improved together when there are many lane ends."""


@dataclass(frozen=True, kw_only=True)
class PrioritySettings:
    """Order by priority; set with `python -m benchmarks.doubt_first`."""

    bands: int = 4
    """Number of priority levels, driven one after the other."""
    median_radius: float = 0.75
    """[m] Radius of the median filter over bands: scattered cells cost more driving than they are worth."""
    value_range: float = 3.0
    """Value of the bin of highest priority minus that of lowest, for a car's search; the lowest is worth 1."""


@dataclass(frozen=True, kw_only=True)
class CheckSettings:
    """Tolerances of a violation; set by the rounding of trajectory.csv (6 decimals at 50 Hz)."""

    limit_share: float = 0.01
    """Share of a limit by which it may be exceeded."""
    slip: float = 2e-4
    """[m, rad] Maximum difference of a pose from the integral of the twists over one sample."""
    anchor_stride: int = 10
    """Samples between two exact distances. Between them a lower bound is used where it suffices."""
    exact_margin: float = 0.01
    """[m] above the smallest exact distance, within which bounds are replaced by exact distances."""


@dataclass(frozen=True, kw_only=True)
class LogSettings:
    """Requirements of the log on a drive."""

    dwell_periods: float = 1.25
    """Minimum stay in a heading bin, in log periods. One period suffices for a log of any phase; the extra
    quarter covers the sampling error of entry and exit times (`python -m benchmarks.coverage_planners`)."""
    min_poses: float = 2.0
    """Logged poses per passage through a bin, below which a warning is given: one lost scan would lose the bin."""


@dataclass(frozen=True, kw_only=True)
class StartSettings:
    """Checks of the start pose.

    Set with `python -m benchmarks.coverage_planners --arena --random 10 --first 1`.
    """

    min_dubins_share: float = 0.05
    """Minimum share of the bins that a Dubins car must cover from its start; other starts are rejected."""
    warn_below: float = 0.99
    """A warning is given if the start reaches a smaller share of the places where the robot fits."""
    propose_above: float = 1.2
    """Minimum ratio of another part's area to the part of the start, above which the other part is proposed."""


@dataclass(frozen=True, kw_only=True)
class SectionSettings:
    """Cutting of a drive; set with `sensorgraph plan office --battery 40` and the drives of `--drive dubins`."""

    max_stuck: int = 8
    """Number of places without a path home after which the cut fails."""
    step_back: float = 2.0
    """[s] by which each attempt ends earlier than the one before."""


JOIN_PLANNERS = (
    "RRTConnect", "BFMT", "BITstar", "BKPIECE1", "FMT", "InformedRRTstar", "KPIECE1", "LBKPIECE1", "RRT", "RRTstar", "SORRTstar",
)  # fmt: skip
"""Planners of ompl.geometric 2.0.1 that run from Python; the first is the default.

Excluded: PRM and PRMstar, whose threads never end when they call Python, and AORRTC, which crashes."""
REACH = ReachSettings()
ROOMS = RoomSettings()
TOURS = TourSettings()
PRIORITY = PrioritySettings()
CHECK = CheckSettings()
SECTIONS = SectionSettings()
LOG = LogSettings()
STARTS = StartSettings()
