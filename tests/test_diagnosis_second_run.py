"""A second run proves what the first one showed, or says that it does not."""

from __future__ import annotations

import pytest
from conftest import further
from scan_samples import ROOM_ROBOT, drive_in_room

from planners.arena import Arena
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.report.summary import summarise
from sensorgraph.world.robot import parse_robot


@pytest.mark.parametrize(
    ("first", "second", "said"),
    [
        (0.03, 0.03, "On the second run, which was not used in any fit, it shrinks from "),
        (0.0, 0.03, "The second run disagrees: its gap is "),
        *further(
            (
                0.03,
                0.0,
                "The second run disagrees: with the effects in the model its log-likelihood falls by ",
            ),
            (0.0, 0.0, ""),
        ),
    ],
    ids=["both have it", "the second has it", "the first has it", "neither has it"],
)
def test_what_the_second_run_says_of_a_bias(room: Arena, first: float, second: float, said: str) -> None:
    finding = diagnose(
        drive_in_room(room, bias=first),
        room,
        parse_robot(ROOM_ROBOT),
        second=drive_in_room(room, bias=second),
        plan_next=False,
    )
    about = [line for line in summarise(finding).details if "second run" in line]
    assert len(about) == bool(said) and all(line.startswith(said) for line in about)
    gap = finding.second_gap
    assert gap is not None
    assert (gap.after.nats_per_ray < gap.before.nats_per_ray) == (first > 0 and second > 0)
