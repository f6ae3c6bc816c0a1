"""Effort and preferences of the search, by vehicle, with the command that set them."""

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
    completion_weight: float = 6.0
    """Additional value of a cell's last bin relative to its first, so that cells are completed before new
    ones begin."""
    goal_horizon: int = 96
    """[units of time] horizon of the search for the nearest bin."""
    goal_width: int = 1500
    """Number of states that the search for the nearest bin keeps at each unit of time."""
    goal_max_states: int = 300_000
    """Maximum number of states of the search for the nearest bin."""
    guided_width: int = 0
    """Number of states kept at each unit of time when a cost-to-go map guides the search for the nearest bin;
    0: no guided search. If the guided search fails, it is repeated with `goal_width` and without the map."""


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
