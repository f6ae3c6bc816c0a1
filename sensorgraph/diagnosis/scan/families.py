"""Families of differences in the scans that no effect of the library explains, and their entries in the ledger."""

from __future__ import annotations

from sensorgraph.diagnosis.engine.ledger import Entry
from sensorgraph.diagnosis.engine.verdict import Facts, Objection
from sensorgraph.diagnosis.report.quantities import minus
from sensorgraph.diagnosis.scan.consequence import ScanError
from sensorgraph.diagnosis.scan.effect_laws import Doubt
from sensorgraph.diagnosis.scan.goodness_of_fit import GoodnessOfFit
from sensorgraph.diagnosis.scan.settings import SCAN

FAMILIES = {
    "absorbed_readings": "short readings or outliers that behave otherwise than the effect that absorbs them",
    "rounded_readings": "readings rounded to steps that grow with the range",
    "implausible_combination": "several effects that point to one common cause",
    "object_at_wall": "an object that stands against a wall",
    "temporary_object": "an object that is present for a part of the run only",
    "missing_by_direction": "returns missing towards one side of the room",
    "reference_worse": "reference poses less accurate than specified",
    "map_worse": "a map less accurate than specified",
    "stamps_or_heading_worse": "stamps or headings less accurate than specified",
    "laser_scatter": "a laser that scatters more than specified",
    "scans_differ": "scans that differ from each other",
    "unexplained_bias": "readings too long or too short in a part of the data",
    "unexplained_spread": "readings with more noise in a part of the data",
    "unexplained_outliers": "more outliers in a part of the data",
    "unexplained_misses": "more missing returns in a part of the data",
    "change_in_time": "a parameter of the sensor that changes during the run",
    "bearing_error": "an error of the bearings that depends on the bearing",
    "bias_by_bearing": "a bias that depends on the bearing",
    "bias_by_range": "a bias that depends on the range",
    "late_scans": "scans of which some are late",
    "scans_elsewhere": "scans taken away from their reference pose",
    "scan_offsets": "scans with different range offsets",
}
"""Name -> noun phrase."""


def family_entries(fit: GoodnessOfFit, sigma: float) -> tuple[Entry, ...]:
    """Return the entry of each tested family at its most likely place.

    Parameters
    ----------
    sigma : [m] Standard deviation of a reading.
    """
    best: dict[str, Doubt] = {}
    for doubt in sorted(fit.tested, key=lambda d: (not d.is_sure, -d.misfit)):
        best.setdefault(doubt.family, doubt)
    names = [name for name in FAMILIES if name in best or (fit.is_doubted and fit.family == name)]
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
        title=FAMILIES[name],
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
    cause = FAMILIES.get(fit.family, "a difference")
    return Objection("weaker_than_unknown", f"{cause}, which explains more, may cause it")


def _unlike(doubt: Doubt, evidence: float) -> str:
    """Return why a difference may be due to chance; empty if its evidence [nats] states it."""
    if not doubt.price:
        return f"its test statistic is {doubt.statistic:.3g}, and {doubt.threshold:.3g} is required"
    is_weak = evidence < SCAN.selection.threshold
    return "" if is_weak else "a part of the run, or a simulated run, shows as much"
