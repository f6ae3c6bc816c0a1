"""Expand xacro into nodes whose values know where they are set; plain XML is xacro without macros.

Values are evaluated lazily, in the scope where they are written. Expansion never changes a file.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any

from sensorgraph.amending.expressions import PARTS, UnknownNameError, evaluate
from sensorgraph.amending.text import TextFile
from sensorgraph.amending.xml_tree import Element
from sensorgraph.errors import SensorgraphError

PARAMETER = re.compile(r"(\*{0,2})([\w.\-]+)(?:\s*:?=\s*(\^\|?)?('[^']*'|\"[^\"]*\"|\$\{[^}]*\}|[^\s]*))?")
ARGUMENT = re.compile(r"\$\(\s*arg\s+(\w+)\s*\)")
"""A substitution inside an expression, as in `${'$(arg side)' == 'left'}`."""
OPTIONAL = re.compile(r"\s*\$\(\s*optenv\s+\w+\s+([^()]*)\)\s*")
MAX_CALLS = 2000
"""Maximum number of macro calls, which bounds recursive macros."""


@dataclass(eq=False)
class Scope:
    """Names that an expression may use."""

    parent: Scope | None = None
    values: dict[str, Value] = field(default_factory=dict)
    blocks: dict[str, tuple[list[Element], Scope]] = field(default_factory=dict)

    def find(self, name: str) -> Value | None:
        """Return the value bound to a name."""
        scope: Scope | None = self
        while scope is not None:
            if name in scope.values:
                return scope.values[name]
            scope = scope.parent
        return None

    def block(self, name: str) -> tuple[list[Element], Scope] | None:
        """Return the block bound to a name."""
        scope: Scope | None = self
        while scope is not None:
            if name in scope.blocks:
                return scope.blocks[name]
            scope = scope.parent
        return None

    @property
    def root(self) -> Scope:
        """Outermost scope, which also holds `$(arg NAME)` under `arg NAME`."""
        return self if self.parent is None else self.parent.root


@dataclass(eq=False)
class Value:
    """A piece of text in a file, with the scope of its names."""

    file: TextFile
    span: tuple[int, int]
    anchor: int
    """Offset of its comment."""
    scope: Scope
    owner: Element | None = None
    """For a macro's parameter: the macro, in which all its uses are."""
    call: Element | None = None
    """For a default of a macro's parameter: the call that does not state it."""
    name: str = ""
    element: Element | None = None
    """Element that holds the text."""

    @property
    def text(self) -> str:
        """Text as edited so far."""
        return self.file.text(self.span)

    def __str__(self) -> str:
        """Return the text with its expressions evaluated."""
        return str(self.evaluated())

    def evaluated(self, depth: int = 0) -> Any:
        """Return the value: a number if the whole text is one expression, else a text.

        Raises
        ------
        UnknownNameError : A name is not known.
        """
        text = self.text.strip()
        if depth > 30:
            raise UnknownNameError(text)
        whole = PARTS.fullmatch(text)
        if whole:
            return self._part(whole, depth)
        return PARTS.sub(lambda part: _plain(self._part(part, depth)), text)

    def _part(self, part: re.Match[str], depth: int) -> Any:
        if part.group(1) is not None:
            inner = ARGUMENT.sub(
                lambda found: _plain(self._bound(f"arg {found.group(1)}", depth)), part.group(1)
            )
            return evaluate(inner, lambda name: self._bound(name, depth))
        words = part.group(2).split(maxsplit=2)
        if len(words) == 2 and words[0] == "arg":
            return self._bound(f"arg {words[1]}", depth)
        if len(words) == 3 and words[0] == "optenv":
            return words[2]
        if words and words[0] in ("find", "env", "dirname", "optenv"):
            return part.group()
        raise UnknownNameError(part.group())

    def _bound(self, name: str, depth: int) -> Any:
        found = self.scope.find(name)
        if found is None:
            raise UnknownNameError(name)
        value = found.evaluated(depth + 1)
        if isinstance(value, str):
            try:
                return float(value)
            except ValueError:
                return value
        return value

    def tokens(self) -> list[Value]:
        """Return the values separated by white space."""
        base = self.file.data[self.span[0] : self.span[1]].decode("utf-8", "replace")
        optional = OPTIONAL.fullmatch(base)
        if optional:  # the default of an environment variable
            base = " " * optional.start(1) + optional.group(1)
        return [
            Value(
                self.file,
                (
                    self.span[0] + len(base[: found.start()].encode()),
                    self.span[0] + len(base[: found.end()].encode()),
                ),
                self.anchor,
                self.scope,
                self.owner,
                self.call,
                element=self.element,
            )
            for found in re.finditer(r"(?:\$\{[^{}]*\}|\$\([^()]*\)|[^\s$]|\$)+", base)
        ]


def _plain(value: Any) -> str:
    return f"{value:.15g}" if isinstance(value, float) else str(value)


@dataclass(eq=False)
class Node:
    """An element after expansion."""

    tag: str
    origin: Element
    attributes: dict[str, Value]
    text: Value | None
    scope: Scope
    children: list[Node] = field(default_factory=list)
    parent: Node | None = None

    def all(self, *tags: str) -> Iterator[Node]:
        """Yield this node and all nodes below it with one of these tags."""
        if self.tag in tags:
            yield self
        for child in self.children:
            yield from child.all(*tags)

    def around(self, *tags: str) -> Iterator[Node]:
        """Yield the nodes around this one with one of these tags, or all, from the inside out."""
        node = self.parent
        while node is not None:
            if not tags or node.tag in tags:
                yield node
            node = node.parent

    def child(self, *path: str) -> Node | None:
        """Return the first node at a path of tags below this one."""
        node: Node | None = self
        for tag in path:
            node = next((one for one in node.children if one.tag == tag), None) if node else None
        return node

    def get(self, name: str) -> str:
        """Return an attribute as text, evaluated if possible; empty without it."""
        return "" if name not in self.attributes else _text(self.attributes[name])

    def content(self, *path: str) -> str:
        """Return the text of the node at a path, evaluated if possible; empty without it."""
        node = self.child(*path)
        return "" if node is None or node.text is None else _text(node.text)


def _text(value: Value) -> str:
    try:
        return str(value)
    except UnknownNameError:
        return value.text


@dataclass(eq=False)
class Document:
    """All given files of one model, expanded."""

    roots: list[Node]
    files: list[TextFile]
    calls: dict[str, int]
    """Macro -> number of its calls."""
    unknown: list[str]
    """Macros that are called, and that no given file defines."""
    copies: dict[Element, int]
    """Element -> number of its expansions."""

    def is_shared(self, value: Value) -> bool:
        """Return whether a text is expanded several times, as in a macro with several calls."""
        return value.element is not None and self.copies.get(value.element, 0) > 1

    def all(self, *tags: str) -> Iterator[Node]:
        """Yield all nodes with one of these tags."""
        for root in self.roots:
            yield from root.all(*tags)


def expand(elements: Sequence[Element]) -> Document:
    """Expand the root elements of files; a file that another includes is expanded in its place.

    Raises
    ------
    SensorgraphError : Macros call each other without end.
    """
    return _Expansion(elements).document()


class _Expansion:
    """One pass over the files."""

    def __init__(self, elements: Sequence[Element]) -> None:
        self.by_name = {element.file.path.name: element for element in elements}
        self.elements = elements
        self.macros: dict[str, Element] = {}
        self.calls: dict[str, int] = {}
        self.unknown: list[str] = []
        self.including: set[str] = set()
        self.copies: dict[Element, int] = {}

    def document(self) -> Document:
        """Expand every file that no other includes."""
        included = {
            PurePosixPath(_attribute(node, "filename", "file")).name
            for element in self.elements
            for node in _below(element)
            if node.tag in ("xacro:include", "include")
        } & self.by_name.keys()
        scope = Scope()
        tops = [one for one in self.elements if one.file.path.name not in included] or [self.elements[0]]
        roots = [node for one in tops for node in self.nodes(one, scope)]
        return Document(roots, [one.file for one in self.elements], self.calls, self.unknown, self.copies)

    def nodes(self, element: Element, scope: Scope) -> list[Node]:
        """Expand one element."""
        tag = element.tag
        if scope.parent is not None or tag not in ("xacro:property", "xacro:arg"):
            self.copies[element] = self.copies.get(element, 0) + 1  # files that define names may come twice
        if tag in ("xacro:include", "include"):
            return self._include(element, scope)
        if not tag.startswith("xacro:"):
            return [self._node(element, scope)]
        name = tag.removeprefix("xacro:")
        if name in ("property", "arg"):
            self._define(element, scope, "arg " if name == "arg" else "")
            return []
        if name == "macro":
            self.macros[_attribute(element, "name").removeprefix("xacro:")] = element
            return []
        if name in ("if", "unless"):
            is_true = _truth(_value_of(element, "value", scope))
            taken = is_true is None or is_true == (name == "if")
            return self._children(element, scope) if taken else []
        if name == "insert_block":
            block = scope.block(_attribute(element, "name"))
            return [] if block is None else [node for one in block[0] for node in self.nodes(one, block[1])]
        if name in self.macros:
            return self._call(element, scope, self.macros[name], name)
        if name not in self.unknown:
            self.unknown.append(name)
        return [self._node(element, scope)]

    def _node(self, element: Element, scope: Scope) -> Node:
        values = {name: _value_of(element, name, scope) for name in element.attributes}
        text = (
            None
            if element.text is None
            else Value(element.file, element.text, element.end, scope, element=element)
        )
        node = Node(element.tag, element, values, text, scope, self._children(element, scope))
        for child in node.children:
            child.parent = node
        return node

    def _children(self, element: Element, scope: Scope) -> list[Node]:
        return [node for child in element.children for node in self.nodes(child, scope)]

    def _include(self, element: Element, scope: Scope) -> list[Node]:
        name = PurePosixPath(_attribute(element, "filename", "file")).name
        found = self.by_name.get(name)
        if found is None or name in self.including:
            return [] if element.tag == "xacro:include" else [self._node(element, scope)]
        self.including.add(name)
        nodes = self._children(found, scope)
        self.including.discard(name)
        return nodes

    def _define(self, element: Element, scope: Scope, prefix: str) -> None:
        name = prefix + _attribute(element, "name")
        key = next((one for one in ("value", "default") if one in element.attributes), None)
        target = scope.root if prefix or _attribute(element, "scope") == "global" else scope
        if _attribute(element, "scope") == "parent" and scope.parent is not None:
            target = scope.parent
        if key is None:
            scope.blocks[name] = (element.children, scope)
        elif key == "value" or target.find(name) is None:
            target.values[name] = _value_of(element, key, scope)
            target.values[name].name = name

    def _call(self, element: Element, scope: Scope, macro: Element, name: str) -> list[Node]:
        self.calls[name] = self.calls.get(name, 0) + 1
        if sum(self.calls.values()) > MAX_CALLS:
            raise SensorgraphError(
                f"{element.file.path}: more than {MAX_CALLS} macro calls; expected a model whose macros do not call themselves"
            )
        inner = Scope(parent=scope)
        blocks = list(element.children)
        start, end = macro.attributes.get("params", (0, 0))
        text = macro.file.data[start:end].decode("utf-8", "replace")
        for found in PARAMETER.finditer(text):
            stars, parameter, outer, default = found.groups()
            if stars:
                if blocks:
                    block = blocks.pop(0)
                    inner.blocks[parameter] = ([block] if stars == "*" else block.children, scope)
            elif parameter in element.attributes:
                inner.values[parameter] = _value_of(element, parameter, scope)
                inner.values[parameter].owner = macro
            elif outer and scope.find(parameter):
                inner.values[parameter] = scope.find(parameter)  # type: ignore[assignment]
            elif default is not None:
                quoted = default[:1] in "'\"" and len(default) > 1
                at = start + len(text[: found.start(4) + quoted].encode())
                to = start + len(text[: found.end(4) - quoted].encode())
                inner.values[parameter] = Value(
                    macro.file, (at, to), macro.head_end, scope, macro, element, parameter
                )
        return self._children(macro, inner)


def _attribute(element: Element, *names: str) -> str:
    for name in names:
        if name in element.attributes:
            start, end = element.attributes[name]
            return element.file.data[start:end].decode("utf-8", "replace")
    return ""


def _value_of(element: Element, name: str, scope: Scope) -> Value:
    span = element.attributes.get(name, (element.start, element.start))
    return Value(element.file, span, element.head_end, scope, name=name, element=element)


def _truth(value: Value) -> bool | None:
    """Return whether a condition holds; None if it is not known."""
    try:
        found = value.evaluated()
    except UnknownNameError:
        return None
    if isinstance(found, str):
        return {"true": True, "1": True, "false": False, "0": False}.get(found.strip().lower())
    return bool(found)


def _below(element: Element) -> Iterator[Element]:
    yield element
    for child in element.children:
        yield from _below(child)
