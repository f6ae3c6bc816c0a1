"""At a site known by its good runs, a name of the sensor takes evidence on which the parts of the way agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_diagnosis_commissioning import ARENA, ROBOT, site_run

from benchmarks.planted_site import scans_alone
from planners.types import Floats
from sensorgraph.diagnosis.result import ChannelResult, Rival, without_close_calls
from sensorgraph.diagnosis.scan.fit import Fitted, fit, start_state
from sensorgraph.diagnosis.scan.scan_data import ScanData, prepare_scans
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.worth import evidence, parts_of_way, spread_evidence
from sensorgraph.diagnosis.site_baseline import SitePrior
from sensorgraph.effects import EFFECTS, Amendment

BIAS = EFFECTS["range_bias"](b=0.03)
OCCLUSION = EFFECTS["self_occlusion"](r0=0.3, theta1=0.1, theta2=0.2)


@pytest.fixture(scope="module")
def null() -> Fitted:
    data, _ = prepare_scans(site_run(2), ARENA, ROBOT)
    return fit(data, (), start_state(data, SCAN.noise), SCAN.noise)


def site_of(null: Fitted) -> ScanData:
    """Return its data as of a site that is known by its good runs."""
    return replace(
        null.solver.data, site=SitePrior(floors={"people": 100.0, "self_occlusion": 400.0}), memo={}
    )


def better_by(null: Fitted, nats: Floats, *model: Amendment) -> Fitted:
    """Return a fit whose scans (n_scans,) are likelier by so many nats."""
    old = null.solution
    log_p = old.responsibilities.log_p + (nats / old.responsibilities.log_p.shape[1])[:, None]
    solution = replace(
        old, j=old.j + float(nats.sum()), responsibilities=replace(old.responsibilities, log_p=log_p)
    )
    return replace(null, solution=solution, model=model)


def test_what_one_part_of_the_way_says_is_no_evidence_and_what_all_say_is_whole(null: Fitted) -> None:
    data = site_of(null)
    part = parts_of_way(data)
    everywhere, at_one_place = np.full(data.n_scans, 0.5), np.where(part == 3, 5.0, 0.0)
    contradicted = np.where(part < 6, 3.0, -6.0)
    assert spread_evidence(data, better_by(null, everywhere), null) == pytest.approx(everywhere.sum())
    assert at_one_place.sum() > SCAN.selection.threshold
    for nats in (at_one_place, contradicted):
        assert nats.sum() > 0
        assert spread_evidence(data, better_by(null, nats), null) == 0.0
    assert (
        evidence(null.solver.data, OCCLUSION, better_by(null, at_one_place), null) > 0
    )  # no site that is known
    assert evidence(data, BIAS, better_by(null, at_one_place), null) > 0  # has a sharper test
    assert evidence(data, OCCLUSION, better_by(null, at_one_place), null) == 0.0


def test_a_robot_that_stands_stays_in_one_part(null: Fitted) -> None:
    data = null.solver.data
    poses = data.poses.copy()
    poses[40:120] = poses[40]
    part = parts_of_way(replace(data, poses=poses))
    assert len(np.unique(part[41:119])) == 1
    unjudged = data.ranges.copy()
    unjudged[:80] = np.nan  # half of the run says nothing: all parts are of the other half
    assert (parts_of_way(replace(data, ranges=unjudged))[:80] == 0).all()


def test_a_lead_that_clutter_may_bring_does_not_choose() -> None:
    found = replace(BIAS, evidence=400.0)
    rival = Rival(name="range_drift", instead_of="range_bias", evidence_nats=380.0, separates="")
    result = ChannelResult(channel="scan", effects=(found,), rivals=(rival,))
    assert without_close_calls(result).effects == (found,)
    far = replace(rival, required_nats=60.0)
    assert without_close_calls(replace(result, rivals=(far,))).undecided == (found,)


def test_a_located_log_with_a_scan_that_has_no_pose_keeps_the_poses_of_the_others() -> None:
    run = site_run(1)
    left = np.delete(np.arange(run.n_scans), 5)
    log = replace(run, pose_stamps=run.pose_stamps[left], poses=run.poses[left])
    kept = scans_alone(log)
    assert kept.n_scans == len(kept.poses)
    assert np.array_equal(
        np.searchsorted(run.stamps, kept.stamps), np.searchsorted(run.stamps, kept.pose_stamps)
    )
    whole = np.searchsorted(run.stamps, kept.stamps)
    others = whole != 5
    assert np.allclose(kept.poses[others, :2], run.poses[whole[others], :2])
