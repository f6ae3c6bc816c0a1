"""The error of `sensorgraph`: every step raises it, independently of the package that detected the error."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Iterable, Sequence
from functools import wraps
from typing import ClassVar, ParamSpec, TypeVar

from logs.errors import LogError
from planners.errors import PlanError
from robotmodic_ident.errors import IdentError

P = ParamSpec("P")
R = TypeVar("R")


class SensorgraphError(ValueError):
    """An error whose message states in one line what was wrong, what was expected and what to do.

    `planners`, `logs` and `robotmodic_ident` can be used alone and have separate errors. The functions of
    `import sensorgraph` convert them into this error, with the original as `__cause__`.
    """

    max_text: ClassVar[int] = 1200
    """Maximum number of characters of a message; a longer one, from a hostile file, is cut in the middle."""

    def __str__(self) -> str:
        text, most = " ".join(super().__str__().split()), self.max_text
        return text if len(text) <= most else f"{text[: most - 300]} ... {text[-290:]}"


def as_sensorgraph_error(function: Callable[P, R]) -> Callable[P, R]:
    """Convert the errors of the other packages in a public function, and unknown options, into `SensorgraphError`.

    A function with `**options` needs `takes_options` too, which knows their names.
    """
    parameters = inspect.signature(function).parameters.values()
    known = (
        None if any(one.kind is one.VAR_KEYWORD for one in parameters) else [one.name for one in parameters]
    )

    @wraps(function)
    def raising(*args: P.args, **kwargs: P.kwargs) -> R:
        if known is not None:
            refuse_unknown_options(kwargs, known)
        try:
            return function(*args, **kwargs)
        except (PlanError, LogError, IdentError) as exc:
            raise SensorgraphError(str(exc)) from exc

    return raising


def takes_options(names: Callable[[], Iterable[str]]) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Refuse all `**options` of a function that are not among `names()`, before any work is done."""

    def decorated(function: Callable[P, R]) -> Callable[P, R]:
        own = [one for one in inspect.signature(function).parameters if one != "options"]

        @wraps(function)
        def checked(*args: P.args, **kwargs: P.kwargs) -> R:
            refuse_unknown_options(kwargs, [*own, *names()])
            return function(*args, **kwargs)

        return checked

    return decorated


def refuse_unknown_options(given: Iterable[str], known: Sequence[str]) -> None:
    """Refuse an option that is not known, and suggest the most similar one.

    Raises
    ------
    SensorgraphError : An option is unknown.
    """
    for name in given:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1, cutoff=0.0)
            raise SensorgraphError(
                f"unknown option `{name}`; " + (f"did you mean `{near[0]}`?" if near else "none is expected")
            )
