"""Entries in the ledger of the differences in the scans that have no name."""

from __future__ import annotations

from sensorgraph.diagnosis.engine.ledger import Entry
from sensorgraph.diagnosis.engine.verdict import Facts, Objection
from sensorgraph.diagnosis.report.quantities import minus
from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.goodness_of_fit import GoodnessOfFit
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed import titles
from sensorgraph.diagnosis.scan.unnamed.family import Doubt


def family_entries(fit: GoodnessOfFit, sigma: float) -> tuple[Entry, ...]:
    """Return the entry of each tested family at its most likely place.

    Parameters
    ----------
    sigma : [m] Standard deviation of a reading.
    """
    best: dict[str, Doubt] = {}
    for doubt in sorted(fit.tested, key=lambda d: (not d.is_sure, -d.misfit)):
        best.setdefault(doubt.family, doubt)
    names = [name for name in titles() if name in best or (fit.is_doubted and fit.family == name)]
    return tuple(_entry(name, best.get(name), fit, sigma) for name in names)


def _entry(name: str, doubt: Doubt | None, fit: GoodnessOfFit, sigma: float) -> Entry:
    is_told = fit.is_doubted and fit.family == name
    told = fit if is_told or doubt is None else doubt
    is_sure = doubt is None or doubt.is_sure
    size = ScanError() if told.size is None or told.misfit <= 0 else told.size
    price = 0.0 if doubt is None else doubt.price
    evidence, least = told.misfit - price, fit.least - price
    is_material = is_told or told.size is None or told.size.is_material(sigma)
    facts = Facts(
        has_name=False,
        accepted=is_told or (is_sure and told.misfit > fit.least),
        evidence=evidence,
        threshold=max(least, SCAN.selection.threshold) if price else least,
        is_significant=is_told or is_sure,
        is_material=is_material,
        objection=None if is_told or not is_material else _objection(fit),
    )
    return Entry(
        name=name,
        channel="scan",
        title=titles()[name],
        facts=facts,
        estimate=minus(told.statement),
        price=price or None,
        size=size.to_dict(),
        consequence=size.sentence() if size.to_dict() else "",
        remark="" if is_told or doubt is None or doubt.is_sure else _unlike(doubt, evidence),
    )


def _objection(fit: GoodnessOfFit) -> Objection:
    """Return why a significant difference is not reported."""
    if not fit.is_doubted:
        return Objection("site_baseline", "the known-good runs of the site show as much")
    cause = titles().get(fit.family, "a difference")
    return Objection("weaker_than_unknown", f"{cause}, which explains more, may cause it")


def _unlike(doubt: Doubt, evidence: float) -> str:
    """Return why a difference may be due to chance; empty if its evidence [nats] states it."""
    if not doubt.price:
        return f"its test statistic is {doubt.statistic:.3g}, and {doubt.threshold:.3g} is required"
    is_weak = evidence < SCAN.selection.threshold
    return "" if is_weak else "a part of the run, or a simulated run, shows as much"
