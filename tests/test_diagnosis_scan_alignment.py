"""Whether a run and an arena belong together is asked before anything is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely.affinity
from conftest import further, polygon_arena
from scan_samples import data_of, drive

from logs.run import RangeSensor, Run
from planners.arena import Arena, wrap
from sensorgraph.diagnosis.scan.map_alignment import align, misalignment
from sensorgraph.diagnosis.scan.scan_data import prepare_scans
from sensorgraph.errors import SensorgraphError
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import default_robot, parse_robot


@pytest.mark.parametrize("turn", [0.7, *further(0.0, np.pi)])
def test_a_map_in_the_wrong_place_is_said_with_where_it_belongs(hall: Arena, turn: float) -> None:
    run = drive(hall)
    c, s = np.cos(turn), np.sin(turn)
    poses = np.column_stack(
        [c * run.poses[:, 0] - s * run.poses[:, 1] + 3.0, s * run.poses[:, 0] + c * run.poses[:, 1] - 1.5, wrap(run.poses[:, 2] + turn)]
    )  # fmt: skip
    data, _ = prepare_scans(replace(run, poses=poses), hall, parse_robot("sensor: {n_rays: 61}"))
    place = align(data, np.random.default_rng(0))
    assert not place.is_good
    assert place.best_share > 0.85
    assert abs(wrap(place.dphi + turn)) < 0.05
    there = align(data_of(hall), np.random.default_rng(0))
    assert there.is_good
    assert there.share > 0.95


@pytest.mark.parametrize(
    ("scale", "words"),
    [
        (100.0, "times as large as the place (centimetres instead of metres?):"),
        (1000.0, "(millimetres instead of metres?):"),
        (0.0254, "it is 0.0253 times as large as the place:"),
        *further(
            (3.0, "it is 2.99 times as large as the place:"),
            (1 / 0.3048, "(feet instead of metres?):"),
            (0.1, "it is 0.0996 times as large as the place:"),
        ),
    ],
)
def test_a_map_of_another_scale_or_unit_is_told_with_its_size(hall: Arena, scale: float, words: str) -> None:
    data = data_of(hall)
    large = replace(hall, walls=scale * hall.walls, free=shapely.affinity.scale(hall.free, scale, scale))
    place = align(replace(data, arena=large, memo={}), np.random.default_rng(0))
    assert not place.is_good
    assert place.scale == pytest.approx(scale, rel=0.01)
    assert words in place.sentence()
    assert place.best_share > 0.95


def test_a_part_of_a_larger_map_is_not_taken_for_one_of_another_scale(hall: Arena) -> None:
    """A run that sees a third of its map, in which furniture is missing, gets no other scale."""
    far = np.concatenate([hall.walls + [shift, 0.0] for shift in (0.0, 14.0, 28.0)])
    names = tuple(f"{part}{name}" for part in "abc" for name in hall.names)
    wide = replace(hall, walls=far, names=names, surfaces=("wall",) * len(names))
    data = data_of(hall)
    ranges = data.ranges.copy()
    ranges[:, :25] *= 0.5
    place = align(replace(data, arena=wide, ranges=ranges, memo={}), np.random.default_rng(0))
    assert 0.45 < place.share < 0.8
    assert place.is_good and place.scale == 1.0


def test_a_mirrored_laser_in_a_corridor_is_named_although_most_rays_end_at_walls() -> None:
    niches = [(0, 0), (5, 0), (5, -0.4), (6, -0.4), (6, 0), (20, 0), (20, 2), (0, 2)]
    corridor = polygon_arena(niches)
    sensor = RangeSensor(bearings=np.linspace(-np.pi, np.pi, 60, endpoint=False), range_max=12.0)
    x = np.linspace(2.0, 18.0, 60)
    poses = np.column_stack([x, 0.95 + 0.05 * np.sin(x), 0.1 * np.cos(x)])
    ranges = np.roll(cast(corridor, poses, sensor).ranges[:, ::-1], 1, axis=1)
    stamps = 0.1 * np.arange(60)
    run = Run(sensor=sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)
    data, _ = prepare_scans(run, corridor, default_robot())
    place = align(data, np.random.default_rng(0))
    assert 0.45 < place.share < 0.8
    found = misalignment(place, run, data)
    assert found is not None and "the scan fits the arena if it is mirrored" in found.statement


def test_too_few_scans_are_refused_in_one_line(hall: Arena) -> None:
    with pytest.raises(SensorgraphError, match="the run has 20 scans, expected 50"):
        data_of(hall, n=20)


def test_another_sensor_is_refused(hall: Arena) -> None:
    with pytest.raises(SensorgraphError, match=r"61 rays from .*, expected 181"):
        prepare_scans(drive(hall), hall, parse_robot("sensor: {n_rays: 181}"))


def test_a_run_in_an_arena_full_of_walls_is_of_another_place_though_rays_end_at_walls(hall: Arena) -> None:
    shelves = [
        [(x, y), (x + 0.08, y), (x + 0.08, y + 4.6), (x, y + 4.6)]
        for x, y in zip(np.arange(0.3, 5.9, 0.4), 14 * [0.2], strict=True)
    ]
    store = polygon_arena([(0, 0), (6, 0), (6, 5), (0, 5)], *shelves)
    data, _ = prepare_scans(drive(hall), store, parse_robot("sensor: {n_rays: 61}"))
    place = align(data, np.random.default_rng(0))
    assert place.share > 0.6  # by chance
    assert place.matching < 0.3 and not place.is_good
    assert "have the length that the arena predicts" in place.sentence()
    assert align(data_of(hall), np.random.default_rng(0)).matching > 0.95


def test_poses_of_another_scale_than_the_ranges_are_not_blamed_on_the_map(hall: Arena) -> None:
    run = drive(hall)
    run = replace(run, poses=run.poses * [0.93, 0.93, 1.0])
    data, _ = prepare_scans(run, hall, parse_robot("sensor: {n_rays: 61}"))
    why = misalignment(align(data, np.random.default_rng(0)), run, data)
    assert why is not None
    assert (
        "ranges 6.6 % shorter" in why.statement and "the scales of ranges and poses differ" in why.statement
    )
    assert "times as large as the place" not in why.statement
