"""The picture of how candidates rank: nothing of it is cut off, however long their places are called."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from PIL import Image

from sensorgraph.diagnosis.report.figures.ranking import ranking_picture
from sensorgraph.diagnosis.scan.model_selection import Step
from sensorgraph.effects import EFFECTS


def test_the_longest_names_are_within_the_picture(tmp_path: Path) -> None:
    gone = EFFECTS["missing_obstacle"]().at("a_cupboard_of_the_second_floor_133", np.array([-10.5, 13.0]))
    bias = EFFECTS["range_bias"](b=0.01)
    steps = (Step(tried=((gone, 3039.0), (bias, 20.0)), chosen="missing_obstacle"),)
    finding: Any = SimpleNamespace(explained=SimpleNamespace(steps=steps))
    ranking_picture(finding, tmp_path / "ranking.png")
    dark = np.asarray(Image.open(tmp_path / "ranking.png").convert("L")) < 128
    assert dark.any() and not dark[:, :8].any() and not dark[:, -8:].any()
