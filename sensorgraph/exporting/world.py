"""What is exported: walls as solid boxes, round obstacles, the robot and its laser, with effects built in."""

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
"""[m] beside the middle of a wall, where it is asked whether there is free space."""
THICKNESSES = (0.1, 0.05, 0.02, 0.01, 0.004)
"""[m] of a wall's box, the first that leaves the free space free."""
INTRUSION = 1e-6
"""[m²] of free space that a box may take."""
SHEET = 0.002
"""[m] thickness of a wall that is seen from both sides."""
BODY_MASS, WHEEL_MASS = 10.0, 0.5
"""[kg] of the body and of a wheel; robot.yaml does not say them."""
CLEARANCE = 0.01
"""[m] of the body above the floor."""
BELOW_LASER = 0.05
"""[m] from the top of the body up to the laser."""
CASTER = 0.02
"""[m] radius of the balls that the robot slides on in front and behind."""
OVERLAP = 1e-4
"""[m] by which a box is longer than its wall at either end, so that no ray slips through a corner."""


@dataclass(frozen=True, kw_only=True)
class Box:
    """A wall as a solid box, seen from above."""

    name: str
    x: float
    """[m] centre."""
    y: float
    yaw: float
    """[rad] of its length."""
    length: float
    """[m]"""
    thickness: float
    """[m]"""

    @property
    def outline(self) -> shapely.Polygon:
        """Its four corners."""
        half = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [self.length / 2, self.thickness / 2]
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return shapely.Polygon(half @ np.array([[c, s], [-s, c]]) + [self.x, self.y])


@dataclass(frozen=True, kw_only=True, eq=False)
class ExportedWorld:
    """An arena and a robot, ready to be written for a simulator."""

    name: str
    arena: Arena
    """As it was given, without effects."""
    robot: Robot
    effects: tuple[Amendment, ...]
    walls: Floats
    """(n_walls, 2, 2) [m] with the effects on the room built in."""
    names: tuple[str, ...]
    """(n_walls,)"""
    boxes: tuple[Box, ...]
    """The walls as solids, on the side that is not free."""
    discs: Floats
    """(n_discs, 3) [m] x, y, radius of round obstacles that effects added."""
    mount: Floats
    """(3,) [m, m, rad] of the laser, effects built in."""
    drivetrain: Drivetrain
    start: Floats
    """(3,) [m, m, rad] where the robot stands: as far from the walls as it gets."""
    wall_height: float
    """[m]"""

    @property
    def body_height(self) -> float:
        """[m] of the robot's disc, up to below its laser."""
        return max(self.robot.sensor.height - BELOW_LASER - CLEARANCE, 2 * CASTER)

    @property
    def caster_reach(self) -> float:
        """[m] from the middle of the robot to either ball."""
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
        """Build effects on room, mount and drivetrain in; those on readings are left to the laser.

        Parameters
        ----------
        wall_height : [m]; None: half a metre above the laser

        Raises
        ------
        SensorgraphError : the arena has no wall, or the robot stands nowhere in it
        """
        if arena.n_walls == 0:
            raise SensorgraphError(
                "there is no wall to export; give an arena with walls or a sensorgraph of faces"
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
        )  # an obstacle is gone
        asked = arena.walls if same else scene.walls
        lines = np.asarray(shapely.linestrings(scene.walls), dtype=np.object_)
        boxes = tuple(
            solid_wall(name, wall, where, arena, lines)
            for name, wall, where in zip(names, scene.walls, asked, strict=True)
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
            start=_roomy_pose(arena, robot),
            wall_height=robot.sensor.height + 0.5 if wall_height is None else wall_height,
        )


def solid_wall(name: str, wall: Floats, where: Floats, arena: Arena, lines: npt.NDArray[np.object_]) -> Box:
    """Return a wall (2, 2) [m] as a box on the side that is not free, as thick as no other wall stands in it.

    Parameters
    ----------
    where : (2, 2) [m] the wall as the arena has it, if it has since moved: there the free side is looked for
    lines : (n_walls,) all walls; those of a sensorgraph have corners beside which nobody knows what is free
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


def _roomy_pose(arena: Arena, robot: Robot) -> Floats:
    """Return a pose (3,) far from all walls."""
    circle = shapely.maximum_inscribed_circle(arena.free, tolerance=0.05)
    if shapely.length(circle) < robot.footprint_radius:
        raise SensorgraphError(
            f"{robot.name} of radius {robot.footprint_radius:g} m stands nowhere in the arena; the roomiest place "
            f"leaves {shapely.length(circle):.2f} m"
        )
    x, y = shapely.get_coordinates(circle)[0]
    return np.array([x, y, 0.0])
