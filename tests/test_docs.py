"""What README and the site's pages show works as shown: code runs, commands, links and included files exist."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest
import yaml

import logs
import sensorgraph
from planners.maps import no_go
from planners.maps.no_go import without
from planners.planning import WALL_MARGIN
from sensorgraph.cli import COMMANDS
from sensorgraph.diagnosis.scan.consequence import SURELY_MATERIAL
from sensorgraph.effects.effects_file import loads
from sensorgraph.loading import load_arena
from sensorgraph.world.robot import default_robot
from sensorgraph.world.wall_distance import WallDistance

ROOT = Path(__file__).parent.parent
SITE = ROOT / "docs" / "pages"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted(SITE.rglob("*.md"))]


def test_the_recording_example_writes_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = SITE / "how-to" / "record.md"
    (code,) = re.findall(r"```python\n(.*?)```", page.read_text(), re.S)
    monkeypatch.chdir(tmp_path)
    exec(compile(code, str(page), "exec"), {})
    run = logs.read(tmp_path / "run.mcap")
    assert (run.n_scans, len(run.poses), len(run.odometry), len(run.commands)) == (1, 1, 1, 1)


@pytest.mark.slow
def test_the_loop_in_the_readme_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = ROOT / "README.md"
    (code,) = re.findall(r"```python\n(.*?)```", page.read_text(), re.S)
    assert len(code.splitlines()) <= 16
    bins = "cell=0.5, headings=8"
    assert bins in code
    code = code.replace(bins, "cell=1.0, headings=2")  # so that the drive is short; all else word for word
    monkeypatch.chdir(tmp_path)
    exec(compile(code, str(page), "exec"), {})
    printed = capsys.readouterr().out
    assert "face" in printed
    assert "omega(k) = " in printed
    assert (tmp_path / "review.rrd").stat().st_size > 0


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_commands_links_and_included_files_exist(page: Path) -> None:
    text = page.read_text()
    for command in re.findall(r"(?:^|`|/)sensorgraph ([a-z]+)", text, re.M):
        assert command in COMMANDS, command
    for link in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", text):
        assert link.startswith("https://") or (page.parent / link).exists(), link
    for script in re.findall(r"python (docs/[\w/]+\.py)", text):
        assert (ROOT / script).exists(), script
    assert "python benchmarks/" not in text  # they are run as modules
    for module in re.findall(r"python\s-m (benchmarks[\w.]*\w)", text):
        path = ROOT / module.replace(".", "/")
        assert path.with_suffix(".py").exists() or (path / "__main__.py").exists(), module
    assert "--8 <" not in text  # a formatter has taken an included script for Python
    for included in re.findall(r'--8<-- "([^":]+)', text):
        assert (ROOT / included).exists(), included


def test_the_examples_have_the_arena_and_the_robot_of_the_quickstart() -> None:
    page = (SITE / "quickstart.md").read_text()
    given = dict(re.findall(r'```\w+ title="(.*?)"\n(.*?)```', page, re.S))
    assert sorted(given) == ["lab.geojson", "robot.yaml"]
    for name, text in given.items():
        assert yaml.safe_load((ROOT / "docs" / "examples" / name).read_text()) == yaml.safe_load(text)


def test_poses_of_commands_in_shipped_arenas_are_free() -> None:
    """A pose that a page or the help of `plan` gives is one that the shipped robot can reach."""
    text = "\n".join(page.read_text() for page in [*PAGES, ROOT / "sensorgraph" / "cli" / "plan.py"])
    radius = default_robot().footprint_radius + WALL_MARGIN
    found = [
        (arena, *map(float, pose))
        for arena, options in re.findall(r"sensorgraph plan (square|office)\b([^\n`]*)", text)
        for pose in re.findall(r"--(?:start|end|dock) ([\d.]+),([\d.]+)", options)
    ]
    assert len(found) >= 6
    assert not [one for one in found if WallDistance(load_arena(one[0]))(*one[1:]) < radius]


def test_the_zone_of_the_page_is_in_the_lab(tmp_path: Path) -> None:
    (zone,) = re.findall(r"```json\n(.*?)```", (SITE / "how-to" / "no-go.md").read_text(), re.S)
    (tmp_path / "zones.geojson").write_text(zone)
    lab = load_arena(ROOT / "docs" / "examples" / "lab.geojson")
    assert without(lab, no_go.zones(str(tmp_path / "zones.geojson"))).free.area < lab.free.area


def test_every_page_is_in_the_navigation() -> None:
    text = re.sub(r"!!?(?:relative|python\S*)", "", (ROOT / "docs" / "mkdocs.yml").read_text())
    listed = re.findall(r"[\w/-]+\.md", str(yaml.safe_load(text)["nav"]))
    assert sorted(listed) == sorted(page.relative_to(SITE).as_posix() for page in SITE.rglob("*.md"))


def test_the_page_of_effects_is_the_registry() -> None:
    printed = runpy.run_path(str(ROOT / "docs" / "effects_table.py"))["page"]()
    assert (SITE / "reference" / "effects.md").read_text() == printed, (
        "python docs/effects_table.py > docs/pages/reference/effects.md"
    )


def test_every_rule_that_takes_a_name_is_on_the_page_of_rules() -> None:
    text = (SITE / "reference" / "diagnosis.md").read_text()
    section = text.split("## Rules that take a name")[1].split("\n## ")[0]
    listed = set(re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE))
    code = "\n".join(path.read_text() for path in (ROOT / "sensorgraph" / "diagnosis").rglob("*.py"))
    rules = {SURELY_MATERIAL, *re.findall(r'Objection\(\s*"(\w+)"', code)}
    assert rules == listed


@pytest.mark.parametrize(("name", "function"), [("architecture", "picture"), ("engine", "engine")])
def test_a_drawn_picture_is_what_its_script_draws(name: str, function: str) -> None:
    drawn = runpy.run_path(str(ROOT / "docs" / "architecture_picture.py"))[function]()
    assert (SITE / "pictures" / f"{name}.svg").read_text() == drawn, (
        f"python docs/architecture_picture.py {name} > docs/pages/pictures/{name}.svg"
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["beam", "smoothing"])
def test_a_picture_of_a_method_is_drawn(name: str) -> None:
    figure = runpy.run_path(str(ROOT / "docs" / "method_pictures.py"))[name]()
    assert len(figure.axes) >= 2


@pytest.mark.parametrize("page", ["reference/effects.md", "how-to/simulate-effects.md"])
def test_the_example_of_effects_can_be_read(page: str) -> None:
    (text,) = re.findall(r"```yaml\n(.*?)```", (SITE / page).read_text(), re.S)
    assert [a.name for a in loads(text)] == ["glass", "wheel_radius"]


def test_readme_holds_the_two_commands_that_ci_runs() -> None:
    text = (ROOT / "README.md").read_text()
    for name in ("demo", "tests"):
        block = re.search(rf"<!-- {name} -->\n```sh\n(.+)\n```\n<!-- end -->", text)
        assert block is not None
        assert block.group(1).startswith("python3 -m venv .venv && ")


def test_one_version_stands_everywhere() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert cited["version"] == sensorgraph.__version__
    assert f"## {cited['version']} — {cited['date-released']}" in (ROOT / "CHANGELOG.md").read_text()
