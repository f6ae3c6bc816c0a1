"""The shell of a page that stands alone: its style, its header, pictures within the page."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable
from html import escape
from pathlib import Path

STYLE = """
:root { --ink: #23262f; --soft: #6d7282; --line: #e3e6ec; --alarm: #d1345b; --calm: #2a788e; --pale: #f6f7f9; }
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); background: #fff; font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto,
  "Helvetica Neue", Arial, sans-serif; }
main { max-width: 60rem; margin: 0 auto; padding: 3.5rem 1.5rem 5rem; }
header { border-left: 5px solid var(--calm); padding-left: 1.4rem; margin-bottom: 3rem; }
header.found, header.unknown, header.undecided, header.misplaced { border-color: var(--alarm); }
header.skipped { border-color: var(--line); }
.eyebrow { color: var(--soft); font-size: .85rem; letter-spacing: .02em; margin: 0 0 .5rem; }
h1 { font-size: 1.75rem; line-height: 1.28; font-weight: 650; margin: 0 0 .8rem; letter-spacing: -.01em; }
header p.lead { margin: .35rem 0; max-width: 46rem; }
h2 { font-size: 1.15rem; font-weight: 650; margin: 3.2rem 0 .6rem; }
p { margin: .5rem 0; max-width: 46rem; }
.note, .soft, figcaption { color: var(--soft); font-size: .9rem; }
figure { margin: 1.2rem 0 0; }
figure img { display: block; max-width: 100%; height: auto; }
figcaption { margin-top: .5rem; max-width: 46rem; }
table { border-collapse: collapse; width: 100%; font-size: .92rem; margin-top: .8rem; }
th { text-align: left; font-weight: 600; color: var(--soft); font-size: .82rem; }
th, td { padding: .45rem .9rem .45rem 0; border-bottom: 1px solid var(--line); vertical-align: top; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.effect { border: 1px solid var(--line); border-radius: 8px; padding: 1.1rem 1.3rem; margin: 1rem 0; }
.effect h3 { margin: 0; font-size: 1.05rem; }
.effect h3 code { color: var(--soft); font-weight: 400; font-size: .85rem; margin-left: .5rem; }
.equation { font: 1.02rem/1.6 ui-serif, Georgia, "Times New Roman", serif; background: var(--pale); border-radius: 6px;
  padding: .6rem .9rem; margin: .7rem 0; max-width: none; }
.equation b { font-weight: 600; color: var(--calm); white-space: nowrap; }
.facts { display: grid; grid-template-columns: repeat(auto-fit, minmax(8.5rem, 1fr)); gap: .4rem 1.5rem; margin: .8rem 0; }
.facts div span { display: block; color: var(--soft); font-size: .8rem; }
table.pairs td:first-child { width: 34%; color: var(--soft); }
table.ledger td { font-size: .86rem; } table.ledger td:nth-child(2) { width: 34%; }
tr.named, tr.unknown, tr.undecided { background: var(--pale); }
small { color: var(--soft); }
sub { font-size: .72em; }
code, pre { font: .88em ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; } pre { white-space: pre-wrap; }
ul { padding-left: 1.1rem; margin: .5rem 0; } li { margin: .2rem 0; }
details summary { cursor: pointer; color: var(--soft); font-size: .92rem; margin-top: .6rem; }
footer { margin-top: 4rem; padding-top: 1rem; border-top: 1px solid var(--line); color: var(--soft); font-size: .85rem; }
@media (max-width: 48rem) { main { padding: 1.5rem 1rem 3rem; } header { padding-left: .9rem; } h1 { font-size: 1.4rem; }
  table { display: block; overflow-x: auto; } th, td { min-width: 4.5rem; }
  td:last-child:not(.n) { min-width: 12rem; } .wide, figure { overflow-x: auto; } .wide svg, figure img { min-width: 36rem; }
  figcaption { position: sticky; left: 0; } }
@media print { main { padding: 0; max-width: none; } body { font-size: 11pt; } figure, .effect, tr { break-inside: avoid; }
  h2 { break-after: avoid; } }
"""


def page_shell(
    *, headline: str, lead: Iterable[str], eyebrow: str, kind: str, sections: Iterable[str]
) -> str:
    """Return a page.

    Parameters
    ----------
    headline, lead, eyebrow : plain text: the answer, sentences below it, a small line above it
    kind : class of the header: `found`, `unknown`, `undecided`, `misplaced`, `skipped`; any other is calm
    sections : HTML; empty ones are left out
    """
    header = [
        f'<header class="{kind}"><p class="eyebrow">{escape(eyebrow)}</p>',
        f"<h1>{without_breaks(headline)}</h1>",
        *(f'<p class="lead">{without_breaks(text)}</p>' for text in lead),
        "</header>",
    ]
    text = "\n".join([*header, *filter(None, sections)])
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(headline)}</title><style>{STYLE}</style></head>\n<body><main>\n{text}\n</main></body></html>\n"
    )


def warnings(log_notes: Iterable[str]) -> list[str]:
    """Return the warnings of the log readers as sentences."""
    return [f"Warning: {note}." for note in log_notes]


def picture(path: Path | None, alt: str, caption: str) -> str:
    """Return a figure with an embedded PNG file; empty without a file."""
    if path is None:
        return ""
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    width = int.from_bytes(path.read_bytes()[16:20], "big")  # PNG: the header chunk begins with the width
    return (
        f'<figure><img alt="{escape(alt)}" width="{round(width * 0.62)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def without_breaks(text: str) -> str:
    """Keep numbers with their units and errors on one line."""
    glued = re.sub(
        r"(?<=\d) (?=(%|cm|mm|ms|m|s|nats)\b|%)|(?<=[\w°%/]) (?=[±=])|(?<=[±<>=]) (?=[\d+−])", "\u00a0", text
    )
    return escape(glued)
