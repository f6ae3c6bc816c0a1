"""`sensorgraph recover`: says how much was saved and how much was lost, and leaves a file that opens."""

from __future__ import annotations

from pathlib import Path

import pytest
from logs_samples import some_run

import logs
from sensorgraph.cli import run as command


def test_cut_file_is_saved_and_the_loss_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "run.mcap", tmp_path / "saved.mcap"
    logs.write(some_run(200, 361), path)
    path.write_bytes(path.read_bytes()[:150_000])
    assert command(["inspect", str(path)]) == 2
    assert f"sensorgraph recover {path} -o {tmp_path / 'run.recovered.mcap'}" in capsys.readouterr().err
    assert command(["recover", str(path), "-o", str(out)]) == 0
    said = capsys.readouterr().out
    n_scans = logs.read(out).n_scans
    assert n_scans > 50
    for words in (
        f"/scan: {n_scans}",
        "attachments: scene.geojson, blob",
        "metadata: sensorgraph",
        "lost ",
        "ends without a footer",
    ):
        assert words in said, said
    assert said.endswith(f"wrote {out}\n")
    assert command(["inspect", str(out)]) == 0


def test_whole_file_says_that_nothing_was_lost(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs.write(some_run(), tmp_path / "run.mcap")
    assert command(["recover", str(tmp_path / "run.mcap"), "-o", str(tmp_path / "out.mcap")]) == 0
    assert "lost nothing: the file was intact" in capsys.readouterr().out


def test_part_of_a_killed_recorder_may_take_its_final_name(tmp_path: Path) -> None:
    """The output's own temporary file must not be the very `.part` that is to be saved."""
    logs.write(some_run(200, 361), tmp_path / "run.mcap")
    part = (tmp_path / "run.mcap").rename(tmp_path / "run.mcap.part")
    part.write_bytes(part.read_bytes()[:-1000])
    before = part.read_bytes()
    assert command(["recover", str(part), "-o", str(tmp_path / "run.mcap")]) == 0
    assert logs.read(tmp_path / "run.mcap").n_scans == 200
    assert part.read_bytes() == before


@pytest.mark.parametrize("arguments", [[], ["nofile.mcap"], ["nofile.mcap", "-o", "out.mcap"]])
def test_wrong_use_gives_one_line_and_exit_2(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(["recover", *arguments]) == 2
    assert capsys.readouterr().err.count("\n") == 1
