"""Design a controller in an identified world: find the polynomial, predict its closed loop, drive it, compare.

The polynomial is searched by the cross-entropy method (Rubinstein 1999) on common random numbers; the closed loop is
predicted by drives of the embedded robot in the graph, from starts nearby and with fresh noise.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from logs.files import atomic_file
from planners.arena import Arena
from robotmodic_ident import Narmax, Scale, Terms, polynomial
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.identification.design_task import (
    DesignTask,
    DriveQuantities,
    Interval,
    predicted,
    quantities,
)
from sensorgraph.identification.population_drive import ClosedLoopPopulation
from sensorgraph.identification.signals import rays_of, variable
from sensorgraph.models.faces.model import Faces
from sensorgraph.recording.controllers import PolynomialController
from sensorgraph.recording.identified_world import ArenaWorld, IdentifiedWorld
from sensorgraph.types import Floats, Progress
from sensorgraph.world.drive import ExecutedDrive, react
from sensorgraph.world.identified_arena import arena_of
from sensorgraph.world.robot import Robot
from sensorgraph.world.wall_distance import WallDistance

OUTPUT = "cmd_omega"
DEFAULT_INPUTS = ("L0-30", "L30-60", "L75-105")
"""To the right, ahead on the right, ahead."""

OUTER_SHARE = 0.25
"""Of the places at the distance asked for, those nearest the arena's bounds, among which the starts are."""


@dataclass(frozen=True, kw_only=True)
class DesignSettings:
    """The search and the prediction; set by how well designs in the shipped square met what was asked."""

    population: int = 24
    elite: int = 6
    rounds: int = 20
    spread: float = 1.0
    """[rad/s for each m] standard deviation of the first coefficients."""
    smoothing: float = 0.7
    """Share of the elite's mean and spread that the next round takes."""
    search_duration: float = 30.0
    """[s] of a drive in the search, at most."""
    n_starts: int = 2
    distance_unit: float = 0.1
    """[m] of wall distance that costs as much as a quarter of the smoothness too much."""
    touching_cost: float = 100.0
    """Of touching a wall all the time."""
    n_predicted: int = 8
    """Drives that the prediction rests on."""
    start_spread: tuple[float, float] = (0.02, 0.05)
    """[m, rad] standard deviation of the starts of these drives: how well a robot is put down."""


DESIGN = DesignSettings()


@dataclass(frozen=True, kw_only=True, eq=False)
class ControllerDesign:
    """A controller, and what it will do."""

    task: DesignTask
    model: Narmax
    """Of the turn rate."""
    facts: dict[str, Any]
    """What a MODEL.json says beside the model: the speed that is held, the period, the inputs."""
    start: Floats
    """(3,) [m, m, rad] where the drives begin."""
    prediction: dict[str, Interval]
    tracks: list[ExecutedDrive] = field(repr=False)
    """The predicted drives."""
    walls: Arena
    """Of the graph."""

    def save(self, path: Path) -> None:
        """Write the controller as a MODEL.json, which `record --controller` drives.

        Raises
        ------
        OSError : the file cannot be written
        """
        with atomic_file(path) as part:
            part.write_text(json.dumps(self.model.to_dict() | self.facts, indent=1) + "\n")

    def to_dict(self) -> dict[str, Any]:
        """Return the task, the equation and the prediction as plain data."""
        return {
            "task": asdict(self.task),
            "controller": self.model.equation(),
            "start": self.start.tolist(),
            "n_predicted": len(self.tracks),
            "prediction": {
                name: {k: None if np.isnan(v) else v for k, v in asdict(interval).items()}
                for name, interval in self.prediction.items()
            },
        }


def design(
    graph: Sensorgraph,
    task: DesignTask,
    robot: Robot,
    *,
    inputs: Sequence[str] = DEFAULT_INPUTS,
    degree: int = 2,
    seed: int = 0,
    settings: DesignSettings = DESIGN,
    progress: Progress | None = None,
) -> ControllerDesign:
    """Find the polynomial of the inputs that keeps the wall distance, and predict its closed loop.

    Parameters
    ----------
    graph : of faces, whose walls stop the robot and whose readings it perceives
    inputs : signals such as `L0-30`, mean returns of the rays between two angles counted from the robot's right
    degree : of the polynomial

    Raises
    ------
    SensorgraphError : the robot cannot do what is asked, the graph is not of faces, or no place is that far from a wall
    """
    task.check(robot)
    if not isinstance(graph.model, Faces):
        raise SensorgraphError(
            f"the graph is of {graph.model.name}; build one of faces, whose walls stop the robot"
        )
    if not 1 <= degree <= 4 or not inputs:
        raise SensorgraphError(
            f"degree {degree} of {len(inputs)} inputs: expected 1 to 4, and an input or more"
        )
    walls = arena_of(graph)
    clearance = WallDistance(walls)
    starts = start_poses(clearance, walls, robot, task.wall_distance, settings.n_starts)
    mount = robot.sensor.mount if graph.pose_frame == "laser" else np.zeros(3)
    world = IdentifiedWorld(graph, robot, seed)
    rays = {variable(name): world.rays[rays_of(robot.sensor, name)] for name in inputs}
    population = ClosedLoopPopulation(graph.model, robot, clearance, rays, seed, mount)
    centres = np.nan_to_num(np.nanmean(population.perceived(starts, 0, len(starts)), axis=0), nan=1.0)
    terms = polynomial([f"{name}(k)" for name in rays], degree)
    theta = _searched(population, terms, centres, starts, task, settings, seed, progress)
    model = _controller(terms, theta, Scale(tuple(rays), tuple(centres.tolist()), (1.0,) * len(rays)))
    facts = {
        "signals": dict(zip(rays, inputs, strict=True)) | {OUTPUT: OUTPUT},
        "held": {"cmd_v": task.speed},
        "period_s": 1.0 / robot.sensor.rate,
    }
    drives = _predicted_drives(graph, model, facts, robot, task, starts[0], clearance, seed, settings)
    middle = np.array(walls.free.centroid.coords[0])
    found = [quantities(drive, clearance, middle, 1.0 / robot.sensor.rate) for drive in drives]
    return ControllerDesign(
        task=task, model=model, facts=facts, start=starts[0], prediction=predicted(found), tracks=drives, walls=walls
    )  # fmt: skip


def drive_design(
    found: ControllerDesign, arena: Arena, robot: Robot, *, seed: int = 0
) -> tuple[ExecutedDrive, DriveQuantities]:
    """Drive a designed controller with the embedded robot in an arena, and measure it by the arena's walls."""
    world = ArenaWorld(arena, robot, seed + 1000)
    clearance = WallDistance(arena)
    steer = PolynomialController(found.model, found.facts, robot, name="the design")
    drive = react(steer, world.scan, found.start, found.task.duration, robot, clearance=clearance)
    middle = np.array(arena.free.centroid.coords[0])
    return drive, quantities(drive, clearance, middle, 1.0 / robot.sensor.rate)


def start_poses(walls: WallDistance, arena: Arena, robot: Robot, distance: float, n: int) -> Floats:
    """Return poses (n, 3) at a distance [m] from the nearest wall, which is on the right, spread along the outer walls.

    Raises
    ------
    SensorgraphError : no place is that far from a wall
    """
    table = np.array(walls.table)
    gx, gy = np.gradient(table, walls.cell)
    right = (np.abs(table - distance) < walls.cell) & (np.hypot(gx, gy) > 0.9)
    i, j = np.nonzero(right)
    x, y = walls.x0 + walls.cell * i, walls.y0 + walls.cell * j
    inside = arena.contains(np.column_stack([x, y]))
    i, j, x, y = i[inside], j[inside], x[inside], y[inside]
    if len(i) == 0:
        raise SensorgraphError(
            f"no place is {distance:g} m from its nearest wall; the farthest is {table.max():.2f} m: ask for less"
        )
    x0, y0, x1, y1 = arena.bounds
    rim = np.min([x - x0, x1 - x, y - y0, y1 - y], axis=0)
    outer = rim <= np.quantile(rim, OUTER_SHARE)
    i, j, x, y = i[outer], j[outer], x[outer], y[outer]
    chosen = [len(i) // 2]
    while len(chosen) < min(n, len(i)):  # the farthest from those chosen
        gap = np.min([np.hypot(x - x[c], y - y[c]) for c in chosen], axis=0)
        chosen.append(int(gap.argmax()))
    phi = np.arctan2(-gx[i, j], gy[i, j])
    return np.asarray(np.column_stack([x, y, phi])[np.resize(chosen, n)], dtype=np.float64)


def _searched(
    population: ClosedLoopPopulation,
    terms: Terms,
    centres: Floats,
    starts: Floats,
    task: DesignTask,
    settings: DesignSettings,
    seed: int,
    progress: Progress | None,
) -> Floats:
    """Return the coefficients (n_terms,) [rad/s] of least cost."""
    rng = np.random.default_rng([seed, 7])
    mean = np.zeros(len(terms))
    linear = [len(term) == 1 and term[0].power == 1 for term in terms]
    mean[linear] = -settings.spread  # a wall that is near: turn left
    spread = np.full(len(terms), settings.spread)
    best, least = mean, np.inf
    for round_ in range(settings.rounds):
        theta = mean + spread * rng.normal(size=(settings.population, len(terms)))
        theta[0] = best
        drives = population.drive(
            terms, theta, centres, starts, speed=task.speed, wall_distance=task.wall_distance,
            duration=min(task.duration, settings.search_duration),
        )  # fmt: skip
        rough = np.maximum(drives.turn_change / task.smoothness - 1.0, 0.0)
        cost = drives.distance_error / settings.distance_unit**2 + (4.0 * rough) ** 2
        cost = (cost + settings.touching_cost * drives.touching).mean(axis=1)
        order = np.argsort(cost)
        if cost[order[0]] < least:
            best, least = theta[order[0]], float(cost[order[0]])
        elite = theta[order[: settings.elite]]
        mean = settings.smoothing * elite.mean(axis=0) + (1 - settings.smoothing) * mean
        spread = settings.smoothing * elite.std(axis=0) + (1 - settings.smoothing) * spread
        if progress is not None:
            progress(round_ + 1, settings.rounds)
    return best


def _controller(terms: Terms, theta: Floats, scale: Scale) -> Narmax:
    """Return the polynomial as a model that `record --controller` reads: designed, so without standard errors."""
    n = len(terms)
    model = Narmax(
        output=OUTPUT, terms=terms, theta=theta, covariance=np.zeros((n, n)), err=np.zeros(n), sigma=0.0,
        n_samples=0, scale=scale, notes=("designed in an identified world, not fitted",),
    )  # fmt: skip
    return replace(model.in_user_units(), err=np.zeros(len(model.in_user_units().terms)))


def _predicted_drives(
    graph: Sensorgraph,
    model: Narmax,
    facts: dict[str, Any],
    robot: Robot,
    task: DesignTask,
    start: Floats,
    clearance: WallDistance,
    seed: int,
    settings: DesignSettings,
) -> list[ExecutedDrive]:
    rng = np.random.default_rng([seed, 8])
    out = []
    for i in range(settings.n_predicted):
        world = IdentifiedWorld(graph, robot, seed + 1 + i)
        sigma = np.array([settings.start_spread[0], settings.start_spread[0], settings.start_spread[1]])
        there = start + sigma * rng.normal(size=3)
        steer = PolynomialController(model, facts, robot, name="the design")
        out.append(react(steer, world.scan, there, task.duration, robot, clearance=clearance))
    return out
