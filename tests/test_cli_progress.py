"""Progress of long work: every stage is named, and the time left follows from what was done since it began."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from test_building_sweep import run_of

import logs
from sensorgraph.building.build import build
from sensorgraph.cli import progress as shown
from sensorgraph.cli import run as command
from sensorgraph.types import Progress


def test_every_stage_of_a_build_is_named_and_ends_at_all_of_it() -> None:
    stages: dict[str, list[tuple[int, int]]] = {}

    @contextmanager
    def bar(label: str, unit: str) -> Iterator[Progress]:
        ticks = stages.setdefault(label, [])
        yield lambda done, total: ticks.append((done, total))

    build([run_of(0, duration=12.0)], progress=bar, calibrate=True)
    assert list(stages) == ["reading scans", "fitting faces", "testing the laser", "calibrating the laser"]
    for label, ticks in stages.items():
        done = [n for n, _ in ticks]
        assert done[0] == 0 and (np.diff(done) >= 0).all(), label
    for label in ("reading scans", "fitting faces", "calibrating the laser"):
        assert stages[label][-1][0] == stages[label][-1][1], label


def test_time_left_follows_from_what_was_done_since_the_stage_began(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 100.0
    monkeypatch.setattr(shown.time, "monotonic", lambda: now)
    monkeypatch.setattr(shown.PlainLines, "last", 99.0)
    with shown.progress("reading", "scans") as tick:
        tick(1000, 4000)  # done before the clock started
        now = 110.0
        tick(2000, 4000)
    assert "reading: 2,000 of 4,000 scans, 100/s, 20 s left" in capsys.readouterr().err
    now = 116.0
    with shown.progress("tracking", "scans") as tick:
        for _ in range(3):  # each pass takes 10 s, and the last one is not over
            tick(0, 1000)
            now += 8.0
            tick(800, 1000)
            now += 2.0
    assert capsys.readouterr().err.splitlines()[1:] == ["tracking: 800 of 1,000 scans, 100/s, 2 s left"] * 3
    with shown.progress("fitting", "%") as tick:
        now += 6.0
        tick(0, 100)
    assert capsys.readouterr().err == "fitting: 0 %\n"  # named, though nothing of it is done


def test_a_stage_that_counts_nothing_is_named_while_it_lasts(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shown, "PLAIN_EVERY", 0.05)
    with shown.progress("thinking"):
        time.sleep(0.3)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) >= 2 and set(lines) == {"thinking: 0 s so far"}
    time.sleep(0.2)
    assert not capsys.readouterr().err  # it is over


def test_reading_shows_a_share_whatever_a_format_counts(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shown.PlainLines, "last", -100.0)
    with shown.reading_bar() as tick:
        tick(30_000_000, 75_897_781)
    assert capsys.readouterr().err == "reading: 39 %\n"


def test_build_says_before_it_fits_what_the_log_makes_hard(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = run_of(0, duration=8.0)
    odometry = type(run)(**{**run.__dict__, "pose_stamps": np.zeros(0), "poses": np.zeros((0, 3))})
    logs.write(odometry, tmp_path / "run.mcap")

    def stop(*given: object, **options: object) -> None:
        raise logs.LogError("fitting begins here")

    monkeypatch.setattr("sensorgraph.building.build.build", stop)
    arguments = ["build", str(tmp_path / "run.mcap"), "--poses", "log", "-o", str(tmp_path / "g.sensorgraph")]
    assert command(arguments) == 2
    said = capsys.readouterr()
    assert re.search(r"run.mcap: the laser sweeps for 0.2 s; each ray gets its own pose", said.out)
    assert "warning: run.mcap: the poses are odometry, which drifts and distorts a map" in said.err
