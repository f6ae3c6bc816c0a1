"""Gazebo: world.sdf (SDF 1.9) with walls, a wheeled robot and a noisy lidar; bridge.launch.py for ros_gz."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import SubElement

import numpy as np

from sensorgraph.effects.range_bias import RANGE_BIAS
from sensorgraph.exporting.world import BODY_MASS, CASTER, CLEARANCE, WHEEL_MASS, ExportedWorld

SYSTEMS = {
    "Physics": "physics",
    "Sensors": "sensors",
    "SceneBroadcaster": "scene-broadcaster",
    "UserCommands": "user-commands",
}
"""Name of a system of the world -> the name in its file."""
WHEEL_WIDTH = 0.03
"""[m]"""
WALL_BIT, TYRE_BIT = "0x01", "0x02"
"""Bits of contacts: tyres touch the floor only, because the outline of the robot is its disc, as in a plan."""


def write(world: ExportedWorld, folder: Path) -> list[str]:
    """Write world.sdf and bridge.launch.py; return what they leave out, one line each."""
    root = ElementTree.Element("sdf", version="1.9")
    place = SubElement(root, "world", name=_name(world.name))
    for name, tag in SYSTEMS.items():
        SubElement(place, "plugin", filename=f"gz-sim-{tag}-system", name=f"gz::sim::systems::{name}")
    light = SubElement(place, "light", type="directional", name="sun")
    _leaves(light, pose="0 0 10 0 0 0", diffuse="0.8 0.8 0.8 1", direction="-0.3 0.2 -1")
    _add_floor(place)
    _add_walls(world, place)
    _add_robot(world, place)
    ElementTree.indent(root, " ")
    (folder / "world.sdf").write_text(ElementTree.tostring(root, encoding="unicode") + "\n", encoding="utf-8")
    template = (files("sensorgraph.data") / "export" / "bridge.launch.py").read_text(encoding="utf-8")
    (folder / "bridge.launch.py").write_text(_with_mount(template, world), encoding="utf-8")
    sensor, left_out = world.robot.sensor, [*world.wide_wheels]
    if sensor.is_composite:
        left_out.append(
            "several sensors: the lidar has one fan at the mount, from the first bearing to the last"
        )
    if sensor.has_ray_delays:
        left_out.append("the sweep: all rays of a scan have the same time")
    if world.robot.drive != "diff":
        left_out.append(f"the {world.robot.drive} car: the robot turns in place")
    if world.robot.actuators.delay or world.robot.actuators.tau:
        left_out.append("dead time and lag of the motors: the plug-in limits only speed and acceleration")
    return left_out


def _with_mount(template: str, world: ExportedWorld) -> str:
    """Return the launch file with the mount of robot.yaml, which effects on the mount do not change."""
    x, y, yaw = (float(value) for value in world.robot.sensor.mount)
    mount = {"x": x, "y": y, "z": float(world.robot.sensor.height), "yaw": yaw}
    line = 'MOUNT = {"x": 0.0, "y": 0.0, "z": 0.0, "yaw": 0.0}'
    assert line in template
    return template.replace(line, f"MOUNT = {json.dumps(mount)}")


def _name(text: str) -> str:
    return text.replace("/", "_").replace(" ", "_")


def _numbers(*values: float) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _leaves(parent: ElementTree.Element, /, **values: str | float) -> None:
    """Add an element for each name."""
    for name, value in values.items():
        SubElement(parent, name).text = value if isinstance(value, str) else f"{value:.9g}"


def _add_floor(place: ElementTree.Element) -> None:
    link = SubElement(_static(place, "floor"), "link", name="link")
    for kind in ("collision", "visual"):
        plane = SubElement(SubElement(SubElement(link, kind, name=kind), "geometry"), "plane")
        _leaves(plane, normal="0 0 1", size="200 200")


def _static(place: ElementTree.Element, name: str) -> ElementTree.Element:
    model = SubElement(place, "model", name=name)
    _leaves(model, static="true")
    return model


def _add_walls(world: ExportedWorld, place: ElementTree.Element) -> None:
    """Add all walls as one static model, and round obstacles as another."""
    link = SubElement(_static(place, "walls"), "link", name="link")
    half = world.wall_height / 2
    for box in world.boxes:
        for kind in ("collision", "visual"):
            part = SubElement(link, kind, name=f"{_name(box.name)}_{kind}")
            _leaves(part, pose=_numbers(box.x, box.y, half, 0, 0, box.yaw))
            _leaves(
                SubElement(SubElement(part, "geometry"), "box"),
                size=_numbers(box.length, box.thickness, 2 * half),
            )
            if kind == "collision":
                _set_contacts(part, WALL_BIT)
    if not len(world.discs):
        return
    link = SubElement(_static(place, "round_obstacles"), "link", name="link")
    for k, (x, y, radius) in enumerate(world.discs):
        for kind in ("collision", "visual"):
            part = SubElement(link, kind, name=f"disc_{k}_{kind}")
            _leaves(part, pose=_numbers(x, y, half, 0, 0, 0))
            _leaves(
                SubElement(SubElement(part, "geometry"), "cylinder"), radius=float(radius), length=2 * half
            )
            if kind == "collision":
                _set_contacts(part, WALL_BIT)


def _add_part(
    link: ElementTree.Element, name: str, shape: str, pose: str, **size: float
) -> ElementTree.Element:
    """Add a visible and a collision shape; return the collision shape."""
    for kind in ("visual", "collision"):
        part = SubElement(link, kind, name=f"{name}_{kind}")
        _leaves(part, pose=pose)
        _leaves(SubElement(SubElement(part, "geometry"), shape), **size)
    return part


def _set_contacts(collision: ElementTree.Element, bits: str) -> None:
    """Let a shape touch only shapes that share a bit; without bits, a shape has all of them."""
    _leaves(SubElement(SubElement(collision, "surface"), "contact"), collide_bitmask=bits)


def _add_mass(link: ElementTree.Element, mass: float, radius: float, length: float, pose: str) -> None:
    """Give a link the mass of a cylinder."""
    inertial = SubElement(link, "inertial")
    _leaves(inertial, pose=pose, mass=mass)
    across = mass * (3 * radius**2 + length**2) / 12
    _leaves(SubElement(inertial, "inertia"), ixx=across, iyy=across, izz=mass * radius**2 / 2)


def _add_robot(world: ExportedWorld, place: ElementTree.Element) -> None:
    robot, limits = world.robot, world.robot.limits
    model = SubElement(place, "model", name=_name(robot.name), canonical_link="base_link")
    _leaves(model, pose=_numbers(*world.start[:2], 0, 0, 0, world.start[2]))
    base = SubElement(model, "link", name="base_link")
    length = world.body_height
    _add_mass(
        base, BODY_MASS, robot.footprint_radius, length, _numbers(0, 0, CLEARANCE + length / 2, 0, 0, 0)
    )
    _add_part(
        base, "body", "cylinder", _numbers(0, 0, CLEARANCE + length / 2, 0, 0, 0), radius=robot.footprint_radius,
        length=length,
    )  # fmt: skip
    for name, x in (("front", world.caster_reach), ("rear", -world.caster_reach)):
        ball = _add_part(base, f"caster_{name}", "sphere", _numbers(x, 0, CASTER, 0, 0, 0), radius=CASTER)
        _leaves(SubElement(SubElement(SubElement(ball, "surface"), "friction"), "ode"), mu=0.0, mu2=0.0)
    _add_lidar(world, base)
    for side, y in (("left", robot.wheels.base / 2), ("right", -robot.wheels.base / 2)):
        wheel = SubElement(model, "link", name=f"{side}_wheel")
        _leaves(wheel, pose=_numbers(0, y, robot.wheels.radius, -np.pi / 2, 0, 0))
        _add_mass(wheel, WHEEL_MASS, robot.wheels.radius, WHEEL_WIDTH, "0 0 0 0 0 0")
        tyre = _add_part(
            wheel, side, "cylinder", "0 0 0 0 0 0", radius=robot.wheels.radius, length=WHEEL_WIDTH
        )
        _set_contacts(tyre, TYRE_BIT)
        joint = SubElement(model, "joint", name=f"{side}_wheel_joint", type="revolute")
        _leaves(joint, parent="base_link", child=f"{side}_wheel")
        _leaves(SubElement(joint, "axis"), xyz="0 0 1")
    drive = SubElement(
        model, "plugin", filename="gz-sim-diff-drive-system", name="gz::sim::systems::DiffDrive"
    )
    _leaves(
        drive, left_joint="left_wheel_joint", right_joint="right_wheel_joint", wheel_separation=robot.wheels.base,
        wheel_radius=robot.wheels.radius, odom_publish_frequency=robot.wheels.rate, topic="cmd_vel",
        odom_topic="odom", tf_topic="tf", frame_id="odom", child_frame_id="base_link",
        max_linear_velocity=min(limits.v, world.drivetrain.v_max),
        min_linear_velocity=-min(limits.v, world.drivetrain.v_max),
        max_angular_velocity=limits.omega, min_angular_velocity=-limits.omega,
        max_linear_acceleration=limits.a, min_linear_acceleration=-limits.a,
        max_angular_acceleration=limits.alpha, min_angular_acceleration=-limits.alpha,
    )  # fmt: skip
    pose = SubElement(
        model, "plugin", filename="gz-sim-pose-publisher-system", name="gz::sim::systems::PosePublisher"
    )
    _leaves(pose, publish_model_pose="true", update_frequency=robot.pose.rate)


def _add_lidar(world: ExportedWorld, base: ElementTree.Element) -> None:
    sensor = world.robot.sensor
    laser = SubElement(base, "sensor", name="laser", type="gpu_lidar")
    _leaves(
        laser, pose=_numbers(world.mount[0], world.mount[1], sensor.height, 0, 0, world.mount[2]), topic="scan",
        update_rate=sensor.rate, always_on="true", gz_frame_id="laser",
    )  # fmt: skip
    lidar = SubElement(laser, "lidar")
    fan = SubElement(SubElement(lidar, "scan"), "horizontal")
    _leaves(
        fan, samples=str(sensor.n_rays), resolution="1", min_angle=float(sensor.bearings[0]),
        max_angle=float(sensor.bearings[-1]),
    )  # fmt: skip
    _leaves(
        SubElement(lidar, "range"), min=sensor.range_min, max=sensor.range_max, resolution=sensor.resolution
    )
    bias = sum(a["b"] for a in world.effects if a.effect is RANGE_BIAS)
    _leaves(SubElement(lidar, "noise"), type="gaussian", mean=float(bias), stddev=sensor.sigma)
