"""A located drive that another place explains as well is ambiguous; a drive that only one place explains is not."""

from __future__ import annotations

import numpy as np
import pytest
from localization_samples import ROOM, loop_poses, room_run

from sensorgraph.localization.front_end import track
from sensorgraph.localization.known_map import known_map
from sensorgraph.localization.map_tracking import MapTracker
from sensorgraph.localization.rival_places import rivals_of_drives
from sensorgraph.localization.scans import scan_points
from sensorgraph.types import no_progress

SHIFT = 20.0
"""[m] Distance between a room and its twin."""
TRUTH = loop_poses(60)
TWIN = [(x0 + SHIFT, y0, x1 + SHIFT, y1) for x0, y0, x1, y1 in ROOM]
WITHOUT_NICHE = [*TWIN[:4], (5 + SHIFT, 6, SHIFT, 6), *TWIN[9:]]


def tracked(walls: list[tuple[float, ...]]) -> MapTracker:
    """Return the tracker of a drive through the first room that was, after a search missed the other, found there alone."""
    run = room_run(TRUTH)
    scans = scan_points(run)
    tracker = MapTracker(
        scans,
        run.stamps,
        track(scans, run.stamps, None, no_progress),
        known_map(np.array(walls).reshape(-1, 2, 2)),
    )
    tracker.poses[:], tracker.breaks[:] = TRUTH, False
    return tracker


def silent(done: int, total: int | None) -> None:
    """Show no progress."""


def test_drive_in_one_of_two_equal_rooms_has_the_other_as_rival() -> None:
    is_rivalled, places = rivals_of_drives(tracked([*ROOM, *TWIN]), silent)
    assert is_rivalled.all()
    own, other = places[len(TRUTH) - 1]
    assert own == pytest.approx(TRUTH[-1])
    assert np.hypot(*(other - own - [SHIFT, 0.0, 0.0])[:2]) < 0.02


def test_drive_in_a_room_whose_twin_differs_has_no_rival() -> None:
    is_rivalled, places = rivals_of_drives(tracked([*ROOM, *WITHOUT_NICHE]), silent)
    assert not is_rivalled.any() and not places


def test_drives_on_both_sides_of_a_break_are_compared_separately() -> None:
    tracker = tracked([*ROOM, *TWIN])
    tracker.breaks[30] = True
    tracker.poses[:30] = np.nan  # not found
    is_rivalled, places = rivals_of_drives(tracker, silent)
    assert not is_rivalled[:30].any() and is_rivalled[30:].all() and list(places) == [len(TRUTH) - 1]
