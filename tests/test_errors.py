"""One error behind `import sensorgraph`, and its old name."""

from __future__ import annotations

from pathlib import Path

import pytest

import sensorgraph as sg
from sensorgraph import errors


def test_the_old_name_is_the_same_class_and_warns() -> None:
    with pytest.warns(DeprecationWarning, match="SensorgraphError"):
        assert errors.GapError is errors.SensorgraphError


def test_other_names_are_not_there() -> None:
    with pytest.raises(AttributeError, match="NoSuchError"):
        _ = errors.NoSuchError


def test_a_fault_that_another_package_finds_arrives_as_the_one_error(tmp_path: Path) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"nothing")
    with pytest.raises(errors.SensorgraphError, match="is no log"):
        sg.read(broken)
    with pytest.raises(errors.SensorgraphError, match="planner 'nowhere' is unknown"):
        sg.plan("square", planner="nowhere")
    (tmp_path / "arena.geojson").write_text("{}")
    with pytest.raises(errors.SensorgraphError):
        sg.load_arena(tmp_path / "arena.geojson")
