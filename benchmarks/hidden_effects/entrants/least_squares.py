"""Least squares over all continuous parameters of laser, poses, map, wheels and motors at once.

So does system identification. It names what leaves its materiality by more than three standard errors, and never says
that something is unknown.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares as solve
from scipy.signal import lfilter

from benchmarks.hidden_effects.entrants.simulated import MAX_RESIDUAL, Scans
from benchmarks.hidden_effects.geometry import interpolated
from benchmarks.hidden_effects.library import MATERIALITY
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.seen import Seen, read_case

STDERRS = 3.0
STEP = 0.01
"""[s] of simulated motors."""
WINDOW = 1.0
"""[s] over which wheels and poses are compared."""
SCAN_PARAMETERS = (
    "range_bias", "range_scale", "range_drift", "mount_yaw", "dx", "dy", "latency", "map_scale",
)  # fmt: skip
KEYS = {
    "range_bias": "b", "range_scale": "s", "range_drift": "b1", "mount_yaw": "delta", "latency": "tau", "map_scale": "s",
    "wheel_radius": "s", "wheel_base": "s", "wheel_radius_diff": "s", "actuator_lag": "tau", "dead_time": "L",
}  # fmt: skip
"""Effect -> its parameter in a report."""


def answer(case: Path) -> dict[str, Any]:
    """Return a report."""
    return least_squares(read_case(case))


def least_squares(seen: Seen) -> dict[str, Any]:
    """Fit all parameters, name those that matter."""
    sizes = {**_fit_wheels(seen), **_fit_motors(seen)}
    if seen.rings:  # a map of pixels has no walls to fit
        sizes |= _fit_scans(Scans(seen))
    found = []
    for name, (values, stderr) in sizes.items():
        size, error = math.hypot(*values.values()), math.hypot(*stderr.values())
        ratio = size / MATERIALITY[name][0]
        if ratio > 1 and size > STDERRS * error:
            found.append((ratio, {"name": name, "parameters": values, "stderr": stderr}))
    return {"effects": [one for _, one in sorted(found, key=lambda pair: -pair[0])], "unknown": None}


Fitted = dict[str, tuple[dict[str, float], dict[str, float]]]
"""Effect -> its parameters and their standard errors."""


def _fit_scans(scans: Scans) -> Fitted:
    hit = np.isfinite(scans.z)

    def residual(p: Floats) -> Floats:
        mu, _ = scans.expected(dict(zip(SCAN_PARAMETERS, p, strict=True)))
        with np.errstate(invalid="ignore"):
            off = np.where(hit & np.isfinite(mu), scans.z - mu, 0.0)
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


def _fit_wheels(seen: Seen) -> Fitted:
    """Regress way and turn of the odometry on those of the reference, window by window."""
    cuts = np.arange(seen.odom_stamps[0], seen.odom_stamps[-1], WINDOW)

    def steps(stamps: Floats, poses: Floats) -> tuple[Floats, Floats]:
        phi = np.unwrap(poses[:, 2])
        middle = (phi[1:] + phi[:-1]) / 2
        along = np.diff(poses[:, 0]) * np.cos(middle) + np.diff(poses[:, 1]) * np.sin(middle)
        way = np.concatenate([[0.0], np.cumsum(along)])
        return np.diff(np.interp(cuts, stamps, way)), np.diff(np.interp(cuts, stamps, phi))

    (way, turn), (true_way, true_turn) = (
        steps(seen.odom_stamps, seen.odometry),
        steps(seen.pose_stamps, seen.poses),
    )
    base = float(seen.robot["wheels"]["base"])
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


def _fit_motors(seen: Seen) -> Fitted:
    """Fit lag and dead time of the motors to the twists."""
    t = np.arange(seen.cmd_stamps[0], seen.cmd_stamps[-1], STEP)
    tau0, delay0 = float(seen.robot["actuators"]["tau"]), float(seen.robot["actuators"]["delay"])
    measured = interpolated(t, seen.odom_stamps, seen.twists)
    middle = seen.cmd_stamps + np.median(np.diff(seen.cmd_stamps)) / 2
    weight = np.array([1 / seen.robot["wheels"]["sigma_v"], 1 / seen.robot["wheels"]["sigma_omega"]])
    half = float(np.median(np.diff(seen.odom_stamps))) / 2

    def residual(p: Floats) -> Floats:
        keep = math.exp(-STEP / max(tau0 + p[0], 1e-3))
        asked = interpolated(t - delay0 - p[1] - half, middle, seen.commands)
        return ((measured - lfilter([1 - keep], [1, -keep], asked, axis=0)) * weight).ravel()

    got = solve(residual, np.zeros(2), diff_step=1e-3, x_scale=0.01, max_nfev=20)
    tau, delay = _stderr(got.jac, got.fun)
    return {
        "actuator_lag": ({"tau": float(got.x[0])}, {"tau": tau}),
        "dead_time": ({"L": float(got.x[1])}, {"L": delay}),
    }
