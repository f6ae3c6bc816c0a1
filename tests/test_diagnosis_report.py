"""The report of a diagnosis says what was found in words, keeps its promises as files, and stands alone."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
import rerun as rr
from report_samples import columns_of, with_scan
from scan_samples import ROOM_ROBOT, drive_in_room
from shapely import box

from planners.arena import Arena
from sensorgraph.demo_effect import HiddenEffect
from sensorgraph.demo_effect import to_dict as hidden_dict
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.report import comparison
from sensorgraph.diagnosis.report.data import to_dict
from sensorgraph.diagnosis.report.files import Diagnosis, save_report
from sensorgraph.diagnosis.report.summary import summarise
from sensorgraph.diagnosis.result import (
    ChannelResult,
    Deviation,
    FitQuality,
    Gap,
    Rival,
    without_close_calls,
)
from sensorgraph.diagnosis.scan_channel import STAGES as DIAGNOSIS_STAGES
from sensorgraph.effects import EFFECTS, effects_file
from sensorgraph.types import Progress
from sensorgraph.world.robot import parse_robot

FILES = {"report.json", "report.html", "effects.yaml", "review.rrd", "timing.json"}
KEYS = {
    "effects", "unknown", "where", "runner_up", "gap", "within_tolerance", "not_observable", "next_run", "intake",
}  # fmt: skip


STAGES: dict[str, list[tuple[int, int]]] = {}
"""Label of each bar that `found` opened -> its ticks."""


@contextmanager
def bar(label: str, unit: str) -> Iterator[Progress]:
    """Record a bar."""
    ticks = STAGES.setdefault(label, [])
    yield lambda done, total: ticks.append((done, total))


@pytest.fixture(scope="module")
def found(room: Arena) -> Finding:
    return diagnose(drive_in_room(room, bias=0.03), room, parse_robot(ROOM_ROBOT), progress=bar)


def test_every_stage_of_a_diagnosis_is_named(found: Finding) -> None:
    named = list(STAGES)
    assert named[:5] == [
        "aligning scans with the arena", "comparing wheels with poses", "comparing commands with wheels",
        "fitting the simulator", "trying effects, round 1",
    ]  # fmt: skip
    assert named[-5:] == [
        "weighing effects", "testing for unexplained structure", "measuring the gap",
        "testing what the run could show", "planning the next run",
    ]  # fmt: skip
    for label in ("trying effects, round 1", "weighing effects"):  # what is counted is counted to the end
        done, total = STAGES[label][-1]
        assert done == total - 1
    assert found.seconds.keys() == set(DIAGNOSIS_STAGES)


@pytest.fixture(scope="module")
def saved(found: Finding, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a saved report."""
    folder = tmp_path_factory.mktemp("report") / "out"
    save_report(found, folder, name="lab.mcap", settings={"seed": 3})
    return folder


def rival_of(finding: Finding, lead: float) -> Rival:
    """Return a rival of the named effect that has so many nats less."""
    [a] = finding.effects
    nats = (a.evidence or 0) - lead
    return Rival(name="range_scale", instead_of=a.name, evidence_nats=nats, separates="near and far")


def external(html: str) -> list[str]:
    """Return what a page loads from elsewhere."""
    found = re.findall(r"(?:src|href)=[\"']?([^\"'> ]+)", html)
    return [v for v in found if not v.startswith(("data:", "#"))]


def test_files_of_a_found_effect_hold_what_the_interface_promises(saved: Path) -> None:
    pictures = {"arena.png", "residuals.png", "gap.png", "next_run.png"}
    assert {path.name for path in saved.iterdir()} == FILES | pictures  # nothing half-written is left
    report = json.loads((saved / "report.json").read_text())
    assert set(report) >= KEYS
    [effect] = report["effects"]
    assert set(effect) >= {"name", "parameters", "stderr", "location", "probability", "evidence_nats"}
    assert effect["name"] == "range_bias"
    assert effect["parameters"]["b"] == pytest.approx(0.03, abs=4 * effect["stderr"]["b"])
    for part in ("before", "after", "noise_floor"):
        assert set(report["gap"][part]) == {"rmse_m", "normalised", "nats_per_ray"}
    assert report["settings"]["seed"] == 3
    assert report["settings"]["version"]


def test_the_page_stands_alone_and_says_it_in_words(saved: Path) -> None:
    html = (saved / "report.html").read_text()
    assert external(html) == []
    assert "<script" not in html
    assert len(html) < 1.5e6
    assert html.count("data:image/png;base64,") == len(list(saved.glob("*.png")))
    assert "Found: range bias, +" in html
    assert "z = r + b" in html
    assert re.search(r"b = \+[23]\.\d+ ± 0\.\d+ cm", html)
    assert "lab.mcap" in html
    assert "no odometry" in html or "not evaluated" in html  # the skipped channels are told


def test_effects_yaml_reads_back_as_found(found: Finding, room: Arena, saved: Path) -> None:
    [a] = effects_file.read(saved / "effects.yaml", room)
    assert (a.name, dict(a.parameters)) == (found.effects[0].name, dict(found.effects[0].parameters))
    assert a.evidence == found.effects[0].evidence


def test_the_recording_holds_three_kinds_of_scans(found: Finding, saved: Path) -> None:
    path, held = str(saved / "review.rrd"), columns_of(saved / "review.rrd")
    for entity in (
        "plan/measured",
        "plan/nominal",
        "plan/amended",
        "gap/amended",
        "residual/nominal",
        "report",
    ):
        assert f"/{entity}" in held, entity
    assert found.explained is not None
    scans = found.explained.null.solver.data.n_scans
    chunks = rr.chunk.RrdReader(path).stream().filter(content="/plan/amended").to_chunks()
    assert sum(c.to_record_batch().num_rows for c in chunks if not c.is_static) == min(scans, 400)
    assert len(rr.chunk.RrdReader(path).blueprints()) == 1


def test_amended_scans_lie_nearer_than_nominal_ones(found: Finding) -> None:
    compared = comparison.compare(found)
    assert compared is not None
    assert compared.is_amended
    before, after = (side.rms(compared.sigma).mean() for side in (compared.before, compared.after))
    assert before > 0.025  # a bias of 3 cm
    assert after < 0.015  # noise of 1 cm


def test_the_picture_shows_the_part_of_a_large_arena_that_the_run_saw(found: Finding, room: Arena) -> None:
    compared = comparison.compare(found)
    assert compared is not None
    x0, y0, x1, y1 = compared.limits
    left, low, right, high = room.bounds
    assert x0 < left and y0 < low and right < x1 and high < y1
    far = np.array([[[left + 60.0, low + 60.0], [left + 61.0, low + 60.0]]])
    building = replace(
        room, free=room.free.union(box(left, low, left + 61, low + 61)), walls=np.concatenate([room.walls, far]),
        names=(*room.names, "far"), surfaces=(*room.surfaces, "wall"),
    )  # fmt: skip
    large = replace(compared, arena=building)
    assert large.limits[2] < left + 1.5 * (right - left)
    seen = large.measured[np.isfinite(large.measured)]
    ends = large.ends(np.flatnonzero(np.isfinite(large.measured)), seen)
    inside = (ends > large.limits[:2]).all(axis=1) & (ends < large.limits[2:]).all(axis=1)
    assert inside.mean() > 0.99


def test_a_script_reads_the_gap_of_the_channel_that_the_headline_is_about(found: Finding) -> None:
    a = replace(EFFECTS["wheel_radius"](s=0.02), evidence=1e6, probability=1.0)
    fit = FitQuality(rmse_m=0.02, normalised=2.0, nats_per_ray=-1.0)
    wheels = Gap(before=fit, after=replace(fit, rmse_m=0.01), noise_floor=fit, n_rays=70)
    deviation = Deviation(
        family="bias", partition="turn", label="left", z=9.0, size=0.1, n_rays=70, channel="odometry"
    )
    odometry = ChannelResult(channel="odometry", effects=(a,), gap=wheels, deviations=(deviation,))
    report = to_dict(replace(found, channels={**found.channels, "odometry": odometry}))
    assert report["gap"]["channel"] == "odometry"
    assert (report["gap"]["unit"], report["gap"]["before"]["rmse_m"]) == ("m/s", 0.02)
    assert report["where"][0]["channel"] == "odometry"
    assert report["channels"]["scan"]["gap"]["channel"] == "scan"
    alone = to_dict(found)
    assert (alone["gap"]["channel"], alone["gap"]["unit"]) == ("scan", "m")
    assert alone["gap"] == alone["channels"]["scan"]["gap"]


def test_the_demo_keeps_what_was_planted_and_what_was_found(found: Finding) -> None:
    kept = hidden_dict(HiddenEffect(planted=EFFECTS["range_bias"](b=0.03), finding=found))
    assert (kept["planted"], kept["planted_parameters"]) == ("range_bias", {"b": 0.03})
    assert kept["found"]["parameters"]["b"] == found.effects[0]["b"]
    assert kept["gap"]["before"]["rmse_m"] > kept["gap"]["after"]["rmse_m"] > 0
    other = hidden_dict(HiddenEffect(planted=EFFECTS["latency"](tau=0.1), finding=found))
    assert other["found"] is None


def test_a_close_runner_up_leaves_it_undecided(found: Finding) -> None:
    close = without_close_calls(replace(found.channels["scan"], rivals=(rival_of(found, 2.0),)))
    what = summarise(replace(found, channels={**found.channels, "scan": close}))
    assert what.outcome == "undecided"
    assert what.headline.startswith("Undecided between range bias")
    assert "near and far" in what.details[0]
    assert summarise(with_scan(found, rivals=(rival_of(found, 50.0),))).outcome == "found"


@pytest.mark.parametrize(("lead", "named"), [(2.0, False), (-2.0, False), (5.0, True), (-40.0, True)])
def test_a_name_that_its_rival_equals_is_no_name(found: Finding, lead: float, named: bool) -> None:
    [a] = found.effects
    result = without_close_calls(replace(found.channels["scan"], rivals=(rival_of(found, lead),)))
    one = replace(found, channels={**found.channels, "scan": result})
    report = to_dict(one)
    assert [e["name"] for e in report["effects"]] == ([a.name] if named else [])
    assert [e["name"] for e in report["undecided"]] == ([] if named else [a.name])
    assert report["runner_up"]["name"] == "range_scale"
    if not named:
        assert summarise(one).headline.startswith("Undecided between range bias")
        also = replace(result, effects=(EFFECTS["range_scale"](s=0.01),), undecided=())
        both = replace(also, effects=(*also.effects, a))
        assert without_close_calls(both).undecided == ()


def test_the_next_run_is_shown_where_one_is_planned(found: Finding, tmp_path: Path) -> None:
    way = np.column_stack([np.linspace(0.5, 3.5, 40), np.full(40, 0.5), np.zeros(40)])
    plan = {
        "why": "drive near and far",
        "questions": ["range_bias or range_scale?"],
        "expected_nats": 340.0,
        "median_random_run_nats": 80.0,
        "duration_s": 120.0,
        "path_m": 9.0,
        "steps": [{"kind": "spin", "place": [0.5, 0.5], "heading": -0.25, "way_m": 0.0}],
    }
    planned = SimpleNamespace(trajectory=SimpleNamespace(poses=way), to_dict=lambda: plan)
    object.__setattr__(found, "next_run", planned)
    try:
        save_report(found, tmp_path)
    finally:
        object.__setattr__(found, "next_run", None)
    html = (tmp_path / "report.html").read_text()
    assert "drive near and far" in html
    assert "<span>expected log Bayes factor [nats]</span>340</div>" in html
    assert "<summary>1 step</summary>" in html
    assert "<td>−14.3°</td>" in html  # not radians without a unit
    assert (tmp_path / "next_run.png").exists()
    assert json.loads((tmp_path / "report.json").read_text())["next_run"] == plan


def test_a_failure_leaves_no_part_behind(
    found: Finding, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: Path, *args: object, **kwargs: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match="No space left"):
        save_report(found, tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("no_pictures")
def test_a_diagnosis_prints_its_headline_and_saves_its_report(
    found: Finding, room: Arena, tmp_path: Path
) -> None:
    diagnosis = Diagnosis.of(found, room, parse_robot(ROOM_ROBOT))
    first, *effects = repr(diagnosis).splitlines()
    assert first.startswith("Diagnosis: Found: range bias")
    table = ElementTree.fromstring(diagnosis._repr_html_())
    assert (table.findtext("caption") or "").startswith("Found: range bias")
    titles = [row.findtext("th") for row in table.findall("tbody/tr")]
    assert titles == [a.effect.title for a in diagnosis.effects]
    assert effects[0].strip().startswith("range_bias(b=0.03")
    written = json.loads((diagnosis.save(tmp_path / "out") / "report.json").read_text())
    assert written["effects"] == json.loads(json.dumps(diagnosis.to_dict()["effects"]))
