"""Find and change values of a YAML file by the positions of their text."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import yaml

from sensorgraph.amending.findings import CannotHoldError
from sensorgraph.amending.text import TextFile, Why, decimal, is_same, note, number_text
from sensorgraph.errors import SensorgraphError

PROPERTIES = re.compile(r"(?:[&!]\S*\s+)*")
"""Anchor and tag in front of a value."""


class _Loader(yaml.SafeLoader):
    """A loader that keeps the place of an alias of a scalar."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.scalars: dict[str, tuple[yaml.ScalarNode, list[yaml.ScalarNode]]] = {}

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Return the next node; that of an alias has the value of the anchor and the span of the alias."""
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        node = super().compose_node(parent, index)
        if not isinstance(node, yaml.ScalarNode) or event.anchor is None:
            return node
        start, end = event.start_mark, event.end_mark
        if not isinstance(event, yaml.AliasEvent):
            self.scalars[event.anchor] = node, []
            return node
        alias = yaml.ScalarNode(node.tag, node.value, start, end)
        self.scalars[event.anchor][1].append(alias)
        return alias


@dataclass(eq=False)
class YamlFile:
    """A YAML file with its syntax tree."""

    file: TextFile
    root: yaml.MappingNode
    anchors: dict[str, tuple[yaml.ScalarNode, list[yaml.ScalarNode]]]
    """Anchor of a scalar -> its node, and a node for each alias."""

    @classmethod
    def of(cls, file: TextFile) -> YamlFile:
        """Parse a file.

        Raises
        ------
        SensorgraphError : The file is not a YAML mapping.
        """
        try:
            loader = _Loader(file.data.decode("utf-8"))
            root = loader.get_single_node()
        except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as exc:
            raise SensorgraphError(f"{file.path}: not YAML: {' '.join(str(exc).split())}") from exc
        if not isinstance(root, yaml.MappingNode):
            raise SensorgraphError(
                f"{file.path}: neither XML nor a YAML mapping; expected a URDF, xacro, SDF or MJCF file, a nav2_params.yaml or a robot.yaml"
            )
        return cls(file, root, loader.scalars)

    def find(self, *path: str) -> Any:
        """Return the node at a path of keys; None if it is not there."""
        node: Any = self.root
        for key in path:
            node = child(node, key)
        return node

    def check_anchors(self) -> None:
        """Check that no changed number is also that of a key that stays.

        Raises
        ------
        CannotHoldError : It is, by an alias.
        """
        for name, (node, aliases) in self.anchors.items():
            if self.span(node) in self.file.edits and any(
                self.span(one) not in self.file.edits for one in aliases
            ):
                raise CannotHoldError(f"`*{name}` uses the number elsewhere, too; write that one out")

    def put(self, node: yaml.ScalarNode, value: float, why: Why) -> None:
        """Write a number, with a comment at the end of its line."""
        span = self.span(node)
        old = as_number(node)
        if old is not None and is_same(old, value):
            return
        text = decimal(value) if "." in node.value or "e" in node.value else number_text(value)
        self.file.replace(span, text, note(node.value, why), self.file.line_end(span[1]))

    def put_text(self, node: yaml.ScalarNode, value: str, phrase: str) -> None:
        """Write a text."""
        span = self.span(node)
        self.file.replace(span, value, f"was {node.value}: {phrase}", self.file.line_end(span[1]))

    def add(self, mapping: Any, path: tuple[str, ...], value: str, why: Why) -> None:
        """Add a key to a mapping, or a section to the file if the mapping is not there.

        Raises
        ------
        CannotHoldError : There is something else than a mapping.
        """
        file, phrase = self.file, note(None, why)
        if isinstance(mapping, yaml.MappingNode) and not mapping.value:  # {}
            end = self.span(mapping)[1]
            comma = ", " if (end - 1, end - 1) in file.edits else ""
            file.insert(end - 1, f"{comma}{path[-1]}: {value}", phrase, file.line_end(end))
            return
        if isinstance(mapping, yaml.ScalarNode) and not mapping.value:  # nothing behind the colon
            at = self.span(mapping)[0]
            text = f"{file.newline}{file.indent(at)}  {path[-1]}: {value}"
            file.insert(file.line_end(at), text, phrase)
            return
        if mapping is not None and not isinstance(mapping, yaml.MappingNode):
            raise CannotHoldError(f"the section of `{path[-1]}` is not a mapping")
        if isinstance(mapping, yaml.MappingNode) and mapping.value:
            key, last = mapping.value[-1]
            at = self.span(last)[1]
            if mapping.flow_style:
                file.insert(at, f", {path[-1]}: {value}", phrase, file.line_end(at))
                return
            while file.data[at - 1 : at].isspace():  # a block ends at the next key
                at -= 1
            at = file.line_end(at)
            file.insert(at, f"{file.newline}{' ' * key.start_mark.column}{path[-1]}: {value}", phrase)
            return
        is_open = not file.data.endswith(b"\n")
        keys = file.newline.join(f"{'  ' * depth}{key}:" for depth, key in enumerate(path))
        text = f"{file.newline if is_open else ''}{keys} {value}"
        file.insert(len(file.data) + 1, text, phrase)  # behind an insertion at the end of the last line
        if not is_open:
            file.insert(len(file.data) + 1, file.newline, "")

    def span(self, node: yaml.Node) -> tuple[int, int]:
        """Return the byte span of a node, without an anchor or a tag."""
        text = self.file.data.decode("utf-8")
        start, end = node.start_mark.index, node.end_mark.index
        if isinstance(node, yaml.ScalarNode):
            found = PROPERTIES.match(text, start, end)
            start = start if found is None else found.end()
        head = len(text[:start].encode())
        return head, head + len(text[start:end].encode())


def child(node: Any, key: str) -> Any:
    """Return the value of a key of a mapping node; None if it is not there."""
    if not isinstance(node, yaml.MappingNode):
        return None
    return next((value for name, value in node.value if name.value == key), None)


def as_number(node: Any) -> float | None:
    """Return the number of a scalar node; None if it is not a plain number."""
    try:
        return float(node.value) if isinstance(node, yaml.ScalarNode) else None
    except ValueError:
        return None
