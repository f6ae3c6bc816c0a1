"""Compare the arguments of a public function with its type hints, which Python does not check.

`sensorgraph.errors.as_sensorgraph_error` does this for every function that it decorates. Arguments with a numpy type are
converted and checked by `sensorgraph.sensor_model_input` instead.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin


@dataclass(frozen=True)
class AtLeast:
    """Smallest allowed value of a number, in `Annotated`."""

    least: int


Count = Annotated[int, AtLeast(0)]
"""A whole number from 0 on."""
AtLeastOne = Annotated[int, AtLeast(1)]
"""A whole number from 1 on."""
NotNegative = Annotated[float, AtLeast(0)]
"""A number from 0 on."""
MADE_BY = {
    "Amendment": 'sg.EFFECTS["NAME"](...)',
    "Arena": "sg.load_arena(...)",
    "CoveragePlan": "sg.plan(...)",
    "DesignTask": "sg.DesignTask(...)",
    "Observation": "sensorgraph.watching.observation.Observation(...)",
    "Robot": "sg.load_robot(...)",
    "Run": "sg.read(...)",
    "Sensorgraph": "sg.load(...)",
}
"""Class -> call that makes an object of it."""
MAX_SHOWN = 60
"""[characters] Maximum length of a value in a message."""


def fault_of(given: Mapping[str, object], hints: Mapping[str, Any]) -> str | None:
    """Return what is wrong with the first argument that its type hint excludes, in one line; None if all fit."""
    for name, value in given.items():
        if name in hints and not fits(value, hints[name]):
            return _fault(name, value, hints[name])
    return None


def fits(value: object, hint: Any) -> bool:
    """Return whether a type hint allows a value.

    Scalars of numpy count as numbers, whole numbers as `float`, 0 and 1 as `bool`, and any collection but a text or a
    mapping as `Sequence`. The elements of an iterator are not checked.
    """
    origin, of = get_origin(hint), get_args(hint)
    if hint is Any:
        return True
    if origin in (Union, UnionType):
        return any(fits(value, one) for one in of)
    if origin is Annotated:
        return fits(value, of[0]) and all(_plain(value) >= one.least for one in of[1:])
    if origin is Literal:
        return any(isinstance(value, type(one)) and value == one for one in of)
    if origin is Callable:
        return callable(value)
    kind: Any = origin or hint
    if not isinstance(kind, type) or getattr(kind, "_is_protocol", False):
        return True
    if kind is object or kind.__module__.startswith("numpy"):
        return True
    return _fits_class(value, kind, of)


def _fits_class(value: object, kind: type, of: Sequence[Any]) -> bool:
    """Return whether a class, with parameters such as those of `Sequence[str]`, allows a value."""
    if kind in (bool, int, float, str):
        return _fits_scalar(_plain(value), kind)
    if kind is Path:
        return isinstance(value, os.PathLike)
    if issubclass(kind, Mapping):
        return isinstance(value, Mapping) and all(
            fits(key, of[0]) and fits(value[key], of[1]) for key in value
        )
    if issubclass(kind, Iterable) and of:
        if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
            return False
        each = of if kind is tuple and ... not in of else None
        elements = _elements(value)
        if each is not None:
            return len(elements) == len(each) and all(map(fits, elements, each))
        return all(fits(one, of[0]) for one in elements)
    return isinstance(value, kind)


def _fits_scalar(value: object, kind: type) -> bool:
    if kind is bool:
        return isinstance(value, bool) or (isinstance(value, int) and value in (0, 1))
    if kind is float:
        return isinstance(value, Real) and not isinstance(value, bool)
    return isinstance(value, kind) and not (kind is int and isinstance(value, bool))


def _plain(value: Any) -> Any:
    """Return the Python number or text of a scalar of numpy, or of an array of shape ()."""
    return value.item() if getattr(value, "ndim", None) == 0 and hasattr(value, "item") else value


def _elements(value: object) -> Collection[object]:
    """Return the elements of a collection; none of an iterator, which could be read only once."""
    if isinstance(value, Sequence | Set):
        return value
    return list(value) if hasattr(value, "__array__") and isinstance(value, Iterable) else ()


def _fault(name: str, value: object, hint: Any) -> str:
    for one in _alternatives(hint):
        kind = get_origin(one)
        is_list = (
            isinstance(kind, type) and issubclass(kind, Iterable) and not issubclass(kind, Mapping | tuple)
        )
        if is_list and fits(value, kind[Any]):  # a list, but of other things
            elements = list(_elements(value))
            index = next(i for i, element in enumerate(elements) if not fits(element, get_args(one)[0]))
            return _fault(f"{name}[{index}]", elements[index], get_args(one)[0])
    return f"`{name}` is {_shown(value)}, expected {expected(hint)}"


def expected(hint: Any) -> str:
    """Return what a type hint allows, in words."""
    kinds = _alternatives(hint)
    words = [_words(one, among=kinds) for one in kinds if one is not NoneType]
    if Path in kinds and str in kinds:
        words.remove("a text")
    words = list(dict.fromkeys([*words, *(["None"] if NoneType in kinds else [])]))
    return " or ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def _alternatives(hint: Any) -> tuple[Any, ...]:
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _words(hint: Any, among: Sequence[Any] = ()) -> str:
    """Return one alternative in words; a list of what stands before it among the alternatives is one of these."""
    origin, of = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return f"{_words(of[0])} from {of[1].least} on"
    if origin is Literal:
        return " or ".join(map(repr, of))
    if origin is Callable:
        return "a function"
    kind: type = origin or hint
    simple = {bool: "True or False", int: "a whole number", float: "a number", str: "a text", Path: "a path"}
    if kind in simple:
        return simple[kind]
    if issubclass(kind, Mapping):
        return "a dict"
    if kind is tuple and ... not in of:
        return f"{len(of)} values (each {expected(of[0])})"
    if issubclass(kind, Iterable) and of:
        is_of_these = set(_alternatives(of[0])) <= set(among)
        return "a list of these" if is_of_these else f"a list (each {expected(of[0])})"
    name = kind.__name__
    return f"{_article(name)} {name}" + (f" (from `{MADE_BY[name]}`)" if name in MADE_BY else "")


def _shown(value: object) -> str:
    """Return a short text of a value, or its type where it has no short text."""
    plain = _plain(value)
    if plain is None or isinstance(plain, str | bytes | Real):
        text = repr(plain)
        return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}..."
    name = value.__name__ if isinstance(value, type) else type(value).__name__
    return f"the class {name}" if isinstance(value, type) else f"{_article(name)} {name}"


def _article(word: str) -> str:
    return "an" if word[0] in "AEIOaeio" or word == "ndarray" else "a"
