"""The public face: `import sensorgraph as sg` is light, lazy, and takes objects or the paths of their files."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import sensorgraph as sg
from logs.run import Run
from sensorgraph.planning.plan import CoveragePlan

pytestmark = pytest.mark.usefixtures("trusted_scans")

FUNCTIONS = (
    "build",
    "diagnose",
    "evaluate",
    "export",
    "identify",
    "load_arena",
    "load_robot",
    "plan",
    "predict",
    "read",
    "record",
    "review",
)


@pytest.fixture(scope="module")
def drive() -> CoveragePlan:
    return sg.plan("square", planner="random_bounce", duration=20.0, seed=1)


@pytest.fixture(scope="module")
def run(drive: CoveragePlan) -> Run:
    return sg.record(drive, seed=1)


def test_every_public_name_is_there_and_listed() -> None:
    for name in sg.__all__:
        assert getattr(sg, name) is not None
    assert set(sg.__all__) <= set(dir(sg))
    assert [name for name in dir(sg) if name not in sg.__all__ and not name.startswith("__")] == []


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'biuld'"):
        sg.biuld  # noqa: B018


def test_import_loads_nothing_heavy() -> None:
    code = (
        "import sys, sensorgraph; heavy = {'numpy', 'scipy', 'numba', 'shapely', 'rerun', 'mcap', 'matplotlib'};"
        "print(*sorted(heavy & set(sys.modules)))"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == ""


@pytest.mark.parametrize("name", FUNCTIONS)
def test_help_is_enough_to_use_a_function(name: str) -> None:
    function = getattr(sg, name)
    text = inspect.getdoc(function) or ""
    assert "Raises" in text
    undocumented = [p for p in inspect.signature(function).parameters if p not in text and p != "progress"]
    said_in_the_first_line = {"run", "graph", "path", "poses", "runs"}
    assert set(undocumented) <= said_in_the_first_line


def test_submodules_do_not_shadow_functions() -> None:
    """`import sensorgraph.building.build` must not turn `sg.build` into a module."""
    for module in pkgutil.iter_modules(sg.__path__):
        importlib.import_module(f"sensorgraph.{module.name}")
    assert [name for name in FUNCTIONS if not callable(getattr(sg, name))] == []


@pytest.mark.usefixtures("no_pictures")
def test_a_plan_and_its_folder_give_the_same_run(drive: CoveragePlan, run: Run, tmp_path: Path) -> None:
    folder = drive.save(tmp_path / "plan")
    again = sg.record(folder, seed=1)
    np.testing.assert_allclose(again.poses, run.poses, atol=1e-6)  # trajectory.csv is rounded
    assert np.mean(again.ranges == run.ranges) > 0.99


def test_a_run_and_its_file_give_the_same_graph(run: Run, drive: CoveragePlan, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    sg.record(drive, seed=1, path=path)
    form = {"model": "polynomial", "degree": 2, "harmonics": 1}
    from_file, in_memory = sg.build(path, **form), sg.build(run, **form)
    pose = [1.0, 1.0, 0.3]
    means = sg.predict(from_file, pose).mean, sg.predict(in_memory, pose).mean
    np.testing.assert_allclose(*means, atol=1e-4)  # a file keeps ranges as float32
    assert sg.predict(in_memory, pose).ranges.shape == (1, run.sensor.n_rays)
    assert sg.evaluate(in_memory, path).n_rays == sg.evaluate(from_file, run).n_rays


def test_results_say_what_they_are_in_a_few_lines(drive: CoveragePlan, run: Run) -> None:
    graph = sg.build(run, model="polynomial", degree=2, harmonics=1)
    found = sg.EFFECTS["range_bias"](b=0.03)
    turn = sg.identify(run, output="omega", inputs="cmd_omega", lags=1)
    near = graph.near(run.ranges[0], run.poses[:3])
    amended = sg.amend(Path(sg.__path__[0]) / "data" / "radix.yaml", [sg.EFFECTS["wheel_radius"](s=0.01)])
    for result in (
        drive, drive.trajectory, drive.robot, run, run.sensor, graph, graph.predict(run.poses[0]), near,
        sg.evaluate(graph, run), drive.arena, found, found.effect, turn, amended,
    ):  # fmt: skip
        lines = repr(result).splitlines()
        assert 1 <= len(lines) <= 5, type(result)
        assert max(map(len, lines)) <= 200, type(result)


def test_results_are_tables_in_a_notebook(drive: CoveragePlan, run: Run) -> None:
    graph = sg.build(run, arena=drive.arena, model="polynomial", degree=2, harmonics=1)
    named = replace(run, meta={**run.meta, "source": "<b>mine</b> & yours"})
    for result, said in (
        (drive, "coverage"),
        (run, "odometry"),
        (graph, "terms"),
        (sg.evaluate(graph, run), "median_m"),
    ):
        table = ElementTree.fromstring(result._repr_html_())
        assert table.tag == "table" and table.find("caption") is not None
        rows = table.findall("tbody/tr")
        assert 3 <= len(rows) <= 20 and len({len(row) for row in rows}) == 1
        assert said in "".join(table.itertext())
    assert "<b>" not in named._repr_html_() and "&lt;b&gt;mine" in named._repr_html_()


def test_inputs_of_identify_may_be_one_text(run: Run) -> None:
    one = sg.identify(run, output="omega", inputs="cmd_omega, cmd_v", lags=1)
    other = sg.identify(run, output="omega", inputs=["cmd_omega", "cmd_v"], lags=1)
    assert one.model.equation() == other.model.equation()


def test_a_parameter_that_an_effect_lacks_is_refused() -> None:
    with pytest.raises(sg.errors.SensorgraphError, match="range_bias has no parameter `a`; expected b"):
        sg.EFFECTS["range_bias"](a=0.1)


def test_a_trajectory_without_an_arena_is_refused(drive: CoveragePlan) -> None:
    with pytest.raises(sg.errors.SensorgraphError, match="give the arena to drive in"):
        sg.record(drive.trajectory)


def test_a_graph_and_an_arena_are_exported(tmp_path: Path) -> None:
    left = sg.export("square", "irsim", tmp_path / "world", robot=sg.load_robot())
    assert left == []
    assert (tmp_path / "world" / "world.yaml").is_file()
    with pytest.raises(sg.errors.SensorgraphError, match="known are mujoco"):
        sg.export(sg.load_arena("square"), "unreal", tmp_path / "none")
    assert not (tmp_path / "none").exists()
