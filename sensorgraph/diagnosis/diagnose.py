"""Diagnose a run: where simulation and measurement disagree, which effects are missing, how sure that is."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import expit

from logs.run import Run
from planners.arena import Arena
from planners.clearance import Barriers
from planners.errors import PlanError
from sensorgraph.diagnosis.commissioning import Commissioned
from sensorgraph.diagnosis.motion.drive_channel import diagnose_drive
from sensorgraph.diagnosis.motion.odometry_channel import diagnose_odometry
from sensorgraph.diagnosis.next_run.design import NextRun, next_run
from sensorgraph.diagnosis.next_run.questions import open_questions
from sensorgraph.diagnosis.result import ChannelResult, Deviation, Gap, Rival, Unknown
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.goodness_of_fit import GoodnessOfFit, check, deviations
from sensorgraph.diagnosis.scan.held_out_gap import gap, held_out
from sensorgraph.diagnosis.scan.map_alignment import POORLY, Placement, placement
from sensorgraph.diagnosis.scan.model_selection import FEW, MOST, THRESHOLD, Explained, explain
from sensorgraph.diagnosis.scan.observability import alike, not_observable, separation
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import ScanData, prepare_scans
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.diagnosis.scan.site_variation import is_usual
from sensorgraph.diagnosis.scan.standard_errors import material_probability
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import size_ratio
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Progress
from sensorgraph.world.orientation import orientation
from sensorgraph.world.robot import Robot

logger = logging.getLogger(__name__)

PARTS = 7
LEAST_SIGMA = 2e-4  # [m, rad, m/s, rad/s] no reference and no wheel is better
PARTLY_ALIKE = 0.65  # share of readings as long as the arena makes them; with fewer, names mean little
SHORTEST = 0.15  # [m] of a pane, a mirror or a black part
WELL = 0.3  # [m] median error of a scan the right way round
SURELY = 0.65  # chance that a size is material, which a name takes
TRUST = 0.975  # most that a name deserves: now and then something outside the library looks like it
SKIN = 4.0  # map tolerances by which an obstacle over a mapped one must stand out of it
STRIKE = 0.006  # of an effect's evidence; where more than this stays unexplained, its name falls


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """All that a diagnosis says, channel by channel, and what pictures need."""

    channels: dict[str, ChannelResult]
    """`scan`, `odometry`, `drive`."""
    intake: dict[str, Any]
    """What came in, what was used, what was dropped, what this run excites; plain data."""
    data: ScanData
    explained: Explained | None
    verdict: GoodnessOfFit | None
    second_gap: Gap | None = None
    """On a further run that nothing has seen, where one was given."""
    next_run: NextRun | None = None
    """A drive that would tell more; None where none was asked for, or none can be made."""
    seconds: dict[str, float] = field(default_factory=dict)
    """[s] of CPU per part."""

    @property
    def effects(self) -> tuple[Amendment, ...]:
        """Named effects of all channels, strongest evidence first."""
        named = [a for result in self.channels.values() for a in result.effects]
        return tuple(sorted(named, key=lambda a: -(a.evidence or 0.0)))

    @property
    def undecided(self) -> tuple[Amendment, ...]:
        """Effects of all channels that a rival explains as well."""
        return tuple(a for result in self.channels.values() for a in result.undecided)

    @property
    def unknown(self) -> Unknown | None:
        """What no effect of the library explains."""
        return next((result.unknown for result in self.channels.values() if result.unknown), None)


def diagnose(
    run: Run,
    arena: Arena,
    robot: Robot,
    *,
    second: Run | None = None,
    known: Sequence[Amendment] = (),
    noise_bounds: NoiseBounds | None = None,
    threshold: float = THRESHOLD,
    commissioned: Commissioned | None = None,
    seed: int = 0,
    plan_next: bool = True,
    progress: Progress | None = None,
) -> Finding:
    """Compare a run with the simulator of its arena and robot, and name what is missing.

    Parameters
    ----------
    second : a further run of the same robot and place, used for nothing but the gap
    known : effects that are part of the model already
    noise_bounds : of the noise; from a commissioning run
    threshold : [nats] of evidence that a name takes
    commissioned : what a run known to be good showed; the diagnosis is of the difference to it
    plan_next : plan the run that would tell more
    progress : told how many of the PARTS are done
    """
    rng = np.random.default_rng(seed)
    clock = time.process_time()
    seconds: dict[str, float] = {}

    def lap(name: str) -> None:
        nonlocal clock
        now = time.process_time()
        seconds[name] = seconds.get(name, 0.0) + now - clock
        clock = now
        if progress is not None:
            progress(len(seconds), PARTS)

    if commissioned is not None:
        robot, known, noise_bounds = (
            commissioned.robot,
            (*commissioned.known, *known),
            commissioned.noise_bounds,
        )
    machine = with_known(robot, known)
    data, notes = prepare_scans(run, arena, robot, known)
    if commissioned is not None:
        data = commissioned.told(data)
    place = placement(data, rng)
    notes["arena"], notes["share_at_walls"] = place.sentence(), place.share
    words = wrong_way(run, data, arena, place) or ("" if place.fits else place.sentence())
    if words:
        return _misplaced(data, notes, place, words, seconds)
    further = None if second is None else other_run(second, arena, robot, known, commissioned, place, rng)
    held = held_out(data)
    train, unseen = data.part(~held), data.part(held)
    lap("intake")
    most = FEW if place.alike < PARTLY_ALIKE else MOST
    explained = explain(train, noise_bounds or NoiseBounds(), threshold=threshold, most=most)
    lap("explain")
    listed = tuple(deviations(FitResiduals(train, explained.null)))[:24]
    gained = explained.final.j - explained.null.j
    verdict = check(train, explained.final, gained, explained.gains, rng=rng)
    if commissioned is not None:
        verdict = commissioned.calmed(verdict, train)
    lap("criticise")
    scan = _scan_result(train, explained, verdict, listed).settled()
    found = [a for i, a in enumerate(explained.final.model) if i in scan_names(explained, verdict)]
    open_names = {(a.name, a.place) for a in scan.undecided}
    named = [a for a in found if (a.name, a.place) not in open_names]
    proof = gap(unseen, explained.null, explained.final, named, rng=rng)
    second_gap = None if further is None else gap(further, explained.null, explained.final, named, rng=rng)
    lap("prove")
    odometry = beside(diagnose_odometry(run, machine, seed=seed), known).settled()
    use_clock = odometry.unknown is None
    drive = beside(diagnose_drive(run, machine, use_clock=use_clock), known).settled()
    lap("odometry and drive")
    scan = replace(scan, gap=proof, not_observable=not_observable(train, explained.final))
    notes["cannot_tell_apart"] = [asdict(pair) for pair in alike(train, explained.final)]
    lap("observable")
    rivals = [explained.rivals[i][0] for i in scan_order(explained, verdict) if i in explained.rivals]
    plan = _next(scan, found, rivals, arena, robot, seed) if plan_next else None
    lap("next run")
    return Finding(
        channels={"scan": scan, "odometry": odometry, "drive": drive},
        intake={**notes, "rays": int(data.ranges.size), "held_out_scans": int(held.sum())},
        data=data,
        explained=explained,
        verdict=verdict,
        second_gap=second_gap,
        next_run=plan,
        seconds=seconds,
    )


def other_run(
    second: Run,
    arena: Arena,
    robot: Robot,
    known: Sequence[Amendment],
    commissioned: Commissioned | None,
    place: Placement,
    rng: np.random.Generator,
) -> ScanData:
    """Return the evidence of a further run; refuse one of another place.

    Parameters
    ----------
    place : how the first run lies in the arena
    """
    data, _ = prepare_scans(second, arena, robot, known)
    there = placement(data, rng)
    if there.share < min(POORLY, 0.6 * place.share):
        raise SensorgraphError(
            f"the second run does not fit the arena: {100 * there.share:.0f} % of its returns end at walls, "
            f"{100 * place.share:.0f} % of the first run's; give a run of the same place"
        )
    return data if commissioned is None else commissioned.told(data)


def _next(
    scan: ChannelResult,
    named: Sequence[Amendment],
    rivals: Sequence[Amendment],
    arena: Arena,
    robot: Robot,
    seed: int,
) -> NextRun | None:
    """Plan the next run; None where the room or the robot does not allow one."""
    try:
        return next_run(open_questions(scan, named, rivals), arena, robot, seed=seed)
    except PlanError as exc:
        logger.info("no next run: %s", exc)
        return None


def wrong_way(run: Run, data: ScanData, arena: Arena, place: Placement) -> str:
    """Say that the scan is mirrored or turned, if that is why few rays end at walls; else nothing."""
    if place.share > POORLY:
        return ""
    found = orientation(replace(run, sensor=data.sensor), arena)
    if (
        found is None
        or found.best == "as logged"
        or found.fits[found.best] > min(WELL, 0.5 * found.fits["as logged"])
    ):
        return ""
    now, then = found.fits["as logged"], found.fits[found.best]
    return (
        f"the scan fits the arena {found.best}: median error {100 * then:.0f} cm instead of {100 * now:.0f} cm; check the "
        "sign of angle_increment, the mount's yaw and the driver's `inverted` setting"
    )


def _misplaced(
    data: ScanData, notes: dict[str, Any], place: Placement, words: str, seconds: dict[str, float]
) -> Finding:
    """Say that the arena does not fit the run, before anything is named."""
    unknown = Unknown(statement=words, statistic=place.share, threshold=place.best_share)
    skipped = "the arena does not fit the run; move it first"
    return Finding(
        channels={
            "scan": ChannelResult(channel="scan", unknown=unknown),
            "odometry": ChannelResult(channel="odometry", skipped=skipped),
            "drive": ChannelResult(channel="drive", skipped=skipped),
        },
        intake=notes,
        data=data,
        explained=None,
        verdict=None,
        seconds=seconds,
    )


def with_known(robot: Robot, known: Sequence[Amendment]) -> Robot:
    """Return the robot with the motors that known effects describe."""
    extra = {a.name: a.parameters for a in known if a.name in ("actuator_lag", "dead_time")}
    motors = replace(
        robot.actuators,
        tau=robot.actuators.tau + extra.get("actuator_lag", {}).get("tau", 0.0),
        delay=robot.actuators.delay + extra.get("dead_time", {}).get("L", 0.0),
    )
    pose, wheels = robot.pose, robot.wheels
    return replace(
        robot,
        actuators=motors,
        pose=replace(
            pose, sigma_xy=max(pose.sigma_xy, LEAST_SIGMA), sigma_yaw=max(pose.sigma_yaw, LEAST_SIGMA)
        ),
        wheels=replace(
            wheels,
            sigma_v=max(wheels.sigma_v, LEAST_SIGMA),
            sigma_omega=max(wheels.sigma_omega, LEAST_SIGMA),
        ),
    )


def beside(result: ChannelResult, known: Sequence[Amendment]) -> ChannelResult:
    """Leave out of a result what is known of wheels and top speed: named again only if it is another size."""
    same = {a.name: a for a in known if a.name not in ("actuator_lag", "dead_time")}

    def is_new(a: Amendment) -> bool:
        if a.name not in same:
            return True
        off = {k: a[k] - same[a.name].parameters.get(k, 0.0) for k in a.effect.sizes}
        return size_ratio(a.effect, off) >= 1.0

    wild = [
        a for a in result.effects if a.effect.channel == "odometry" and abs(a.parameters.get("s", 0.0)) > 0.5
    ]
    if wild:  # no wheel is that wrong
        words = "odometry and reference do not belong together: way or turn differ in sign or by half"
        return replace(result, effects=(), unknown=Unknown(statement=words))
    slips = [a for a in result.effects if a.name == "wheel_slip"]
    doubtful = (
        slips if len(slips) > 1 and result.unknown is not None else []
    )  # patches that only mimic the unknown
    return replace(result, effects=tuple(a for a in result.effects if is_new(a) and a not in doubtful))


def scan_order(explained: Explained, verdict: GoodnessOfFit) -> list[int]:
    """Return the indices of the effects that are named, strongest evidence first."""
    return sorted(scan_names(explained, verdict), key=lambda i: -explained.gains[i])


def scan_names(explained: Explained, verdict: GoodnessOfFit) -> set[int]:
    """Return the indices of the effects that are named: material, and not struck by a doubt."""
    final = explained.final
    return {
        i
        for i, a in enumerate(final.model)
        if is_material(final, a) and not _is_struck(explained, i, verdict)
    }


def _scan_result(
    data: ScanData, explained: Explained, verdict: GoodnessOfFit, listed: tuple[Deviation, ...]
) -> ChannelResult:
    """Turn the accepted model into names, sizes within tolerance, doubt and rivals."""
    final = explained.final
    complete = [
        replace(
            placed(amendment, data),
            evidence=explained.gains[index],
            probability=probability(explained, index, verdict),
        )
        for index, amendment in enumerate(final.model)
    ]
    small = [a for a in complete if not is_material(final, a)]
    order = scan_order(explained, verdict)
    rivals = []
    for index in order:
        amendment = complete[index]
        if index in explained.rivals:
            rival, short = explained.rivals[index]
            rivals.append(
                Rival(
                    name=rival.name,
                    instead_of=amendment.name,
                    evidence_nats=explained.gains[index] - short,
                    separates=separation(amendment, rival),
                )
            )
    return ChannelResult(
        channel="scan",
        effects=tuple(complete[i] for i in order),
        within_tolerance=tuple(small),
        unknown=_unknown(verdict),
        rivals=tuple(rivals),
        deviations=listed,
    )


def placed(amendment: Amendment, data: ScanData) -> Amendment:
    """Return an effect with its point moved to where its fitted parameters put it."""
    values = amendment.parameters
    if amendment.name == "unmapped_obstacle":
        return amendment.at("", (values["x"], values["y"]))
    if {"a", "b"} <= set(values) and amendment.place in data.arena.names:
        start, end = data.arena.walls[data.arena.names.index(amendment.place)]
        along = (end - start) / max(float(np.hypot(*(end - start))), 1e-9)
        return amendment.at(amendment.place, start + along * (values["a"] + values["b"]) / 2)
    return amendment


def is_material(fitted: Fitted, amendment: Amendment) -> bool:
    """Tell whether an effect is large enough for a name; part of a wall shorter than SHORTEST may be a blurred corner."""
    values = amendment.parameters
    if (
        amendment.effect.place == "wall"
        and {"a", "b"} <= set(values)
        and values["b"] - values["a"] < SHORTEST
    ):
        return False
    if is_usual(fitted, amendment) or not is_known(amendment) or is_skin(fitted, amendment):
        return False
    return material_probability(amendment, amendment.stderr, slackness(fitted, amendment)) >= SURELY


def is_skin(fitted: Fitted, amendment: Amendment) -> bool:
    """Tell whether an obstacle stands out of a mapped one by no more than the map may be wrong there."""
    if amendment.name != "unmapped_obstacle":
        return False
    data, values = fitted.solver.data, amendment.parameters
    place = np.array([[values["x"], values["y"]]])
    if data.arena.contains(place)[0]:
        return False
    stands_out = values["r"] - float(Barriers(data.arena).distances(place)[0])
    return stands_out < SKIN * data.tolerances.map * slackness(fitted, amendment)


def is_known(amendment: Amendment) -> bool:
    """Tell whether the run says how large an effect is: no size is less than its own standard error."""
    sizes = [k for k in amendment.effect.sizes if k in amendment.parameters]
    off = sum((amendment.stderr.get(k, 0.0) / amendment.effect.sizes[k]) ** 2 for k in sizes) ** 0.5
    return not sizes or off < size_ratio(amendment.effect, amendment.parameters)


def slackness(fitted: Fitted, amendment: Amendment) -> float:
    """Return how many times its materiality an effect must be: more, where the tolerances proved too tight."""
    scale = max(fitted.state.map_scale, fitted.state.pose_scale)
    return 1.25 * scale if scale > 1.3 else max(1.0, scale)


def _is_struck(explained: Explained, index: int, verdict: GoodnessOfFit) -> bool:
    """Tell whether a name falls because too much of its own feature is left unexplained."""
    if index in verdict.failed:
        return True
    if (
        explained.final.model[index].name == "quantisation"
    ):  # every reading lies on it, whatever else is amiss
        return False
    return verdict.doubted and verdict.misfit > STRIKE * explained.gains[index]


def probability(explained: Explained, index: int, verdict: GoodnessOfFit) -> float:
    """Return the chance that a name is right and its size material, calibrated on development cases."""
    gain = explained.gains[index]
    margin = explained.rivals[index][1] if index in explained.rivals else gain
    score = 0.15 * min(gain, margin)
    p = TRUST * float(expit(score))
    if verdict.doubted:
        p *= 0.5
    fitted = explained.final
    amendment = fitted.model[index]
    p *= material_probability(amendment, amendment.stderr, slackness(fitted, amendment))
    return float(p)


def _unknown(verdict: GoodnessOfFit) -> Unknown | None:
    if not verdict.doubted:
        return None
    return Unknown(
        statement=f"something no effect of the library explains: {verdict.statement}",
        deviation=verdict.deviation,
        statistic=verdict.statistic,
        threshold=verdict.threshold,
    )
