"""A review holds what it says it shows, without a viewer; the recording is whole and the same every time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from logs.run import RangeSensor, Run
from logs.transforms import compose
from planners.arena import Arena
from planners.coverage import HEADINGS
from sensorgraph.building.build import build
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.show.review import maps
from sensorgraph.show.review.cells import RayCounts
from sensorgraph.show.review.contents import RayVerdict, Review, collect
from sensorgraph.show.review.report import report
from sensorgraph.show.review.review import review
from sensorgraph.show.review.views import intensity_points, write
from sensorgraph.types import Progress
from sensorgraph.world.raycast import cast

pytestmark = pytest.mark.usefixtures("trusted_scans")


@pytest.fixture(scope="module")
def run(room: Arena, sensor: RangeSensor) -> Run:
    rng = np.random.default_rng(0)
    poses = rng.uniform([0.4, 0.4, -np.pi], [2.2, 2.6, np.pi], (400, 3))
    stamps = 0.1 * np.arange(400)
    ranges = cast(room, poses, sensor).ranges + 0.01 * rng.normal(size=(400, sensor.n_rays))
    ranges[3, 5] = np.inf
    return Run(
        sensor=sensor,
        stamps=stamps,
        ranges=ranges,
        pose_stamps=stamps,
        poses=poses,
        meta={"source": "x/lab.mcap"},
    )


@pytest.fixture(scope="module")
def graph(run: Run) -> Sensorgraph:
    return build([run], split="every10", model="polynomial", degree=2, harmonics=3)


@pytest.fixture(scope="module")
def seen(run: Run, graph: Sensorgraph, room: Arena) -> Review:
    return collect(run, graph=graph, arena=room)


def test_every_paired_scan_falls_in_one_cell(run: Run, seen: Review) -> None:
    assert seen.cells.counts.sum() == run.n_scans
    assert seen.cells.error is not None
    assert (np.isfinite(seen.cells.error) <= (seen.cells.counts > 0)).all()


def test_cells_are_those_of_a_plain_count(run: Run, seen: Review) -> None:
    width, (x0, y0) = seen.cells.cell, seen.cells.origin
    for pose in run.poses[:50]:
        i, j = int((pose[0] - x0) // width), int((pose[1] - y0) // width)
        k = round(pose[2] / (2 * np.pi / HEADINGS)) % HEADINGS
        assert seen.cells.counts[i, j, k] > 0


def test_every_scored_ray_is_counted_once_and_shares_are_those_of_the_evaluation(seen: Review) -> None:
    counts, found = seen.cells.ray_counts, seen.evaluation
    assert counts is not None and found is not None
    assert counts.scored.sum() == found.n_rays
    assert counts.answered.sum() / counts.scored.sum() == pytest.approx(found.answered)
    assert counts.wrong.sum() / counts.answered.sum() == pytest.approx(found.answered_only["wrong_5cm"])
    verdicts = seen.verdicts
    assert (verdicts == RayVerdict.UNANSWERED).sum() == (counts.scored - counts.answered).sum()
    assert (verdicts == RayVerdict.WRONG).sum() == counts.wrong.sum()
    assert verdicts[3, 5] == RayVerdict.UNSCORED  # no return there
    assert (verdicts == RayVerdict.RIGHT).any()


def test_where_nobody_looked_is_not_answered_and_where_walls_moved_is_wrong(room: Arena, run: Run) -> None:
    west = run.poses[:, 0] < 1.0
    known = build(
        [replace(run, stamps=run.stamps[west], ranges=run.ranges[west])], model="polynomial", degree=1
    )
    cells = collect(run, graph=known, arena=room).cells
    assert cells.ray_counts is not None and cells.expected_error_map is not None
    dark = cells.ray_counts.by_place.share_unanswered
    column = int((1.9 - cells.origin[0]) / cells.cell)
    assert np.nanmin(dark[column:]) == 1.0
    assert np.nanmin(dark[: int((0.8 - cells.origin[0]) / cells.cell)]) < 0.1
    (x, _, area), *_ = cells.expected_error_map.places()
    assert x > 1.0
    assert area > 0.5
    moved = collect(replace(run, ranges=run.ranges + 1.0), graph=known, arena=room).cells.ray_counts
    assert moved is not None
    assert np.array_equal(np.isnan(moved.share_wrong), np.isnan(cells.ray_counts.share_wrong))
    assert moved.wrong.sum() > 0.5 * moved.answered.sum()


def test_right_wrong_unanswered_free_and_unknown_cells_have_five_colours() -> None:
    counts = RayCounts(
        scored=np.array([100, 100, 100, 0, 0]),
        answered=np.array([100, 100, 0, 0, 0]),
        wrong=np.array([0, 100, 0, 0, 0]),
    )
    free = np.array([True, True, True, True, False])
    rgb = maps.verdict_colours(counts, counts.saturating_wrong, free & (counts.scored == 0))
    named = [
        *(maps.VERDICT_COLOURS[v] for v in (RayVerdict.RIGHT, RayVerdict.WRONG, RayVerdict.UNANSWERED)),
        maps.FREE,
        maps.EMPTY,
    ]
    assert [tuple(colour) for colour in rgb.tolist()] == named
    apart = np.abs(np.diff(np.array(named)[:, None] - np.array(named), axis=1))
    assert apart.max(axis=-1).min() > 20


def test_without_a_map_free_is_where_rays_went_through(room: Arena, run: Run, graph: Sensorgraph) -> None:
    cells = collect(run, graph=graph).cells
    middles = cells.origin + (np.argwhere(cells.free) + 0.5) * cells.cell
    assert room.contains(middles).all()  # neither in the pillar nor beyond the walls
    assert len(middles) * cells.cell**2 == pytest.approx(4 * 3 - 0.5**2)  # all of the floor


def test_end_points_lie_on_the_walls(room: Arena, seen: Review) -> None:
    points = np.concatenate(seen.points(seen.measured))
    a, d = room.walls[:, 0], room.walls[:, 1] - room.walls[:, 0]
    share = np.clip(((points[:, None] - a) * d).sum(-1) / (d * d).sum(-1), 0, 1)
    off = np.linalg.norm(points[:, None] - a - share[..., None] * d, axis=-1).min(axis=1)
    assert off.max() < 0.06  # noise of 1 cm


def test_the_report_counts_on_held_out_scans(seen: Review) -> None:
    text = report(seen)
    assert "lab.mcap" in text
    assert "400 of 400 scans paired" in text
    assert "Scored on the scans held out of the build (every10)" in text
    assert seen.held_out is not None
    assert f"{100 * seen.held_out.all['median_m']:.3g} cm" in text


def test_the_report_says_when_a_graph_was_fitted_to_what_it_is_scored_on(run: Run) -> None:
    own = collect(run, graph=build([run], model="polynomial", degree=2, harmonics=2))
    assert "built from this run" in report(own)
    other = replace(run, ranges=run.ranges + 0.01)
    assert "not used to build the graph" in report(
        collect(other, graph=build([run], model="polynomial", degree=2, harmonics=2))
    )


def test_a_long_run_is_thinned_evenly_and_says_so(run: Run, graph: Sensorgraph) -> None:
    few = collect(run, graph=graph, max_scans=50)
    assert len(few.shown) == 50
    assert np.ptp(np.diff(few.shown)) <= 1
    assert few.cells.counts.sum() == run.n_scans
    assert "Shown: 50 scans, evenly spaced" in report(few)


def test_a_run_without_poses_is_refused(run: Run) -> None:
    with pytest.raises(SensorgraphError, match="0 of 400 scans paired"):
        collect(replace(run, pose_stamps=np.zeros(0), poses=np.zeros((0, 3))))


@pytest.mark.parametrize("with_graph", [True, False])
def test_the_recording_holds_scans_maps_cells_and_report(
    run: Run, seen: Review, room: Arena, tmp_path: Path, with_graph: bool
) -> None:
    path = tmp_path / "review.rrd"
    write(seen if with_graph else collect(run, arena=room), path)
    store = rr.chunk.RrdReader(str(path)).store()
    columns = {str(c) for c in store.schema().component_columns()}
    expected = {"plan/measured", "plan/robot", "plan/coverage/image", "space/cells", "ray/measured", "report"}
    if with_graph:
        expected |= {f"plan/{name}/image" for name in ("verdict", "next", "unanswered", "wrong", "error")}
        expected |= {"plan/predicted", "plan/right", "plan/wrong", "plan/not_answered"}
        expected |= {"ray/predicted", "error_per_ray"}
    for entity in expected:
        assert any(f"/{entity}" in column for column in columns), entity
    rows = sum(
        chunk.to_record_batch().num_rows
        for chunk in rr.chunk.RrdReader(str(path)).stream().filter(content="/plan/measured").to_chunks()
        if not chunk.is_static
    )
    assert rows == 400
    assert len(rr.chunk.RrdReader(str(path)).blueprints()) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["review.rrd"]


def test_intensities_are_drawn_where_their_returns_are(run: Run, room: Arena, tmp_path: Path) -> None:
    """The intensity of a return is planted as the place where it hit."""
    lasers = compose(run.poses, run.sensor.mount)
    x = lasers[:, :1] + run.ranges * np.cos(lasers[:, 2:] + run.sensor.bearings)
    known = collect(replace(run, intensities=100 + np.where(np.isfinite(x), x, np.nan)), arena=room)
    points, values = intensity_points(known)
    assert len(points) == np.isfinite(run.ranges).sum()
    np.testing.assert_allclose(values, 100 + points[:, 0], atol=1e-9)
    write(known, tmp_path / "bright.rrd")
    store = rr.chunk.RrdReader(str(tmp_path / "bright.rrd")).store()
    assert "/plan/intensity" in store.schema().entity_paths()
    write(collect(run, arena=room), tmp_path / "plain.rrd")
    store = rr.chunk.RrdReader(str(tmp_path / "plain.rrd")).store()
    assert "/plan/intensity" not in store.schema().entity_paths()


def test_every_stage_of_a_review_is_named(run: Run, graph: Sensorgraph, tmp_path: Path) -> None:
    stages: dict[str, list[tuple[int, int]]] = {}

    @contextmanager
    def bar(label: str, unit: str) -> Iterator[Progress]:
        ticks = stages.setdefault(label, [])
        yield lambda done, total: ticks.append((done, total))

    review(run, path=tmp_path / "review.rrd", graph=graph, progress=bar)
    assert list(stages) == [
        "evaluating", "evaluating held-out scans", "predicting", "counting by place and heading", "writing",
    ]  # fmt: skip
    assert stages["writing"][0] == (0, run.n_scans)


def test_colours_span_the_scale_and_no_data_is_grey() -> None:
    rgb = maps.colours(np.array([0.0, 1.0, 2.0, np.nan]))
    assert rgb.tolist() == [[68, 1, 84], [253, 231, 37], [253, 231, 37], list(maps.EMPTY)]


def test_stated_standard_deviations_are_shown_and_said(run: Run, tmp_path: Path) -> None:
    covariances = np.zeros((400, 3, 3))
    covariances[:, np.arange(3), np.arange(3)] = np.array([0.01, 0.01, 0.002]) ** 2
    short = replace(run, stamps=run.stamps[:40], ranges=run.ranges[:40], pose_covariances=covariances)
    stated = collect(short)
    assert stated.deviations is not None
    np.testing.assert_allclose(stated.deviations, np.tile([0.01, 0.01, 0.002], (40, 1)))
    assert "standard deviation 1 cm, 0.11° (median)" in report(stated)
    write(stated, tmp_path / "stated.rrd")
    paths = set(rr.chunk.RrdReader(str(tmp_path / "stated.rrd")).store().schema().entity_paths())
    assert {"/deviation/x", "/deviation/y", "/deviation/phi"} <= paths
    assert collect(replace(short, pose_covariances=np.zeros((0, 3, 3)))).deviations is None
