"""The one error of this package."""

from __future__ import annotations


class Redraw(Exception):
    """A drawn case cannot be used: no room, a collision, a dull drive, a faint effect. Draw it again."""
