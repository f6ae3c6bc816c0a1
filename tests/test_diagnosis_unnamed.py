"""Differences without a name are hypotheses as effects are: a further one is one object, found and listed in the ledger."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scan_samples import drive

from logs.run import Run
from planners.arena import Arena
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.engine.verdict import Verdict
from sensorgraph.diagnosis.ledger import families_of
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.unnamed import UNNAMED, Checked, Doubt, Unnamed, titles
from sensorgraph.diagnosis.scan.unnamed.columns import ColumnEstimate, Columns, Words, find_columns
from sensorgraph.errors import SensorgraphError
from sensorgraph.world.robot import Robot, parse_robot

NAME = "bias_by_turn_rate"
TRUE_BIAS = 0.03
"""[m s/rad]"""


@dataclass(frozen=True, kw_only=True, eq=False)
class BiasByTurnRate(Columns):
    """Readings that grow with the rate at which the robot turns left, whatever the bearing."""

    def words(self, estimate: ColumnEstimate, fitted: Fitted) -> Words:
        bias = 1000 * float(estimate.values[0])
        return Words(
            statement=f"readings are off by {bias:+.0f} mm per rad/s", causes=("a gyro in the laser",)
        )


def turn_rates(fitted: Fitted) -> list[Columns]:
    solver = fitted.solver
    rate = np.where(solver.jacobian.valid, solver.data.twists[:, 2, None], 0.0)
    return [BiasByTurnRate(family=NAME, columns=rate[:, None, :])]


def find(checked: Checked) -> list[Doubt]:
    return find_columns(checked, turn_rates)


TURN_RATE = Unnamed(titles={NAME: "a bias that depends on the turn rate"}, find=find, is_cause=True)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return parse_robot("sensor: {n_rays: 61}")


@pytest.fixture(scope="module")
def plain(hall: Arena) -> Run:
    return drive(hall, seed=4)


@pytest.fixture(scope="module")
def odd(plain: Run) -> Run:
    """Hide the bias in the readings themselves."""
    turn = np.unwrap(np.interp(plain.stamps, plain.pose_stamps, np.unwrap(plain.poses[:, 2])))
    rate = np.gradient(turn, plain.stamps)
    return replace(plain, ranges=plain.ranges + TRUE_BIAS * rate[:, None])


def test_a_further_difference_without_a_name_is_found_once_it_is_listed(
    hall: Arena, robot: Robot, odd: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(UNNAMED, NAME, TURN_RATE)
    finding = diagnose(odd, hall, robot, plan_next=False)
    unknown = finding.channels["scan"].unknown
    assert unknown is not None and unknown.family == NAME
    said = float(unknown.statement.split("off by ")[1].split(" mm")[0]) / 1000
    assert said == pytest.approx(TRUE_BIAS, rel=0.1)
    assert [a.name for a in finding.effects] == []
    (entry,) = finding.ledger.of(NAME)
    assert entry.verdict is Verdict.UNKNOWN and entry.price is not None and entry.price > 0
    assert "was reported as unknown" in finding.why(NAME)


def test_it_is_not_found_where_it_is_not(
    hall: Arena, robot: Robot, plain: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(UNNAMED, NAME, TURN_RATE)
    finding = diagnose(plain, hall, robot, plan_next=False)
    assert finding.channels["scan"].unknown is None
    (entry,) = finding.ledger.of(NAME)
    assert entry.verdict is Verdict.SILENT and entry.facts.evidence is not None and entry.facts.evidence < 0


def test_a_weaker_explanation_of_a_named_effect_has_less_evidence_than_the_effect(
    hall: Arena, robot: Robot, plain: Run
) -> None:
    """To first order, each profile of a bias has more evidence than the bias itself."""
    finding = diagnose(replace(plain, ranges=plain.ranges + 0.02), hall, robot, plan_next=False)
    (bias,) = finding.ledger.of("range_bias")
    assert bias.verdict is Verdict.NAMED and bias.facts.evidence is not None
    for name in ("bias_by_bearing", "bias_by_range"):
        (entry,) = finding.ledger.of(name)
        assert entry.verdict is Verdict.SILENT and entry.facts.evidence is not None
        assert entry.facts.evidence < 0.1 * bias.facts.evidence
        weak = entry.facts.evidence < entry.facts.threshold
        assert ("but it needs" if weak else "parts of the run disagree") in entry.reason


def test_without_it_nobody_knows_its_name(hall: Arena, robot: Robot, plain: Run) -> None:
    finding = diagnose(plain, hall, robot, plan_next=False)
    with pytest.raises(SensorgraphError, match="is no effect or family"):
        finding.why(NAME)


def test_every_kind_has_one_test_and_a_noun_phrase() -> None:
    names = [name for unnamed in UNNAMED.values() for name in unnamed.titles]
    assert len(set(names)) == len(names)
    assert all(title[0].islower() and not title.endswith(".") for title in titles().values())


def test_the_page_lists_each_of_them() -> None:
    page = (Path(__file__).parent.parent / "docs/pages/reference/diagnosis.md").read_text()
    listed = page.split("## Differences without a name")[1].split("\n## ")[0]
    rows = [line for line in listed.splitlines() if line.startswith("| ") and "`" in line]
    kinds = [
        (channel, *kind) for channel in ("scan", "odometry", "drive") for kind in families_of(channel).items()
    ]
    assert rows == [f"| {channel} | `{name}` | {title} |" for channel, name, title in kinds]


@pytest.mark.parametrize(
    ("where", "family"), [("everywhere", "laser_losses"), ("in a sector", "unexplained_misses")]
)
def test_returns_that_are_missing_everywhere_are_the_laser_and_no_surface(
    hall: Arena, robot: Robot, plain: Run, where: str, family: str
) -> None:
    """Losses at random are a property of the laser; those of a sector are said where they are."""
    rng, bearings = np.random.default_rng(5), plain.sensor.bearings
    lost = rng.random(plain.ranges.shape) < (
        0.08 if where == "everywhere" else 0.4 * (np.abs(bearings - 0.7) < 0.3)
    )
    finding = diagnose(
        replace(plain, ranges=np.where(lost, np.inf, plain.ranges)), hall, robot, plan_next=False
    )
    unknown = finding.channels["scan"].unknown
    assert unknown is not None and unknown.family == family
    assert finding.effects == ()
    assert finding.explained is not None
    if where == "everywhere":
        assert finding.explained.final.state.noise.loss == pytest.approx(lost.mean(), abs=0.01)
