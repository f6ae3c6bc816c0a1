"""SDF of gz and of Gazebo classic: the laser's `<sensor>`, its pose, the wheels, and the DiffDrive plugin."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from sensorgraph.amending.findings import CannotHoldError, MeasuredLaser, apply, why
from sensorgraph.amending.gazebo import LASERS, DiffDrive, GazeboSensor, choose, is_diff_drive
from sensorgraph.amending.numbers import known, put
from sensorgraph.amending.place import NewPose, numbers_text, rotation, shift, triple, turn
from sensorgraph.amending.xacro import Document, Node, Value
from sensorgraph.effects import Amendment
from sensorgraph.effects.max_range import MAX_RANGE
from sensorgraph.effects.min_range import MIN_RANGE
from sensorgraph.effects.mount_xy import MOUNT_XY
from sensorgraph.effects.mount_yaw import MOUNT_YAW
from sensorgraph.effects.quantisation import QUANTISATION
from sensorgraph.effects.range_bias import RANGE_BIAS
from sensorgraph.effects.range_noise import RANGE_NOISE
from sensorgraph.effects.speed_saturation import SPEED_SATURATION
from sensorgraph.effects.wheel_base import WHEEL_BASE
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_radius_diff import WHEEL_RADIUS_DIFF
from sensorgraph.types import Floats

WHAT = "SDF"


def amend_sdf(
    document: Document,
    amendments: tuple[Amendment, ...],
    *,
    laser: str | None,
    measured: MeasuredLaser | None,
    file: str,
) -> list[str]:
    """Amend an SDF; return what it cannot hold, one line each.

    Raises
    ------
    SensorgraphError : The laser is not there, or there are several.
    """
    model = _SdfModel(document, laser, file)
    sensor, drive = model.sensor, DiffDrive(document, model.plugins)
    handlers = {
        WHEEL_RADIUS: drive.radius,
        WHEEL_BASE: drive.base,
        WHEEL_RADIUS_DIFF: model.radius_difference,
        SPEED_SATURATION: drive.saturation,
        MOUNT_XY: model.shift,
        MOUNT_YAW: model.turn,
        **sensor_handlers(sensor, measured),
    }
    lines = write_measured(sensor, measured, file)
    lines += apply(amendments, handlers, WHAT, file, document.files)
    model.finish()
    if sensor is not None:
        sensor.finish()
    return lines


def sensor_handlers(sensor: GazeboSensor | None, measured: MeasuredLaser | None) -> dict:  # type: ignore[type-arg]
    """Return the handlers of effects on a laser's `<sensor>`, in SDF and in URDF."""

    def there() -> GazeboSensor:
        if sensor is None:
            raise CannotHoldError("it has no laser `<sensor>`")
        return sensor

    return {
        RANGE_BIAS: lambda a: there().bias(a),
        RANGE_NOISE: lambda a: there().growing_noise(a, measured),
        MAX_RANGE: lambda a: there().limit("max", a["R"], why(a, "R")),
        MIN_RANGE: lambda a: there().limit("min", a["r_min"], why(a, "r_min")),
        QUANTISATION: lambda a: there().limit("resolution", a["q"], why(a, "q")),
    }


def write_measured(sensor: GazeboSensor | None, measured: MeasuredLaser | None, file: str) -> list[str]:
    """Write the settings of a measured laser, before effects; return a line if the file has no laser for them."""
    if sensor is None or measured is None:
        return []
    try:
        sensor.measured(measured)
    except CannotHoldError as exc:
        return [f"{file}: the laser of {measured.name}: {exc}"]
    return []


class _SdfModel:
    """Links, lasers, joints and plugins of an SDF."""

    def __init__(self, document: Document, laser: str | None, file: str) -> None:
        _place_included(document)
        self.document = document
        self._new = NewPose()
        self.links = {node.get("name"): node for node in document.all("link")}
        found = [node for node in document.all("sensor") if node.get("type") in LASERS]
        chosen = choose([(one.get("name"), one) for one in found], laser, self.links, file)
        self.sensor = None if chosen is None else GazeboSensor(document, chosen)
        plugins = [node for node in document.all("plugin") if is_diff_drive(node)]
        robot = [] if chosen is None else list(chosen.around("model"))[-1:]
        own = [node for node in plugins if robot and robot[0] in node.around("model")]
        self.plugins = own or plugins

    def shift(self, a: Amendment) -> None:
        """Move the laser."""
        pose, parent = self._pose()
        if pose is None:
            self._new.shift(a, parent)
        else:
            shift(self.document, _six(pose)[:3], a, parent)

    def turn(self, a: Amendment) -> None:
        """Turn the laser."""
        pose, parent = self._pose()
        if pose is None:
            self._new.turn(a, parent)
        else:
            unit = math.pi / 180 if pose.get("degrees") == "true" else 1.0
            turn(self.document, _six(pose)[3:], a, parent, unit)

    def radius_difference(self, a: Amendment) -> None:
        """Change the radii of the wheels' collision shapes: the driver assumes equal wheels."""
        if len(self.plugins) != 1:
            raise CannotHoldError("it has no DiffDrive plugin, which names the wheels")
        plugin = self.plugins[0]
        wheels = [
            (side, sign, joint.content())
            for side, sign in (("left", 1.0), ("right", -1.0))
            for joint in plugin.children
            if re.fullmatch(f"{side}.*joint", joint.tag, re.IGNORECASE)
        ]
        if len({side for side, _, _ in wheels}) < 2:
            raise CannotHoldError("its DiffDrive plugin does not name a left and a right joint")
        for side, sign, name in wheels:
            joint = _frame(name, plugin)
            link = None if joint is None else _frame(joint.content("child"), joint)
            shapes = [] if link is None else list(link.all("collision"))
            leaves = [
                leaf.text
                for shape in shapes
                for round_ in shape.all("cylinder", "sphere")
                if (leaf := round_.child("radius")) is not None and leaf.text is not None
            ]
            if not leaves:
                raise CannotHoldError(f"the {side} wheel `{name}` has no collision cylinder or sphere")
            for radius in leaves:
                old = known(radius)
                factor = sign * a["s"] / 2
                put(self.document, radius, old * (1 + factor), why(a, "s", per=old / 2))

    def _pose(self) -> tuple[Node | None, Floats]:
        """Return the `<pose>` that places the laser, and the rotation (3, 3) of its parent in base_link."""
        if self.sensor is None:
            raise CannotHoldError("it has no laser `<sensor>`")
        node = self.sensor.sensor
        link = next(node.around("link"), None)
        origin = _base_link(node)
        base = self._rotation(origin)
        own = node.child("pose")
        if not node.children:
            raise CannotHoldError("its laser is empty")
        placed = None if link is None or link is origin else link.child("pose")
        if own is None and link is not None and placed is not None and len(list(link.all("sensor"))) == 1:
            outer = _frame(placed.get("relative_to"), link) or _nested_model(link)
            return placed, base.T @ self._rotation(outer)
        return own, base.T @ self._rotation(link)

    def _rotation(self, frame: Node | None, depth: int = 0) -> Floats:
        """Return the rotation (3, 3) of a link, joint, frame or nested model in the robot's model."""
        pose = None if frame is None else frame.child("pose")
        if frame is None or depth > 20:
            return np.eye(3)
        outer = "" if pose is None else pose.get("relative_to")
        if not outer and frame.tag == "joint":
            outer = frame.content("child")
        if not outer and frame.tag == "frame":
            outer = frame.get("attached_to")
        parent = _frame(outer, frame) or _nested_model(frame)
        turned = np.eye(3)
        if pose is not None and pose.text is not None:
            unit = math.pi / 180 if pose.get("degrees") == "true" else 1.0
            if pose.get("rotation_format") == "quat_xyzw":
                quaternion = [known(one) for one in pose.text.tokens()[3:7]]
                if len(quaternion) < 4 or not any(quaternion):
                    raise CannotHoldError(f"the quaternion of `{frame.get('name')}` is not a rotation")
                return np.asarray(
                    self._rotation(parent, depth + 1) @ Rotation.from_quat(quaternion).as_matrix()
                )
            turned = rotation([unit * value for value in triple(pose.text.tokens()[3:])])
        return np.asarray(self._rotation(parent, depth + 1) @ turned)

    def finish(self) -> None:
        """Add a pose to the laser that had none, if an effect moved it."""
        if self._new.phrases and self.sensor is not None:
            first = self.sensor.sensor.children[0].origin
            zero = [0.0, 0.0, 0.0]
            text = numbers_text([*(self._new.xyz or zero), *(self._new.rpy or zero)])
            first.add_behind(f"<pose>{text}</pose>", "; ".join(self._new.phrases))


def _place_included(document: Document) -> None:
    """Put a model that one `<include>` of another given file names in its place, with its name and pose, as SDF does."""
    includes = list(document.all("include"))
    for root in document.roots:
        for model in [one for one in root.children if one.tag == "model"]:
            names = {
                model.get("name"),
                model.origin.file.path.absolute().parent.name,
                model.origin.file.path.name,
            }
            found = [one for one in includes if names & set(Path(one.content("uri")).parts[-1:])]
            around = found[0].parent if len(found) == 1 else None
            if around is None or root in found[0].around():
                continue
            model.parent, include = around, found[0]
            around.children.append(model)
            root.children.remove(model)
            model.children[:0] = [one for one in include.children if one.tag == "pose"]
            if (name := include.child("name")) is not None and name.text is not None:
                model.attributes["name"] = name.text


def _nested_model(node: Node) -> Node | None:
    """Return the model around a node if it is nested; the world's models are placed anywhere."""
    around = list(node.around("model"))
    return around[0] if len(around) > 1 else None


def _frame(name: str, near: Node) -> Node | None:
    """Return the link, joint, frame or model of a name, such as `lidar::link`, in the models around a node."""
    last = name.rsplit("::", 1)[-1]
    for model in near.around("model"):
        for one in model.all("link", "joint", "frame", "model"):
            if last and one.get("name") == last and one is not near:
                return one
    return None


def _base_link(sensor: Node) -> Node | None:
    """Return the link `base_link` of the robot with a sensor, or its first link."""
    robot = next(reversed(list(sensor.around("model"))), None)
    links = [] if robot is None else list(robot.all("link"))
    return next((one for one in links if one.get("name") == "base_link"), links[0] if links else None)


def _six(pose: Node) -> list[Value]:
    values = [] if pose.text is None else pose.text.tokens()
    if len(values) != 6:
        raise CannotHoldError(f"the laser's `<pose>` has {len(values)} numbers; expected 6")
    return values
