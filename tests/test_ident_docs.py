"""The example of the page on identification prints what the page says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parent.parent / "docs" / "pages" / "how-to" / "identify.md"


def test_the_example_prints_what_the_page_says(capsys: pytest.CaptureFixture[str]) -> None:
    text = PAGE.read_text()
    (code,) = re.findall(r"```python\n(.*?)```", text, re.S)
    printed = re.findall(r"prints\n\n```text\n(.*?)```", text, re.S)[0]
    exec(compile(code, str(PAGE), "exec"), {})
    assert capsys.readouterr().out == printed
