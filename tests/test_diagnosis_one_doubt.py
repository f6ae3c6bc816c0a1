"""A clock of the odometry and a dead time that cancel: one cause, which neither is."""

from __future__ import annotations

from dataclasses import replace

import pytest
from conftest import further
from diagnosis_samples import ROBOT, make_run

from sensorgraph.diagnosis.diagnose import diagnose_motion


@pytest.mark.parametrize("shift", [-0.1, *further(0.1)])
def test_a_base_with_a_clock_of_its_own_is_one_doubt_and_no_two_names(shift: float) -> None:
    """Commands and odometry come from its computer: wheels follow commands, and poses do not follow wheels."""
    run = make_run(3)
    run = replace(run, odom_stamps=run.odom_stamps + shift, cmd_stamps=run.cmd_stamps + shift)
    odometry, drive = diagnose_motion(run, ROBOT, ())
    assert odometry.effects == drive.effects == ()
    assert odometry.unknown is not None and drive.unknown is None
    when = "after" if shift < 0 else "before"
    assert f"the poses come 100 ms {when} commands and odometry" in odometry.unknown.statement
    assert odometry.unknown.families[0].startswith("the clock of the base")


def test_a_clock_and_a_dead_time_of_other_sizes_keep_their_names() -> None:
    run = make_run(3, dead=0.1)
    run = replace(run, odom_stamps=run.odom_stamps + 0.05)
    odometry, drive = diagnose_motion(run, ROBOT, ())
    assert [a.name for a in odometry.effects] == ["pose_clock_offset"]
    assert [a.name for a in drive.effects] == ["dead_time"]
