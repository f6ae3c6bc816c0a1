"""Orientations of MJCF: quaternions, angles, axes; attributes of elements."""

from __future__ import annotations

import math

import numpy as np

from sensorgraph.amending.findings import CannotHoldError, why
from sensorgraph.amending.numbers import put
from sensorgraph.amending.place import about_z, known, rotation, triple, turned
from sensorgraph.amending.text import Why, note, number_text
from sensorgraph.amending.xacro import Document, Node, Value
from sensorgraph.effects import Amendment
from sensorgraph.types import Floats


def turn_frame(
    document: Document, frame: Node, a: Amendment, parent: Floats, unit: float, order: str
) -> None:
    """Turn a body or a site by `mount_yaw`.

    Parameters
    ----------
    parent : (3, 3) Rotation of its parent in base_link.
    unit : [rad] Unit of angles in the file.
    order : Order of Euler angles.

    Raises
    ------
    CannotHoldError : Its orientation is written in a way that is not supported.
    """
    reason, delta = why(a, "delta"), a["delta"]
    if "zaxis" in frame.attributes or "xyaxes" in frame.attributes:
        name = "zaxis" if "zaxis" in frame.attributes else "xyaxes"
        values = numbers_of(frame, name, 3 if name == "zaxis" else 6)
        around = parent.T @ about_z(delta) @ parent
        for k in range(0, len(values), 3):
            old = np.array([known(value) for value in values[k : k + 3]])
            for value, new in zip(values[k : k + 3], around @ old, strict=True):
                put(document, value, float(new), Why(cause=reason.cause))
        return
    matrix = turned(own_rotation(frame, unit), delta, parent)
    name = next((one for one in ("quat", "axisangle", "euler") if one in frame.attributes), "")
    if not name:
        text = number_text(delta / unit)
        if not np.allclose(parent, about_z(math.atan2(parent[1, 0], parent[0, 0])), atol=1e-9):
            raise CannotHoldError("the body of the laser is tilted and has no orientation to change")
        angles = ["0", "0", "0"]
        angles[order.lower().index("z")] = text
        add_attribute(frame, "euler", " ".join(angles), note(None, reason))
    elif name == "quat":
        for value, new in zip(numbers_of(frame, "quat", 4), _quaternion(matrix), strict=True):
            put(document, value, new, Why(cause=reason.cause))
    elif name == "euler":
        if order.lower() != "xyz":
            raise CannotHoldError("its angles are in another order than xyz")
        values = numbers_of(frame, "euler", 3)
        for value, new in zip(values, _euler(frame, matrix, delta, unit), strict=True):
            put(document, value, new / unit, why(a, "delta", per=1 / unit))
    else:
        values = numbers_of(frame, "axisangle", 4)
        axis = np.array([known(value) for value in values[:3]])
        if not np.allclose(np.abs(axis), [0, 0, 1]) or not np.allclose(parent, np.eye(3)):
            raise CannotHoldError("the laser turns about an axis other than z")
        new = known(values[3]) + float(axis[2]) * delta / unit
        put(document, values[3], new, why(a, "delta", per=1 / unit))


def _euler(frame: Node, matrix: Floats, delta: float, unit: float) -> list[float]:
    """Return intrinsic angles x, y, z [rad] of a matrix (3, 3)."""
    if np.allclose(matrix[2, :2], 0.0) and np.allclose(matrix[:2, 2], 0.0) and matrix[2, 2] > 0:
        old = known(numbers_of(frame, "euler", 3)[2]) * unit
        return [0.0, 0.0, old + delta]
    return [
        math.atan2(-matrix[1, 2], matrix[2, 2]),
        math.asin(max(-1.0, min(1.0, float(matrix[0, 2])))),
        math.atan2(-matrix[0, 1], matrix[0, 0]),
    ]


def own_rotation(frame: Node, unit: float) -> Floats:
    """Return the rotation (3, 3) of a body or a site in its parent."""
    if "quat" in frame.attributes:
        w, x, y, z = (known(one) for one in numbers_of(frame, "quat", 4))
        n = math.sqrt(w * w + x * x + y * y + z * z) or 1.0
        w, x, y, z = w / n, x / n, y / n, z / n
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
    if "euler" in frame.attributes:
        x, y, z = (unit * value for value in triple(numbers_of(frame, "euler", 3)))
        return np.asarray(rotation([x, 0, 0]) @ rotation([0, y, 0]) @ about_z(z))
    if "axisangle" in frame.attributes:
        values = [known(one) for one in numbers_of(frame, "axisangle", 4)]
        if np.allclose(np.abs(values[:3]), [0, 0, 1]):
            return about_z(values[2] * values[3] * unit)
        raise CannotHoldError("a parent of the laser turns about an axis other than z")
    return np.eye(3)


def numbers_of(node: Node, name: str, n: int) -> list[Value]:
    """Return the first n numbers of an attribute.

    Raises
    ------
    CannotHoldError : It has fewer numbers.
    """
    values = node.attributes[name].tokens()
    if len(values) < n:
        raise CannotHoldError(f"`{name}` of `{node.get('name')}` has {len(values)} numbers; expected {n}")
    return values[:n]


def _quaternion(matrix: Floats) -> tuple[float, float, float, float]:
    """Return w, x, y, z of a rotation (3, 3)."""
    m = matrix
    four = [
        1 + m[0, 0] + m[1, 1] + m[2, 2], 1 + m[0, 0] - m[1, 1] - m[2, 2],
        1 - m[0, 0] + m[1, 1] - m[2, 2], 1 - m[0, 0] - m[1, 1] + m[2, 2],
    ]  # fmt: skip
    w, x, y, z = (math.sqrt(max(float(one), 0.0)) / 2 for one in four)
    return (
        w,
        math.copysign(x, m[2, 1] - m[1, 2]),
        math.copysign(y, m[0, 2] - m[2, 0]),
        math.copysign(z, m[1, 0] - m[0, 1]),
    )


def add_attribute(node: Node, name: str, text: str, phrase: str) -> None:
    """Add an attribute to an element."""
    element, file = node.origin, node.origin.file
    is_empty = file.data[element.head_end - 2 : element.head_end] == b"/>"
    at = element.head_end - (2 if is_empty else 1)
    file.insert(at, f' {name}="{text}"', phrase, element.head_end)
