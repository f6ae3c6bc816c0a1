"""The laser and the DiffDrive plugin of Gazebo, gz and classic: the same elements in SDF and in URDF.

The numbers of the plugin are what the driver assumes, and the geometry is what the robot has. A driver that
assumes wheels (1 + s) times the true ones reports (1 + s) times the true distance, in Gazebo as on the robot.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

from sensorgraph.amending.findings import CannotHoldError, MeasuredLaser, why
from sensorgraph.amending.numbers import known, number_in, put
from sensorgraph.amending.text import Why, note, number_text
from sensorgraph.amending.xacro import Document, Node
from sensorgraph.effects import Amendment
from sensorgraph.errors import SensorgraphError

LASERS = ("ray", "gpu_ray", "lidar", "gpu_lidar")
"""Types of a sensor that is a laser."""
RADIUS = ("wheel_radius", "wheelRadius")
DIAMETER = ("wheel_diameter", "wheelDiameter")
SEPARATION = ("wheel_separation", "wheelSeparation")
SAME_ANGLE = 1e-5
"""[rad] Difference of angles that a LaserScan, in single precision, does not show."""
SIGMAS = 3.0
"""Standard errors from which a measured rate differs from the stated one."""


def is_diff_drive(plugin: Node) -> bool:
    """Return whether a plugin is a differential or skid-steer drive of gz or of Gazebo classic."""
    name = plugin.get("filename") + plugin.get("name")
    return any(one in name for one in ("diff-drive", "diff_drive", "DiffDrive", "skid_steer_drive"))


def choose(
    named: Sequence[tuple[str, Node]], laser: str | None, others: Iterable[str], file: str
) -> Node | None:
    """Return the laser to amend among named ones; None without one.

    Raises
    ------
    SensorgraphError : The given name is not there, or there are several and none is given.
    """
    names = [name for name, _ in named]
    if laser is not None:
        found = [node for name, node in named if name == laser or node.get("name") == laser]
        if found:
            return found[0]
        known = names or sorted({one for one in others if one})
        raise SensorgraphError(
            f"{file}: there is no laser `{laser}`; give one of {', '.join(f'`{one}`' for one in known[:12]) or 'none'}"
        )
    if len(named) > 1:
        raise SensorgraphError(
            f"{file}: has {len(named)} lasers, {', '.join(f'`{one}`' for one in names)}; choose one with `laser`"
        )
    return named[0][1] if named else None


class GazeboSensor:
    """The `<sensor>` element of a laser."""

    def __init__(self, document: Document, sensor: Node) -> None:
        self.document, self.sensor = document, sensor
        kind = next((one for one in ("lidar", "ray") if sensor.child(one)), "")
        self.ray = sensor.child(kind) if kind else None
        self._added: dict[str, tuple[float, Why]] = {}

    def bias(self, a: Amendment) -> None:
        """Add a constant offset to the mean of the noise."""
        self._noise("mean", lambda old: old + a["b"], why(a, "b"))

    def growing_noise(self, a: Amendment, laser: MeasuredLaser | None) -> None:
        """Write the root mean square of noise that grows with the range."""
        if laser is None:
            raise CannotHoldError(
                "`<stddev>` is one number for all ranges; give a run, whose ranges determine the best one"
            )
        square = a["k"] ** 2 * laser.mean_square_range
        sigma = why(a, "k", per=math.sqrt(laser.mean_square_range))
        self._noise("stddev", lambda old: math.hypot(old, math.sqrt(square)), sigma)

    def limit(self, tag: str, value: float, reason: Why) -> None:
        """Write `<min>`, `<max>` or `<resolution>` of the ranges."""
        self._leaf(self._ray().child("range"), tag, value, reason)

    def measured(self, laser: MeasuredLaser) -> None:
        """Write rate, rays, angles and ranges of a log, where they differ from those of the file."""
        cause = f"as in {laser.name}"
        stated = number_in(self.sensor, "update_rate")
        if stated is None or abs(stated - laser.rate) > SIGMAS * laser.rate_sigma:
            self._leaf(self.sensor, "update_rate", laser.rate, Why(cause=cause, sigma=laser.rate_sigma))
        fan = self._ray().child("scan", "horizontal")
        rays = {"samples": laser.n_rays, "min_angle": laser.angle_min, "max_angle": laser.angle_max}
        if fan is not None and not all(_states(fan, tag, value) for tag, value in rays.items()):
            for tag, value in rays.items():
                self._leaf(fan, tag, value, Why(cause=cause))
        self.limit("min", laser.range_min, Why(cause=cause))
        self.limit("max", laser.range_max, Why(cause=cause))

    def finish(self) -> None:
        """Add a `<noise>` element with the numbers that were found, if the laser had none."""
        if not self._added:
            return
        at = self._ray().child("range") or self._ray().child("scan") or self.sensor.children[-1]
        values = {tag: self._added[tag][0] if tag in self._added else 0.0 for tag in ("mean", "stddev")}
        inner = "".join(f"<{tag}>{number_text(value)}</{tag}>" for tag, value in values.items())
        phrase = "; ".join(note(None, reason) for _, reason in self._added.values())
        at.origin.add_behind(f"<noise><type>gaussian</type>{inner}</noise>", phrase)

    def _noise(self, tag: str, change: Callable[[float], float], reason: Why) -> None:
        ray = self._ray()
        noise = ray.child("noise") or self.sensor.child("noise")
        if noise is None:
            self._added[tag] = (change(0.0), reason)
            return
        if self._switch_on(noise, reason):
            for one in ("mean", "stddev"):
                self._leaf(noise, one, change(0.0) if one == tag else 0.0, reason)
            return
        leaf = noise.child(tag)
        old = 0.0 if leaf is None or leaf.text is None else known(leaf.text)
        self._leaf(noise, tag, change(old), reason)

    def _switch_on(self, noise: Node, reason: Why) -> bool:
        """Make noise of type none gaussian; return whether it was of type none."""
        kind = noise.child("type")
        value = noise.attributes.get("type") if kind is None else kind.text
        if value is None or value.text.strip() != "none":
            return False
        value.file.replace(value.span, "gaussian", note("none", Why(cause=reason.cause)), value.anchor)
        return True

    def _leaf(self, parent: Node | None, tag: str, value: float, reason: Why) -> None:
        if parent is None:
            raise CannotHoldError(f"its laser has no element for `<{tag}>`")
        _put_leaf(self.document, parent, tag, value, reason)

    def _ray(self) -> Node:
        if self.ray is None:
            raise CannotHoldError("its laser has no `<lidar>` or `<ray>`")
        return self.ray


class DiffDrive:
    """The plugin of a differential drive."""

    def __init__(self, document: Document, plugins: Sequence[Node]) -> None:
        self.document, self.plugins = document, plugins

    def radius(self, a: Amendment) -> None:
        """Let the driver assume wheels (1 + s) times as large."""
        self._scale((*RADIUS, *DIAMETER), a)

    def base(self, a: Amendment) -> None:
        """Let the driver assume a wheelbase (1 + s) times as large."""
        self._scale(SEPARATION, a)

    def saturation(self, a: Amendment) -> None:
        """Limit the speed."""
        plugin = self._plugin()
        if "libgazebo" in plugin.get("filename"):
            raise CannotHoldError("the plugin of Gazebo classic has no limit of speed")
        for tag, value in (("max_linear_velocity", a["v_max"]), ("min_linear_velocity", -a["v_max"])):
            old = number_in(plugin, tag)
            if old is None or abs(old) > a["v_max"]:
                _put_leaf(self.document, plugin, tag, value, why(a, "v_max"))

    def _scale(self, tags: Sequence[str], a: Amendment) -> None:
        plugin = self._plugin()
        leaves = [leaf for leaf in plugin.children if leaf.tag in tags and leaf.text is not None]
        if not leaves:
            raise CannotHoldError(f"the plugin has no `<{tags[0]}>`")
        for leaf in leaves:
            assert leaf.text is not None
            old = known(leaf.text)
            reason = why(a, "s", per=old)
            cause = f"{reason.cause}, assumed by the driver"
            put(self.document, leaf.text, old * (1 + a["s"]), Why(cause=cause, sigma=reason.sigma))

    def _plugin(self) -> Node:
        if not self.plugins:
            raise CannotHoldError("it has no DiffDrive plugin")
        if len(self.plugins) > 1:
            raise CannotHoldError(f"it has {len(self.plugins)} DiffDrive plugins")
        if not self.plugins[0].children:
            raise CannotHoldError("the DiffDrive plugin is empty")
        return self.plugins[0]


def _states(fan: Node, tag: str, value: float) -> bool:
    """Return whether a fan of rays states their number, or an angle [rad]."""
    stated = number_in(fan, tag)
    return stated is not None and abs(stated - value) < SAME_ANGLE


def _put_leaf(document: Document, parent: Node, tag: str, value: float, reason: Why) -> None:
    """Write the number of a child, which is added behind the others if it is missing.

    Raises
    ------
    CannotHoldError : The parent is empty.
    """
    leaf = parent.child(tag)
    if leaf is not None and leaf.text is not None:
        put(document, leaf.text, value, reason)
    elif parent.children:
        parent.children[-1].origin.add_behind(f"<{tag}>{number_text(value)}</{tag}>", note(None, reason))
    else:
        raise CannotHoldError(f"its laser has no element for `<{tag}>`")
