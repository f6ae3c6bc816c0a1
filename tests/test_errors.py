"""`import sensorgraph` raises one error, whichever package finds the fault."""

from __future__ import annotations

from pathlib import Path

import pytest

import sensorgraph as sg
from sensorgraph import errors


def test_a_fault_that_another_package_finds_arrives_as_the_one_error(tmp_path: Path) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"nothing")
    with pytest.raises(errors.SensorgraphError, match="is not a known log"):
        sg.read(broken)
    with pytest.raises(errors.SensorgraphError, match="planner 'nowhere' is unknown"):
        sg.plan("square", planner="nowhere")
    (tmp_path / "arena.geojson").write_text("{}")
    with pytest.raises(errors.SensorgraphError):
        sg.load_arena(tmp_path / "arena.geojson")
