"""Shortcuts of a car's drive: a needless part goes, no bin is lost, walls are kept off, the checker finds nothing."""

from __future__ import annotations

import os

import numpy as np
import pytest
import shapely
from planners_samples import outlined

from planners.arena import Arena
from planners.cars.car_curve import curve_of_arcs
from planners.cars.shortcuts import shorten_drive
from planners.check import check
from planners.clearance import Barriers
from planners.coverage import Coverage
from planners.curve import Curve
from planners.reach import Reach, reach
from planners.search.log_phases import missed
from planners.task import Task
from planners.types import Bools, Floats
from planners.vehicle import Limits, Vehicle

LIMITS = Limits(turning_radius=0.4)
RATE = 10.0
FINE = 500.0
"""[Hz]"""


def ground(arena: Arena, drive: str) -> Task:
    barriers = Barriers(arena)
    free = reach(arena, barriers, clearance=0.22, cell=0.25)
    return Task(
        arena=arena,
        vehicle=Vehicle(drive=drive, limits=LIMITS),
        barriers=barriers,
        reach=free,
        coverage=Coverage.empty(origin=free.origin, cell=free.cell, cells=free.cells(), headings=16),
        start=None,
        seed=0,
        rate=RATE,
        priority=None,
        duration=None,
        progress=None,
    )


def drawn(start: tuple[float, float, float], *arcs: tuple[float, int, int]) -> Curve:
    """Draw arcs of length [m], bend and gear."""
    length, bend, gear = np.array(arcs).T
    return curve_of_arcs(np.array(start), length, bend, gear, LIMITS, LIMITS.v)


def won(curve: Curve, task: Task) -> Bools:
    """Return the bins that a log of any phase meets."""
    every = np.ones_like(task.coverage.reachable)
    return np.asarray(~missed(curve, every, task.coverage, RATE))


def crossed(curve: Curve, task: Task) -> Bools:
    """Return the bins that the car is in for 6 cm at a time: a log meets them whatever the speed."""
    poses = curve.log(FINE)
    bins, inside = task.coverage.bins(poses)
    assert inside.all()
    flat = np.ravel_multi_index(tuple(bins.T), task.coverage.reachable.shape)
    begins = np.flatnonzero(np.diff(flat, prepend=-1))
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    long = np.diff(way[begins], append=way[-1]) >= 0.06
    found = np.zeros_like(task.coverage.reachable)
    found.flat[flat[begins[long]]] = True
    return found


def best(curve: Curve, todo: Bools, task: Task) -> Curve:
    short, interrupted = shorten_drive(curve, todo, task, LIMITS.v)
    assert not interrupted
    return short


def ends(curve: Curve) -> Floats:
    return np.asarray(curve.sample(np.array([0.0, curve.duration]))[0])


HALL = outlined(shapely.box(0, 0, 8, 8))
LOOP = (2 * np.pi * 0.4, 1, 1)


@pytest.mark.parametrize("drive", ["dubins", "reeds_shepp"])
def test_a_loop_that_wins_nothing_wanted_is_left_out_and_one_that_does_is_driven(drive: str) -> None:
    task = ground(HALL, drive)
    straight = drawn((1.0, 4.0, 0.05), (2.0, 0, 1), (2.0, 0, 1))
    with_loop = drawn((1.0, 4.0, 0.05), (2.0, 0, 1), LOOP, (2.0, 0, 1))
    plain = best(with_loop, won(straight, task), task)
    assert plain.duration == pytest.approx(straight.duration, abs=0.02)
    kept = best(with_loop, won(with_loop, task), task)
    assert not (won(with_loop, task) & ~won(kept, task)).any()
    assert kept.duration > straight.duration + 3.0


def test_a_way_back_is_taken_if_it_is_quicker_and_the_car_has_a_reverse_gear() -> None:
    """A turn by half: by three arcs with reverse, by a loop without."""
    turned = drawn((3.0, 4.0, 0.05), (1.0, 0, 1), (4.2 * np.pi * 0.4 / 2, 1, 1), (1.0, 0, 1))
    none = np.zeros_like(ground(HALL, "dubins").coverage.reachable)
    there = best(turned, none, ground(HALL, "dubins"))
    with_reverse = best(turned, none, ground(HALL, "reeds_shepp"))
    assert with_reverse.duration < there.duration <= turned.duration


def test_no_way_leads_through_a_wall() -> None:
    """A detour round a long wall has a quick way across, but for the wall."""
    wall = shapely.box(2.0, 3.95, 6.0, 4.05)
    arcs = [
        (3.6, 0, 1),
        (np.pi * 0.7 * 0.4 / 0.7 / 2, 1, 1),
        (1.0, 0, 1),
        (np.pi * 0.4 / 2, 1, 1),
        (3.6, 0, 1),
    ]
    detour = drawn((3.2, 3.0, 0.0), *arcs)
    none = np.zeros_like(ground(HALL, "dubins").coverage.reachable)
    free = best(detour, none, ground(HALL, "dubins"))
    walled = best(detour, none, ground(outlined(shapely.box(0, 0, 8, 8).difference(wall)), "dubins"))
    arena = outlined(shapely.box(0, 0, 8, 8).difference(wall))
    assert free.duration < walled.duration - 1.0
    found = check(walled.trajectory(), arena, Vehicle(drive="dubins", limits=LIMITS))
    assert found.count == 0


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["dubins", "reeds_shepp"])
def test_a_random_drive_gets_shorter_keeps_every_bin_its_ends_and_the_rules(drive: str) -> None:
    rng = np.random.default_rng(5)
    arena = outlined(shapely.box(0, 0, 6, 5).difference(shapely.box(2.5, 2.0, 3.0, 3.0)))
    task = ground(arena, drive)
    curve = wandering(rng, task.reach, 2000, back=drive == "reeds_shepp")
    todo = task.coverage.reachable & crossed(curve, task)
    short = best(curve, todo, task)
    assert short.duration < 0.98 * curve.duration
    assert not (todo & ~won(short, task)).any()
    np.testing.assert_allclose(ends(short), ends(curve), atol=1e-9)
    assert check(short.trajectory(), arena, task.vehicle).count == 0


def wandering(rng: np.random.Generator, free: Reach, n: int, *, back: bool) -> Curve:
    """Drive at random, in a wide berth of the walls."""
    pose, arcs = np.array([1.2, 1.2, 0.1]), list[tuple[float, int, int]]()
    tries = 0
    while len(arcs) < n and tries < 100 * n:
        tries += 1
        arc = (
            float(rng.uniform(0.1, 0.5)),
            int(rng.integers(-1, 2)),
            int(rng.choice([1, 1, 1, -1])) if back else 1,
        )
        curve = curve_of_arcs(pose, *(np.array([part]) for part in arc), LIMITS, LIMITS.v)
        poses = curve.sample(np.linspace(0, curve.duration, 20))[0]
        node = np.floor((poses[:, :2] - free.origin) / free.step).astype(int)
        node = node.clip(0, np.array(free.distance.shape) - 1)
        if free.distance[tuple(node.T)].min() < 0.25:
            arcs = arcs[: max(len(arcs) - int(rng.integers(0, 6)), 0)]
            pose = (
                ends(curve_of_arcs(np.array([1.2, 1.2, 0.1]), *np.array(arcs).T, LIMITS, LIMITS.v))[1]
                if arcs
                else np.array([1.2, 1.2, 0.1])
            )
            continue
        arcs.append(arc)
        pose = poses[-1]
    assert len(arcs) == n
    return curve_of_arcs(np.array([1.2, 1.2, 0.1]), *np.array(arcs).T, LIMITS, LIMITS.v)


@pytest.mark.slow
def test_any_count_of_processors_gives_the_same_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    task = ground(outlined(shapely.box(0, 0, 6, 5)), "reeds_shepp")
    curve = wandering(np.random.default_rng(8), task.reach, 1500, back=True)
    todo = task.coverage.reachable & crossed(curve, task)
    found = []
    for count in (1, 3):
        monkeypatch.setattr(os, "cpu_count", lambda count=count: count)
        found.append(best(curve, todo, task))
    np.testing.assert_array_equal(found[0].poses, found[1].poses)
