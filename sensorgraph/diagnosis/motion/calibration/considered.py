"""Ledger of a calibration from driving alone: which effects it tested, which it cannot show, and what decided."""

from __future__ import annotations

from dataclasses import replace

from sensorgraph.diagnosis.engine.ledger import Entry, Ledger
from sensorgraph.diagnosis.engine.verdict import Facts
from sensorgraph.diagnosis.hypotheses import effect_entry, least_size, needs_of
from sensorgraph.diagnosis.motion.calibration.comparison import Change, is_long_enough
from sensorgraph.diagnosis.motion.calibration.estimate import DrivingCalibration
from sensorgraph.diagnosis.motion.calibration.verdict import SURE, calibrated_effects, is_material
from sensorgraph.diagnosis.motion.calibration.words import EFFECT_OF, QUANTITIES
from sensorgraph.diagnosis.motion.families import ODOMETRY_FAMILIES
from sensorgraph.effects import EFFECTS
from sensorgraph.effects.latency import LATENCY
from sensorgraph.effects.wheel_radius_diff import WHEEL_RADIUS_DIFF

THRESHOLD = 0.5 * SURE**2
"""[nats] Evidence of an estimate that is `SURE` standard errors off."""
CHANGE = ODOMETRY_FAMILIES["jump"]
"""Name in the ledger, and noun phrase, of a change at a moment."""
NEEDS_ARENA = "only wheels and mount are estimated without an arena, since poses from the run's own scans absorb the rest"


def driving_ledger(found: DrivingCalibration, change: Change | None, base: float | None) -> Ledger:
    """Return the ledger of one run.

    Parameters
    ----------
    change : Change during the run, if there is one.
    base : [m] Wheelbase that the odometry uses; None: unknown, so that unequal wheels have no size.
    """
    hidden = {EFFECT_OF[name]: why for name, why in reversed(found.hidden.items())}
    if base is None:
        hidden.setdefault(WHEEL_RADIUS_DIFF.name, "it needs the wheelbase; give --robot with wheels.base")
    if LATENCY.name not in hidden:
        delay, error = found.of("delay")
        hidden[LATENCY.name] = (
            f"the scan delay of {QUANTITIES['delay'].text(delay, error)} is relative to the odometry; "
            "only reference poses can show which of the two is late"
        )
    entries = []
    for a in calibrated_effects(found, base):
        why = hidden.get(a.name, "")
        evidence = None if why else a.evidence
        facts = Facts(
            has_name=True, accepted=evidence is not None and evidence > THRESHOLD, evidence=evidence, threshold=THRESHOLD,
            is_material=is_material(a), not_observable=why,
        )  # fmt: skip
        entry = effect_entry(a, facts)
        entries.append(replace(entry, remark=f"it is smaller than what matters ({least_size(a.effect)})"))
    known = {entry.name for entry in entries}
    for name, effect in EFFECTS.items():
        if name not in known:
            facts = Facts(has_name=True, not_observable=hidden.get(name, NEEDS_ARENA))
            entries.append(
                Entry(
                    name=name, channel=effect.channel, title=effect.title, facts=facts, needs=needs_of(effect)
                )
            )
    return Ledger(entries=(*entries, _change(found, change)))


def _change(found: DrivingCalibration, change: Change | None) -> Entry:
    """Return the entry of a change of wheels or mount during the run."""
    name, title = CHANGE
    if change is None:
        why = "" if is_long_enough(found) else "the drive is too short to show a change during it"
        weak = Facts(has_name=False, evidence=None if why else 0.0, threshold=THRESHOLD, not_tried=why)
        return Entry(name=name, channel="odometry", title=title, facts=weak)
    one, q = change.difference, QUANTITIES[change.difference.name]
    facts = Facts(
        has_name=False, accepted=True, evidence=0.5 * (one.value / one.stderr) ** 2, threshold=THRESHOLD
    )
    estimate = f"{q.title} by {q.text(one.value, one.stderr)} at about {change.at_s:.0f} s"
    return Entry(
        name=name, channel="odometry", title=title, facts=facts, estimate=estimate,
        needs=f"which of these is the cause: {q.causes}",
    )  # fmt: skip
