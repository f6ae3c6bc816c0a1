"""Effort and preferences of the search, by vehicle, with the command that set them."""

from __future__ import annotations

from typing import NamedTuple


class SearchSettings(NamedTuple):
    """Effort and preferences of one search.

    Set by driving time over reference time against processor time, as printed by
    `python -m benchmarks.coverage_planners --arena --random 10 --first 1` (random offices for development)
    and by `--arena square office`. The search is chaotic: differences below 3 % of the driving time are
    noise.
    """

    beam_width: int = 250
    """Number of states kept at each unit of time."""
    executed: float = 0.19
    """Share of a full turn for which the best sequence is executed before the next look-ahead."""
    completion_weight: float = 6.0
    """Additional value of a cell's last bin relative to its first, so that cells are completed before new
    ones begin."""
    goal_width: int = 400
    """Number of states that the search for the nearest bin keeps at each unit of time."""
    guided_width: int = 0
    """Number of states kept at each unit of time when a cost-to-go map guides the search for the nearest bin;
    0: no guided search. If the guided search fails, it is repeated with `goal_width` and without the map."""


SPIN_ROOM = SearchSettings()
"""For robots that turn in place. One wide beam finds shorter drives than two narrow ones in the same time."""
CAR_ROOM = {
    "reeds_shepp": SearchSettings(
        beam_width=50, executed=0.51, completion_weight=0.5, goal_width=300, guided_width=8
    ),
    "dubins": SearchSettings(beam_width=120, executed=0.38, completion_weight=0.5, goal_width=1500),
}
"""For cars, by drive (`--drive reeds_shepp`, `--drive dubins`). Beams are narrow because the drive is
shortened later."""
