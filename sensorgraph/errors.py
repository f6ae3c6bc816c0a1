"""The error that users of `sensorgraph` catch: every step raises it, whichever package found the fault."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from logs.errors import LogError
from planners.errors import PlanError
from robotmodic_ident.errors import IdentError

MAX_TEXT = 1200
"""Characters of a message; what a hostile file puts into it is cut in the middle."""
P = ParamSpec("P")
R = TypeVar("R")


class SensorgraphError(ValueError):
    """Say what came, what was expected and what to do, in one line.

    `planners`, `logs` and `robotmodic_ident` can be used alone and have errors of their own; behind
    `import sensorgraph` they arrive as this one, with the original as `__cause__`.
    """

    def __str__(self) -> str:
        text = " ".join(super().__str__().split())
        return text if len(text) <= MAX_TEXT else f"{text[: MAX_TEXT - 300]} ... {text[-290:]}"


def as_sensorgraph_error(function: Callable[P, R]) -> Callable[P, R]:
    """Let a public function raise `SensorgraphError` where one of the other packages finds the fault."""

    @wraps(function)
    def raising(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except (PlanError, LogError, IdentError) as exc:
            raise SensorgraphError(str(exc)) from exc

    return raising
