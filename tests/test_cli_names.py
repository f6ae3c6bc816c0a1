"""One name each: outputs by --out, rays by --ray or --bearing; help that lists all there is, on any terminal."""

from __future__ import annotations

import re

import numpy as np
import pytest

from logs.run import RangeSensor
from planners.planning import PLANNERS
from sensorgraph.cli import COMMANDS
from sensorgraph.cli import run as cli
from sensorgraph.errors import SensorgraphError
from sensorgraph.show.rays import chosen_ray, ray_at


def help_of(
    command: str, columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> str:
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("TERMINAL_WIDTH", str(columns))
    assert cli([command, "--help"] if command else ["--help"]) == 0
    return re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_cuts_no_word_at_40_columns(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = help_of(command, 40, monkeypatch, capsys)
    assert "…" not in text and "│" not in text
    assert not re.search(r"\w\.\.\.$", text, re.MULTILINE)
    long = [line for line in text.splitlines() if len(line) > 40]
    assert all(" " not in line.strip() or line.lstrip().startswith(("-", "Usage")) for line in long), long


def test_help_lists_every_planner(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = help_of("plan", 200, monkeypatch, capsys)
    for planner in PLANNERS:
        assert re.search(rf"\b{planner}\b", text), planner


@pytest.mark.parametrize(
    "command",
    ["demo", "plan", "recover", "build", "predict", "show", "review", "diagnose", "identify", "record"],
)
def test_every_command_that_writes_a_file_calls_it_out(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = help_of(command, 60, monkeypatch, capsys)
    assert "-o, --out " in text
    assert "--figure" not in text


@pytest.mark.parametrize(
    ("bearing", "ray"), [(0, 9), (90, 18), (-90, 0), (44, 13), (46, 14), (360, 9), (-450, 0)]
)
def test_a_bearing_counts_from_ahead_counter_clockwise(bearing: float, ray: int) -> None:
    ahead = np.radians(np.arange(-90, 91, 10))
    for yaw in (0.0, np.pi, -0.3):
        sensor = RangeSensor(
            bearings=ahead - yaw, range_min=0.1, range_max=8.0, mount=np.array([0.1, 0.0, yaw])
        )
        assert ray_at(sensor, bearing) == ray


def test_a_bearing_where_the_sensor_does_not_look_is_refused() -> None:
    sensor = RangeSensor(bearings=np.radians(np.arange(-90, 91, 10)), range_min=0.1, range_max=8.0)
    for bearing in (180.0, 101.0, float("nan"), float("inf")):
        with pytest.raises(SensorgraphError, match=r"looks from -90\.0° to 90\.0°"):
            ray_at(sensor, bearing)
    with pytest.raises(SensorgraphError, match="give one of them"):
        chosen_ray(sensor, 3, 0.0)
    assert chosen_ray(sensor, 3, None) == 3 and chosen_ray(sensor, None, None) is None
