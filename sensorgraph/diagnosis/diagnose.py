"""Diagnose a run: where simulation and measurement differ, which effects are missing, with what confidence."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from logs.run import Run, pair
from planners.arena import Arena
from planners.errors import PlanError
from sensorgraph.diagnosis.finding import Finding, misaligned
from sensorgraph.diagnosis.map_changes import without_unknown_space
from sensorgraph.diagnosis.motion.calibration.driving import DrivingFinding, diagnose_driving
from sensorgraph.diagnosis.motion.drive_channel import diagnose_drive
from sensorgraph.diagnosis.motion.naming import (
    as_one_doubt,
    beside_doubted_wheels,
    name_motion_effects,
)
from sensorgraph.diagnosis.motion.odometry_channel import diagnose_odometry
from sensorgraph.diagnosis.next_run.design import NextRun, next_run
from sensorgraph.diagnosis.next_run.questions import RoomExposure, open_questions
from sensorgraph.diagnosis.raster_map import RasterMap, raster_map_of
from sensorgraph.diagnosis.result import ChannelResult, shared_with, without_shared
from sensorgraph.diagnosis.scan.goodness_of_fit import held_out
from sensorgraph.diagnosis.scan.likely_poses import at_likely_poses, fitted_and_held_out, freed_of_scans
from sensorgraph.diagnosis.scan.map_alignment import Alignment, align, misalignment
from sensorgraph.diagnosis.scan.scan_data import ScanData, prepare_scans
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.diagnosis.scan_channel import (
    ScanDiagnosis,
    StageClock,
    diagnose_scans,
)
from sensorgraph.diagnosis.site_baseline import SiteBaseline
from sensorgraph.effects import Amendment
from sensorgraph.effects.actuator_lag import ACTUATOR_LAG
from sensorgraph.effects.dead_time import DEAD_TIME
from sensorgraph.errors import SensorgraphError
from sensorgraph.intake import check_jumps, check_moves, log_notes
from sensorgraph.localization.locate import corrections_of, is_located
from sensorgraph.types import ProgressBars, no_progress
from sensorgraph.world.pixel_walls import is_raster
from sensorgraph.world.robot import Robot

logger = logging.getLogger(__name__)

LEAST_SIGMA = 2e-4
"""[m, rad, m/s, rad/s] lower limit of the noise of reference poses and wheels."""


def diagnose(
    run: Run,
    arena: Arena,
    robot: Robot,
    *,
    second: Run | None = None,
    known: Sequence[Amendment] = (),
    baseline: SiteBaseline | None = None,
    seed: int = 0,
    plan_next: bool = True,
    force: bool = True,
    simulated: Sequence[Amendment] = (),
    progress: ProgressBars = no_progress,
) -> Finding:
    """Compare a run with the simulation of its arena and robot, and name the missing effects.

    Parameters
    ----------
    second : A further run of the same robot and place; used only to measure the gap.
    known : Effects that are already part of the model.
    baseline : What known-good runs of the site show (`commissioning`). Only differences from it are reported.
    seed : Of the simulated replicates (parametric bootstrap) and of the next run.
    plan_next : Plan a run that could answer the open questions.
    force : Accept a run whose poses jump; False: reject it, as the commands do.
    simulated : Effects that a simulation of the run shows; the same size is not a difference.
    progress : Opens a bar for each of the STAGES and for their counted steps.

    Raises
    ------
    SensorgraphError
        A run is too short, has no returns or no poses, has poses that jump, or is of another sensor or place.
    """
    _check_motion(run, second, force=force)
    rng, clock, noise_bounds = np.random.default_rng(seed), StageClock(progress), SCAN.noise
    if baseline is not None:
        robot, known, noise_bounds = baseline.robot, (*baseline.known, *known), baseline.noise_bounds
    with clock.stage("intake"):
        laid = _laid_on_arena(run, arena, robot, known, baseline, noise_bounds, rng)
        if problem := misalignment(laid.alignment, run, laid.data):
            return misaligned(laid.data, laid.notes, problem, clock.seconds, _driving(run, laid, progress))
        if baseline is None and is_located(run):
            laid = _with_free_poses(laid, noise_bounds)
        other = None if second is None else _prepare_second(second, laid, baseline, noise_bounds, rng)
        parts = (*_split(laid, noise_bounds), other)
        run, second = run.take_scans(slice(0)), None  # the scans of a long log are no longer needed
    with clock.stage("odometry and drive"):  # before the scans, since both need much memory in a long run
        odometry, drive = diagnose_motion(run, laid.robot, known, progress)
    scans = diagnose_scans(
        *parts, noise_bounds=noise_bounds, baseline=baseline, simulated=simulated, rng=rng, clock=clock
    )
    found = _finding(laid, scans, odometry, drive, simulated)
    plan = _planned(scans, laid, seed, clock) if plan_next else None
    return replace(found, next_run=plan, seconds=clock.seconds)


def _finding(
    laid: _Laid,
    scans: ScanDiagnosis,
    odometry: ChannelResult,
    drive: ChannelResult,
    simulated: Sequence[Amendment],
) -> Finding:
    """Return the finding, with the channels adjusted for what a simulation shows."""
    return Finding(
        channels={one.channel: without_shared(one, simulated) for one in (scans.result, odometry, drive)},
        intake=laid.notes,
        data=laid.data,
        explained=scans.explained,
        goodness_of_fit=scans.goodness_of_fit,
        second_gap=scans.second_gap,
        shared=tuple(a for one in (scans.result, odometry, drive) for a in shared_with(one, simulated)),
    )


def _split(laid: _Laid, noise_bounds: NoiseBounds) -> tuple[ScanData, ScanData]:
    """Return the scans for fits and the held-out ones, and note how many there are."""
    held = held_out(laid.data)
    laid.notes.update(rays=int(laid.data.ranges.size), held_out_scans=int(held.sum()))
    return fitted_and_held_out(laid.data, held, noise_bounds)


def _driving(run: Run, laid: _Laid, progress: ProgressBars) -> DrivingFinding | None:
    """Calibrate wheels and mount of a run whose poses are in another frame than the arena; None without odometry.

    In another place, the arena is to be corrected first.
    """
    if not laid.alignment.fits_elsewhere:
        return None
    name = str(run.meta.get("source", "the run"))
    try:
        return diagnose_driving({name: (run, run)}, base=laid.robot.wheels.base, progress=progress)
    except SensorgraphError as exc:
        logger.info("wheels and mount are not calibrated: %s", exc)
        return None


def _check_motion(run: Run, second: Run | None, *, force: bool) -> None:
    """Reject runs whose poses jump or never move."""
    for one in [run] if second is None else [run, second]:
        check_jumps(one, pair(one), force=force)
        check_moves(one)


def _prepare(
    run: Run,
    arena: Arena,
    robot: Robot,
    known: Sequence[Amendment],
    baseline: SiteBaseline | None,
    pixels: RasterMap | None,
) -> tuple[ScanData, dict[str, Any]]:
    """Return the scans of a run, prepared for the baseline if there is one, and notes for the report."""
    data, notes = prepare_scans(run, arena, robot, known)
    if pixels is not None:
        data, notes["map_of_pixels"] = pixels.judged(data)
    else:
        is_uncommissioned = arena.is_identified and baseline is None
        data, said = without_unknown_space(data, with_changes=not is_uncommissioned)
        notes |= said | {"is_uncommissioned_graph": is_uncommissioned}
    if baseline is not None:
        # the poses may be those of the laser itself: a mount that has moved since then shows as a difference
        site = baseline.prior(data.n_scans, data.ranges.size)
        data = replace(data, laser_frame=False, site=site, memo={})
    return data, dict(notes)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Laid:
    """A run, prepared for comparison with its arena."""

    data: ScanData
    notes: dict[str, Any]
    """For the report."""
    alignment: Alignment
    arena: Arena
    robot: Robot
    """As used in the diagnosis: walls instead of grid cells, and tolerances that account for this."""
    pixels: RasterMap | None


def _laid_on_arena(
    run: Run,
    arena: Arena,
    robot: Robot,
    known: Sequence[Amendment],
    baseline: SiteBaseline | None,
    noise_bounds: NoiseBounds,
    rng: np.random.Generator,
) -> _Laid:
    """Prepare the scans of a run, and measure how well they fit the arena."""
    pixels: RasterMap | None = None
    if is_raster(arena):

        def prepare(pixels: RasterMap) -> tuple[ScanData, dict[str, Any]]:
            return _prepare(run, pixels.arena, pixels.widened(robot), known, baseline, pixels)

        pixels, (data, notes) = raster_map_of(arena, prepare, noise_bounds)
        arena, robot = pixels.arena, pixels.widened(robot)
    else:
        data, notes = _prepare(run, arena, robot, known, baseline, None)
    alignment = align(data, rng)
    notes["arena"], notes["share_at_walls"] = alignment.sentence(), alignment.share
    notes["log_notes"] = [*log_notes(run), *corrections_of(run)]
    return _Laid(data=data, notes=notes, alignment=alignment, arena=arena, robot=robot, pixels=pixels)


def _with_free_poses(laid: _Laid, noise_bounds: NoiseBounds) -> _Laid:
    """Widen the pose tolerances of a run that its own scans located, by the shift that an effect can cause."""
    data = freed_of_scans(laid.data, noise_bounds)
    return replace(laid, data=data, notes={**laid.notes, "poses_of_its_own_scans": data.from_scans})


def _prepare_second(
    run: Run,
    first: _Laid,
    baseline: SiteBaseline | None,
    noise_bounds: NoiseBounds,
    rng: np.random.Generator,
) -> ScanData:
    """Return the scans of a second run, and add its notes; reject a run of another place."""
    first.notes["log_notes"] += log_notes(run)
    data, _ = _prepare(run, first.data.arena, first.robot, first.data.known, baseline, first.pixels)
    if first.data.from_scans and is_located(run):
        data = replace(data, from_scans=True, tolerances=first.data.tolerances, memo={})
    share = align(data, rng).share
    if share < SCAN.alignment.poor_share * first.alignment.share:
        raise SensorgraphError(
            f"the second run does not fit the arena: {100 * share:.0f} % of its returns end at walls, "
            f"compared with {100 * first.alignment.share:.0f} % in the first run; give a run of the same place"
        )
    return at_likely_poses(replace(data, corners=first.data.corners), noise_bounds, even_rays=True)


def diagnose_motion(
    run: Run,
    robot: Robot,
    known: Sequence[Amendment],
    progress: ProgressBars = no_progress,
) -> tuple[ChannelResult, ChannelResult]:
    """Return the results of the odometry channel and the drive channel."""
    model = motion_model(robot, known)
    with progress("comparing wheels with poses", ""):
        found = diagnose_odometry(run, model)
        odometry = name_motion_effects(found, known)
    with progress("comparing commands with wheels", ""):
        driven = diagnose_drive(
            run,
            model,
            use_clock=odometry.unknown is None,
            wheels=odometry.motion,
            named_wheels=odometry.effects,
        )
        drive = name_motion_effects(beside_doubted_wheels(driven, odometry), known)
    return as_one_doubt(odometry, drive)


def motion_model(robot: Robot, known: Sequence[Amendment]) -> Robot:
    """Return the robot with the known motor effects included, and with noise that is never zero."""
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


def _planned(scans: ScanDiagnosis, laid: _Laid, seed: int, clock: StageClock) -> NextRun | None:
    """Plan the next run; return None if the room or the robot does not allow one."""
    with clock.stage("next run"):
        try:
            room = RoomExposure(laid.arena, laid.robot, seed=seed)
            names = scans.names
            questions = open_questions(scans.result, names.accepted, names.rivals, room.can_show)
            return next_run(questions, laid.arena, laid.robot, seed=seed)
        except PlanError as exc:
            logger.info("no next run: %s", exc)
            return None
