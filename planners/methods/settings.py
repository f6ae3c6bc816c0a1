"""The tuned numbers of the planners: what they mean, and the command that set them.

Unless said otherwise they were set with `python benchmarks/coverage_planners.py --arena --random 10 --first 1` (random
offices for development, each `--drive`) and `--arena square office`: coverage, driving time and planning time.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class CoverageSettings:
    """How searches of rooms become a drive."""

    retry_dwell: tuple[float, ...] = (1.3, 1.6)
    """Log periods to stay in bins that a log of some phase missed, at the first and the second try."""
    missed_bin_cost: float = 4.0
    """[s] that a bin costs which a search leaves to the repair, when searches of a room are compared."""
    open_share: float = 0.25
    """Cells of which earlier runs have left a larger share of the bins are covered anew (`python -m benchmarks.resumed`)."""
    scattered_share: float = 0.75
    """If more than half of the missing bins lie in cells of which at most this share is missing, stops are planned in place of a
    search (likewise)."""
    few_missing: float = 0.03
    """If a smaller share of the bins is missing, detours are tried before the repair."""


@dataclass(frozen=True, kw_only=True)
class CarRepairSettings:
    """How a car's drive is completed."""

    max_idle_queries: int = 12
    """Queries in a row that leave no fewer bins missing, before the rest is given up. A path from before the end of the
    drive may cut bins off, so the count can rise for a while."""
    step_back: tuple[float, ...] = (4.0, 16.0, 64.0, 256.0)
    """[s] before the end of a drive from where a path is tried, if none leads on from the end."""
    search_from: int = 12
    """Missing bins nearby from which on the search takes over from OMPL."""
    max_searches: int = 3
    """Times that one bin is searched for."""
    search_radius: float = 3.0
    """[m] within which missing bins count as nearby."""
    goal_offset: float = 0.3
    """Goals within a bin lie at its middle, and this share of its width and height beside it."""
    few_goals: int = 9
    """Goals of a bin when many bins are missing: those of its middle heading."""


@dataclass(frozen=True, kw_only=True)
class SpinRepairSettings:
    """How the drive of a robot that turns in place is completed."""

    max_visits: int = 2
    """Times that the robot stops in one cell for what is missing there."""


@dataclass(frozen=True, kw_only=True)
class StopAndSpinSettings:
    """The planner `stop_and_spin` (`--planner stop_and_spin`)."""

    overlap: float = 0.5
    """[s] that turns and moves overlap where there is room."""
    blend_room: float = 0.012
    """[m] beyond the clearance that the blend of a move and a turn needs."""
    near_share: float = 0.75
    """Cells with this share of the area that counts as reachable are visited, too: another raster may count them."""
    max_rounds: int = 4
    """Times that bins which a log may miss are visited again."""
    step_back: tuple[int, ...] = (1, 4, 16, 64)
    """Stops to go back when no path leads on."""


@dataclass(frozen=True, kw_only=True)
class SpinSettings:
    """Spins on the spot, in shares of a heading bin's width unless said otherwise."""

    guard: float = 0.1
    """How far into its last bin a spin goes, at least."""
    border: float = 0.02
    """An arrival this close to the border of a bin does not cover it."""
    zigzag: float = 0.22
    """Moves of a lane lean this far left and right in turn, and spins save twice that."""
    max_reverse: float = 0.8
    """[m] longest move that is driven backward to save turning."""


@dataclass(frozen=True, kw_only=True)
class BaselineSettings:
    """Random bounce and wall following; set so that neither gets stuck in the square (`--race square office`)."""

    min_bounce: float = 0.05
    """[m] that must be free ahead after a bounce."""
    wall_distance: float = 0.15
    """[m] beyond the clearance at which walls are followed."""


@dataclass(frozen=True, kw_only=True)
class OverviewSettings:
    """The first minutes of an anytime plan; set by `python -m benchmarks.error_by_minutes --arena office` (seed 1)."""

    share: float = 0.03
    """Of the reference time that the rounds of views take together."""
    spin_share: float = 0.135
    """Of the reference time at which the last round of spins ends: with more the office takes more than 1.25 of it."""
    first_round: float = 100.0
    """[s] of the first round."""
    growth: float = 1.0
    """Length of each later round of views, as a share of all that was driven before."""
    spin_growth: float = 0.5
    """The same of rounds of spins."""
    candidates: int = 2500
    """Scans to choose from."""
    looks: int = 4
    """Scans of a spin that count when it is chosen."""
    turn: float = 3.0
    """[rad] by which a robot turns at a view and on its way there, on average."""
    look_period: float = 0.2
    """[s] between scans of a drive that count as seen."""


@dataclass(frozen=True, kw_only=True)
class AnytimeSettings:
    """How an anytime plan begins that knows no sensor; set by `python -m benchmarks.coverage_planners --order anytime`."""

    block: float = 3.0
    """[m] side of blocks: without a survey, one cell of each is completed before all cells are."""


COVERAGE = CoverageSettings()
OVERVIEW = OverviewSettings()
ANYTIME = AnytimeSettings()
CAR_REPAIR = CarRepairSettings()
SPIN_REPAIR = SpinRepairSettings()
STOP_AND_SPIN = StopAndSpinSettings()
SPINS = SpinSettings()
BASELINES = BaselineSettings()
