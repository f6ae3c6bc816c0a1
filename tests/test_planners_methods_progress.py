"""Progress of a plan counts bins, and its clock starts when the search does: compiling is no part of the rate."""

from __future__ import annotations

import re

import pytest
from planners_samples import door_arena

from planners import plan
from planners.vehicle import Vehicle
from sensorgraph.cli import progress as told

pytestmark = pytest.mark.usefixtures("narrow_search")


def test_progress_starts_at_no_bin_and_ends_at_all_that_are_wanted() -> None:
    said: list[tuple[int, int]] = []
    made = plan(
        door_arena(0.9),
        Vehicle(),
        cell=0.5,
        headings=4,
        progress=lambda done, total: said.append((done, total)),
    )
    totals = {total for _, total in said}
    assert said[0][0] == 0
    assert len(totals) == 1
    bins = made.report["reachable_cells"]
    assert bins <= totals.pop() <= 1.3 * bins  # cells that all but count are wanted too


def test_what_is_planned_is_said_and_how_good_it_is() -> None:
    said: list[str] = []
    made = plan(door_arena(0.9), Vehicle(), cell=0.5, headings=4, status=said.append)
    told_ratios = [float(word) for text in said for word in re.findall(r", ([0-9.]+) of the reference", text)]
    assert said[0].startswith("searching") and said[-1] == "checking the drive"
    assert told_ratios[-1] == pytest.approx(made.report["ratio"], rel=0.35)  # joins and repairs come after


def test_what_is_worked_on_stands_beside_the_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(told.PlainLines, "last", -100.0)
    with told.progress_with_status("planning", "bins") as (tick, set_status):
        set_status("searching 3 rooms")
        tick(10, 40)
    assert capsys.readouterr().err == "planning, searching 3 rooms: 10 of 40 bins\n"


def test_what_comes_before_the_first_tick_says_nothing_of_the_time_left(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A minute of compiling, then 100 bins a second."""
    clock = [0.0]
    monkeypatch.setattr(told.time, "monotonic", lambda: clock[0])
    told.reset_silence()
    with told.progress("planning", "bins") as tick:
        clock[0] = 60.0
        tick(0, 2000)
        clock[0] = 70.0
        tick(1000, 2000)
    said = "planning: 0 of 2,000 bins\nplanning: 1,000 of 2,000 bins, 100/s, 10 s left\n"
    assert capsys.readouterr().err == said
