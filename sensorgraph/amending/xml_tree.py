"""Read XML into elements that know the byte spans of their attributes and texts."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from xml.parsers import expat

from sensorgraph.amending.text import TextFile
from sensorgraph.errors import SensorgraphError

ATTRIBUTE = re.compile(rb"""([\w:.\-]+)\s*=\s*("[^"]*"|'[^']*')""")
MAX_DEPTH = 200
"""Maximum depth of elements."""


@dataclass(eq=False)
class Element:
    """One element of a file."""

    tag: str
    file: TextFile
    start: int
    head_end: int
    """Offset behind the start tag."""
    attributes: dict[str, tuple[int, int]]
    """Name -> span of the value between its quotes."""
    end: int = 0
    text: tuple[int, int] | None = None
    """Span of the text without white space around it; None without text."""
    children: list[Element] = field(default_factory=list)

    def add_attribute(self, name: str, text: str, phrase: str) -> None:
        """Add an attribute to the start tag."""
        is_empty = self.file.data[self.head_end - 2 : self.head_end] == b"/>"
        at = self.head_end - (2 if is_empty else 1)
        self.file.insert(at, f' {name}="{text}"', phrase, self.head_end)

    def add_behind(self, text: str, phrase: str) -> None:
        """Insert an element on a separate line, behind this one and with its indentation."""
        file = self.file
        file.insert(self.end, f"{file.newline}{file.indent(self.start)}{text}", phrase)


def parse_xml(file: TextFile) -> Element:
    """Return the root element of a file.

    Raises
    ------
    SensorgraphError : The file is not XML, defines entities, or is nested too deeply.
    """
    parser = expat.ParserCreate()
    stack: list[Element] = []
    roots: list[Element] = []
    data = file.data

    def begin(tag: str, _: object) -> None:
        start = parser.CurrentByteIndex
        head = _head(data, start)
        element = Element(tag, file, start, head, _attributes(data, start + 1 + len(tag.encode()), head))
        if len(stack) >= MAX_DEPTH:
            raise SensorgraphError(f"{file.path}: more than {MAX_DEPTH} nested elements; expected a model")
        (stack[-1].children if stack else roots).append(element)
        stack.append(element)

    def finish(tag: str) -> None:
        element = stack.pop()
        at = parser.CurrentByteIndex
        is_empty = data[element.head_end - 2 : element.head_end] == b"/>"
        element.end = element.head_end if is_empty else data.index(b">", at) + 1

    def characters(text: str) -> None:
        element = stack[-1]
        if text.strip() and element.text is None:
            at = parser.CurrentByteIndex
            lead = len(text) - len(text.lstrip())
            first = at + len(text[:lead].encode())
            end = data.index(b"<", first)
            element.text = (first, first + len(data[first:end].rstrip()))

    def entity(name: str, *_: object) -> None:
        raise SensorgraphError(f"{file.path}: defines the entity {name}; expected a model without entities")

    parser.StartElementHandler, parser.EndElementHandler = begin, finish
    parser.CharacterDataHandler, parser.EntityDeclHandler = characters, entity
    parser.buffer_text = False
    try:
        parser.Parse(data, True)
    except expat.ExpatError as exc:
        raise SensorgraphError(
            f"{file.path}: not XML: {expat.ErrorString(exc.code)} in line {exc.lineno}; expected URDF, xacro, SDF or MJCF"
        ) from exc
    return roots[0]


def _head(data: bytes, start: int) -> int:
    """Return the offset behind a start tag; a `>` inside quotes does not end it."""
    quote = 0
    for at in range(start, len(data)):
        byte = data[at]
        if quote:
            quote = 0 if byte == quote else quote
        elif byte in b"\"'":
            quote = byte
        elif byte == 0x3E:
            return at + 1
    return len(data)


def _attributes(data: bytes, start: int, end: int) -> dict[str, tuple[int, int]]:
    return {
        found.group(1).decode(): (found.start(2) + 1, found.end(2) - 1)
        for found in ATTRIBUTE.finditer(data, start, end)
    }
