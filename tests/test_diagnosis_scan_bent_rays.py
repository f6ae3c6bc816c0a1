"""Slopes of rays that a surface has bent: casting these alone gives what casting all gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scan_samples import drive, hall_arena

from sensorgraph.diagnosis.scan.jacobian import bent_columns
from sensorgraph.diagnosis.scan.scan_data import prepare_scans
from sensorgraph.effects import EFFECTS
from sensorgraph.world.robot import parse_robot
from sensorgraph.world.scene import Scene


@pytest.mark.parametrize(
    ("sensor", "with_cone"),
    [("{n_rays: 61}", False), ("{n_rays: 360, fov: 360 deg}", True)],
    ids=["pane", "pane and cone"],
)
def test_bent_rays_alone_have_the_slopes_that_they_have_among_all(
    sensor: str, with_cone: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    hall = hall_arena()
    robot, run = parse_robot(f"sensor: {sensor}"), drive(hall, n=60)
    seen = replace(run, sensor=robot.sensor, ranges=np.full((60, robot.sensor.n_rays), 2.0))
    data, _ = prepare_scans(seen, hall, robot)
    model = [EFFECTS["glass"](a=0.5, b=4.0, alpha_ret=0.3, depth=1.0).at(hall.names[0])]
    if with_cone:
        model.append(EFFECTS["sonar_cone"](gamma=0.06, alpha_max=1.2))
    beams = data.scene().run(model)
    alone = bent_columns(data, model, beams)
    monkeypatch.setattr(Scene, "wanted", property(lambda _: None, lambda *_: None), raising=False)
    among = bent_columns(data, model, beams)
    assert alone is not None and among is not None and alone[0].sum() > 50
    for one, other in zip(alone, among, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)
