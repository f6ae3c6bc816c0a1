"""A small HTML table for `_repr_html_` in notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def html_table(caption: str, rows: Iterable[Sequence[str]], head: Sequence[str] = ()) -> str:
    """Return a table whose first column holds the row names; all text is escaped.

    Parameters
    ----------
    rows : name and cells of each row, the same number in each
    head : names of the columns; empty for no header row
    """
    left = ' style="text-align: left"'
    lines = ["<table>", f'<caption style="caption-side: top; text-align: left">{escape(caption)}</caption>']
    if head:
        names = "".join(f"<th{left}>{escape(name)}</th>" for name in head)
        lines.append(f"<thead><tr>{names}</tr></thead>")
    lines.append("<tbody>")
    for name, *cells in rows:
        body = "".join(f"<td{left}>{escape(cell)}</td>" for cell in cells)
        lines.append(f"<tr><th{left}>{escape(name)}</th>{body}</tr>")
    return "\n".join([*lines, "</tbody>", "</table>"])
