"""Diagnose a run: where simulation and measurement disagree, which effects are missing, how sure that is."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from logs.run import Run, pair
from planners.arena import Arena
from planners.errors import PlanError
from sensorgraph.diagnosis.finding import Finding, misaligned
from sensorgraph.diagnosis.motion.drive_channel import diagnose_drive
from sensorgraph.diagnosis.motion.odometry_channel import diagnose_odometry
from sensorgraph.diagnosis.naming import (
    ScanNames,
    name_motion_effects,
    name_scan_effects,
    without_limits_of_doubted_wheels,
)
from sensorgraph.diagnosis.next_run.design import NextRun, next_run
from sensorgraph.diagnosis.next_run.questions import open_questions
from sensorgraph.diagnosis.raster_map import RasterMap
from sensorgraph.diagnosis.result import ChannelResult, Gap
from sensorgraph.diagnosis.scan.deviations import deviations
from sensorgraph.diagnosis.scan.goodness_of_fit import check
from sensorgraph.diagnosis.scan.held_out_gap import held_out, held_out_gap
from sensorgraph.diagnosis.scan.map_alignment import Alignment, align, misalignment
from sensorgraph.diagnosis.scan.model_selection import Explained, explain
from sensorgraph.diagnosis.scan.observability import alike, not_observable
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import ScanData, prepare_scans
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.diagnosis.site_baseline import SiteBaseline
from sensorgraph.diagnosis.unknown_space import without_unknown_space
from sensorgraph.effects import Amendment
from sensorgraph.effects.actuator_lag import ACTUATOR_LAG
from sensorgraph.effects.dead_time import DEAD_TIME
from sensorgraph.errors import SensorgraphError
from sensorgraph.intake import check_jumps
from sensorgraph.types import Progress, ProgressBars, no_progress
from sensorgraph.world.pixel_walls import is_raster
from sensorgraph.world.robot import Robot

logger = logging.getLogger(__name__)

STAGES = {
    "intake": "laying scans on the arena",
    "odometry and drive": "",
    "explain": "",
    "criticise": "looking for what is left",
    "prove": "measuring the gap",
    "observable": "asking what the run could show",
    "next run": "planning the next run",
}
"""Name, as timing.json has it -> what its bar says; empty: it opens bars of its own."""
LEAST_SIGMA = 2e-4
"""[m, rad, m/s, rad/s] no reference and no wheel is better."""


def diagnose(
    run: Run,
    arena: Arena,
    robot: Robot,
    *,
    second: Run | None = None,
    known: Sequence[Amendment] = (),
    noise_bounds: NoiseBounds | None = None,
    threshold: float = SCAN.selection.threshold,
    baseline: SiteBaseline | None = None,
    seed: int = 0,
    plan_next: bool = True,
    force: bool = True,
    progress: ProgressBars = no_progress,
) -> Finding:
    """Compare a run with the simulator of its arena and robot, and name what is missing.

    Most of this function is the description of its arguments and one line for each stage.

    Parameters
    ----------
    second : a further run of the same robot and place, used for nothing but the gap
    known : effects that are part of the model already
    noise_bounds : limits of the estimated noise; default: those of a careful set-up
    threshold : [nats] of evidence that a name takes
    baseline : what good runs of the site show (`commissioning`); the diagnosis is of the difference to it
    seed : of the replicates and of the next run
    plan_next : plan the run that would tell more
    force : take a run whose poses jump, too; False: refuse it, as the commands do
    progress : opens a bar for each of the STAGES, and for what is counted within

    Raises
    ------
    SensorgraphError
        A run is too short, has no returns or no poses, poses that jump, or is of another sensor or place.
    """
    check_jumps(run, pair(run), force=force)
    if second is not None:
        check_jumps(second, pair(second), force=force)
    rng = np.random.default_rng(seed)
    clock = _StageClock(progress)
    if baseline is not None:
        robot, known, noise_bounds = baseline.robot, (*baseline.known, *known), baseline.noise_bounds
    with clock.stage("intake"):
        pixels = RasterMap.of(arena) if is_raster(arena) else None
        if pixels is not None:
            arena, robot = pixels.arena, pixels.widened(robot)
        data, intake = _prepare(run, arena, robot, known, baseline, pixels)
        alignment = align(data, rng)
        intake["arena"], intake["share_at_walls"] = alignment.sentence(), alignment.share
        problem = misalignment(alignment, run, data)
    if problem is not None:
        return misaligned(data, intake, problem, clock.seconds)
    with clock.stage("intake"):
        second_data = (
            None if second is None else _prepare_second(second, data, robot, baseline, alignment, rng, pixels)
        )
        held = held_out(data)
        train, unseen = data.subset(~held), data.subset(held)
        run, second = _without_scans(run), None  # from here on a long log's scans would only take memory
    with clock.stage(
        "odometry and drive"
    ):  # first, as both this and the scans need much memory in a long run
        odometry, drive = diagnose_motion(run, robot, known, seed, progress)
    noise_bounds = noise_bounds or SCAN.noise
    with clock.stage("explain"):
        most = _max_effects(alignment)
        explained = explain(train, noise_bounds, threshold=threshold, most=most, progress=progress)
        null, final = explained.null, explained.final
    with clock.stage("criticise") as tick:
        fit = check(train, final, final.j - null.j, explained.gains, rng=rng, tick=tick)
        fit = fit if baseline is None else baseline.discount(fit, train)
        listed = deviations(FitResiduals(train, null))[: SCAN.goodness_of_fit.max_listed]
        names = name_scan_effects(train, explained, fit, listed)
    with clock.stage("prove"):
        gap, second_gap = measure_gaps(unseen, second_data, explained, names, rng)
    with clock.stage("observable"):
        scan = replace(names.result, gap=gap, not_observable=not_observable(train, final))
        intake["cannot_tell_apart"] = [asdict(pair) for pair in alike(train, final)]
    plan = None
    if plan_next:
        with clock.stage("next run"):
            plan = plan_next_run(scan, names, arena, robot, seed)
    return Finding(
        channels={"scan": scan, "odometry": odometry, "drive": drive},
        intake={**intake, "rays": int(data.ranges.size), "held_out_scans": int(held.sum())},
        data=data,
        explained=explained,
        goodness_of_fit=fit,
        second_gap=second_gap,
        next_run=plan,
        seconds=clock.seconds,
    )


class _StageClock:
    """CPU time per stage, and a bar for each."""

    def __init__(self, progress: ProgressBars) -> None:
        self.seconds: dict[str, float] = {}
        self._progress = progress

    @contextmanager
    def stage(self, name: str) -> Iterator[Progress]:
        """Say what is done now, and book its time when it has ended."""
        begin, label = time.process_time(), STAGES[name]
        with (self._progress if label else no_progress)(
            label, "replicates" if name == "criticise" else ""
        ) as tick:
            tick(0, 1)
            yield tick
        self.seconds[name] = self.seconds.get(name, 0.0) + time.process_time() - begin


def _without_scans(run: Run) -> Run:
    """Return the motion of a run alone."""
    return replace(run, stamps=run.stamps[:0], ranges=run.ranges[:0])


def _max_effects(alignment: Alignment) -> int:
    """Return how many effects a model may have: few where the arena matches the run only in part."""
    is_partial = alignment.matching < SCAN.alignment.partly_matching
    selection = SCAN.selection
    return selection.max_effects_if_partly_matching if is_partial else selection.max_effects


def _prepare(
    run: Run,
    arena: Arena,
    robot: Robot,
    known: Sequence[Amendment],
    baseline: SiteBaseline | None,
    pixels: RasterMap | None,
) -> tuple[ScanData, dict[str, Any]]:
    """Return the scans of a run, to be judged against the baseline if there is one, and notes for the report."""
    data, notes = prepare_scans(run, arena, robot, known)
    if pixels is not None:
        data, notes["map_of_pixels"] = pixels.judged(data)
    else:
        data, notes["into_unknown_share"] = without_unknown_space(data)
    return data if baseline is None else baseline.apply_to(data), dict(notes)


def _prepare_second(
    run: Run,
    first: ScanData,
    robot: Robot,
    baseline: SiteBaseline | None,
    alignment: Alignment,
    rng: np.random.Generator,
    pixels: RasterMap | None,
) -> ScanData:
    """Return the scans of a further run; refuse one of another place.

    Parameters
    ----------
    first : scans of the first run
    alignment : of the first run with the arena
    """
    data, _ = _prepare(run, first.arena, robot, first.known, baseline, pixels)
    share = align(data, rng).share
    if share < min(SCAN.alignment.poor_share, SCAN.alignment.second_run_share * alignment.share):
        raise SensorgraphError(
            f"the second run does not fit the arena: {100 * share:.0f} % of its returns end at walls, "
            f"{100 * alignment.share:.0f} % of the first run's; give a run of the same place"
        )
    return data


def measure_gaps(
    unseen: ScanData,
    second: ScanData | None,
    explained: Explained,
    names: ScanNames,
    rng: np.random.Generator,
) -> tuple[Gap, Gap | None]:
    """Return the gap on the held-out scans, and on those of a second run if there is one."""
    null, final = explained.null, explained.final
    gap = held_out_gap(unseen, null, final, names.named, rng=rng)
    return gap, None if second is None else held_out_gap(second, null, final, names.named, rng=rng)


def diagnose_motion(
    run: Run,
    robot: Robot,
    known: Sequence[Amendment],
    seed: int,
    progress: ProgressBars = no_progress,
) -> tuple[ChannelResult, ChannelResult]:
    """Return what the odometry channel and the drive channel show."""
    model = motion_model(robot, known)
    with progress("comparing wheels with poses", ""):
        odometry = name_motion_effects(diagnose_odometry(run, model, seed=seed), known)
    with progress("comparing commands with wheels", ""):
        found = diagnose_drive(run, model, use_clock=odometry.unknown is None, wheels=odometry.motion)
        drive = name_motion_effects(without_limits_of_doubted_wheels(found, odometry), known)
    return odometry, drive


def motion_model(robot: Robot, known: Sequence[Amendment]) -> Robot:
    """Return the robot with the motors that known effects describe, and with noise that is never zero."""
    actuators, pose, wheels = robot.actuators, robot.pose, robot.wheels
    return replace(
        robot,
        actuators=replace(
            actuators,
            tau=actuators.tau + sum(a["tau"] for a in known if a.effect is ACTUATOR_LAG),
            delay=actuators.delay + sum(a["L"] for a in known if a.effect is DEAD_TIME),
        ),
        pose=replace(
            pose, sigma_xy=max(pose.sigma_xy, LEAST_SIGMA), sigma_yaw=max(pose.sigma_yaw, LEAST_SIGMA)
        ),
        wheels=replace(
            wheels,
            sigma_v=max(wheels.sigma_v, LEAST_SIGMA),
            sigma_omega=max(wheels.sigma_omega, LEAST_SIGMA),
        ),
    )


def plan_next_run(
    scan: ChannelResult, names: ScanNames, arena: Arena, robot: Robot, seed: int
) -> NextRun | None:
    """Plan the next run; None where the room or the robot does not allow one."""
    try:
        return next_run(open_questions(scan, names.accepted, names.rivals), arena, robot, seed=seed)
    except PlanError as exc:
        logger.info("no next run: %s", exc)
        return None
