"""The tutorials' scripts run, and print what their pages show."""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "docs" / "examples"
SLOW = {"controller", "hidden_effect"}
SCRIPTS = [
    pytest.param(script, marks=[pytest.mark.slow] if script.stem in SLOW else [], id=script.stem)
    for script in sorted(EXAMPLES.glob("*.py"))
]
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:[eE][+-]\d+)?")


@pytest.mark.parametrize("script", SCRIPTS)
def test_the_script_prints_what_its_page_shows(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(script)])
    runpy.run_path(str(script), run_name="__main__")
    printed, shown = capsys.readouterr().out, script.with_suffix(".txt").read_text()
    again = f"python docs/examples/{script.name} > docs/examples/{script.stem}.txt"
    assert NUMBER.sub("#", printed) == NUMBER.sub("#", shown), again
    numbers, expected = (list(map(float, NUMBER.findall(text))) for text in (printed, shown))
    # another processor rounds otherwise, and a chaotic drive shows it in its second digit
    assert numbers == pytest.approx(expected, rel=0.1, abs=0.02), again
