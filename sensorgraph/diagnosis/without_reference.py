"""Runs without a reference in a known place: their poses are located, and driving alone tells of wheels and mount."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

from logs.run import Run
from planners.arena import Arena
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.motion.calibration.driving import DrivingFinding, check_odometry, diagnose_driving
from sensorgraph.diagnosis.motion.calibration.words import ABSORBED
from sensorgraph.diagnosis.result import ChannelResult
from sensorgraph.effects.wheel_slip import WHEEL_SLIP
from sensorgraph.errors import SensorgraphError
from sensorgraph.localization.kept import needs_locating
from sensorgraph.localization.locate import is_located, locate, located_run
from sensorgraph.types import ProgressBars, no_progress
from sensorgraph.world.robot import Robot

logger = logging.getLogger(__name__)


def located_in(run: Run, walls: Arena | None) -> Run:
    """Return a run with the poses of its own scans, where it has no reference; None: in a place of its own."""
    if not needs_locating(run, run.n_scans, None):
        return run
    return located_run(run, locate(run, walls, name="the map" if walls is None else "the arena"))


def drive_alone(runs: Sequence[Run], robot: Robot | None) -> DrivingFinding:
    """Tell wheels and mount of one run or two without arena and reference.

    Raises
    ------
    SensorgraphError : a run has no odometry, or is too short
    """
    names = ["the run"] if len(runs) == 1 else ["the first run", "the second run"]
    for run, name in zip(runs, names, strict=True):
        check_odometry(run, name=name)
    pairs = {name: (run, located_in(run, None)) for name, run in zip(names, runs, strict=True)}
    return diagnose_driving(pairs, base=None if robot is None else robot.wheels.base)


def driving_of(
    run: Run, robot: Robot, *, name: str = "the run", progress: ProgressBars = no_progress
) -> DrivingFinding | None:
    """Calibrate wheels and mount of a located run; None for a run with a reference, and where driving tells nothing."""
    if not is_located(run):
        return None
    try:
        return diagnose_driving({name: (run, run)}, base=robot.wheels.base, progress=progress)
    except SensorgraphError as exc:
        logger.warning("%s", exc)
        return None


def with_driving(finding: Finding, driving: DrivingFinding | None) -> Finding:
    """Put what driving alone tells in place of the odometry channel, which compares wheels with poses of their making."""
    if driving is None or finding.explained is None:
        return finding
    slip = {WHEEL_SLIP.name: "the wheels have helped to make the poses"}
    odometry = ChannelResult(
        channel="odometry",
        effects=driving.effects,
        not_observable={**ABSORBED, **slip},
        notes={"calibration": "from driving alone"},
    )
    return replace(finding, channels={**finding.channels, "odometry": odometry}, driving=driving)
