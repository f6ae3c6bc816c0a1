"""The tuned numbers of the search: what they mean, and the command that set them.

Some are constants of compiled code. `planners.kernel` compiles anew after a change of any file that names it, as this one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """How much one search tries, and what it prefers.

    Set by driving time over its reference against processor time, as printed by
    `python benchmarks/coverage_planners.py --arena --random 10 --first 1` (random offices for development) and by
    `--arena square office`. A search is chaotic: differences below 3 % of the driving time are noise.
    """

    beam_width: int = 100
    """States kept at each unit of time."""
    horizon: float = 6.3
    """[s] looked ahead: one revolution at 1 rad/s. Longer horizons put off what is near."""
    executed: float = 1.6
    """[s] driven of the best sequence before the search looks ahead again."""
    discount: float = 0.19
    """Share of a bin's value that is lost over the whole horizon."""
    goal_pull: float = 0.5
    """Value of ending one cell nearer to the nearest missing bin."""
    completion_weight: float = 6.0
    """How much more a cell's last bin is worth than its first, so that cells are finished before new ones are begun."""
    overtime: float = 0.25
    """Value of ending one unit of time earlier, among sequences that run past the horizon."""
    min_bins: int = 3
    """If the beam wins fewer bins, the nearest missing bin is searched for instead."""
    goal_horizon: int = 96
    """Units of time that the search for the nearest bin looks ahead."""
    goal_width: int = 1500
    """States that the search for the nearest bin keeps at each unit of time."""
    goal_max_states: int = 300_000
    """States after which the search for the nearest bin gives up."""
    guided_width: int = 0
    """States kept at each unit of time when a cost-to-go map guides the search for the nearest bin; if that fails, it is
    repeated with `goal_width` and without the map. 0: no guided search."""
    lattice: float = 0.03
    """[m] Positions closer than this count as the same state."""
    value_noise: float = 0.1
    """Random share by which the values of cells differ from seed to seed."""
    inner_dwell: float = 0.85
    """Share of a log period to stay in the inner half of a bin; the way out of the bin takes the rest."""
    max_skipped_cells: int = 16
    """Unreachable cells that a search gives up, one after the other, before it ends."""


SPIN_ROOM = SearchSettings(beam_width=250, executed=1.2, goal_width=400, goal_horizon=300)
"""For robots that turn in place. One wide beam finds shorter drives than two narrow ones in the same time."""
SPIN_ONLY_ROOM = replace(SPIN_ROOM, beam_width=150)
"""The same for a floor of one room. It is searched twice, since a processor would be idle, so the beam is narrower."""
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
"""For cars, by drive (`--drive reeds_shepp`, `--drive dubins`). Beams are narrow because the drive is shortened afterwards."""


@dataclass(frozen=True, kw_only=True)
class AreaSettings:
    """What of a floor a search sees; set with `python benchmarks/coverage_planners.py` and `benchmarks/tracking_error.py`."""

    min_inner_share: float = 0.12
    """If this share of a cell's inner half can be reached, its bins count only there, else anywhere in the cell."""
    margin_cells: int = 8
    """Cells around a room that the search may drive through."""


AREA = AreaSettings()


@dataclass(frozen=True, kw_only=True)
class PrimitiveSettings:
    """How finely the robot's motion is cut into primitives; set with `python benchmarks/coverage_planners.py`."""

    max_duration: float = 0.5
    """[s] of a primitive of a robot that turns in place."""
    max_levels: int = 6
    """Levels of speed, forward and backward each."""
    max_arc: float = 0.2
    """[m] of a car's primitive."""
    gear_change_cost: float = 0.75
    """Cost of a change of gear, as a share of v/a, the time that stopping and starting adds to a drive."""
    reeds_shepp_depth: int = 1
    """Primitives that must be drivable after a state for it to count as safe, for a car that can reverse ..."""
    dubins_depth: int = 25
    """... and for one that cannot: with fewer it is trapped in front of walls."""


PRIMITIVES = PrimitiveSettings()


@dataclass(frozen=True, kw_only=True)
class KernelSettings:
    """Numbers that are compiled into the kernels; limits of work were set so that no plan of the benchmarks meets them.

    See `python benchmarks/coverage_planners.py` and `python -m benchmarks.large_floor`.
    """

    samples: int = 8
    """Poses at which a primitive is tested for clearance and for its bins."""
    max_bins: int = 3
    """Bins that one primitive may cover."""
    stop_margin: float = 0.003
    """[m] A stop covers its bin only if it is this far inside the cell, so that rounding cannot move it out."""
    max_escape_tries: int = 3000
    """Primitives tried before a state counts as one from which the robot cannot go on."""
    max_stop_primitives: int = 24
    """Primitives within which the robot must come to rest at the end of a search."""
    goal_room: int = 8
    """The search for the nearest bin holds so many times its width of states for each unit of time."""
    decisions_per_tick: int = 20
    """Decisions between two reports of progress."""
    phases: int = 10
    """Phases of the log's clock for which every bin must be met."""
    min_closed_form_turn: float = 0.05
    """[rad] and [rad/s] above which the closed form of an arc loses no precision; below, quadrature is used."""


KERNELS = KernelSettings()


@dataclass(frozen=True, kw_only=True)
class HeuristicSettings:
    """The lattice of the cost-to-go map that guides a car to the nearest bin.

    Set with `python benchmarks/coverage_planners.py --drive reeds_shepp --arena square office` (column `cpu`).
    """

    points_per_cell: int = 4
    """Lattice points along the side of a cell."""
    window_radius: float = 1.2
    """[m] around the car that the map covers."""
    clearance_slack: float = 0.02
    """[m] that a lattice point may be too near to a wall, since the poses beside it may be clear."""
    overrun: int = 6
    """Units of time that the wave goes on after it has reached the car."""
    rim: int = 5
    """Points along the border of the window that stay empty; more than a primitive is long."""
    roundings: int = 16
    """Ways in which the end of a primitive is rounded to the lattice, by turns, so that the errors average out."""


HEURISTIC = HeuristicSettings()
