"""What something unexplained in the scans costs a user: how far a simulation without it is off, and what it may be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.result import Deviation
from sensorgraph.diagnosis.scan.settings import SCAN, GoodnessOfFitSettings

CAUSES: dict[tuple[str, str], str] = {
    (
        "bearing",
        "bias",
    ): "an error of the laser that depends on bearing: its mirror, its angles, its mounting",
    ("bearing", "misses"): "rays that are dead or covered at some bearings",
    ("bearing", "outliers"): "something on the robot within view of the laser, or a second laser",
    ("range", "bias"): "an error of the laser that depends on range: a step, a curve, a cycle of its phase",
    ("range", "misses"): "a loss of signal with range: fog, a weak or dirty window",
    ("range", "outliers"): "echoes from dust, fog or a dirty window",
    ("incidence", "bias"): "walls seen at a slant read wrongly: a broad beam, rough or shiny surfaces",
    ("incidence", "misses"): "surfaces that shine or swallow light at a slant",
    (
        "omega",
        "bias",
    ): "timing between scans and poses: a clock that drifts or jitters, a sweep that is not steady",
    ("speed", "bias"): "timing between scans and poses, or a tilt that depends on speed",
    ("acceleration", "bias"): "the robot pitches when it brakes or accelerates",
    (
        "acceleration",
        "outliers",
    ): "the robot pitches when it brakes or accelerates, so that rays meet the floor",
    ("time", "bias"): "something that changed during the run: a knock, a restart, a warming laser",
    ("time", "spread"): "disturbances for a time: vibration, interference, a failing cable",
    ("time", "misses"): "a loss of signal for a time: sunlight, dirt, a failing cable",
    ("time", "outliers"): "something that comes and goes: people, a door, another laser",
    ("heading", "bias"): "a reference whose yaw depends on heading, or a laser that is not level",
    ("direction in map", "misses"): "light from one direction of the room: sun, a lamp",
    ("direction in map", "bias"): "a map whose scale differs between its axes, or that is sheared",
    (
        "robot place",
        "bias",
    ): "a reference that is bent over the place (lens, mirror of markers), or an uneven floor",
    (
        "robot place",
        "outliers",
    ): "an uneven floor or a ramp at that place, or things that only that place sees",
    ("robot place", "misses"): "light or surfaces that only that place sees",
    ("robot place", "spread"): "a reference that is worse at that place, or an uneven floor",
    ("hit place", "bias"): "something at that place of the map: bent, moved, turned or covered",
    (
        "hit place",
        "outliers",
    ): "something there that the map lacks, or that moves: a door, furniture, a person",
    ("hit place", "misses"): "a surface there that swallows or deflects light",
    ("hit place", "spread"): "a rough, half-open or moving thing there: a curtain, a plant, a door",
    ("wall", "bias"): "that wall: bent, moved, or covered by something",
    ("wall", "outliers"): "openings, furniture or people before that wall",
    ("wall", "misses"): "the surface of that wall",
    ("wall", "spread"): "a rough or uneven surface of that wall",
}
"""Partition and kind of a deviation -> where a robot engineer would look."""
ELSE = {
    "bias": "an error of laser, reference or map that no effect of the library makes",
    "spread": "noise that the sensor's description lacks: vibration, interference, a poor reference",
    "outliers": "readings of things that the map lacks",
    "misses": "a loss of signal that the sensor's description lacks",
}
SCATTER_CAUSES = (
    "scans that come late, twice or with wrong stamps",
    "a reference that is at times worse than stated",
    "bursts of noise of the laser",
)
"""Of scans that differ from each other more than their rays do within a scan."""
MAX_CAUSES = 3


@dataclass(frozen=True, kw_only=True)
class ScanError:
    """By how much simulated readings are off."""

    offset: float = 0.0
    """[m] root mean square of the mean error of the affected readings."""
    noise: float = 0.0
    """[m] by which the standard deviation of the affected readings is wrong."""
    affected: float = 0.0
    """Share of all readings that are off by these."""
    wrong: float = 0.0
    """Share of all readings that are strays, or missing, though the simulator says otherwise."""

    def to_dict(self) -> dict[str, float]:
        """Return plain data for the report: what is not zero."""
        named = {
            "offset_m": self.offset,
            "noise_m": self.noise,
            "affected_share": self.affected,
            "wrong_share": self.wrong,
        }
        return {key: value for key, value in named.items() if value}

    def sentence(self) -> str:
        """Say it in words."""
        parts, affected = [], _percent(self.affected)
        if self.offset:
            parts.append(f"off by {length(self.offset)} in {affected} of the readings")
        if self.noise:
            parts.append(f"too quiet by {length(self.noise)} in {affected} of the readings")
        if self.wrong:
            parts.append(f"wrong in {_percent(self.wrong)} of the readings, which are strays or missing")
        return f"a simulation without it is {' and '.join(parts)}"

    def is_material(self, sigma: float, settings: GoodnessOfFitSettings = SCAN.goodness_of_fit) -> bool:
        """Tell whether a user would mind.

        Parameters
        ----------
        sigma : [m] of one reading; of a noisy sensor more is needed
        """
        least = max(settings.min_range_error, settings.min_size["bias"] * sigma)
        is_off = max(self.offset, self.noise) >= least and self.affected >= settings.min_affected_share
        return is_off or self.wrong >= settings.min_wrong_share


def scan_error(deviations: Sequence[Deviation], sigma: float, n_readings: int) -> ScanError:
    """Return what deviations of one kind and one partition amount to.

    Parameters
    ----------
    sigma : [m] of one reading
    n_readings : of the whole run
    """
    rays = np.array([d.n_rays for d in deviations], dtype=np.float64)
    size = np.array([d.size for d in deviations])
    share, family = float(rays.sum()) / max(n_readings, 1), deviations[0].family
    mean_square = float((rays * size**2).sum() / rays.sum())
    if family == "bias":
        return ScanError(offset=float(np.sqrt(mean_square)), affected=share)
    if family == "spread":
        return ScanError(noise=excess_noise(float((rays * size).sum() / rays.sum()), sigma), affected=share)
    return ScanError(wrong=float((rays * size).sum()) / max(n_readings, 1))


def excess_noise(spread: float, sigma: float) -> float:
    """Return by how much a standard deviation [m] is too small if the variance is too small by this ratio."""
    return float(sigma * (np.sqrt(1 + max(spread, 0.0)) - 1))


def length(metres: float) -> str:
    """Return a length with two digits and its unit: `28 cm`, `1.2 m`."""
    return (
        f"{100 * metres:.2g} cm"
        if metres < 0.995
        else f"{metres:.2g} m"
        if metres < 9.95
        else f"{metres:.0f} m"
    )


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.095 else f"{100 * share:.0f} %"


def likely_causes(deviations: Sequence[Deviation]) -> tuple[str, ...]:
    """Return what the deviations may come from, the likeliest first: the partition whose bins explain most."""
    explained: dict[tuple[str, str], float] = {}
    for d in deviations:
        key = (d.partition.removesuffix(" and half of the run"), d.family)
        explained[key] = explained.get(key, 0.0) + d.z**2
    ranked = sorted(explained, key=lambda key: -explained[key])
    return tuple(dict.fromkeys(CAUSES.get(key, ELSE[key[1]]) for key in ranked))[:MAX_CAUSES]
