"""Changes of a building, and the offset of the ranges, by one located run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from localization_samples import ROOM, looking_about, room_run

import sensorgraph as sg
from sensorgraph.surveying.building import changed_places


def test_a_located_pose_does_not_absorb_an_offset_of_the_ranges() -> None:
    """A laser that looks ahead and measures 8.7 cm too long seems to stand 11 cm further back."""
    run = sg.record(sg.plan("square", views=4))
    arena = sg.load_arena("square")
    phi = run.poses[:, 2]
    back = run.poses - 0.11 * np.column_stack([np.cos(phi), np.sin(phi), np.zeros(len(phi))])
    for poses, offset in ((run.poses, 0.0), (back, 0.087)):
        worn = replace(run, ranges=run.ranges + offset, poses=poses)
        found = changed_places(worn, arena.walls).offset
        assert found is not None
        assert abs(found[0] - offset) < max(4 * found[1], 0.004)


def test_a_thing_that_was_taken_away_is_gone_and_the_edges_of_others_are_not() -> None:
    """With poses that are 1 cm off, rays pass the edges of a box that the map predicts."""
    poses = looking_about(np.arange(0.0, 40.0, 0.2))
    run = room_run(poses, n_rays=180)
    off = 0.01 * np.random.default_rng(0).standard_normal(poses.shape)
    run = replace(run, pose_stamps=run.stamps, poses=poses + off)
    room = np.array(ROOM).reshape(-1, 2, 2)
    assert len(changed_places(run, room).gone) == 0
    box = np.array([(6.0, 1.0, 6.5, 1.0), (6.5, 1.0, 6.5, 1.5), (6.5, 1.5, 6.0, 1.5), (6.0, 1.5, 6.0, 1.0)])
    gone = changed_places(run, np.concatenate([room, box.reshape(-1, 2, 2)])).gone
    assert len(gone) and np.abs(gone - [6.25, 1.25]).max() < 0.5
