"""Motions end where they were told to, within every limit, and blends know where they end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planners.curve import Curve, CurveBuilder, duration, trapezoid
from planners.methods.spins import GUARD, choose_departure, least_sweep
from planners.trajectory import Trajectory, read_csv
from planners.vehicle import Limits

LIMITS = st.builds(
    Limits,
    v=st.floats(0.05, 2.0),
    omega=st.floats(0.1, 3.0),
    a=st.floats(0.1, 3.0),
    alpha=st.floats(0.2, 6.0),
)
STEPS = st.lists(
    st.tuples(st.booleans(), st.floats(-7.0, 7.0), st.floats(0.0, 1.0)), min_size=1, max_size=12
).filter(lambda steps: any(abs(size) > 1e-3 for _, size, _ in steps))


@given(distance=st.floats(-20, 20), top=st.floats(0.05, 3), rate=st.floats(0.05, 5))
def test_a_trapezoid_covers_its_distance_and_ends_at_rest(distance: float, top: float, rate: float) -> None:
    times, rates = trapezoid(distance, top, rate)
    speed = np.concatenate([[0.0], np.cumsum(times * rates)])
    assert speed[-1] == pytest.approx(0.0, abs=1e-9)
    assert abs(speed).max() <= top + 1e-9
    assert (abs(rates) <= rate + 1e-12).all()
    assert (0.5 * (speed[1:] + speed[:-1]) * times).sum() == pytest.approx(distance, abs=1e-8)
    assert times.sum() == pytest.approx(float(duration(distance, top, rate)), abs=1e-8)


def integrate(curve: Curve) -> np.ndarray:
    """Integrate the twists by the midpoint rule, in steps of a millisecond or less."""
    steps = 20_000 + int(1000 * curve.duration)
    dt = curve.duration / steps
    poses, twists, _ = curve.sample((np.arange(steps) + 0.5) * dt)
    phi = poses[:, 2]
    return np.array([(twists[:, 0] * np.cos(phi)).sum() * dt, (twists[:, 0] * np.sin(phi)).sum() * dt])


@settings(max_examples=40, deadline=None)
@given(limits=LIMITS, steps=STEPS)
def test_a_drawing_keeps_its_limits_and_ends_where_its_pen_is(
    limits: Limits, steps: list[tuple[bool, float, float]]
) -> None:
    pen = CurveBuilder(np.array([1.0, -2.0, 0.4]), limits)
    for is_turn, size, overlap in steps:
        if is_turn:
            pen.turn(size, overlap=overlap)
        else:
            pen.move(size, overlap=overlap)
    curve = pen.curve()
    stamps = np.linspace(0.0, curve.duration, 2000)
    poses, twists, _ = curve.sample(stamps)
    assert abs(twists[:, 0]).max() <= limits.v + 1e-7
    assert abs(twists[:, 1]).max() <= limits.omega + 1e-7
    change = abs(np.diff(twists, axis=0)) / np.diff(stamps)[:, None]
    assert change[:, 0].max() <= limits.a * (1 + 1e-6) + 1e-5
    assert change[:, 1].max() <= limits.alpha * (1 + 1e-6) + 1e-5
    np.testing.assert_allclose(poses[-1, :2], pen.pose[:2], atol=1e-7)
    assert np.cos(poses[-1, 2] - pen.pose[2]) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(integrate(curve), poses[-1, :2] - poses[0, :2], atol=2e-4)  # midpoint rule


def test_without_overlap_moves_and_turns_are_exact() -> None:
    pen = CurveBuilder(np.zeros(3), Limits())
    for _ in range(4):
        pen.move(1.5)
        pen.turn(np.pi / 2)
    np.testing.assert_allclose(pen.pose, [0, 0, 2 * np.pi], atol=1e-12)
    assert pen.curve().duration == pytest.approx(4 * (1.5 / 0.4 + 0.8 + np.pi / 2 + 0.5))


def test_overlap_saves_its_time_and_costs_millimetres() -> None:
    ends, times = [], []
    for overlap in (0.0, 0.5):
        pen = CurveBuilder(np.zeros(3), Limits())
        for _ in range(10):
            pen.move(0.25, overlap=overlap)
            pen.turn(np.pi, overlap=overlap)
            pen.move(0.25, overlap=overlap)
            pen.turn(-np.pi, overlap=overlap)
        ends.append(pen.pose)
        times.append(pen.clock)
    assert times[0] - times[1] == pytest.approx(39 * 0.5, abs=1e-6)
    assert np.hypot(*(ends[1] - ends[0])[:2]) < 40 * 0.004


@settings(max_examples=200, deadline=None)
@given(
    phi=st.floats(-10, 10),
    missing=st.lists(st.integers(0, 15), min_size=1, max_size=16, unique=True),
    direction=st.sampled_from([1, -1]),
)
def test_the_least_sweep_passes_every_heading_and_none_shorter_does(
    phi: float, missing: list[int], direction: int
) -> None:
    need = np.zeros(16, dtype=bool)
    need[missing] = True
    width = 2 * np.pi / 16
    sweep = least_sweep(phi, need, direction)
    swept = phi + direction * np.linspace(0.0, sweep, 20_001)
    met = np.unique(np.floor(swept / width + 0.5).astype(int) % 16)
    assert np.isin(missing, met).all()
    if sweep > 0:
        shorter = swept[: int(20_001 * max(1 - 1.01 * GUARD * width / sweep, 0))]
        met = np.unique(np.floor(shorter / width + 0.5).astype(int) % 16) if len(shorter) else []
        here = int(np.floor(phi / width + 0.5)) % 16
        assert not np.isin(missing, met).all() or need[here]


@settings(max_examples=100, deadline=None)
@given(
    phi=st.floats(-3, 3),
    way=st.floats(0.1, 3.0),
    bearing=st.floats(-3, 3),
    overlap=st.sampled_from([0.0, 0.5]),
    spins=st.booleans(),
)
def test_aiming_hits_the_target_through_the_blends(
    phi: float, way: float, bearing: float, overlap: float, spins: bool
) -> None:
    pen = CurveBuilder(np.array([0.0, 0.0, phi]), Limits())
    pen.move(0.3)
    target = pen.pose[:2] + way * np.array([np.cos(bearing), np.sin(bearing)])
    chosen = choose_departure(pen, target, np.ones(16, dtype=bool) if spins else None, (overlap, overlap))
    pen.turn(chosen.angle, overlap=overlap)
    pen.move(chosen.distance, overlap=overlap)
    np.testing.assert_allclose(pen.pose[:2], target, atol=2e-4)  # the blends' few mm, found by iteration
    if spins:
        assert abs(chosen.angle) >= 2 * np.pi * 14 / 16


def test_samples_are_at_fifty_hertz_and_survive_the_file(tmp_path: Path) -> None:
    pen = CurveBuilder(np.array([0.1, 0.2, 3.0]), Limits())
    pen.move(1.0)
    pen.turn(1.0, "spin")
    trajectory = pen.curve().trajectory()
    assert np.diff(trajectory.stamps).max() <= 0.02 + 1e-9
    assert trajectory.twists[-1].tolist() == [0.0, 0.0]
    path = tmp_path / "t.csv"
    trajectory.write_csv(path)
    again = read_csv(path)
    for name in ("stamps", "poses", "twists"):
        np.testing.assert_allclose(getattr(again, name), getattr(trajectory, name), atol=5.1e-7)  # six digits
    assert isinstance(again, Trajectory)
    assert set(again.primitives) == {"move", "spin"}


def test_a_primitive_may_have_any_name(tmp_path: Path) -> None:
    odd = np.array(['a "b", c', "lane", ""])
    drawn = Trajectory(
        stamps=np.arange(3.0), poses=np.full((3, 3), -1e-9), twists=np.zeros((3, 2)), primitives=odd
    )
    drawn.write_csv(tmp_path / "t.csv")
    assert read_csv(tmp_path / "t.csv").primitives.tolist() == ['a "b", c', "lane", "move"]


def test_nothing_drawn_is_an_error() -> None:
    with pytest.raises(ValueError, match="the curve is empty"):
        CurveBuilder(np.zeros(3), Limits()).curve()
