"""Where free space ends without a wall nothing is known, and rays that go there are not judged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from logs.run import Run
from planners.arena import Arena
from sensorgraph.diagnosis.map_changes import without_unknown_space
from sensorgraph.diagnosis.scan.fit import fit, start_state
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import prepare_scans
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.diagnosis.scan.worth import surely_stands
from sensorgraph.effects import EFFECTS
from sensorgraph.world.open_borders import open_borders
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import parse_robot

ROBOT = parse_robot("sensor: {n_rays: 181}")


def looking_about(arena: Arena) -> Run:
    """Turn in place before the pillar of the 4 x 3 m room."""
    t = 0.1 * np.arange(60)
    poses = np.column_stack([np.full(60, 1.2), np.full(60, 1.3), np.zeros(60)])
    return Run(
        sensor=ROBOT.sensor,
        stamps=t,
        ranges=cast(arena, poses, ROBOT.sensor).ranges,
        pose_stamps=t,
        poses=poses,
    )


def with_hole_in_east_wall(room: Arena) -> Arena:
    """Take the wall at x = 4 away; free space still ends there."""
    east = (room.walls[..., 0] == 4.0).all(axis=1)
    names = tuple(name for name, gone in zip(room.names, east, strict=True) if not gone)
    return replace(room, walls=room.walls[~east], names=names, surfaces=room.surfaces[: len(names)])


def test_walls_all_round_leave_nothing_unknown(room: Arena) -> None:
    data, _ = prepare_scans(looking_about(room), room, ROBOT)
    same, notes = without_unknown_space(data)
    assert len(open_borders(room)) == 0
    assert notes["into_unknown_share"] == 0.0
    np.testing.assert_array_equal(same.ranges, data.ranges)


def test_only_rays_that_leave_known_space_are_left_out(room: Arena) -> None:
    part = with_hole_in_east_wall(room)
    data, _ = prepare_scans(looking_about(room), part, ROBOT)
    judged, notes = without_unknown_space(data)
    met = cast(room, data.poses, data.sensor).wall
    east = (room.walls[met, :, 0] == 4.0).all(axis=2) & (met >= 0)
    assert 0.02 < notes["into_unknown_share"] < 0.5
    np.testing.assert_array_equal(np.isnan(judged.ranges), east & ~np.isnan(data.ranges))
    np.testing.assert_array_equal(judged.ranges[~east], data.ranges[~east])


def furnished(room: Arena, middles: list[tuple[float, float]]) -> Arena:
    """Put boxes of 0.12 m into the room, without a word in its free space."""
    corner = 0.06 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    boxes = np.concatenate([
        np.stack([middle + corner, middle + np.roll(corner, -1, axis=0)], axis=1) for middle in middles
    ])  # fmt: skip
    return replace(
        room,
        walls=np.concatenate([room.walls, boxes]),
        names=(*room.names, *(f"box_{i // 4}/edge_{i % 4}" for i in range(len(boxes)))),
        surfaces=(*room.surfaces, *["wall"] * len(boxes)),
    )


def test_more_things_than_can_be_named_have_come_with_the_building_and_few_are_effects(room: Arena) -> None:
    """The walls are of a log of another day."""
    middles = [(2.1, 0.95), (2.0, 1.75), (1.7, 2.3), (2.2, 0.45), (1.5, 0.45), (3.4, 0.6), (3.4, 2.2)]
    for n, is_judged in ((1, True), (7, False)):
        since = furnished(room, middles[:n])
        data, _ = prepare_scans(looking_about(since), room, ROBOT)
        judged, notes = without_unknown_space(data, with_changes=False)
        at_box = cast(since, data.poses, data.sensor).wall >= room.n_walls
        assert len(notes["changes"]) == (0 if is_judged else n)
        assert np.isnan(judged.ranges[at_box]).mean() == (0.0 if is_judged else pytest.approx(1.0, abs=0.1))
        assert not np.isnan(judged.ranges[~at_box]).any()
        np.testing.assert_array_equal(without_unknown_space(data)[0].ranges, data.ranges)


def test_a_wall_just_behind_the_rim_still_takes_the_ray(room: Arena) -> None:
    """A graph's free space is of cells, which end before the wall."""
    short = replace(room, free=room.free.intersection(shapely.box(0, 0, 3.92, 3)))
    assert len(open_borders(short)) == 0


def test_cells_that_no_ray_happened_to_cross_are_no_border(room: Arena) -> None:
    speckled = replace(room, free=room.free.difference(shapely.box(1.0, 2.0, 1.2, 2.2)))
    assert len(open_borders(speckled)) == 0
    large = replace(room, free=room.free.difference(shapely.box(0.8, 1.8, 1.6, 2.6)))
    assert len(open_borders(large)) == 4


def test_a_range_beyond_which_nothing_returns_is_seen_though_much_is_unknown(room: Arena) -> None:
    run = looking_about(room)
    short = replace(run, ranges=np.where(run.ranges > 2.0, np.inf, run.ranges))
    data, _ = prepare_scans(short, room, ROBOT)
    expected = cast(room, data.poses, data.sensor).ranges
    judged = replace(data, ranges=np.where(expected > 2.4, np.nan, data.ranges), memo={})
    assert (np.isnan(judged.ranges) & (expected > 2.4)).mean() > 0.1
    null = fit(judged, (), start_state(judged, NoiseBounds()), NoiseBounds())
    proposed = EFFECTS["max_range"].diagnostics.propose(FitResiduals(judged, null))
    assert proposed and proposed[0].values["R"] == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("stands", [True, False])
def test_rays_without_a_return_have_not_passed_a_thing_that_is_out_of_their_range(
    room: Arena, stands: bool
) -> None:
    robot = parse_robot("sensor: {n_rays: 181, range_max: 1.2}")
    run, (x, y, r) = looking_about(room), (3.2, 2.3, 0.1)
    poses = run.poses + np.linspace(0.0, 1.2, 60)[:, None] * np.array([1.0, 0.5, 0.0])  # towards it
    ranges = cast(room, poses, robot.sensor).ranges
    if stands:
        pillar = shapely.Point(x, y).buffer(r).exterior
        ring = np.stack([pillar.coords[:-1], pillar.coords[1:]], axis=1)
        full = replace(
            room,
            walls=np.concatenate([room.walls, ring]),
            names=(*room.names, *(f"pillar/{k}" for k in range(len(ring)))),
            surfaces=(*room.surfaces, *["wall"] * len(ring)),
        )
        ranges = cast(full, poses, robot.sensor).ranges
    run = replace(run, sensor=robot.sensor, poses=poses, ranges=np.where(ranges > 1.2, np.inf, ranges))
    data, _ = prepare_scans(run, room, robot)
    assert surely_stands(EFFECTS["unmapped_obstacle"](x=x, y=y, r=r), data) is stands
