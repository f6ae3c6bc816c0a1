"""Drive channel: silent on nothing and on wheel effects, right on lag, dead time and saturation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnosis_samples import ROBOT, make_run, without_commands, without_odometry

from sensorgraph.diagnosis.motion.drive_channel import diagnose_drive

PLANTED: list[tuple[str, dict[str, Any], str, float]] = [
    ("actuator_lag", {"lag": 0.06}, "tau", 0.06),
    ("dead_time", {"dead": 0.08}, "L", 0.08),
    ("speed_saturation", {"v_max": 0.30}, "v_max", 0.30),
]


def test_nothing_planted_nothing_named() -> None:
    for seed in (1, 2):
        result = diagnose_drive(make_run(seed), ROBOT)
        assert result.effects == () and result.unknown is None and result.skipped == ""


@pytest.mark.parametrize(("name", "effect", "key", "value"), PLANTED, ids=[p[0] for p in PLANTED])
def test_planted_effect_is_named_with_its_size(
    name: str, effect: dict[str, Any], key: str, value: float
) -> None:
    result = diagnose_drive(make_run(3, **effect), ROBOT)
    assert [a.name for a in result.effects] == [name] and result.unknown is None
    assert abs(result.effects[0][key] - value) < 3 * result.effects[0].stderr[key]


@pytest.mark.parametrize(
    "effect", [{"radius": 0.03}, {"diff": 0.02}, {"base": 0.04}, {"clock": 0.06}], ids=str
)
def test_wheel_effects_are_no_drive_effects(effect: dict[str, float]) -> None:
    assert diagnose_drive(make_run(4, **effect), ROBOT).effects == ()


@pytest.mark.parametrize(("column", "least"), [(1, 0.3), (0, 0.2)], ids=["turns", "ways"])
def test_motors_that_ignore_small_commands_are_unknown(column: int, least: float) -> None:
    """The run is driven by what the motors obey; the log shows what they were told beside it: 0.6 of `least`."""
    for seed in (5, 6):
        run = make_run(seed)
        told, still = run.commands.copy(), np.abs(run.commands[:, column]) < 1e-9
        shift = np.sign(np.sin(run.cmd_stamps / 3.0))
        told[still, column] = 0.6 * least * shift[still]
        result = diagnose_drive(replace(run, commands=told), ROBOT)
        assert result.unknown is not None and "small" in result.unknown.statement and result.effects == ()


def test_run_without_commands_or_odometry_is_skipped_with_reason() -> None:
    run = make_run(1, duration=10.0)
    assert "commands" in diagnose_drive(without_commands(run), ROBOT).skipped
    assert "odometry" in diagnose_drive(without_odometry(run), ROBOT).skipped
