"""The one error of this package."""

from __future__ import annotations


class Redraw(RuntimeError):
    """A drawn case cannot be used: no room, a collision, a dull drive, no place for an effect. Draw it again."""
