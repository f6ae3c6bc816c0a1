"""benchmarks/hidden_effects stands alone: its worlds share no physics, and it runs where the product is not installed."""

from __future__ import annotations

import ast
import hashlib
import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from benchmarks import hidden_effects
from benchmarks.hidden_effects.case import Spec
from benchmarks.hidden_effects.worlds import WORLDS
from benchmarks.hidden_effects.worlds.blind import cases as blind
from benchmarks.hidden_effects.worlds.own import cases as own

HERE = Path(hidden_effects.__file__).parent
OURS = ("sensorgraph", "planners", "logs", "robotmodic_ident")
ALLOWED = {
    *sys.stdlib_module_names,
    "numpy",
    "scipy",
    "shapely",
    "numba",
    "yaml",
    "mcap",
    "rosbags",
    "mujoco",
    "irsim",
}
CASE_FORM = {f"benchmarks.hidden_effects.{name}" for name in ("case", "geometry", "library", "log", "robot")}
"""What worlds share: the form of a case, polygons, what robot.yaml and the reference page say, and no physics."""


def _imported(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        names |= {one.name for one in node.names} if isinstance(node, ast.Import) else set()
        if isinstance(node, ast.ImportFrom):
            of_package = node.module == hidden_effects.__name__
            names |= (
                {f"{node.module}.{one.name}" for one in node.names} if of_package else {node.module or ""}
            )
    return names


@pytest.mark.parametrize("world", ["own", "blind", "floors", "simulators"])
def test_a_world_shares_no_code_with_the_product_nor_with_another_world(world: str) -> None:
    modules = [*(HERE / "worlds" / world).glob("*.py")]
    assert len(modules) > 4
    for path in modules:
        for name in _imported(path):
            is_its_own = name.startswith(f"benchmarks.hidden_effects.worlds.{world}")
            assert is_its_own or name in CASE_FORM or name.split(".")[0] in ALLOWED, f"{path}: {name}"


def test_every_world_has_a_module_with_suites() -> None:
    for module in WORLDS.values():
        path = HERE.parent.parent / (module.replace(".", "/") + ".py")
        assert "SUITES = " in path.read_text() and "def make(spec: Spec) -> Case" in path.read_text()


@pytest.mark.parametrize(("world", "digest"), [(own, "780398f86cbc5d4c"), (blind, "9c617b2720c03fdc")])
def test_a_seed_gives_the_same_case_as_ever(world: object, digest: str) -> None:
    """Truth, map and robot.yaml; numbers of the physics to six digits, which differ with processor and library beyond."""
    case = world.make(Spec(suite="singles", index=1, background="dirty"))  # type: ignore[attr-defined]
    values = json.loads(json.dumps(case.truth), parse_float=lambda text: f"{float(text):.6g}")
    text = json.dumps([values, case.map["arena.geojson"], case.robot], sort_keys=True)
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == digest


def test_the_package_has_all_its_parts() -> None:
    stated = tomllib.loads((HERE / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    there = {path.parent.relative_to(HERE.parent.parent) for path in HERE.rglob("__init__.py")}
    assert sorted(stated) == sorted(".".join(path.parts) for path in there)


BLOCKED = f"""
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {OURS}:
            raise ImportError(name + " is not installed")
sys.meta_path.insert(0, Absent())
from benchmarks.hidden_effects.command import main
main()
"""


@pytest.mark.slow
def test_it_generates_answers_and_scores_where_the_product_is_not_installed(tmp_path: Path) -> None:
    def run(*arguments: str) -> str:
        command = [sys.executable, "-c", BLOCKED, *arguments]
        done = subprocess.run(command, capture_output=True, text=True, cwd=HERE.parent.parent, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    folder = str(tmp_path)
    run("generate", "--world", "own", "--suite", "singles", "--effect", "mount_yaw", "--strength", "0.9",
        "--background", "clean", "--n", "1", "-o", folder)  # fmt: skip
    assert "mount_yaw" in run("answer", folder, "--entrant", "least_squares")
    assert "no report: " in run("answer", folder, "--entrant", "sensorgraph")
    assert "material single, first name right, clean (1 effects)" in run(
        "score", folder, "--answers", "least_squares"
    )
    table = run("score", folder).splitlines()
    assert table[0].split() == ["least_squares", "sensorgraph"]
    (named,) = (line for line in table if line.startswith("material single, clean: named first"))
    assert named.split("first")[1].split() == ["1", "of", "1", "0", "of", "1"]
