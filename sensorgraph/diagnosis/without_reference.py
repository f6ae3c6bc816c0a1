"""Runs without reference poses in a known place: locate them, and calibrate them from driving alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from logs.run import Run
from logs.transforms import compose, invert
from planners.arena import Arena
from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.motion.calibration.comparison import ABSORBED, QUANTITIES
from sensorgraph.diagnosis.motion.calibration.driving import DrivingFinding, check_odometry, diagnose_driving
from sensorgraph.diagnosis.motion.calibration.effects import effects_of
from sensorgraph.diagnosis.result import ChannelResult, Rival
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import Effect
from sensorgraph.effects.map_scale import MAP_SCALE
from sensorgraph.effects.range_scale import RANGE_SCALE
from sensorgraph.effects.wheel_slip import WHEEL_SLIP
from sensorgraph.errors import SensorgraphError
from sensorgraph.localization.kept import needs_locating
from sensorgraph.localization.locate import is_located, locate, located_run
from sensorgraph.types import ProgressBars, no_progress
from sensorgraph.world.robot import Robot
from sensorgraph.world.sweep import with_sweep_of

STRETCHES = (RANGE_SCALE, MAP_SCALE)
METRES = "a wall of the map measured with a tape, or wheels with a known distance scale"
"""What distinguishes the length scale of the laser from that of the map, if poses were located in the map."""


def located_in(run: Run, walls: Arena | None, robot: Robot | None = None) -> Run:
    """Return a run located with its own scans, if it has no reference poses.

    Parameters
    ----------
    walls : Where it is located; None: in a map built from the run itself.
    robot : States ray times and the mount of the laser; None: as logged.
    """
    run = run if robot is None else with_sweep_of(run, robot)
    if needs_locating(run, run.n_scans, None):
        run = located_run(run, locate(run, walls, name="the map" if walls is None else "the arena"))
    return run if robot is None else with_described_mount(run, robot)


def with_described_mount(run: Run, robot: Robot) -> Run:
    """Return a located run with the laser mount that robot.yaml states.

    The scans locate the laser, so that the poses of the base follow from the mount.
    """
    said, logged = np.asarray(robot.sensor.mount), np.asarray(run.sensor.mount)
    is_stated = "sensor.mount" in robot.stated
    if not is_stated or not is_located(run) or run.sensor.is_composite or np.array_equal(said, logged):
        return run
    base = compose(np.broadcast_to(logged, (1, 3)), invert(said[None]))
    poses = compose(run.poses, np.broadcast_to(base, run.poses.shape))
    return replace(run, poses=poses, sensor=replace(run.sensor, mount=said))


def drive_alone(runs: Sequence[Run], robot: Robot | None) -> DrivingFinding:
    """Calibrate wheels and mount of one or two runs without arena and reference poses.

    Raises
    ------
    SensorgraphError : A run has no odometry.
    """
    names = ["the run"] if len(runs) == 1 else ["the first run", "the second run"]
    for run, name in zip(runs, names, strict=True):
        check_odometry(run, name=name)
    pairs = {name: (run, located_in(run, None)) for name, run in zip(names, runs, strict=True)}
    return diagnose_driving(pairs, base=None if robot is None else robot.stated_base)


def _wrong_metre(
    driving: DrivingFinding | None, stretch: Amendment, robot: Robot
) -> tuple[DrivingFinding | None, Effect | None]:
    """Return the calibration in a valid length scale, and the effect that stretches the readings.

    The effect is None if the wheels do not decide.
    """
    if driving is None:
        return None, None
    name, found = list(driving.runs.items())[-1]
    s, s_error = stretch["s"], stretch.stderr["s"] if stretch.stderr else 0.0
    in_map = found.by_metre(1 + s, s_error)
    q, ways = QUANTITIES["way_scale"], (one.of("way_scale") for one in (found, in_map))
    agrees_with_laser, agrees_with_map = (not q.is_off(way - 1, error) for way, error in ways)
    if agrees_with_map == agrees_with_laser:
        return driving, None
    if agrees_with_laser:
        return driving, MAP_SCALE
    effects = effects_of(in_map, robot.stated_base)
    return replace(driving, runs={**driving.runs, name: in_map}, effects=effects), RANGE_SCALE


def _with_stretch(finding: Finding, stretch: Amendment, wrong: Effect | None) -> Finding:
    """Name the effect that stretches the readings: `range_scale` or `map_scale`; if `wrong` is None, neither."""
    if stretch.effect is wrong:
        return finding
    scan = finding.channels["scan"]
    others = tuple(a for a in scan.effects if a is not stretch)
    if wrong is RANGE_SCALE:  # same readings, since the located poses stretch with the map
        errors = {"s": (stretch.stderr or {}).get("s", 0.0)}
        named = replace(
            RANGE_SCALE(s=stretch["s"]),
            stderr=errors,
            evidence=stretch.evidence,
            probability=stretch.probability,
        )
        rivals = tuple(rival for rival in scan.rivals if rival.instead_of != stretch.name)
        scan = replace(scan, effects=(*others, named), rivals=rivals)
    else:
        other = next(effect for effect in STRETCHES if effect is not stretch.effect)
        nats = stretch.evidence or 0.0
        rival = Rival(name=other.name, instead_of=stretch.name, evidence_nats=nats, separates=METRES)
        scan = replace(
            scan, effects=others, undecided=(*scan.undecided, stretch), rivals=(*scan.rivals, rival)
        )
    return replace(finding, channels={**finding.channels, "scan": scan})


def _without_wheels(finding: Finding, why: str) -> Finding:
    if finding.channels["odometry"].skipped:
        return finding
    why = f"the poses were located with the scans, and driving alone does not determine the wheels: {why}"
    skipped = ChannelResult(channel="odometry", skipped=why)
    return replace(finding, channels={**finding.channels, "odometry": skipped})


def driving_of(
    run: Run, robot: Robot, *, name: str = "the run", progress: ProgressBars = no_progress
) -> DrivingFinding | str | None:
    """Calibrate wheels and mount of a located run; return None for a run with reference poses.

    Return the reason if driving alone does not determine them.
    """
    if not is_located(run):
        return None
    try:
        return diagnose_driving({name: (run, run)}, base=robot.stated_base, progress=progress)
    except SensorgraphError as exc:
        return str(exc)


def with_driving(finding: Finding, driving: DrivingFinding | str | None, robot: Robot) -> Finding:
    """Replace the odometry channel, which compares wheels with poses that depend on them, by the calibration.

    If driving alone does not determine the wheels, they are not evaluated: located poses are no reference for
    them.

    If readings are longer or shorter than the map, the length scales of laser, map and wheels are compared.
    The one that disagrees with the other two is wrong. Poses that were located in the map have stretched with
    it, so that the scans alone do not decide.
    """
    if finding.explained is None:
        return finding
    if isinstance(driving, str):
        finding, driving = _without_wheels(finding, driving), None
    stretch = next((a for a in finding.effects if a.effect in STRETCHES and not a.place), None)
    if stretch is not None and finding.data.from_scans:
        driving, wrong = _wrong_metre(driving, stretch, robot)
        finding = _with_stretch(finding, stretch, wrong)
    if driving is None:
        return finding
    beside, alone = finding.channels["odometry"], driving.channel
    # a slippery patch is local, which the calibration of a whole run does not show
    slips = [a for a in beside.effects if a.effect is WHEEL_SLIP]
    odometry = replace(
        alone,
        effects=(*alone.effects, *slips),
        considered=(*alone.considered, *(one for one in beside.considered if one.name == WHEEL_SLIP.name)),
        not_observable={
            **alone.not_observable,
            **ABSORBED,
            **{k: why for k, why in beside.not_observable.items() if k == WHEEL_SLIP.name},
        },
        motion=beside.motion if slips else None,
    )
    return replace(finding, channels={**finding.channels, "odometry": odometry}, driving=driving)
