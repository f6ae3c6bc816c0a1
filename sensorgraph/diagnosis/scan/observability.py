"""Report effects that a run could not have shown, and what would distinguish two effects.

    evidence(x) = min over n of  [ (x - n)' M (x - n) + |n / tau|² ] / 2

Here x is an effect of the scan channel, written as a shift of the nuisance parameters. M is the normal matrix
of the fit with the pose errors eliminated, and n are the nuisance parameters with their tolerances tau. The
evidence is the log Bayes factor that this run would contribute if the effect were present. For effects without
derivatives, the rays that would be lost or change their reading are counted instead.
"""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.engine.verdict import OBSERVABLE_SIZE
from sensorgraph.diagnosis.scan.exposure import RunExposure
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.effects import EFFECTS, Amendment, Effect
from sensorgraph.effects.exposures import falls_short, listed
from sensorgraph.types import Floats


def not_observable(data: ScanData, fitted: Fitted) -> dict[str, str]:
    """Return the effects that this run could not have shown, each with the reason."""
    exposure = RunExposure(data, fitted)
    out = _hidden_by_poses(data)
    present = set(fitted.names())
    for found in (_told_by_effects(exposure), _smooth(exposure)):
        for name, why in found.items():
            if name not in present and name not in out:
                out[name] = why
    return {name: out[name] for name in EFFECTS if name in out}


def _hidden_by_poses(data: ScanData) -> dict[str, str]:
    out: dict[str, str] = {}
    if data.laser_frame:
        why = "the poses are those of the laser, so they do not depend on the mount"
        out |= {name: why for name, effect in EFFECTS.items() if effect.stage == "mount"}
    if data.from_scans:
        why = "the poses were located with these scans and absorb it; it can be estimated from driving alone, with a minute of driving and turning"
        out |= {
            name: why for name, effect in EFFECTS.items() if not data.may_show(effect) and name not in out
        }
    elif data.laser_frame:
        why = "the poses were fitted to these scans and absorb it"
        out |= {
            name: why
            for name, effect in EFFECTS.items()
            if effect.diagnostics.hidden_by_slam and name not in out
        }
    return out


def _told_by_effects(exposure: RunExposure) -> dict[str, str]:
    """Query the effects that define their own condition of observability."""
    out = {}
    for name, effect in EFFECTS.items():
        if effect.diagnostics.unobservable is None:
            continue
        typical = effect.typical(OBSERVABLE_SIZE)
        why = effect.diagnostics.unobservable(exposure, typical, exposure.need_of(effect))
        if why:
            out[name] = why
    return out


def _sizes(effect: Effect) -> Floats:
    """Return shifts (m, k) of OBSERVABLE_SIZE materialities; four directions for a shift in the plane."""
    sizes = np.array([OBSERVABLE_SIZE * effect.sizes.get(name, 0.0) for name in effect.steps])
    if len(effect.sizes) == 2:
        angle = np.arange(4) * np.pi / 4
        return np.asarray(np.stack([np.cos(angle), np.sin(angle)], axis=1) * sizes)
    return np.asarray(sizes[None])


def _smooth(exposure: RunExposure) -> dict[str, str]:
    """Test effects in the span of the nuisance parameters, and effects with separate columns."""
    out: dict[str, str] = {}
    blind: dict[str, list[str]] = {}
    partly: dict[str, list[str]] = {}
    for hypothesis in exposure.hypotheses:
        amendment, effect = hypothesis.amendment, hypothesis.amendment.effect
        need = exposure.need(amendment)
        nats = [exposure.nats(hypothesis.directions @ size) for size in _sizes(effect)]
        if min(nats) >= need:
            continue
        if amendment.place:
            group = blind if max(nats) < need else partly
            group.setdefault(effect.name, []).append(amendment.place)
            continue
        reason = _lacks(effect, exposure)
        if max(nats) >= need:
            angle = int(45 * int(np.argmin(nats)))
            reason = f"not along {angle}° (0° is forward): {reason}"
        out[effect.name] = (
            f"{reason}; at {OBSERVABLE_SIZE:g} times its materiality, {falls_short(min(nats), need)}"
        )
    for effect in EFFECTS.values():
        if effect.has_own_columns and effect.sizes and effect.name not in exposure.fitted.names():
            nats_alone, need = exposure.nats_alone(effect), exposure.need_of(effect)
            if nats_alone < need:
                out[effect.name] = (
                    f"{_lacks(effect, exposure)}; at {OBSERVABLE_SIZE:g} times its materiality, {falls_short(nats_alone, need)}"
                )
    for name, places in blind.items():
        out[name] = f"{listed(places)}: observed too rarely for {OBSERVABLE_SIZE:g} times its materiality"
    for name, places in partly.items():
        said = f"{listed(places)}: a shift across the line of sight would not show"
        out[name] = f"{out[name]}; {said}" if name in out else said
    return out


def _lacks(effect: Effect, exposure: RunExposure) -> str:
    """Return what the run lacks to show a smooth effect."""
    why = effect.diagnostics.why_unseen
    if callable(why):
        return why(exposure)
    return why or f"it varies with {effect.varies}"


def separation(a: Amendment, b: Amendment) -> str:
    """Return the observation that would distinguish two effects."""
    hint = a.effect.rivals.get(b.name) or b.effect.rivals.get(a.name)
    return (
        hint
        or f"{a.effect.title} varies with {a.effect.varies}; {b.effect.title} varies with {b.effect.varies}"
    )
