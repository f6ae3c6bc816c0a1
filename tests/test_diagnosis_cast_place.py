"""Casts at likely poses: errors count from the reference, and outlines are where the laser is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import polygon_arena
from scan_samples import drive

from logs.run import Run
from planners.arena import Arena, wrap
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.scan.candidates import proposed_candidates
from sensorgraph.diagnosis.scan.fit import Fitted, fit, start_state
from sensorgraph.diagnosis.scan.likely_poses import at_likely_poses, is_reference_wide
from sensorgraph.diagnosis.scan.nuisance import as_pose_errors, errors_of_laser
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import ScanData, prepare_scans
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.types import Floats
from sensorgraph.world.raycast import laser_poses
from sensorgraph.world.robot import parse_robot

TEXT = "sensor: {n_rays: 61}\ntolerances: {pose_xy: 0.03, pose_yaw: 0.01}"


@pytest.fixture(scope="module")
def legs() -> Arena:
    """Return a hall of many thin legs: outlines everywhere."""
    corners = [(x, y) for x in (1.0, 2.0, 4.0, 5.0) for y in (0.8, 2.3, 4.2)]
    things = [[(x, y), (x + 0.12, y), (x + 0.12, y + 0.12), (x, y + 0.12)] for x, y in corners]
    return polygon_arena([(0, 0), (6, 0), (6, 5), (0, 5)], *things)


def wandering(run: Run) -> tuple[Run, Floats]:
    """Return a run whose reference wanders by 3 cm and 10 mrad, and its errors at the scans."""
    rng = np.random.default_rng(3)
    knots = np.linspace(run.pose_stamps[0], run.pose_stamps[-1], 14)
    off = rng.normal(size=(14, 3)) * [0.03, 0.03, 0.01]
    errors = np.stack([np.interp(run.pose_stamps, knots, c) for c in off.T], axis=1)
    poses = run.poses + errors
    at_scans = np.stack([np.interp(run.stamps, run.pose_stamps, c) for c in errors.T], axis=1)
    return replace(run, poses=np.column_stack([poses[:, :2], wrap(poses[:, 2])])), at_scans


@pytest.fixture(scope="module")
def wide(legs: Arena) -> tuple[ScanData, Floats]:
    run, errors = wandering(drive(legs, n=120))
    data = prepare_scans(run, legs, parse_robot(TEXT))[0]
    assert len(data.stamps) == len(errors)
    return data, errors


def fitted(data: ScanData) -> Fitted:
    return fit(data, (), start_state(data, SCAN.noise), SCAN.noise)


def test_poses_are_found_again_and_count_from_the_reference(wide: tuple[ScanData, Floats]) -> None:
    data, errors = wide
    posed = at_likely_poses(data, SCAN.noise)
    assert posed.posed is not None
    got = fitted(posed)
    off = errors_of_laser(posed, got.state) + errors  # the fit takes the reference back
    assert np.sqrt((off[:, :2] ** 2).mean()) < 0.004 and np.sqrt((off[:, 2] ** 2).mean()) < 0.003
    np.testing.assert_allclose(posed.poses - posed.posed, data.poses)


def test_outlines_that_rays_pass_are_where_the_laser_is(wide: tuple[ScanData, Floats]) -> None:
    data, _ = wide
    plain, posed = fitted(data), fitted(at_likely_poses(data, SCAN.noise))
    assert posed.j > plain.j + 500
    assert posed.state.noise.stray < 0.3 * plain.state.noise.stray + 1e-3


def test_where_there_are_no_outlines_it_makes_no_difference(wide: tuple[ScanData, Floats]) -> None:
    room = polygon_arena([(0, 0), (6, 0), (6, 5), (0, 5)])
    run = drive(room, n=80)
    data = prepare_scans(run, room, parse_robot(TEXT))[0]
    one, other = fitted(data), fitted(at_likely_poses(data, SCAN.noise))
    assert abs(one.j - other.j) < 3.0
    np.testing.assert_allclose(one.state.delta, other.state.delta, atol=2e-3)


def test_poses_that_others_judge_are_found_from_every_other_ray(wide: tuple[ScanData, Floats]) -> None:
    data, _ = wide
    odd = np.arange(data.n_rays) % 2 == 1
    spoilt = replace(data, ranges=np.where(odd, 1.0, data.ranges), memo={})
    one, other = (at_likely_poses(d, SCAN.noise, even_rays=True) for d in (data, spoilt))
    assert one.posed is not None and other.posed is not None
    np.testing.assert_array_equal(one.posed, other.posed)


def test_a_cone_is_found_though_the_likely_poses_have_taken_what_they_could_of_it(legs: Arena) -> None:
    cone = EFFECTS["sonar_cone"](gamma=0.1, alpha_max=0.9)
    run, _ = wandering(drive(legs, (cone,), n=120))
    data = at_likely_poses(prepare_scans(run, legs, parse_robot(TEXT))[0], SCAN.noise)
    null = fitted(data)
    best = max(
        (c for c in proposed_candidates(FitResiduals(data, null)) if c.amendment.name == "sonar_cone"),
        key=lambda c: c.gain,
    )
    assert best.gain > 300 and 0.05 < best.amendment["gamma"] < 0.15


def test_a_usual_reference_keeps_its_casts(legs: Arena) -> None:
    data = prepare_scans(drive(legs, n=60), legs, parse_robot("sensor: {n_rays: 61}"))[0]
    assert not is_reference_wide(data)
    assert at_likely_poses(data, SCAN.noise) is data


def test_a_mount_far_beyond_its_tolerance_moves_the_casts_and_is_found(legs: Arena) -> None:
    """The stated tolerances are narrow, but the laser is 3 cm and 1 degree off, so that other rays meet the legs."""
    hidden = EFFECTS["mount_xy"](dx=0.023, dy=0.019), EFFECTS["mount_yaw"](delta=-0.017)
    robot = parse_robot("{sensor: {n_rays: 61}, tolerances: {pose_xy: 0.0022, pose_yaw: 0.0015}}")
    run = drive(legs, hidden, n=120)
    data = prepare_scans(run, legs, robot)[0]
    assert not is_reference_wide(data)
    assert fitted(at_likely_poses(data, SCAN.noise)).j > fitted(data).j + 200
    finding = diagnose(run, legs, robot, plan_next=False)
    assert {a.name for a in finding.effects} == {"mount_xy", "mount_yaw"} and finding.unknown is None
    for a in finding.effects:
        (true,) = (one for one in hidden if one.name == a.name)
        assert all(abs(a[k] - true[k]) < 3 * a.stderr[k] for k in true.parameters)


@pytest.mark.parametrize(
    ("pose_xy", "fov", "is_wide"), [(0.02, 3.14, True), (0.009, 3.14, False), (0.009, 0.2, True)]
)
def test_a_reference_is_wide_beyond_the_noise_or_the_next_ray(
    legs: Arena, pose_xy: float, fov: float, is_wide: bool
) -> None:
    """At some 2 m neighbours of 61 rays are 10 cm apart over a half turn, and less than 9 mm over 11 degrees: noise is 1 cm."""
    text = f"sensor: {{n_rays: 61}}\ntolerances: {{pose_xy: {pose_xy}, pose_yaw: 0.0001}}"
    data = prepare_scans(drive(legs, n=60), legs, parse_robot(text))[0]
    data = replace(data, sensor=replace(data.sensor, bearings=np.linspace(-fov / 2, fov / 2, 61)))
    assert is_reference_wide(data) is is_wide


@pytest.mark.parametrize(
    ("effect", "key"), [(EFFECTS["mount_yaw"](delta=0.03), "delta"), (EFFECTS["latency"](tau=0.06), "tau")]
)
def test_what_moves_the_laser_is_told_from_the_poses_at_the_cast_that_both_share(
    legs: Arena, effect: Amendment, key: str
) -> None:
    """The poses have taken it: whatever size a fit of it begins with, it gains what they lose; without it they take it back."""
    run, _ = wandering(drive(legs, (effect,), n=120))
    data = at_likely_poses(prepare_scans(run, legs, parse_robot(TEXT))[0], SCAN.noise)
    null = fitted(data)
    for begun in (0.0, 0.9 * effect[key]):
        one = fit(data, (effect.moved_to({key: begun}),), null.state, SCAN.noise)
        assert one.j > null.j + 15 and one.model[0][key] == pytest.approx(effect[key], rel=0.35)
    again = fit(data, one.model, one.state, SCAN.noise)
    moved = np.abs(again.cast.beams.ranges - one.cast.beams.ranges)
    assert (
        np.median(moved) < 0.005 and (moved > 0.03).mean() < 0.06
    )  # a delay moves by more than its slope says
    anew = fit(data, one.model, start_state(data, SCAN.noise), SCAN.noise)
    assert anew.j > null.j
    # as the evidence of an effect is asked
    without = fit(data, (), one.state, SCAN.noise)
    assert without.j > null.j - 0.5 * (one.j - null.j)


def test_what_looks_like_a_mount_or_a_delay_moves_the_laser_as_they_do(
    wide: tuple[ScanData, Floats],
) -> None:
    data = replace(wide[0], sensor=replace(wide[0].sensor, mount=np.array([0.2, -0.3, 0.1])))
    off = np.array([0.003, -0.002, 0.004, 0.01])
    moved = data.poses + as_pose_errors(data, off)
    there = laser_poses(data.poses - off[3] * data.twists, data.sensor.mount + off[:3])
    np.testing.assert_allclose(laser_poses(moved, data.sensor.mount), there, atol=2e-4)  # to second order
