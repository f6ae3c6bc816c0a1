"""A graph updated with a new run knows what both runs saw, without the rays of the old one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import further, polygon_arena

import logs
from logs.run import RangeSensor, Run
from planners.arena import Arena
from sensorgraph.building.build import build, can_update
from sensorgraph.cli import run as command
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.loading import load_arena
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.sufficient_statistics import SufficientStatistics, rebase_line_sums
from sensorgraph.models.residual_memory import ResidualMemory
from sensorgraph.world.raycast import cast

pytestmark = pytest.mark.usefixtures("trusted_scans")

BOX = [(1.0, 1.0), (1.4, 1.0), (1.4, 1.4), (1.0, 1.4)]
FEW_RAYS = RangeSensor(
    bearings=np.linspace(-np.pi / 2, np.pi / 2, 21), range_max=8.0, mount=np.array([0.1, 0.02, 0.01])
)
"""Cells take a time that grows with the number of readings."""


def drive(arena: Arena, sensor: RangeSensor, n: int, seed: int, x: tuple[float, float] = (0.2, 3.8)) -> Run:
    """Return n scans from poses in a part of an arena, with 1 cm of noise."""
    rng = np.random.default_rng(seed)
    poses = rng.uniform([x[0], 0.2, -np.pi], [x[1], 2.8, np.pi], (6 * n, 3))
    poses = poses[arena.contains(poses[:, :2])][:n]
    ranges = cast(arena, poses, sensor).ranges
    stamps = np.arange(len(poses)) / 10
    ranges = ranges + 0.01 * rng.normal(size=ranges.shape)
    return Run(sensor=sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)


def truth(arena: Arena, sensor: RangeSensor, n: int = 600) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(77)
    poses = rng.uniform([0.2, 0.2, -np.pi], [3.8, 2.8, np.pi], (3 * n, 3))
    poses = poses[arena.contains(poses[:, :2])][:n]
    return poses, cast(arena, poses, sensor).ranges


def off(graph: Sensorgraph, poses: np.ndarray, ranges: np.ndarray) -> np.ndarray:
    return np.abs(graph.predict(poses).mode - ranges)


@pytest.fixture(scope="module")
def first(room: Arena, sensor: RangeSensor) -> Sensorgraph:
    return build([drive(room, sensor, 300, 1)], names=["first"], calibrate=False)


def test_sums_about_a_moved_line_are_those_taken_there() -> None:
    rng = np.random.default_rng(4)
    points = np.array([3.0, -2.0]) + rng.normal(size=(50, 2))
    weights = rng.uniform(1, 2, 50)

    def face(angle: float, d: float) -> FaceSet:
        one = np.zeros(1)
        return FaceSet(
            np.array([[np.cos(angle), np.sin(angle)]]), np.array([d]), np.array([0, 1]), one, one, one,
            np.array([-1]),
        )  # fmt: skip

    def sums(at: FaceSet) -> np.ndarray:
        s, e = points @ at.tangents[0], points @ at.normals[0] - at.offsets[0]
        w = weights
        rows = [w, w * s, w * s * s, w * e, w * s * e, np.full(50, 1.0), w * e * e, np.full(50, 0.5)]
        return np.array([[row.sum() for row in rows]])

    a, b = face(0.3, 1.2), face(0.34, 1.1)
    np.testing.assert_allclose(rebase_line_sums(sums(a), a, b), sums(b), rtol=1e-9)


def test_more_of_the_same_makes_it_better(first: Sensorgraph, room: Arena, sensor: RangeSensor) -> None:
    more = build([drive(room, sensor, 1500, 2)], names=["more"], update=first)
    poses, ranges = truth(room, sensor)
    before, after = off(first, poses, ranges), off(more, poses, ranges)
    assert np.median(after) < 0.75 * np.median(before)
    assert (after > 0.05).mean() <= (before > 0.05).mean()
    assert more.model.hits.sum() == pytest.approx(1800 * 61, rel=0.02)
    assert [entry["name"] for entry in more.origin["inputs"]] == ["first", "more"]


def test_a_part_never_seen_is_added(room: Arena, sensor: RangeSensor) -> None:
    west, east = (drive(room, sensor, 400, seed, x) for seed, x in ((1, (0.2, 2.3)), (2, (3.1, 3.8))))
    old = build([west], calibrate=False)
    new = build([east], update=old)
    whole = build([west, east], calibrate=False)
    poses, ranges = truth(room, sensor)
    wrong = [(off(graph, poses, ranges) > 0.05).mean() for graph in (old, new, whole)]
    assert wrong[0] > 0.01
    assert wrong[1] < max(2 * wrong[2], 0.004)
    answered = [graph.predict(poses).answered.mean() for graph in (old, new, whole)]
    assert answered[0] < answered[1] == pytest.approx(answered[2], abs=0.01)


@pytest.mark.slow
def test_noise_of_the_new_poses_adds_no_surfaces(sensor: RangeSensor) -> None:
    """Poses of the new run are refined as those of the first, so that an update equals a fit of both runs."""
    square, runs = load_arena("square"), []
    for seed in (1, 2):
        run = drive(square, sensor, 1200, seed)
        noise = 0.003 * np.random.default_rng(50 + seed).normal(size=run.poses.shape)  # [m, m, rad]
        runs.append(replace(run, poses=run.poses + noise))
    updated, whole = build(runs[1:], update=build(runs[:1])), build(runs)
    assert updated.model.faces.n_faces <= whole.model.faces.n_faces + 2
    poses, ranges = truth(square, sensor)
    wrong = [(off(graph, poses, ranges) > 0.05).mean() for graph in (updated, whole)]
    assert wrong[0] < wrong[1] + 0.002
    answered = [graph.predict(poses).answered.mean() for graph in (updated, whole)]
    assert answered[0] > answered[1] - 0.003


def test_a_new_box_and_a_taken_one_become_likely_and_unlikely(sensor: RangeSensor) -> None:
    outer = [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0)]
    empty, full = polygon_arena(outer), polygon_arena(outer, BOX)
    pose = np.array([[2.4, 1.2, np.pi]])  # looks at the box's right side, 1 m ahead less the mount
    middle = [30]
    bare, boxed = (build([drive(a, sensor, 60, 5)], calibrate=False) for a in (empty, full))
    near, far = (graph.predict(pose, rays=middle).mode[0, 0] for graph in (boxed, bare))
    assert near == pytest.approx(0.9, abs=0.03) and far == pytest.approx(2.3, abs=0.03)
    put = build([drive(full, sensor, 1500, 6)], update=bare)
    taken = build([drive(empty, sensor, 1500, 7)], update=boxed)
    assert put.predict(pose, rays=middle).mode[0, 0] == pytest.approx(near, abs=0.03)
    assert taken.predict(pose, rays=middle).mode[0, 0] == pytest.approx(far, abs=0.03)


def test_an_updated_graph_survives_its_file(
    first: Sensorgraph, room: Arena, sensor: RangeSensor, tmp_path: Path
) -> None:
    run = drive(room, sensor, 300, 3)
    for name in "ab":
        build([run], update=first, names=["b"]).save(tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    Sensorgraph.load(tmp_path / "a").save(tmp_path / "c")
    assert (tmp_path / "c").read_bytes() == (tmp_path / "a").read_bytes()
    assert (tmp_path / "a").stat().st_size < 100_000


def test_update_on_the_command_line(
    first: Sensorgraph, room: Arena, sensor: RangeSensor, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first.save(tmp_path / "g.sensorgraph")
    logs.write(drive(room, sensor, 300, 3), tmp_path / "second.mcap")
    words = ["build", str(tmp_path / "second.mcap"), "--update", str(tmp_path / "g.sensorgraph")]
    assert command([*words, "-o", str(tmp_path / "h.sensorgraph")]) == 0
    assert "300 fitted" in capsys.readouterr().out
    again = [*words[:3], str(tmp_path / "h.sensorgraph"), "-o", str(tmp_path / "i.sensorgraph")]
    assert command(again) == 2
    (line,) = [line for line in capsys.readouterr().err.strip().splitlines() if line.startswith("error")]
    assert "second.mcap is part of the graph already" in line
    assert command([*words, "--model", "cells", "-o", str(tmp_path / "i.sensorgraph")]) == 2
    assert not (tmp_path / "i.sensorgraph").exists()


def test_what_cannot_be_updated_is_said(first: Sensorgraph, room: Arena, sensor: RangeSensor) -> None:
    run = drive(room, sensor, 60, 3)
    plain = build([run], model="polynomial", degree=1, harmonics=1)
    with pytest.raises(SensorgraphError, match="this one is of polynomial"):
        build([run], update=plain)
    with pytest.raises(SensorgraphError, match="update it with the same"):
        build([run], update=first, split="every10")
    other = RangeSensor(bearings=np.linspace(-1, 1, 9), mount=sensor.mount)
    with pytest.raises(SensorgraphError, match="9 rays at other bearings than the 61"):
        build([drive(room, other, 60, 3)], update=first)


def sweeping(run: Run) -> Run:
    """Return the run of a laser that turns during the drive, with odd readings."""
    ranges = run.ranges.copy()
    ranges[::7, 3], ranges[::5, 8], ranges[::6, 20] = np.inf, -np.inf, np.nan
    return replace(run, sensor=replace(run.sensor, sweep_time=0.08), ranges=ranges)


@pytest.mark.parametrize("sweeps", [True, *further(False)])
def test_cells_of_an_update_are_those_of_all_runs(sweeps: bool, room: Arena, tmp_path: Path) -> None:
    runs = [drive(room, FEW_RAYS, 30, seed) for seed in (1, 2)]
    runs = [sweeping(run) for run in runs] if sweeps else runs
    whole, first = build(runs, model="cells", cell=0.2), build(runs[:1], model="cells", cell=0.2)
    assert can_update(first)
    first.save(tmp_path / "first")
    updated = build(runs[1:], update=Sensorgraph.load(tmp_path / "first"))
    (header, arrays), (expected, wanted) = updated.model.state(), whole.model.state()
    assert header == expected
    for name in wanted:
        np.testing.assert_array_equal(arrays[name], wanted[name], err_msg=name)


def test_a_graph_without_sums_for_growing_noise_is_updated(
    first: Sensorgraph, room: Arena, sensor: RangeSensor
) -> None:
    """Graphs of 0.2.0 and before have sums for three kinds of noise."""
    model = first.model
    arrays = model.statistics.arrays()
    arrays["spread"] = arrays["spread"][:3, [0, 1, 2, 4]]
    statistics = SufficientStatistics.from_arrays(arrays, model.faces)
    again = drive(room, sensor, 300, 2)
    of_old, of_new = (
        build([again], update=replace(first, model=replace(model, statistics=one))).model
        for one in (statistics, model.statistics)
    )
    assert of_old.noise.sigma == pytest.approx(of_new.noise.sigma, rel=0.02)
    np.testing.assert_allclose(of_old.faces.offsets, of_new.faces.offsets, atol=1e-3)


@pytest.mark.parametrize("others", ["old", *further("old and whole")])
def test_faces_with_cells_are_updated_together(
    room: Arena, others: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sensorgraph.models.cells.model.CELL_SIZE", 0.1)
    west, east = (drive(room, FEW_RAYS, 30, seed, x) for seed, x in ((1, (0.2, 2.3)), (2, (3.1, 3.8))))
    old = build([west], calibrate=False, cells=True)
    new = build([east], update=old)
    assert new.model.faces.n_faces > old.model.faces.n_faces or new.model.hits.sum() > old.model.hits.sum()
    assert new.model.cells.counts["scans"] == 60
    poses, ranges = truth(room, FEW_RAYS, 300)
    wrong = [(off(graph, poses, ranges) > 0.1).mean() for graph in (old, new)]
    assert wrong[1] < wrong[0]
    if others == "old and whole":
        whole = build([west, east], calibrate=False, cells=True)
        assert wrong[1] == pytest.approx((off(whole, poses, ranges) > 0.1).mean(), abs=0.003)
    with pytest.raises(SensorgraphError, match="part of the graph already"):
        build([east], update=new)


def test_an_update_keeps_the_memory_or_identifies_it_anew(
    first: Sensorgraph, room: Arena, sensor: RangeSensor
) -> None:
    shares = np.full((2, 2), 0.1)
    known = ResidualMemory(
        sizes=np.array([0.1, 0.2]), lifetimes=np.array([10.0]), events=shares, noise=shares
    )
    again = drive(room, sensor, 230, 2)
    graph = replace(first, memory=known)
    assert build([again], names=["again"], update=graph).memory is known
    anew = build([again], names=["again"], update=graph, memory=True).memory
    assert anew is not None and anew.noise.sum() < 0.2  # the walls are where they are
