"""Tuned parameters of the search, with the command that set each.

Some are constants of compiled code. `planners.kernel` compiles again after a change of their values.
"""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """Effort and preferences of one search.

    Set by driving time over reference time against processor time, as printed by
    `python -m benchmarks.coverage_planners --arena --random 10 --first 1` (random offices for development)
    and by `--arena square office`. The search is chaotic: differences below 3 % of the driving time are
    noise.
    """

    beam_width: int = 100
    """Number of states kept at each unit of time."""
    horizon: float = 6.3
    """[s] look-ahead: one revolution at 1 rad/s. With a longer horizon the search postpones near bins."""
    executed: float = 1.6
    """[s] executed of the best sequence before the next look-ahead."""
    discount: float = 0.19
    """Share of a bin's value that is lost over the whole horizon."""
    goal_pull: float = 0.5
    """Value of ending one cell nearer to the nearest missing bin."""
    completion_weight: float = 6.0
    """Additional value of a cell's last bin relative to its first, so that cells are completed before new
    ones begin."""
    overtime: float = 0.25
    """Value of ending one unit of time earlier, among sequences that exceed the horizon."""
    min_bins: int = 3
    """Minimum number of bins covered by the beam; below it, the nearest missing bin is searched for instead."""
    goal_horizon: int = 96
    """[units of time] horizon of the search for the nearest bin."""
    goal_width: int = 1500
    """Number of states that the search for the nearest bin keeps at each unit of time."""
    goal_max_states: int = 300_000
    """Maximum number of states of the search for the nearest bin."""
    guided_width: int = 0
    """Number of states kept at each unit of time when a cost-to-go map guides the search for the nearest bin;
    0: no guided search. If the guided search fails, it is repeated with `goal_width` and without the map."""
    lattice: float = 0.03
    """[m] side of a lattice cell; positions in one cell count as the same state."""
    value_noise: float = 0.1
    """Random share by which the values of cells differ between seeds."""
    inner_dwell: float = 0.85
    """Minimum stay in the inner half of a bin, as a share of the log period; the path out of the bin takes the rest."""
    max_skipped_cells: int = 16
    """Maximum number of unreachable cells that a search gives up."""


SPIN_ROOM = SearchSettings(beam_width=250, executed=1.2, goal_width=400, goal_horizon=300)
"""For robots that turn in place. One wide beam finds shorter drives than two narrow ones in the same time."""
SPIN_ONLY_ROOM = replace(SPIN_ROOM, beam_width=150)
"""The same for a floor of one room. It is searched twice, because a processor would be idle, so the beam is
narrower."""
CAR_ROOM = {
    "reeds_shepp": SearchSettings(
        executed=3.2,
        completion_weight=0.5,
        beam_width=50,
        goal_horizon=400,
        goal_width=300,
        goal_max_states=100_000,
        guided_width=8,
    ),
    "dubins": SearchSettings(executed=2.4, completion_weight=0.5, beam_width=120, goal_horizon=400),
}
"""For cars, by drive (`--drive reeds_shepp`, `--drive dubins`). Beams are narrow because the drive is
shortened later."""


@dataclass(frozen=True, kw_only=True)
class AreaSettings:
    """The area of a search.

    Set with `python -m benchmarks.coverage_planners` and `python -m benchmarks.tracking_error`.
    """

    min_inner_share: float = 0.12
    """Minimum reachable share of a cell's inner half for its bins to count only there; else they count everywhere."""
    margin_cells: int = 8
    """Number of cells around a room in which the search may drive."""


AREA = AreaSettings()


@dataclass(frozen=True, kw_only=True)
class PrimitiveSettings:
    """Resolution of the motion primitives; set with `python -m benchmarks.coverage_planners`."""

    max_duration: float = 0.5
    """[s] maximum duration of a primitive of a robot that turns in place."""
    max_levels: int = 6
    """Maximum number of speed levels in each direction."""
    max_arc: float = 0.2
    """[m] maximum length of a car's primitive."""
    gear_change_cost: float = 0.75
    """Cost of a gear change as a share of v / a, the time that stopping and starting add to a drive."""
    reeds_shepp_depth: int = 1
    """Number of primitives that must be able to follow a safe state, for a car that can reverse ..."""
    dubins_depth: int = 25
    """... and for one that cannot, which with fewer gets trapped in front of walls."""


PRIMITIVES = PrimitiveSettings()


@dataclass(frozen=True, kw_only=True)
class KernelSettings:
    """Constants compiled into the kernels; no plan of the benchmarks reaches the limits of work.

    See `python -m benchmarks.coverage_planners`, without options and with `--large 50 36`.
    """

    samples: int = 8
    """Number of poses at which a primitive is tested for clearance and bins."""
    max_bins: int = 3
    """Maximum number of bins that one primitive covers."""
    stop_margin: float = 0.003
    """[m] minimum distance of a stop from the border of its cell to cover its bin, so that rounding cannot
    move it out."""
    max_escape_tries: int = 3000
    """Maximum number of primitives tried before a state counts as unsafe."""
    max_stop_primitives: int = 24
    """Maximum number of primitives to come to rest at the end of a search."""
    goal_capacity: int = 8
    """Capacity of each unit of time in the search for the nearest bin, as a multiple of its width."""
    decisions_per_tick: int = 20
    """Number of decisions between two progress reports."""
    phases: int = 10
    """Number of phases of the log's clock for which every bin must be recorded."""
    min_closed_form_turn: float = 0.05
    """[rad] and [rad/s] above which the closed form of an arc keeps its precision; below, quadrature is used."""


KERNELS = KernelSettings()


@dataclass(frozen=True, kw_only=True)
class HeuristicSettings:
    """Lattice of the cost-to-go map that guides a car to the nearest bin.

    Set with `python -m benchmarks.coverage_planners --drive reeds_shepp --arena square office` (column `cpu`).
    """

    points_per_cell: int = 4
    """Number of lattice points along the side of a cell."""
    window_radius: float = 1.2
    """[m] radius of the map around the car."""
    clearance_slack: float = 0.02
    """[m] by which a lattice point may be too near to a wall, since poses next to it may be clear."""
    overrun: int = 6
    """[units of time] that the wave continues after it has reached the car."""
    rim: int = 5
    """Number of empty points along the border of the window; more than the length of a primitive."""
    roundings: int = 16
    """Number of roundings of a primitive's end to the lattice, used in turn so that the errors average out."""


HEURISTIC = HeuristicSettings()
