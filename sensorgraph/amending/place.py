"""Move and turn a frame that is written as xyz and roll, pitch, yaw in the frame of its parent."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from planners.types import ROUND_OFF, SAME_PLACE
from sensorgraph.amending.findings import why
from sensorgraph.amending.numbers import known, number, put
from sensorgraph.amending.text import Why, note, number_text
from sensorgraph.amending.xacro import Document, Value
from sensorgraph.effects import Amendment
from sensorgraph.types import Floats


def rotation(rpy: Sequence[float]) -> Floats:
    """Return the matrix (3, 3) of fixed-axis roll, pitch and yaw [rad]."""
    return Rotation.from_euler("xyz", rpy).as_matrix()


def angles_of(matrix: Floats, axes: str = "xyz") -> list[float]:
    """Return the angles (3,) [rad] of a rotation (3, 3), about fixed axes (small letters) or turning ones (capitals)."""
    order: Any = axes
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Gimbal lock")  # the third angle is then zero
        angles = Rotation.from_matrix(matrix).as_euler(order)
    return [0.0 if abs(one) < ROUND_OFF else float(one) for one in angles]


def shift_of(a: Amendment, parent: Floats) -> list[tuple[float, Why]]:
    """Return the change (3,) [m] of a position by `mount_xy`, in the frame of the parent, with its reasons.

    Parameters
    ----------
    parent : (3, 3) Rotation of the parent in base_link.
    """
    out = []
    for row in parent.T:
        sigma = math.sqrt(
            sum(((why(a, key).sigma or 0.0) * row[k]) ** 2 for k, key in enumerate(("dx", "dy")))
        )
        cause = f"{a.name} dx = {a['dx']:.4g}, dy = {a['dy']:.4g}"
        change = float(row[0] * a["dx"] + row[1] * a["dy"])
        out.append((change, Why(cause=cause, sigma=sigma or None)))
    return out


class NewPose:
    """A pose that a file lacks, and that effects move and turn."""

    def __init__(self) -> None:
        self.xyz: list[float] | None = None
        self.rpy: list[float] | None = None
        self.phrases: list[str] = []

    def shift(self, a: Amendment, parent: Floats) -> None:
        """Move it by `mount_xy`; `parent` (3, 3) is the rotation of its parent in base_link."""
        moved = shift_of(a, parent)
        old = self.xyz or [0.0, 0.0, 0.0]
        self.xyz = [before + change for before, (change, _) in zip(old, moved, strict=True)]
        self.phrases.append(
            note(None, max((reason for _, reason in moved), key=lambda one: one.sigma or 0.0))
        )

    def turn(self, a: Amendment, parent: Floats) -> None:
        """Turn it by `mount_yaw`."""
        self.rpy = angles_of(turned(rotation(self.rpy or [0.0, 0.0, 0.0]), a["delta"], parent))
        self.phrases.append(note(None, why(a, "delta")))


def numbers_text(values: Sequence[float]) -> str:
    """Return numbers separated by spaces; those below `SAME_PLACE` are zero."""
    return " ".join(number_text(0.0 if abs(one) < SAME_PLACE else one) for one in values)


def shift(document: Document, xyz: Sequence[Value], a: Amendment, parent: Floats) -> None:
    """Add `mount_xy` to a position.

    Raises
    ------
    CannotHoldError : A coordinate uses names that no given file sets.
    """
    for value, (change, reason) in zip(xyz, shift_of(a, parent), strict=True):
        if abs(change) > SAME_PLACE:
            put(document, value, known(value) + change, reason)


def turn(document: Document, rpy: Sequence[Value], a: Amendment, parent: Floats, unit: float = 1.0) -> None:
    """Turn a frame by `mount_yaw` about the z axis of base_link.

    Parameters
    ----------
    unit : [rad] Unit of the angles in the file.

    Raises
    ------
    CannotHoldError : An angle uses names that no given file sets.
    """
    old = [known(value) * unit for value in rpy]
    new = angles_of(turned(rotation(old), a["delta"], parent))
    for value, before, after in zip(rpy, old, new, strict=True):
        change = math.remainder(after - before, 2 * math.pi)
        if abs(change) > SAME_PLACE:
            put(document, value, (before + change) / unit, why(a, "delta", per=1 / unit))


def turned(matrix: Floats, angle: float, parent: Floats) -> Floats:
    """Return a rotation (3, 3) in its parent after a turn [rad] about the z axis of base_link."""
    return np.asarray(parent.T @ rotation([0.0, 0.0, angle]) @ parent @ matrix)


def triple(values: Sequence[Value]) -> list[float]:
    """Return three numbers; zeros for those that are unknown."""
    found = [number(value) or 0.0 for value in values[:3]]
    return [*found, *[0.0] * (3 - len(found))]
