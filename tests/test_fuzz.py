"""Damaged files and odd options, some of each kind: what `python -m benchmarks.fuzz` tries by the hundred thousand."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.fuzz.commands import COMMANDS, fuzz_command, write_samples
from benchmarks.fuzz.readers import READERS, fuzz_reader
from sensorgraph.cli import run as cli


@pytest.mark.parametrize("name", [name for name in READERS if name != "model"])
def test_a_damaged_file_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    """`python -m benchmarks.fuzz` tries 100,000; here some of each kind."""
    assert not fuzz_reader(name, 10, 1, tmp_path)


@pytest.mark.parametrize("name", ["inspect", "recover", "show", "predict", "record", "export", "nav2"])
def test_what_is_fuzzed_works_undamaged(name: str, tmp_path: Path) -> None:
    places = write_samples(tmp_path)
    assert cli([word.format(**places) for word in COMMANDS[name][0].split()]) == 0


@pytest.mark.parametrize("name", ["inspect", "recover", "show", "predict"])
def test_an_odd_option_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    assert not fuzz_command(name, 4, 1, tmp_path)
