"""Evaluate the expressions of xacro: arithmetic on numbers and names, without Python's own eval."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable
from typing import Any

PARTS = re.compile(r"\$\{([^{}]*)\}|\$\(([^()]*)\)")
"""An expression `${...}` or a substitution `$(...)`."""
BINARY: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Mod: operator.mod, ast.FloorDiv: operator.floordiv, ast.Eq: operator.eq, ast.NotEq: operator.ne,
    ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge,
}  # fmt: skip
UNARY: dict[type, Callable[[Any], Any]] = {
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Not: operator.not_,
}
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "radians": math.radians, "degrees": math.degrees, "sin": math.sin, "cos": math.cos, "tan": math.tan,
    "atan2": math.atan2, "sqrt": math.sqrt, "abs": abs, "min": min, "max": max, "float": float, "int": int,
}  # fmt: skip
CONSTANTS = {"pi": math.pi, "M_PI": math.pi, "True": True, "False": False, "true": True, "false": False}
MAX_LENGTH = 2000
"""Maximum number of characters of an expression."""


class UnknownNameError(LookupError):
    """An expression uses a name or a form that is not known."""


def evaluate(expression: str, name: Callable[[str], Any]) -> Any:
    """Return the value of an expression; `name` returns the value of a name.

    Raises
    ------
    UnknownNameError : A name, a function or the form of the expression is not known.
    """
    try:
        if len(expression) > MAX_LENGTH:
            raise UnknownNameError(expression[:20])
        return _value(ast.parse(expression.strip(), mode="eval").body, name)
    except (SyntaxError, TypeError, ValueError, ArithmeticError, RecursionError) as exc:
        raise UnknownNameError(expression) from exc


def names_in(expression: str) -> set[str]:
    """Return the names in an expression, without functions; empty if it is no expression."""
    try:
        tree = ast.parse(expression.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError):
        return set()
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} - FUNCTIONS.keys() - {"math"}


def is_sum(expression: str) -> bool:
    """Return whether a number may be added behind an expression without parentheses."""
    try:
        tree = ast.parse(expression.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError):
        return False
    return not isinstance(tree.body, ast.IfExp | ast.BoolOp | ast.Compare)


def _value(node: ast.expr, name: Callable[[str], Any]) -> Any:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float | str):
        return node.value
    if isinstance(node, ast.Name):
        try:
            return name(node.id)
        except UnknownNameError:
            if node.id in CONSTANTS:
                return CONSTANTS[node.id]
            raise
    if isinstance(node, ast.BinOp) and type(node.op) in BINARY:
        left, right = _value(node.left, name), _value(node.right, name)
        if (isinstance(left, str) or isinstance(right, str)) and not isinstance(node.op, ast.Add):
            raise UnknownNameError(ast.unparse(node))
        return BINARY[type(node.op)](left, right)
    if isinstance(node, ast.UnaryOp) and type(node.op) in UNARY:
        return UNARY[type(node.op)](_value(node.operand, name))
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in BINARY:
        return BINARY[type(node.ops[0])](_value(node.left, name), _value(node.comparators[0], name))
    if isinstance(node, ast.BoolOp):
        values = [_value(one, name) for one in node.values]
        return all(values) if isinstance(node.op, ast.And) else any(values)
    if isinstance(node, ast.IfExp):
        return _value(node.body if _value(node.test, name) else node.orelse, name)
    if isinstance(node, ast.Attribute) and ast.unparse(node) == "math.pi":
        return math.pi
    if isinstance(node, ast.Call) and ast.unparse(node.func).removeprefix("math.") in FUNCTIONS:
        function = FUNCTIONS[ast.unparse(node.func).removeprefix("math.")]
        return function(*(_value(one, name) for one in node.args))
    raise UnknownNameError(ast.unparse(node))
