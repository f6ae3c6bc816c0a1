"""The tutorials' scripts run, and print what their pages show."""

from __future__ import annotations

import re
import runpy
import shlex
import sys
from pathlib import Path

import pytest

from sensorgraph.cli import run as cli

EXAMPLES = Path(__file__).parent.parent / "docs" / "examples"
SLOW = {
    "controller",
    "hidden_effect",
    "mujoco_twin",
    "nav2",
    "plan_to_sensorgraph",
    "sensor_model",
    "watch_twin",
    "real_log",
}
NEEDS = {"mujoco_twin": "mujoco", "watch_twin": "mujoco"}
"""Script -> a package of an extra, without which it is skipped."""
SCRIPTS = [
    pytest.param(script, marks=[pytest.mark.slow] if script.stem in SLOW else [], id=script.stem)
    for script in sorted(EXAMPLES.glob("*.py"))
]
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:[eE][+-]\d+)?")


@pytest.mark.parametrize("script", SCRIPTS)
def test_the_script_prints_what_its_page_shows(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if script.stem in NEEDS:
        pytest.importorskip(NEEDS[script.stem])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(script)])
    runpy.run_path(str(script), run_name="__main__")
    printed, shown = capsys.readouterr().out, script.with_suffix(".txt").read_text()
    again = f"python docs/examples/{script.name} > docs/examples/{script.stem}.txt"
    assert NUMBER.sub("#", printed) == NUMBER.sub("#", shown), again
    numbers, expected = (list(map(float, NUMBER.findall(text))) for text in (printed, shown))
    # another processor rounds otherwise, and a chaotic drive shows it in its second digit
    assert numbers == pytest.approx(expected, rel=0.1, abs=0.02), again


def shown_outputs(page: str) -> list[tuple[list[str], str]]:
    """Return each group of commands of a page, with the output that is shown after it (empty: none)."""
    blocks = re.findall(r"```(sh|text)\n(.*?)```", page, re.S)
    out: list[tuple[list[str], str]] = []
    for kind, body in blocks:
        if kind == "sh":
            out.append(([line for line in body.splitlines() if line.startswith("sensorgraph ")], ""))
        else:
            out[-1] = (out[-1][0], body)
    return [pair for pair in out if pair[0]]


def assert_prints(printed: str, shown: str) -> None:
    """Compare line by line; `...` at the end of a line, or as a line, stands for anything that follows."""
    lines = printed.splitlines()
    for k, line in enumerate(shown.splitlines()):
        if line == "...":
            return
        text, cut, _ = line.partition(" ...")
        found = lines[k] if k < len(lines) else ""
        found = found[: len(text)] if cut else found
        assert NUMBER.sub("#", found) == NUMBER.sub("#", text), (found, text)
        numbers = (list(map(float, NUMBER.findall(part))) for part in (found, text))
        first, expected = numbers
        assert first == pytest.approx(expected, rel=0.1, abs=0.02), (found, text)


@pytest.mark.slow
def test_the_quickstart_prints_what_its_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """All commands, word for word, without a display."""
    page = (EXAMPLES.parent / "pages" / "quickstart.md").read_text()
    for name, body in re.findall(r'```\w+ title="(.*?)"\n(.*?)```', page, re.S):
        (tmp_path / name).write_text(body)
    monkeypatch.chdir(tmp_path)
    used = []
    for commands, shown in shown_outputs(page):
        for line in commands:
            capsys.readouterr()
            words = [word for word in shlex.split(line)[1:] if word != "--show"]
            used.append(words[0])
            assert cli(words) == 0, (line, capsys.readouterr().err)
        assert_prints(capsys.readouterr().out, shown)
    assert used == [
        "plan", "record", "inspect", "build", "show", "plan", "record", "evaluate", "review", "show",
    ]  # fmt: skip
    (size,) = re.findall(r"The graph is one file of (\d+) kB", page)
    assert (tmp_path / "lab.sensorgraph").stat().st_size / 1000 == pytest.approx(float(size), rel=0.05)
    for name in ("plan/plan.png", "run.mcap", "check.mcap", "review.rrd", "faces.png"):
        assert (tmp_path / name).stat().st_size > 0
