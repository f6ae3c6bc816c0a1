"""The identified world: a sensorgraph replaces the arena, and the simulated robot drives in it.

Noise depends on the seed, the scan number and the ray, not on the controller. So two controllers have the
same noise, which allows a fair comparison of model and robot, and of controllers (Nehmzow, Scientific Methods
in Mobile Robotics, 2006).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

import logs
from logs.run import RangeSensor, Run
from logs.transforms import compose
from planners.arena import Arena, wrap
from planners.trajectory import Trajectory
from sensorgraph.errors import SensorgraphError
from sensorgraph.evaluation.evaluate import poses_for
from sensorgraph.graph import Sensorgraph
from sensorgraph.intake import check_rays
from sensorgraph.loading import attachments_of
from sensorgraph.models.faces.model import Faces
from sensorgraph.models.narmax.drawing import DrawnRun
from sensorgraph.models.narmax.model import RayNarmax
from sensorgraph.models.place_noise import places_of
from sensorgraph.recording.controllers import controller_named
from sensorgraph.sensor_model import draw
from sensorgraph.types import Floats, ProgressBars, no_progress
from sensorgraph.world.described import rays_text
from sensorgraph.world.drive import follow, react
from sensorgraph.world.ray_order import bearings_text, ray_order
from sensorgraph.world.raycast import cast, cast_rays, laser_poses
from sensorgraph.world.robot import Robot
from sensorgraph.world.scene import apply_range_limits
from sensorgraph.world.simulate import occupancy_map, simulate
from sensorgraph.world.wall_distance import WallDistance

PLAN_CONTROLLER = "plan"
"""Controller that follows the plan, as `record` does without a graph."""
SCANS_PER_NOISE_BLOCK = 256  # scans with noise drawn at once


class PerceivedWorld(Protocol):
    """A world in which a robot can be driven closed loop."""

    seed: int
    sensor: RangeSensor

    def scans(self, first: int, poses: Floats) -> Floats:
        """Draw scans `first`, `first` + 1, ... at base_link poses; return readings (n, n_rays) [m].

        `poses` are (n, 3), or (n, n_rays, 3) for a sensor that sweeps.
        """
        ...

    def scan(self, number: int, pose: Floats) -> Floats:
        """Draw one scan (n_rays,) [m] at a pose (3,)."""
        ...


class ScanNoise:
    """A uniform and a normal number for each ray of each scan, reproducible in any order."""

    def __init__(self, seed: int, n_rays: int) -> None:
        self.seed, self.n_rays = seed, n_rays
        self._kept: tuple[int, Floats, Floats] | None = None

    def of(self, number: int) -> tuple[Floats, Floats]:
        """Return the uniform and normal numbers (n_rays,) of one scan."""
        block, row = divmod(number, SCANS_PER_NOISE_BLOCK)
        if self._kept is None or self._kept[0] != block:
            rng = np.random.default_rng([self.seed, 1, block])
            shape = (SCANS_PER_NOISE_BLOCK, self.n_rays)
            self._kept = block, rng.random(shape), rng.normal(size=shape)
        return self._kept[1][row], self._kept[2][row]


class ArenaWorld:
    """Readings cast in an arena, with only the noise of the sensor."""

    def __init__(self, arena: Arena, robot: Robot, seed: int) -> None:
        self.arena, self.sensor, self.seed = arena, robot.sensor, seed
        self._noise = ScanNoise(seed, robot.sensor.n_rays)

    def scans(self, first: int, poses: Floats) -> Floats:
        """Draw scans `first`, `first` + 1, ... at base_link poses; return readings (n, n_rays) [m].

        `poses` are (n, 3), or (n, n_rays, 3) for a sensor that sweeps.
        """
        normal = np.array([self._noise.of(first + i)[1] for i in range(len(poses))])
        if poses.ndim == 3:
            lasers = laser_poses(poses, self.sensor.mount)
            headings = lasers[..., 2] + self.sensor.bearings
            ranges = cast_rays(self.arena, lasers[..., :2], headings, self.sensor).ranges
        else:
            ranges = cast(self.arena, poses, self.sensor).ranges
        noisy = ranges + self.sensor.sigma * normal
        return apply_range_limits(np.where(np.isfinite(ranges), noisy, ranges), self.sensor)

    def scan(self, number: int, pose: Floats) -> Floats:
        """Draw one scan (n_rays,) [m] at a pose (3,)."""
        return np.asarray(self.scans(number, pose[None])[0])


class IdentifiedWorld:
    """Readings drawn from a graph; of `n_rays`, `unanswered` were drawn without an answer of the graph."""

    def __init__(self, graph: Sensorgraph, robot: Robot, seed: int) -> None:
        rays = ray_order(graph.sensor.bearings, robot.sensor.bearings)
        if rays is None:
            keys = rays_text(graph.sensor.bearings)
            raise SensorgraphError(
                "the rays of the robot differ from those of the graph "
                f"({bearings_text(robot.sensor.bearings, graph.sensor.bearings)}); "
                "give the robot.yaml of the sensor with which the graph was built"
                + (f", or write sensor: {{{keys}}}" if keys else "")
            )
        check_rays(
            robot.sensor, robot.name, takes="an identified world draws",
            remedy="drive in an arena, or give the robot of one laser",
        )  # fmt: skip
        self.graph, self.seed, self.rays = graph, seed, rays
        self.sensor = replace(robot.sensor, range_max=min(robot.sensor.range_max, graph.sensor.range_max))
        self.n_rays = self.unanswered = 0
        self._noise = ScanNoise(seed, robot.sensor.n_rays)
        self._run: DrawnRun | None = None
        self._next = 0

    def scans(self, first: int, poses: Floats) -> Floats:
        """Draw scans `first`, `first` + 1, ... at base_link poses; return readings (n, n_rays) [m].

        `poses` are (n, 3), or (n, n_rays, 3) for a sensor that sweeps.
        """
        there = self._graph_poses(poses)
        answered = self.graph.predict(there, rays=self.rays).answered
        self.n_rays += answered.size
        self.unanswered += int((~answered).sum())
        return self._draw(first, there)

    def scan(self, number: int, pose: Floats) -> Floats:
        """Draw one scan (n_rays,) [m] at a pose (3,)."""
        return np.asarray(self._draw(number, self._graph_poses(pose[None]))[0])

    def _graph_poses(self, poses: Floats) -> Floats:
        """Return base_link poses (..., 3) in the frame of the graph; the headings of a long drive are many turns."""
        there = poses_for(self.graph, "base_link", self.sensor.mount, poses).copy()
        there[..., 2] = wrap(there[..., 2])
        return there

    def _draw(self, first: int, poses: Floats) -> Floats:
        uniform, normal = self._numbers(first, poses)
        model = self.graph.model
        if isinstance(model, RayNarmax):
            readings = self._draw_run(model, first, poses, uniform, normal)
        elif not isinstance(model, Faces):
            prediction = self.graph.predict(poses, rays=self.rays)
            lost = uniform[:, self.rays] < prediction.p_no_return
            readings = np.where(lost, np.inf, prediction.mode + prediction.sigma * normal[:, self.rays])
        else:
            own = uniform[:, self.rays], normal[:, self.rays]
            readings = draw(self.graph, poses, *own, self.rays)
        return apply_range_limits(readings, self.sensor)

    def _numbers(self, first: int, poses: Floats) -> tuple[Floats, Floats]:
        """Return the uniform and normal numbers (n, n_rays) of scans, in the order of the graph's rays."""
        noise = [self._noise.of(first + i) for i in range(len(poses))]
        memory, sensor = self.graph.memory, self.graph.sensor
        if memory is not None:
            mode = self.graph.predict(poses).mode
            starts = poses if self.graph.pose_frame == "laser" else compose(poses, sensor.mount)
            places = places_of(starts, sensor.bearings, mode, sensor.range_max)
            noise = [
                memory.numbers(self.seed, (first + i) / self.sensor.rate, places[i], *fresh)
                for i, fresh in enumerate(noise)
            ]
        uniform, normal = (np.array(part) for part in zip(*noise, strict=True))
        return uniform, normal

    def _draw_run(
        self, model: RayNarmax, first: int, poses: Floats, uniform: Floats, normal: Floats
    ) -> Floats:
        """Draw consecutive scans, with lags from the scans before; a gap starts a new run."""
        if self._run is None or first != self._next:
            self._run = DrawnRun(model, 1.0 / self.sensor.rate)
        self._next = first + len(poses)
        drawn = [self._run.scan(*of_scan) for of_scan in zip(poses, uniform, normal, strict=True)]
        return np.array(drawn).reshape(len(poses), model.n_rays)[:, self.rays]


def record_in_world(
    path: Path,
    world: PerceivedWorld,
    arena: Arena,
    robot: Robot,
    way: Trajectory,
    controller: str,
    *,
    start: Floats | None = None,
    name: str = "",
    progress: ProgressBars = no_progress,
) -> Run:
    """Drive in an identified world for the duration of the plan, and write the run.

    Parameters
    ----------
    arena : Walls that stop the robot's body, and map of the run.
    controller : `plan` follows the trajectory; others of CONTROLLERS, or a MODEL.json of `identify`, steer by
        the drawn scans.
    start : (3,) [m, m, rad] Start pose of a controller other than `plan`; None: the start of the plan.
    name : Name of the graph for the run's metadata; empty in an arena.
    """
    robot = replace(robot, sensor=world.sensor)
    clearance = WallDistance(arena)
    with progress("driving", "commands") as tick:
        if controller == PLAN_CONTROLLER:
            rng = np.random.default_rng([world.seed, 2])
            driven = follow(way, robot, clearance=clearance, rng=rng, progress=tick)
        else:
            steer = controller_named(controller, robot, world.seed)
            begin = way.poses[0] if start is None else start
            driven = react(steer, world.scan, begin, way.duration, robot, clearance=clearance, progress=tick)
    meta = {"simulated": "true", "seed": str(world.seed), "contacts": str(driven.contacts)}
    with progress("scanning", "scans") as tick:
        run = simulate(
            driven, arena, robot, rng=np.random.default_rng([world.seed, 3]), perceive=world.scans,
            meta={**meta, **({"graph": name} if name else {}), "controller": controller},
            attachments=attachments_of(arena, robot),
            progress=tick,
        )  # fmt: skip
    with progress("writing", "messages") as tick:
        logs.write(run, path, occupancy=occupancy_map(arena), progress=tick)
    return run
