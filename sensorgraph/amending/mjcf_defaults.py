"""Default classes of MJCF: an attribute that an element inherits.

Source: MuJoCo documentation, XML reference, `default`.
"""

from __future__ import annotations

from sensorgraph.amending.xacro import Document, Node, Value

ACTUATORS = ("general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder", "muscle")
"""Actuators, which share their defaults."""


def default_of(document: Document, node: Node, name: str) -> Value | None:
    """Return an attribute of a geom, a site or an actuator, or that of its default class; None without one."""
    if name in node.attributes:
        return node.attributes[name]
    classes = [node.get("class"), *(one.get("childclass") for one in node.around())]
    wanted = next(filter(None, classes), "main")
    tags = ACTUATORS if node.tag in ACTUATORS else (node.tag,)
    groups = [one for one in document.all("default") if _class_of(one) == wanted]
    while groups:
        for inner in (one for group in groups for one in group.children if one.tag in tags):
            if name in inner.attributes:
                return inner.attributes[name]
        groups = [one.parent for one in groups if one.parent is not None and _is_inner(one)]
    return None


def _class_of(group: Node) -> str:
    """Return the name of a default class; the outermost one is `main` if it has none."""
    return group.get("class") or ("" if _is_inner(group) else "main")


def _is_inner(group: Node) -> bool:
    """Return whether a default class is inside another one, from which it inherits."""
    return group.parent is not None and group.parent.tag == "default"
