"""Print `--help` on a narrow terminal as a list, with each description indented below its option."""

from __future__ import annotations

import shutil
from typing import Any

NARROW = 72
"""[columns] Width below which a table with boxes truncates names."""


def is_narrow() -> bool:
    """Return whether the terminal (or COLUMNS) is too narrow for tables."""
    return shutil.get_terminal_size().columns < NARROW


def set_narrow(command: Any) -> None:
    """Make a command and its subcommands print their help as a list."""
    own = command.context_class
    command.context_class = type(
        "NarrowContext", (own,), {"formatter_class": _formatter(own.formatter_class)}
    )
    command.rich_markup_mode = None
    for inner in getattr(command, "commands", {}).values():
        inner.short_help = (
            inner.short_help or (inner.help or "").split("\n\n")[0]
        )  # else it is truncated for a table
        set_narrow(inner)


def _formatter(own: Any) -> type:
    def begin(self: Any, *args: Any, **kwargs: Any) -> None:
        own.__init__(self, *args, **kwargs)
        self.width = shutil.get_terminal_size().columns - 2

    def write_dl(self: Any, rows: Any, col_max: int = 30, col_spacing: int = 2) -> None:
        for name, text in rows:
            self.write(f"{'':{self.current_indent}}{name}\n")
            with self.indentation():
                self.write_text(text)

    return type("NarrowFormatter", (own,), {"__init__": begin, "write_dl": write_dl})
