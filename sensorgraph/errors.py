"""The error of `sensorgraph`: every step raises it, independently of the package that detected the error."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from logs.errors import LogError
from planners.errors import PlanError
from robotmodic_ident.errors import IdentError

MAX_TEXT = 1200
"""Maximum number of characters of a message; a longer one, from a hostile file, is cut in the middle."""
P = ParamSpec("P")
R = TypeVar("R")


class SensorgraphError(ValueError):
    """An error whose message states in one line what was wrong, what was expected and what to do.

    `planners`, `logs` and `robotmodic_ident` can be used alone and have separate errors. The functions of
    `import sensorgraph` convert them into this error, with the original as `__cause__`.
    """

    def __str__(self) -> str:
        text = " ".join(super().__str__().split())
        return text if len(text) <= MAX_TEXT else f"{text[: MAX_TEXT - 300]} ... {text[-290:]}"


def as_sensorgraph_error(function: Callable[P, R]) -> Callable[P, R]:
    """Convert the errors of the other packages in a public function into `SensorgraphError`."""

    @wraps(function)
    def raising(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except (PlanError, LogError, IdentError) as exc:
            raise SensorgraphError(str(exc)) from exc

    return raising
