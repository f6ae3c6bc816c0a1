"""Surfaces of a map of pixels: in the middle of the cells of a robot's map, at their borders in a world made from a map."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from conftest import polygon_arena
from test_diagnosis_raster_map import BIN, BOX, PIXEL, ROBOT, ROOM, mapped, scanned

from logs.run import Run
from planners.arena import Arena
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.raster_map import RasterMap, raster_map_of
from sensorgraph.diagnosis.scan.scan_data import ScanData, prepare_scans
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.world.raycast import cast_laser, laser_poses

SIGMA = ROBOT.sensor.sigma


@pytest.fixture(scope="module")
def pixels(tmp_path_factory: pytest.TempPathFactory) -> Arena:
    """Return the map of a room with a box and a bin."""
    return mapped(tmp_path_factory.mktemp("depth"), BOX, BIN)


def noisy(run: Run, bias: float = 0.0) -> Run:
    noise = np.random.default_rng(5).normal(bias, SIGMA, run.ranges.shape)
    return replace(run, ranges=run.ranges + noise)


def chosen(pixels: Arena, run: Run) -> tuple[RasterMap, dict[str, Any]]:
    def prepare(one: RasterMap) -> tuple[ScanData, dict[str, Any]]:
        return one.judged(prepare_scans(run, one.arena, one.widened(ROBOT))[0])

    found, (data, notes) = raster_map_of(pixels, prepare, SCAN.noise)
    assert data.arena is found.arena
    return found, notes


@pytest.mark.parametrize("bias", [0.0, -0.03, 0.03], ids=["good laser", "reads short", "reads long"])
def test_scans_tell_a_world_made_from_the_map_from_the_room_that_was_mapped(
    pixels: Arena, bias: float
) -> None:
    found, notes = chosen(pixels, noisy(scanned(pixels), min(bias, 0.0)))
    assert found.is_drawn and notes["walls_at_cell_borders"]
    found, notes = chosen(pixels, noisy(scanned(polygon_arena(ROOM, BOX)), bias))
    assert not found.is_drawn and not notes["walls_at_cell_borders"]


def test_outlines_of_the_cells_are_the_map_as_drawn_and_objects_keep_their_names(pixels: Arena) -> None:
    drawn = RasterMap.of(pixels).as_drawn()
    lasers = laser_poses(scanned(pixels).poses, ROBOT.sensor.mount)
    args = lasers, ROBOT.sensor.bearings, ROBOT.sensor.range_max
    np.testing.assert_allclose(cast_laser(drawn.arena.walls, *args)[0], cast_laser(pixels.walls, *args)[0])
    parts = [name.split("/")[0] for name in drawn.arena.names]
    assert parts[0] == "outline" and parts == sorted(parts) and "thing_1" in parts
    middles = drawn.arena.walls.mean(axis=1)[np.array(parts) == "thing_1"]
    assert (np.ptp(middles, axis=0) < 1.0 + 4 * PIXEL).all()


def test_nothing_is_found_in_a_world_made_from_the_map(pixels: Arena) -> None:
    found = diagnose(noisy(scanned(pixels)), pixels, ROBOT, plan_next=False)
    assert not found.effects and found.unknown is None
