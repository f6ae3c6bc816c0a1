"""Read and change a number where it is set: in place, in a property, or in the argument of a macro's call."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from planners.types import ROUND_OFF
from sensorgraph.amending.expressions import PARTS, UnknownNameError, is_sum, names_in
from sensorgraph.amending.findings import CannotHoldError
from sensorgraph.amending.text import Why, is_same, note, number_text
from sensorgraph.amending.xacro import Document, Node, Value

ALONE = re.compile(r"\$\{\s*(-?)\s*([A-Za-z_]\w*)\s*\}|\$\(\s*(arg\s+\w+)\s*\)")
"""A value that is one name, possibly with a minus."""
RATIOS = (1.0, 0.5, 2.0)
"""Size over a property that states it: radius or diameter, distance of the wheels or half of it."""


def number(value: Value) -> float | None:
    """Return a value as a number; None if it is not one, or uses names that no given file sets."""
    try:
        return float(value.evaluated())
    except (UnknownNameError, TypeError, ValueError):
        return None


def known(value: Value) -> float:
    """Return a number of a file.

    Raises
    ------
    CannotHoldError : It uses names that no given file sets.
    """
    found = number(value)
    if found is None:
        raise CannotHoldError(f"`{value.text.strip()}` uses names that no given file sets")
    return found


def number_in(node: Node, *path: str) -> float | None:
    """Return the number in the node at a path of tags below one; None without a number that the files set."""
    leaf = node.child(*path)
    return None if leaf is None or leaf.text is None else number(leaf.text)


def put(document: Document, value: Value, new: float, why: Why) -> None:
    """Write a number. A name is changed where it is set if this is its only use, else the use is changed.

    Raises
    ------
    CannotHoldError : The text is expanded several times, and so sets the number of other elements, too.
    """
    old = number(value)
    if old is not None and is_same(old, new):
        return
    alone = ALONE.fullmatch(value.text.strip())
    if alone:
        name = alone.group(2) or " ".join(alone.group(3).split())
        bound = value.scope.find(name)
        if bound is not None and _uses(document, name, bound) == 1:
            _put_at(document, bound, -new if alone.group(1) else new, why)
            return
    if document.is_shared(value):
        raise CannotHoldError(
            f"`{value.text.strip()}` is in a macro with several calls; make it a parameter of the macro"
        )
    if PARTS.search(value.text) and old is not None:
        text = value.text.strip()
        inner = text[2:-1] if PARTS.fullmatch(text) and text.startswith("${") else None
        if inner is not None:
            step = number_text(abs(new - old))
            base = inner if is_sum(inner) else f"({inner})"
            value.file.replace(
                value.span,
                f"${{{base} {'+' if new > old else '-'} {step}}}",
                note(number_text(old), why),
                value.anchor,
            )
            return
    value.file.replace(value.span, number_text(new), note(_shown(value, old), why), value.anchor)


def scale(document: Document, values: Sequence[Value], factor: float, why: Why) -> None:
    """Multiply numbers, once for all expansions of a text.

    A property that states a number, its half or its double is changed instead, for all its uses.

    Parameters
    ----------
    why : Reason, with the standard error of the factor.

    Raises
    ------
    CannotHoldError : A text also sets a number that is not among the values.
    """
    uses = Counter((id(value.file), value.span) for value in values)
    done: set[tuple[int, tuple[int, int]]] = set()
    for value in values:
        old = number(value)
        if old is None or old == 0:
            continue
        if (
            value.element is not None
            and document.copies.get(value.element, 0) > uses[id(value.file), value.span]
        ):
            raise CannotHoldError(f"`{value.text.strip()}` is in a macro with calls for other parts, too")
        target = _property_of(value, old) or value
        if (id(target.file), target.span) in done:
            continue
        done.add((id(target.file), target.span))
        base = number(target)
        assert base is not None
        found = PARTS.fullmatch(target.text.strip())
        new = number_text(factor * base)
        if found and found.group(1):
            new = f"${{({found.group(1).strip()}) * {number_text(factor)}}}"
        target.file.replace(target.span, new, note(_shown(target, base), why.scaled(base)), target.anchor)


def _property_of(value: Value, old: float) -> Value | None:
    """Return the property or argument that states a number; None unless there is exactly one."""
    part = PARTS.fullmatch(value.text.strip())
    if part is None:
        return None
    names = names_in(part.group(1)) if part.group(1) else {" ".join(part.group(2).split())}
    found = []
    for name in sorted(names):
        bound = value.scope.find(name)
        base = None if bound is None else number(bound)
        if bound is None or not base or (bound.owner is not None and abs(base) == 1):
            continue  # a macro's parameter of 1 or -1 states the side
        is_ratio = any(abs(abs(old / base) - ratio) <= ROUND_OFF for ratio in RATIOS)
        if is_ratio and _is_proportional(value, bound, base, old):
            found.append(bound)
    return found[0] if len(found) == 1 else None


def _is_proportional(value: Value, bound: Value, base: float, old: float) -> bool:
    kept = bound.file.edits.get(bound.span)
    bound.file.edits[bound.span] = repr(2 * base)
    doubled = number(value)
    if kept is None:
        del bound.file.edits[bound.span]
    else:
        bound.file.edits[bound.span] = kept
    return doubled is not None and abs(doubled - 2 * old) <= ROUND_OFF * abs(old)


def _put_at(document: Document, bound: Value, new: float, why: Why) -> None:
    """Write the value of a name: at its definition, or as an argument of the one call that relies on the default."""
    if bound.call is not None and document.calls.get(bound.call.tag.removeprefix("xacro:"), 0) > 1:
        phrase = note(_shown(bound, number(bound)), why)
        bound.call.add_attribute(bound.name, number_text(new), phrase)
        return
    put(document, bound, new, why)


def _uses(document: Document, name: str, bound: Value) -> int:
    """Return how often a name is used: in its macro for a macro's parameter, else in all files."""
    pieces = (
        [(bound.owner.file.data, bound.owner.head_end, bound.owner.end)]
        if bound.owner is not None
        else [(file.data, 0, len(file.data)) for file in document.files]
    )
    word = re.compile(rf"\b{re.escape(name)}\b")
    return sum(
        len(word.findall(part.group(1) or part.group(2) or ""))
        for data, start, end in pieces
        for part in PARTS.finditer(
            re.sub(r"<!--.*?-->", "", data[start:end].decode("utf-8", "replace"), flags=re.S)
        )
    )


def _shown(value: Value, old: float | None) -> str:
    text = value.text.strip()
    return number_text(old) if old is not None and not PARTS.search(text) and len(text) > 12 else text
