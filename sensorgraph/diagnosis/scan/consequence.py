"""What an effect or an unexplained difference of the scans costs a simulation, and whether that matters to a user.

The size of a difference is the error of a simulation without it. An effect matters by its size, or by the readings that it changes,
beside the errors that the setup and its map may have.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, pdtr

from sensorgraph.diagnosis.result import Deviation
from sensorgraph.diagnosis.scan.fit import Cast, Fitted, log_p_at
from sensorgraph.diagnosis.scan.nuisance import prior_widths
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, GoodnessOfFitSettings
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import size_ratio
from sensorgraph.world.robot import Tolerances

CAUSES: dict[str, dict[str, str]] = {
    "bearing": {
        "bias": "an error of the laser that depends on bearing: its mirror, its angles, its mounting",
        "misses": "dead or covered rays at some bearings",
        "outliers": "an object on the robot within view of the laser, or a second laser",
    },
    "range": {
        "bias": "an error of the laser that depends on range: a step, a curve, a periodic phase error",
        "misses": "a loss of signal with range: fog, a weak or dirty window",
        "outliers": "echoes from dust, fog or a dirty window",
    },
    "incidence": {
        "bias": "a range error at slanted walls: a broad beam, rough or shiny surfaces",
        "misses": "surfaces that reflect or absorb light at a slant",
    },
    "omega": {
        "bias": "timing between scans and poses: a clock that drifts or jitters, an unsteady sweep",
    },
    "speed": {
        "bias": "timing between scans and poses, or a tilt that depends on speed",
    },
    "acceleration": {
        "bias": "pitching of the robot when it brakes or accelerates",
        "outliers": "pitching of the robot when it brakes or accelerates, so that rays meet the floor",
    },
    "time": {
        "bias": "something that changed during the run: a knock, a restart, a warming laser",
        "spread": "temporary disturbances: vibration, interference, a failing cable",
        "misses": "a temporary loss of signal: sunlight, dirt, a failing cable",
        "outliers": "a temporary object: people, a door, another laser",
    },
    "direction in map": {
        "misses": "light from one direction of the room: sun, a lamp",
        "bias": "a map whose scale differs between its axes, or that is sheared",
    },
    "robot place": {
        "bias": "a reference pose with an error that depends on place (lens, mirrored markers), or an uneven floor",
        "outliers": "an uneven floor or a ramp at that place, or objects that are visible only from there",
        "misses": "light or surfaces that are visible only from that place",
        "spread": "a less accurate reference pose at that place, or an uneven floor",
    },
    "hit place": {
        "bias": "an object or wall at that place: bent, moved, turned or covered",
        "outliers": "an object there that is missing in the map or moves: a door, furniture, a person",
        "misses": "a surface there that absorbs or deflects light",
        "spread": "a rough, half-open or moving object there: a curtain, a plant, a door",
    },
    "wall": {
        "bias": "that wall: bent, moved, or covered by something",
        "outliers": "openings, furniture or people in front of that wall",
        "misses": "the surface of that wall",
        "spread": "a rough or uneven surface of that wall",
    },
}
"""Partition and kind of a deviation -> likely cause."""
ELSE = {
    "bias": "an error of laser, reference or map that is not in the library of effects",
    "spread": "noise that is missing in the sensor's description: vibration, interference, a poor reference",
    "outliers": "readings of objects that are missing in the map",
    "misses": "a loss of signal that is missing in the sensor's description",
}
SCATTER_CAUSES = (
    "scans that are late, repeated or wrongly stamped",
    "a reference pose that is temporarily less accurate than specified",
    "bursts of noise in the laser",
)
"""Causes of scans that differ from each other more than the rays within a scan do."""
MAX_CAUSES = 3
LEAST_CHANGE = SCAN.likelihood.min_resolution
"""[m] minimum change of a reading by an effect."""
SURELY_MATERIAL = "surely_material"
"""Name of the rule that a size exceeds its materiality with sufficient probability."""


@dataclass(frozen=True, kw_only=True)
class ScanError:
    """Error of simulated readings."""

    offset: float = 0.0
    """[m] typical mean error of the affected readings: root mean square or, of an effect, median."""
    noise: float = 0.0
    """[m] error of the standard deviation of the affected readings, as `offset`."""
    affected: float = 0.0
    """Share of all readings with these errors."""
    wrong: float = 0.0
    """Share of all readings that are outliers or missing, contrary to the simulation."""

    def to_dict(self) -> dict[str, float]:
        """Return the nonzero values as plain data for the report."""
        named = {
            "offset_m": self.offset,
            "noise_m": self.noise,
            "affected_share": self.affected,
            "wrong_share": self.wrong,
        }
        return {key: value for key, value in named.items() if value}

    def sentence(self) -> str:
        """Return the error as a sentence."""
        parts, affected = [], _percent(self.affected)
        if self.offset:
            parts.append(f"off by {length(self.offset)} in {affected} of the readings")
        if self.noise:
            parts.append(f"less noisy than the laser by {length(self.noise)} in {affected} of the readings")
        if self.wrong:
            parts.append(f"wrong in {_percent(self.wrong)} of the readings, which are outliers or missing")
        return f"a simulation without it is {' and '.join(parts)}"

    def is_material(self, sigma: float, settings: GoodnessOfFitSettings = SCAN.goodness_of_fit) -> bool:
        """Return whether the error exceeds what a user tolerates.

        Parameters
        ----------
        sigma : [m] Standard deviation of a reading; the minimum error grows with it.
        """
        least = max(settings.min_range_error, settings.min_error_of_sigma * sigma)
        is_off = max(self.offset, self.noise) >= least and self.affected >= settings.min_share
        return is_off or self.wrong >= settings.min_share


def scan_error(deviations: Sequence[Deviation], sigma: float, n_readings: int) -> ScanError:
    """Return the error of simulated readings that deviations of one kind and one partition correspond to.

    Parameters
    ----------
    sigma : [m] Standard deviation of a reading.
    n_readings : Number of readings in the whole run.
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
    """Return the error [m] of a standard deviation whose variance is too small by the ratio `spread`."""
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
    """Return likely causes of deviations, first those of the partition whose bins explain most."""
    explained: dict[tuple[str, str], float] = {}
    for d in deviations:
        key = (d.partition, d.family)
        explained[key] = explained.get(key, 0.0) + d.z**2
    ranked = sorted(explained, key=lambda key: -explained[key])
    return tuple(dict.fromkeys(CAUSES.get(part, {}).get(kind, ELSE[kind]) for part, kind in ranked))[
        :MAX_CAUSES
    ]


def scan_change(one: Cast, other: Cast) -> ScanError:
    """Return the difference between two simulations of the same scans.

    Offset and noise are medians, because some rays pass an edge in one of them, and differ by metres.
    """
    a, b = one.expected, other.expected
    with np.errstate(invalid="ignore"):
        off = np.abs(a.reading - b.reading)
    moved = np.isfinite(off) & (off > LEAST_CHANGE)
    rounding = (a.lattice**2 - b.lattice**2) / 12
    noise = np.sqrt(np.abs(a.sigma**2 - b.sigma**2 + rounding))
    noisy = np.isfinite(noise) & (noise > LEAST_CHANGE)
    lost = np.abs(a.p_return - b.p_return)
    wrong = float(lost.mean()) + abs(a.stray - b.stray) + abs(a.short - b.short)
    return ScanError(
        offset=float(np.median(off[moved])) if moved.any() else 0.0,
        noise=float(np.median(noise[noisy])) if noisy.any() else 0.0,
        affected=float((moved | noisy).mean()),
        wrong=min(wrong, 1.0) if wrong > LEAST_CHANGE else 0.0,
    )


def material_chance(fitted: Fitted, amendment: Amendment) -> float:
    """Return the probability that an effect of a fit matters: its size, or without one the share of the readings that it changes.

        P(share > min_share) = P(X <= n),   X ~ Poisson(min_share N)

    n of N readings are clearly better explained with the effect; their rate has a flat prior.
    """
    if amendment.effect.sizes or amendment.effect.diagnostics.is_lattice:
        return material_probability(amendment, amendment.stderr, required_ratio(fitted, amendment))
    data, settings = fitted.solver.data, SCAN.goodness_of_fit
    rest = tuple(a for a in fitted.model if a != amendment)
    better = log_p_at(data, fitted.model, fitted.state) - log_p_at(data, rest, fitted.state)
    n_changed = int((better > settings.clearly_better).sum())
    return float(pdtr(n_changed, settings.min_share * better.size))


def material_probability(amendment: Amendment, stderr: Mapping[str, float], slack: float = 1.0) -> float:
    """Return the probability that an effect's size is at least `slack` times its materiality; 1 without a limit.

        Φ((ratio - slack) / error)

    The error is taken along the direction of the size, since several sizes add as a vector. The other sign does not count:
    a size that the run does not determine (error -> inf) is as probably material as not.
    """
    sizes = amendment.effect.sizes
    ratio = size_ratio(amendment.effect, amendment.parameters)
    if not np.isfinite(ratio):
        return 1.0
    parts = {
        k: (amendment[k] / m, stderr.get(k, 0.0) / m) for k, m in sizes.items() if k in amendment.parameters
    }
    along = sum((value * error) ** 2 for value, error in parts.values()) ** 0.5 / max(ratio, 1e-9)
    error = max(along, 1e-6)
    return float(ndtr((ratio - slack) / error))


def required_ratio(fitted: Fitted, amendment: Amendment) -> float:
    """Return the minimum size of an effect in materialities: more for wide specified tolerances, or if the fit widened them."""
    proved = max(1.0, fitted.state.map_scale, fitted.state.pose_scale)
    usual, told = prior_widths(Tolerances()), prior_widths(fitted.solver.data.tolerances)
    return proved * float((told / usual)[list(amendment.effect.nuisances)].max(initial=1.0))


def is_map_error(fitted: Fitted, amendment: Amendment) -> bool:
    """Return whether a change of the building is within the errors of the map.

    This holds for a wall of an occupancy-grid map, or the map as a whole, that moved by less than a cell, and for a disc that stands
    out of a mapped object by a small distance. A disc that may be as large as the largest one also counts, because it was fitted to
    a flat object.
    """
    data, values = fitted.solver.data, amendment.parameters
    if amendment.effect.place != "spot":
        return _is_within_cell(data, amendment)
    largest = amendment.effect.parameter("r").high - amendment.effect.sizes["r"]
    if values["r"] + 2 * amendment.stderr.get("r", 0.0) > largest:
        return True
    spot = np.array([[values["x"], values["y"]]])
    if data.arena.contains(spot)[0]:
        return False
    stands_out = values["r"] - float(data.barriers.distances(spot)[0])
    return stands_out < SCAN.nuisance.max_tolerances * data.tolerances.map * required_ratio(fitted, amendment)


def _is_within_cell(data: ScanData, amendment: Amendment) -> bool:
    """Return whether the walls that an effect moves, less twice its standard error, stay within a cell of the map."""
    effect = amendment.effect
    if data.grain <= 0 or effect.place == "obstacle" or effect.diagnostics.corner_shifts is None:
        return False
    scene = data.scene()
    before = scene.walls.copy()
    amendment(scene)
    shift = (scene.walls - before).reshape(-1, 2)
    if effect.place is None:
        shift = shift - shift.mean(axis=0)  # the poses absorb it
    return float(np.hypot(*shift.T).max()) - 2 * amendment.stderr.get("d", 0.0) < 2 * data.grain
