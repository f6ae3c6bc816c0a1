"""Effects as entries of the ledger."""

from __future__ import annotations

import math
from dataclasses import replace

from sensorgraph.diagnosis.engine.ledger import Competitor, Entry
from sensorgraph.diagnosis.engine.verdict import Facts
from sensorgraph.diagnosis.motion.consequence import SimulationError
from sensorgraph.diagnosis.report.quantities import quantity, symbol, title_of
from sensorgraph.diagnosis.result import Rival
from sensorgraph.effects import Amendment, Effect


def effect_entry(a: Amendment, facts: Facts, *, price: float | None = None) -> Entry:
    """Return the entry of an effect with fitted or expected parameters.

    Parameters
    ----------
    price : [nats] Complexity penalty.
    """
    place, xy = ("", None) if a.location is None else (a.location.name, a.location.xy)
    return Entry(
        name=a.name,
        channel=a.effect.channel,
        title=a.effect.title,
        facts=facts,
        place=place,
        xy=None if xy is None else (float(xy[0]), float(xy[1])),
        parameters={k: float(v) for k, v in a.parameters.items()},
        stderr={k: float(v) for k, v in a.stderr.items() if math.isfinite(v)},
        estimate=", ".join(f"{symbol(name)} = {quantity(a, name)}" for name in a.parameters),
        price=price,
        needs=needs_of(a.effect),
    )


def accepted_entry(a: Amendment, threshold: float, price: float, size: SimulationError) -> Entry:
    """Return the entry of an effect of a motion channel that is in the model.

    Parameters
    ----------
    threshold, price : [nats] Evidence that it needs, and its complexity penalty.
    size : Error of a simulation without it.
    """
    facts = Facts(has_name=True, accepted=True, evidence=a.evidence, threshold=threshold)
    return replace(
        effect_entry(a, facts, price=price),
        size=size.to_dict(),
        consequence=size.sentence(),
        remark=f"its size is not surely material (at least {least_size(a.effect)})",
    )


def least_size(effect: Effect) -> str:
    """Return the materiality of an effect in words; empty if it has no size."""
    limits = effect(**effect.sizes)
    return ", ".join(quantity(limits, name).lstrip("+") for name in limits.parameters)


def needs_of(effect: Effect) -> str:
    """Return what a run must show to decide about an effect."""
    return f"residuals that vary with {effect.varies}"


def competitor(rival: Rival) -> Competitor:
    """Return the rival of an effect as a competitor in the ledger."""
    return Competitor(
        title=title_of(rival.name), evidence=float(rival.evidence_nats), separates=rival.separates
    )
