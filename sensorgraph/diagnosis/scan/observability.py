"""Report effects that a run could not have shown, and pairs of effects that it cannot distinguish.

    evidence(x) = min over n of  [ (x - n)' M (x - n) + |n / tau|² ] / 2

Here x is an effect of the scan channel, written as a shift of the nuisance parameters. M is the normal matrix
of the fit with the pose errors eliminated, and n are the nuisance parameters with their tolerances tau. The
evidence is the log Bayes factor that this run would contribute if the effect were present. For effects without
derivatives, the rays that would be lost or change their reading are counted instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.scan.exposure import RunExposure
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import EFFECTS, Amendment, Effect
from sensorgraph.effects.exposures import falls_short, listed
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.types import Floats

SIZE = SCAN.observability.size
MAX_CORRELATION = SCAN.observability.max_correlation


@dataclass(frozen=True, kw_only=True)
class Alike:
    """Two effects that this run cannot distinguish."""

    a: str
    b: str
    correlation: float
    """Correlation of their columns, with the nuisance parameters projected out."""
    nats: float
    """[nats] Expected evidence between them if the first is present at three times its materiality."""
    why: str
    """One sentence, with the observation that would distinguish them."""


def not_observable(
    data: ScanData,
    fitted: Fitted,
    *,
    threshold: float = SCAN.selection.threshold,
) -> dict[str, str]:
    """Return the effects that this run could not have shown, each with the reason.

    Parameters
    ----------
    threshold : [nats] Evidence that a name requires, after the complexity penalty.
    """
    exposure = RunExposure(data, fitted, threshold)
    out = _hidden_by_poses(data)
    present = set(fitted.names())
    for found in (_told_by_effects(exposure), _smooth(exposure)):
        for name, why in found.items():
            if name not in present and name not in out:
                out[name] = why
    return {name: out[name] for name in EFFECTS if name in out}


def alike(data: ScanData, fitted: Fitted, *, threshold: float = SCAN.selection.threshold) -> list[Alike]:
    """Return the pairs of effects that this run would show but cannot distinguish."""
    exposure = RunExposure(data, fitted, threshold)
    return [*_alike_smooth(exposure), *_look_alikes(exposure)]


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
        typical = effect.typical(SIZE)
        why = effect.diagnostics.unobservable(exposure, typical, exposure.need_of(effect))
        if why:
            out[name] = why
    return out


def _sizes(effect: Effect) -> Floats:
    """Return shifts (m, k) of SIZE materialities; four directions for a shift in the plane."""
    sizes = np.array([SIZE * effect.sizes.get(name, 0.0) for name in effect.steps])
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
        out[effect.name] = f"{reason}; at {SIZE:g} times its materiality, {falls_short(min(nats), need)}"
    for effect in EFFECTS.values():
        if effect.has_own_columns and effect.sizes and effect.name not in exposure.fitted.names():
            nats_alone, need = exposure.nats_alone(effect, SIZE), exposure.need_of(effect)
            if nats_alone < need:
                out[effect.name] = (
                    f"{_lacks(effect, exposure)}; at {SIZE:g} times its materiality, {falls_short(nats_alone, need)}"
                )
    for name, places in blind.items():
        out[name] = f"{listed(places)}: observed too rarely for {SIZE:g} times its materiality"
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


def _alike_smooth(exposure: RunExposure) -> list[Alike]:
    """Compare the columns of smooth effects, with the nuisance parameters projected out."""
    rows = []
    for hypothesis in exposure.hypotheses:
        amendment, directions, own = hypothesis.amendment, hypothesis.directions, hypothesis.nuisances
        shifts = [directions @ size for size in _sizes(amendment.effect)]
        nats = [exposure.nats(shift) for shift in shifts]
        best = int(np.argmax(nats))
        rows.append((amendment, directions, own, shifts[best], nats[best] >= exposure.need(amendment)))
    out = []
    for i, (a, da, own_a, xa, shown_a) in enumerate(rows):
        for b, db, own_b, xb, shown_b in rows[i + 1 :]:
            if (a.place and (b.place or not shown_a)) or (b.place and not shown_b):
                continue
            own = (*own_a, *own_b)
            one = _compare(exposure, xa, db, own, shown_a)
            other = _compare(exposure, xb, da, own, shown_b)
            found = [f for f in (one, other) if f is not None]
            if found:
                out.append(_said_alike(a, b, max(f[0] for f in found), min(f[1] for f in found)))
    return sorted(out, key=lambda pair: pair.nats)


def _compare(
    exposure: RunExposure, shift: Floats, others: Floats, own: Sequence[Nuisance], shown: bool
) -> tuple[float, float] | None:
    """Return correlation and expected evidence [nats] between two effects; None if the run distinguishes them."""
    correlation, strength = _correlation(exposure, shift, others, own)
    if strength < 1.0 or (correlation < MAX_CORRELATION and not shown):
        return None
    if correlation < MAX_CORRELATION and strength * (1 - correlation**2) > exposure.threshold:
        return None  # bounds on the nuisances can only increase the evidence
    nats = exposure.nats(shift, others, own)
    return (correlation, nats) if correlation >= MAX_CORRELATION or nats < exposure.threshold else None


def _correlation(
    exposure: RunExposure, x: Floats, others: Floats, own: Sequence[Nuisance]
) -> tuple[float, float]:
    """Return the correlation of a column x with the span of other columns o, and the evidence [nats] for x.

        correlation² = f_xo f_oo⁻¹ f_ox / f_xx,   evidence = f_xx / 2

    The matrix f is the information with the nuisance parameters projected out.
    """
    columns = np.column_stack([x, others])
    f = columns.T @ exposure.projected(own) @ columns
    explained = f[0, 1:] @ np.linalg.lstsq(f[1:, 1:], f[1:, 0], rcond=1e-9)[0]
    share = float(np.clip(explained / max(f[0, 0], 1e-300), 0.0, 1.0))
    return float(np.sqrt(share)), float(0.5 * f[0, 0])


def _said_alike(a: Amendment, b: Amendment, correlation: float, nats: float) -> Alike:
    name_a, name_b = (f"{e.effect.title} at {e.place}" if e.place else e.effect.title for e in (a, b))
    why = f"this run hardly distinguishes {name_a} from {name_b} (log Bayes factor {nats:.0f})"
    raw_a, raw_b = (f"{e.name} of {e.place}" if e.place else e.name for e in (a, b))
    return Alike(a=raw_a, b=raw_b, correlation=correlation, nats=nats, why=f"{why}; {separation(a, b)}")


def separation(a: Amendment, b: Amendment) -> str:
    """Return the observation that would distinguish two effects."""
    hint = a.effect.rivals.get(b.name) or b.effect.rivals.get(a.name)
    return (
        hint
        or f"{a.effect.title} varies with {a.effect.varies}; {b.effect.title} varies with {b.effect.varies}"
    )


def _look_alikes(exposure: RunExposure) -> list[Alike]:
    """Query each effect for another effect that this run cannot distinguish from it."""
    out = []
    for effect in EFFECTS.values():
        found = effect.diagnostics.look_alike(exposure) if effect.diagnostics.look_alike is not None else None
        if found is None:
            continue
        other, reason = EFFECTS[found[0]], found[1]
        words = f"this run cannot distinguish {effect.title} from {other.title}: {reason}; {effect.rivals[other.name]}"
        out.append(Alike(a=effect.name, b=other.name, correlation=1.0, nats=0.0, why=words))
    return out
