"""MJCF of MuJoCo: the laser's body or sites, the wheels' geoms and bodies, and the actuators' lag and delay.

A controller outside the file sets the speeds of the wheels. The file holds the geometry, and so the true radius
and distance of the wheels; the controller keeps the numbers that the driver of the robot assumes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

import numpy as np

from sensorgraph.amending.findings import CannotHoldError, MeasuredLaser, apply, why
from sensorgraph.amending.gazebo import choose
from sensorgraph.amending.mjcf_defaults import default_of
from sensorgraph.amending.mjcf_frames import (
    ORIENTATIONS,
    numbers_of,
    own_rotation,
    turn_frame,
)
from sensorgraph.amending.numbers import known, number, put
from sensorgraph.amending.place import shift, shift_of
from sensorgraph.amending.text import Why, note, number_text
from sensorgraph.amending.xacro import Document, Node, Value
from sensorgraph.effects import Amendment
from sensorgraph.effects.actuator_lag import ACTUATOR_LAG
from sensorgraph.effects.dead_time import DEAD_TIME
from sensorgraph.effects.latency import LATENCY
from sensorgraph.effects.max_range import MAX_RANGE
from sensorgraph.effects.mount_xy import MOUNT_XY
from sensorgraph.effects.mount_yaw import MOUNT_YAW
from sensorgraph.effects.wheel_base import WHEEL_BASE
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_radius_diff import WHEEL_RADIUS_DIFF
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Floats

WHAT = "MJCF"
ROUND = {"sphere": (0,), "cylinder": (0,), "capsule": (0,), "ellipsoid": (0, 2)}
"""Type of a geom -> the numbers of its size that are radii of a wheel."""
MAX_DELAY_STEPS = 100_000
"""Maximum number of time steps in the history of a delayed actuator."""
DEFAULT_STEP = 0.002
"""[s] Time step of MuJoCo if the file states none."""
DELAY_SINCE = "MuJoCo 3.5 or later"


def amend_mjcf(
    document: Document,
    amendments: tuple[Amendment, ...],
    *,
    laser: str | None,
    measured: MeasuredLaser | None,
    file: str,
) -> list[str]:
    """Amend an MJCF; return what it cannot hold, one line each.

    Raises
    ------
    SensorgraphError : The laser is not there, or there are several.
    """
    model = _MjcfModel(document, laser, file)
    handlers = {
        WHEEL_RADIUS: model.radius,
        WHEEL_RADIUS_DIFF: model.radius_difference,
        WHEEL_BASE: model.base,
        ACTUATOR_LAG: model.lag,
        DEAD_TIME: model.delay,
        LATENCY: model.latency,
        MOUNT_XY: model.shift,
        MOUNT_YAW: model.turn,
        MAX_RANGE: lambda a: model.cutoff(a["R"], why(a, "R")),
    }
    if measured is not None and model.rangefinders:
        model.cutoff(measured.range_max, Why(cause=f"as in {measured.name}"))
    return apply(amendments, handlers, WHAT, file, document.files)


class _MjcfModel:
    """Bodies, joints, actuators and rangefinders of an MJCF."""

    def __init__(self, document: Document, laser: str | None, file: str) -> None:
        self.document = document
        self.bodies = {node.get("name"): node for node in document.all("body") if node.get("name")}
        self.sites = {node.get("name"): node for node in document.all("site")}
        self.rangefinders = list(document.all("rangefinder"))
        self.angle = 1.0 if self._option("compiler", "angle") == "radian" else math.pi / 180
        self.order = self._option("compiler", "eulerseq") or "xyz"
        if not re.fullmatch("[xyzXYZ]{3}", self.order):
            raise SensorgraphError(f"{file}: eulerseq is `{self.order}`; expected three of x, y, z, X, Y, Z")
        self.frames = self._laser_frames(laser, file)
        below = {id(site) for frame in self.frames for site in frame.all("site")}
        own = [one for one in self.rangefinders if id(self._site(one.get("site"))) in below]
        self.rangefinders = own or self.rangefinders

    def _laser_frames(self, laser: str | None, file: str) -> list[Node]:
        """Return the body of the laser, or its sites if it has no body for itself."""
        if laser is not None and laser in self.bodies | self.sites:
            return [(self.bodies | self.sites)[laser]]
        sites = [node for one in self.rangefinders if (node := self._site(one.get("site"))) is not None]
        by_body: dict[int, tuple[Node, list[Node]]] = {}
        for site in sites:
            body = next(site.around("body"), None)
            if body is not None:
                by_body.setdefault(id(body), (body, []))[1].append(site)
        named = [(body.get("name") or "unnamed", body) for body, _ in by_body.values()]
        body = choose(named, laser, [*self.bodies, *self.sites], file)
        if body is None:
            return []
        is_own = not any(_own(body, "joint", "freejoint")) and any(body.around("body"))
        return [body] if is_own else by_body[id(body)][1]

    def _site(self, name: str) -> Node | None:
        """Return a site; `<replicate>` adds a number to the names of its sites."""
        if name in self.sites:
            return self.sites[name]
        stem = name.rstrip("0123456789").rstrip("_-")
        return self.sites.get(name.rstrip("0123456789")) or self.sites.get(stem)

    def shift(self, a: Amendment) -> None:
        """Move the laser."""
        self._check_laser()
        for frame in self.frames:
            parent = self._parent_rotation(frame)
            self._check_own(frame, ("pos",))
            if "pos" in frame.attributes:
                shift(self.document, numbers_of(frame, "pos", 3), a, parent)
            else:
                moved = " ".join(number_text(change) for change, _ in shift_of(a, parent))
                frame.origin.add_attribute("pos", moved, note(None, why(a, "dx")))

    def turn(self, a: Amendment) -> None:
        """Turn the laser."""
        self._check_laser()
        for frame in self.frames:
            self._check_own(frame, ORIENTATIONS)
            turn_frame(self.document, frame, a, self._parent_rotation(frame), self.angle, self.order)

    def radius(self, a: Amendment) -> None:
        """Write the true radius of both wheels."""
        factor = 1 / (1 + a["s"])
        self._resize([(wheel, factor) for _, wheel in self._wheels()], why(a, "s"))

    def radius_difference(self, a: Amendment) -> None:
        """Write different radii of the two wheels."""
        self._resize(
            [(wheel, 1 + (0.5 if is_left else -0.5) * a["s"]) for is_left, wheel in self._wheels()],
            why(a, "s"),
        )

    def base(self, a: Amendment) -> None:
        """Write the true distance of the wheels."""
        for _, wheel in self._wheels():
            value = numbers_of(wheel, "pos", 3)[1]
            old = known(value)
            put(self.document, value, old / (1 + a["s"]), why(a, "s", per=old))

    def lag(self, a: Amendment) -> None:
        """Increase the time constant of the actuators."""
        done: set[tuple[int, int]] = set()

        def slower(value: Value) -> None:
            if value.span not in done:  # a default class may set several actuators
                done.add(value.span)
                put(self.document, value, max(known(value) + a["tau"], 0.0), why(a, "tau"))

        for actuator in self._actuators():
            constant = default_of(self.document, actuator, "timeconst")
            if constant is not None:
                slower(constant)
                continue
            kind = str(default_of(self.document, actuator, "dyntype") or "none")
            if actuator.tag == "position" and a["tau"] > 0:
                actuator.origin.add_attribute("timeconst", number_text(a["tau"]), note(None, why(a, "tau")))
            elif actuator.tag != "general" or kind not in ("none", "filter", "filterexact"):
                raise CannotHoldError(
                    f"an actuator `{actuator.tag}`{f' with dyntype {kind}' if kind != 'none' else ''} has no time constant; "
                    "`general` with dyntype filterexact has one"
                )
            elif kind == "none":
                if a["tau"] > 0:
                    text = f'filterexact" dynprm="{number_text(a["tau"])}'
                    actuator.origin.add_attribute("dyntype", text, note(None, why(a, "tau")))
            else:
                prm = default_of(self.document, actuator, "dynprm")
                if prm is None or not prm.tokens():
                    raise CannotHoldError(f"an actuator with dyntype {kind} has no dynprm")
                slower(prm.tokens()[0])

    def delay(self, a: Amendment) -> None:
        """Delay the actuators, with a history of as many time steps."""
        self._delay(self._actuators(), a, "L")

    def latency(self, a: Amendment) -> None:
        """Delay the rangefinders."""
        if not self.rangefinders:
            raise CannotHoldError("it has no rangefinder")
        self._delay(self.rangefinders, a, "tau")

    def _delay(self, nodes: list[Node], a: Amendment, parameter: str) -> None:
        step = float(self._option("option", "timestep") or DEFAULT_STEP)
        done: set[tuple[int, int]] = set()
        for node in nodes:
            value = default_of(self.document, node, "delay")
            if value is not None and value.span in done:
                continue
            total = (0.0 if value is None else known(value)) + a[parameter]
            steps = math.ceil(total / step) + 1
            if not total >= 0 or steps > MAX_DELAY_STEPS:
                raise CannotHoldError(f"the delay would be {total:.3g} s; expected 0 or more")
            if value is not None:
                done.add(value.span)
                put(self.document, value, total, why(a, parameter))
                history = default_of(self.document, node, "nsample")
                if history is not None and (number(history) or 0) < steps:
                    put(self.document, history, steps, Why(cause=f"history of {number_text(total)} s"))
            else:
                text = f'{number_text(total)}" nsample="{steps}'
                node.origin.add_attribute("delay", text, f"{note(None, why(a, parameter))}; {DELAY_SINCE}")

    def cutoff(self, value: float, reason: Why) -> None:
        """Write the longest range of the rangefinders."""
        if not self.rangefinders:
            raise CannotHoldError("it has no rangefinder")
        for one in self.rangefinders:
            if "cutoff" in one.attributes:
                put(self.document, one.attributes["cutoff"], value, reason)
            else:
                one.origin.add_attribute("cutoff", number_text(value), note(None, reason))

    def _resize(self, wheels: list[tuple[Node, float]], reason: Why) -> None:
        """Change the radii of wheels, and lower or raise their axles so that they touch the same floor."""
        done: dict[tuple[int, int], tuple[float, float]] = {}
        for wheel, factor in wheels:
            change = 0.0
            for value in self._radii(wheel):
                if value.span not in done:  # a default class may set the radius of several wheels
                    old = known(value)
                    put(self.document, value, old * factor, reason.scaled(old))
                    done[value.span] = factor, old * (factor - 1)
                if done[value.span][0] != factor:
                    raise CannotHoldError("both wheels have the radius of one default class")
                change = done[value.span][1]
            if not change:
                raise CannotHoldError(f"the wheel `{wheel.get('name')}` has no round geom")
            height = numbers_of(wheel, "pos", 3)[2]
            put(self.document, height, known(height) + change, Why(cause=reason.cause))

    def _radii(self, wheel: Node) -> list[Value]:
        """Return the radii of the round geoms of a wheel."""
        found = []
        for geom in _own(wheel, "geom"):
            size, kind = default_of(self.document, geom, "size"), default_of(self.document, geom, "type")
            name = "sphere" if kind is None else str(kind)
            values = [] if size is None else size.tokens()
            found += [values[k] for k in ROUND.get(name, ()) if k < len(values)]
        return found

    def _wheels(self) -> list[tuple[bool, Node]]:
        """Return (is left, body) of the wheels: the bodies of driven hinges."""
        driven = [self._body_of(one) for one in self._actuators()]
        wheels = [body for body in driven if body is not None and "pos" in body.attributes]
        sided = [(number(numbers_of(body, "pos", 3)[1]) or 0.0, body) for body in wheels]
        if len([1 for y, _ in sided if y > 0]) == 0 or len([1 for y, _ in sided if y < 0]) == 0:
            raise CannotHoldError("no actuators drive a left and a right wheel")
        return [(y > 0, body) for y, body in sided if y]

    def _actuators(self) -> list[Node]:
        nodes = [
            one
            for group in self.document.all("actuator")
            for one in group.children
            if "joint" in one.attributes
        ]
        if not nodes:
            raise CannotHoldError("it has no actuator of a joint")
        robots = {id(robot): robot for one in nodes if (robot := _robot(self._body_of(one))) is not None}
        own = _robot(self.frames[0]) if self.frames else None
        if len(robots) > 1 and (own is None or id(own) not in robots):
            names = ", ".join(f"`{one.get('name')}`" for one in robots.values())
            raise CannotHoldError(
                f"it has {len(robots)} robots, {names}; choose the laser's body or site of one with `laser`"
            )
        return [one for one in nodes if len(robots) < 2 or _robot(self._body_of(one)) is own]

    def _body_of(self, actuator: Node) -> Node | None:
        """Return the body that an actuator's joint moves."""
        joints = self.document.all("joint", "freejoint")
        moved = (one for one in joints if one.get("name") == actuator.get("joint"))
        return next((body for one in moved for body in one.around("body")), None)

    def _check_own(self, frame: Node, names: tuple[str, ...]) -> None:
        """Check that no default class places a site: its number would be that of other sites, too."""
        if any(name in frame.attributes for name in names):
            return
        for name in names:
            if default_of(self.document, frame, name) is not None:
                raise CannotHoldError(f"a default class sets `{name}` of the site `{frame.get('name')}`")

    def _option(self, tag: str, name: str) -> str:
        return next((node.get(name) for node in self.document.all(tag) if name in node.attributes), "")

    def _check_laser(self) -> None:
        if not self.frames:
            raise CannotHoldError(
                "it has no rangefinder, whose site is the laser; give its body or site as `laser`"
            )

    def _parent_rotation(self, frame: Node) -> Floats:
        """Return the rotation (3, 3) of the parent of a frame in the moving base."""
        matrix = np.eye(3)
        for above in frame.around():
            if above.tag not in ("body", "frame", "replicate") or any(_own(above, "freejoint", "joint")):
                break
            if above.tag != "replicate":
                matrix = own_rotation(above, self.angle, self.order) @ matrix
        return matrix


def _own(body: Node, *tags: str) -> Iterator[Node]:
    """Yield the direct children of a body with one of these tags."""
    return (child for child in body.children if child.tag in tags)


def _robot(node: Node | None) -> Node | None:
    """Return the outermost body around a node, or the node itself."""
    return None if node is None else [node, *node.around("body")][-1]
