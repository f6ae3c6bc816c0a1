"""Locating a run in a known place: planted poses come back, with the right doubt."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
import shapely
from conftest import further
from localization_samples import ROOM, any_times, loop_poses, room_run

from logs.run import Run
from logs.transforms import compose
from sensorgraph.building.build import build
from sensorgraph.errors import SensorgraphError
from sensorgraph.localization.branch_and_bound import SearchWindow
from sensorgraph.localization.global_search import GlobalPlaces, find_places, local_view
from sensorgraph.localization.graph_walls import seen_by_graph, walls_of_graph
from sensorgraph.localization.in_map import locate_in_map
from sensorgraph.localization.known_map import known_map
from sensorgraph.localization.map_check import best_fit, looks
from sensorgraph.localization.map_tracking import min_fit_of
from sensorgraph.localization.scans import scan_points
from sensorgraph.localization.settings import GLOBAL_SEARCH, MAP_TRACKING
from sensorgraph.models.seen_space import SeenSpace
from sensorgraph.types import Progress

FREE = shapely.Polygon([wall[:2] for wall in ROOM[:10]], [[wall[:2] for wall in ROOM[10:]]])
WALLS = np.array(ROOM).reshape(-1, 2, 2)
TRUTH = loop_poses(120)


def errors(poses: np.ndarray, truth: np.ndarray) -> np.ndarray:
    off = poses - truth
    off[:, 2] = np.angle(np.exp(1j * off[:, 2]))
    return np.abs(off)


def test_run_is_found_without_a_guess_and_followed_within_a_centimetre() -> None:
    run = room_run(TRUTH, way_scale=0.97, heading_bias=0.05)
    found = locate_in_map(run, WALLS)
    off = errors(found.poses, TRUTH)
    assert set(found.status) == {"ok"}
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.015 and off[:, 2].max() < np.radians(0.5)
    assert found.wheels is not None
    assert found.wheels.way_scale == pytest.approx(1 / 0.97, abs=0.01)
    sd = np.sqrt(np.diagonal(found.covariances, axis1=1, axis2=2))
    assert (off < 3 * sd).mean() > 0.95


def after(run: Run, other: Run) -> Run:
    """Join two runs of one robot: the odometry goes on as if nothing had happened."""
    stamps = np.concatenate([run.stamps, run.stamps[-1] + 0.2 + other.stamps])
    odometry = np.concatenate([run.odometry, compose(run.odometry[-1], other.odometry)])
    return replace(
        run,
        stamps=stamps,
        ranges=np.concatenate([run.ranges, other.ranges]),
        odom_stamps=stamps,
        odometry=odometry,
        odom_twists=np.zeros((len(stamps), 2)),
    )


@any_times
def test_robot_carried_elsewhere_is_lost_at_once_or_found_again_and_never_wrong(
    times: Callable[[Run], Run],
) -> None:
    elsewhere = np.column_stack([np.linspace(5.2, 7.2, 40), np.full(40, 1.1), np.full(40, 0.1)])
    truth = np.concatenate([TRUTH[:60], elsewhere])
    found = locate_in_map(times(after(room_run(TRUTH[:60]), room_run(elsewhere, seed=1))), WALLS)
    ok = np.array(found.status) == "ok"
    off = errors(found.poses, truth)
    assert np.hypot(off[ok, 0], off[ok, 1]).max() < 0.03
    again = found.t[ok & (np.arange(100) >= 60)]
    assert len(again) and again[0] - found.t[60] < 5.0


def test_robot_carried_into_the_twin_of_its_room_is_not_followed_in_the_old_one() -> None:
    twin = [
        (x0 + 20.0, y0, x1 + 20.0, y1) for x0, y0, x1, y1 in [*ROOM[:4], (5, 6, 0, 6), *ROOM[9:]]
    ]  # without niche
    walls = [*ROOM, *twin]
    way = np.array([[2.1, 4.4], [2.1, 1.2], [6.4, 1.2]])
    along = np.linspace(0, 2, 60)
    ahead = np.column_stack([np.interp(along, range(3), column) for column in way.T])
    one = np.column_stack([ahead, np.full(60, 0.3)])
    two = one[np.r_[[-1] * 5, -1:-61:-1]] + [20.1, 0.15, 0.15]  # the arm of the room shows no difference
    run = after(room_run(one, walls=walls), room_run(two, walls=walls, seed=1))
    truth = np.concatenate([one, two])
    found = locate_in_map(run, np.array(walls).reshape(-1, 2, 2))
    ok = np.array(found.status) == "ok"
    off = np.hypot(*errors(found.poses, truth)[:, :2].T)
    assert ok[:60].all() and off[ok].max() < 0.05
    rivals = found.rivals[60]
    assert np.hypot(*(rivals[:, :2] - truth[60, :2]).T).min() < 0.05


def test_place_that_looks_the_same_twice_is_ambiguous_and_names_the_rival() -> None:
    square = np.array([[0, 0, 4, 0], [4, 0, 4, 4], [4, 4, 0, 4], [0, 4, 0, 0]], dtype=float)
    still = np.tile([1.0, 1.5, 0.3], (6, 1))
    found = locate_in_map(room_run(still, walls=[tuple(w) for w in square]), square.reshape(-1, 2, 2))
    assert set(found.status) == {"ambiguous"}
    assert any("most scans are not located: at best, a short drive fits" in note for note in found.notes)
    rivals = next(iter(found.rivals.values()))
    assert len(rivals) == 4
    assert np.hypot(*(rivals[:, :2] - still[0, :2]).T).min() < 0.02


@any_times
def test_people_and_a_moved_table_do_not_pull(times: Callable[[Run], Run]) -> None:
    run = room_run(TRUTH[::2])
    rng = np.random.default_rng(3)
    ranges = run.ranges.copy()
    for k in range(run.n_scans):  # legs, and something wide that stands elsewhere in each scan
        near = np.roll(np.arange(120), int(rng.integers(120)))[:30]
        ranges[k, near] = np.minimum(ranges[k, near], rng.uniform(0.6, 1.2))
    found = locate_in_map(times(replace(run, ranges=ranges)), WALLS)
    off = errors(found.poses, TRUTH[::2])
    assert set(found.status) == {"ok"}
    off_place = np.hypot(off[:, 0], off[:, 1])
    assert (
        np.quantile(off_place, 0.9) < 0.015 and off_place.max() < 0.06
    )  # where legs stand just before a wall


def test_map_of_another_place_is_said_to_fit_nowhere() -> None:
    hall = np.array([[0, 0, 30, 0], [30, 0, 30, 20], [30, 20, 0, 20], [0, 20, 0, 0]], dtype=float)
    with pytest.raises(SensorgraphError, match="fit nowhere in hall"):
        locate_in_map(room_run(TRUTH[:20]), hall.reshape(-1, 2, 2), name="hall")


@pytest.mark.slow
@pytest.mark.parametrize("scale", [3.0, *further(100.0)])
def test_map_that_is_too_large_is_said_to_fit_nowhere_though_single_scans_fit_many_places(
    scale: float,
) -> None:
    with pytest.raises(SensorgraphError, match=r"fit nowhere in plan.*of another scale"):
        locate_in_map(room_run(TRUTH), scale * WALLS, name="plan")


def test_mirrored_laser_is_named() -> None:
    run = room_run(TRUTH[:20])
    with pytest.raises(SensorgraphError, match="only as seen in a mirror"):
        locate_in_map(replace(run, ranges=np.roll(run.ranges[:, ::-1], 1, axis=1)), WALLS)


@any_times
def test_run_without_odometry_is_located_by_its_scans(times: Callable[[Run], Run]) -> None:
    truth = TRUTH[:60]
    run = replace(
        room_run(truth), odom_stamps=np.zeros(0), odometry=np.zeros((0, 3)), odom_twists=np.zeros((0, 2))
    )
    found = locate_in_map(times(run), WALLS)
    off = errors(found.poses, truth)
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.02
    assert found.wheels is None and "no usable odometry" in found.notes[0]


@pytest.mark.slow
def test_run_is_located_in_a_graph_of_cells() -> None:
    run = replace(room_run(TRUTH), pose_stamps=np.arange(120) / 5, poses=TRUTH)
    graph = build([run], model="cells")
    walls, normals = walls_of_graph(graph)
    ends = WALLS[:, 1] - WALLS[:, 0]
    share = ((walls.mean(axis=1)[:, None] - WALLS[:, 0]) * ends).sum(axis=2) / (ends**2).sum(axis=1)
    nearest = WALLS[:, 0] + np.clip(share, 0, 1)[..., None] * ends
    off = np.hypot(*(walls.mean(axis=1)[:, None] - nearest).transpose(2, 0, 1)).min(axis=1)
    assert len(walls) > 300 and np.quantile(off, 0.95) < 0.02  # the noise of returns
    sided = normals.any(axis=1)
    inwards = (walls.mean(axis=1) + 0.15 * normals)[sided]
    assert sided.mean() > 0.8 and shapely.contains_xy(FREE, *inwards.T).mean() > 0.98
    found = locate_in_map(room_run(TRUTH[20:60], seed=7), walls, normals=normals)
    distance = np.hypot(*errors(found.poses, TRUTH[20:60])[:, :2].T)
    assert set(found.status) == {"ok"} and distance.max() < 0.02


def test_robot_behind_a_wall_is_not_drawn_to_the_side_that_was_mapped() -> None:
    screen = [(4.94, 0.0, 4.94, 2.2), (5.06, 2.2, 5.06, 0.0)]
    mapped = np.concatenate([WALLS, np.array(screen[:1]).reshape(-1, 2, 2)])  # its right side nobody has seen
    ahead = mapped[:, 1] - mapped[:, 0]
    normals = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.hypot(*ahead.T)[:, None]
    is_free = shapely.contains_xy(FREE, *(mapped.mean(axis=1) + 0.05 * normals).T)
    normals[:-1] *= np.where(is_free, 1.0, -1.0)[:-1, None]  # that of the screen points left
    right = np.column_stack([np.full(20, 6.3), np.linspace(1.0, 2.0, 20), np.full(20, 0.3)])
    run = room_run(right, walls=[*ROOM, *screen])
    off = [
        errors(locate_in_map(run, mapped, normals=way).poses, right)[:, 0].max() for way in (None, normals)
    ]
    assert off[0] > 0.02 > 0.005 > off[1]


def test_rays_into_space_that_nobody_mapped_do_not_count_against_a_place() -> None:
    pose = np.array([1.5, 1.0, 0.4])
    mapped = WALLS[WALLS[:, :, 0].min(axis=1) < 3.0]  # the rest of the room was never seen
    mapped = np.stack([np.minimum(mapped[..., 0], 3.0), mapped[..., 1]], axis=-1)
    seen = SeenSpace(cells=np.ones((32, 64), dtype=np.bool_), origin=np.array([-0.1, -0.1]), resolution=0.1)
    scans = scan_points(room_run(pose[None]))
    view = local_view(scans, np.array([0]), pose[None])
    one_eyed, blind = known_map(mapped, seen), known_map(mapped)
    ahead = pose[0] + np.cos(pose[2]) * view.points[:, 0] - np.sin(pose[2]) * view.points[:, 1]
    judged = one_eyed.judge(pose[None], view.points, view.starts)
    assert judged.unseen[0] == pytest.approx((ahead > 3.3).mean(), abs=0.05)
    found = find_places(view, one_eyed)
    assert len(found.rivals) == 0 and np.hypot(*(found.poses[0] - pose)[:2]) < 0.02
    assert found.fit > 0.85 > 0.75 > find_places(view, blind).fit


def test_last_scan_is_enough_where_the_map_lacks_what_the_scans_before_it_saw() -> None:
    half = known_map(WALLS[WALLS[:, :, 0].max(axis=1) <= 5.0])  # without the right arm
    poses = np.array([[6.5, 1.4, 0.2], [1.2, 4.5, 2.0]])
    scans = scan_points(room_run(poses, n_rays=360))
    both, last = (local_view(scans, chosen, poses[chosen]) for chosen in (np.array([0, 1]), np.array([1])))
    found = find_places(both, half)
    assert len(both.points) == len(last.points)
    assert np.hypot(*(found.poses[0] - poses[1])[:2]) < 0.05
    assert found.fit > 0.8 > 0.6 > found.fits[0]


def test_match_that_a_wall_behind_a_screen_holds_is_found_beside_it() -> None:
    screen = np.array([[[7.7, 0.0], [7.7, 1.6]]])
    place = known_map(np.concatenate([WALLS, screen]))
    pose = np.array([[6.4, 1.5, 0.0]])
    scans = scan_points(room_run(pose, walls=[*ROOM, (7.7, 0.0, 7.7, 1.6)]))
    window = SearchWindow.around(pose[0] + [0.3, 0.0, 0.0], half_xy=0.05, half_phi=0.02)
    found = find_places(local_view(scans, np.array([0]), pose), place, window=window)
    assert np.hypot(*(found.poses[0] - pose[0])[:2]) < 0.03 and found.hidden[0] < 0.05


def test_place_that_fits_badly_is_believed_only_where_no_other_comes_near() -> None:
    alone = GlobalPlaces(
        poses=np.array([[0.0, 0, 0], [9.0, 0, 0]]),
        probabilities=np.array([1.0, 0.0]),
        agreements=np.array([0.8, 0.4]),
        hidden=np.array([0.15, 0.25]),  # half a metre of a door that is open now
        unseen=np.zeros(2),
    )
    among_others = replace(alone, hidden=np.array([0.15, 0.1]), agreements=np.array([0.8, 0.6]))
    assert alone.lead == pytest.approx(0.6) and among_others.lead == pytest.approx(0.1)
    assert min_fit_of(alone) < alone.fit == among_others.fit < min_fit_of(among_others)
    half = replace(alone, hidden=np.array([0.15, 0.1]), agreements=np.array([0.85, 0.5]))
    assert half.lead == pytest.approx(0.25)
    assert min_fit_of(half) == pytest.approx((min_fit_of(alone) + GLOBAL_SEARCH.accept_fit) / 2)
    assert min_fit_of(replace(alone, agreements=np.array([0.65, 0.2]))) > 0.35  # no place fits so badly


def test_rays_along_a_wall_or_past_its_end_did_not_go_through_it() -> None:
    walls = np.array([[[0.0, 0.0], [4.0, 0.0]], [[6.0, -2.0], [6.0, 2.0]]])  # one along x, one beyond its end
    place = known_map(walls)
    laser = np.array([[0.5, 0.5, 0.0]])

    def hidden(points: list[list[float]], shift: float = 0.0) -> float:
        ends = np.array(points) - laser[0, :2]
        return float(place.judge(laser + [0.0, shift, 0.0], ends, np.zeros_like(ends)).hidden[0])

    aslant = [[3.8, 0.0], [3.9, 0.0]]  # the last metre within 0.15 m of the wall on which they end
    past_the_end = [[6.0, -0.15], [6.0, -0.2]]
    through = [[2.0, -1.0], [1.0, -1.5], [3.0, -0.8]]
    for shift in (-0.05, 0.0, 0.05):
        assert hidden(aslant, shift) == hidden(past_the_end, shift) == 0.0
        assert hidden(through, shift) == 1.0


def test_place_whose_rays_are_likelier_but_fit_worse_does_not_rule_out_another() -> None:
    both = GlobalPlaces(
        poses=np.array([[0.0, 0, 0], [9.0, 0, 0]]),
        probabilities=np.array([0.999, 0.001]),
        agreements=np.array([0.9, 0.65]),
        hidden=np.array([0.1, 0.02]),
        unseen=np.array([0.0, 0.3]),
    )
    assert both.fits == pytest.approx([0.7, 0.61 / 0.7])
    assert len(both.rivals) == 1 and both.fit == both.fits[1]
    alike, worse = (replace(both, agreements=np.array([0.9, share])) for share in (0.51, 0.45))
    assert alike.fits == pytest.approx([0.7, 0.47 / 0.7])
    assert len(alike.rivals) == 1 and len(worse.rivals) == 0


@any_times
def test_covariance_grows_where_the_map_is_wrong_and_not_elsewhere(times: Callable[[Run], Run]) -> None:
    bent = WALLS.copy()
    bent[(WALLS[:, :, 0] >= 5.0).all(axis=1)] += [0.0, 0.03]  # the right end of the room
    rough = np.concatenate([WALLS, bent[(WALLS[:, :, 0] >= 5.0).all(axis=1)]])
    right = np.column_stack([np.linspace(5.6, 7.0, 20), np.full(20, 1.4), np.zeros(20)])
    poses = np.concatenate([TRUTH[:60], right])
    found = locate_in_map(times(after(room_run(TRUTH[:60]), room_run(right, seed=1))), rough)
    sd = np.sqrt(np.diagonal(found.covariances, axis1=1, axis2=2))[:, :2].mean(axis=1)
    assert len(sd) == len(poses)
    assert np.median(sd[62:]) > 1.3 * np.median(sd[:60])


@any_times
def test_covariance_of_a_laser_with_coarse_steps_is_that_of_its_errors(times: Callable[[Run], Run]) -> None:
    run = times(room_run(TRUTH[::3]))
    coarse = replace(run, ranges=0.05 * np.rint(run.ranges / 0.05))  # no field of the run says so
    off, sd = [], []
    for one in (run, coarse):
        found = locate_in_map(one, WALLS)
        off.append(np.sqrt((errors(found.poses, TRUTH[::3])[:, :2] ** 2).mean()))
        sd.append(np.sqrt(np.diagonal(found.covariances, axis1=1, axis2=2)[:, :2].mean()))
    assert off[0] < sd[0] < 3 * off[0]
    assert off[1] < sd[1] < 3 * off[1]


def test_covariance_grows_where_returns_lie_on_no_wall() -> None:
    run = room_run(TRUTH[:30])
    run = replace(run, sensor=replace(run.sensor, sigma=0.001))  # what scatters more is the map's
    without_box = WALLS[:-4]
    sd = [
        np.sqrt(np.diagonal(locate_in_map(run, walls).covariances, axis1=1, axis2=2))[:, :2].mean()
        for walls in (WALLS, without_box)
    ]
    assert sd[1] > 1.05 * sd[0]  # a ninth of the returns is of the box


@pytest.mark.slow
def test_grid_of_seen_cells_is_where_the_log_of_a_graph_has_looked() -> None:
    run = replace(room_run(TRUTH), pose_stamps=np.arange(120) / 5, poses=TRUTH)
    seen = seen_by_graph(build([run], model="cells"))
    assert seen is not None
    middle = ((TRUTH[:, :2] - seen.origin) / seen.resolution).astype(int)
    assert seen.cells[tuple(middle.T)].all()
    outside = ((np.array([-0.5, -0.5]) - seen.origin) / seen.resolution).astype(int)
    assert (outside < 0).any() or not seen.cells[tuple(outside)]


@pytest.mark.slow
def test_another_arena_is_said_before_the_scans_are_followed() -> None:
    rng = np.random.default_rng(0)
    first, angle = rng.uniform([0, 0], [20, 15], size=(80, 2)), rng.uniform(0, np.pi, size=80)
    other = np.stack([first, first + 1.5 * np.column_stack([np.cos(angle), np.sin(angle)])], axis=1)
    steps: list[str] = []

    @contextmanager
    def progress(step: str, unit: str) -> Iterator[Progress]:
        steps.append(step)
        yield lambda done, total: None

    with pytest.raises(SensorgraphError, match=r"fit nowhere in other.*of another place"):
        locate_in_map(room_run(TRUTH), other, name="other", progress=progress)
    assert steps == ["looking for the scans in the map"]
    located = locate_in_map(room_run(TRUTH), WALLS, progress=progress)
    assert set(located.status) == {"ok"} and steps[2:5] == [
        "tracking",
        "estimating ray times",
        "locating in the map",
    ]


def test_short_drive_that_fits_counts_as_far_as_the_scans_after_it_continue_there() -> None:
    run = room_run(TRUTH)
    run = replace(run, ranges=np.where(run.ranges > 1.5, np.inf, run.ranges))
    corners = TRUTH[32, :2] + [[-0.4, -0.4], [0.4, -0.4], [0.4, 0.4], [-0.4, 0.4]]
    box = np.stack(
        [corners, np.roll(corners, -1, axis=0)], axis=1
    )  # the run drives through it after the drive
    right, wrong = known_map(WALLS), known_map(np.concatenate([WALLS, box]))
    one, sure = list(looks(run, 1, 20)), GLOBAL_SEARCH.accept_fit
    assert best_fit(one, wrong) > sure
    assert best_fit(one, wrong, sure=1.1) < MAP_TRACKING.near_fit  # no fit is good enough alone
    assert best_fit(one, right, sure=1.1) > sure
