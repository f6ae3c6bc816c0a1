"""Adapt our docstrings to mkdocstrings: an entry is one line, `name : description`, with the type in the signature.

numpydoc reads the text after the colon as the type. This extension moves it to the description before the text is parsed.
"""

from __future__ import annotations

import re
from typing import Any

import griffe

ENTRY = re.compile(r"^(\S[^:]*?) : (.*)$")
NAMED = ("Parameters", "Raises", "Attributes")


class OneLineEntries(griffe.Extension):
    """Rewrite the docstring of every loaded object."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of one object."""
        if obj.docstring is not None:
            obj.docstring.value = rewritten(obj.docstring.value)


def rewritten(text: str) -> str:
    """Return a docstring with each description on the line below its name, and the return value as a sentence."""
    lines, out, section = text.splitlines(), [], ""
    for k, line in enumerate(lines):
        following = lines[k + 1] if k + 1 < len(lines) else ""
        if line and set(following) == {"-"} and len(following) >= len(line):
            section = line
            out += ["**Returns**", ""] if section == "Returns" else [line]
        elif set(line) == {"-"} and section == "Returns":
            continue
        elif section in NAMED and (entry := ENTRY.match(line)):
            names, what = entry.groups()
            for name in [names] if section == "Raises" else names.split(", "):
                out += [name, f"    {what}"]
        else:
            out.append(line)
    return "\n".join(out)
