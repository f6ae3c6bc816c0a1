"""What lasers do to ranges: returns that are lost, biases, false returns, and faults of whole scans."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from benchmarks.hidden_effects.log import Booleans, Floats
from benchmarks.hidden_effects.worlds.blind.effects import Hidden
from benchmarks.hidden_effects.worlds.blind.robots import Robot
from benchmarks.hidden_effects.worlds.blind.scene import Hits, incidence


@dataclass(kw_only=True, eq=False)
class Readings:
    """All rays of a run, one after the other (n = n_scans n_rays), filled on their way."""

    robot: Robot
    duration: float
    """[s]"""
    stamps: Floats
    """(n,) [s] of the scan."""
    taken: Floats
    """(n,) [s] when the ray was truly taken."""
    bearings: Floats
    """(n,) [rad] as the log says."""
    x: Floats
    y: Floats
    """(n,) [m] where the laser was."""
    corners: Floats | None
    """(n_corners, 2) [m]"""
    seed: int
    n_scans: int
    direction: Floats = field(default_factory=lambda: np.zeros(0))
    """(n,) [rad] in the map, where the ray truly went."""
    hits: Hits = field(init=False)

    def rng(self, stream: int) -> np.random.Generator:
        """Return a stream of noise that does not depend on what is hidden."""
        return np.random.default_rng([self.seed, 77, stream])


Law = Callable[[Readings, Floats, Hidden], Floats]
"""(readings, ranges (n,) [m], effect) -> ranges."""


def _lost(is_lost: Booleans, ranges: Floats) -> Floats:
    return np.where(is_lost, np.inf, ranges)


def _on_section(readings: Readings, hidden: Hidden) -> Booleans:
    hits = readings.hits
    return np.asarray((hits.wall == hidden.wall) & (hits.along >= hidden["a"]) & (hits.along <= hidden["b"]))


def _black_surface(readings: Readings, ranges: Floats, hidden: Hidden) -> Floats:
    returns = readings.hits.cos_incidence * (hidden["r0"] / np.maximum(ranges, 0.01)) ** 2
    dark = _on_section(readings, hidden)
    return _lost(dark & (readings.rng(3).random(ranges.size) > np.minimum(1, returns)), ranges)


def _incidence_dropout(readings: Readings, ranges: Floats, hidden: Hidden) -> Floats:
    return _lost(incidence(readings.hits) > hidden["alpha_max"], ranges)


def _sun(readings: Readings, ranges: Floats, hidden: Hidden) -> Floats:
    off = (readings.direction - hidden["dir"] + np.pi) % (2 * np.pi) - np.pi
    share = hidden["p"] * np.clip(ranges / 2.0, 0, 1)
    return _lost((np.abs(off) < hidden["half"]) & (readings.rng(12).random(ranges.size) < share), ranges)


LOSSES: dict[str, Law] = {
    "black_surface": _black_surface,
    "incidence_dropout": _incidence_dropout,
    "f_sun": _sun,
}
"""Before the range is measured."""


def _sector_bias(readings: Readings, ranges: Floats, hidden: Hidden) -> Floats:
    return ranges + hidden["b"] * _in_sector(readings, hidden)


def _in_sector(readings: Readings, hidden: Hidden) -> Booleans:
    bearings = readings.bearings
    return np.asarray((bearings >= hidden["theta1"]) & (bearings <= hidden["theta2"]))


def _range_drift(readings: Readings, ranges: Floats, hidden: Hidden) -> Floats:
    if hidden["tau"] > 0:
        return ranges + hidden["b1"] * (1 - np.exp(-readings.taken / hidden["tau"]))
    return ranges + hidden["b1"] * readings.taken / readings.duration


def _cyclic(readings: Readings, ranges: Floats, hidden: Hidden) -> Floats:
    is_finite = np.isfinite(ranges)
    phase = 2 * np.pi * np.where(is_finite, ranges, 0) / hidden["lam"]
    return np.where(is_finite, ranges + hidden["A"] * np.sin(phase), ranges)


def _multipath(readings: Readings, ranges: Floats, hidden: Hidden) -> Floats:
    hits, direction = readings.hits, readings.direction
    x, y = readings.x + np.cos(direction) * hits.ranges, readings.y + np.sin(direction) * hits.ranges
    x, y = np.where(np.isfinite(x), x, 1e3), np.where(np.isfinite(y), y, 1e3)
    corners = readings.corners if readings.corners is not None else np.zeros((0, 2))
    off = np.min([np.hypot(x - corner[0], y - corner[1]) for corner in corners], axis=0)
    return np.asarray(ranges + hidden["b"] * np.exp(-off / hidden["len"]))


def _self_occlusion(readings: Readings, ranges: Floats, hidden: Hidden) -> Floats:
    return np.where(_in_sector(readings, hidden), np.minimum(ranges, hidden["r0"]), ranges)


def _grime(readings: Readings, ranges: Floats, hidden: Hidden) -> Floats:
    """Scatter a share of the rays of a sector back from the dirty window, right before the laser."""
    rng = readings.rng(13)
    scattered = _in_sector(readings, hidden) & (rng.random(ranges.size) < hidden["p"])
    near = hidden["r0"] + rng.exponential(hidden["spread"], ranges.size)
    return np.where(scattered, np.minimum(ranges, near), ranges)


def _bloom(readings: Readings, ranges: Floats, hidden: Hidden) -> Floats:
    """Let a retroreflector be seen by rays that pass it at less than `gamma`, and read it short."""
    n = readings.robot.n_rays
    shines = _on_section(readings, hidden).reshape(-1, n)
    seen = np.where(shines, ranges.reshape(-1, n), np.inf)
    spread = seen.copy()
    for off in range(1, int(np.ceil(hidden["gamma"] / readings.robot.ray_step)) + 1):
        spread[:, off:] = np.minimum(spread[:, off:], seen[:, :-off])
        spread[:, :-off] = np.minimum(spread[:, :-off], seen[:, off:])
    return np.where(np.isfinite(spread), spread - hidden["short"], ranges.reshape(-1, n)).ravel()


def _crosstalk(readings: Readings, ranges: Floats, hidden: Hidden) -> Floats:
    """Show ghosts whose bearing and range wander, as another laser turns beside this one."""
    stamps, n, n_rays = readings.stamps, ranges.size, readings.robot.n_rays
    turn = hidden["w1"] * stamps + hidden["p1"]
    ghost = np.full(n, np.inf)
    for k in range(int(hidden["n"])):
        centre = turn * (1 + 0.37 * k) + k * 2.1
        on = np.random.default_rng([readings.seed, 5, k]).random(readings.n_scans) < 0.6
        off = np.abs((readings.bearings - centre + np.pi) % (2 * np.pi) - np.pi)
        heard = np.repeat(on, n_rays) & (off < hidden["half"]) & (readings.rng(20 + k).random(n) < 0.8)
        swing = np.sin(1.7 * stamps * (1 + 0.3 * k) + 3 * readings.bearings + k)
        ghost = np.where(heard, 0.35 + (0.5 + 0.5 * swing) * hidden["dmax"], ghost)
    return np.where(np.isfinite(ghost), ghost, ranges)


BIASES: dict[str, Law] = {
    "range_bias": lambda readings, ranges, hidden: ranges + hidden["b"],
    "sector_bias": _sector_bias,
    "range_drift": _range_drift,
    "f_incbias": lambda readings, ranges, hidden: ranges + hidden["b"] * (1 - readings.hits.cos_incidence),
    "f_eccentric": lambda readings, ranges, hidden: (
        ranges + hidden["A"] * np.sin(readings.bearings + hidden["ph"])
    ),
    "f_cyclic": _cyclic,
    "f_thermal": lambda readings, ranges, hidden: (
        ranges + hidden["A"] * np.sin(2 * np.pi * readings.taken / hidden["T"])
    ),
    "f_multipath": _multipath,
    "self_occlusion": _self_occlusion,
    "f_grime": _grime,
    "f_bloom": _bloom,
    "f_crosstalk": _crosstalk,
}
"""Before noise, in the order in which they act."""


def _stuck(readings: Readings, ranges: Floats, hidden: Hidden) -> None:
    """Let some neighbouring rays stay at an old value for seconds, several times."""
    rng, width = np.random.default_rng([readings.seed, 6]), int(hidden["width"])
    for _ in range(int(hidden["n"])):
        first = rng.integers(0, readings.n_scans - 10)
        n = int(rng.uniform(3, 8) * readings.robot.scan_rate)
        ray = rng.integers(0, readings.robot.n_rays - width)
        ranges[first : first + n, ray : ray + width] = ranges[first, ray : ray + width]


def _duplicated(readings: Readings, ranges: Floats, hidden: Hidden) -> None:
    """Log the scan before again under a new stamp, at random."""
    rng = np.random.default_rng([readings.seed, 7])
    for k in range(1, readings.n_scans):
        if rng.random() < hidden["p"]:
            ranges[k] = ranges[k - 1]


SCAN_FAULTS: dict[str, Callable[[Readings, Floats, Hidden], None]] = {"f_stuck": _stuck, "f_dup": _duplicated}
"""Of the ranges (n_scans, n_rays) [m] as logged, in place."""
