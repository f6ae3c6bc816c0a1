"""URDF and xacro: the origin of the laser's joint, the wheels, and the Gazebo elements in `<gazebo>`."""

from __future__ import annotations

import re

import numpy as np

from sensorgraph.amending.findings import CannotHoldError, MeasuredLaser, apply, why
from sensorgraph.amending.gazebo import LASERS, DiffDrive, GazeboSensor, choose, is_diff_drive
from sensorgraph.amending.numbers import known, number, scale
from sensorgraph.amending.place import NewPose, numbers_text, rotation, shift, triple, turn
from sensorgraph.amending.sdf import sensor_handlers, write_measured
from sensorgraph.amending.text import note, number_text
from sensorgraph.amending.xacro import Document, Node, Value
from sensorgraph.effects import Amendment
from sensorgraph.effects.mount_xy import MOUNT_XY
from sensorgraph.effects.mount_yaw import MOUNT_YAW
from sensorgraph.effects.speed_saturation import SPEED_SATURATION
from sensorgraph.effects.wheel_base import WHEEL_BASE
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_radius_diff import WHEEL_RADIUS_DIFF
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Floats

WHAT = "URDF"
LASER_NAME = re.compile(r"laser|lidar|scan|lds|hokuyo|sick|velodyne|ouster", re.IGNORECASE)
"""Names by which a laser's link is recognized if no `<gazebo>` element has a sensor."""
WHEEL_NAME = re.compile(r"wheel|tyre|tire", re.IGNORECASE)


def amend_urdf(
    document: Document,
    amendments: tuple[Amendment, ...],
    *,
    laser: str | None,
    measured: MeasuredLaser | None,
    file: str,
) -> list[str]:
    """Amend a URDF or a xacro; return what it cannot hold, one line each.

    Raises
    ------
    SensorgraphError : The laser is not there, or there are several.
    """
    model = _UrdfModel(document, laser, file)
    drive = DiffDrive(document, model.plugins)
    handlers = {
        WHEEL_RADIUS: drive.radius if model.plugins else model.radius,
        WHEEL_BASE: drive.base if model.plugins else model.base,
        WHEEL_RADIUS_DIFF: model.radius_difference,
        SPEED_SATURATION: drive.saturation,
        MOUNT_XY: model.shift,
        MOUNT_YAW: model.turn,
        **sensor_handlers(model.sensor, measured),
    }
    lines = write_measured(model.sensor, measured, file)
    lines += apply(amendments, handlers, WHAT, file, document.files)
    model.finish()
    if model.sensor is not None:
        model.sensor.finish()
    if document.unknown and lines:
        lines.append(
            f"{file}: no given file defines {', '.join(f'`{one}`' for one in document.unknown[:8])}; "
            "give the file of each macro, too"
        )
    return lines


class _UrdfModel:
    """Links, joints, lasers and plugins of a URDF."""

    def __init__(self, document: Document, laser: str | None, file: str) -> None:
        self.document, self.file = document, file
        self.links = {node.get("name"): node for node in document.all("link") if node.get("name")}
        self.joints = [node for node in document.all("joint") if node.child("parent") and node.child("child")]
        self.joint_of = {_link(joint, "child"): joint for joint in self.joints}
        self.plugins = [node for node in document.all("plugin") if is_diff_drive(node)]
        sensors = [
            (gazebo.get("reference"), sensor)
            for gazebo in document.all("gazebo")
            for sensor in gazebo.all("sensor")
            if sensor.get("type") in LASERS
        ]
        self._new: dict[Node, NewPose] = {}
        self.sensor: GazeboSensor | None = None
        if sensors:
            chosen = choose(sensors, laser, self.links, file)
            assert chosen is not None
            self.sensor = GazeboSensor(document, chosen)
            self.laser: str | None = next(name for name, one in sensors if one is chosen)
        else:
            self.laser = self._laser_by_name(laser)

    def _laser_by_name(self, laser: str | None) -> str | None:
        if laser is not None:
            choose([(name, node) for name, node in self.links.items()], laser, self.links, self.file)
            return laser
        named = [name for name in self.links if LASER_NAME.search(name) and name in self.joint_of]
        parents = {_link(self.joint_of[name], "parent") for name in named}
        ends = [name for name in named if name not in parents]
        if len(ends) > 1:
            raise SensorgraphError(
                f"{self.file}: {len(ends)} links may be the laser, {', '.join(f'`{one}`' for one in ends)}; "
                "choose one with `laser`"
            )
        return ends[0] if ends else None

    def shift(self, a: Amendment) -> None:
        """Move the origin of the laser's joint."""
        joint, parent = self._laser_joint()
        origin = joint.child("origin")
        if origin is None or "xyz" not in origin.attributes:
            self._new.setdefault(joint, NewPose()).shift(a, parent)
        else:
            shift(self.document, _three(origin, "xyz"), a, parent)

    def turn(self, a: Amendment) -> None:
        """Turn the origin of the laser's joint."""
        joint, parent = self._laser_joint()
        origin = joint.child("origin")
        if origin is None or "rpy" not in origin.attributes:
            self._new.setdefault(joint, NewPose()).turn(a, parent)
        else:
            turn(self.document, _three(origin, "rpy"), a, parent)

    def finish(self) -> None:
        """Add what an origin lacks, or the origin."""
        for joint, pose in self._new.items():
            origin, phrase = joint.child("origin"), "; ".join(pose.phrases)
            lacks = {"xyz": pose.xyz, "rpy": pose.rpy}
            parts = {name: numbers_text(value) for name, value in lacks.items() if value is not None}
            if origin is None:
                text = " ".join(f'{name}="{value}"' for name, value in parts.items())
                joint.children[-1].origin.add_behind(f"<origin {text}/>", phrase)
                continue
            for name, value in parts.items():
                origin.origin.add_attribute(name, value, phrase)

    def radius(self, a: Amendment) -> None:
        """Write the true radius of the wheels: without a plugin, only the geometry has one."""
        self._divide([value for _, value in self._radii()], a)

    def base(self, a: Amendment) -> None:
        """Write the true distance of the wheels."""
        origins = [origin for joint in self._wheels() if (origin := joint.child("origin")) is not None]
        self._divide([_three(origin, "xyz")[1] for origin in origins], a)

    def _divide(self, values: list[Value], a: Amendment) -> None:
        """Divide sizes by 1 + s."""
        for value in values:
            known(value)
        factor = 1 / (1 + a["s"])
        scale(self.document, values, factor, why(a, "s", per=factor**2))

    def radius_difference(self, a: Amendment) -> None:
        """Write different radii of the left and right wheels."""
        spans: dict[tuple[int, int], set[bool]] = {}
        radii = self._radii()
        for is_left, value in radii:
            spans.setdefault(value.span, set()).add(is_left)
        if any(len(sides) > 1 for sides in spans.values()):
            raise CannotHoldError("one macro sets the radius of both wheels")
        for is_left, value in radii:
            old = known(value)
            factor = 1 + (0.5 if is_left else -0.5) * a["s"]
            value.file.replace(
                value.span,
                number_text(old * factor),
                note(value.text.strip(), why(a, "s", per=old / 2)),
                value.anchor,
            )

    def _laser_joint(self) -> tuple[Node, Floats]:
        """Return the nearest joint whose origin places only this laser, and the rotation of its parent in base_link."""
        if self.laser is None:
            raise CannotHoldError("it has no link of a laser")
        base = self._rotation("base_link") if "base_link" in self.links else np.eye(3)
        name = self.laser
        while name in self.joint_of:
            joint = self.joint_of[name]
            parent = _link(joint, "parent")
            origin = joint.child("origin")
            shared = [
                one for one in self.joints
                if one is not joint and origin is not None and one.child("origin") is not None
                and one.child("origin").origin is origin.origin  # type: ignore[union-attr]
            ]  # fmt: skip
            if not shared:
                return joint, base.T @ self._rotation(parent)
            name = parent
        raise CannotHoldError(f"no joint places only the link `{self.laser}`")

    def _rotation(self, link: str, depth: int = 0) -> Floats:
        """Return the rotation (3, 3) of a link in the root of the tree."""
        joint = self.joint_of.get(link)
        if joint is None or depth > 100:
            return np.eye(3)
        origin = joint.child("origin")
        rpy = [] if origin is None or "rpy" not in origin.attributes else origin.attributes["rpy"].tokens()
        return np.asarray(self._rotation(_link(joint, "parent"), depth + 1) @ rotation(triple(rpy)))

    def _wheels(self) -> list[Node]:
        """Return the joints of the driven wheels, which are aside from the middle."""
        found = []
        for joint in self.joints:
            origin = joint.child("origin")
            if joint.get("type") != "continuous" or origin is None or "xyz" not in origin.attributes:
                continue
            y = number(_three(origin, "xyz")[1])
            if y and WHEEL_NAME.search(joint.get("name") + _link(joint, "child")):
                found.append(joint)
        if not found:
            raise CannotHoldError("it has no continuous joint of a wheel with a known origin")
        return found

    def _radii(self) -> list[tuple[bool, Value]]:
        """Return (is left, radius) of each cylinder or sphere of a wheel."""
        found = []
        for joint in self._wheels():
            origin = joint.child("origin")
            link = self.links.get(_link(joint, "child"))
            assert origin is not None
            is_left = (number(_three(origin, "xyz")[1]) or 0.0) > 0
            for shape in [] if link is None else link.all("cylinder", "sphere"):
                if "radius" in shape.attributes:
                    found.append((is_left, shape.attributes["radius"]))
        if not found:
            raise CannotHoldError("its wheels have no cylinder or sphere")
        return found


def _link(joint: Node, end: str) -> str:
    node = joint.child(end)
    return "" if node is None else node.get("link")


def _three(origin: Node, name: str) -> list[Value]:
    values = origin.attributes[name].tokens()
    if len(values) != 3:
        raise CannotHoldError(f"`{name}` of an origin has {len(values)} numbers; expected 3")
    return values
