"""Commissioning: learn the baseline of a site from known-good runs.

A map built from scans, poses located with the same scans and a room full of chairs leave residuals that no
robot.yaml describes. Known-good runs have the same residuals. They show

- the noise of the readings, and the shares of missing returns and outliers,
- the jitter of the poses,
- the evidence and the size that clutter alone gives to each effect of the library.

The `SiteBaseline` holds these values, so that only differences from them are reported for a later run.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence, Set
from dataclasses import replace
from typing import Any

import numpy as np

from logs.run import Run
from planners.arena import Arena
from sensorgraph.diagnosis.map_changes import without_unknown_space
from sensorgraph.diagnosis.raster_map import raster_map_of
from sensorgraph.diagnosis.scan.candidates import SearchMemory, searched, shortlist
from sensorgraph.diagnosis.scan.fit import Fitted, bare_fit, fit
from sensorgraph.diagnosis.scan.goodness_of_fit import check
from sensorgraph.diagnosis.scan.likely_poses import at_likely_poses
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import ScanData, prepare_scans
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.diagnosis.scan.worth import (
    must_be_spread,
    pose_tolerances,
    price,
    shift_tolerances,
    single_effects,
    spread_evidence,
    surely_stands,
)
from sensorgraph.diagnosis.site_baseline import SiteBaseline, SitePrior, WindowEstimate
from sensorgraph.effects import EFFECTS, Amendment, quantisation
from sensorgraph.robust import rms
from sensorgraph.types import Progress
from sensorgraph.work_counter import WorkCounter
from sensorgraph.world.pixel_walls import is_raster
from sensorgraph.world.robot import Robot

logger = logging.getLogger(__name__)

LEVELS = ("core", "tail", "loss", "stray")
"""Levels of the noise of a reading."""


def commission_all(
    runs: Sequence[Run], arena: Arena, robot: Robot, *, seed: int = 0, progress: Progress | None = None
) -> SiteBaseline:
    """Learn the baseline of a site from one or several known-good runs.

    Parameters
    ----------
    seed : Of the simulated replicates.

    Raises
    ------
    SensorgraphError
        A run is too short, has no returns or no poses, or has another sensor than the robot.
    """
    if len(runs) == 1:
        return learnt(prepared(runs[0], arena, robot), robot, seed=seed, progress=progress)
    work = WorkCounter(progress, 2 * len(runs))
    several, shown = [], []
    for run in runs:
        several.append(prepared(run, arena, robot))
        shown.append(range_effects(several[-1]))
        work.add(1)
    known = mean_of(shown)
    baselines = []
    for data in several:
        baselines.append(learnt(data, robot, seed=seed, known=known, progress=work.part(1)))
        work.add(1)
    return merged(baselines)


def learnt(
    data: ScanData,
    robot: Robot,
    *,
    seed: int = 0,
    known: Sequence[Amendment] | None = None,
    progress: Progress | None = None,
) -> SiteBaseline:
    """Learn the baseline from scans of `prepared`.

    Parameters
    ----------
    seed : Of the simulated replicates.
    known : Effects that several runs share, as part of the simulator. None: there is only this run. Its own
        effects become part of the simulator, and its halves determine the tolerances.
    """
    rng, noise = np.random.default_rng(seed), SCAN.site.wide_noise
    cuts = SCAN.site.windows[:2] if known is None else SCAN.site.windows[:1]
    n_windows = sum(
        len(data.windows(n)) for n in (*cuts, *SCAN.site.windows)
    )  # a short run has no short ones
    work = WorkCounter(progress, 2 + n_windows)
    known = site_effects(data) if known is None else tuple(known)
    work.add(1)
    data = replace(data, known=(*data.known, *known), memo={})
    tolerances = shift_tolerances(data, cuts)
    work.add(1)
    hidden = hidden_by_scraps(data.arena)
    data = replace(
        data, tolerances=tolerances, site=SitePrior(floors=dict.fromkeys(hidden, float("inf"))), memo={}
    )
    parts = [window for n in cuts for window in data.windows(n)]
    fits = []
    for window in parts:
        fits.append(bare_fit(window, noise))
        work.add(1)
    bounds = noise_bounds(fits)
    levels: list[tuple[WindowEstimate, ...]] = []
    for n in SCAN.site.windows:
        estimates = []
        for window in data.windows(n):
            estimates.append(window_estimate(window, bounds, rng))
            work.add(1)
        levels.append(tuple(estimates))
    logger.debug("known %s; windows %s", known, levels)
    return SiteBaseline(
        robot=replace(
            robot,
            sensor=replace(robot.sensor, resolution=data.sensor.resolution),
            tolerances=tolerances,
        ),
        known=known,
        noise_bounds=bounds,
        not_looked_for=hidden,
        runs=(tuple(level for level in levels if level),),
    )


def prepared(run: Run, arena: Arena, robot: Robot) -> ScanData:
    """Return the scans of a known-good run, with the resolution of its readings and its pose tolerances."""
    noise = SCAN.site.wide_noise
    if is_raster(arena):
        _, (data, _) = raster_map_of(
            arena,
            lambda pixels: pixels.judged(prepare_scans(run, pixels.arena, pixels.widened(robot))[0]),
            noise,
        )
    else:
        data, _ = without_unknown_space(prepare_scans(run, arena, robot)[0])
    data = at_likely_poses(replace(data, laser_frame=False), noise)
    null = bare_fit(data, noise)
    sensor = data.sensor
    for found in quantisation.propose(FitResiduals(data, null)):
        sensor = replace(sensor, resolution=found.values["q"])
    return replace(data, sensor=sensor, tolerances=pose_tolerances(data, null), memo={})


def merged(several: Sequence[SiteBaseline]) -> SiteBaseline:
    """Merge the baselines of several known-good runs, all with the same known effects."""
    first = several[0]
    tolerances = [b.robot.tolerances for b in several]
    merged_tolerances = replace(
        tolerances[0],
        mount_xy=rms(np.array([t.mount_xy for t in tolerances])),
        mount_yaw=rms(np.array([t.mount_yaw for t in tolerances])),
        stamp=rms(np.array([t.stamp for t in tolerances])),
        pose_xy=float(np.median([t.pose_xy for t in tolerances])),
        pose_yaw=float(np.median([t.pose_yaw for t in tolerances])),
    )
    bounds = [b.noise_bounds for b in several]
    levels: dict[str, Any] = {k: _hull([getattr(b, k) for b in bounds]) for k in LEVELS}
    noise = replace(bounds[0], **levels)
    return SiteBaseline(
        robot=replace(first.robot, tolerances=merged_tolerances),
        known=first.known,
        noise_bounds=noise,
        not_looked_for=tuple(dict.fromkeys(name for b in several for name in b.not_looked_for)),
        runs=tuple(cuts for b in several for cuts in b.runs),
    )


def _hull(intervals: Sequence[tuple[float, float]]) -> tuple[float, float]:
    return min(low for low, _ in intervals), max(high for _, high in intervals)


def window_estimate(data: ScanData, bounds: NoiseBounds, rng: np.random.Generator) -> WindowEstimate:
    """Evaluate one window of a known-good run like a run under test."""
    null = bare_fit(data, bounds)
    gains, sizes = clutter_gains(data, null, bounds)
    smooth, stderrs = single_effects(null)
    return WindowEstimate(
        n_scans=data.n_scans,
        n_readings=int(data.ranges.size),
        gains=gains,
        sizes={**sizes, **smooth},
        stderrs=stderrs,
        misfit=check(data, null, 0.0, {}, rng=rng).misfit,
    )


def hidden_by_scraps(arena: Arena) -> tuple[str, ...]:
    """Return the effects of whole walls and of edges if the map consists of short fragments; otherwise none."""
    size = np.hypot(*(arena.walls[:, 1] - arena.walls[:, 0]).T)
    if len(size) == 0 or np.median(size) > SCAN.site.min_wall:
        return ()
    whole = [name for name, effect in EFFECTS.items() if effect.place in ("wall", "obstacle")]
    edges = [name for name, effect in EFFECTS.items() if effect.diagnostics.at_edges]
    return (*whole, *edges)


def site_effects(data: ScanData) -> tuple[Amendment, ...]:
    """Fit the effects that a site may always show, one after another, while the evidence suffices."""
    noise = SCAN.site.wide_noise
    current = bare_fit(data, noise)
    left = site_starts()
    while left:
        tried = [with_site_effect(data, current, start) for start in left]
        gains = [got.j - current.j - price(got.model[-1], data) for got in tried]
        best = int(np.argmax(gains))
        if gains[best] < SCAN.selection.threshold:
            break
        current = tried[best]
        left.pop(best)
    return current.model


def range_effects(data: ScanData) -> tuple[Amendment, ...]:
    """Fit the range bias and the range scale that a site may always show, jointly.

    The noise is not included: a mean over runs would hide the small noise of a calm run.
    """
    noise = SCAN.site.wide_noise
    current = bare_fit(data, noise)
    for start in site_starts():
        if start.effect.nuisances:
            current = with_site_effect(data, current, start)
    return current.model


def site_starts() -> list[Amendment]:
    """Return the effects that a site may always show, at the start values of their fit."""
    starts = {name: effect.diagnostics.site_start for name, effect in EFFECTS.items()}
    return [EFFECTS[name](**values) for name, values in starts.items() if values is not None]


def with_site_effect(data: ScanData, current: Fitted, start: Amendment) -> Fitted:
    """Add an effect to the fit of a known-good run."""
    noise = SCAN.site.wide_noise
    got = fit(data, (*current.model, start), current.state, noise)
    if got.model[-1].search_steps:
        got = searched(data, got, noise, rounds=6, first=1.0, turns=2)
    return got


def mean_of(shown: Sequence[Sequence[Amendment]]) -> tuple[Amendment, ...]:
    """Return effects that several runs share, each with the mean of its parameters."""
    return tuple(
        same[0].effect(**{k: float(np.mean([a[k] for a in same])) for k in same[0].parameters})
        for same in zip(*shown, strict=True)
    )


def noise_bounds(fits: Sequence[Fitted]) -> NoiseBounds:
    """Return bounds of the noise: slightly above the most in the windows of a known-good run; less is not an effect."""

    def span(name: str) -> tuple[float, float]:
        low, _ = getattr(SCAN.site.wide_noise, name)
        most = max(float(getattr(f.state.noise, name)) for f in fits)
        return low, most * SCAN.noise.core[1]

    levels: dict[str, Any] = {name: span(name) for name in LEVELS}
    return NoiseBounds(**levels, max_scale=1.0)


def clutter_gains(
    data: ScanData, null: Fitted, bounds: NoiseBounds
) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Return the largest evidence of each effect due to clutter [nats], and the sizes of whole-sensor effects.

    Each whole-sensor effect is fitted in every window, even if the window does not propose it. The windows
    that propose it have the most extreme sizes, which do not represent the spread.
    """
    gains: dict[str, float] = {}
    sizes: dict[str, tuple[float, dict[str, float]]] = {}
    proposed = [candidate.amendment for candidate in shortlist(data, null, 0.0, SearchMemory())]
    names = {amendment.name for amendment in proposed}
    for amendment in (*proposed, *unproposed(data, names)):
        got = fit(data, (amendment,), null.state, bounds)
        if got.model[-1].search_steps:
            got = searched(data, got, bounds, rounds=3, first=1.0, turns=1)
        (effect,) = got.model
        gained = spread_evidence(data, got, null) if must_be_spread(effect) else got.j - null.j
        gain = gained - price(effect, data)
        if (
            effect.effect.place is None
            and effect.effect.sizes
            and gain > sizes.get(effect.name, (-np.inf,))[0]
        ):
            sizes[effect.name] = gain, {k: effect[k] for k in effect.effect.sizes}
        if effect.name in names and not surely_stands(effect, data):
            gains[effect.name] = max(gains.get(effect.name, 0.0), gain)
    return gains, {name: values for name, (_, values) in sizes.items()}


def unproposed(data: ScanData, names: Set[str]) -> list[Amendment]:
    """Return further whole-sensor effects that have a size and no nuisance, at their materiality.

    Parameters
    ----------
    names : Effects that are excluded.
    """
    return [
        effect(**{q.name: effect.sizes.get(q.name, 0.0) for q in effect.parameters})
        for name, effect in EFFECTS.items()
        if effect.channel == "scan" and effect.place is None and effect.sizes and not effect.nuisances
        and name not in names and data.may_show(effect)
    ]  # fmt: skip
