"""The house: sensorgraph stands above planners, logs and robotmodic_ident; each third party has one owner."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("planners", "logs", "robotmodic_ident", "sensorgraph")
OWNERS = {
    "ompl": {"planners/joins/ompl_process.py", "planners/ompl_frame.py", "planners/ompl_planner.py"},
    "mcap": {"logs/"},
    "rosbags": {"logs/"},
    "zstandard": {"logs/"},  # both come with mcap: recovery must decompress what is left of a cut chunk
    "lz4": {"logs/"},
    "rerun": {
        "sensorgraph/show/rerun_file.py",
        "sensorgraph/show/review/",
        "sensorgraph/diagnosis/report/rerun_view.py",
        "sensorgraph/surveying/rerun_layer.py",
    },
    "shapely": {"planners/", "sensorgraph/world/", "sensorgraph/exporting/"},
    "matplotlib": {
        "logs/run_figure.py",
        "sensorgraph/show/figures/",
        "sensorgraph/diagnosis/report/arena_figure.py",
        "sensorgraph/diagnosis/report/residual_figures.py",
    },
    "typer": {"sensorgraph/cli/"},
    "rich": {"sensorgraph/cli/"},
    "yaml": {"sensorgraph/", "planners/", "logs/"},
    "PIL": {"planners/maps/"},
    "distributed": {"sensorgraph/dask_client.py", "sensorgraph/surveying/cluster.py"},
    "pyarrow": {"sensorgraph/surveying/parquet.py"},
    "numba": {"robotmodic_ident/kernel.py", "planners/kernel.py", "planners/call_types.py"},
    "gtsam": {"sensorgraph/localization/pose_graph.py"},
    "mujoco": {"sensorgraph/data/export/drive_mujoco.py"},
    "irsim": {"sensorgraph/data/export/drive_irsim.py"},
    "zenoh": {"logs/live/network.py"},
    "launch": {"sensorgraph/data/export/bridge.launch.py"},
    "launch_ros": {"sensorgraph/data/export/bridge.launch.py"},
    "numpy": set(PACKAGES),
    "scipy": set(PACKAGES),
}
TOP_LEVEL = {
    "pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CONTRIBUTING.md", "CITATION.cff", ".gitignore", ".ci",
    "benchmarks", "docs", "tests", *PACKAGES,
}  # fmt: skip
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
    "gtsam",
    "distributed",
}


def modules() -> list[Path]:
    return [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def statements_of(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the node and the statements in it, without their expressions, which are nine nodes in ten."""
    yield node
    for block in ("body", "handlers", "orelse", "finalbody", "cases"):
        for inner in getattr(node, block, ()):
            yield from statements_of(inner)


@cache
def nodes_of(path: Path) -> tuple[ast.AST, ...]:
    return tuple(statements_of(tree_of(path)))


@cache
def imports(path: Path) -> tuple[tuple[str, bool], ...]:
    """Return (top-level package, is at module level) of every import."""
    return tuple(_imports(path))


def _imports(path: Path) -> Iterator[tuple[str, bool]]:
    top = {id(node) for node in tree_of(path).body}
    for node in nodes_of(path):
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


SAME_IN_EACH_LEAF = {
    "files.py": ("logs", "planners", "robotmodic_ident"),
    "yaml_text.py": ("logs", "planners"),
    "uninterrupted.py": ("planners", "robotmodic_ident"),
}
"""Small modules that more than one leaf needs; the leaves know nothing of each other, so each has a copy."""


@pytest.mark.parametrize("name", SAME_IN_EACH_LEAF)
def test_what_every_leaf_needs_says_the_same_in_each(name: str) -> None:
    assert len({(ROOT / leaf / name).read_text() for leaf in SAME_IN_EACH_LEAF[name]}) == 1


def test_a_temporary_file_is_made_in_one_place_of_each_leaf() -> None:
    """`logs.formats.mcap_file` has its own, since a recording that a crash ends must keep its name."""
    makers = {name_of(path) for path in modules() if "uuid4" in path.read_text()}
    assert makers == {f"{leaf}/files.py" for leaf in SAME_IN_EACH_LEAF["files.py"]} | {
        "logs/formats/mcap_file.py"
    }


MOST_LINES = {"module": 400, "function": 80, "class": 250}
REASON = re.compile(r"\bone (loop|piece|class|table)\b|most of this function", re.IGNORECASE)
"""What is longer says so in its docstring, and why one piece is clearer."""


def dotted(path: Path) -> str:
    return name_of(path).removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def own_imports(nodes: Iterable[ast.AST], known: frozenset[str]) -> set[str]:
    """Return the modules of ours that any of the nodes imports."""
    found = set()
    for inner in nodes:
        if isinstance(inner, ast.Import):
            found |= {alias.name for alias in inner.names}
        elif isinstance(inner, ast.ImportFrom):
            names = {f"{inner.module}.{alias.name}" for alias in inner.names}
            found |= (names & known) or {str(inner.module)}
    return found & known


def test_no_module_imports_itself_through_others() -> None:
    """Also not through type hints, nor through imports inside functions."""
    paths = {dotted(path): path for path in modules()}
    known = frozenset(paths)
    left = {name: own_imports(nodes_of(path), known) - {name} for name, path in paths.items()}
    while done := {name for name, needs in left.items() if not needs & left.keys()}:
        left = {name: needs for name, needs in left.items() if name not in done}
    assert not left, f"a circle runs through some of {sorted(left)}"


def test_imports_inside_functions_hide_something() -> None:
    """A third party that is heavy or optional; our own modules only where start-up counts: commands, lazy names."""
    known = frozenset(dotted(path) for path in modules())
    for path in modules():
        if any(name_of(path).startswith(room) for room in LIGHT):
            continue
        for node in nodes_of(path):
            if isinstance(node, ast.FunctionDef) and node.name != "__getattr__":
                inside = own_imports(statements_of(node), known)
                assert not inside, (
                    f"{name_of(path)}: {node.name} imports {sorted(inside)}; import it at the top"
                )


def test_what_is_long_says_why() -> None:
    for path in modules():
        doc = ast.get_docstring(tree_of(path))
        pieces = [("module", name_of(path), len(path.read_text().splitlines()), doc)]
        for node in nodes_of(path):
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                kind = "class" if isinstance(node, ast.ClassDef) else "function"
                lines = (node.end_lineno or 0) - node.lineno + 1
                pieces.append((kind, f"{name_of(path)}: {node.name}", lines, ast.get_docstring(node)))
        for kind, name, lines, doc in pieces:
            assert lines <= MOST_LINES[kind] or REASON.search(doc or ""), f"{kind} {name} has {lines} lines"


def test_no_two_public_classes_share_a_name() -> None:
    homes: dict[str, list[str]] = {}
    for path in modules():
        for node in tree_of(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes.setdefault(node.name, []).append(name_of(path))
    assert not {name: places for name, places in homes.items() if len(places) > 1}


def test_nothing_else_lies_at_the_top_level() -> None:
    """Two wheels of another project, 54 MB, once were committed there."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("what is tracked is known of a checkout alone")
    tracked = subprocess.run(
        ["git", "-C", ROOT, "ls-files"], capture_output=True, text=True, check=True
    ).stdout
    assert {name.split("/")[0] for name in tracked.splitlines()} == TOP_LEVEL
