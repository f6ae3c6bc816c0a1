"""The command line as a whole: quick to start, one line for every mistake, quiet when interrupted."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from sensorgraph.cli import COMMANDS, run


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_examples(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([command, "--help"]) == 0
    text = capsys.readouterr().out
    assert f"sensorgraph {command}" in text
    assert "Examples" in text


def test_help_loads_nothing_heavy() -> None:
    heavy = "{'numpy', 'scipy', 'shapely', 'rerun', 'mcap', 'rosbags', 'ompl', 'matplotlib'}"
    code = f"import sys; from sensorgraph.cli import run; run(['--help']); print({heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip().splitlines()[-1] == "set()"


def test_the_demo_loads_no_package_that_it_does_not_need() -> None:
    """Each takes a fifth of a second or more of every command."""
    code = "import sys, sensorgraph.demo; print({'scipy.interpolate', 'scipy.stats', 'gtsam'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_a_command_uses_one_blas_thread_unless_told_otherwise(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import os, sys\n"
        "from sensorgraph import cli\n"
        "cli.run = lambda: print(os.environ['OPENBLAS_NUM_THREADS'], 'numpy' in sys.modules) or 0\n"
        "cli.main()\n"
    )
    for told, expected in (({}, "1 False"), ({"OPENBLAS_NUM_THREADS": "2"}, "2 False")):
        rest = {k: v for k, v in os.environ.items() if k != "OPENBLAS_NUM_THREADS"}
        done = subprocess.run(
            [sys.executable, script], env=rest | told, capture_output=True, text=True, check=True
        )
        assert done.stdout.strip() == expected


@pytest.mark.slow
def test_compile_leaves_the_kernels_of_all_stages_in_the_cache(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "sensorgraph", "compile"]
    variables = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run(command, env=variables, capture_output=True, check=True)
    # module.kernel.digest-line
    kept = {".".join(path.name.split(".")[:2]) for path in tmp_path.rglob("*.nbi")}
    kernels = {
        "beam.beam_search",
        "visibility._e_step",
        "matching._match_readings",
        "prediction.predict_rays",
        "whitening.robust_misfit",
    }
    assert kernels <= kept


def test_the_package_runs_as_a_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "sensorgraph", "inspect", "--nonsense"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "--nonsense" in done.stderr and len(done.stderr.splitlines()) == 1


def test_interruption_is_said_and_has_its_own_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("logs.inspection.inspect", interrupted)
    assert run(["inspect", str(tmp_path)]) == 130
    assert capsys.readouterr().err.strip() == "interrupted"


def test_a_fault_of_ours_is_one_line_and_code_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise IndexError("list index out of range")

    monkeypatch.setattr("logs.inspection.inspect", broken)
    monkeypatch.delenv("SENSORGRAPH_DEBUG", raising=False)
    assert run(["inspect", str(tmp_path)]) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "IndexError" in line
    assert "a bug in sensorgraph" in line


@pytest.mark.parametrize(
    "arguments", [["nonsense"], ["--nonsense"], ["plan"], ["plan", "square", "--cell", "x", "-o", "p"]]
)
def test_usage_errors_are_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(arguments) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("error: ")
