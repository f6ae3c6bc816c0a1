"""The ablation takes rules, hypotheses and constants out of verdicts, and counts what changes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from scipy.stats import norm

from benchmarks.ablation import (
    Answer,
    ablate,
    answer,
    main,
    of_size,
    paired_interval,
    priced,
    scaled,
    without_hypothesis,
)
from benchmarks.hidden_effects.results import Case
from sensorgraph.diagnosis.engine.ledger import Competitor, Entry, Ledger
from sensorgraph.diagnosis.engine.verdict import Facts, Objection

ACCEPTED = Facts(
    has_name=True,
    accepted=True,
    evidence=40.0,
    threshold=12.0,
    material_probability=0.9,
    required_probability=0.65,
)
BIAS = Entry(name="range_bias", channel="scan", title="range bias", facts=ACCEPTED)
UNKNOWN = Entry(
    name="scans_elsewhere", channel="scan", title="scans elsewhere", facts=replace(ACCEPTED, has_name=False)
)


def ledger(*entries: Entry) -> Ledger:
    return Ledger(entries=entries)


def case(*names: str, suite: str = "singles") -> Case:
    return Case(
        label="a",
        truth={"suite": suite, "effects": [{"name": name} for name in names]},
        report=None,
        cpu_s=None,
    )


def immaterial(name: str) -> Case:
    return replace(case(), truth={"suite": "singles", "effects": [{"name": name, "material": False}]})


def doubted(entry: Entry, rule: str) -> Entry:
    return replace(entry, facts=replace(entry.facts, objection=Objection(rule, "a reason")))


@pytest.mark.parametrize(
    ("said", "truth", "kind"),
    [
        (Answer(("range_bias",), False), case("range_bias"), "right"),
        (Answer(("range_bias",), True), case("range_bias"), "unknown"),
        (Answer(("range_scale",), False), case("range_bias"), "wrong"),
        (Answer((), False), case("range_bias"), "silent"),
        (Answer((), False), case(suite="none"), "right"),
        (Answer((), True), case(suite="foreign"), "right"),
        (Answer((), False), immaterial("range_bias"), "right"),
        (Answer(("range_bias",), False), immaterial("range_bias"), "right"),
        (Answer(("range_bias",), False), case("range_bias", "tilt", suite="pairs"), "incomplete"),
    ],
)
def test_an_answer_has_a_kind(said: Answer, truth: Case, kind: str) -> None:
    assert said.kind(truth) == kind


def test_a_rule_that_hides_a_right_name_gains_it_when_it_goes() -> None:
    found = ablate([case("range_bias")], [ledger(doubted(BIAS, "site_baseline"))])
    rule = next(e for e in found if e.what == "rule site_baseline out")
    assert (rule.changed, rule.gained, rule.lost, rule.wrong) == (1, 1, 0, 0)


def test_a_rule_that_hides_a_wrong_name_is_worth_its_place() -> None:
    found = ablate([case(suite="none")], [ledger(doubted(BIAS, "site_baseline"))])
    rule = next(e for e in found if e.what == "rule site_baseline out")
    assert (rule.lost, rule.gained, rule.wrong) == (1, 0, 1)


def test_without_an_unknown_its_objections_go() -> None:
    both = ledger(UNKNOWN, doubted(BIAS, "part_of_unknown"))
    assert answer(both) == Answer((), True)
    assert answer(without_hypothesis("scans_elsewhere", both)) == Answer(("range_bias",), False)


def test_without_its_rival_an_effect_is_decided() -> None:
    close = replace(
        BIAS,
        facts=replace(ACCEPTED, lead=1.0, required_lead=3.0),
        rival=Competitor(title="scale error of the range", evidence=39.0),
    )
    rival = replace(BIAS, name="range_scale", title="scale error of the range", facts=Facts(has_name=True))
    assert answer(ledger(close, rival)).names == ()
    assert answer(without_hypothesis("range_scale", ledger(close, rival))).names == ("range_bias",)


def test_limits_scale() -> None:
    assert not scaled("threshold", 4.0, ACCEPTED).accepted
    weak = replace(ACCEPTED, accepted=False, evidence=8.0)
    assert scaled("threshold", 0.5, weak).accepted
    assert not scaled("threshold", 0.5, replace(weak, is_significant=False)).accepted
    assert not scaled("threshold", 0.5, replace(weak, evidence=40.0)).accepted  # another one explains it
    assert scaled("doubt", 0.5, ACCEPTED).required_probability == pytest.approx(0.825)


def test_penalties_and_materiality_scale() -> None:
    weak = replace(BIAS, facts=replace(ACCEPTED, accepted=False, evidence=8.0), price=8.0)
    assert answer(priced(0.5, ledger(weak))).names == ("range_bias",)
    assert answer(priced(2.0, ledger(replace(BIAS, price=30.0)))).names == ()
    chance = float(norm.cdf((0.006 / 0.005 - 1) / (0.001 / 0.005)))  # a materiality of 5 mm
    large = replace(BIAS, parameters={"b": 0.006}, stderr={"b": 0.001})
    usual = replace(large, facts=replace(ACCEPTED, material_probability=chance))
    assert answer(of_size(1.0, ledger(usual))).names == ("range_bias",)
    assert answer(of_size(2.0, ledger(usual))).names == ()
    assert of_size(2.0, ledger(large)) == ledger(large)  # the tolerances of its run were wider than usual


def test_the_paired_interval_holds_zero_if_as_many_move_either_way() -> None:
    low, high = paired_interval(3, 3, 100)
    assert low < 0 < high and low == pytest.approx(-high)
    assert paired_interval(0, 0, 100)[1] == pytest.approx(0.0362, abs=1e-4)
    assert paired_interval(20, 0, 100)[1] < 0


def test_the_command_reads_stored_answers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stored = ledger(doubted(BIAS, "site_baseline"), UNKNOWN)
    for name in ("truth", "answers/sensorgraph/0000"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "truth/0000.json").write_text(json.dumps({"suite": "foreign", "effects": []}))
    report = {"effects": [], "unknown": {"said": True}, "ledger": stored.to_list()}
    (tmp_path / "answers/sensorgraph/0000/report.json").write_text(json.dumps(report))
    main([str(tmp_path), "--json", str(tmp_path / "out.json")])
    printed = capsys.readouterr().out
    assert "1 cases: 1 right" in printed and "disagree on the names in 0 cases" in printed
    rows = {one["what"]: one for one in json.loads((tmp_path / "out.json").read_text())["changes"]}
    assert rows["rule site_baseline out"]["lost"] == rows["hypothesis scans_elsewhere out"]["lost"] == 1


def test_folders_without_answers_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([str(tmp_path)])
    assert "no answer of sensorgraph with a ledger" in capsys.readouterr().err
