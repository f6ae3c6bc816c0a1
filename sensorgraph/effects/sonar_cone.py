"""Sonar cone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import UNEXPECTED
from sensorgraph.effects.interfaces import Exposure, Residuals
from sensorgraph.effects.set_up import wall_direction_error
from sensorgraph.types import Floats, Ints
from sensorgraph.world.beams import Beams
from sensorgraph.world.ray_order import is_full_turn
from sensorgraph.world.scene import CONE_STEP, RIGHT_ANGLE, Scene

GAMMAS = np.radians([2.0, 4.0, 6.0, 8.0, 10.0, 12.5, 15.0, 18.0, 22.0, 27.0])
"""[rad] Half angles that are tested."""
ALPHAS = np.radians([20.0, 30.0, 45.0, 65.0, 89.9])
"""[rad] Largest incidences that are tested with each half angle."""
MIN_SHORT = 0.005
"""Minimum share of short readings.

A cone measures nearer surfaces next to the ray, and short ranges of walls at oblique incidence. Runs without effects
have fewer short readings, including people and outliers below 0.2 %.
"""


def transform(scene: Scene, a: Amendment) -> None:
    """Replace each ray by the nearest returning ray in its cone.

    Cones of a sweeping laser share rays: one of 30° then takes its outermost rays a twelfth of the sweep too early or late.
    """
    gamma, alpha = a["gamma"], a["alpha_max"] if a["alpha_max"] < RIGHT_ANGLE else np.inf
    beams = scene.beams
    n = len(scene.bearings)
    step = float(np.diff(scene.bearings).mean()) if n > 1 else CONE_STEP
    finer = max(1, int(np.ceil(step / CONE_STEP - 1e-9)))
    small = step / finer
    n_side = int(gamma / small + 1e-9)
    even = n > 1 and not scene.sensor.is_composite and float(np.ptp(np.diff(scene.bearings))) < 1e-9
    around = even and is_full_turn(scene.bearings) and 2 * n_side < n * finer
    fits = around or (even and step * (n - 1) + 2 * n_side * small < 2 * np.pi - 0.5 * small)
    parts = [beams] if gamma == 0 else [scene.shoot(-gamma), scene.shoot(gamma)]
    if gamma > 0 and fits and scene.sensor.interlaced_sweeps == 1:
        in_fan = np.arange(-n_side, (n - 1) * finer + n_side + 1)
        rays = np.arange(n * finer) if around else in_fan
        whole = scene.shoot(bearings=scene.bearings[0] + small * rays)
        column = in_fan % len(rays) if around else in_fan + n_side
        window = sliding_window_view(_seen(whole, alpha)[:, column], 2 * n_side + 1, axis=1)[:, ::finer]
        at = column[np.arange(n) * finer + window.argmin(axis=2)]
        parts.append(_chosen(whole, at))
    elif gamma > 0:
        parts += [scene.shoot(gamma * share) for share in np.linspace(-1, 1, 2 * n_side + 1)[1:-1]]
    ranges = np.stack([_seen(part, alpha) for part in parts])
    best = ranges.argmin(axis=0)
    for name in ("ux", "uy", "ranges", "wall", "nx", "ny"):
        of_parts = np.stack([getattr(part, name) for part in parts])
        setattr(beams, name, np.take_along_axis(of_parts, best[None], axis=0)[0])
    beams.forget()
    nearest = ranges.min(axis=0)
    lost = ~np.isfinite(nearest)
    beams.reading = np.where(lost, np.inf, beams.ranges)


def _seen(part: Beams, alpha: float) -> Floats:
    """Return the ranges of rays that return, inf for others."""
    if alpha == np.inf:
        return part.ranges
    with np.errstate(invalid="ignore"):
        return np.where(part.incidence <= alpha, part.ranges, np.inf)


def _chosen(whole: Beams, at: Ints) -> Beams:
    """Return some rays of a cast, one per bearing."""
    row = np.arange(len(whole.ranges))[:, None]
    picked = {name: getattr(whole, name)[row, at] for name in ("ux", "uy", "ranges", "wall", "nx", "ny")}
    return Beams(ox=whole.ox, oy=whole.oy, reading=picked["ranges"].copy(), **picked)


def sweep(residuals: Residuals) -> list[list[Mapping[str, float]]]:
    """Return half angles for several largest incidences, if enough readings are short."""
    if residuals.short.mean() < MIN_SHORT:
        return []
    return [[{"gamma": float(gamma), "alpha_max": float(alpha)} for gamma in GAMMAS] for alpha in ALPHAS]


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Count the rays whose cone would contain a nearer surface."""
    gamma = typical["gamma"]
    bearings = exposure.sensor.bearings
    side = int(gamma / np.median(np.abs(np.diff(bearings)))) if len(bearings) > 1 else 0
    shorter = np.zeros(exposure.range.shape, dtype=np.bool_)
    if side:
        seen, reading = exposure.seen, exposure.range
        limit = reading - 4 * max(exposure.sensor.sigma, 1e-3)
        shorter[:, side:] |= seen[:, :-side] & (reading[:, :-side] < limit[:, side:])
        shorter[:, :-side] |= seen[:, side:] & (reading[:, side:] < limit[:, :-side])
    if UNEXPECTED * shorter.sum() >= need:
        return ""
    return "neighbouring rays have similar ranges, so a cone and a thin ray read the same"


SONAR_CONE = Effect(
    name="sonar_cone",
    title="sonar cone",
    channel="scan",
    stage="optics",
    physics="The reading is the nearest return within +-gamma; a surface at an incidence above alpha_max does not return.",
    equation="z = min of r over θ ± γ, no return for α > α_max",
    source="Leonard and Durrant-Whyte (1992), Directed Sonar Sensing for Mobile Robot Navigation",
    varies="the nearest surface in the cone (arcs of constant range, short corners)",
    rivals={
        "mixed_pixels": "turn in place in front of a wall",
        "incidence_dropout": "turn in place in front of a wall",
    },
    parameters=(
        Parameter(
            name="gamma",
            unit="rad",
            doc="half angle of the cone",
            low=0.0,
            high=1.5,
            search_step=0.02,
            typical=float(np.radians(10.0)),
            hidden=lambda _: float(CONE_STEP / np.sqrt(12)),
        ),
        Parameter(
            name="alpha_max",
            unit="rad",
            doc="largest incidence of a return",
            neutral=RIGHT_ANGLE,
            low=0.0,
            high=RIGHT_ANGLE,
            search_step=0.05,
            hidden=wall_direction_error,
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(
        at_edges=True,
        unobservable=unobservable,
        sweep=sweep,
        wide_beam=True,
        leftover_share=0.01,
        misfit_share=0.06,
        is_forecast=False,
    ),
)
