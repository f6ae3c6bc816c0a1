"""The blind world of hidden effects: it repeats itself to the byte, and its logs mean what its truth says."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from blind_cases import spread_over_sigma
from conftest import further

import benchmarks.hidden_effects as hidden_effects
from benchmarks.hidden_effects import command, results, score
from benchmarks.hidden_effects.case import Case, Spec, save
from benchmarks.hidden_effects.library import LIBRARY
from benchmarks.hidden_effects.worlds.blind import cases, effects, rooms, setups
from benchmarks.hidden_effects.worlds.blind.cases import draw, make, names_of

EFFECTS = {
    **dict.fromkeys(LIBRARY, "singles"),
    **dict.fromkeys(effects.DEVELOPMENT, "foreign"),
    **dict.fromkeys(effects.REPORT, "foreign"),
}


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let cases be short drives in one room, however dull."""
    monkeypatch.setattr(setups, "PLANS", {"lab": rooms.PLANS["lab"]})
    monkeypatch.setattr(setups, "SHORTEST", 12.0)
    monkeypatch.setattr(setups, "LONGEST", 12.0)
    monkeypatch.setattr(cases, "check_variety", lambda setup, driven: None)


def test_kinds_of_the_report_are_not_those_of_development() -> None:
    assert len(effects.DEVELOPMENT) == 30 and len(effects.REPORT) == 15
    assert not set(effects.DEVELOPMENT) & set(effects.REPORT)
    readme = (Path(hidden_effects.__file__).parent / "README.md").read_text()
    assert all(f"`{name}`" in readme for name in effects.NOTES)


def test_any_35_singles_hold_each_effect_once() -> None:
    assert len(LIBRARY) == 35
    for first in (0, 17, 40):
        names = [names_of(Spec(suite="singles", index=first + k))[0][0] for k in range(35)]
        assert sorted(names) == sorted(LIBRARY)
    foreign_specs = [Spec(suite="foreign", index=k) for k in range(60)]
    made = {(names_of(spec)[0], spec.background_in_turn(names_of(spec)[1])) for spec in foreign_specs}
    assert len(made) == 60  # clean and dirty


@pytest.mark.slow
def test_same_arguments_give_the_same_bytes(brief: None, tmp_path: Path) -> None:
    def run(folder: str, first: int, n: int) -> None:
        for k in range(n):
            spec = Spec(suite="singles", index=first + k)
            command.make_and_save(
                "blind", spec, tmp_path / folder, len([*tmp_path.glob(f"{folder}/truth/*")])
            )

    run("one", 3, 2)
    run("two", 4, 1)
    run("two", 3, 1)  # added as the next number
    for first, second in (("0000", "0001"), ("0001", "0000")):
        for name in ("run.mcap", "arena.geojson", "robot.yaml"):
            one, two = (tmp_path / "one/cases" / first / name, tmp_path / "two/cases" / second / name)
            assert one.read_bytes() == two.read_bytes()
        truths = [tmp_path / "one/truth" / f"{first}.json", tmp_path / "two/truth" / f"{second}.json"]
        assert truths[0].read_bytes() == truths[1].read_bytes()


def test_an_empty_clean_case_fits_its_map(brief: None, tmp_path: Path) -> None:
    save(make(Spec(suite="none", index=0, background="clean")), tmp_path, 0)
    case = tmp_path / "cases" / "0000"
    assert 0.95 < spread_over_sigma(case) < 1.15  # poses are off by 1 to 3 mm, and a few mrad at range


def _without(spec: Spec, attempt: int, monkeypatch: pytest.MonkeyPatch) -> Case:
    """Return the case of the same draws without what is hidden."""
    drawn = setups.draw_setup

    def emptied(names: tuple[str, ...], *, is_dirty: bool, rng: np.random.Generator) -> setups.Setup:
        setup = drawn((spec.effect,), is_dirty=is_dirty, rng=rng)
        setup.hidden, setup.built = {}, setup.built_plain
        return setup

    monkeypatch.setattr(cases, "draw_setup", emptied)
    key = [cases.ROOT_SEED, cases.SUITES.index(spec.suite), 0, spec.index, 0, attempt]
    nothing = Spec(suite="none", index=0, background="clean")
    return draw(nothing, (), np.random.default_rng(key), is_dirty=False)


QUICK = list(EFFECTS)[::4]


@pytest.mark.parametrize("name", [*QUICK, *further(*(name for name in EFFECTS if name not in QUICK))])
def test_each_effect_changes_the_run(name: str, brief: None, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = Spec(suite=EFFECTS[name], index=0, background="clean", effect=name)
    case = make(spec)
    told = case.truth["foreign_effect"] if EFFECTS[name] == "foreign" else case.truth["effects"][0]
    assert told["name"] == name and told["material"]
    assert told["materiality_ratio"] is None or told["materiality_ratio"] > 1.5
    plain = _without(spec, case.truth["made"]["attempt"], monkeypatch)
    one, other = case.log, plain.log
    changed = {
        "scan": not np.array_equal(one.ranges, other.ranges),
        "pose": not np.array_equal(one.poses, other.poses),
        "odometry": not np.array_equal(one.odometry.twists, other.odometry.twists),
        "drive": not np.array_equal(one.commands, other.commands),
    }
    assert changed[told["channel"]]
    if told["channel"] in ("scan", "pose"):  # the drive is the same, to the bit
        assert [channel for channel, is_changed in changed.items() if is_changed] == [told["channel"]]
    assert case.map == plain.map and case.robot == plain.robot  # neither gives it away


def test_answers_that_repeat_the_truth_are_scored_as_right(brief: None, tmp_path: Path) -> None:
    specs = [Spec(suite="none", index=0), Spec(suite="pairs", index=3), Spec(suite="foreign", index=1)]
    specs += [
        Spec(suite="singles", index=0, effect=name) for name in ("moved_wall", "wheel_slip", "mount_xy")
    ]
    for number, spec in enumerate(specs):
        save(make(spec), tmp_path, number)
        truth = json.loads((tmp_path / "truth" / f"{number:04d}.json").read_text())
        answer = {
            "effects": [one | {"stderr": dict.fromkeys(one["parameters"], 0.0)} for one in truth["effects"]],
            "unknown": truth["foreign"],
        }
        folder = tmp_path / "answers" / "oracle" / f"{number:04d}"
        folder.mkdir(parents=True)
        (folder / "report.json").write_text(json.dumps(answer))
    read = results.load([tmp_path], "oracle")
    assert [one.suite for one in read] == [spec.suite for spec in specs]
    assert score.failures(read) == []
    assert all(one.is_material for one in read if one.hidden)
    assert score.text(read)
