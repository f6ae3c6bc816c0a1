"""A fleet: limits of each log, results kept by content, changes by evidence, and a page that opens from disk."""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import further

import logs
import sensorgraph as sg
from logs.run import Run
from sensorgraph.cli import run as cli
from sensorgraph.errors import SensorgraphError
from sensorgraph.surveying import limited
from sensorgraph.surveying.causes import Series, changes_of_wheels
from sensorgraph.surveying.cluster import cluster, task
from sensorgraph.surveying.limited import (
    TaskError,
    TaskKilledError,
    TaskLimitError,
    TaskLimits,
    run_limited,
)
from sensorgraph.surveying.quantities import LABELS
from sensorgraph.surveying.result import Fleet
from sensorgraph.surveying.store import ResultStore, find_logs
from sensorgraph.surveying.trends import SPREAD, SURE, odd_robots, steps_of
from sensorgraph.surveying.worker import _answer


def series(rng: np.random.Generator, n: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """Return values of a robot without a change, and their standard errors."""
    sigmas = rng.uniform(0.002, 0.008, n)
    return 1 + rng.normal(0, 0.003) + sigmas * rng.standard_t(4, n) / np.sqrt(2), sigmas


def test_no_change_is_invented_and_logs_may_scatter_more_than_their_errors() -> None:
    rng = np.random.default_rng(0)
    found = []
    for k in range(20):
        values, sigmas = series(rng)
        values = values + (k % 2) * rng.normal(0, 0.006, len(values))
        found += [
            one for one in steps_of("way_scale", np.arange(20.0), values, sigmas) if one.probability > SURE
        ]
    assert not found


def test_a_step_is_found_with_its_place_and_size() -> None:
    values, sigmas = series(np.random.default_rng(1))
    values[12:] -= 0.03
    [step] = steps_of("way_scale", np.arange(20.0), values, sigmas)
    assert step.before == 11 and not step.is_drift and step.probability > SURE
    assert abs(step.size + 0.03) < 3 * step.sigma


def test_two_steps_are_found_in_one_robot() -> None:
    values, sigmas = series(np.random.default_rng(2), 30)
    values[10:] += 0.04
    values[20:] -= 0.08
    found = steps_of("way_scale", np.arange(30.0), values, sigmas)
    assert sorted(one.before for one in found) == [9, 19]


def test_slow_wear_is_a_drift() -> None:
    values, sigmas = series(np.random.default_rng(3), 30)
    values -= np.linspace(0, 0.05, 30)
    [drift] = steps_of("way_scale", np.arange(30.0), values, sigmas)
    assert drift.is_drift and abs(drift.size + 0.05) < 3 * drift.sigma


def test_a_robot_differs_from_its_sisters_only_if_it_does() -> None:
    rng = np.random.default_rng(4)
    same = {f"amr{k}": (float(rng.normal(0, 0.002)), 0.002) for k in range(10)}
    assert not [one for one in odd_robots("mount_phi", same) if one.probability > SURE]
    [odd] = odd_robots("mount_phi", same | {"amr10": (0.05, 0.002)})
    assert odd.robot == "amr10" and odd.probability > SURE and abs(odd.size - 0.05) < 3 * odd.sigma


def wheels(
    change: tuple[int, float, float, float], n: int = 20, way_error: float = 0.006
) -> dict[str, Series]:
    """Return the series of a robot whose wheels and base change by shares at a log: (log, left, right, base).

    A wheel that is smaller by a share rolls so much less: written from the wheels' ways alone.
    """
    rng, (at, left, right, base) = np.random.default_rng(7), change
    t = np.arange(n, dtype=float)
    rolls_left, rolls_right, b = (np.where(t >= at, 1 + one, 1.0) for one in (left, right, base))
    errors = {"way_scale": way_error, "wheel_difference": 0.002, "turn_scale": 0.008}
    means = {
        "way_scale": (rolls_left + rolls_right) / 2,
        "wheel_difference": rolls_right - rolls_left,
        "turn_scale": (rolls_left + rolls_right) / 2 / b,
    }
    d = {name: mean + errors[name] * rng.normal(size=n) for name, mean in means.items()}
    d |= {
        "left_wheel": d["way_scale"] - d["wheel_difference"] / 2,
        "right_wheel": d["way_scale"] + d["wheel_difference"] / 2,
    }
    errors |= {"left_wheel": way_error, "right_wheel": way_error}
    return {name: Series(t=t, values=one, sigmas=np.full(n, errors[name])) for name, one in d.items()}


@pytest.mark.parametrize(
    ("change", "cause", "size"),
    [
        ((9, -0.03, 0.0, 0.0), "left_wheel", -0.03),
        ((12, 0.0, -0.03, 0.0), "right_wheel", -0.03),
        ((9, -0.03, -0.03, 0.0), "way_scale", -0.03),
        ((9, 0.0, 0.0, 0.04), "turn_scale", -0.04),
    ],
)
def test_a_change_of_the_wheels_is_one_change_with_its_cause(
    change: tuple[int, float, float, float], cause: str, size: float
) -> None:
    [found] = changes_of_wheels(wheels(change))
    assert found.step.quantity == cause and found.t == change[0] - 1
    assert abs(found.step.size - size) < 4 * found.step.sigma < 0.02


def test_which_wheel_changed_is_not_said_where_the_distance_does_not_show_it() -> None:
    found = changes_of_wheels(
        {
            name: one
            for name, one in wheels((9, -0.02, 0.0, 0.0), way_error=0.2).items()
            if name != "turn_scale"
        }
    )
    assert [one.step.quantity for one in found] == ["wheel_difference"]
    assert abs(found[0].step.size - 0.02) < 4 * found[0].step.sigma


def test_two_wheels_that_change_on_two_days_are_two_changes() -> None:
    one, two = wheels((8, -0.03, 0.0, 0.0), 30), wheels((20, 0.0, -0.04, 0.0), 30)
    base = wheels((30, 0.0, 0.0, 0.0), 30)
    both = {
        name: replace(one[name], values=one[name].values + two[name].values - base[name].values)
        for name in base
    }
    found = sorted(changes_of_wheels(both), key=lambda change: change.t)
    assert [(change.step.quantity, change.t) for change in found] == [
        ("left_wheel", 7.0),
        ("right_wheel", 19.0),
    ]
    assert all("wheel_difference" in change.seen_in for change in found)


def test_every_quantity_has_a_name_and_a_prior() -> None:
    assert LABELS.keys() == SPREAD.keys()


def test_a_hang_a_crash_and_a_full_memory_cost_only_their_task() -> None:
    limits = TaskLimits(seconds=2.0, megabytes=1500)
    assert run_limited("builtins:len", {"a": 1}, limits) == 1
    begin = time.monotonic()
    with pytest.raises(TaskError, match="takes more than 2 s"):
        run_limited("fleet_tasks:hang", {}, limits)
    assert time.monotonic() - begin < 30
    with pytest.raises(TaskError, match="crashed"):
        run_limited("fleet_tasks:crash", {}, limits)
    with pytest.raises(TaskError, match="needs more than 1500 MB"):
        run_limited("fleet_tasks:grow", {}, limits)
    with pytest.raises(TaskError, match="ZeroDivisionError"):
        run_limited("fleet_tasks:fail", {}, limits)
    assert run_limited("builtins:len", {"a": 1, "b": 2}, limits) == 2


def test_an_interrupt_does_not_wait_for_running_logs() -> None:
    pytest.importorskip("distributed")
    limits, others = TaskLimits(seconds=90.0, megabytes=1500), set(limited._all)
    with pytest.raises(KeyboardInterrupt), cluster(None, 1) as client:
        futures = [client.submit(run_limited, "fleet_tasks:hang", {}, limits, pure=False) for _ in range(3)]
        until = time.monotonic() + 60
        while not any(worker.n_tasks for worker in limited._all - others):
            assert time.monotonic() < until
            time.sleep(0.1)
        begin = time.monotonic()
        raise KeyboardInterrupt
    assert time.monotonic() - begin < 30  # each task hangs for 90 s
    assert len(futures) == 3 and not limited._all
    assert run_limited("builtins:len", {"a": 1}, limits) == 1  # the next call starts processes again


@pytest.fixture(autouse=True)
def tasks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put a module with misbehaving tasks on the path of other processes."""
    (tmp_path / "fleet_tasks.py").write_text(
        "import os, time\n"
        "def hang(_): time.sleep(100)\n"
        "def crash(_): os.abort()\n"
        "def grow(_): return len(bytearray(2_000_000_000))\n"
        "def fail(_): return 1 / 0\n"
    )
    root = Path(__file__).parent.parent
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{root}")


def test_logs_are_found_in_folders_and_by_patterns(tmp_path: Path) -> None:
    (tmp_path / "a" / "bag").mkdir(parents=True)
    for name in ("a/x.mcap", "a/notes.txt", "a/bag/metadata.yaml", "a/bag/0.db3", "y.log.gz"):
        (tmp_path / name).write_text("")
    found = [tmp_path / "a" / "bag", tmp_path / "a" / "x.mcap", tmp_path / "y.log.gz"]
    assert find_logs([tmp_path]) == find_logs([tmp_path, tmp_path / "a" / "x.mcap"]) == found
    assert find_logs([str(tmp_path / "a" / "*.mcap")]) == found[1:2]
    (tmp_path / "none").mkdir()
    with pytest.raises(SensorgraphError, match="no log in"):
        find_logs([tmp_path / "none"])
    with pytest.raises(SensorgraphError, match="does not exist"):
        find_logs([tmp_path / "missing"])


def test_results_are_kept_by_content_and_settings(tmp_path: Path) -> None:
    log, copy = tmp_path / "a.mcap", tmp_path / "b.mcap"
    log.write_bytes(b"one")
    copy.write_bytes(b"one")
    store = ResultStore.open(tmp_path, {"version": "1"})
    key = store.key(log)
    assert store.key(copy) == key
    store.put(key, {"robot": "r"})
    assert ResultStore.open(tmp_path, {"version": "1"}).get(key) == {"robot": "r"}
    newer = ResultStore.open(tmp_path, {"version": "2"})
    assert newer.get(key) is None and newer.others([key]) == 1
    log.write_bytes(b"two!")
    assert newer.key(log) != key


@cache
def recorded() -> Run:
    """Return a drive through four viewpoints."""
    return sg.record(sg.plan("square", views=4))


def surveyed_here(work: str, arguments: dict[str, Any], _: TaskLimits) -> Any:
    """Run a task in this process, with the answers of the process that it has otherwise: 4 s of imports less."""
    answer = json.loads(json.dumps(_answer({"work": work, "arguments": arguments})))
    if "error" in answer:
        raise TaskError(answer["error"])
    return answer["result"]


@pytest.mark.parametrize("has_own_process", [False, *further(True)])
def test_a_fleet_is_one_table_and_a_second_call_analyses_only_new_logs(
    has_own_process: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    if not has_own_process:
        monkeypatch.setattr("sensorgraph.surveying.cluster.run_limited", surveyed_here)
    bags = tmp_path / "bags"
    bags.mkdir()
    run = recorded()
    without = replace(run, pose_stamps=np.zeros(0), poses=np.zeros((0, 3)))
    logs.write(without, bags / "monday.mcap")
    whole = (bags / "monday.mcap").read_bytes()
    (bags / "again.mcap").write_bytes(whole)
    (bags / "broken.mcap").write_bytes(whole[:3000])
    out = tmp_path / "fleet"
    found = sg.fleet(bags, out, places="square", workers=1)
    [row] = found.rows
    assert row["robot"] == "radix" and row["ok_share"] > 0.9 and row["day"] == "2024-01-01"
    value, sigma = row["quantities"]["left_wheel"]
    assert abs(value - 1) < 4 * sigma
    assert not found.changes and len(found.failures) == 1 and found.failures[0][0].endswith("broken.mcap")
    assert len(found.same) == 1 and found.n_new == 2
    table = list(csv.DictReader((out / "fleet.csv").read_text().splitlines()))
    assert {one["robot"] for one in table} == {"radix", ""} and any("broken" in one["log"] for one in table)
    page = (out / "fleet.html").read_text(encoding="utf-8")
    assert f"logs/{row['key']}.html" in page and (out / "logs" / f"{row['key']}.html").is_file()
    assert "http://" not in page.replace("http://www.w3.org", "") and "<script" not in page
    second = sg.fleet(bags, out, places="square", workers=1)
    assert second.n_new == 0 and second.rows == found.rows
    assert json.loads((out / "fleet.json").read_text())["rows"][0]["robot"] == "radix"


def in_this_process(monkeypatch: pytest.MonkeyPatch, run: Callable[..., None]) -> None:
    """Let a fleet run its tasks without other processes, which take a second."""

    def here(_: None, jobs: Iterable[tuple[str, dict[str, str]]], limits: TaskLimits) -> Iterator[Any]:
        return ((key, task(arguments, limits)) for key, arguments in jobs)

    monkeypatch.setattr("sensorgraph.surveying.cluster.run_limited", run)
    monkeypatch.setattr("sensorgraph.surveying.fleet.surveyed", here)
    monkeypatch.setattr("sensorgraph.surveying.fleet.cluster", lambda *_: nullcontext())


def test_logs_of_one_robot_at_the_same_time_are_pointed_out() -> None:
    def row(log: str, robot: str, start: float) -> dict[str, Any]:
        return {"log": log, "robot": robot, "epoch_s": start, "length_s": 60.0}

    rows = (
        row("a/1.mcap", "amr", 0.0), row("b/1.mcap", "amr", 30.0), row("a/2.mcap", "amr", 500.0),
        row("b/2.mcap", "amr", 500.0), row("c/1.mcap", "other", 0.0), row("c/2.mcap", "other", 60.0),
    )  # fmt: skip
    found = Fleet(
        rows=rows, failures=(), same=(), changes=(), possible=(), odd=(), n_new=6, n_outdated=0
    )  # one after the other is one robot
    [note] = found.shared_names
    assert note.startswith("a/1.mcap and b/1.mcap overlap in time") and "amr (and 1 more)" in note
    assert f"note: {note}" in found.lines() and "`--name REGEX`" in note


def test_a_fleet_without_a_usable_log_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*_: object) -> None:
        raise TaskError("is no log")

    in_this_process(monkeypatch, fails)
    (tmp_path / "note.txt").write_text("no log")
    assert cli(["fleet", str(tmp_path / "note.txt"), "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr()
    assert "note.txt" in said.out and said.err.splitlines()[-1].startswith("error: no log could be analysed")


def test_only_failures_that_stay_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A log that took too long is analysed again with another limit, and one whose process was killed always."""
    errors = {b"slow": TaskLimitError, b"killed": TaskKilledError, b"bad": TaskError}
    for content in errors:
        (tmp_path / f"{content.decode()}.mcap").write_bytes(content)

    def fails(_: str, arguments: dict[str, str], __: TaskLimits) -> None:
        raise errors[Path(arguments["path"]).read_bytes()]("fails")

    in_this_process(monkeypatch, fails)

    def n_new(seconds: float) -> int:
        return sg.fleet(tmp_path, tmp_path / "out", limits=TaskLimits(seconds=seconds)).n_new

    assert [n_new(1.0), n_new(1.0), n_new(2.0)] == [3, 1, 2]


def test_what_fails_every_log_is_refused_and_an_unreadable_log_is_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "x.mcap").write_bytes(b"x")
    with pytest.raises(SensorgraphError, match="is not a regular expression"):
        sg.fleet(tmp_path, tmp_path / "out", pattern="(amr")
    with pytest.raises(FileNotFoundError):
        sg.fleet(tmp_path, tmp_path / "out", robot=tmp_path / "robot.yaml")

    def denied(*_: object) -> str:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(ResultStore, "key", denied)
    [(log, reason)] = sg.fleet(tmp_path, tmp_path / "out").failures
    assert log.endswith("x.mcap") and reason == "cannot be read: Permission denied"


def test_a_scheduler_that_is_not_there_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("sensorgraph.dask_client.CONNECT_TIMEOUT", 0.5)
    (tmp_path / "x.mcap").write_bytes(b"x")
    with pytest.raises(SensorgraphError, match="no scheduler answers") as caught:
        sg.fleet(tmp_path / "x.mcap", tmp_path / "out", scheduler="tcp://127.0.0.1:9")
    assert "\n" not in str(caught.value)


def test_the_local_cluster_listens_only_on_this_machine() -> None:
    pytest.importorskip("distributed")
    psutil = pytest.importorskip("psutil")

    def listening() -> set[tuple[str, int]]:
        found = psutil.Process().net_connections("tcp")
        return {tuple(one.laddr) for one in found if one.status == psutil.CONN_LISTEN}

    before = listening()
    with cluster(None, 1):
        opened = listening() - before
    assert opened and {address for address, _ in opened} <= {"127.0.0.1", "::1"}
