"""Survey one log: what it contains, where it was recorded, its wheels and mount, and changes of the building."""

from __future__ import annotations

import re
import time
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from logs.inspection import Inspection, inspect
from logs.run import Run
from sensorgraph.diagnosis.motion.calibration.driving import diagnose_driving
from sensorgraph.diagnosis.motion.calibration.estimate import PARAMETERS, DrivingCalibration
from sensorgraph.diagnosis.without_reference import with_described_mount
from sensorgraph.errors import SensorgraphError
from sensorgraph.loading import open_place, robot_in
from sensorgraph.localization.known_map import KnownMap, known_map
from sensorgraph.localization.locate import locate, located_run, walls_of_place
from sensorgraph.localization.map_check import best_fit, looks
from sensorgraph.localization.result import Localization
from sensorgraph.localization.settings import MAP_TRACKING
from sensorgraph.surveying.building import changed_places
from sensorgraph.world.described import with_robot
from sensorgraph.world.robot import Robot, load_robot

FRAME_PARTS = re.compile(r"^/?([^/]+)/[^/]+$")
"""A frame such as `amr7/laser`, whose prefix names the robot."""
PLACES_AT_ONCE = 16
"""Number of places that a process keeps open."""


def survey(arguments: dict[str, Any]) -> dict[str, Any]:
    """Return the row of one log as plain data.

    Parameters
    ----------
    arguments : `path`; `places` (files of graphs or arenas); `robot` (robot.yaml or None); `pattern` (regular
        expression that finds the robot's name in the path, or None); `topics` (role -> topic).

    Raises
    ------
    SensorgraphError : The file is no log of a laser, or its scans fit in no place.
    """
    begin, path = time.process_time(), Path(arguments["path"])
    seen = inspect(path, arguments["topics"])
    if seen.run is None:
        raise SensorgraphError("; ".join(seen.missing) or "it holds no scans; see `sensorgraph inspect`")
    machine = load_robot(arguments["robot"]) if arguments["robot"] else robot_in(seen.run)
    run = seen.run if machine is None else with_robot(seen.run, machine)
    row = _facts(run, seen, path, machine, arguments["pattern"])
    place, fit = _best_place(run, arguments["places"])
    found = locate(run, None if place is None else _opened(place), name=place or "the map")
    located = located_run(run, found)
    located = located if machine is None else with_described_mount(located, machine)
    row |= {"place": "" if place is None else Path(place).name, "place_fit": fit, **_located(found)}
    row |= _calibration(run, located, machine)
    if place is not None:
        changes = changed_places(located, walls_of_place(_opened(place)).walls)
        row["changes"] = changes.to_dict()
        if changes.offset is not None:
            row["quantities"] |= {"range_offset": list(changes.offset)}
    else:
        row["changes"] = {}
    row["seconds"] = time.process_time() - begin
    return row


def _facts(
    run: Run, seen: Inspection, path: Path, machine: Robot | None, pattern: str | None
) -> dict[str, Any]:
    """Return name of the robot, day, length and content."""
    frames = [topic.frame for topic in seen.topics if "Scan" in topic.type or "Cloud" in topic.type]
    sensor = run.sensor
    way = float(np.hypot(*np.diff(run.odometry[:, :2], axis=0).T).sum()) if len(run.odometry) else 0.0
    span = float(np.ptp(sensor.bearings))
    return {
        "robot": _robot_name(path, pattern, machine, frames),
        "kind": f"{sensor.n_rays} rays over {np.degrees(span):.0f}° to {sensor.range_max:g} m",
        "epoch_s": run.epoch_ns / 1e9 + float(run.stamps[0]),
        "length_s": run.duration,
        "way_m": way,
        "n_scans": run.n_scans,
        "no_return": float(np.mean(~np.isfinite(run.ranges))),
        "warnings": list(seen.warnings),
        "use": {use.name: use.verdict for use in seen.use},
    }


def _robot_name(path: Path, pattern: str | None, machine: Robot | None, frames: list[str]) -> str:
    """Return the robot's name: by the pattern, its robot.yaml, the prefix of its frames, else its folder."""
    found = re.search(pattern, str(path)) if pattern else None
    if found:
        return found.group(1) if found.groups() else found.group()
    if machine is not None and "name" in machine.text:
        return machine.name
    for frame in frames:
        prefix = FRAME_PARTS.match(frame)
        if prefix:
            return prefix.group(1)
    return path.absolute().parent.name


_opened = lru_cache(PLACES_AT_ONCE)(open_place)


@lru_cache(PLACES_AT_ONCE)
def _known(place: str) -> KnownMap:
    return known_map(*walls_of_place(_opened(place)))


def _best_place(run: Run, places: list[str]) -> tuple[str | None, float | None]:
    """Return the place that short drives of the run fit best, with the fit (0 to 1); None without places."""
    if not places:
        return None, None
    if len(places) == 1:
        return places[0], None
    best, name = 0.0, places[0]
    for view in looks(
        run
    ):  # all places are compared by one short drive, and by another one if it fits nowhere
        for one in places:
            fit = best_fit([view], _known(one))
            best, name = max((best, name), (fit, one))
        if best >= MAP_TRACKING.near_fit:
            return name, best
    raise SensorgraphError(
        f"its scans fit in none of {len(places)} places; the best, {Path(name).name}, fits {100 * best:.0f} %, "
        f"expected {100 * MAP_TRACKING.near_fit:.0f} %"
    )


def _located(found: Localization) -> dict[str, Any]:
    ok = np.array(found.status) == "ok"
    path = found.poses[ok][:, :2]
    every = max(1, len(path) // 200)
    return {
        "ok_share": float(ok.mean()),
        "path": np.round(path[::every], 2).tolist(),
        "location_notes": list(found.notes),
    }


def _calibration(run: Run, located: Run, machine: Robot | None) -> dict[str, Any]:
    """Return wheels and mount with standard errors, and the effects that they mean."""
    base = None if machine is None else machine.stated_base
    try:
        finding = diagnose_driving({"the run": (run, located)}, base=base)
    except SensorgraphError as exc:
        return {"quantities": {}, "effects": [], "lines": [str(exc)]}
    found = finding.runs["the run"]
    quantities = {
        name: [float(value) for value in found.of(name)]
        for name in (*PARAMETERS, "delay")
        if name not in found.hidden
    }
    if base is not None:
        quantities |= _each_wheel(found, base)
    return {
        "quantities": quantities,
        "effects": [[a.name, {k: float(v) for k, v in a.parameters.items()}] for a in finding.effects],
        "lines": finding.lines,
    }


def _each_wheel(found: DrivingCalibration, base: float) -> dict[str, list[float]]:
    """Return the true radius of each wheel over the assumed one: the rim speeds v ∓ ω base / 2 of straight driving."""
    if {"way_scale", "heading_bias"} & found.hidden.keys():
        return {}
    (way, way_error), (bias, bias_error) = found.of("way_scale"), found.of("heading_bias")
    error = float(np.hypot(way_error, bias_error * base / 2))
    return {
        "left_wheel": [way - bias * base / 2, error],
        "right_wheel": [way + bias * base / 2, error],
        # the error of the distance is common to both wheels
        "wheel_difference": [bias * base, bias_error * base],
    }
