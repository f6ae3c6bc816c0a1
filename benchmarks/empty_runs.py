"""Runs with nothing hidden, of robots unlike the shipped one: each name and each doubt is a false one.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.empty_runs --seeds 6

Plans a drive of each robot in an arena of its own, records it with our simulator once for every seed, diagnoses the
runs, and prints how many were given a name or a doubt.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import sensorgraph as sg
from benchmarks.arguments import parser_of
from benchmarks.hidden_effects.case import geojson as written
from benchmarks.measures import timed
from planners.maps import geojson
from sensorgraph.world.robot import parse_robot

Ring = list[tuple[float, float]]


@dataclass(frozen=True, kw_only=True)
class Setup:
    """A robot in an arena of its own."""

    robot: str
    """robot.yaml"""
    rings: dict[str, Ring]
    """[m] of the arena and its obstacles."""
    grid: dict[str, Any]
    """How `plan` divides poses."""
    berth: float = 0.0
    """[m] that the plan keeps from walls beyond its own margin: a robot that touches one has something to hide."""


def box(x: float, y: float, width: float, depth: float) -> Ring:
    """Return a rectangle from its lower left corner."""
    return [(x, y), (x + width, y), (x + width, y + depth), (x, y + depth)]


SETUPS = {
    # a TurtleBot3 Burger: small, slow, its laser sweeps while it spins
    "turtlebot": Setup(
        robot="""
name: burger
footprint_radius: 0.11
limits: {v: 0.22, omega: 2.84, a: 0.5, alpha: 3.0}
sensor: {mount: [-0.032, 0, 0], n_rays: 360, fov: 6.28318531, range_min: 0.12, range_max: 3.5, rate: 5, sweep_time: 0.2}
wheels: {radius: 0.033, base: 0.16}
""",
        rings={
            "arena": [(0, 0), (3.2, 0), (3.2, 1.4), (4.4, 1.4), (4.4, 3.0), (0, 3.0)],
            "box": box(1.2, 1.2, 0.5, 0.5),
            "post": box(2.6, 2.2, 0.2, 0.2),
        },
        grid={"cell": 0.4, "headings": 12},
    ),
    # a small car: cannot turn in place, 40 scans a second over 270 degrees
    "car": Setup(
        robot="""
name: car
drive: reeds_shepp
footprint_radius: 0.2
limits: {v: 0.7, omega: 1.6, a: 1.0, alpha: 12.0, turning_radius: 0.7}
sensor: {mount: [0.25, 0, 0], n_rays: 271, fov: 4.71238898, range_min: 0.06, range_max: 10, sigma: 0.02, rate: 40}
pose: {rate: 100, sigma_xy: 0.002, sigma_yaw: 0.002}
wheels: {radius: 0.05, base: 0.3, sigma_v: 0.01, sigma_omega: 0.02, rate: 50}
actuators: {tau: 0.06}
""",
        rings={
            "arena": [(0, 0), (8, 0), (8, 5), (5, 5), (5, 6.5), (0, 6.5)],
            "crate": box(3.2, 2.4, 0.8, 0.6),
            "barrel": box(6.0, 3.0, 0.4, 0.4),
        },
        grid={"cell": 0.5, "headings": 8},
        berth=0.2,
    ),
    # a toy with sixteen rays, twice a second, and coarse wheels
    "sixteen rays": Setup(
        robot="""
name: toy
footprint_radius: 0.07
limits: {v: 0.12, omega: 1.0, a: 0.2, alpha: 1.5}
sensor: {mount: [0, 0, 0], n_rays: 16, fov: 6.28318531, range_min: 0.03, range_max: 2.5, sigma: 0.015, rate: 2}
pose: {rate: 15, sigma_xy: 0.003, sigma_yaw: 0.004}
wheels: {radius: 0.02, base: 0.1, sigma_v: 0.005, sigma_omega: 0.05, rate: 10}
""",
        rings={
            "arena": [(0, 0), (2.2, 0), (2.2, 1.6), (1.2, 1.6), (1.2, 2.0), (0, 2.0)],
            "can": box(0.6, 0.7, 0.15, 0.15),
        },
        grid={"cell": 0.25, "headings": 8},
    ),
}


def main() -> None:
    """Plan once for each robot, record and diagnose once for each seed."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=6, help="runs of each robot")
    options = parser.parse_args()
    print(f"{'robot':14} {'minutes':>8} {'runs':>5} {'named':>6} {'doubted':>8} {'CPU s a run':>12}")
    for name, setup in SETUPS.items():
        arena, robot = geojson.loads(written("arena", setup.rings)), parse_robot(setup.robot)
        wide = replace(robot, footprint_radius=robot.footprint_radius + setup.berth)
        plan = sg.plan(arena, wide, **setup.grid)
        named, doubts, seconds, minutes = 0, [], [], 0.0
        for seed in range(1, options.seeds + 1):
            run = sg.record(plan, robot=robot, seed=seed)
            if run.meta["contacts"] != "0":
                raise SystemExit(f"{name}, seed {seed}: the robot touched a wall; give it a wider berth")
            with timed() as took:
                finding = sg.diagnose(run)
            seconds.append(took.cpu)
            minutes = float(run.stamps[-1] - run.stamps[0]) / 60
            named += bool(finding.effects)
            doubts += [(seed, a.name) for a in finding.effects]
            doubts += [] if finding.unknown is None else [(seed, finding.unknown.statement)]
        doubted = len({seed for seed, text in doubts if " " in text})
        print(
            f"{name:14} {minutes:8.1f} {options.seeds:5d} {named:6d} {doubted:8d} {np.median(seconds):12.1f}"
        )
        for seed, text in doubts:
            print(f"    seed {seed}: {text}")


if __name__ == "__main__":
    main()
