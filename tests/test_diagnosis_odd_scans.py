"""Scans of which a share is stamped late, or taken elsewhere: what was planted is found, and nothing where one delay holds for all."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scan_samples import checked_of, drive, hall_arena

from sensorgraph.diagnosis.scan.fit import Fitted, fit, start_state
from sensorgraph.diagnosis.scan.scan_data import prepare_scans
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed import Doubt, sure
from sensorgraph.diagnosis.scan.unnamed.odd_scans import OddScans, find, odd_scans
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.world.robot import parse_robot


def fitted(late: float, share: float, *effects: Amendment, seed: int = 3) -> Fitted:
    """Return the fit of a run of which a share of the scans is stamped late [s]."""
    hall = hall_arena()
    run = drive(hall, effects)
    is_late = np.random.default_rng(seed).random(len(run.stamps)) < share
    stamps = run.stamps + late * is_late
    data, _ = prepare_scans(replace(run, stamps=stamps), hall, parse_robot("sensor: {n_rays: 61}"))
    return fit(data, effects, start_state(data, SCAN.noise), SCAN.noise, outer=1, inner=7)


def kind_of(got: Fitted) -> OddScans:
    found, _ = odd_scans(got)
    assert found is not None
    return found


def delay_in(statement: str) -> float:
    """Return the delay [s] that a statement reports."""
    found = re.search(r"stamped (\d+) ms too (late|early)", statement)
    assert found is not None
    return float(found[1]) / (1000 if found[2] == "late" else -1000)


def doubts_of(got: Fitted, null: Fitted | None = None) -> list[Doubt]:
    return sure(find(checked_of(got, null)))


@pytest.mark.parametrize(("late", "share"), [(0.06, 0.3), (-0.05, 0.2), (0.08, 0.1)])
def test_a_share_of_late_scans_is_found_with_its_size(late: float, share: float) -> None:
    got = fitted(late, share)
    found = kind_of(got)
    assert found.family == "late_scans" and "changes" not in found.statement
    assert delay_in(found.statement) == pytest.approx(late, rel=0.12)
    assert found.share == pytest.approx(share, abs=0.06)
    (doubt,) = doubts_of(got)
    assert ("late" if late > 0 else "early") in doubt.statement
    assert doubt.size is not None and doubt.size.is_material(got.solver.data.sensor.sigma)


def test_scans_that_are_late_in_one_stretch_are_told_as_a_delay_that_changes() -> None:
    hall = hall_arena()
    run = drive(hall, n=300)
    grows = 0.08 * (np.arange(run.n_scans) > 180)
    data, _ = prepare_scans(
        replace(run, stamps=run.stamps + grows), hall, parse_robot("sensor: {n_rays: 61}")
    )
    got = fit(data, (), start_state(data, SCAN.noise), SCAN.noise, outer=1, inner=7)
    found = kind_of(got)
    assert delay_in(found.statement) == pytest.approx(0.08, rel=0.12)
    assert "the delay of the scans changes during the run" in found.statement


def test_one_delay_of_all_scans_is_no_mixture_and_keeps_its_name() -> None:
    assert doubts_of(fitted(0.0, 0.0)) == []
    assert doubts_of(fitted(0.0, 0.0, EFFECTS["latency"](tau=0.04))) == []


def test_a_latency_that_is_the_mean_of_two_loses_its_name() -> None:
    hall = hall_arena()
    run = drive(hall)
    is_late = np.random.default_rng(5).random(len(run.stamps)) < 0.4
    late = replace(run, stamps=run.stamps + 0.08 * is_late)
    data, _ = prepare_scans(late, hall, parse_robot("sensor: {n_rays: 61}"))
    null = fit(data, (), start_state(data, SCAN.noise), SCAN.noise, outer=1, inner=7)
    mean = fit(
        data, (EFFECTS["latency"](tau=0.03),), start_state(data, SCAN.noise), SCAN.noise, outer=3, inner=5
    )
    (doubt,) = doubts_of(mean, null)
    assert doubt.failed == {0}


def test_scans_of_a_reference_that_jumps_are_elsewhere_and_not_late() -> None:
    hall, rng = hall_arena(), np.random.default_rng(8)
    run = drive(hall)
    jumps = rng.random(len(run.stamps)) < 0.12
    turns = rng.uniform(0, 2 * np.pi, len(run.stamps))
    shift = 0.15 * jumps[:, None] * np.stack([np.cos(turns), np.sin(turns), 0 * turns], axis=1)
    at = np.abs(run.pose_stamps[:, None] - run.stamps).argmin(axis=1)  # of the scan that is nearest
    data, _ = prepare_scans(
        replace(run, poses=run.poses + shift[at]), hall, parse_robot("sensor: {n_rays: 61}")
    )
    null = fit(data, (), start_state(data, SCAN.noise), SCAN.noise, outer=1, inner=7)
    found = kind_of(null)
    assert found.family == "scans_elsewhere"
    assert found.share == pytest.approx(jumps.mean(), abs=0.04)
    assert float(found.statement.split("by ")[1].split(" cm")[0]) == pytest.approx(15.0, rel=0.25)
    (doubt,) = doubts_of(null)
    assert "away from their reference pose" in doubt.statement and not doubt.failed


@pytest.mark.parametrize(("own", "told"), [(0.0, False), (0.06, True)])
def test_rays_that_are_rounded_alike_are_no_offset_of_the_scan(own: float, told: bool) -> None:
    """Steps of 10 cm: the rays to one wall are rounded alike, and a scan's mean is off by a centimetre or two."""
    hall, steps = hall_arena(), EFFECTS["quantisation"](q=0.1)
    run = drive(hall)
    offsets = own * np.random.default_rng(6).normal(size=(run.n_scans, 1))
    rounded = np.round((run.ranges + offsets) / 0.1) * 0.1
    data, _ = prepare_scans(replace(run, ranges=rounded), hall, parse_robot("sensor: {n_rays: 61}"))
    got = fit(data, (steps,), start_state(data, SCAN.noise), SCAN.noise, outer=1, inner=7)
    assert bool(doubts_of(got)) == told
    if told:
        assert kind_of(got).family == "scan_offsets"


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
