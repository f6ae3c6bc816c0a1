"""MuJoCo: scene.xml with walls as boxes, a robot on wheels (or on a planar joint) and its laser; drive.py records."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from sensorgraph.exporting.world import BODY_MASS, CASTER, CLEARANCE, WHEEL_MASS, ExportedWorld

WALL_GROUP, ROBOT_GROUP = 0, 1
"""Groups of geoms; the laser sees only the first."""
TIMESTEP = 0.001
"""[s]"""
SERVO_GAIN = 20.0
"""[N m s/rad] Gain of the wheels' speed control; without lag, a step is followed within a few milliseconds."""
SOLREF = "0.002 1"
"""Time constant [s] and damping ratio of the tyre contact; with softer tyres the body lags its wheels."""
TYRE_BIT, FLOOR_BITS = "2", "3"
"""Bits of contacts: tyres touch the floor only, because the outline of the robot is its disc, as in a plan."""
MAX_SITES = 2000
"""Maximum number of rays with a rangefinder each."""


def write(world: ExportedWorld, folder: Path) -> list[str]:
    """Write scene.xml; return what it leaves out, one line each."""
    root = ElementTree.Element("mujoco", model=world.name)
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="true")
    # elliptic friction cones and a stiff ratio keep wheels from creeping
    ElementTree.SubElement(
        root, "option", timestep=f"{TIMESTEP:g}", cone="elliptic", impratio="200", integrator="implicitfast"
    )
    ElementTree.SubElement(ElementTree.SubElement(root, "visual"), "headlight", diffuse="0.6 0.6 0.6")
    body = ElementTree.SubElement(root, "worldbody")
    _add_room(world, body)
    robot = ElementTree.SubElement(body, "body", name="base_link", pos=_text(*world.start[:2], 0.0))
    actuators = ElementTree.SubElement(root, "actuator")
    is_wheeled = world.robot.drive == "diff"
    (_add_wheeled if is_wheeled else _add_planar)(world, robot, actuators)
    laser = _add_laser(world, robot)
    if laser:
        sensors = ElementTree.SubElement(root, "sensor")
        for name in laser:
            ElementTree.SubElement(
                sensors, "rangefinder", name=name, site=name, cutoff=f"{world.robot.sensor.range_max:g}"
            )
    ElementTree.indent(root, " ")
    (folder / "scene.xml").write_text(ElementTree.tostring(root, encoding="unicode") + "\n", encoding="utf-8")
    left_out = [f"rangefinders for {world.robot.sensor.n_rays} rays; drive.py casts these rays"]
    return [*world.wide_wheels, *([] if laser else left_out)]


def _text(*numbers: float) -> str:
    return " ".join(f"{number:.9g}" for number in numbers)


def _add_room(world: ExportedWorld, body: ElementTree.Element) -> None:
    """Add the floor, the walls and the round obstacles."""
    x0, y0, x1, y1 = world.arena.bounds
    ElementTree.SubElement(
        body, "geom", name="floor", type="plane", pos=_text((x0 + x1) / 2, (y0 + y1) / 2, 0.0),
        size=_text((x1 - x0) / 2 + 1, (y1 - y0) / 2 + 1, 0.1), rgba="0.9 0.9 0.92 1", friction="1 0.005 0.0001",
        group=str(ROBOT_GROUP), contype=FLOOR_BITS, conaffinity=FLOOR_BITS,
    )  # fmt: skip
    half = world.wall_height / 2
    for box in world.boxes:
        ElementTree.SubElement(
            body, "geom", name=box.name, type="box", pos=_text(box.x, box.y, half),
            size=_text(box.length / 2, box.thickness / 2, half), euler=_text(0, 0, box.yaw), rgba="0.6 0.62 0.68 1",
            group=str(WALL_GROUP),
        )  # fmt: skip
    for k, (x, y, radius) in enumerate(world.discs):
        ElementTree.SubElement(
            body, "geom", name=f"disc_{k}", type="cylinder", pos=_text(x, y, half), size=_text(radius, half),
            rgba="0.8 0.55 0.2 1", group=str(WALL_GROUP),
        )  # fmt: skip


def _add_body(world: ExportedWorld, robot: ElementTree.Element) -> None:
    """Add the robot's disc, up to below its laser."""
    half = world.body_height / 2
    ElementTree.SubElement(
        robot, "geom", name="body", type="cylinder", pos=_text(0, 0, CLEARANCE + half),
        size=_text(world.robot.footprint_radius, half), mass=f"{BODY_MASS:g}", rgba="0.16 0.47 0.56 1",
        group=str(ROBOT_GROUP), friction="0.1",
    )  # fmt: skip


def _add_wheeled(world: ExportedWorld, robot: ElementTree.Element, actuators: ElementTree.Element) -> None:
    """Add two driven wheels and two frictionless balls."""
    radius, base = world.robot.wheels.radius, world.robot.wheels.base
    ElementTree.SubElement(robot, "freejoint", name="base")
    _add_body(world, robot)
    for name, x in (("front", world.caster_reach), ("rear", -world.caster_reach)):
        ElementTree.SubElement(
            robot, "geom", name=f"caster_{name}", type="sphere", pos=_text(x, 0, CASTER), size=_text(CASTER),
            mass="0.05", friction="0 0 0", condim="1", priority="1", group=str(ROBOT_GROUP),
        )  # fmt: skip
    tau = world.drivetrain.tau
    for name, y in (("left", base / 2), ("right", -base / 2)):
        wheel = ElementTree.SubElement(robot, "body", name=f"{name}_wheel", pos=_text(0, y, radius))
        ElementTree.SubElement(
            wheel, "joint", name=f"{name}_wheel", type="hinge", axis="0 1 0", armature="0.01"
        )
        # an ellipsoid touches the floor in one point, so that the wheelbase equals that of robot.yaml
        ElementTree.SubElement(
            wheel, "geom", name=f"{name}_tyre", type="ellipsoid", size=_text(radius, min(0.02, radius), radius),
            mass=f"{WHEEL_MASS:g}", friction="2 0.005 0.0001", solref=SOLREF, priority="1", rgba="0.14 0.15 0.18 1",
            group=str(ROBOT_GROUP), contype=TYRE_BIT, conaffinity=TYRE_BIT,
        )  # fmt: skip
        lag: dict[str, Any] = {"dyntype": "filterexact", "dynprm": _text(tau)} if tau > 0 else {}
        top = (world.robot.limits.v + world.robot.limits.omega * base / 2) / radius
        ElementTree.SubElement(
            actuators, "general", name=f"{name}_wheel", joint=f"{name}_wheel", gainprm=_text(SERVO_GAIN),
            biastype="affine", biasprm=_text(0, 0, -SERVO_GAIN), ctrlrange=_text(-top, top), **lag,
        )  # fmt: skip


def _add_planar(world: ExportedWorld, robot: ElementTree.Element, actuators: ElementTree.Element) -> None:
    """Add a planar joint for a car; drive.py sets its velocity as that of a car without slip."""
    for name, kind, axis in (("x", "slide", "1 0 0"), ("y", "slide", "0 1 0"), ("phi", "hinge", "0 0 1")):
        ElementTree.SubElement(robot, "joint", name=name, type=kind, axis=axis)
    _add_body(world, robot)


def _add_laser(world: ExportedWorld, robot: ElementTree.Element) -> list[str]:
    """Add a site for each ray; return their names."""
    sensor = world.robot.sensor
    if sensor.n_rays > MAX_SITES:
        return []
    mount, height = world.mount, sensor.height
    origins = np.zeros((sensor.n_rays, 2)) if not sensor.is_composite else sensor.origins
    c, s = np.cos(mount[2]), np.sin(mount[2])
    names = []
    for k, bearing in enumerate(sensor.bearings):
        x, y = (
            mount[0] + c * origins[k, 0] - s * origins[k, 1],
            mount[1] + s * origins[k, 0] + c * origins[k, 1],
        )
        phi = bearing + mount[2]
        names.append(f"ray_{k}")
        ElementTree.SubElement(
            robot, "site", name=names[-1], pos=_text(x, y, height), zaxis=_text(np.cos(phi), np.sin(phi), 0),
            size="0.002", group="4",
        )  # fmt: skip
    return names
