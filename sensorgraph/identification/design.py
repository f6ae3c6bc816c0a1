"""Design a controller in an identified world: search the polynomial, predict its closed loop, drive it, compare.

The coefficients theta are searched by the cross-entropy method (Rubinstein 1999) with common random numbers:

    Sample: theta_k ~ N(mean, spread²) for k = 1 ... population.
    Update: mean   <- SMOOTHING mean(elite) + (1 - SMOOTHING) mean, where the elite has the lowest cost.
    Update: spread <- SMOOTHING std(elite)  + (1 - SMOOTHING) spread.
    Cost: distance_error / DISTANCE_UNIT² + (4 max(turn_change / smoothness - 1, 0))² + TOUCHING_COST touching.

The closed loop is predicted by drives of the simulated robot in the graph, from nearby starts and with new noise. The
search may converge to a robot that turns in a circle; if a predicted drive does not follow the wall, it starts again.
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
from sensorgraph.errors import SensorgraphError, as_sensorgraph_error
from sensorgraph.graph import Sensorgraph
from sensorgraph.identification.design_task import (
    DesignTask,
    DriveQuantities,
    Interval,
    follows_wall,
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
"""Mean ranges to the right, ahead on the right, and ahead."""

ELITE = 4
"""The elite is one of so many controllers."""
FIRST_SPREAD, SMOOTHING = 1.0, 0.7
"""[rad/s per m] Standard deviation of the coefficients in the first round; weight of the elite in the next round."""
N_STARTS = 2
MAX_SEARCHES = 3
DISTANCE_UNIT, TOUCHING_COST = 0.1, 100.0
"""[m] RMS error of the wall distance of cost 1, as an excess of the smoothness by 25 %; cost of permanent contact."""
OUTER_SHARE = 0.25
"""Share of the places at the requested distance that are candidates for a start: those nearest to the bounds."""


@dataclass(frozen=True, kw_only=True)
class DesignSettings:
    """Effort of search and prediction, and the start of the drives; set on designs in the shipped square."""

    population: int = 24
    rounds: int = 20
    search_duration: float = 30.0
    """[s] Maximum duration of a drive in the search."""
    n_predicted: int = 8
    """Number of drives from which the behaviour is predicted."""
    start_spread: tuple[float, float] = (0.02, 0.05)
    """[m, rad] Standard deviations of the start poses of these drives, typical of a robot placed by hand."""


DESIGN = DesignSettings()


@dataclass(frozen=True, kw_only=True, eq=False)
class ControllerDesign:
    """A designed controller and its predicted behaviour."""

    task: DesignTask
    model: Narmax
    """Model of the turn rate."""
    facts: dict[str, Any]
    """Other entries of MODEL.json: the constant speed, the period, the inputs."""
    start: Floats
    """(3,) [m, m, rad] Start pose of the drives."""
    prediction: dict[str, Interval]
    tracks: list[ExecutedDrive] = field(repr=False)
    """The predicted drives."""
    n_failed: int
    """Number of predicted drives that touch a wall or do not keep it on the right; 0 if the design meets its task."""
    walls: Arena
    """Walls of the graph."""

    def save(self, path: Path) -> None:
        """Write the controller as a MODEL.json for `record --controller`.

        Raises
        ------
        OSError : The file cannot be written.
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
            "n_failed": self.n_failed,
            "prediction": {
                name: {k: None if np.isnan(v) else v for k, v in asdict(interval).items()}
                for name, interval in self.prediction.items()
            },
        }


@as_sensorgraph_error
def design(
    graph: Sensorgraph, task: DesignTask, robot: Robot, *, inputs: Sequence[str] = DEFAULT_INPUTS,
    degree: int = 2, seed: int = 0, settings: DesignSettings = DESIGN, progress: Progress | None = None,
) -> ControllerDesign:  # fmt: skip
    """Find the polynomial of the inputs that keeps the wall distance, and predict its closed loop.

    Parameters
    ----------
    graph : Graph of faces; its walls stop the robot and its predictions are the readings.
    inputs : Signals such as `L0-30`, the mean range of the rays between two angles from the robot's right.
    degree : Degree of the polynomial.

    Raises
    ------
    SensorgraphError
        The task exceeds the limits of the robot, the graph has no faces, or no place has this distance from a wall.
    """
    task.check(robot)
    if not isinstance(graph.model, Faces):
        raise SensorgraphError(
            f"the graph has the model {graph.model.name}, expected faces, whose walls stop the robot; build one of faces"
        )
    if not 1 <= degree <= 4 or not inputs:
        raise SensorgraphError(
            f"degree is {degree} with {len(inputs)} inputs; expected a degree of 1 to 4 and at least one input"
        )
    walls = arena_of(graph)
    clearance = WallDistance(walls)
    starts = start_poses(clearance, walls, task.wall_distance, N_STARTS)
    mount = robot.sensor.mount if graph.pose_frame == "laser" else np.zeros(3)
    world = IdentifiedWorld(graph, robot, seed)
    rays = {variable(name): world.rays[rays_of(robot.sensor, name)] for name in inputs}
    population = ClosedLoopPopulation(graph.model, robot, clearance, rays, seed, mount)
    centres = np.nan_to_num(np.nanmean(population.perceived(starts, 0, len(starts)), axis=0), nan=1.0)
    terms = polynomial([f"{name}(k)" for name in rays], degree)
    scale = Scale(tuple(rays), tuple(centres.tolist()), (1.0,) * len(rays))
    facts = {
        "signals": dict(zip(rays, inputs, strict=True)) | {OUTPUT: OUTPUT},
        "held": {"cmd_v": task.speed},
        "period_s": 1.0 / robot.sensor.rate,
    }
    n_failed, model, drives = settings.n_predicted + 1, None, list[ExecutedDrive]()
    for search in range(MAX_SEARCHES):
        theta = _searched(population, terms, centres, starts, task, settings, [seed, 7, search], progress)
        now = _controller(terms, theta, scale)
        tried = _predicted_drives(graph, now, facts, robot, task, starts[0], clearance, seed, settings)
        n_now = sum(not follows_wall(drive, clearance) for drive in tried)
        if n_now < n_failed:
            n_failed, model, drives = n_now, now, tried
        if not n_failed:
            break
    assert model is not None
    middle = np.array(walls.free.centroid.coords[0])
    found = [quantities(drive, clearance, middle, 1.0 / robot.sensor.rate) for drive in drives]
    return ControllerDesign(
        task=task, model=model, facts=facts, start=starts[0], prediction=predicted(found), tracks=drives,
        n_failed=n_failed, walls=walls,
    )  # fmt: skip


def drive_design(
    found: ControllerDesign, arena: Arena, robot: Robot, *, seed: int = 0
) -> tuple[ExecutedDrive, DriveQuantities]:
    """Drive a designed controller with the simulated robot in an arena, and measure the drive."""
    world = ArenaWorld(arena, robot, seed + 1000)
    clearance = WallDistance(arena)
    steer = PolynomialController(found.model, found.facts, robot, name="the design")
    drive = react(steer, world.scan, found.start, found.task.duration, robot, clearance=clearance)
    middle = np.array(arena.free.centroid.coords[0])
    return drive, quantities(drive, clearance, middle, 1.0 / robot.sensor.rate)


def start_poses(walls: WallDistance, arena: Arena, distance: float, n: int) -> Floats:
    """Return poses (n, 3) at a distance [m] from the nearest wall on the right, spread along the outer walls.

    Raises
    ------
    SensorgraphError : No place has this distance from a wall.
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
            f"no place is {distance:g} m from its nearest wall, the maximum is {table.max():.2f} m; reduce the wall distance"
        )
    x0, y0, x1, y1 = arena.bounds
    rim = np.min([x - x0, x1 - x, y - y0, y1 - y], axis=0)
    outer = rim <= np.quantile(rim, OUTER_SHARE)
    i, j, x, y = i[outer], j[outer], x[outer], y[outer]
    chosen = [len(i) // 2]
    while len(chosen) < min(n, len(i)):  # add the place farthest from those chosen
        gap = np.min([np.hypot(x - x[c], y - y[c]) for c in chosen], axis=0)
        chosen.append(int(gap.argmax()))
    phi = np.arctan2(-gx[i, j], gy[i, j])
    return np.asarray(np.column_stack([x, y, phi])[np.resize(chosen, n)], dtype=np.float64)


def _searched(
    population: ClosedLoopPopulation, terms: Terms, centres: Floats, starts: Floats, task: DesignTask,
    settings: DesignSettings, seed: Sequence[int], progress: Progress | None,
) -> Floats:  # fmt: skip
    """Return the coefficients (n_terms,) [rad/s] of lowest cost."""
    rng = np.random.default_rng(seed)
    mean = np.zeros(len(terms))
    linear = [len(term) == 1 and term[0].power == 1 for term in terms]
    mean[linear] = -FIRST_SPREAD  # turn left if a wall is near
    spread = np.full(len(terms), FIRST_SPREAD)
    best, least = mean, np.inf
    for round_ in range(settings.rounds):
        theta = mean + spread * rng.normal(size=(settings.population, len(terms)))
        theta[0] = best
        drives = population.drive(
            terms, theta, centres, starts, speed=task.speed, wall_distance=task.wall_distance,
            duration=min(task.duration, settings.search_duration),
        )  # fmt: skip
        rough = np.maximum(drives.turn_change / task.smoothness - 1.0, 0.0)
        cost = drives.distance_error / DISTANCE_UNIT**2 + (4.0 * rough) ** 2
        cost = (cost + TOUCHING_COST * drives.touching).mean(axis=1)
        order = np.argsort(cost)
        if cost[order[0]] < least:
            best, least = theta[order[0]], float(cost[order[0]])
        elite = theta[order[: max(settings.population // ELITE, 2)]]
        mean = SMOOTHING * elite.mean(axis=0) + (1 - SMOOTHING) * mean
        spread = SMOOTHING * elite.std(axis=0) + (1 - SMOOTHING) * spread
        if progress is not None:
            progress(round_ + 1, settings.rounds)
    return best


def _controller(terms: Terms, theta: Floats, scale: Scale) -> Narmax:
    """Return the polynomial as a model for `record --controller`; it was not fitted and has no standard errors."""
    n = len(terms)
    model = Narmax(
        output=OUTPUT, terms=terms, theta=theta, covariance=np.zeros((n, n)), err=np.zeros(n), sigma=0.0,
        n_samples=0, scale=scale, notes=("designed in an identified world, not fitted",),
    )  # fmt: skip
    return replace(model.in_user_units(), err=np.zeros(len(model.in_user_units().terms)))


def _predicted_drives(
    graph: Sensorgraph, model: Narmax, facts: dict[str, Any], robot: Robot, task: DesignTask, start: Floats,
    clearance: WallDistance, seed: int, settings: DesignSettings,
) -> list[ExecutedDrive]:  # fmt: skip
    rng = np.random.default_rng([seed, 8])
    out = []
    for i in range(settings.n_predicted):
        world = IdentifiedWorld(graph, robot, seed + 1 + i)
        sigma = np.array([settings.start_spread[0], settings.start_spread[0], settings.start_spread[1]])
        there = start + sigma * rng.normal(size=3)
        steer = PolynomialController(model, facts, robot, name="the design")
        out.append(react(steer, world.scan, there, task.duration, robot, clearance=clearance))
    return out
