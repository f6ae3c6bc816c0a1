"""The ledger of a diagnosis: complete, consistent with the report, and able to explain each of its verdicts."""

from __future__ import annotations

import ast
import json
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_samples import ROBOT, make_run
from scan_samples import ROOM_ROBOT, drive_in_room

from planners.arena import Arena
from sensorgraph.cli import run as cli
from sensorgraph.diagnosis import engine
from sensorgraph.diagnosis.diagnose import diagnose, diagnose_motion
from sensorgraph.diagnosis.engine.ledger import Competitor, Entry, Ledger
from sensorgraph.diagnosis.engine.verdict import DecidedBy, Facts, Objection, Verdict, judge
from sensorgraph.diagnosis.engine.why import paragraph, why
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.ledger import families_of, ledger_of, not_observable
from sensorgraph.diagnosis.report.considered import considered_section, unobservable_line
from sensorgraph.diagnosis.report.data import plain, to_dict
from sensorgraph.diagnosis.report.files import save_report
from sensorgraph.diagnosis.result import ChannelResult, Rival, Unknown, Withdrawn
from sensorgraph.effects import EFFECTS
from sensorgraph.errors import SensorgraphError
from sensorgraph.world.robot import parse_robot

NAMED = Facts(has_name=True, accepted=True, evidence=40.0, threshold=12.0)


@pytest.fixture(scope="module")
def found(room: Arena) -> Finding:
    return diagnose(drive_in_room(room, bias=0.03), room, parse_robot(ROOM_ROBOT), plan_next=False)


@pytest.fixture(scope="module")
def silent(room: Arena) -> Finding:
    return diagnose(drive_in_room(room), room, parse_robot(ROOM_ROBOT), plan_next=False)


@pytest.mark.parametrize("which", ["found", "silent"])
def test_each_effect_and_each_family_is_in_the_ledger_once(
    which: str, request: pytest.FixtureRequest
) -> None:
    finding: Finding = request.getfixturevalue(which)
    counted = Counter((one.channel, one.name) for one in finding.ledger)
    expected = {(effect.channel, name) for name, effect in EFFECTS.items()}
    channels = ("scan", "odometry", "drive")
    expected |= {(channel, name) for channel in channels for name in families_of(channel)}
    assert set(counted) == expected
    assert set(counted.values()) == {1}
    assert len(set(finding.ledger.names)) == len(expected)  # no name is used by two channels


@pytest.mark.parametrize("which", ["found", "silent"])
def test_verdicts_are_those_of_the_report(which: str, request: pytest.FixtureRequest) -> None:
    finding: Finding = request.getfixturevalue(which)
    said = {verdict: [one.name for one in finding.ledger if one.verdict is verdict] for verdict in Verdict}
    assert sorted(said[Verdict.NAMED]) == sorted(a.name for a in finding.effects)
    assert sorted(said[Verdict.UNDECIDED]) == sorted(a.name for a in finding.undecided)
    unknown = [one.unknown.family for one in finding.channels.values() if one.unknown is not None]
    assert said[Verdict.UNKNOWN] == unknown
    small = [a.name for one in finding.channels.values() for a in one.within_tolerance]
    assert sorted(one.name for one in finding.ledger if one.decided_by is DecidedBy.IMMATERIAL) >= sorted(
        small
    )


def test_a_named_effect_has_its_numbers_and_its_consequence(found: Finding, room: Arena) -> None:
    (entry,) = found.ledger.of("range_bias")
    (a,) = found.effects
    assert entry.parameters == a.parameters and entry.facts.evidence == a.evidence
    assert entry.size["offset_m"] == pytest.approx(0.03, rel=0.1)  # a reading is off by the bias itself
    n_readings = np.isfinite(drive_in_room(room, bias=0.03).ranges).sum()
    assert entry.price is not None  # of one parameter, for the readings that are not held out
    assert 0.5 * np.log(0.8 * n_readings) < entry.price < 0.5 * np.log(n_readings)
    assert entry.alone == pytest.approx(a.evidence, rel=0.1)
    assert "off by 3.1 cm in 100 %" in entry.consequence


@pytest.mark.parametrize("which", ["found", "silent"])
def test_every_entry_is_explained_with_size_and_evidence(which: str, request: pytest.FixtureRequest) -> None:
    finding: Finding = request.getfixturevalue(which)
    for entry in finding.ledger:
        text = finding.why(entry.name)
        assert "size" in text and "evidence" in text and f"({entry.name})" in text
        assert entry.reason in text and "\n" not in paragraph(entry)
        assert entry.estimate in text
    assert finding.why("Range bias") == finding.why("range_bias") == finding.why("range-bias")


def test_a_ledger_survives_json_with_its_verdicts(found: Finding) -> None:
    text = json.dumps(to_dict(found)["ledger"], allow_nan=False)
    kept = Ledger.from_list(json.loads(text))
    assert kept == found.ledger
    assert [one["verdict"] for one in json.loads(text)] == [one.verdict for one in kept]
    assert plain(kept.to_list()) == json.loads(text)
    keys = {"name", "channel", "named_effect", "location", "parameters", "stderr", "evidence_nats",
            "price_nats", "size", "verdict", "reason"}  # fmt: skip
    assert all(keys <= set(one) for one in json.loads(text))


def test_a_verdict_is_a_function_of_its_facts() -> None:
    for facts, expected in {
        NAMED: (Verdict.NAMED, DecidedBy.EVIDENCE),
        replace(NAMED, lead=2.0, required_lead=3.0): (Verdict.UNDECIDED, DecidedBy.CLOSE_RIVAL),
        replace(NAMED, lead=4.0, required_lead=3.0): (Verdict.NAMED, DecidedBy.EVIDENCE),
        replace(NAMED, is_material=False): (Verdict.SILENT, DecidedBy.IMMATERIAL),
        replace(NAMED, material_probability=0.6, required_probability=0.65): (
            Verdict.SILENT,
            DecidedBy.IMMATERIAL,
        ),
        replace(NAMED, material_probability=0.7, required_probability=0.65): (
            Verdict.NAMED,
            DecidedBy.EVIDENCE,
        ),
        replace(NAMED, objection=Objection("clutter", "people pass")): (Verdict.SILENT, DecidedBy.OBJECTION),
        replace(NAMED, has_name=False): (Verdict.UNKNOWN, DecidedBy.EVIDENCE),
        replace(NAMED, accepted=False): (Verdict.SILENT, DecidedBy.BEATEN),
        replace(NAMED, accepted=False, is_significant=False): (Verdict.SILENT, DecidedBy.WEAK),
        replace(NAMED, accepted=False, evidence=5.0): (Verdict.SILENT, DecidedBy.WEAK),
        Facts(has_name=True, not_observable="no floor in view"): (Verdict.SILENT, DecidedBy.NOT_OBSERVABLE),
        Facts(has_name=True, not_tried="no start"): (Verdict.SILENT, DecidedBy.NOT_TRIED),
    }.items():
        assert judge(facts) == expected, facts


def test_the_engine_knows_no_robot() -> None:
    for path in Path(engine.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(
                ("sensorgraph", "logs", "planners")
            ):
                assert (node.module or "").startswith(("sensorgraph.diagnosis.engine", "sensorgraph.errors"))


def test_the_runner_up_and_the_missing_readings_are_said() -> None:
    weak = replace(NAMED, accepted=False, evidence=4.0)
    rival = Competitor(title="mirror", evidence=300.0, separates="a view along the wall")
    entry = Entry(name="glass", channel="scan", title="glass pane", facts=weak, price=8.0, estimate="a = 1 m")
    text = why(Ledger(entries=(entry,)), "glass")
    assert "4 nats, but it needs 12 nats" in text
    beaten = replace(entry, facts=replace(weak, evidence=40.0), rival=rival)
    assert "mirror explains the same data better (300 nats)" in paragraph(beaten)
    assert "a view along the wall" in paragraph(beaten)
    needs = replace(entry, needs="residuals that vary with incidence")
    assert "1.7 times as many such readings would suffice" in paragraph(needs)  # (12 + 8) / (4 + 8)


def test_effects_that_lost_their_name_keep_the_reason() -> None:
    a = replace(EFFECTS["wheel_base"](s=0.02), evidence=30.0)
    taken = ChannelResult(channel="odometry", effects=(a,)).without(
        {0: Objection("floor", "the floor may imitate it")}
    )
    assert taken.effects == () and [one.amendment for one in taken.withdrawn] == [a]
    (entry,) = ledger_of({"odometry": taken}).of("wheel_base")
    assert entry.verdict is Verdict.SILENT and entry.reason == "the floor may imitate it"
    rival = Rival(name="wheel_radius", instead_of="wheel_base", evidence_nats=28.0, separates="a spin")
    open_ = ChannelResult(channel="odometry", undecided=(a,), rivals=(rival,))
    (entry,) = ledger_of({"odometry": open_}).of("wheel_base")
    assert entry.verdict is Verdict.UNDECIDED and "wheel radius" in entry.reason
    assert Withdrawn(amendment=a, objection=Objection("floor", "")).amendment is a


def test_a_channel_that_tried_nothing_says_why() -> None:
    elsewhere = ChannelResult(channel="scan", unknown=Unknown(statement="the arena is of another place"))
    skipped = ChannelResult(channel="drive", skipped="the run has no commands")
    calibrated = ChannelResult(channel="odometry", notes={"calibration": "from driving alone"})
    ledger = ledger_of({one.channel: one for one in (elsewhere, skipped, calibrated)})
    reasons = {
        "scan": "not tried: the arena is of another place",
        "drive": "not tried: the run has no commands",
        "odometry": "not tried: the calibration from driving alone shows no material size",
    }
    (unknown,) = [one for one in ledger if one.verdict is Verdict.UNKNOWN]
    assert unknown.estimate == "the arena is of another place" and unknown.channel == "scan"
    assert unknown.reason == "no effect of the library explains it"
    for one in ledger:
        if one is not unknown:
            assert one.reason == reasons[one.channel]
    assert {effect.channel for effect in EFFECTS.values()} == set(reasons)


def test_wheels_and_motors_are_explained_too() -> None:
    run = make_run(3, radius=0.03, lag=0.08)
    odometry, drive = diagnose_motion(run, ROBOT, ())
    ledger = ledger_of({"odometry": odometry, "drive": drive})
    (radius,), (lag,), (base,) = (ledger.of(name) for name in ("wheel_radius", "actuator_lag", "wheel_base"))
    assert radius.verdict is lag.verdict is Verdict.NAMED
    assert radius.size["drift_m_per_minute"] > 0.05 and lag.size["speed_m_s"] > 0.0
    assert base.verdict is Verdict.SILENT and base.facts.evidence is not None
    assert base.facts.evidence < base.facts.threshold and np.isfinite(base.stderr["s"])
    tested = [one for one in ledger if not one.facts.has_name and one.facts.evidence is not None]
    assert len(tested) > 15 and all(one.price is not None for one in tested)
    text = json.dumps(plain(ledger.to_list()), allow_nan=False)
    assert Ledger.from_list(json.loads(text)) == ledger


def test_page_and_terminal_say_what_was_considered_and_what_could_not_be_shown(found: Finding) -> None:
    section = considered_section(found.ledger)
    rows = re.findall(r"<tr class='(\w+)'>.*?<code>(\w+)</code>", section)
    assert sorted(name for _, name in rows) == sorted(found.ledger.names)  # each once, most of them folded
    assert rows[0] == ("named", "range_bias")
    folded = dict(re.findall(r"<summary>(\d+) ([^<]+)</summary>", section))
    hidden = not_observable(found.ledger)
    assert str(len(hidden)) in folded
    skipped = [name for name, effect in EFFECTS.items() if found.channels[effect.channel].skipped]
    line = unobservable_line(found)
    assert line.startswith(f"{len(hidden) + len(skipped)} of {len(EFFECTS)} effects are not observable")
    assert all(one.title in line for one in hidden)


@pytest.mark.usefixtures("no_pictures")
def test_command_explains_a_kept_report(
    found: Finding, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_report(found, tmp_path / "out")
    for place in (tmp_path / "out", tmp_path / "out" / "report.json"):
        assert cli(["why", str(place), "range_bias"]) == 0
        assert capsys.readouterr().out.strip() == found.why("range_bias")


@pytest.mark.usefixtures("no_pictures")
def test_command_refuses_what_it_cannot_explain_in_one_line(
    found: Finding, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_report(found, tmp_path)
    old = {key: value for key, value in to_dict(found).items() if key != "ledger"}
    (tmp_path / "old.json").write_text(json.dumps(plain(old)))
    (tmp_path / "damaged.json").write_text(json.dumps({"effects": [], "ledger": [{"name": "glass"}]}))
    (tmp_path / "other.json").write_text("[]")
    (tmp_path / "text.json").write_text("glass")
    for words, said in {
        (tmp_path, "glas"): "did you mean glass?",
        (tmp_path, "nothing like it"): "expected one of: range_bias",
        (tmp_path / "old.json", "glass"): "has no ledger, as of an older version",
        (tmp_path / "damaged.json", "glass"): "is damaged",
        (tmp_path / "other.json", "glass"): "is not a report",
        (tmp_path / "text.json", "glass"): "is not JSON",
        (tmp_path / "none", "glass"): "does not exist",
    }.items():
        assert cli(["why", *map(str, words)]) == 2
        text = capsys.readouterr().err.strip()
        assert said in text and "\n" not in text
    with pytest.raises(SensorgraphError, match="did you mean mirror"):
        found.why("miror")


def test_the_evidence_expected_of_a_material_size_is_that_of_a_run_with_it(
    silent: Finding, room: Arena
) -> None:
    (absent,) = silent.ledger.of("range_bias")
    planted = EFFECTS["range_bias"].sizes["b"]
    finding = diagnose(drive_in_room(room, bias=planted), room, parse_robot(ROOM_ROBOT), plan_next=False)
    (present,) = finding.ledger.of("range_bias")
    assert absent.at_materiality is not None and absent.price is not None
    assert present.facts.evidence is not None
    scatter = np.sqrt(2 * (absent.at_materiality + absent.price))  # of a log-likelihood ratio
    assert abs(present.facts.evidence - absent.at_materiality) < 3 * scatter


def test_a_material_size_is_ruled_out_by_two_standard_errors() -> None:
    odometry, drive = diagnose_motion(make_run(3, radius=0.03), ROBOT, ())
    ledger = ledger_of({"odometry": odometry, "drive": drive})
    judged = [one for one in ledger if one.at_materiality is not None]
    assert any(one.is_ruled_out for one in judged)
    for one in judged:
        if one.is_ruled_out:
            (name,) = EFFECTS[one.name].sizes
            assert abs(one.parameters[name]) + 2 * one.stderr.get(name, 0.0) < EFFECTS[one.name].sizes[name]
            assert one.at_materiality is not None and one.at_materiality > 12
        assert one.is_ruled_out == ("ruled out" in paragraph(one))
        assert "evidence" in paragraph(one)
