"""Against a run that is known to be good, what the site always shows is silent and what has changed is named."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from conftest import polygon_arena

from benchmarks import planted_changes, planted_site
from logs import read
from logs.run import RangeSensor, Run
from planners.arena import Arena
from planners.types import Floats
from sensorgraph.diagnosis.commissioning import commission_all
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.scan.scan_data import prepare_scans
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.diagnosis.scan.worth import clutter_floor, price, surely_stands
from sensorgraph.diagnosis.site_baseline import (
    SiteBaseline,
    SitePrior,
    WindowEstimate,
    baseline_intervals,
    between_windows,
)
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.world.robot import default_robot

ARENA = polygon_arena(
    [(0, 0), (6, 0), (6, 4), (3.5, 4), (3.5, 5), (0, 5)],
    [(4.0, 1.2), (4.6, 1.2), (4.6, 1.9), (4.0, 1.9)],
)
SENSOR = RangeSensor(bearings=np.linspace(-1.5, 1.5, 61), range_max=8.0, sigma=0.01, resolution=0.001)
ROBOT = replace(default_robot(), sensor=SENSOR)


def site_run(seed: int, *, bias: float = 0.0, turn: float = 0.0, n_scans: int = 160) -> Run:
    """Drive through a site that always shows the same: jittery laser poses, noise with the range, strays, passers-by."""
    rng = np.random.default_rng(seed)
    t = np.arange(n_scans) * 0.2
    phase = rng.uniform(0, 2 * np.pi)
    poses = np.stack(
        [
            2.2 + 1.1 * np.sin(0.21 * t + phase),
            2.4 + 0.9 * np.cos(0.17 * t + phase),
            2.5 * np.sin(0.3 * t + phase),
        ],
        axis=1,
    )
    angle = poses[:, 2:] + SENSOR.bearings + turn
    exact = ranges_in(ARENA, poses[:, :2], angle)
    z = exact + bias + rng.normal(size=exact.shape) * np.hypot(0.01, 0.006 * exact)
    stray = rng.random(z.shape) < 0.04
    z = np.where(stray, rng.uniform(0.05, 8.0, z.shape), z)
    first = rng.integers(
        0, 50, len(t)
    )  # somebody in the way of a few neighbouring rays, in every fourth scan
    by = (np.abs(np.arange(61) - first[:, None]) < 3) & (rng.random(len(t)) < 0.25)[:, None]
    z = np.where(by, np.minimum(z, rng.uniform(0.5, 1.5, (len(t), 1))), z)
    z = np.where(rng.random(z.shape) < 0.02, np.inf, np.round(z, 3))
    said = poses + rng.normal(size=poses.shape) * [0.01, 0.01, 0.004]
    return Run(sensor=SENSOR, stamps=t, ranges=z, pose_stamps=t, poses=said, pose_frame="laser")


def ranges_in(arena: Arena, origins: Floats, angle: Floats) -> Floats:
    """Meet every ray with every wall; ranges like angle (n_scans, n_rays)."""
    a, d = arena.walls[:, 0], arena.walls[:, 1] - arena.walls[:, 0]
    ux, uy = np.cos(angle)[..., None], np.sin(angle)[..., None]
    x, y = a[:, 0] - origins[:, None, :1], a[:, 1] - origins[:, None, 1:]
    cross = ux * d[:, 1] - uy * d[:, 0]
    r = (x * d[:, 1] - y * d[:, 0]) / cross
    along = (x * uy - y * ux) / cross
    best = np.where((r > 0) & (along >= 0) & (along <= 1), r, np.inf).min(axis=-1)
    return np.asarray(best)


@pytest.fixture(scope="module")
def good() -> SiteBaseline:
    return commission_all([site_run(1)], ARENA, ROBOT)


@pytest.fixture(scope="module")
def learnt() -> SiteBaseline:
    """Return the baseline of a run of three windows, as short as that can be."""
    shown: list[int] = []
    run = site_run(1, n_scans=100)
    baseline = commission_all([run], ARENA, ROBOT, progress=lambda done, total: shown.append(done))
    assert shown == sorted(shown) and shown[-1] == 100 and len(shown) > 8  # counted, as every stage is
    return baseline


def against(good: SiteBaseline | None, run: Run) -> Finding:
    return diagnose(run, ARENA, ROBOT, baseline=good, plan_next=False)


def names(finding: Finding) -> list[str]:
    return [a.name for a in finding.effects]


@pytest.mark.slow
def test_what_the_site_always_shows_is_silent_against_a_good_run(good: SiteBaseline) -> None:
    finding = against(good, site_run(2))
    assert names(finding) == []
    assert finding.unknown is None
    bare = against(None, site_run(2))
    assert names(bare) or bare.unknown is not None


@pytest.mark.slow
def test_a_bias_that_the_good_run_lacks_is_named_first_with_its_size(good: SiteBaseline) -> None:
    effect = against(good, site_run(3, bias=0.04)).effects[0]
    assert effect.name == "range_bias"
    assert effect["b"] == pytest.approx(0.04, abs=0.006)


@pytest.mark.slow
def test_a_turned_laser_is_named_though_the_poses_are_its_own(good: SiteBaseline) -> None:
    found = against(good, site_run(4, turn=0.02))
    effect = found.effects[0]
    assert effect.name == "mount_yaw"
    assert effect["delta"] == pytest.approx(0.02, abs=0.004)
    bare, _ = prepare_scans(site_run(4), ARENA, ROBOT)
    assert bare.laser_frame
    assert not found.data.laser_frame


def test_the_good_run_loosens_pose_tolerances_to_what_its_poses_deserve(learnt: SiteBaseline) -> None:
    t = learnt.robot.tolerances
    assert 0.006 < t.pose_xy < 0.02  # 10 mm planted
    assert 0.002 < t.pose_yaw < 0.008  # 4 mrad planted
    assert 0.01 < learnt.noise_bounds.stray[1] < 0.2


def windows(
    name: str, key: str, values: list[float], stderrs: list[float] | None = None
) -> list[WindowEstimate]:
    """Make windows that show these sizes, each as surely as told."""
    errors = [0.0] * len(values) if stderrs is None else stderrs
    return [
        WindowEstimate(
            n_scans=100,
            n_readings=9000,
            gains={},
            sizes={name: {key: v}},
            stderrs={name: {key: e}},
            misfit=0.0,
        )
        for v, e in zip(values, errors, strict=True)
    ]


def test_a_baseline_interval_contains_a_further_window_of_the_same_site_and_not_what_is_far_off() -> None:
    rng = np.random.default_rng(0)
    missed = 0
    for _ in range(400):
        values = [float(v) for v in rng.normal(0.003, 0.004, 12)]
        interval = baseline_intervals(windows("range_bias", "b", values[:11]))["range_bias"]
        missed += not interval.contains(EFFECTS["range_bias"](b=values[11]))
        assert not interval.contains(EFFECTS["range_bias"](b=0.05))
    assert missed <= 6  # 0.8 expected: 99.9 % either side


def test_windows_that_are_sure_to_different_degrees_are_judged_each_by_its_own_error() -> None:
    rng = np.random.default_rng(1)
    missed, widths = 0, []
    for _ in range(400):
        errors = rng.uniform(0.001, 0.02, 12)
        values = 0.003 + rng.normal(size=12) * np.hypot(0.002, errors)
        interval = baseline_intervals(windows("range_bias", "b", list(values[:11]), list(errors[:11])))[
            "range_bias"
        ]
        missed += not interval.contains(EFFECTS["range_bias"](b=values[11]), {"b": errors[11]})
        widths.append(interval.half_width()["b"])
    assert missed <= 6
    assert np.median(widths) < 0.02  # their errors alone spread the values by 12 mm


def test_spread_between_windows_is_recovered_beside_their_own_errors() -> None:
    rng = np.random.default_rng(2)
    errors = rng.uniform(0.5, 3.0, 2000)
    values = 7.0 + rng.normal(size=2000) * np.hypot(1.5, errors)
    mean, of_mean, between = between_windows(values, errors, None)
    assert mean == pytest.approx(7.0, abs=4 * of_mean)
    assert between == pytest.approx(1.5, rel=0.1)
    plain = between_windows(values[:9], np.zeros(9), None)
    assert plain == pytest.approx((values[:9].mean(), values[:9].std(ddof=1) / 3, values[:9].std(ddof=1)))


def test_a_window_whose_parts_disagree_hardly_widens_the_interval() -> None:
    values, stderrs = [0.001, 0.003, 0.0, 0.002, 0.001, 0.03], [0.001] * 5
    calm = baseline_intervals(windows("range_drift", "b1", values[:5], stderrs))["range_drift"].half_width()
    odd = baseline_intervals(windows("range_drift", "b1", values, [*stderrs, 0.02]))[
        "range_drift"
    ].half_width()
    even = baseline_intervals(windows("range_drift", "b1", values, [*stderrs, 0.001]))[
        "range_drift"
    ].half_width()
    assert odd["b1"] < 1.5 * calm["b1"]
    assert even["b1"] > 2 * calm["b1"]


def test_a_run_whose_parts_disagree_may_be_farther_off() -> None:
    interval = baseline_intervals(windows("range_drift", "b1", [0.0, 0.001, 0.002, 0.003]))["range_drift"]
    drift = EFFECTS["range_drift"](b1=0.03)
    assert not interval.contains(drift)
    assert not interval.contains(drift, {"b1": 0.001})
    assert interval.contains(drift, {"b1": 0.03})


def test_shares_and_noise_levels_have_their_interval_on_the_scale_where_they_spread_evenly() -> None:
    interval = baseline_intervals(windows("people", "p", [0.01, 0.04, 0.09, 0.04]))["people"]
    assert interval.mean["p"] == pytest.approx(0.2)
    low, high = interval.limits("people")["p"]
    assert low >= 0.0
    assert high > 0.09
    noise = baseline_intervals(windows("range_noise", "k", [0.001, 0.008, 0.001, 0.008]))["range_noise"]
    assert noise.mean["k"] == pytest.approx((0.01 + 0.04) / 2)
    low, high = noise.limits("range_noise")["k"]
    assert low == 0.0
    assert high - 0.0045 > 2 * 0.0045  # farther above the mean than below it


def test_every_window_tells_the_size_of_every_number_of_the_whole_sensor(learnt: SiteBaseline) -> None:
    whole = {
        name
        for name, effect in EFFECTS.items()
        if effect.channel == "scan"
        and effect.place is None
        and effect.sizes
        and name not in learnt.not_looked_for
    }
    for window in (w for level in learnt.runs[0] for w in level):
        assert whole - {"scan_skew"} <= set(window.sizes)  # a laser without sweep has none


def test_a_sector_varies_at_least_as_the_whole_sensor() -> None:
    intervals = baseline_intervals(windows("range_bias", "b", [0.0, 0.004, -0.003, 0.002, -0.004]))
    sector = EFFECTS["sector_bias"]
    assert intervals["sector_bias"].limits("sector_bias") == intervals["range_bias"].limits("range_bias")
    assert intervals["sector_bias"].contains(sector(theta1=-0.2, theta2=0.6, b=-0.007))
    assert not intervals["sector_bias"].contains(sector(theta1=-0.2, theta2=0.6, b=0.06))


def test_too_few_windows_have_no_interval() -> None:
    assert baseline_intervals(windows("range_bias", "b", [0.0, 0.001, 0.002])) == {}


def baseline(*gains: dict[str, float]) -> SiteBaseline:
    """Return what several good runs show, in which clutter brings effects these nats."""
    shown = [
        WindowEstimate(n_scans=100, n_readings=9000, gains=one, sizes={}, stderrs={}, misfit=0.0)
        for one in gains
    ]
    return SiteBaseline(
        robot=ROBOT,
        known=(),
        noise_bounds=NoiseBounds(),
        not_looked_for=(),
        runs=tuple(((w,),) for w in shown),
    )


def floors(site: SiteBaseline) -> dict[str, float]:
    windows = site.similar_windows(100)
    return site.clutter_nats(windows, {}, 9000)


def test_an_effect_pays_more_than_clutter_brings_in_the_worst_good_run() -> None:
    found = floors(baseline({"range_noise": 40.0, "people": 500.0}, {"range_noise": 50.0}))
    assert found == pytest.approx(
        {"range_noise": SCAN.site.clutter_factor * 50.0, "people": SCAN.site.clutter_factor * 500.0}
    )
    alone = floors(baseline({"range_noise": 50.0}))  # one good run does not show how much clutter varies
    assert alone["range_noise"] > found["range_noise"]


def pillar_run(*, leans: bool = False, near: bool = False) -> tuple[Run, Amendment]:
    """Stand a pillar in the room, at a wall, or beside something else as large."""
    run = site_run(2)
    x, y, r = (0.2, 2.5, 0.12) if leans else (2.2, 4.2, 0.12)
    angle = run.poses[:, 2:] + SENSOR.bearings
    ranges = run.ranges
    for at in (x, x + 0.3)[: 1 + near]:
        dx, dy = at - run.poses[:, :1], y - run.poses[:, 1:2]
        ahead, aside = dx * np.cos(angle) + dy * np.sin(angle), dx * np.sin(angle) - dy * np.cos(angle)
        with np.errstate(invalid="ignore"):
            face = ahead - np.sqrt(r**2 - aside**2)
        ranges = np.where((np.abs(aside) < r) & (face > 0.1) & (ranges > face), face, ranges)
    return replace(run, ranges=ranges), EFFECTS["unmapped_obstacle"](x=x, y=y, r=r)


@pytest.mark.parametrize(
    ("case", "floor"),
    [({}, 0.0), ({"leans": True}, 900.0), ({"near": True}, 900.0)],
    ids=["alone", "leans", "near"],
)
def test_clutter_is_no_price_of_what_surely_stands_alone_in_the_room(
    case: dict[str, bool], floor: float
) -> None:
    run, disc = pillar_run(**case)
    data = replace(prepare_scans(run, ARENA, ROBOT)[0], site=SitePrior(floors={"unmapped_obstacle": 900.0}))
    assert clutter_floor(disc, data) == floor
    assert price(disc, data) == price(disc, replace(data, site=SitePrior())) + floor


def test_what_rays_go_through_does_not_surely_stand() -> None:
    _, disc = pillar_run()
    data = replace(
        prepare_scans(site_run(2), ARENA, ROBOT)[0], site=SitePrior(floors={"unmapped_obstacle": 900.0})
    )
    assert not surely_stands(disc, data)
    assert clutter_floor(disc, data) == 900.0


@pytest.mark.slow
def test_several_good_runs_are_silent_on_a_further_one_and_name_a_bias() -> None:
    several = commission_all([site_run(seed) for seed in (1, 5, 6)], ARENA, ROBOT)
    assert several.n_runs == 3
    shown = {a.name: a for a in several.known}
    assert shown["range_bias"]["b"] == pytest.approx(0.0, abs=0.004)
    assert names(against(several, site_run(2))) == []
    effect = against(several, site_run(3, bias=0.04)).effects[0]
    assert effect.name == "range_bias"
    assert effect["b"] == pytest.approx(0.04, abs=0.006)


@pytest.mark.slow
def test_a_lattice_keeps_its_name_where_the_site_leaves_much_unexplained() -> None:
    run = site_run(2)
    finding = against(None, replace(run, ranges=np.round(run.ranges / 0.02) * 0.02))
    assert finding.unknown is not None
    found = {a.name: a for a in finding.effects}
    assert found["quantisation"]["q"] == pytest.approx(0.02, abs=1e-4)


@pytest.mark.slow
def test_real_log_is_silent_untouched_and_names_a_planted_bias(real_logs: Path) -> None:
    log = read(real_logs / "ple-freiburg-079" / "freiburg-079-corrected.log.gz")
    _, _, other, window = islice(planted_site.windows(log), 4)
    told = planted_site.robot_of(log, 0.01)
    good = commission_all([planted_site.measurement(log, other.scans)], other.arena, told)
    run = planted_site.measurement(log, window.scans)
    untouched = diagnose(run, window.arena, told, baseline=good, plan_next=False)
    assert names(untouched) == []
    longer = planted_changes.bias(run, log, window, 0.03, np.random.default_rng(0))
    named = diagnose(longer, window.arena, told, baseline=good, plan_next=False).effects[0]
    assert named.name == "range_bias"
    assert named["b"] == pytest.approx(0.03, abs=0.01)  # the map of scans has an offset of its own
