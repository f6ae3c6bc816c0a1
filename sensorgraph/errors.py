"""The one error that the sensorgraph package raises when what the user gave does not allow what was asked."""

from __future__ import annotations

import warnings


class SensorgraphError(ValueError):
    """Say what came, what was expected and what to do, in one line."""


def __getattr__(name: str) -> type[SensorgraphError]:
    if name == "GapError":  # its name before 0.1.0
        warnings.warn(
            "GapError is now SensorgraphError; the old name goes after 0.1", DeprecationWarning, stacklevel=2
        )
        return SensorgraphError
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
