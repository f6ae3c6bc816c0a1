"""What README and docs show works as shown: code runs, commands and linked files exist."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

import logs
from sensorgraph.cli import COMMANDS
from sensorgraph.effects.effects_file import loads

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def test_the_recording_example_writes_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "recording.md").read_text(), re.S)
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "docs/recording.md", "exec"), {})
    run = logs.read(tmp_path / "run.mcap")
    assert (run.n_scans, len(run.poses), len(run.odometry), len(run.commands)) == (1, 1, 1, 1)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_and_links_exist(page: Path) -> None:
    text = page.read_text()
    for command in re.findall(r"(?:^|`|/)sensorgraph ([a-z]+)", text, re.M):
        assert command in COMMANDS, command
    for link in re.findall(r"\]\(([^)#]+)\)", text):
        assert (page.parent / link).exists(), link
    for script in re.findall(r"python ((?:benchmarks|docs)/\S+\.py)", text):
        assert (ROOT / script).exists(), script


def test_the_page_of_effects_is_the_registry() -> None:
    printed = runpy.run_path(str(ROOT / "docs" / "effects_table.py"))["page"]()
    assert (ROOT / "docs" / "effects.md").read_text() == printed, (
        "python docs/effects_table.py > docs/effects.md"
    )


def test_the_example_of_effects_can_be_read() -> None:
    (text,) = re.findall(r"```yaml\n(.*?)```", (ROOT / "docs" / "effects.md").read_text(), re.S)
    assert [a.name for a in loads(text)] == ["glass", "wheel_radius"]


def test_readme_holds_the_two_commands_that_ci_runs() -> None:
    text = (ROOT / "README.md").read_text()
    for name in ("demo", "tests"):
        block = re.search(rf"<!-- {name} -->\n```sh\n(.+)\n```\n<!-- end -->", text)
        assert block is not None
        assert block.group(1).startswith("python3 -m venv .venv && ")
