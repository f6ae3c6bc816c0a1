"""Odometry channel: odometry against reference poses, for wheel effects, slippery patches and the clock offset.

Reference poses are averaged over a tenth of a second. Between two averages, the motion of the body along its
heading and in yaw is compared with the wheels. Its motion across the heading is compared with wheels that
roll without slipping.

Odometry may count backwards: its distance, its turns, both, or one of its wheels. With the wheels l and r, distance (l + r) / 2 and turn (r - l) / b, a left wheel that counts backwards exchanges distance
and turn; a right one does it with the opposite sign.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.run import Run
from sensorgraph.diagnosis.engine import selection as engine
from sensorgraph.diagnosis.motion.consequence import ReferenceError, SimulationError, reference_error
from sensorgraph.diagnosis.motion.increments import MIN_ROWS, ChannelSkippedError, clock_sigma
from sensorgraph.diagnosis.motion.reference_noise import LimitedNoiseFitter, noise_limits
from sensorgraph.diagnosis.motion.regression import CLUSTER, Term
from sensorgraph.diagnosis.motion.report import TriedEffect, channel_result
from sensorgraph.diagnosis.motion.selection import MotionChannel, admitted_structure
from sensorgraph.diagnosis.motion.slip_patches import best_patch, gains_of_discs, patch_price, refine_patch
from sensorgraph.diagnosis.motion.structure_test import StructureFamily, StructureTest
from sensorgraph.diagnosis.motion.wheel_model import WheelModel
from sensorgraph.diagnosis.motion.wheel_rows import (
    AVERAGING_TIME,
    WINDOW,
    MotionSignals,
    OdometryRows,
    motion_signals,
    rows_at,
)
from sensorgraph.diagnosis.motion.wheel_structure import odometry_families, reference_jumps
from sensorgraph.diagnosis.motion.whitening import by_kind
from sensorgraph.diagnosis.result import ChannelResult, MotionDifference, Unknown
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Effect
from sensorgraph.effects.wheel_slip import WHEEL_SLIP
from sensorgraph.localization.locate import is_located
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot

MAX_CLOCK = 0.8
"""[s] maximum clock offset of the search."""
CLOCK_STEP = 0.025
"""[s] step of the search."""
CERTAIN = 0.8
"""Correlation above which two motions are the same, and below minus which they are opposite."""


def diagnose_odometry(run: Run, robot: Robot) -> ChannelResult:
    """Name the effects that make odometry and reference poses differ.

    A run without odometry or separate reference poses is skipped, with the reason in `ChannelResult.skipped`.
    """
    try:
        signals = motion_signals(run)
        if backwards := counts_backwards(signals):
            words = f"{backwards}; correct the sign, then diagnose again"
            return ChannelResult(channel="odometry", unknown=Unknown(statement=words))
        rows = aligned_rows(signals)
    except ChannelSkippedError as exc:
        return ChannelResult(channel="odometry", skipped=str(exc))
    model = WheelModel(rows, signals.wheels, robot)
    late = clock_left(model)
    moved = rows_at(signals, rows.clock + late)
    if moved is not None:
        model = WheelModel(moved, signals.wheels, robot)
    if run.pose_frame == "base_link" and not is_located(run):
        model.allow_askew()
    terms = select(model)
    return odometry_result(model, terms, signals)


def clock_left(model: WheelModel) -> float:
    """Return the remaining error of the assumed clock offset, with all effects free [s]."""
    theta = model.fit(model.effects).solution.theta
    return float(np.clip(theta[model.clock], -CLOCK_STEP, CLOCK_STEP))


def odometry_clock_offset(run: Run, robot: Robot) -> tuple[float, float] | None:
    """Return the age of the odometry at its stamps, and its standard error [s]; None if it is not observable."""
    try:
        signals = motion_signals(run)
        rows = aligned_rows(signals)
    except ChannelSkippedError:
        return None
    model = WheelModel(rows, signals.wheels, robot)
    fit, clock = model.fit(model.effects).solution, model.clock
    error = model.regression.clustered_errors(fit, model.clusters)[clock]
    return rows.clock + float(fit.theta[clock]), float(error)


def aligned_rows(signals: MotionSignals) -> OdometryRows:
    """Return the rows at the clock offset of the coarse search; the regression has a column for what is left of it.

    Raises
    ------
    ChannelSkippedError
        Poses and odometry hardly overlap.
    """
    rows = rows_at(signals, coarse_offset(signals))
    n = 0 if rows is None else int(rows.valid.sum())
    if rows is None or n < MIN_ROWS:
        raise ChannelSkippedError(
            f"poses and odometry overlap in {n} tenths of a second, expected at least {MIN_ROWS}"
        )
    return rows


def coarse_offset(signals: MotionSignals) -> float:
    """Return the clock offset [s] at which turn rate and speed of wheels and reference agree best.

        maximise over tau  - sum over t of (reference(t) - wheels(t + tau))² / power of the reference

    The sum includes turn and distance. Aligning sensors by their turn rates is the method of Olson (2010), "A passive
    solution to the sensor synchronization problem".
    """
    stamps, poses, wheels = signals.stamps, signals.poses, signals.wheels
    first, last = max(stamps[0], wheels.start[0]), min(stamps[-1], wheels.end[-1])
    grid = np.arange(first, last, CLOCK_STEP)
    margin = round(MAX_CLOCK / CLOCK_STEP)
    if len(grid) < 4 * margin:  # shorter than the search
        return 0.0
    seen = np.stack([np.interp(grid, stamps, column) for column in poses.T], axis=1)
    dx, dy, turn = np.gradient(seen, axis=0)[margin:-margin].T
    heading = seen[margin:-margin, 2]
    ends, fit = np.append(wheels.start, wheels.end[-1]), np.zeros(2 * margin + 1)
    along = dx * np.cos(heading) + dy * np.sin(heading)
    for of_reference, of_wheels in ((turn, wheels.turn), (along, wheels.distance)):
        power = np.sum((of_reference - of_reference.mean()) ** 2)
        if power < 1e-12:
            continue
        move = np.gradient(np.interp(grid, ends, np.append(0.0, np.cumsum(of_wheels))))
        shifted = np.lib.stride_tricks.sliding_window_view(move, len(of_reference))
        fit -= ((of_reference - shifted) ** 2).sum(axis=1) / power  # odometry at t + tau corresponds to t
    k = int(np.argmax(fit))
    if not 0 < k < len(fit) - 1:
        return 0.0
    a, b, c = fit[k - 1 : k + 2]
    bend = a - 2 * b + c
    return float((k - margin + (0.5 * (a - c) / bend if bend < 0 else 0.0)) * CLOCK_STEP)


def counts_backwards(signals: MotionSignals) -> str:
    """Return what of the odometry counts backwards, relative to the reference poses; empty if nothing does."""
    wheels, poses = signals.wheels, signals.poses
    first, last = max(wheels.start[0], signals.stamps[0]), min(wheels.end[-1], signals.stamps[-1])
    edges = np.arange(first, last, WINDOW)
    if len(edges) * WINDOW < MIN_ROWS * AVERAGING_TIME:
        return ""
    ends = np.append(wheels.start, wheels.end[-1])
    counted = [
        np.diff(np.interp(edges, ends, np.append(0.0, np.cumsum(part))))
        for part in (wheels.distance, wheels.turn)
    ]
    heading = np.unwrap(poses[:, 2])
    steps, middle = np.diff(poses[:, :2], axis=0), (heading[1:] + heading[:-1]) / 2
    ahead = np.append(0.0, np.cumsum(steps[:, 0] * np.cos(middle) + steps[:, 1] * np.sin(middle)))
    seen = [np.diff(np.interp(edges, signals.stamps, part)) for part in (ahead, heading)]
    (way, cross), (other, turn) = ([_correlation(a, b) for b in counted] for a in seen)
    parts = [name for name, r in (("distance", way), ("turns", turn)) if r < -CERTAIN]
    if parts:
        found = " and ".join(parts)
        askew = ", or the reference poses look backwards" if parts == ["distance"] else ""
        swapped = " (left and right wheel exchanged)" if parts == ["turns"] else ""
        return f"the odometry counts its {found} backwards{swapped}{askew}"
    if max(abs(way), abs(turn)) < CERTAIN < min(abs(cross), abs(other)) and cross * other > 0:
        return f"the {'left' if cross > 0 else 'right'} wheel of the odometry counts backwards"
    return ""


def _correlation(a: Floats, b: Floats) -> float:
    """Return the correlation of two signals about zero; 0 if one of them does not move."""
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else 0.0


# selection -----------------------------------------------------------------------------------------------------------


def select(model: WheelModel) -> list[Term]:
    """Add hypotheses to the model while the evidence suffices, then remove superfluous ones.

    Structure that no effect explains competes with the effects, and replaces patches if it explains more.
    """
    settings = SCAN.selection
    terms = engine.select(WheelChannel(model), threshold=settings.threshold, most=settings.max_effects)
    add_structure(model, terms)
    for i in range(len(model.patches)):
        if model.patch_term(i) in terms:
            refine_patch(model, i, terms)
    engine.remove_superfluous(WheelChannel(model, terms), terms, threshold=settings.threshold)
    return terms


class WheelChannel(MotionChannel):
    """Wheel effects and slippery patches, as hypotheses about the odometry."""

    def __init__(self, model: WheelModel, terms: Sequence[Term] = ()) -> None:
        super().__init__(model, terms)
        self.wheels = model

    def best(self, model: Sequence[Term]) -> tuple[Term, float] | None:
        """Return the best further hypothesis, which may be a patch, and its evidence [nats]."""
        wheels, other = self.wheels, super().best(model)
        can_slip = len(wheels.patches) < SCAN.selection.max_effects
        found = wheels.last_patch = best_patch(wheels, model) if can_slip else None
        if found is None or found[1] < max(SCAN.selection.threshold, -np.inf if other is None else other[1]):
            return other
        wheels.patches.append(found[0])
        return wheels.patch_term(len(wheels.patches) - 1), found[1]

    def added(self, model: Sequence[Term]) -> None:
        """Refine a patch that has entered, and fit the noise."""
        wheels = self.wheels
        if model[-1].effect is WHEEL_SLIP:
            wheels.fit_noise()  # that of a model without the patch has absorbed a part of it
            found = best_patch(wheels, model[:-1])
            if found is not None:
                wheels.patches[-1] = found[0]
                wheels.whiten()
            refine_patch(wheels, len(wheels.patches) - 1, model)
        wheels.fit_noise()
        self.fit, self._fits = wheels.fit(model), {}


def add_structure(model: WheelModel, terms: list[Term]) -> None:
    """Let structure that no effect explains enter the model, in addition to the effects or instead of patches."""
    model.denoise_motion()
    families = odometry_families(model.rows, model.motion, model.robot.wheels)
    limits = noise_limits(model.robot, model.wheels, model.rows.stamps)
    own = np.delete(model.columns, model.n_own - 1, axis=1)
    late = clock_sigma(model.robot) * model.columns[:, model.n_own - 1, None]
    test = StructureTest(model.rows.valid, model.y, LimitedNoiseFitter(limits), late)
    rest, plain = model.fit(model.effects), own[:, : model.n_own - 1]
    left = rest.y - rest.explained(range(model.n_own))
    families += reference_jumps(model.rows, left)
    beside = [one for one in families if one.kind != "reference jumps" or not model.patches]
    family, gain = test.best(own, beside)  # a patch at the place of jumps absorbs a part of them
    replaces = False
    if model.patches:
        other, total = test.best(plain, families)
        replaces = test.lead(plain, other, own) + patch_price(model) * len(model.patches) > gain
        if replaces:
            own, family, gain = plain, other, total
    dispersion = test.dispersion(CLUSTER, limits[0].period)
    threshold = SCAN.selection.threshold * dispersion

    def size_of(missing: Floats, family: StructureFamily) -> SimulationError | ReferenceError:
        if family.is_of_reference:
            return reference_error(model.rows.D_yaw @ model.motion.turn, missing[: 2 * model.rows.n])
        return model.error_without(model.fit(terms), missing)

    found = admitted_structure(model, test, own, (family, gain), threshold, size_of)
    if replaces and gain >= threshold:
        model.patches = []
        terms[:] = [term for term in terms if term.effect is not WHEEL_SLIP]
    model.structure = found
    model.fit_noise()
    engine.remove_superfluous(MotionChannel(model, terms), terms, threshold=SCAN.selection.threshold)


# report --------------------------------------------------------------------------------------------------------------


def odometry_result(model: WheelModel, terms: Sequence[Term], signals: MotionSignals) -> ChannelResult:
    """Return the result of the odometry channel for the selected hypotheses."""
    fit = model.fit(terms)
    slips = any(term.effect is WHEEL_SLIP for term in terms)

    def patch_instead(rest: Sequence[Term], term: Term) -> dict[Effect, float]:
        """Return the evidence of a slippery patch that could replace an effect [nats]."""
        found = None if term.effect is WHEEL_SLIP else best_patch(model, rest)
        return {} if found is None else {WHEEL_SLIP: found[1]}

    return channel_result(
        model,
        terms,
        fit,
        instead=patch_instead,
        also_tried=[] if slips else tried_patch(model, terms),
        not_observable={},
        notes={
            **signals.notes,
            "clock_offset_s": model.rows.clock + float(fit.solution.theta[model.clock]),
            "rows": 2 * model.rows.n_valid,
        },
        motion=motion_difference(model, terms),
    )


def tried_patch(model: WheelModel, terms: Sequence[Term]) -> list[TriedEffect]:
    """Return the best slippery patch if one was found."""
    if model.last_patch is None:
        return []
    patch, evidence = model.last_patch
    _, lost = gains_of_discs(model, patch.disc[None], patch.track, terms)
    slip = WHEEL_SLIP(s=float(lost[0]), x=patch.x, y=patch.y, r=patch.r).at(xy=(patch.x, patch.y))
    return [TriedEffect(amendment=slip, evidence=evidence, price=patch_price(model))]


def motion_difference(model: WheelModel, terms: Sequence[Term]) -> MotionDifference | None:
    """Return the motion that patches and structure explain; None without these."""
    more = range(model.n_own, model.columns.shape[1])
    if not more:
        return None
    rows, dt = (
        by_kind(model.fit(terms).explained(list(more)), model.rows.n)[:2],
        np.gradient(model.rows.stamps),
    )
    return MotionDifference(
        stamps=model.rows.stamps,
        rates=np.stack([np.where(model.rows.valid, x, 0.0) / dt for x in rows], axis=1),
    )
