"""Found effects and measured quantities as changes of numbers, and what a format cannot hold."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from sensorgraph.amending.text import TextFile, Why
from sensorgraph.effects import Amendment, Effect

MODEL_LAYER = "`sensorgraph record --effects` simulates it, and `diagnose --effects` accounts for it"
SCRIPT_LAYER = (
    "the drive.py of `sensorgraph export --effects` adds it to the readings (`sensorgraph.exporting.twin`)"
)
MAP_LAYER = "`sensorgraph export ARENA --effects` builds it into a world"


@dataclass(frozen=True, kw_only=True)
class MeasuredLaser:
    """Settings of a laser as its log states or shows them."""

    n_rays: int
    angle_min: float
    """[rad]"""
    angle_max: float
    """[rad]"""
    range_min: float
    """[m]"""
    range_max: float
    """[m]"""
    rate: float
    """[Hz]"""
    rate_sigma: float
    """[Hz]"""
    mean_square_range: float
    """[m²] Mean of the squared returns."""
    name: str
    """Name of the run."""


class CannotHoldError(Exception):
    """A format cannot hold an effect; the message is the reason."""


def why(a: Amendment, parameter: str, *, per: float = 1.0) -> Why:
    """Return the reason of a change by a parameter of an effect.

    Parameters
    ----------
    per : Derivative of the changed number by the parameter, which converts the standard error.
    """
    sigma = a.stderr.get(parameter)
    known = sigma is not None and math.isfinite(sigma)
    return Why(
        cause=f"{a.name} {parameter} = {a[parameter]:.4g}",
        sigma=abs(per) * sigma if known and sigma is not None else None,
    )


def layer_of(a: Amendment) -> str:
    """Return the Python layer that can apply an effect."""
    if a.effect.channel != "scan":
        return MODEL_LAYER
    if a.stage == "geometry":
        return MAP_LAYER
    return SCRIPT_LAYER


def left_out(a: Amendment, reason: str, file: str) -> str:
    """Return the line on an effect that a file cannot hold."""
    return f"{file}: {a.effect.title} ({a.name}): {reason}; {layer_of(a)}"


def no_place(a: Amendment, what: str) -> str:
    """Return the general reason why a format has no place for an effect."""
    if a.effect.channel == "scan" and a.stage == "geometry":
        return f"it belongs to the map, and {what} describes the robot"
    return f"{what} has no number for it"


def apply(
    amendments: tuple[Amendment, ...],
    handlers: Mapping[Effect, Callable[[Amendment], None]],
    what: str,
    file: str,
    files: Sequence[TextFile],
) -> list[str]:
    """Apply each effect with the handler of a format; return a line for each effect that the format cannot hold.

    An effect is applied as a whole or not at all.
    """
    lines = []
    for a in amendments:
        kept = [one.state() for one in files]
        try:
            if a.effect not in handlers:
                raise CannotHoldError(no_place(a, what))
            handlers[a.effect](a)
        except CannotHoldError as exc:
            lines.append(left_out(a, str(exc), file))
            for one, state in zip(files, kept, strict=True):
                one.restore(state)
    return lines
