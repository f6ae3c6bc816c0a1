"""RangeSensor, Run and pair: what they refuse, and that pairing is interpolation that never guesses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from logs_samples import some_run

from logs import OccupancyMap, RangeSensor, Run, pair


def run_of(stamps: list[float], pose_stamps: list[float], poses: np.ndarray) -> Run:
    return Run(
        sensor=RangeSensor(bearings=np.zeros(1)),
        stamps=np.array(stamps),
        ranges=np.ones((len(stamps), 1)),
        pose_stamps=np.array(pose_stamps),
        poses=poses,
    )


@given(
    steps=st.lists(st.floats(0.01, 0.19), min_size=1, max_size=30),
    scans=st.lists(st.floats(-1.0, 7.0), min_size=1, max_size=30),
    seed=st.integers(0, 2**16),
)
def test_pair_equals_numpy_interpolation_inside_and_nothing_outside(
    steps: list[float], scans: list[float], seed: int
) -> None:
    pose_stamps = np.concatenate([[0.0], np.cumsum(steps)])
    phi = np.cumsum(
        np.random.default_rng(seed).uniform(-3.0, 3.0, len(pose_stamps))
    )  # never half a turn a step
    poses = np.column_stack([np.sin(pose_stamps), pose_stamps**2, phi])
    stamps = np.sort(scans)
    pairing = pair(run_of(stamps.tolist(), pose_stamps.tolist(), poses))
    inside = (stamps >= pose_stamps[0]) & (stamps <= pose_stamps[-1])
    np.testing.assert_array_equal(pairing.paired, inside)
    assert np.isnan(pairing.poses[~inside]).all()
    for column in range(2):
        want = np.interp(stamps[inside], pose_stamps, poses[:, column])
        np.testing.assert_allclose(pairing.poses[inside, column], want, atol=1e-9)  # float64 at 40 m
    want = np.interp(stamps[inside], pose_stamps, phi)
    off = np.angle(np.exp(1j * (pairing.poses[inside, 2] - want)))
    np.testing.assert_allclose(off, 0, atol=1e-9)
    assert sum(pairing.dropped.values()) + pairing.paired.sum() == len(stamps)


def test_pair_goes_the_short_way_through_half_a_turn() -> None:
    poses = np.array([[0, 0, np.pi - 0.1], [0, 0, -np.pi + 0.3]])
    pairing = pair(run_of([0.05], [0.0, 0.1], poses))
    assert pairing.poses[0, 2] == pytest.approx(-np.pi + 0.1)


def test_pair_never_bridges_a_gap_but_takes_a_pose_of_the_same_stamp() -> None:
    poses = np.zeros((3, 3))
    pairing = pair(run_of([0.0, 0.5, 1.0, 1.05], [0.0, 1.0, 1.1], poses), max_gap=0.2)
    assert pairing.paired.tolist() == [True, False, True, True]
    assert str(pairing) == "3 of 4 scans paired with poses, 1 in a gap of the poses above 0.2 s"


def test_pair_drops_scans_at_poses_that_are_not_finite() -> None:
    poses = np.zeros((3, 3))
    poses[1, 0] = np.nan
    pairing = pair(run_of([0.0, 0.05, 0.2], [0.0, 0.1, 0.2], poses))
    assert pairing.paired.tolist() == [True, False, True]
    assert pairing.dropped == {"at a pose that is not finite": 1}


def test_pair_says_that_there_is_no_pose() -> None:
    pairing = pair(run_of([0.0, 0.1], [], np.zeros((0, 3))))
    assert not pairing.paired.any()
    assert pairing.dropped == {"without any pose": 2}


def test_pair_takes_poses_with_duplicated_stamps() -> None:
    pairing = pair(run_of([0.1], [0.0, 0.1, 0.1, 0.2], np.arange(12.0).reshape(4, 3)))
    assert pairing.paired.all()
    assert np.isfinite(pairing.poses).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"ranges": np.zeros((3, 2))}, "ranges has shape"),
        ({"stamps": np.arange(40.0)[::-1]}, "goes back in time"),
        ({"stamps": np.full(40, np.nan)}, "is not finite"),
        ({"poses": np.zeros((3, 2))}, "poses has shape"),
        ({"poses": None}, "poses of type NoneType holds no real numbers"),
    ],
)
def test_run_refuses_arrays_that_do_not_fit(change: dict[str, np.ndarray], words: str) -> None:
    run = some_run()
    fields = {name: getattr(run, name) for name in ("sensor", "stamps", "ranges", "pose_stamps", "poses")}
    with pytest.raises(ValueError, match=words):
        Run(**{**fields, **change})


def test_sensor_refuses_bearings_that_do_not_increase() -> None:
    with pytest.raises(ValueError, match="increasing"):
        RangeSensor(bearings=np.array([0.0, 0.0]))
    with pytest.raises(ValueError, match=r"from 0.5 to -1 rad at ray 1, .* reverse bearings and ranges"):
        RangeSensor(bearings=np.array([0.0, 0.5, -1.0]))
    with pytest.raises(ValueError, match="min < max"):
        RangeSensor(bearings=np.zeros(1), range_min=1.0, range_max=1.0)


def test_runs_and_sensors_take_lists() -> None:
    sensor = RangeSensor(bearings=[-1, 0, 1], mount=(0.1, 0, 0))  # type: ignore[arg-type]
    run = Run(sensor=sensor, stamps=[0, 1], ranges=[[1, 2, 3]] * 2, pose_stamps=[0], poses=[[0, 0, 0]])  # type: ignore[arg-type]
    for array in (sensor.bearings, sensor.mount, run.stamps, run.ranges, run.poses):
        assert array.dtype == np.float64
    assert run.ray_poses(1).shape == (3, 3)
    for call in (lambda: RangeSensor(bearings=None), lambda: RangeSensor(bearings=[0.0], mount="front")):  # type: ignore[arg-type]
        with pytest.raises(
            ValueError, match=r"(bearings of type NoneType|mount of type str) holds no real numbers"
        ):
            call()


@pytest.mark.parametrize(
    ("scan", "kind"),
    [
        (None, ValueError),
        ("3", ValueError),
        (3.0, ValueError),
        (True, ValueError),
        ([3], ValueError),
        (99, IndexError),
    ],
)
def test_a_scan_is_chosen_by_its_index(scan: Any, kind: type[Exception]) -> None:
    run = some_run()
    with pytest.raises(
        kind, match=r"scan (99 does not exist; this run has|is of type \w+, expected a whole number)"
    ):
        run.ray_poses(scan)
    if scan is not None:
        with pytest.raises(kind, match=r"^scan "):
            run.plot(scan)
    np.testing.assert_array_equal(run.ray_poses(-1), run.ray_poses(np.int64(run.n_scans - 1)))  # type: ignore[arg-type]


@pytest.mark.parametrize("stamps", [None, "one", np.datetime64(1, "s"), 1j, [1.0, "a"]])
def test_times_of_poses_are_numbers(stamps: Any) -> None:
    with pytest.raises(ValueError, match=r"^stamps of type \w+ holds no real numbers"):
        some_run().poses_at(stamps)
    assert some_run().poses_at([1, 2]).shape == (2, 3)


def test_occupancy_refuses_what_is_no_map() -> None:
    with pytest.raises(ValueError, match="int8"):
        OccupancyMap(data=np.zeros((2, 2)), resolution=0.1, origin=np.zeros(3))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="positive"):
        OccupancyMap(data=np.zeros((2, 2), dtype=np.int8), resolution=0.0, origin=np.zeros(3))


def test_repr_says_in_three_lines_what_a_run_holds() -> None:
    run = Run(
        sensor=RangeSensor(bearings=np.linspace(-1.0, 1.0, 5)),
        stamps=np.array([0.5, 1.5]),
        ranges=np.ones((2, 5)),
        pose_stamps=np.array([0.0, 2.0]),
        poses=np.zeros((2, 3)),
        meta={"source": "lab.mcap", "pose_source": "/pose"},
    )
    first, second, third = repr(run).splitlines()
    assert first == "Run of lab.mcap: 2 scans of 5 rays, 2.0 s"
    assert second == "  rays from -57.3 to 57.3 deg, 0.05 to 8 m"
    assert third == "  2 poses of base_link from /pose"
    bare = Run(sensor=run.sensor, stamps=np.zeros(0), ranges=np.zeros((0, 5)))
    assert bare.duration == 0.0 and "no poses" in repr(bare)


def test_a_sensor_of_some_rays_keeps_their_origins_and_cones() -> None:
    bearings = np.linspace(-1.0, 1.0, 5)
    ring = RangeSensor(bearings=bearings, origins=np.stack([bearings, bearings], axis=1), cones=bearings**2)
    some = ring.take(np.array([1, 3]))
    np.testing.assert_array_equal(some.origins[:, 0], some.bearings)
    np.testing.assert_array_equal(some.cones, some.bearings**2)
    plain = RangeSensor(bearings=bearings).take(slice(0, 2))
    assert plain.n_rays == 2 and plain.origins.shape == (0, 2) and plain.cones.shape == (0,)
