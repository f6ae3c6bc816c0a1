"""`sensorgraph demo --full`: the planned drive beside a random one, and beside the model of 2004."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sensorgraph.cli import run


@pytest.mark.slow
def test_a_plan_and_faces_beat_chance_and_polynomials(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["demo", "--full", "-o", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "[6/6]" in said and "random, same time" in said and "planned, form of 2004" in said
    result = json.loads((tmp_path / "demo.json").read_text())
    planned, random, plain = (result[name] for name in ("coverage", "random_bounce", "coverage_polynomial"))
    assert planned["coverage"] > 1.5 * random["coverage"]
    assert plain["all"]["median_m"] > 10 * planned["all"]["median_m"]
    assert (tmp_path / "coverage.png").exists() and (tmp_path / "random_bounce.mcap").exists()
