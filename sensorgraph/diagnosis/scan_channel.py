"""Scan channel: search for effects, test for unmodelled structure, measure the gap, list unobservable effects; in timed stages."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from sensorgraph.diagnosis.result import ChannelResult, Gap, shared_with
from sensorgraph.diagnosis.scan.considered import effect_entries, family_entries
from sensorgraph.diagnosis.scan.deviations import deviations
from sensorgraph.diagnosis.scan.goodness_of_fit import GoodnessOfFit, check, held_out_gap, told_by_tolerances
from sensorgraph.diagnosis.scan.model_selection import Explained, explain
from sensorgraph.diagnosis.scan.naming import ScanNames, name_scan_effects
from sensorgraph.diagnosis.scan.observability import (
    RunExposure,
    evidence_at_materiality,
    not_observable,
)
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.diagnosis.scan.unnamed.worse_than_specified import (
    doubt_of_losses,
    doubt_of_scatter,
    freed_losses,
    freed_scatter,
)
from sensorgraph.diagnosis.site_baseline import SiteBaseline
from sensorgraph.effects import Amendment
from sensorgraph.types import Progress, ProgressBars, no_progress

STAGES = {
    "intake": "aligning scans with the arena",
    "odometry and drive": "",
    "explain": "",
    "criticise": "testing for unexplained structure",
    "prove": "measuring the gap",
    "observable": "testing what the run could show",
    "next run": "planning the next run",
}
"""Name, as in timing.json -> label of its progress bar; empty: the stage opens bars itself."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanDiagnosis:
    """Results of the scan channel."""

    result: ChannelResult
    names: ScanNames
    explained: Explained
    goodness_of_fit: GoodnessOfFit
    second_gap: Gap | None


def diagnose_scans(
    train: ScanData,
    unseen: ScanData,
    second: ScanData | None,
    *,
    noise_bounds: NoiseBounds,
    baseline: SiteBaseline | None,
    simulated: Sequence[Amendment],
    rng: np.random.Generator,
    clock: StageClock,
) -> ScanDiagnosis:
    """Explain the scans, and measure the gap on scans that no fit has used.

    Parameters
    ----------
    second : Scans of a further run, for a second gap.
    simulated : Effects that a simulation shows. The same effect with the same size is not a difference.
    """
    with clock.stage("explain"):
        explained = explain(train, noise_bounds, progress=clock.progress)
        for freed in (freed_scatter, freed_losses) if baseline is None else ():
            free = freed(train, explained.final, noise_bounds)
            if free is not None:
                noise_bounds = free
                explained = explain(train, free, progress=clock.progress)
    with clock.stage("criticise") as tick:
        goodness, names = judge(train, explained, baseline, rng, tick=tick)
    null, final = explained.null, explained.final
    with clock.stage("prove"):
        gap_of = partial(held_out_gap, null=null, final=final, named=names.named, rng=rng)
        shared = shared_with(names.result, simulated)
        gap = gap_of(unseen, shared=shared)
        second_gap = None if second is None else gap_of(second, shared=shared)
    with clock.stage("observable"):
        exposure = RunExposure(train, final)
        unseen_effects = {**names.result.not_observable, **not_observable(exposure)}
        considered = (
            *effect_entries(train, explained, names.complete, names.small, names.chances),
            *family_entries(goodness, train.sensor.sigma),
        )
        result = replace(
            names.result,
            gap=gap,
            not_observable=unseen_effects,
            at_materiality=evidence_at_materiality(exposure),
            considered=considered,
        )
    return ScanDiagnosis(
        result=result,
        names=names,
        explained=explained,
        goodness_of_fit=goodness,
        second_gap=second_gap,
    )


def judge(
    train: ScanData,
    explained: Explained,
    baseline: SiteBaseline | None,
    rng: np.random.Generator,
    *,
    tick: Progress | None = None,
) -> tuple[GoodnessOfFit, ScanNames]:
    """Test an accepted model for unmodelled structure, and name its effects."""
    null, final = explained.null, explained.final
    found = check(train, final, final.j - null.j, explained.gains, rng=rng, null=null, tick=tick)
    if baseline is not None:
        found = _beyond_usual(found, baseline, train)
    elif not found.is_doubted:
        found = replace(found, told=doubt_of_scatter(final) or doubt_of_losses(final))
    listed = deviations(FitResiduals(train, null))[: SCAN.goodness_of_fit.max_listed]
    names = name_scan_effects(train, explained, found, listed)
    if not found.is_doubted and (told := told_by_tolerances(final, found)) is not None:
        found = told if baseline is None else _beyond_usual(told, baseline, train)
        names = name_scan_effects(train, explained, found, listed)
    return found, names


def _beyond_usual(found: GoodnessOfFit, baseline: SiteBaseline, train: ScanData) -> GoodnessOfFit:
    """Remove unmodelled structure no larger than that of the known-good runs; keep only the excess misfit."""
    beyond = found.misfit - baseline.usual_misfit(train.ranges.size)
    told = None if found.told is None or beyond <= 0 else replace(found.told, misfit=beyond)
    return replace(found, told=told)


class StageClock:
    """CPU time and progress bar of each stage."""

    def __init__(self, progress: ProgressBars) -> None:
        self.seconds: dict[str, float] = {}
        self.progress = progress

    @contextmanager
    def stage(self, name: str) -> Iterator[Progress]:
        """Show a progress bar during a stage, and add its CPU time afterwards."""
        begin, label = time.process_time(), STAGES[name]
        with (self.progress if label else no_progress)(
            label, "replicates" if name == "criticise" else ""
        ) as tick:
            tick(0, 1)
            yield tick
        self.seconds[name] = self.seconds.get(name, 0.0) + time.process_time() - begin
