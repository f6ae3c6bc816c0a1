"""The tutorials' scripts run, and print what their pages show."""

from __future__ import annotations

import re
import runpy
import shlex
import shutil
import sys
from pathlib import Path

import pytest

from sensorgraph.cli import run as cli

EXAMPLES = Path(__file__).parent.parent / "docs" / "examples"
SLOW = {"controller", "hidden_effect", "nav2", "plan_to_sensorgraph"}
NEEDS = {"mujoco_twin": "mujoco"}
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


@pytest.mark.slow
def test_the_commands_of_the_quickstart_run_one_after_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """All of them, word for word but for coarser bins, so that the drive is short, and without a display."""
    page = EXAMPLES.parent / "pages" / "quickstart.md"
    blocks = re.findall(r"```sh\n(.*?)```", page.read_text(), re.S)
    commands = [line for block in blocks for line in block.splitlines() if line.startswith("sensorgraph ")]
    assert [line.split()[1] for line in commands] == [
        "plan", "record", "inspect", "build", "show", "plan", "record", "evaluate", "review", "show",
    ]  # fmt: skip
    for name in ("lab.geojson", "robot.yaml"):
        shutil.copy(EXAMPLES / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    for line in commands:
        words = [word for word in shlex.split(line)[1:] if word != "--show"]
        words += ["--cell", "0.5", "--headings", "8"] if words[0] == "plan" and "--views" not in words else []
        assert cli(words) == 0, (line, capsys.readouterr().err)
    printed = capsys.readouterr().out
    for said in (
        "100.00 %) in 0 h",
        "scans paired with poses",
        "r = (",
        "median error",
        "wrote lab.sensorgraph",
    ):
        assert said in printed, said
    for name in ("plan/plan.png", "run.mcap", "lab.sensorgraph", "check.mcap", "review.rrd", "faces.png"):
        assert (tmp_path / name).stat().st_size > 0
