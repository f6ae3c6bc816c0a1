"""The import rule: sensorgraph stands above planners, logs and robotmodic_ident; each third party has one owner."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("planners", "logs", "robotmodic_ident", "sensorgraph")
OWNERS = {
    "ompl": {"planners/joins/ompl_process.py", "planners/ompl_planner.py"},
    "mcap": {"logs/"},
    "rosbags": {"logs/"},
    "zstandard": {"logs/"},  # both come with mcap: recovery must decompress what is left of a cut chunk
    "lz4": {"logs/"},
    "rerun": {
        "sensorgraph/show/rerun_file.py",
        "sensorgraph/show/review/",
        "sensorgraph/diagnosis/report/rerun_view.py",
    },
    "shapely": {"planners/", "sensorgraph/world/"},
    "matplotlib": {
        "sensorgraph/show/figures/",
        "sensorgraph/diagnosis/report/figures/",
    },
    "typer": {"sensorgraph/cli/"},
    "rich": {"sensorgraph/cli/"},
    "yaml": {"sensorgraph/", "planners/", "logs/"},
    "PIL": {"planners/maps/"},
    "distributed": {"sensorgraph/building/dask_cluster.py"},
    "numba": {"robotmodic_ident/kernel.py", "planners/kernel.py"},
    "numpy": set(PACKAGES),
    "scipy": set(PACKAGES),
}
LIGHT = {"sensorgraph/cli"}  # start-up counts: no heavy import at module level
HEAVY = {
    "ompl",
    "mcap",
    "rosbags",
    "rerun",
    "shapely",
    "matplotlib",
    "numpy",
    "scipy",
    "PIL",
    "numba",
    "distributed",
}


def modules() -> list[Path]:
    return [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def imports(path: Path) -> Iterator[tuple[str, bool]]:
    """Yield (top-level package, is at module level)."""
    tree = ast.parse(path.read_text())
    top = {id(node) for node in tree.body}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name.split(".")[0], id(node) in top
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield (node.module or "").split(".")[0], id(node) in top


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_leaves_import_neither_each_other_nor_sensorgraph() -> None:
    for path in modules():
        package = name_of(path).split("/")[0]
        if package == "sensorgraph":
            continue
        for imported, _ in imports(path):
            assert imported not in set(PACKAGES) - {package}, f"{name_of(path)} imports {imported}"


@pytest.mark.parametrize("third_party", OWNERS)
def test_third_party_is_imported_only_by_its_owner(third_party: str) -> None:
    for path in modules():
        if any(imported == third_party for imported, _ in imports(path)):
            assert any(name_of(path).startswith(owner) for owner in OWNERS[third_party]), name_of(path)


def test_every_third_party_has_an_owner() -> None:
    import sys

    known = set(OWNERS) | set(PACKAGES) | set(sys.stdlib_module_names)
    for path in modules():
        for imported, _ in imports(path):
            assert imported in known, f"{name_of(path)} imports {imported}, which has no owner"


def test_command_line_imports_nothing_heavy_at_start() -> None:
    for path in modules():
        if any(name_of(path).startswith(room) for room in LIGHT):
            heavy = {imported for imported, at_top in imports(path) if at_top} & HEAVY
            assert not heavy, f"{name_of(path)} imports {heavy} at module level"


def test_tests_lie_flat_and_none_shadows_a_package() -> None:
    assert not [p for p in (ROOT / "tests").rglob("*.py") if p.parent != ROOT / "tests"]
    assert not [p for p in PACKAGES if (ROOT / f"{p}.py").exists()]
