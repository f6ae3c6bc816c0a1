"""Read and change a number where it is set: in place, in a property, or in the argument of a macro's call."""

from __future__ import annotations

import re

from sensorgraph.amending.expressions import PARTS, UnknownNameError, names_in
from sensorgraph.amending.text import Why, note, number_text
from sensorgraph.amending.xacro import Document, Value

ALONE = re.compile(r"\$\{\s*(-?)\s*([A-Za-z_]\w*)\s*\}|\$\(\s*(arg\s+\w+)\s*\)")
"""A value that is one name, possibly with a minus."""
PROPORTION = 1e-9
"""Relative deviation up to which an expression is proportional to a name."""
CHANGE = 1e-9
"""Change of a number below which it is not written."""


def number(value: Value) -> float | None:
    """Return a value as a number; None if it is not one, or uses names that no given file sets."""
    try:
        return float(value.evaluated())
    except (UnknownNameError, TypeError, ValueError):
        return None


def put(document: Document, value: Value, new: float, why: Why) -> None:
    """Write a number. A name is changed where it is set if this is its only use, else the use is changed."""
    old = number(value)
    if old is not None and abs(new - old) <= CHANGE * max(1.0, abs(old)):
        return
    alone = ALONE.fullmatch(value.text.strip())
    if alone:
        name = alone.group(2) or " ".join(alone.group(3).split())
        bound = value.scope.find(name)
        if bound is not None and _uses(document, name, bound) == 1:
            _put_at(document, bound, -new if alone.group(1) else new, why)
            return
    if PARTS.search(value.text) and old is not None:
        text = value.text.strip()
        inner = text[2:-1] if PARTS.fullmatch(text) and text.startswith("${") else None
        if inner is not None:
            step = number_text(abs(new - old))
            value.file.replace(
                value.span,
                f"${{{inner} {'+' if new > old else '-'} {step}}}",
                note(number_text(old), why),
                value.anchor,
            )
            return
    value.file.replace(value.span, number_text(new), note(_shown(value, old), why), value.anchor)


def scale(document: Document, value: Value, factor: float, why: Why) -> None:
    """Multiply a number; a property to which it is proportional is changed instead, for all its uses."""
    old = number(value)
    if old is None or old == 0:
        return
    part = PARTS.fullmatch(value.text.strip())
    names = names_in(part.group(1)) if part and part.group(1) else set()
    bound = [found for name in sorted(names) if (found := value.scope.find(name)) is not None]
    if len(bound) == 1:
        if why.cause in "; ".join(bound[0].file.notes.get(bound[0].anchor, [])):
            return  # another use of the same property has changed it
        base = number(bound[0])
        if base and _is_proportional(value, bound[0], base, old):
            put(document, bound[0], factor * base, why)
            return
    put(document, value, factor * old, why)


def _is_proportional(value: Value, bound: Value, base: float, old: float) -> bool:
    kept = bound.file.edits.get(bound.span)
    bound.file.edits[bound.span] = repr(2 * base)
    doubled = number(value)
    if kept is None:
        del bound.file.edits[bound.span]
    else:
        bound.file.edits[bound.span] = kept
    return doubled is not None and abs(doubled - 2 * old) <= PROPORTION * abs(old)


def _put_at(document: Document, bound: Value, new: float, why: Why) -> None:
    """Write the value of a name: at its definition, or as an argument of the one call that relies on the default."""
    if bound.call is not None and document.calls.get(bound.call.tag.removeprefix("xacro:"), 0) > 1:
        call = bound.call
        is_empty = call.file.data[call.head_end - 2 : call.head_end] == b"/>"
        at = call.head_end - (2 if is_empty else 1)
        text = f' {bound.name}="{number_text(new)}"'
        call.file.insert(at, text, note(_shown(bound, number(bound)), why), call.head_end)
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
