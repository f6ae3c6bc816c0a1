"""Pages, docstrings, help texts and messages stay easy to read: short sentences, the field's own verbs.

The idioms below are where earlier prose sounded translated. A sentence that trips this test is rewritten for its reader;
the list is a set of symptoms, not a style guide.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("sensorgraph", "planners", "logs", "robotmodic_ident")
IDIOMS = re.compile(
    r"\b(?:(?:is|are|was|were|be) (?:told|said|asked)|tells? (?:apart|nothing|little|how|whether|which|by|of)"
    r"|says? (?:so|what|how|it|which|by)|hangs? on|is (?:none|nobody|nothing)|nothing but|but for"
    r"|as (?:much|many|far|good|large|little) as that|the more so|(?:what|who|which) (?:it|they) (?:is|are|was|were) (?:of|about)"
    r"|by itself|of (?:its|their) own|stands? (?:beside|for|in|among|where)|lies? (?:beside|among)"
    r"|taken? (?:for|as) (?:it|that|none|nothing)|in (?:its|their|the) stead|instead of which|somebody|nobody"
    r"|what (?:is|was) (?:left|missing|looked at|asked|said|found)|from (?:there|then|that|\d[\d.]* times) on"
    r"|how (?:sure|far|good|large|many times)|goes? to and fro|mend(?:s|ed|ing)?|trifles?|besides?)\b"
)
SECTIONS = re.compile(r"\b(?:Parameters|Returns|Raises|Yields) -{3,}")
LONGEST = 35
"""Words of the longest sentence in README, pages, help texts and messages."""
MOST_IDIOMS = {
    "README.md": 0.0,
    "CHANGELOG.md": 0.3,
    "CONTRIBUTING.md": 0.3,
    "help and messages": 0.3,
    "docs": 0.2,
} | (dict.fromkeys(PACKAGES, 0.3))
"""Idioms per 1,000 words in each area."""


def sentences(text: str) -> list[str]:
    """Split prose into sentences of four words or more, with code and link targets masked."""
    text = re.sub(r"`[^`]*`", "CODE", re.sub(r"\]\([^)]*\)", "]", text))
    parts = re.split(r"(?<=[.!?:;])\s+(?=[A-Z(`*\[\"])|\n", text)
    return [part.strip() for part in parts if part.count(" ") > 2]


def prose_of_page(path: Path) -> Iterator[str]:
    """Yield the paragraphs, list items and table cells of a Markdown page, without its code blocks."""
    text = re.sub(r"```.*?```", "", path.read_text(), flags=re.S)
    for block in re.split(r"\n\s*\n", text):
        lines = [line.strip() for line in block.splitlines()]
        for row in (line for line in lines if line.startswith("|")):
            yield from row.strip("|").split("|")
        prose = " ".join(line for line in lines if not line.startswith(("|", "#", "![", "<", "---", "- {")))
        yield from re.split(r"(?:^|\s)(?:[-*]|\d+\.)\s+", prose)


@cache
def texts_of_module(path: Path) -> tuple[tuple[bool, str], ...]:
    """Return (is a help text or a message, text) of a module's strings of more than three words."""
    tree = ast.parse(path.read_text())
    shown, constants, out = set[int](), list[ast.Constant](), list[tuple[bool, str]]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant):
            constants.append(node)
        elif isinstance(node, ast.Raise):
            shown |= {id(inner) for inner in ast.walk(node)}
    for node in constants:
        if isinstance(node.value, str) and node.value.count(" ") > 3:
            is_shown = id(node) in shown or "/cli/" in path.as_posix()
            text = SECTIONS.sub("\n", re.sub(r"\s+", " ", node.value))
            if not text.lstrip().startswith(("<", ":root")):  # HTML and CSS
                out.append((is_shown, text))
    return tuple(out)


def modules() -> list[Path]:
    return [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def texts(area: str) -> Iterator[str]:
    """Yield the texts of an area."""
    if area.endswith(".md"):
        yield from prose_of_page(ROOT / area)
    elif area == "docs":
        for page in sorted((ROOT / "docs" / "pages").rglob("*.md")):
            yield from prose_of_page(page)
    else:
        for path in modules():
            if area == "help and messages" or path.relative_to(ROOT).parts[0] == area:
                for is_shown, text in texts_of_module(path):
                    if is_shown or area != "help and messages":
                        yield text


@cache
def judged(text: str) -> tuple[int, tuple[str, ...]]:
    """Return how many words a text has, and its idioms, each in its sentence; a message is in two areas."""
    parts = sentences(text)
    idioms = (f"{match.group()!r} in: {part[:120]}" for part in parts for match in IDIOMS.finditer(part))
    return sum(len(part.split()) for part in parts), tuple(idioms)


@pytest.mark.parametrize("area", MOST_IDIOMS)
def test_idioms_stay_rare(area: str) -> None:
    results = [judged(text) for text in texts(area)]
    found = [idiom for _, idioms in results for idiom in idioms]
    share = 1000 * len(found) / sum(words for words, _ in results)
    assert share <= MOST_IDIOMS[area], "\n".join([f"{share:.2f} per 1,000 words", *found[:40]])


@pytest.mark.parametrize(
    "area", ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", "docs", "help and messages"]
)
def test_no_sentence_is_too_long(area: str) -> None:
    long = [
        f"{len(sentence.split())} words: {sentence[:160]}"
        for text in texts(area)
        for sentence in sentences(text)
        if len(sentence.split()) > LONGEST and "$ " not in sentence and "sensorgraph " not in sentence
    ]
    assert not long, "\n".join(long)


def test_a_percentage_has_a_space_before_its_sign() -> None:
    """As in SI and on the pages; the format `:.0%` prints none."""
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in modules()
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if re.search(r":[.,\d]*%\}", line)
    ]
    assert not found, "\n".join(found)
