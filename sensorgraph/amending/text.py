"""A file as text with pending edits of spans, and the comment on each edited number."""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass, field
from pathlib import Path

from planners.types import ROUND_OFF

MARK = "sensorgraph amend: "
"""Start of each comment that an amendment writes."""


State = tuple[dict[tuple[int, int], str], dict[int, list[str]]]
"""Pending edits and comments."""


@dataclass(frozen=True, kw_only=True)
class Why:
    """Reason of a changed number."""

    cause: str
    """Effect and parameter with its value, or the quantity measured in a run."""
    sigma: float | None = None
    """Standard error of the new number, in its unit; None if unknown."""

    def __str__(self) -> str:
        return self.cause

    def scaled(self, factor: float) -> Why:
        """Return the same reason with the standard error times a factor."""
        return Why(cause=self.cause, sigma=None if self.sigma is None else abs(factor) * self.sigma)


@dataclass(eq=False)
class TextFile:
    """A file with pending edits; offsets are in bytes of the original."""

    path: Path
    data: bytes
    is_xml: bool
    edits: dict[tuple[int, int], str] = field(default_factory=dict)
    """Span -> new text; an insertion has an empty span."""
    notes: dict[int, list[str]] = field(default_factory=dict)
    """Offset of a comment -> its phrases."""

    @property
    def encoding(self) -> str:
        """Encoding of the file."""
        return declared_encoding(self.data)

    def text(self, span: tuple[int, int]) -> str:
        """Return the text of a span, as edited so far."""
        return self.edits.get(span) or self.data[span[0] : span[1]].decode("utf-8", "replace")

    def replace(self, span: tuple[int, int], new: str, note: str, anchor: int) -> None:
        """Replace a span; the note becomes a comment at `anchor`."""
        self.edits[span] = new
        self._note(anchor, note)

    def insert(self, at: int, new: str, note: str, anchor: int | None = None) -> None:
        """Insert text, with the comment at `anchor`; None: directly behind the text."""
        behind = self._comment([note]) if anchor is None else ""
        self.edits[at, at] = self.edits.get((at, at), "") + new + behind
        if anchor is not None:
            self._note(anchor, note)

    def state(self) -> State:
        """Return a copy of the pending edits."""
        return dict(self.edits), {at: list(phrases) for at, phrases in self.notes.items()}

    def restore(self, state: State) -> None:
        """Return to earlier pending edits."""
        self.edits, self.notes = state

    def line_end(self, at: int) -> int:
        """Return the offset of the end of the line that contains an offset."""
        found = self.data.find(b"\n", at)
        end = len(self.data) if found < 0 else found
        return end - 1 if self.data[end - 1 : end] == b"\r" else end

    def indent(self, at: int) -> str:
        """Return the white space at the start of the line that contains an offset."""
        start = self.data.rfind(b"\n", 0, at) + 1
        return re.match(rb"[ \t]*", self.data[start:]).group().decode()  # type: ignore[union-attr]

    @property
    def newline(self) -> str:
        """Line break of the file."""
        return "\r\n" if b"\r\n" in self.data else "\n"

    def holds(self, effect: str, parameter: str) -> bool:
        """Return whether a comment of an earlier amendment contains a parameter of an effect."""
        # a comment of mount_xy names both of its parameters
        cause = re.compile(rf"\b{effect} (\w+ = [^,;]+, )*{re.escape(parameter)}(?![\d.e])")
        return any(
            MARK in line and cause.search(line)
            for line in self.data.decode(self.encoding, "replace").splitlines()
        )

    def amended(self) -> bytes:
        """Return the file with all edits and comments."""
        # a comment stays on its line, and an insertion at the same offset starts the next one
        pieces = [(at, at, self._comment(phrases)) for at, phrases in self.notes.items()]
        pieces += [(start, end, new) for (start, end), new in self.edits.items()]
        out, last = [], 0
        for start, end, new in sorted(pieces, key=lambda piece: piece[:2]):
            out += [self.data[last:start], new.encode()]
            last = end
        return b"".join([*out, self.data[last:]])

    def diff(self, new: bytes) -> str:
        """Return the unified diff between the file and a new text."""
        before, after = (part.decode(self.encoding, "replace").splitlines() for part in (self.data, new))
        return "\n".join(
            difflib.unified_diff(before, after, f"{self.path}", f"{self.path} (amended)", lineterm="")
        )

    def _note(self, anchor: int, note: str) -> None:
        phrases = self.notes.setdefault(anchor, [])
        if note and note not in phrases:
            phrases.append(note)

    def _comment(self, phrases: list[str]) -> str:
        text = MARK + "; ".join(phrases)
        if not phrases or not any(phrases):
            return ""
        if not self.is_xml:
            return f"  # {text}"
        if self.encoding.lower() not in ("utf-8", "utf8"):
            text = text.replace("±", "+/-").encode("ascii", "replace").decode()
        return f" <!-- {text.replace('--', '- -')} -->"


def declared_encoding(data: bytes) -> str:
    """Return the encoding that an XML declaration names; UTF-8 without one."""
    declared = re.match(rb"<\?xml[^>]*encoding\s*=\s*[\"']([\w.\-]+)", data)
    return declared.group(1).decode() if declared else "utf-8"


def is_same(old: float, new: float) -> bool:
    """Tell whether two numbers are equal up to round-off."""
    return abs(new - old) <= ROUND_OFF * max(1.0, abs(old))


def number_text(value: float) -> str:
    """Return a number with six significant digits."""
    return f"{value + 0.0:.6g}"


def decimal(value: float) -> str:
    """Return a number that YAML and ROS read as a float."""
    digits, e, exponent = number_text(value).partition("e")
    return f"{digits if '.' in digits else f'{digits}.0'}{e}{exponent}"


def note(old: str | None, why: Why) -> str:
    """Return the comment on a changed number."""
    parts = [] if old is None else [f"was {old}"]
    if why.sigma is not None:
        parts.append(f"± {why.sigma:.2g}")
    return f"{', '.join(parts)}: {why.cause}" if parts else why.cause
