"""A foreign package `logs` or `planners` before ours on the search path is said in one line."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from sensorgraph.packages import COMPANIONS, check_packages

ROOT = Path(__file__).parent.parent


def test_our_own_packages_pass() -> None:
    check_packages()


@pytest.mark.parametrize("entry", ["sensorgraph", "sensorgraph.cli"])
@pytest.mark.parametrize("name", COMPANIONS)
@pytest.mark.parametrize("is_folder", [True, False], ids=["package", "module"])
def test_another_package_of_that_name_is_one_line(
    tmp_path: Path, name: str, is_folder: bool, entry: str
) -> None:
    if is_folder:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("")
    else:
        (tmp_path / f"{name}.py").write_text("")
    code = (
        f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]\n"
        f"try:\n    import {entry}\n"
        "except ImportError as exc:\n    print(exc)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (line,) = done.stdout.splitlines()
    found = tmp_path / (name if is_folder else f"{name}.py")
    assert f"another package `{name}` in {found}" in line
    assert str(ROOT) in line and "rename yours" in line


def test_a_missing_package_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sensorgraph.packages.COMPANIONS", ("no_such_package",))
    with pytest.raises(ImportError, match=r"`no_such_package`, which is missing.*install sensorgraph again"):
        check_packages()
