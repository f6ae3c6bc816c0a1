"""The tuned numbers of packages, found in their source and changed in a process that ends: constants and settings."""

from __future__ import annotations

import ast
import importlib
import pkgutil
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

from numba.core.caching import NullCache
from numba.core.dispatcher import Dispatcher
from numba.core.typing.templates import _OverloadFunctionTemplate

PRODUCT = ("sensorgraph", "planners", "logs", "robotmodic_ident")
SHARE = re.compile(
    "share|quantile|probability|chance|correlation|confidence|matching|cosine|dropout|absorber|discount|level|sure|start|predicted"
)
"""Names of numbers that are below 1 by their nature."""
UNTUNED = {
    "CHI2_MEDIAN_1", "CHI2_MEDIAN_3", "GOLDEN_RATIO", "SIGMA_OF_MAD", "ROUND_OFF", "SQRT_HALF", "DENSITY_AT_0",
    "NO_RETURN", "BROKEN", "NO_LINE",
}  # fmt: skip
"""Constants that nobody has tuned: of mathematics, and codes in arrays of integers."""


@dataclass(frozen=True, kw_only=True)
class Number:
    """A constant of a module, or a part of one: a field of settings, an entry of a dict."""

    module: ModuleType
    name: str
    path: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """What a table calls it."""
        return ".".join((self.module.__name__.removeprefix("sensorgraph."), self.name, *self.path))

    @property
    def value(self) -> Any:
        """As it stands."""
        value = getattr(self.module, self.name)
        for key in self.path:
            value = part(value, key)
        return value


def numbers_of(*packages: str) -> Iterator[Number]:
    """Yield the numbers of the modules of packages."""
    for module in modules_of(*packages):
        names = assigned(module)
        for name in [name for name in names if name not in UNTUNED]:
            value = getattr(module, name)
            if is_literal(names[name]) or is_settings(value) or is_settings_dict(value):
                yield from parts_of(Number(module=module, name=name))


def parts_of(number: Number) -> Iterator[Number]:
    """Yield a number, or those of settings or of a dict of them."""
    value = number.value
    keys: Iterable[str] = ()
    if is_settings(value):
        keys = value._fields if hasattr(value, "_fields") else [one.name for one in fields(value)]
    elif is_settings_dict(value):
        keys = value
    elif scaled(number.name, value, 2.0) is not None:
        yield number
    for key in keys:
        yield from parts_of(Number(module=number.module, name=number.name, path=(*number.path, key)))


def modules_of(*packages: str) -> list[ModuleType]:
    """Return modules and those of packages, imported."""
    found = []
    for package in packages:
        found.append(importlib.import_module(package))
        paths = getattr(found[-1], "__path__", ())
        found += [importlib.import_module(one.name) for one in pkgutil.walk_packages(paths, package + ".")]
    return found


@cache
def assigned(module: ModuleType) -> dict[str, ast.expr]:
    """Return what a module assigns to names in upper case, in their order."""
    found: dict[str, ast.expr] = {}
    for line in ast.parse(Path(str(module.__file__)).read_text()).body:
        if isinstance(line, (ast.Assign, ast.AnnAssign)) and line.value is not None:
            target = line.targets[0] if isinstance(line, ast.Assign) else line.target
            pairs = [(target, line.value)]
            if isinstance(target, ast.Tuple) and isinstance(line.value, ast.Tuple):
                pairs = list(zip(target.elts, line.value.elts, strict=True))
            found |= {t.id: v for t, v in pairs if isinstance(t, ast.Name) and t.id.isupper()}
    return found


def is_literal(value: ast.expr) -> bool:
    """Return whether an expression is written as a number, or as several."""
    if isinstance(value, (ast.Tuple, ast.Dict)):
        parts = value.elts if isinstance(value, ast.Tuple) else value.values
        return bool(parts) and all(map(is_literal, parts))
    if isinstance(value, ast.BinOp):
        return is_literal(value.left) and is_literal(value.right)
    if isinstance(value, ast.Call):  # such as math.radians(20.0)
        return ast.unparse(value.func).endswith("radians") and all(map(is_literal, value.args))
    if isinstance(value, ast.UnaryOp):
        return is_literal(value.operand)
    return isinstance(value, ast.Constant) and type(value.value) in (int, float)


def is_settings(value: Any) -> bool:
    """Return whether a value holds numbers by name."""
    return not isinstance(value, type) and (is_dataclass(value) or hasattr(value, "_fields"))


def is_settings_dict(value: Any) -> bool:
    """Return whether a value is a dict of such values."""
    return isinstance(value, dict) and all(map(is_settings, value.values())) and bool(value)


def part(value: Any, key: str) -> Any:
    """Return an entry of a dict or a field."""
    return value[key] if isinstance(value, Mapping) else getattr(value, key)


def scaled(name: str, value: Any, factor: float) -> Any:
    """Return a number, or each number of a tuple or mapping, times a factor; None for what is no number."""
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return None
    if isinstance(value, int):
        return max(1, round(value * factor)) if value > 0 else None
    if isinstance(value, float):
        if SHARE.search(name.lower()) and value < 1.0 <= value * factor:
            return (1.0 + value) / 2
        return value * factor
    if isinstance(value, tuple):
        parts = [scaled(name, part, factor) for part in value]
        return None if any(part is None for part in parts) else tuple(parts)
    if isinstance(value, Mapping):
        return {key: scaled(name, part, factor) for key, part in value.items()}
    return None


def vary(numbers: Iterable[Number], factor: float) -> None:
    """Scale numbers in this process, with all that was computed from them on import and compiled with them."""
    changed: set[tuple[str, str]] = set()
    for number in numbers:
        old = getattr(number.module, number.name)
        new = with_part(old, number.path, scaled((number.name, *number.path)[-1], number.value, factor))
        _set(number.module, number.name, new, changed)
    recompile(changed)


def with_part(value: Any, path: tuple[str, ...], new: Any) -> Any:
    """Return a value with another part; a dataclass itself changes, for all that hold it."""
    if not path:
        return new
    inner = with_part(part(value, path[0]), path[1:], new)
    if is_dataclass(value):
        object.__setattr__(value, path[0], inner)
        return value
    return {**value, path[0]: inner} if isinstance(value, dict) else value._replace(**{path[0]: inner})


def _set(module: ModuleType, name: str, new: Any, changed: set[tuple[str, str]]) -> None:
    """Set a name wherever it was imported, and compute what modules made of it."""
    old = getattr(module, name)
    for one in loaded():
        if one is not module and (name in assigned(one) or one.__dict__.get(name) is not old):
            continue
        setattr(one, name, new)
        changed.add((one.__name__, name))
        for derived, expression in assigned(one).items():
            if any(isinstance(n, ast.Name) and n.id == name for n in ast.walk(expression)):
                value = eval(compile(ast.Expression(expression), one.__name__, "eval"), one.__dict__)
                if repr(value) != repr(getattr(one, derived)):
                    _set(one, derived, value, changed)


def loaded() -> list[ModuleType]:
    """Return the modules of the product that are imported."""
    return [m for n, m in list(sys.modules.items()) if n.split(".")[0] in PRODUCT and hasattr(m, "__file__")]


def recompile(changed: set[tuple[str, str]]) -> None:
    """Compile kernels anew that hold changed constants, the called ones first."""
    for template in _OverloadFunctionTemplate.__subclasses__():
        function: Any = template.key
        if isinstance(function, FunctionType) and constants_in(function) & changed:
            template._impl_cache.clear()
            template._compiled_overloads.clear()
            template._jit_options["cache"] = False
    for module in loaded():
        assigned(module)
    kernels: Any = {id(v): v for m in loaded() for v in vars(m).values() if isinstance(v, Dispatcher)}
    for kernel in sorted(kernels.values(), key=lambda one: len(constants_in(one.py_func))):
        if constants_in(kernel.py_func) & changed:
            kernel._cache = NullCache()
            kernel.recompile()


@cache
def constants_in(function: FunctionType) -> frozenset[tuple[str, str]]:
    """Return the global names (module, name) that a kernel and those that it calls refer to."""
    found: set[tuple[str, str]] = set()
    waiting: list[tuple[CodeType, FunctionType]] = [(function.__code__, function)]
    seen = {function}
    while waiting:
        code, within = waiting.pop()
        waiting += [(one, within) for one in code.co_consts if isinstance(one, CodeType)]
        for name in code.co_names:
            value = within.__globals__.get(name)
            called = value.py_func if isinstance(value, Dispatcher) else value
            if isinstance(called, FunctionType) and called.__module__.split(".")[0] in PRODUCT:
                waiting += [(called.__code__, called)] * (called not in seen)
                seen.add(called)
            found.add((within.__module__, name))
    return frozenset(found)
