"""Remove names of motion effects that are known, or explained by what another channel shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.engine.verdict import Objection
from sensorgraph.diagnosis.result import ChannelResult, Unknown, without_close_calls
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.effects.actuator_lag import ACTUATOR_LAG
from sensorgraph.effects.dead_time import DEAD_TIME
from sensorgraph.effects.effect import size_ratio
from sensorgraph.effects.pose_clock_offset import POSE_CLOCK_OFFSET


def name_motion_effects(result: ChannelResult, known: Sequence[Amendment]) -> ChannelResult:
    """Remove effects of a motion channel that are in the model already."""
    expected = {a.name: a.parameters for a in known if a.effect not in (ACTUATOR_LAG, DEAD_TIME)}
    as_known = {a.name for a in result.effects if _is_expected(a, expected)}
    given = Objection("given", "it is already in the model, as given")
    why = {i: given for i, a in enumerate(result.effects) if a.name in as_known}
    rivals = tuple(rival for rival in result.rivals if rival.instead_of not in as_known)
    return without_close_calls(replace(result.without(why), rivals=rivals))


def beside_doubted_wheels(drive: ChannelResult, odometry: ChannelResult) -> ChannelResult:
    """Remove motor effects with less evidence than an unexplained error of the wheels, which may imitate them: clock drift, misreading."""
    unknown = odometry.unknown
    if unknown is None or "reference_m" in unknown.size:
        return drive
    words = "the odometry has an unexplained error with more evidence, which may cause it"
    weak = [i for i, a in enumerate(drive.effects) if (a.evidence or 0.0) < unknown.statistic]
    why = dict.fromkeys(weak, Objection("part_of_unknown", words))
    unseen = dict.fromkeys((drive.effects[i].name for i in weak), words)
    return replace(drive.without(why), not_observable={**drive.not_observable, **unseen})


def as_one_doubt(odometry: ChannelResult, drive: ChannelResult) -> tuple[ChannelResult, ChannelResult]:
    """Replace an odometry clock offset and a dead time that cancel by one unknown cause.

    If they cancel, the wheels follow the commands as robot.yaml specifies. One cause then shifts commands and
    odometry relative to the poses.
    """
    clocks = [a for a in odometry.effects if a.effect is POSE_CLOCK_OFFSET]
    delays = [a for a in drive.effects if a.effect is DEAD_TIME]
    if not (clocks and delays) or odometry.unknown is not None:
        return odometry, drive
    (clock,), (delay,) = clocks, delays
    error = float(np.hypot(clock.stderr["tau"], delay.stderr["L"]))
    if abs(clock["tau"] + delay["L"]) > 2 * error:
        return odometry, drive
    words = f"poses come {1000 * abs(clock['tau']):.0f} ms {'after' if clock['tau'] < 0 else 'before'} commands and odometry"
    unknown = Unknown(
        statement=f"the wheels follow the commands as robot.yaml specifies, but the {words}, which no single effect of the library explains",
        statistic=clock.evidence or 0.0,
        threshold=SCAN.selection.threshold,
        consequence=words,
        families=(
            "the clock of the base, which stamps commands and odometry",
            "wheels that slip while the speed changes",
            "a filter on the poses",
        ),
    )
    words = "a clock offset and a dead time cancel, so that one unknown cause explains both"
    why = Objection("absorbed_by_unknown", words)
    return (
        replace(odometry.without({odometry.effects.index(clock): why}), unknown=unknown),
        drive.without({drive.effects.index(delay): why}),
    )


def _is_expected(amendment: Amendment, known: Mapping[str, Mapping[str, float]]) -> bool:
    """Tell whether an effect is already known, with a size that differs by less than its materiality."""
    if amendment.name not in known:
        return False
    values = known[amendment.name]
    off = {k: amendment[k] - values.get(k, 0.0) for k in amendment.effect.sizes}
    return size_ratio(amendment.effect, off) < 1.0
