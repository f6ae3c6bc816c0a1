"""`locate`: estimate the poses of a run in a known place or in a new one, and return the run with these poses."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import dataclass, fields, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from logs.errors import MAX_LISTED
from logs.notes import notes_of
from logs.run import RARE_TIMES, Run
from logs.usability import MIN_SCANS
from planners.arena import Arena
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.intake import check_rays, check_returns
from sensorgraph.localization.arena_walls import drawn_walls, straight_walls
from sensorgraph.localization.graph_walls import seen_by_graph, walls_of_graph
from sensorgraph.localization.in_map import locate_in_map
from sensorgraph.localization.known_map import MapWalls
from sensorgraph.localization.mapping import map_run
from sensorgraph.localization.odometry import with_one_odometry, with_spread_stamps
from sensorgraph.localization.odometry_check import check_turns, with_checked_odometry
from sensorgraph.localization.range_offset import RANGE_OFFSET
from sensorgraph.localization.result import Closure, Localization, stretches_of, true_intervals
from sensorgraph.localization.robot_parts import without_robot_parts
from sensorgraph.types import Floats, ProgressBars, no_progress

POSE_SOURCE = "locate"
"""`pose_source` of a located run."""
ATTACHMENT = "localization.json"
"""Attachment of a located run with the localization summary."""
_kept_walls = WeakKeyDictionary[Arena | Sensorgraph, MapWalls]()
CORRECTED = ": corrected"
"""In the notes on what the run shows and its log states otherwise."""
COLUMNS = ("t", "x", "y", "phi", "sigma_x", "sigma_y", "sigma_phi", "status", "map")


def locate(
    run: Run,
    place: Arena | Sensorgraph | None = None,
    *,
    name: str = "the map",
    progress: ProgressBars = no_progress,
) -> Localization:
    """Estimate the pose of every scan of a run, from its scans and its odometry.

    Parameters
    ----------
    place : Arena or sensorgraph in which the run was recorded; None: a place without a map.
    name : Name of the place in messages.

    Raises
    ------
    SensorgraphError : There are too few scans, or too few of them have returns, the rays are wide cones, the scans fit
        nowhere in the place, or scans and odometry turn in opposite directions.
    """
    if run.n_scans < MIN_SCANS:
        raise SensorgraphError(
            f"the run has {run.n_scans} scan{'' if run.n_scans == 1 else 's'}, expected a drive of {MIN_SCANS} or more; "
            "give a longer log"
        )
    check_rays(run.sensor, "the run", takes="locate takes", remedy="give the run of a laser", one_place=False)
    check_returns(run)
    n_measured = int(np.isfinite(run.ranges).any(axis=1).sum())
    if n_measured < MIN_SCANS:
        why = next((f" ({note})" for note in notes_of(run) if "repeat the one before" in note), "")
        raise SensorgraphError(
            f"only {n_measured} of the {run.n_scans} scans have returns, expected {MIN_SCANS} or more{why}; check the laser "
            "with `sensorgraph inspect`"
        )
    given, run = run, with_spread_stamps(run)
    is_spread = run is not given
    run, own = without_robot_parts(run)
    run, notes = with_checked_odometry(run)
    notes = (*own, *notes)
    if is_spread:
        n = int((np.diff(given.stamps) == 0).sum())
        notes = (f"{n} scans repeat the previous stamp: spread evenly up to the next stamp", *notes)
    if place is None:
        found = map_run(run, progress=progress)
    else:
        found = locate_in_map(run, **walls_of_place(place)._asdict(), name=name, progress=progress)
    check_turns(found.wheels)
    return replace(found, t=given.stamps, notes=(*notes, *found.notes)) if notes else found


def walls_of_place(place: Arena | Sensorgraph) -> MapWalls:
    """Return the walls of an arena or a sensorgraph with what is known of them; they are kept as long as the place."""
    if place not in _kept_walls:
        _kept_walls[place] = _walls_of(place)
    return _kept_walls[place]


def _walls_of(place: Arena | Sensorgraph) -> MapWalls:
    if isinstance(place, Sensorgraph):
        walls, normals = walls_of_graph(place)
        return MapWalls(walls, seen_by_graph(place), normals)
    straight = straight_walls(place)
    if (
        straight is not None
    ):  # the borders of the cells, on both sides of a wall, are better for search and tracking
        return MapWalls(place.walls, straight=straight)
    walls, normals = drawn_walls(place)
    return MapWalls(walls, normals=normals)


def has_reference(run: Run) -> bool:
    """Tell whether the run has reference poses other than its odometry."""
    source = run.meta.get("pose_source", "")
    return len(run.pose_stamps) > 0 and not source.startswith("odometry")


def is_located(run: Run) -> bool:
    """Tell whether the poses of a run were estimated from its own scans and wheels."""
    return run.meta.get("pose_source", "") == POSE_SOURCE


def located_run(run: Run, found: Localization) -> Run:
    """Return the run with the poses of the located scans as its reference.

    If ray times were identified, its sensor has these. Of a log with two odometries, it keeps the one that was used.
    """
    ok = np.array(found.status) == "ok"
    if not ok.any():
        raise SensorgraphError(
            f"no scan was located: {'; '.join(found.notes) or 'all are ' + found.status[0]}"
        )
    meta = {key: value for key, value in run.meta.items() if key != RANGE_OFFSET}
    if found.range_offset:
        meta[RANGE_OFFSET] = f"{found.range_offset:.5f}"
    return replace(
        with_one_odometry(run),
        sensor=found.sensor or run.sensor,
        pose_stamps=run.stamps[ok],
        poses=found.poses[ok],
        pose_covariances=found.covariances[ok],
        pose_frame="base_link",
        meta={**meta, "pose_source": POSE_SOURCE},
        attachments={**run.attachments, ATTACHMENT: (json.dumps(summary(found), indent=1) + "\n").encode()},
    )


def corrections_of(run: Run) -> list[str]:
    """Return what `locate` corrected in the data of the laser, for reports on the located run: ray bearings, times and ranges."""
    kept = run.attachments.get(ATTACHMENT)
    notes = [] if kept is None or not is_located(run) else json.loads(kept).get("notes", [])
    return [f"{run.meta.get('source', 'the run')}: {note}" for note in notes if CORRECTED in note]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LocatedRun(Localization):
    """Result of `sg.locate`: poses, covariances and status of all scans, and the run with these poses."""

    run: Run
    """The run with the poses of the located scans as its reference; all else is unchanged."""

    @classmethod
    def of(cls, run: Run, found: Localization) -> LocatedRun:
        """Combine a run and its localization."""
        values = {one.name: getattr(found, one.name) for one in fields(Localization)}
        none = replace(
            run, pose_stamps=np.zeros(0), poses=np.zeros((0, 3)), pose_covariances=np.zeros((0, 3, 3))
        )
        return cls(**values, run=located_run(run, found) if "ok" in found.status else none)

    def __repr__(self) -> str:
        return "\n".join(summary_lines(self))

    def to_dict(self) -> dict[str, Any]:
        """Return counts, time intervals, wheels and loop closures as plain data."""
        return summary(self)


def deviations(found: Localization) -> Floats:
    """Return the standard deviations (n_scans, 3) [m, m, rad] of x, y, phi."""
    return np.sqrt(np.diagonal(found.covariances, axis1=1, axis2=2))


def poses_csv(found: Localization) -> str:
    """Return one row per scan, in the order of the log: t,x,y,phi,sigma_x,sigma_y,sigma_phi,status,map."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    sigma = deviations(found)
    for k, status in enumerate(found.status):
        numbers = (found.t[k], *found.poses[k], *sigma[k])
        writer.writerow([*(f"{value:.6f}" for value in numbers), status, found.map_numbers[k]])
    return text.getvalue()


def summary(found: Localization) -> dict[str, Any]:
    """Return the localization as plain data for JSON."""
    states = np.array(found.status)
    ok = states == "ok"
    sigma = deviations(found)
    wheels = found.wheels
    return {
        "n_scans": len(found.t),
        **{word: int((states == word).sum()) for word in ("ok", "lost", "ambiguous")},
        "stretches": stretches(found),
        "maps": maps(found),
        "rivals": {str(scan): poses.tolist() for scan, poses in found.rivals.items()},
        "sigma_median": [float(np.median(sigma[ok, i])) if ok.any() else None for i in range(3)],
        "wheels": None if wheels is None else {
            name: value if np.isfinite(value) else None for name, value in vars(wheels).items()
        },
        "closures": {
            "kept": [_closure(one) for one in found.kept],
            "refused": [_closure(one) for one in found.refused],
        },
        "ray_times": None if found.sensor is None or not found.sensor.has_ray_delays else {
            name: getattr(found.sensor, name) for name in ("sweep_time", *RARE_TIMES)
        },
        "range_offset": found.range_offset,
        "notes": list(found.notes),
    }  # fmt: skip


def stretches(found: Localization) -> list[dict[str, Any]]:
    """Return the time intervals in which the robot was ok, lost or ambiguous."""
    return [
        {"status": word, "from_s": float(found.t[a]), "to_s": float(found.t[b - 1]), "n_scans": b - a}
        for word, a, b in stretches_of(found.status)
    ]


def maps(found: Localization) -> list[dict[str, Any]]:
    """Return the maps, each with its time intervals; poses of different maps are in different frames."""
    numbers = found.map_numbers
    out: list[dict[str, Any]] = []
    for number in range(1, int(numbers.max(initial=0)) + 1):
        where = numbers == number
        if where.any():
            times = [
                {"from_s": float(found.t[a]), "to_s": float(found.t[b - 1]), "n_scans": b - a}
                for a, b in true_intervals(where)
            ]
            out.append({"map": number, "n_scans": int(where.sum()), "intervals": times})
    return out


def _closure(one: Closure) -> dict[str, Any]:
    return {
        "first": int(one.first),
        "second": int(one.second),
        "relative": [float(value) for value in one.relative],
        "inliers": float(one.inliers),
        **({"reason": one.reason} if one.reason else {}),
    }


def summary_lines(found: Localization) -> list[str]:
    """Return a summary of a few lines."""
    states = np.array(found.status)
    n, ok = len(states), states == "ok"
    counts = ", ".join(
        f"{int((states == word).sum()):,} {word}" for word in ("lost", "ambiguous") if (states == word).any()
    )
    lines = [f"{int(ok.sum()):,} of {n:,} scans located{f'; {counts}' if counts else ''}"]
    if ok.any():
        sigma = np.median(deviations(found)[ok], axis=0)
        place = 100 * float(np.hypot(sigma[0], sigma[1]) / np.sqrt(2))
        lines.append(f"median standard deviation: {place:.1f} cm, {np.degrees(sigma[2]):.2f}°")
    if found.wheels is not None:
        lines.append(f"wheels: {found.wheels}")
    if found.kept or found.refused:
        lines.append(f"loop closures: {len(found.kept)} kept, {len(found.refused)} rejected")
    lines += found.notes[:MAX_LISTED]
    if len(found.notes) > MAX_LISTED:
        lines.append(f"... and {len(found.notes) - MAX_LISTED} more (--json FILE lists all)")
    return lines
