"""What is kept between casts: a scene with a memory reads what one without does."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import effects_samples as world
import numpy as np
import pytest

from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.world.cast_memory import CastMemory, Recent

MODELS: tuple[tuple[Amendment, ...], ...] = (
    (),
    (EFFECTS["moved_obstacle"](dx=0.05, dy=-0.1).at("box"),),
    (EFFECTS["moved_obstacle"](dx=0.06, dy=-0.1).at("box"), EFFECTS["mount_xy"](dx=0.02, dy=0.0)),
    (
        EFFECTS["moved_obstacle"](dx=0.06, dy=-0.1).at("box"),
        EFFECTS["unmapped_obstacle"](x=1.0, y=2.0, r=0.2),
    ),
    (EFFECTS["missing_obstacle"]().at("box"),),
    (EFFECTS["map_scale"](s=0.01, dx=0.0, dy=0.0),),
    (EFFECTS["mirror"](a=0.5, b=2.5).at("room/edge_0"), EFFECTS["moved_wall"](d=0.1).at("room/edge_1")),
    (EFFECTS["latency"](tau=0.1), EFFECTS["moved_wall"](d=0.1).at("room/edge_1")),
    (),
)
"""Which walls stand elsewhere changes from one to the next, and so do rays, discs and surfaces."""


@pytest.mark.parametrize("sweep", [0.0, 0.08])
def test_a_memory_changes_no_reading(sweep: float) -> None:
    sensor = replace(world.SENSOR, sweep_time=sweep)
    memory = CastMemory()
    for model in (*MODELS, *MODELS[::-1]):
        scene = world.scene(sensor, box=True)
        scene.casts = memory
        with_memory, without = scene.run(model), world.scene(sensor, box=True).run(model)
        np.testing.assert_allclose(with_memory.reading, without.reading, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(with_memory.wall, without.wall)


def test_the_one_unused_longest_of_too_many_is_made_again() -> None:
    made: list[bytes] = []
    recent: Recent[None] = Recent(2)
    for key in (b"a", b"b", b"a", b"c", b"a", b"b"):
        recent.get(key, partial(made.append, key))
    assert made == [b"a", b"b", b"c", b"b"]
