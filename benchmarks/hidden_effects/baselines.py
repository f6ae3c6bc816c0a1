"""Two plain diagnosers to compare with: least squares over all parameters, and the largest mean residual.

    python -m benchmarks.hidden_effects.baselines DIR [--only least_squares]
    python -m benchmarks.hidden_effects.score DIR --answers least_squares

`least_squares` fits every continuous parameter of scanner, poses, map, wheels and motors at once, as system
identification does, and names those that leave their materiality by more than three standard errors. It never says that
something is unknown. `largest_residual` names the law of the group (all readings, a sector, a wall, late readings, far
readings, missing or unexpected returns) whose mean residual is largest, as one would by eye.

Both read the cases as any other program would, and share nothing with the package under test but its file reader.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.optimize import least_squares as solve
from scipy.signal import lfilter

from benchmarks.hidden_effects.strengths import MATERIALITY
from benchmarks.hidden_effects.world import ARENA, Floats, Room, TrueHits, cast, walls_of
from logs import Run, pair, read

N_SCANS, N_RAYS = 60, 45
"""Of a run that are looked at."""
MAX_RESIDUAL = 0.5
"""[m] a larger one is of another surface."""
STDERRS = 3.0
STEP = 0.01
"""[s] of simulated motors."""
WINDOW = 1.0
"""[s] over which wheels and poses are compared."""
CHANCE = 3.0
"""Materialities that the mean residual of a group must reach."""


class Scans:
    """Scans of a case, thinned, and the arena as mapped."""

    def __init__(self, run: Run, room: Room, robot: dict[str, Any]) -> None:
        pairing = pair(run)
        some = np.flatnonzero(pairing.paired)
        some = some[:: max(1, len(some) // N_SCANS)]
        rays = np.arange(0, run.ranges.shape[1], max(1, run.ranges.shape[1] // N_RAYS))
        self.z = run.ranges[some][:, rays]
        self.stamps = run.stamps[some]
        self.bearings = run.sensor.bearings[rays]
        self.poses, self.pose_stamps = run.poses, run.pose_stamps
        self.mount = np.array(robot["sensor"]["mount"], dtype=np.float64)
        self.room = room
        self.share = (self.stamps - self.stamps[0]) / (self.stamps[-1] - self.stamps[0])

    def expected(self, q: dict[str, float]) -> tuple[Floats, TrueHits, tuple[str, ...]]:
        """Return the readings (n, m) [m] that parameters make, what the rays met, and the names of the walls."""
        heading = np.unwrap(self.poses[:, 2])
        at = self.stamps - q.get("latency", 0.0)
        x, y, phi = (np.interp(at, self.pose_stamps, c) for c in (*self.poses[:, :2].T, heading))
        dx, dy = self.mount[0] + q.get("dx", 0.0), self.mount[1] + q.get("dy", 0.0)
        origin = np.stack(
            [x + dx * np.cos(phi) - dy * np.sin(phi), y + dx * np.sin(phi) + dy * np.cos(phi)], 1
        )
        angle = phi[:, None] + self.mount[2] + q.get("mount_yaw", 0.0) + self.bearings
        middle, scale = self.room.centroid, 1 + q.get("map_scale", 0.0)
        room = Room(rings={name: middle + scale * (ring - middle) for name, ring in self.room.rings.items()})
        walls = walls_of(room)
        hits = cast(walls, np.repeat(origin, len(self.bearings), axis=0), angle.ravel())
        r = hits.ranges.reshape(self.z.shape)
        drift = q.get("range_drift", 0.0) * self.share[:, None]
        return (1 + q.get("range_scale", 0.0)) * r + q.get("range_bias", 0.0) + drift, hits, walls.names


SCAN_PARAMETERS = (
    "range_bias",
    "range_scale",
    "range_drift",
    "mount_yaw",
    "dx",
    "dy",
    "latency",
    "map_scale",
)
KEYS = {
    "range_bias": "b", "range_scale": "s", "range_drift": "b1", "mount_yaw": "delta", "latency": "tau", "map_scale": "s",
    "wheel_radius": "s", "wheel_base": "s", "wheel_radius_diff": "s", "actuator_lag": "tau", "dead_time": "L",
}  # fmt: skip
"""Effect -> its parameter in a report."""


def least_squares(run: Run, room: Room, robot: dict[str, Any]) -> dict[str, Any]:
    """Fit all parameters, name those that matter."""
    sizes = {**_fit_scans(Scans(run, room, robot)), **_fit_wheels(run, robot), **_fit_motors(run, robot)}
    found = []
    for name, (values, stderr) in sizes.items():
        size, error = math.hypot(*values.values()), math.hypot(*stderr.values())
        if size > MATERIALITY[name] and size > STDERRS * error:
            ratio = size / MATERIALITY[name]
            found.append((ratio, {"name": name, "parameters": values, "stderr": stderr}))
    return {"effects": [one for _, one in sorted(found, key=lambda pair: -pair[0])], "unknown": None}


Fitted = dict[str, tuple[dict[str, float], dict[str, float]]]
"""Effect -> its parameters and their standard errors."""


def _fit_scans(scans: Scans) -> Fitted:
    seen = np.isfinite(scans.z)

    def residual(p: Floats) -> Floats:
        mu, _, _ = scans.expected(dict(zip(SCAN_PARAMETERS, p, strict=True)))
        with np.errstate(invalid="ignore"):
            off = np.where(seen & np.isfinite(mu), scans.z - mu, 0.0)
        return np.where(np.abs(off) < MAX_RESIDUAL, off, 0.0).ravel()

    got = solve(residual, np.zeros(len(SCAN_PARAMETERS)), diff_step=1e-3, x_scale=0.01, max_nfev=12)
    error = _stderr(got.jac, got.fun)
    value = dict(zip(SCAN_PARAMETERS, map(float, got.x), strict=True))
    stderr = dict(zip(SCAN_PARAMETERS, error, strict=True))
    out: Fitted = {
        name: ({KEYS[name]: value[name]}, {KEYS[name]: stderr[name]})
        for name in SCAN_PARAMETERS
        if name in KEYS
    }
    out["mount_xy"] = ({k: value[k] for k in ("dx", "dy")}, {k: stderr[k] for k in ("dx", "dy")})
    return out


def _stderr(jacobian: Floats, residual: Floats) -> list[float]:
    variance = float(residual @ residual) / max(len(residual) - jacobian.shape[1], 1)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * variance
    return [float(error) for error in np.sqrt(np.diag(covariance))]


def _fit_wheels(run: Run, robot: dict[str, Any]) -> Fitted:
    """Regress way and turn of the odometry on those of the reference, window by window."""
    cuts = np.arange(run.odom_stamps[0], run.odom_stamps[-1], WINDOW)

    def steps(stamps: Floats, poses: Floats) -> tuple[Floats, Floats]:
        phi = np.unwrap(poses[:, 2])
        middle = (phi[1:] + phi[:-1]) / 2
        along = np.diff(poses[:, 0]) * np.cos(middle) + np.diff(poses[:, 1]) * np.sin(middle)
        way = np.concatenate([[0.0], np.cumsum(along)])
        return np.diff(np.interp(cuts, stamps, way)), np.diff(np.interp(cuts, stamps, phi))

    (way, turn), (true_way, true_turn) = (
        steps(run.odom_stamps, run.odometry),
        steps(run.pose_stamps, run.poses),
    )
    base = float(robot["wheels"]["base"])
    nothing = np.zeros_like(true_way)
    # way = (1 + s) way', turn = (1 + s - b) turn' + d way' / base
    rows = np.concatenate(
        [
            np.stack([true_way, nothing, nothing], 1),
            np.stack([true_turn, -true_turn, true_way / base], 1) * base,
        ]
    )
    y = np.concatenate([way - true_way, (turn - true_turn) * base])
    p, *_ = np.linalg.lstsq(rows, y, rcond=None)
    error = _stderr(rows, y - rows @ p)
    names = ("wheel_radius", "wheel_base", "wheel_radius_diff")
    return {
        name: ({"s": float(v)}, {"s": e}) for name, v, e in zip(names, np.append(p, []), error, strict=True)
    }


def _fit_motors(run: Run, robot: dict[str, Any]) -> Fitted:
    """Fit lag and dead time of the motors to the twists."""
    t = np.arange(run.cmd_stamps[0], run.cmd_stamps[-1], STEP)
    tau0, delay0 = float(robot["actuators"]["tau"]), float(robot["actuators"]["delay"])
    measured = np.stack([np.interp(t, run.odom_stamps, c) for c in run.odom_twists.T], axis=1)
    weight = np.array([1 / robot["wheels"]["sigma_v"], 1 / robot["wheels"]["sigma_omega"]])
    half = float(np.median(np.diff(run.odom_stamps))) / 2

    def residual(p: Floats) -> Floats:
        keep = math.exp(-STEP / max(tau0 + p[0], 1e-3))
        asked = np.stack(
            [
                np.interp(
                    t - delay0 - p[1] - half, run.cmd_stamps + np.median(np.diff(run.cmd_stamps)) / 2, c
                )
                for c in run.commands.T
            ],
            axis=1,
        )
        return ((measured - lfilter([1 - keep], [1, -keep], asked, axis=0)) * weight).ravel()

    got = solve(residual, np.zeros(2), diff_step=1e-3, x_scale=0.01, max_nfev=20)
    tau, delay = _stderr(got.jac, got.fun)
    return {
        "actuator_lag": ({"tau": float(got.x[0])}, {"tau": tau}),
        "dead_time": ({"L": float(got.x[1])}, {"L": delay}),
    }


def largest_residual(run: Run, room: Room, robot: dict[str, Any]) -> dict[str, Any]:
    """Name the law of the group of readings that is off the most."""
    scans = Scans(run, room, robot)
    mu, hits, names = scans.expected({})
    far = mu > float(robot["sensor"]["range_max"])
    seen = np.isfinite(scans.z) & np.isfinite(mu) & ~far
    with np.errstate(invalid="ignore"):
        off = np.where(seen, scans.z - mu, 0.0)
    wall = hits.wall.reshape(mu.shape)
    found: list[tuple[float, dict[str, Any]]] = []

    def look(name: str, group: Floats, key: str, place: str = "", least: float = 0.02) -> None:
        chosen = seen & group.astype(bool)
        if chosen.sum() >= least * seen.sum():
            mean = float(off[chosen].mean())
            location = {"name": place, "xy": None} if place else None
            found.append(
                (
                    abs(mean) / MATERIALITY[name],
                    {"name": name, "parameters": {key: mean}, "location": location},
                )
            )

    look("range_bias", np.ones_like(mu), "b")
    look("range_drift", np.broadcast_to(scans.share[:, None] > 2 / 3, mu.shape), "b1")
    for k in range(8):
        low, high = np.quantile(scans.bearings, [k / 8, (k + 1) / 8])
        look(
            "sector_bias",
            np.broadcast_to((scans.bearings >= low) & (scans.bearings < high), mu.shape),
            "b",
        )
    for k, name in enumerate(names):
        is_outer = name.startswith(ARENA)
        label = "moved_wall" if is_outer else "moved_obstacle"
        look(label, wall == k, "d" if is_outer else "dx", name if is_outer else name.partition("/")[0])
    short = seen & (off < -MAX_RESIDUAL / 2)
    found.append((short.mean() / 0.01, {"name": "unmapped_obstacle", "parameters": {}}))
    lost = np.isposinf(scans.z) & np.isfinite(mu) & ~far
    found.append((lost.mean() / 0.01, {"name": "max_range", "parameters": {}}))
    ratio, best = max(found, key=lambda pair: pair[0])
    return {"effects": [best] if ratio >= CHANCE else [], "unknown": None}


BASELINES: dict[str, Callable[[Run, Room, dict[str, Any]], dict[str, Any]]] = {
    "least_squares": least_squares,
    "largest_residual": largest_residual,
}


def room_of(geojson: str) -> Room:
    """Return the rings of an arena file."""
    features = json.loads(geojson)["features"]
    rings = {f["properties"]["name"]: np.array(f["geometry"]["coordinates"][0])[:-1] for f in features}
    return Room(rings={ARENA: rings.pop(ARENA), **rings})


def main() -> None:
    """Answer every case of a folder."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("--only", choices=list(BASELINES), action="append")
    options = parser.parse_args()
    for name in options.only or BASELINES:
        for case in sorted((options.folder / "cases").iterdir()):
            begin = time.process_time()
            robot = yaml.safe_load((case / "robot.yaml").read_text())
            report = BASELINES[name](
                read(case / "run.mcap"), room_of((case / "arena.geojson").read_text()), robot
            )
            folder = options.folder / name / case.name
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "report.json").write_text(json.dumps(report, indent=1))
            said = ", ".join(one["name"] for one in report["effects"]) or "silent"
            print(f"{name} {case.name}: {said} ({time.process_time() - begin:.1f} s)", flush=True)


if __name__ == "__main__":
    main()
