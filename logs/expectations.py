"""What a log must hold: topics, rates, gaps and stamps, learned from good logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from logs.errors import LogError
from logs.inspection import Inspection, TopicInfo

RATE_SHARES = {"warning": 0.9, "error": 0.5}
"""Level -> share of the lowest rate in the good logs, below which a rate is too low."""
GAP_FACTORS = {"warning": 2.0, "error": 5.0}
"""Level -> factor of the longest gap in the good logs, above which a gap is too long."""


@dataclass(frozen=True, kw_only=True)
class TopicDeviation:
    """One way in which a log differs from what is expected."""

    level: str
    """warning or error"""
    text: str


def expected_topics(good: Sequence[Inspection]) -> dict[str, Any]:
    """Return the limits of each topic that all good logs hold, as plain data."""
    common = set.intersection(*({topic.name for topic in one.topics} for one in good)) if good else set()
    out: dict[str, Any] = {}
    for name in sorted(common):
        each = [topic for one in good for topic in one.topics if topic.name == name]
        limits: dict[str, Any] = {"type": each[0].type}
        rates = [topic.rate for topic in each if topic.rate is not None]
        gaps = [topic.longest_gap for topic in each if topic.longest_gap is not None]
        if len(rates) == len(each):
            limits["rate_hz"] = {level: round(share * min(rates), 3) for level, share in RATE_SHARES.items()}
        if len(gaps) == len(each):
            limits["gap_s"] = {level: round(factor * max(gaps), 3) for level, factor in GAP_FACTORS.items()}
        silences = [
            _silence(topic, end_of(one))[0] for one in good for topic in one.topics if topic.name == name
        ]
        if len(gaps) == len(each):
            longest = max(*silences, *gaps)
            limits["silent_s"] = {level: round(factor * longest, 3) for level, factor in GAP_FACTORS.items()}
        limits["n_back"] = max(topic.n_back for topic in each)
        out[name] = limits
    return out


def deviations(found: Inspection, expected: Mapping[str, Any]) -> list[TopicDeviation]:
    """Return how a log differs from the limits of its topics.

    Raises
    ------
    LogError
        If the limits are not those that `expected_topics` returns.
    """
    known = {topic.name: topic for topic in found.topics}
    out = []
    try:
        for name, limits in expected.items():
            if name not in known:
                out.append(
                    TopicDeviation(level="error", text=f"{name} is missing, expected {limits['type']}")
                )
                continue
            out += _of_topic(known[name], limits, end_of(found))
    except (KeyError, TypeError, AttributeError) as exc:
        raise LogError(
            f"the limits of topics are not readable ({type(exc).__name__}: {exc}); make the policy again with "
            "watch GRAPH --init-policy RUN... -o FILE"
        ) from exc
    return out


def end_of(found: Inspection) -> float:
    """Return the time [s] of the last message of a log, from its start."""
    return max((topic.last for topic in found.topics if topic.last is not None), default=0.0)


def _silence(topic: TopicInfo, end: float) -> tuple[float, str]:
    """Return the longer time [s] without messages at the start or the end of a log, and which one it is."""
    if topic.first is None or topic.last is None:
        return 0.0, "start"
    return max((topic.first, "start"), (end - topic.last, "end"))


def _of_topic(topic: TopicInfo, limits: Mapping[str, Any], end: float) -> list[TopicDeviation]:
    rate, gap, (silent, side) = topic.rate or 0.0, topic.longest_gap or 0.0, _silence(topic, end)
    name, at_most = topic.name, "expected at most"
    said = (
        [("error", f"{name} is {topic.type}, expected {limits['type']}")]
        if topic.type != limits["type"]
        else []
    )
    for key, value, sign, text, unit in (
        ("rate_hz", rate, -1, f"{name} has {rate:.2f} Hz, expected", "Hz"),
        ("gap_s", gap, 1, f"{name} has a gap of {gap:.2f} s, {at_most}", "s"),
        (
            "silent_s",
            silent,
            1,
            f"{name} is silent for {silent:.2f} s at the {side} of the log, {at_most}",
            "s",
        ),
    ):
        for level in ("error", "warning") if key in limits else ():
            if sign * (value - limits[key][level]) > 0:
                said.append((level, f"{text} {limits[key][level]:g} {unit}"))
                break
    if topic.n_back > limits["n_back"]:
        said.append(("error", f"{name}: stamps go back {topic.n_back} times, {at_most} {limits['n_back']}"))
    return [TopicDeviation(level=level, text=text) for level, text in said]
