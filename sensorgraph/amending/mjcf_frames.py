"""Orientations of MJCF: quaternions, angles, axes; attributes of elements."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from planners.types import ROUND_OFF
from sensorgraph.amending.findings import CannotHoldError, why
from sensorgraph.amending.numbers import known, put
from sensorgraph.amending.place import angles_of, turned
from sensorgraph.amending.text import Why, note, number_text
from sensorgraph.amending.xacro import Document, Node, Value
from sensorgraph.effects import Amendment
from sensorgraph.types import Floats

ORIENTATIONS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")
"""Attributes of which one states an orientation."""


def turn_frame(
    document: Document, frame: Node, a: Amendment, parent: Floats, unit: float, order: str
) -> None:
    """Turn a body or a site by `mount_yaw`.

    Parameters
    ----------
    parent : (3, 3) Rotation of its parent in base_link.
    unit : [rad] Unit of angles in the file.
    order : Axes of Euler angles: small letters turn with the body, capital ones stay.

    Raises
    ------
    CannotHoldError : Its orientation uses unknown names, or mixes both kinds of Euler angles.
    """
    reason, delta = why(a, "delta"), a["delta"]
    matrix = turned(own_rotation(frame, unit, order), delta, parent)
    name = next((one for one in ORIENTATIONS if one in frame.attributes), "")
    if name in ("zaxis", "xyaxes"):
        values = numbers_of(frame, name, 3 if name == "zaxis" else 6)
        around = turned(np.eye(3), delta, parent)
        for k in range(0, len(values), 3):
            old = np.array([known(value) for value in values[k : k + 3]])
            for value, new in zip(values[k : k + 3], around @ old, strict=True):
                put(document, value, float(new), Why(cause=reason.cause))
    elif name == "quat":
        x, y, z, w = Rotation.from_matrix(matrix).as_quat(canonical=True)
        for value, new in zip(numbers_of(frame, "quat", 4), (w, x, y, z), strict=True):
            put(document, value, float(new), Why(cause=reason.cause))
    elif name == "axisangle":
        _put_axisangle(document, frame, a, matrix, unit)
    else:
        if order not in (order.lower(), order.upper()):
            raise CannotHoldError(f"its angles are in the mixed order {order}")
        angles = angles_of(matrix, order.swapcase())  # SciPy's capitals turn
        if not name:
            text = " ".join(number_text(one / unit) for one in angles)
            frame.origin.add_attribute("euler", text, note(None, reason))
            return
        for value, angle in zip(numbers_of(frame, "euler", 3), angles, strict=True):
            before = known(value) * unit
            change = math.remainder(angle - before, 2 * math.pi)
            put(document, value, (before + change) / unit, why(a, "delta", per=1 / unit))


def _put_axisangle(document: Document, frame: Node, a: Amendment, matrix: Floats, unit: float) -> None:
    """Write a rotation (3, 3) as axis and angle; only the angle if the axis stays."""
    values = numbers_of(frame, "axisangle", 4)
    *axis, before = (known(value) for value in values)
    vector = Rotation.from_matrix(matrix).as_rotvec()
    along = float(np.dot(vector, axis)) / (float(np.linalg.norm(axis)) or 1.0)
    if np.linalg.norm(np.cross(vector, axis)) > ROUND_OFF:
        along = float(np.linalg.norm(vector))
        for value, new in zip(values[:3], vector / along, strict=True):
            put(document, value, float(new), Why(cause=why(a, "delta").cause))
        before = along / unit
    change = math.remainder(along - before * unit, 2 * math.pi)
    put(document, values[3], before + change / unit, why(a, "delta", per=1 / unit))


def own_rotation(frame: Node, unit: float, order: str) -> Floats:
    """Return the rotation (3, 3) of a body, frame or site in its parent.

    Parameters
    ----------
    unit : [rad] Unit of angles in the file.
    order : Axes of Euler angles: small letters turn with the body, capital ones stay.
    """
    name = next((one for one in ORIENTATIONS if one in frame.attributes), "")
    sizes = {"quat": 4, "axisangle": 4, "euler": 3, "xyaxes": 6, "zaxis": 3}
    values = np.array([known(one) for one in numbers_of(frame, name, sizes[name])] if name else [])
    if name and not np.any(values[:3] if name != "euler" else 1.0) and name != "quat":
        raise CannotHoldError(f"`{name}` of `{frame.get('name')}` is zero")
    if name == "quat":
        return Rotation.from_quat(np.roll(values, -1)).as_matrix() if values.any() else np.eye(3)
    if name == "axisangle":
        return Rotation.from_rotvec(values[:3] / np.linalg.norm(values[:3]) * values[3] * unit).as_matrix()
    if name == "euler":
        matrix = np.eye(3)
        for letter, angle in zip(order, values * unit, strict=True):
            one = Rotation.from_euler(letter.lower(), angle).as_matrix()
            matrix = matrix @ one if letter.islower() else one @ matrix
        return matrix
    if name == "xyaxes":
        x = values[:3] / np.linalg.norm(values[:3])
        z = np.cross(x, values[3:])
        z = z / np.linalg.norm(z)
        return np.column_stack([x, np.cross(z, x), z])
    if name == "zaxis":  # the shortest turn from z to the axis
        z = values / np.linalg.norm(values)
        axis = np.array([-z[1], z[0], 0.0])
        length = float(np.linalg.norm(axis))
        axis = axis / length if length > ROUND_OFF else np.array([1.0, 0.0, 0.0])
        return Rotation.from_rotvec(axis * math.atan2(length, z[2])).as_matrix()
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
