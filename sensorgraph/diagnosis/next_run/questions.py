"""Questions for the next run: pairs of models, of which one is taken as true.

`RoomExposure` tells whether any drive in a room could show an effect, by the effect's own condition. A forecast compares two models ray by ray. An effect may need more, for example readings of the floor, before the
search of a diagnosis finds it. `Diagnostics.unobservable` is the condition that the report applies to a run; here it is
applied to spins at places in the whole room.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from planners.arena import Arena
from sensorgraph.diagnosis.engine.verdict import OBSERVABLE_SIZE
from sensorgraph.diagnosis.next_run.design import MAX_DESCRIBED, motion_samples
from sensorgraph.diagnosis.next_run.drives import DrivableSpace, MotionKind, candidate_motions
from sensorgraph.diagnosis.next_run.forecast import DECIDED_NATS, OpenQuestion, planned_scans
from sensorgraph.diagnosis.result import ChannelResult
from sensorgraph.diagnosis.scan.fit import bare_fit, cast
from sensorgraph.diagnosis.scan.observability import RunExposure, separation
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.world.robot import Robot

LONGER_THAN_ANY_WALL = 1e3
"""[m]"""


def open_questions(
    result: ChannelResult,
    model: Sequence[Amendment],
    rivals: Sequence[Amendment],
    can_show: Callable[[Amendment], bool] = lambda a: True,
) -> list[OpenQuestion]:
    """Return the open questions of the scan channel, most important first.

    The first of these that applies:

    1. Does a rival within `decided_nats` explain the scans instead?
    2. Is an effect present that this run could not have shown anywhere?
    3. What is the size of the least certain effect?
    4. Is an effect present that this run could not have shown at some places?
    5. Is one of the usual effects (`question_rank`) present?

    Parameters
    ----------
    model : The accepted effects.
    rivals : Second-best explanation of each effect, in the order of `result.rivals`.
    can_show : Whether a run in the room could show an effect; there are no questions about others.
    """
    accepted = tuple(model)
    close = _undecided(result, accepted, rivals)
    if close:
        return close[:1]
    hidden = [(name, why, typical_effect(name, why)) for name, why in result.not_observable.items()]
    everywhere = [
        _is_there(one, accepted, why)
        for _, why, one in hidden
        if one is not None and not one.place and can_show(one)
    ]
    if everywhere:
        return everywhere[:MAX_DESCRIBED]
    if accepted:
        worst = max(accepted, key=_relative_stderr)
        rest = tuple(a for a in accepted if a is not worst)
        text, hint = (
            f"what is the size of the {_called(worst)}",
            f"its residual varies with {worst.effect.varies}",
        )
        return [OpenQuestion(truth=accepted, alternative=rest, text=text, hint=hint)]
    somewhere = [_is_there(one, accepted, why) for _, why, one in hidden if one is not None]
    if somewhere:
        return somewhere[:MAX_DESCRIBED]
    ranked = [
        (e.diagnostics.question_rank, name) for name, e in EFFECTS.items() if e.diagnostics.question_rank
    ]
    usual = (typical_effect(name) for _, name in sorted(ranked))
    return [_is_there(one, (), "") for one in usual if one is not None and can_show(one)]


def _undecided(
    result: ChannelResult, accepted: tuple[Amendment, ...], rivals: Sequence[Amendment]
) -> list[OpenQuestion]:
    """Return the questions about rivals that the run does not exclude, closest first."""
    evidence = {a.name: a.evidence or 0.0 for a in result.effects}
    found = []
    for named, rival in zip(result.rivals, rivals, strict=True):
        own = next((a for a in accepted if a.name == named.instead_of), None)
        margin = evidence.get(named.instead_of, 0.0) - named.evidence_nats
        if own is not None and margin < DECIDED_NATS:
            rest = tuple(a for a in accepted if a is not own)
            found.append((margin, between((*rest, own), (*rest, rival))))
    return [question for _, question in sorted(found, key=lambda pair: pair[0])]


def _is_there(unseen: Amendment, accepted: tuple[Amendment, ...], why: str) -> OpenQuestion:
    """Return the question whether a further effect of observable size is present."""
    hint = f"in this run: {why}" if why else f"its residual varies with {unseen.effect.varies}"
    text = f"is there any {_called(unseen)}"
    return OpenQuestion(truth=(*accepted, unseen), alternative=accepted, text=text, hint=hint)


def between(truth: Sequence[Amendment], alternative: Sequence[Amendment]) -> OpenQuestion:
    """Return the question which of two models holds; they differ in their last effect."""
    one, other = truth[-1], alternative[-1]
    return OpenQuestion(
        truth=tuple(truth),
        alternative=tuple(alternative),
        text=f"{_called(one)} or {_called(other)}",
        hint=separation(one, other),
    )


def typical_effect(name: str, why: str = "") -> Amendment | None:
    """Return an effect of observable size; None if it has no such size or its place is unknown.

    Parameters
    ----------
    why : Reason from `not_observable`. The effect is placed at the first place in it.
    """
    effect = EFFECTS[name]
    values = effect.typical(OBSERVABLE_SIZE)
    place = why.split(":")[0].split(",")[0] if ":" in why else ""
    if effect.place in ("wall", "obstacle") and place:
        whole_wall = {"a": 0.0, "b": LONGER_THAN_ANY_WALL} if effect.on_part_of_wall else {}
        return effect(**whole_wall, **values).at(place)
    if effect.place is not None or not values or not effect.diagnostics.is_forecast:
        return None
    return effect(**values)


def _relative_stderr(a: Amendment) -> float:
    """Return the largest standard error of the sizes of an effect, divided by their materiality."""
    sizes = a.effect.sizes
    return max((a.stderr.get(k, 0.0) / m for k, m in sizes.items()), default=0.0)


def _called(a: Amendment) -> str:
    """Return title and place of an effect."""
    return f"{a.effect.title} at {a.place}" if a.place else a.effect.title


class RoomExposure:
    """Surfaces, ranges and angles that a drive anywhere in a room would meet; computed at the first question."""

    def __init__(self, arena: Arena, robot: Robot, *, seed: int = 0, minutes: float = 2.0) -> None:
        self.arena, self.robot, self.seed, self.duration = arena, robot, seed, 60.0 * minutes

    @cached_property
    def _spins(self) -> tuple[RunExposure, float]:
        """Exposure of spins at all places, and its share of the readings of a run that stays at one place."""
        space = DrivableSpace.of(self.arena, self.robot)
        motions = candidate_motions(space, np.random.default_rng(self.seed))
        spins = [motion for motion in motions if motion.kind is MotionKind.SPIN]
        samples = [motion_samples(motion, self.robot, self.duration) for motion in spins]
        scans = planned_scans(samples, self.arena, self.robot, self.duration)
        expected = cast(scans, ()).expected
        scans.ranges[:] = np.where(expected.p_return > 0.5, expected.reading, np.inf)
        fitted = bare_fit(scans, SCAN.noise)
        sensor = self.robot.sensor
        share = scans.ranges.size / len(spins) / (self.duration * sensor.rate * sensor.n_rays)
        return RunExposure(scans, fitted), share

    def can_show(self, a: Amendment) -> bool:
        """Tell whether a run could show an effect that acts everywhere; True for effects without a condition."""
        condition = a.effect.diagnostics.unobservable
        if condition is None or a.place:
            return True
        exposure, share = self._spins
        return not condition(exposure, a.parameters, exposure.need_of(a.effect) * min(share, 1.0))
