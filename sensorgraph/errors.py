"""The error of `sensorgraph`: every step raises it, independently of the package that detected the error."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import cache, wraps
from typing import Any, ClassVar, ParamSpec, TypeVar, get_type_hints

from logs.errors import LogError
from planners.errors import PlanError
from robotmodic_ident.errors import IdentError
from sensorgraph.arguments import fault_of

P = ParamSpec("P")
R = TypeVar("R")
MOST_NAMES = 12
"""Number of names that a message lists."""


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


class SensorgraphFileError(OSError, SensorgraphError):
    """A file or folder cannot be read or written. It is an `OSError`, too, with `errno`, `strerror` and `filename`."""

    def __str__(self) -> str:
        return file_fault(self)


class MissingFileError(FileNotFoundError, SensorgraphFileError):
    """A file or folder does not exist. It is a `FileNotFoundError`, too."""


def file_fault(exc: OSError) -> str:
    """Return what is wrong with a file, and what to do, in one line."""
    if exc.filename is None:
        return f"{exc.strerror}; the output cannot be written"
    path = exc.filename2 or exc.filename
    return f"{path}: {exc.strerror}; give a path that exists and can be read or written"


def as_sensorgraph_error(function: Callable[P, R]) -> Callable[P, R]:
    """Convert errors of files and of the other packages in a public function into `SensorgraphError`.

    Unknown options and arguments that the type hints exclude are refused before any work is done. A function with
    `**options` needs `takes_options` too, which knows their names and types.
    """
    parameters = inspect.signature(function).parameters.values()
    known = (
        None if any(one.kind is one.VAR_KEYWORD for one in parameters) else [one.name for one in parameters]
    )
    names = [one.name for one in parameters if one.kind is one.POSITIONAL_OR_KEYWORD]
    hints = cache(lambda: get_type_hints(function, include_extras=True))

    @wraps(function)
    def raising(*args: P.args, **kwargs: P.kwargs) -> R:
        if known is not None:
            refuse_unknown(kwargs, known, "option")
        refuse_wrong_types({**dict(zip(names, args, strict=False)), **kwargs}, hints())
        try:
            return function(*args, **kwargs)
        except (PlanError, LogError, IdentError) as exc:
            raise SensorgraphError(str(exc)) from exc
        except OSError as exc:
            if isinstance(exc, SensorgraphError) or exc.errno is None:
                raise
            kind = MissingFileError if isinstance(exc, FileNotFoundError) else SensorgraphFileError
            raise kind(exc.errno, exc.strerror, exc.filename, None, exc.filename2) from exc

    return raising


def takes_options(types: Callable[[], Mapping[str, Any]]) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Refuse all `**options` of a function that are not among `types()` or have another type, before any work is done."""

    def decorated(function: Callable[P, R]) -> Callable[P, R]:
        own = [one for one in inspect.signature(function).parameters if one != "options"]

        @wraps(function)
        def checked(*args: P.args, **kwargs: P.kwargs) -> R:
            hints = types()
            refuse_unknown(kwargs, [*own, *hints], "option")
            refuse_wrong_types({name: kwargs[name] for name in kwargs if name not in own}, hints)
            return function(*args, **kwargs)

        return checked

    return decorated


def refuse_wrong_types(given: Mapping[str, object], hints: Mapping[str, Any]) -> None:
    """Refuse an argument that its type hint excludes.

    Raises
    ------
    SensorgraphError : An argument has another type, or a number is too small.
    """
    fault = fault_of(given, hints)
    if fault is not None:
        raise SensorgraphError(fault)


def refuse_unknown(
    given: Iterable[object], known: Collection[str], what: str, *, where: str = "", section: str = ""
) -> None:
    """Refuse a name that is not known, and suggest the most similar one.

    Parameters
    ----------
    what : What the names are, such as `option` or `key`.
    where : Begin of the message, such as the name of a file.
    section : What precedes the names, such as `limits.`.

    Raises
    ------
    SensorgraphError : A name is unknown.
    """
    for name in given:
        if name not in known:
            start, like = f"{where}: " if where else "", suggestion(str(name), known, section)
            raise SensorgraphError(f"{start}unknown {what} `{section}{name}`; {like}")


def suggestion(name: str, known: Collection[str], where: str = "") -> str:
    """Ask for the known name that is most similar or, if none is similar, list what is expected; `where` precedes names."""
    folded = {each.casefold(): each for each in known}
    near = difflib.get_close_matches(name.casefold(), folded, n=1)
    if near:
        return f"did you mean `{where}{folded[near[0]]}`?"
    names = [f"`{where}{each}`" for each in known]
    listed = ", ".join(names if len(names) <= MOST_NAMES else [*names[:MOST_NAMES], "..."])
    return f"expected {listed}" if names else "none is expected"
