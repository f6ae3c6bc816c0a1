"""Ledger of a diagnosis: every hypothesis that was considered, with its numbers and the verdict on it.

This package knows no robot: hypotheses come with the words and numbers that a reader needs. `why` explains an entry. `kept_ledger` reads
a kept report.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from sensorgraph.diagnosis.engine.verdict import DecidedBy, Facts, Objection, Verdict, judge
from sensorgraph.errors import SensorgraphError


@dataclass(frozen=True, kw_only=True)
class Competitor:
    """The hypothesis that explains the same data best, in place of an entry."""

    title: str
    evidence: float
    """[nats]"""
    separates: str = ""
    """Observation that would distinguish the two."""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A hypothesis that was considered: an effect of the library at its best place, or a nameless family."""

    name: str
    """Of the effect or the family, as in `--why NAME`."""
    channel: str
    title: str
    """Noun phrase for readers, without an article."""
    facts: Facts
    place: str = ""
    """Name of its best place; empty without one."""
    xy: tuple[float, float] | None = None
    """[m, map]"""
    parameters: Mapping[str, float] = field(default_factory=dict)
    """Most likely values, in SI units."""
    stderr: Mapping[str, float] = field(default_factory=dict)
    estimate: str = ""
    """The same in words and in the units of readers; empty if nothing was estimated."""
    price: float | None = None
    """[nats] Complexity penalty, which the evidence does not contain."""
    alone: float | None = None
    """[nats] Evidence before any effect was accepted; None if it was not fitted then."""
    materiality: str = ""
    """Smallest size that matters to a user, in words; empty if it has none."""
    at_materiality: float | None = None
    """[nats] Evidence that it would have in this run at this size; None if unknown."""
    is_ruled_out: bool = False
    """Whether its size is surely smaller than this."""
    size: Mapping[str, float] = field(default_factory=dict)
    """Error of a simulation without it; each key contains its unit."""
    consequence: str = ""
    """The same in words."""
    rival: Competitor | None = None
    needs: str = ""
    """What the next run would have to show."""
    remark: str = ""
    """Cause of the verdict in the words of the channel, if the numbers do not state it."""

    @property
    def where(self) -> str:
        """Its best place in words; empty without one."""
        if self.xy is None:
            return self.place
        spot = f"({self.xy[0]:.1f}, {self.xy[1]:.1f}) m".replace("-", "−")
        return f"{self.place} about {spot}" if self.place else f"about {spot}"

    @property
    def verdict(self) -> Verdict:
        """Verdict on the hypothesis."""
        return judge(self.facts)[0]

    @property
    def decided_by(self) -> DecidedBy:
        """Fact that decided the verdict."""
        return judge(self.facts)[1]

    @property
    def reason(self) -> str:
        """Reason for the verdict, as a clause."""
        facts, rival = self.facts, self.rival
        needs = f"it needs {nats(facts.threshold)}"
        match self.decided_by:
            case DecidedBy.EVIDENCE if facts.evidence is not None or not self.remark:
                return f"its evidence is {nats(facts.evidence)}" + (
                    f", and {needs}" if facts.threshold > 0 else ""
                )
            case DecidedBy.CLOSE_RIVAL if rival is not None:
                lead, required = nats(facts.lead), nats(facts.required_lead)
                return f"{rival.title} explains the data almost as well: {lead} apart, {required} required"
            case DecidedBy.BEATEN if rival is not None:
                return f"{rival.title} explains the same data better ({nats(rival.evidence)})"
            case DecidedBy.NOT_OBSERVABLE:
                return f"not observable in this run: {facts.not_observable}"
            case DecidedBy.NOT_TRIED:
                return f"not tried: {facts.not_tried or 'no start was found'}"
            case DecidedBy.WEAK if facts.is_significant or not self.remark:
                return f"its evidence is {nats(facts.evidence)}, but {needs}"
            case DecidedBy.OBJECTION if facts.objection is not None:
                return facts.objection.words
            case DecidedBy.IMMATERIAL:
                return self.remark or "too small to matter"
            case DecidedBy.WEAK:
                return self.remark
        return self.remark or "another hypothesis explains the same data"

    def to_dict(self) -> dict[str, Any]:
        """Return the entry as plain data, for report.json."""
        facts = asdict(self.facts)
        objection = self.facts.objection
        facts |= {
            "objection": "" if objection is None else objection.words,
            "rule": "" if objection is None else objection.rule,
        }
        location = {"name": self.place, "xy": None if self.xy is None else list(self.xy)}
        return {
            "name": self.name,
            "channel": self.channel,
            "named_effect": facts.pop("has_name"),
            "title": self.title,
            "location": location if self.place or self.xy is not None else None,
            "parameters": dict(self.parameters),
            "stderr": dict(self.stderr),
            "estimate": self.estimate,
            "evidence_nats": facts.pop("evidence"),
            "price_nats": self.price,
            "alone_nats": self.alone,
            "materiality": self.materiality,
            "at_materiality_nats": self.at_materiality,
            "ruled_out": self.is_ruled_out,
            "size": dict(self.size),
            "consequence": self.consequence,
            "rival": None if self.rival is None else asdict(self.rival),
            "verdict": self.verdict.value,
            "decided_by": self.decided_by.value,
            "reason": self.reason,
            "needs": self.needs,
            "remark": self.remark,
            "facts": facts,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Entry:
        """Return the entry of plain data; the verdict follows from its facts."""
        location, rival, facts = data["location"] or {}, data["rival"], dict(data["facts"])
        words, rule = facts.pop("objection"), facts.pop("rule")
        facts["objection"] = Objection(rule, words) if words else None
        xy = location.get("xy")
        return cls(
            **{key: data[key] for key in ("name", "channel", "title", "parameters", "stderr", "estimate")},
            **{key: data[key] for key in ("size", "consequence", "needs", "remark")},
            facts=Facts(has_name=data["named_effect"], evidence=data["evidence_nats"], **facts),
            place=location.get("name", ""),
            xy=None if xy is None else (xy[0], xy[1]),
            price=data["price_nats"],
            alone=data["alone_nats"],
            materiality=data["materiality"],
            at_materiality=data["at_materiality_nats"],
            is_ruled_out=data["ruled_out"],
            rival=None if rival is None else Competitor(**rival),
        )


@dataclass(frozen=True, kw_only=True)
class Ledger(Sequence[Entry]):
    """All hypotheses of a diagnosis."""

    entries: tuple[Entry, ...]

    def __len__(self) -> int:
        return len(self.entries)

    def __iter__(self) -> Iterator[Entry]:
        return iter(self.entries)

    def __getitem__(self, index: Any) -> Any:
        return self.entries[index]

    def of(self, name: str) -> tuple[Entry, ...]:
        """Return the entries of an effect or a family; spaces and hyphens count as underscores."""
        return tuple(entry for entry in self.entries if entry.name == as_name(name))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all hypotheses, each once."""
        return tuple(dict.fromkeys(entry.name for entry in self.entries))

    def to_list(self) -> list[dict[str, Any]]:
        """Return the ledger as plain data, for report.json."""
        return [entry.to_dict() for entry in self.entries]

    @classmethod
    def from_list(cls, data: Sequence[Mapping[str, Any]]) -> Ledger:
        """Return the ledger of plain data."""
        return cls(entries=tuple(Entry.from_dict(one) for one in data))


def as_name(text: str) -> str:
    """Return a text as the name of a hypothesis: `Scans elsewhere` is `scans_elsewhere`."""
    return "_".join(text.lower().replace("-", " ").replace("_", " ").split())


def nats(value: float | None) -> str:
    """Return evidence with its unit, in whole nats where these suffice."""
    if value is None:
        return "unknown"
    text = f"{value:.1f}" if abs(value) < 10 else f"{value:,.0f}"
    return f"{text.removesuffix('.0')} nats".replace("-", "−")


def kept_ledger(path: Path) -> Ledger:
    """Return the ledger of a report: its folder, or its report.json.

    Raises
    ------
    SensorgraphError
        There is no report, it is damaged, or it was written by a version without a ledger.
    """
    file = path / "report.json" if path.is_dir() else path
    if not file.is_file():
        raise SensorgraphError(f"{file} does not exist; give the folder of a diagnosis, or its report.json")
    try:
        report = json.loads(file.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as exc:
        raise SensorgraphError(
            f"{file} is not JSON ({exc}); expected the report.json of a diagnosis"
        ) from exc
    if not isinstance(report, dict) or "effects" not in report:
        raise SensorgraphError(f"{file} is not a report; expected the report.json of a diagnosis")
    if "ledger" not in report:
        raise SensorgraphError(f"{file} has no ledger, as of an older version; diagnose the run again")
    try:
        return Ledger.from_list(report["ledger"])
    except (KeyError, TypeError, AttributeError, IndexError) as exc:
        raise SensorgraphError(f"the ledger of {file} is damaged ({exc}); diagnose the run again") from exc
