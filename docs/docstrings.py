"""Let mkdocstrings read our docstrings: `name : what it is`, on one line, with the type in the signature.

numpydoc takes what follows the colon for the type; this moves it to the description before the text is parsed.
"""

from __future__ import annotations

import re
from typing import Any

import griffe

ENTRY = re.compile(r"^(\S[^:]*?) : (.*)$")
NAMED = ("Parameters", "Raises", "Attributes")


class OneLineEntries(griffe.Extension):
    """Rewrite the docstring of every object that is loaded."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite one docstring."""
        if obj.docstring is not None:
            obj.docstring.value = rewritten(obj.docstring.value)


def rewritten(text: str) -> str:
    """Put the description of each entry on a line below its name; say what is returned in a sentence."""
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
