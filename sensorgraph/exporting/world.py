"""Content of an export: walls as solid boxes, round obstacles, the robot and its laser, with effects applied."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import shapely

from planners.arena import Arena
from sensorgraph.effects import Amendment
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Floats
from sensorgraph.world.drivetrain import Drivetrain
from sensorgraph.world.robot import Robot
from sensorgraph.world.scene import STAGES, Scene

PROBE = 0.005
"""[m] Distance from the middle of a wall at which free space is tested."""
THICKNESSES = (0.1, 0.05, 0.02, 0.01, 0.004)
"""[m] Thicknesses of a wall's box; the first that keeps the free space free is used."""
INTRUSION = 1e-6
"""[m²] Maximum area of free space that a box may occupy."""
SHEET = 0.002
"""[m] Thickness of a wall observed from both sides."""
BODY_MASS, WHEEL_MASS = 10.0, 0.5
"""[kg] Masses of the body and of a wheel; robot.yaml does not specify them."""
CLEARANCE = 0.01
"""[m] Height of the body above the floor."""
BELOW_LASER = 0.05
"""[m] Distance from the top of the body to the laser."""
CASTER = 0.02
"""[m] Radius of the frictionless balls in front and behind."""
OVERLAP = 1e-4
"""[m] Excess length of a box at each end of its wall, so that no ray passes through a corner."""


@dataclass(frozen=True, kw_only=True)
class Box:
    """A wall as a solid box, from above."""

    name: str
    x: float
    """[m] Centre."""
    y: float
    yaw: float
    """[rad] Direction of its length."""
    length: float
    """[m]"""
    thickness: float
    """[m]"""

    @property
    def outline(self) -> shapely.Polygon:
        """Polygon of its four corners."""
        half = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [self.length / 2, self.thickness / 2]
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return shapely.Polygon(half @ np.array([[c, s], [-s, c]]) + [self.x, self.y])


@dataclass(frozen=True, kw_only=True, eq=False)
class ExportedWorld:
    """An arena and a robot, prepared for a simulator."""

    name: str
    arena: Arena
    """Arena without effects."""
    robot: Robot
    effects: tuple[Amendment, ...]
    walls: Floats
    """(n_walls, 2, 2) [m] Walls with the effects on the room applied."""
    names: tuple[str, ...]
    """(n_walls,)"""
    boxes: tuple[Box, ...]
    """Walls as solids, on the side that is not free."""
    discs: Floats
    """(n_discs, 3) [m] x, y and radius of round obstacles added by effects."""
    mount: Floats
    """(3,) [m, m, rad] Mount of the laser, with effects applied."""
    drivetrain: Drivetrain
    start: Floats
    """(3,) [m, m, rad] Initial pose of the robot: the place with the largest clearance."""
    wall_height: float
    """[m]"""

    @property
    def body_height(self) -> float:
        """[m] Height of the robot's disc, up to below its laser."""
        return max(self.robot.sensor.height - BELOW_LASER - CLEARANCE, 2 * CASTER)

    @property
    def wide_wheels(self) -> list[str]:
        """One line if the wheels are outside the disc of the robot, and nothing otherwise."""
        base, disc = self.robot.wheels.base, 2 * self.robot.footprint_radius
        if self.robot.drive != "diff" or base <= disc:
            return []
        return [
            f"contacts of the wheels with walls: they are {base:g} m apart, outside the footprint of {disc:g} m; "
            "state wheels.base or footprint_radius in robot.yaml"
        ]

    @property
    def caster_reach(self) -> float:
        """[m] Distance from the centre of the robot to each ball."""
        return max(self.robot.footprint_radius - CASTER, 2 * CASTER)

    @classmethod
    def of(
        cls,
        arena: Arena,
        robot: Robot,
        effects: Sequence[Amendment] = (),
        *,
        name: str = "arena",
        wall_height: float | None = None,
    ) -> ExportedWorld:
        """Apply the effects on room, mount and drivetrain; those on readings remain for the laser.

        Parameters
        ----------
        wall_height : [m] None: half a metre above the laser.

        Raises
        ------
        SensorgraphError : The arena has no wall, or no place for the robot.
        """
        if arena.n_walls == 0:
            raise SensorgraphError(
                "the arena has no wall to export; give an arena with walls or a sensorgraph of faces"
            )
        scene = Scene(
            arena=arena, sensor=robot.sensor, stamps=np.zeros(1), motion=lambda t: np.zeros((*np.shape(t), 3)), span=1.0
        )  # fmt: skip
        built_in = [a for a in effects if a.effect.channel == "scan" and a.stage in ("geometry", "mount")]
        for a in sorted(built_in, key=lambda a: (STAGES.index(a.stage), a.key)):
            a(scene)
        same = len(scene.walls) == arena.n_walls
        names = (
            arena.names if same else tuple(f"wall_{k}" for k in range(len(scene.walls)))
        )  # an effect removed an obstacle
        original_walls = arena.walls if same else scene.walls
        lines = np.asarray(shapely.linestrings(scene.walls), dtype=np.object_)
        boxes = tuple(
            solid_wall(name, wall, where, arena, lines)
            for name, wall, where in zip(names, scene.walls, original_walls, strict=True)
            if np.hypot(*(wall[1] - wall[0])) > 0
        )
        return cls(
            name=name,
            arena=arena,
            robot=robot,
            effects=tuple(effects),
            walls=scene.walls,
            names=names,
            boxes=boxes,
            discs=scene.discs,
            mount=scene.mount,
            drivetrain=Drivetrain.of(robot, (a for a in effects if a.effect.channel != "scan")),
            start=_most_open_pose(arena, robot),
            wall_height=robot.sensor.height + 0.5 if wall_height is None else wall_height,
        )


def solid_wall(name: str, wall: Floats, where: Floats, arena: Arena, lines: npt.NDArray[np.object_]) -> Box:
    """Return a wall (2, 2) [m] as a box on the side that is not free, thin enough to contain no other wall.

    Parameters
    ----------
    where : (2, 2) [m] The wall in the original arena, where its free side is tested, as effects may move it.
    lines : (n_walls,) All walls; at the corners of a sensorgraph's walls free space can be unknown.
    """
    way = wall[1] - wall[0]
    length = float(np.hypot(*way))
    normal = np.array([-way[1], way[0]]) / length
    there = where[1] - where[0]
    aside = np.array([-there[1], there[0]]) / max(float(np.hypot(*there)), 1e-12)
    left, right = arena.contains(where.mean(axis=0) + PROBE * np.stack([aside, -aside]))
    yaw, middle = float(np.arctan2(way[1], way[0])), wall.mean(axis=0)

    def box(thickness: float, side: float) -> Box:
        x, y = middle + side * thickness / 2 * normal
        return Box(
            name=name, x=float(x), y=float(y), yaw=yaw, length=length + 2 * OVERLAP, thickness=thickness
        )

    if left == right:
        return box(SHEET, 0.0)
    side = -1.0 if left else 1.0
    for thickness in THICKNESSES:
        found = box(thickness, side)
        taken = found.outline.intersection(arena.free).area
        inner = found.outline.buffer(-min(2 * OVERLAP, thickness / 4))
        if taken <= INTRUSION + 4 * OVERLAP * thickness and not shapely.intersects(lines, inner).any():
            break
    return found


def _most_open_pose(arena: Arena, robot: Robot) -> Floats:
    """Return the pose (3,) with the largest clearance."""
    circle = shapely.maximum_inscribed_circle(arena.free, tolerance=0.05)
    if shapely.length(circle) < robot.footprint_radius:
        raise SensorgraphError(
            f"{robot.name} with radius {robot.footprint_radius:g} m fits nowhere in the arena; the largest clearance is "
            f"{shapely.length(circle):.2f} m"
        )
    x, y = shapely.get_coordinates(circle)[0]
    return np.array([x, y, 0.0])
