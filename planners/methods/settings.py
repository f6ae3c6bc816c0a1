"""Tuned parameters of the planners, with the command that set each.

Unless stated otherwise they were set with
`python -m benchmarks.coverage_planners --arena --random 10 --first 1` (random offices for development, each
`--drive`) and `--arena square office`: coverage, driving time and planning time.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class CoverageSettings:
    """Composition of a drive from the searches of rooms."""

    retry_dwell: tuple[float, ...] = (1.3, 1.6)
    """Minimum stay [log periods] in bins that a log of some phase missed, at the first and the second retry."""
    missed_bin_cost: float = 4.0
    """[s] Cost of a bin that a search leaves to the repair, when searches of a room are compared."""
    open_share: float = 0.25
    """Maximum share of missing bins after earlier runs; cells above it are covered again as a whole
(`python -m benchmarks.resumed`)."""
    scattered_share: float = 0.75
    """If more than half of the missing bins are in cells with at most this share missing, stops are planned
    instead of a search (`python -m benchmarks.resumed`)."""
    few_missing: float = 0.03
    """If a smaller share of the bins is missing, detours are tried before the repair."""


@dataclass(frozen=True, kw_only=True)
class CarRepairSettings:
    """Completion of a car's drive."""

    max_idle_queries: int = 12
    """Maximum number of successive queries that leave no fewer bins missing. A path from before the end of
    the drive may remove bins, so the number of missing bins can rise temporarily."""
    step_back: tuple[float, ...] = (4.0, 16.0, 64.0, 256.0)
    """[s] before the end of the drive, from which a path is tried if none starts at the end."""
    search_from: int = 12
    """Number of missing bins nearby, at and above which the search replaces OMPL."""
    max_searches: int = 3
    """Maximum number of searches for one bin."""
    search_radius: float = 3.0
    """[m] radius in which missing bins count as nearby."""
    goal_offset: float = 0.3
    """Offset of goals from the middle of a bin, as a share of its width and height."""
    few_goals: int = 9
    """Number of goals per bin if many bins are missing: those at its middle heading."""


@dataclass(frozen=True, kw_only=True)
class SpinRepairSettings:
    """Completion of the drive of a robot that turns in place."""

    max_visits: int = 2
    """Maximum number of stops in one cell for its missing headings."""


@dataclass(frozen=True, kw_only=True)
class StopAndSpinSettings:
    """The planner `stop_and_spin` (`--planner stop_and_spin`)."""

    overlap: float = 0.5
    """[s] overlap of turns and moves where there is enough free space."""
    blend_room: float = 0.012
    """[m] beyond the clearance that the blend of a move and a turn needs."""
    near_share: float = 0.75
    """Share of the area required for reachability, above which cells are visited too: another raster may count them."""
    max_rounds: int = 4
    """Maximum number of extra rounds for bins that a log may miss."""
    step_back: tuple[int, ...] = (1, 4, 16, 64)
    """Numbers of stops to go back when no path leads on."""


@dataclass(frozen=True, kw_only=True)
class SpinSettings:
    """Spins on the spot, in shares of a heading bin's width unless stated otherwise."""

    guard: float = 0.1
    """Minimum depth to which a spin enters its last bin."""
    border: float = 0.02
    """An arrival closer than this to the border of a bin does not cover it."""
    zigzag: float = 0.22
    """Alternating lean of a lane's moves to the left and right; each spin is shorter by twice that."""
    max_reverse: float = 0.8
    """[m] maximum length of a move driven backward to save turning."""


@dataclass(frozen=True, kw_only=True)
class BaselineSettings:
    """Random bounce and wall following; set so that neither gets stuck in the square (`--race square office`)."""

    min_bounce: float = 0.05
    """[m] minimum free distance ahead after a bounce."""
    wall_distance: float = 0.15
    """[m] beyond the clearance, the distance of wall following."""


@dataclass(frozen=True, kw_only=True)
class OverviewSettings:
    """The first minutes of an anytime plan.

    Set with `python -m benchmarks.error_by_minutes --arena office` (seed 1).
    """

    share: float = 0.03
    """Total duration of the rounds of views, as a share of the reference time."""
    spin_share: float = 0.135
    """End of the last round of spins, as a share of the reference time; with more, the office takes more than
    1.25 of it."""
    first_round: float = 100.0
    """[s] duration of the first round; each later one lasts as long as the drive before it."""
    spin_growth: float = 0.5
    """Duration of each round of spins, as a share of the drive before it."""
    candidates: int = 2500
    """Number of candidate scans."""
    looks: int = 4
    """Number of scans of a spin that are evaluated when it is chosen."""
    turn: float = 3.0
    """[rad] mean angle that a robot turns at a view and on the route to it."""
    look_period: float = 0.2
    """[s] between scans of a drive that are marked as seen."""


@dataclass(frozen=True, kw_only=True)
class AnytimeSettings:
    """An anytime plan without a sensor model.

    Set with `python -m benchmarks.coverage_planners --order anytime`.
    """

    block: float = 3.0
    """[m] side of blocks: without a survey, one cell of each block is completed before all others."""


COVERAGE = CoverageSettings()
OVERVIEW = OverviewSettings()
ANYTIME = AnytimeSettings()
CAR_REPAIR = CarRepairSettings()
SPIN_REPAIR = SpinRepairSettings()
STOP_AND_SPIN = StopAndSpinSettings()
SPINS = SpinSettings()
BASELINES = BaselineSettings()
