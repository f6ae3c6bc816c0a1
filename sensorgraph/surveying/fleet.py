"""`fleet`: survey many logs, keep the results by content, and compare logs of a robot and robots of a fleet."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from sensorgraph.errors import SensorgraphError, as_sensorgraph_error
from sensorgraph.files import atomic_folder
from sensorgraph.loading import open_place
from sensorgraph.localization.locate import walls_of_place
from sensorgraph.robust import MAJORITY
from sensorgraph.surveying.causes import MEASURED, SHOWN_IN, CausedStep, Series, changes_of_wheels
from sensorgraph.surveying.cluster import cluster, surveyed
from sensorgraph.surveying.limited import TaskLimits
from sensorgraph.surveying.page import fleet_page, log_page
from sensorgraph.surveying.parquet import write_parquet
from sensorgraph.surveying.quantities import LABELS, QUANTITIES, quantities_of
from sensorgraph.surveying.rerun_layer import write_layer
from sensorgraph.surveying.result import Fleet, RobotChange
from sensorgraph.surveying.store import ResultStore, find_logs
from sensorgraph.surveying.trends import SURE, OddRobot, level, odd_robots, steps_of
from sensorgraph.types import Progress
from sensorgraph.version import __version__
from sensorgraph.world.robot import load_robot

COLUMNS = (
    "log", "robot", "kind", "day", "length_s", "way_m", "n_scans", "place", "place_fit", "ok_share", "no_return",
)  # fmt: skip
"""Columns of the table before those of the quantities."""


@as_sensorgraph_error
def fleet(
    logs: Path | str | Sequence[Path | str],
    out: Path | str,
    *,
    places: Path | str | Sequence[Path | str] = (),
    robot: Path | str | None = None,
    pattern: str | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    limits: TaskLimits | None = None,
    topics: Mapping[str, str] | None = None,
    progress: Progress | None = None,
) -> Fleet:
    """Survey many logs, and compare the logs of each robot and the robots with each other.

    Results are kept in the output folder by the content of a log, so that a second call analyses only new logs.

    Parameters
    ----------
    logs : Logs, folders with logs, or patterns.
    out : Folder for fleet.html, fleet.csv, fleet.parquet, fleet.json, fleet.rrd, one page for each log, and the kept
        results.
    places : Sensorgraphs or arenas; each log is located in the one that fits. None: each log in its own map.
    robot : robot.yaml of all robots. None: the one kept in each log.
    pattern : Regular expression that finds the robot's name in the path of a log; its first group, if it has one.
    scheduler : Address of a Dask scheduler, whose workers read the same paths. None: a local cluster.
    workers : Number of logs at a time on this machine. None: one for each processor.
    limits : TaskLimits of time and memory of each log.
    topics : Role -> topic.
    progress : Called with the numbers of finished and of all logs.

    Returns
    -------
    Fleet with `rows`, `changes`, `odd` and `failures`.

    Raises
    ------
    SensorgraphError : There is no log, a place is invalid, Dask is missing, or the scheduler does not answer.
    """
    paths = find_logs([logs] if isinstance(logs, str | Path) else list(logs))
    given = [places] if isinstance(places, str | Path) else list(places)
    known = {str(Path(one).absolute() if Path(one).exists() else one): one for one in given}
    walls = {Path(name).name: walls_of_place(open_place(name)).walls for name in known}
    if len(walls) < len(known):
        raise SensorgraphError("two places have the same file name; rename one of them")
    _check(robot, pattern)
    folder, bounds = Path(out), limits or TaskLimits()
    shared = _shared(known, robot, pattern, topics or {})
    store = ResultStore.open(folder, _settings(shared))
    keys, unreadable = _keys(store, paths)
    first = {key: path for path, key in reversed(keys.items())}  # the first path of each content
    done = {key: result for key in first if (result := store.get(key)) is not None}
    # a log that took too long or too much memory is analysed again with other limits
    done = {key: row for key, row in done.items() if row.get("limits") in (None, bounds.as_list())}
    jobs = {key: {**shared, "path": str(path.absolute())} for key, path in first.items() if key not in done}
    n_outdated = store.others(jobs)
    for key, result in _analysed(store, jobs, bounds, scheduler, workers):
        done[key] = result
        if progress is not None:
            progress(len(done), len(first))
    rows = [{"log": str(first[key]), "key": key, **row} for key, row in done.items() if "error" not in row]
    failed = [(str(first[key]), row["error"]) for key, row in done.items() if "error" in row]
    found = _compared(
        rows,
        walls=walls,
        failures=tuple(sorted(unreadable + failed)),
        same=tuple((str(path), str(first[key])) for path, key in keys.items() if first[key] != path),
        n_new=len(jobs),
        n_outdated=n_outdated,
    )
    save(found, folder)
    return found


def _check(robot: Path | str | None, pattern: str | None) -> None:
    """Refuse a robot.yaml and a pattern that would make every log fail."""
    if robot is not None:
        load_robot(robot)
    try:
        re.compile(pattern or "")
    except re.error as exc:
        raise SensorgraphError(
            f"{pattern!r} is not a regular expression: {exc}; expected one such as '(amr[0-9]+)'"
        ) from exc


def _keys(store: ResultStore, paths: Iterable[Path]) -> tuple[dict[Path, str], list[tuple[str, str]]]:
    """Return the hash of each log's content, and the logs that cannot be read, with the reason."""
    keys: dict[Path, str] = {}
    unreadable = []
    for path in paths:
        try:
            keys[path] = store.key(path)
        except OSError as exc:
            unreadable.append((str(path), f"cannot be read: {exc.strerror or exc}"))
    store.keep_contents()
    return keys, unreadable


def _analysed(
    store: ResultStore,
    jobs: Mapping[str, Any],
    limits: TaskLimits,
    scheduler: str | None,
    workers: int | None,
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Analyse logs on the cluster, and yield each result by the hash of its log once it is kept."""
    if not jobs:
        return
    with cluster(scheduler, workers) as client:
        for key, result in surveyed(client, jobs.items(), limits):
            if not result.get("is_passing"):
                store.put(key, result)
            yield key, result


def _compared(rows: list[dict[str, Any]], **facts: Any) -> Fleet:
    """Return the rows by robot and time, with the changes of each robot and the robots that differ."""
    rows.sort(key=lambda row: (row["robot"], row["epoch_s"], row["log"]))
    for row in rows:
        row["day"] = datetime.fromtimestamp(row["epoch_s"], UTC).strftime("%Y-%m-%d")
    changes = _changes(rows)
    return Fleet(
        rows=tuple(rows),
        changes=tuple(one for one in changes if one.probability >= SURE),
        possible=tuple(one for one in changes if MAJORITY <= one.probability < SURE),
        odd=tuple(one for one in _odd(rows, changes) if one.probability >= SURE),
        **facts,
    )


def _shared(
    places: Iterable[str], robot: Path | str | None, pattern: str | None, topics: Mapping[str, str]
) -> dict[str, Any]:
    """Return the arguments of `survey` that all logs share."""
    return {
        "places": list(places),
        "robot": None if robot is None else str(Path(robot).absolute()),
        "pattern": pattern,
        "topics": dict(topics),
    }


def _settings(shared: Mapping[str, Any]) -> dict[str, Any]:
    """Return what decides whether a kept result is used: version, places and robot by their content."""
    stamps = [
        [one, Path(one).stat().st_size, Path(one).stat().st_mtime_ns] if Path(one).exists() else one
        for one in [*shared["places"], *([shared["robot"]] if shared["robot"] else [])]
    ]
    return {"version": __version__, "files": stamps, "pattern": shared["pattern"], "topics": shared["topics"]}


def _by_robot(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    out: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        out.setdefault(str(row["robot"]), []).append(row)
    return out


def _series(rows: Sequence[Mapping[str, Any]], quantity: str) -> tuple[list[int], Series]:
    """Return the indices of rows with a quantity, and the quantity over these."""
    index = [k for k, row in enumerate(rows) if quantity in row["quantities"]]
    pairs = np.array([rows[k]["quantities"][quantity] for k in index], dtype=np.float64).reshape(-1, 2)
    t = np.array([rows[k]["epoch_s"] for k in index], dtype=np.float64)
    floor = LABELS[quantity].resolution
    return index, Series(t=t, values=pairs[:, 0], sigmas=np.hypot(pairs[:, 1], floor))


def _changes(rows: Sequence[Mapping[str, Any]]) -> list[RobotChange]:
    """Return the changes of each robot: of its wheels by their causes, and of each other quantity."""
    out = []
    for robot, own in _by_robot(rows).items():
        names = quantities_of(own)
        wheels = [name for name in names if name in SHOWN_IN] if "left_wheel" in names else []
        measured = {name: _series(own, name)[1] for name in (*wheels, *MEASURED)} if wheels else {}
        found = changes_of_wheels({name: one for name, one in measured.items() if len(one.t)})
        for name in names:
            if name not in wheels:
                _, one = _series(own, name)
                steps = steps_of(name, one.t, one.values, one.sigmas)
                found += [CausedStep(step=step, t=float(one.t[step.before])) for step in steps]
        out += [_change(robot, one, own) for one in found]
    return sorted(out, key=lambda one: (-one.probability, one.robot))


def _change(robot: str, found: CausedStep, own: Sequence[Mapping[str, Any]]) -> RobotChange:
    step = found.step
    after = next((row for row in own if row["epoch_s"] > found.t), own[-1])
    return RobotChange(
        robot=robot, quantity=step.quantity, day=str(after["day"]), after=str(after["log"]), size=step.size,
        sigma=step.sigma, probability=step.probability, is_drift=step.is_drift, seen_in=found.seen_in,
    )  # fmt: skip


def _odd(rows: Sequence[Mapping[str, Any]], changes: Sequence[RobotChange]) -> list[OddRobot]:
    """Compare the first level of each robot, before any change, with that of robots with the same laser."""
    kinds: dict[str, dict[str, list[Mapping[str, Any]]]] = {}
    for robot, own in _by_robot(rows).items():
        kinds.setdefault(str(own[0]["kind"]), {})[robot] = own
    out = []
    for robots in kinds.values():
        for quantity in quantities_of([row for own in robots.values() for row in own]):
            levels = {}
            for robot, own in robots.items():
                index, one = _series(own, quantity)
                ends = [
                    k
                    for change in changes
                    if change.robot == robot and quantity in (change.quantity, *change.seen_in)
                    for k, at in enumerate(index)
                    if own[at]["log"] == change.after
                ]
                last = min(ends, default=len(index))
                if last:
                    levels[robot] = level(quantity, one.values[:last], one.sigmas[:last])
            out += odd_robots(quantity, levels)
    return sorted(out, key=lambda one: -one.probability)


def save(result: Fleet, folder: Path) -> None:
    """Write table, page, rerun layer and a page for each log; either all of them or none."""
    with atomic_folder(folder) as part:
        (part / "fleet.csv").write_text(_csv(result), encoding="utf-8")
        (part / "fleet.json").write_text(json.dumps(result.to_dict(), indent=1) + "\n", encoding="utf-8")
        write_parquet([flat(row) for row in result.rows], part / "fleet.parquet")
        (part / "logs").mkdir()
        for row in result.rows:
            (part / "logs" / f"{row['key']}.html").write_text(log_page(row), encoding="utf-8")
        (part / "fleet.html").write_text(fleet_page(result), encoding="utf-8")
        write_layer(result.rows, result.walls, part / "fleet.rrd")
    _remove_old_pages(folder / "logs", {str(row["key"]) for row in result.rows})


def _remove_old_pages(folder: Path, keys: set[str]) -> None:
    for path in folder.glob("*.html"):
        if path.stem not in keys:
            path.unlink(missing_ok=True)


def flat(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row of the table: plain columns, and two for each quantity."""
    out = {name: row.get(name) for name in COLUMNS}
    for name in QUANTITIES:
        value, sigma = row["quantities"].get(name, (None, None))
        out |= {name: value, f"{name}_sigma": sigma}
    changes = row.get("changes") or {}
    out |= {"n_new_cells": len(changes.get("new", ())), "n_gone_cells": len(changes.get("gone", ()))}
    return {**out, "effects": " ".join(name for name, _ in row.get("effects", ())), "seconds": row["seconds"]}


def _csv(result: Fleet) -> str:
    text = io.StringIO()
    rows = [flat(row) for row in result.rows]
    names = list(rows[0]) if rows else list(COLUMNS)
    writer = csv.DictWriter(text, [*names, "error"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    writer.writerows({"log": log, "error": reason} for log, reason in result.failures)
    return text.getvalue()
