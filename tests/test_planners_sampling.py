"""A log too slow for the bins of a drive is said."""

from __future__ import annotations

import re

import numpy as np
import pytest

from planners.report import sampling_warnings, steering_warnings
from planners.trajectory import Trajectory
from planners.vehicle import Limits, Vehicle

ROBOT = Vehicle()


GRID = {"cell": 0.5, "headings": 8}


def drive(v: float, omega: float) -> Trajectory:
    n = 10
    return Trajectory(
        stamps=np.arange(n) / 50.0,
        poses=np.zeros((n, 3)),
        twists=np.tile([v, omega], (n, 1)),
        primitives=np.full(n, "move"),
    )


@pytest.mark.parametrize(
    ("v", "omega", "rate", "sweep_time", "said"),
    [
        (0.4, 1.0, 10.0, 0.0, []),
        (0.4, 0.78, 4.0, 0.0, []),  # the paper's 4 Hz serve 22.5 degrees up to 0.785 rad/s
        (0.4, 0.79, 4.0, 0.0, ["heading bin"]),
        (0.51, 0.1, 4.0, 0.0, ["cell"]),
        (0.0, 1.9, 100.0, 0.1, []),
        (0.0, 2.0, 100.0, 0.1, ["half a heading bin"]),
        (0.49, 0.0, 100.0, 0.25, []),
        (0.51, 0.0, 100.0, 0.25, ["half a cell"]),
        (1.0, 4.0, 4.0, 0.15, ["cell", "heading bin", "half a cell", "half a heading bin"]),
    ],
)
def test_a_log_too_slow_for_the_bins_is_said(
    v: float, omega: float, rate: float, sweep_time: float, said: list[str]
) -> None:
    lines = sampling_warnings(drive(v, omega), cell=0.25, headings=16, rate=rate, sweep_time=sweep_time)
    assert len(lines) == len(said)
    assert all(word in line for word, line in zip(said, lines, strict=True))


def test_who_does_what_a_warning_says_is_not_warned_again() -> None:
    grid = {"cell": 0.25, "headings": 16, "sweep_time": 0.15}
    fast = " ".join(sampling_warnings(drive(1.3, 4.0), rate=4.0, **grid))
    rates = [float(number) for number in re.findall(r"log at (\S+) Hz", fast)]
    speeds = [float(number) for number in re.findall(r"drive at (\S+) m/s", fast)]
    spins = [float(number) for number in re.findall(r"turn at (\S+) rad/s", fast)]
    assert (len(rates), len(speeds), len(spins)) == (2, 2, 2)
    assert not [
        line for line in sampling_warnings(drive(1.3, 4.0), rate=max(rates), **grid) if "log of" in line
    ]
    assert sampling_warnings(drive(min(speeds), min(spins)), rate=4.0, **grid) == []


@pytest.mark.parametrize(("v", "alpha"), [(0.4, 2.0), (0.2, 2.0), (0.4, 8.0)])
def test_a_car_that_steers_too_slowly_for_its_arcs_is_said_with_how_far_it_leaves_them(
    v: float, alpha: float
) -> None:
    """Arcs of 0.4 m to the right and to the left; the truth is integrated in small steps."""
    rate = v / 0.4
    arcs = drive(v, rate)
    arcs.twists[5:, 1] = -rate
    t = np.linspace(0.0, 2 * rate / alpha, 100_001)
    late = 2 * rate * t - alpha * t**2 / 2  # [rad]
    aside = float(np.trapezoid(v * late, t))
    car = Vehicle(drive="dubins", limits=Limits(alpha=alpha, turning_radius=0.4))
    lines = steering_warnings(arcs, car, 0.02)
    assert [f"about {aside:.2g} m off" in line for line in lines] == [True] * (aside > 0.02)
    assert steering_warnings(arcs, ROBOT, 0.02) == []
