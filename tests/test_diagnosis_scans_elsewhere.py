"""Scans taken away from their reference poses, or stamped late: what was planted is found, and nothing where one delay holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import further
from scan_samples import checked_of, drive, hall_arena

from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.scan.fit import Fitted, fit, start_state
from sensorgraph.diagnosis.scan.scan_data import prepare_scans
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed import Doubt, sure
from sensorgraph.diagnosis.scan.unnamed.scans_elsewhere import find
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.world.robot import parse_robot


def fitted(late: float, share: float, *effects: Amendment, seed: int = 3) -> Fitted:
    """Return the fit of a run of which a share of the scans is stamped late [s]."""
    hall = hall_arena()
    run = drive(hall, effects)
    is_late = np.random.default_rng(seed).random(len(run.stamps)) < share
    stamps = run.stamps + late * is_late
    data, _ = prepare_scans(replace(run, stamps=stamps), hall, parse_robot("sensor: {n_rays: 61}"))
    return fit(data, effects, start_state(data, SCAN.noise), SCAN.noise)


def doubts_of(got: Fitted, null: Fitted | None = None) -> list[Doubt]:
    return sure(find(checked_of(got, null)))


def share_in(statement: str) -> float:
    return float(statement.split(" %")[0]) / 100


@pytest.mark.parametrize(("late", "share"), [(-0.05, 0.2), *further((0.06, 0.3), (0.08, 0.1))])
def test_late_scans_were_taken_away_from_their_poses(late: float, share: float) -> None:
    got = fitted(late, share)
    (doubt,) = doubts_of(got)
    assert any("stamped late" in cause for cause in doubt.causes)
    # a scan that was taken at rest is where its pose is, whatever its stamp
    assert 0.4 * share < share_in(doubt.statement) < share + 0.06
    assert doubt.size is not None and doubt.size.is_material(got.solver.data.sensor.sigma)


def test_one_delay_of_all_scans_keeps_its_name() -> None:
    assert doubts_of(fitted(0.0, 0.0)) == []
    assert doubts_of(fitted(0.0, 0.0, EFFECTS["latency"](tau=0.04))) == []


def test_a_latency_that_is_the_mean_of_two_is_not_named() -> None:
    hall = hall_arena()
    run = drive(hall)
    is_late = np.random.default_rng(5).random(len(run.stamps)) < 0.4
    late = replace(run, stamps=run.stamps + 0.08 * is_late)
    finding = diagnose(late, hall, parse_robot("sensor: {n_rays: 61}"), plan_next=False)
    assert finding.channels["scan"].effects == ()
    assert finding.unknown is not None and any("stamp" in cause for cause in finding.unknown.families)


def test_scans_of_a_reference_that_jumps_are_elsewhere_by_its_jump() -> None:
    hall, rng = hall_arena(), np.random.default_rng(8)
    run = drive(hall)
    jumps = rng.random(len(run.stamps)) < 0.12
    turns = rng.uniform(0, 2 * np.pi, len(run.stamps))
    shift = 0.15 * jumps[:, None] * np.stack([np.cos(turns), np.sin(turns), 0 * turns], axis=1)
    at = np.abs(run.pose_stamps[:, None] - run.stamps).argmin(axis=1)  # of the scan that is nearest
    data, _ = prepare_scans(
        replace(run, poses=run.poses + shift[at]), hall, parse_robot("sensor: {n_rays: 61}")
    )
    null = fit(data, (), start_state(data, SCAN.noise), SCAN.noise)
    (doubt,) = doubts_of(null)
    assert share_in(doubt.statement) == pytest.approx(jumps.mean(), abs=0.04)
    assert float(doubt.statement.split("by ")[1].split(" cm")[0]) == pytest.approx(15.0, rel=0.25)
    assert "away from their reference pose" in doubt.statement and not doubt.failed


def test_rays_that_are_rounded_alike_do_not_move_the_scan() -> None:
    """Steps of 10 cm: the rays to one wall are rounded alike, as by a pose error of a centimetre or two."""
    hall, steps = hall_arena(), EFFECTS["quantisation"](q=0.1)
    run = drive(hall)
    rounded = np.round(run.ranges / 0.1) * 0.1
    data, _ = prepare_scans(replace(run, ranges=rounded), hall, parse_robot("sensor: {n_rays: 61}"))
    got = fit(data, (steps,), start_state(data, SCAN.noise), SCAN.noise)
    assert doubts_of(got) == []


def test_one_facet_of_four_shows_though_a_long_run_is_thinned_to_one_scan_in_four() -> None:
    hall, sensor = hall_arena(), parse_robot("sensor: {n_rays: 61}").sensor
    run = drive(hall, n=400)
    n_rays = -(-4 * SCAN.intake.max_readings // run.n_scans)  # as many as thin it so
    many = replace(sensor, bearings=np.linspace(sensor.bearings[0], sensor.bearings[-1], n_rays))
    ranges = np.stack([np.interp(many.bearings, sensor.bearings, z) for z in run.ranges])
    data, _ = prepare_scans(
        replace(run, sensor=many, ranges=ranges), hall, parse_robot(f"sensor: {{n_rays: {n_rays}}}")
    )
    facet = np.rint((data.stamps - run.stamps[0]) / 0.2).astype(int) % 4
    assert data.n_scans == run.n_scans // 4
    assert np.bincount(facet, minlength=4).min() > 0.2 * data.n_scans
