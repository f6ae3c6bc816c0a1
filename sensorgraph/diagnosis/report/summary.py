"""Summarise a diagnosis in a headline and a few sentences, for the top of the report and for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from sensorgraph.diagnosis.finding import Finding, SimulationComparison
from sensorgraph.diagnosis.motion.calibration.comparison import QUANTITIES
from sensorgraph.diagnosis.report.considered import tolerated
from sensorgraph.diagnosis.report.quantities import (
    brief,
    deviation_text,
    from_to,
    gap_sentence,
    largest,
    minus,
    percent,
    title_of,
)
from sensorgraph.diagnosis.result import BOTH_SIDES, Deviation, Rival, Unknown
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment

OF_MOUNT = {QUANTITIES[name].effect.name for name in ("mount_x", "mount_phi", "delay")}
MAX_CHANGES = 5
"""Maximum number of changes of the building that are listed."""


class Outcome(StrEnum):
    """Kind of result of a diagnosis."""

    FOUND = "found"
    UNDECIDED = "undecided"
    """A rival explains the data almost as well."""
    UNKNOWN = "unknown"
    """No effect of the library explains the difference."""
    NOTHING = "nothing"
    MISPLACED = "misplaced"
    """Arena and run do not belong together."""
    SKIPPED = "skipped"
    """No channel could be compared."""


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Top of the report."""

    outcome: Outcome
    headline: str
    details: tuple[str, ...]
    """Further sentences."""


def summarise(finding: Finding) -> Summary:
    """Return the headline of a finding and the sentences that belong to it."""
    effects, unknown, undecided = finding.effects, finding.unknown, undecided_rivals(finding)
    details = gap_sentences(finding)
    nameless = [] if finding.driving is None else finding.driving.nameless
    if finding.explained is None and unknown is not None and unknown.deviation is None:
        return _misplaced(unknown)
    compared = [name for name, one in finding.channels.items() if not one.skipped]
    if not compared:
        why = "; ".join(f"{name}: {one.skipped}" for name, one in finding.channels.items())
        return Summary(outcome=Outcome.SKIPPED, headline="Nothing could be compared.", details=(why,))
    if undecided:
        a, rival = undecided[0]
        headline = f"Undecided between {brief(a)} and {title_of(rival.name)}."
        details.insert(0, f"What would distinguish them: {rival.separates}.")
        rest = [b for b in effects if b is not a]
        if rest:
            details.insert(0, f"Also found: {'; '.join(brief(b) for b in rest)}.")
        outcome = Outcome.UNDECIDED
    elif unknown is not None and all((a.probability or 0.0) <= 0.5 for a in effects):
        headline, outcome = f"Something unknown{_place_phrase(unknown.deviation)}.", Outcome.UNKNOWN
        if effects:
            details.insert(0, f"Part of it is explained by {'; '.join(brief(a) for a in effects)}.")
    elif effects:
        named = [f"{brief(a)} ({percent(a.probability)})" for a in effects]
        headline = (
            f"Found: {named[0]}." if len(named) == 1 else f"Found {len(named)} effects: {'; '.join(named)}."
        )
        outcome = Outcome.FOUND
    else:
        headline, outcome = "Nothing material found.", Outcome.NOTHING
        who = "The scans agree with a simulation" if nameless else "Simulation and measurement agree"
        details.insert(0, _agreement(finding, who))
        if nameless:
            headline, outcome, nameless = f"{nameless[0]}.", Outcome.FOUND, nameless[1:]
    details[:0] = [f"{text}." for text in nameless]
    if unknown is not None:
        text = deviation_text(unknown.deviation) if unknown.deviation is not None else unknown.statement
        text = text.removeprefix("something no effect of the library explains: ")
        lead = (
            "In addition, something is unexplained: "
            if outcome is not Outcome.UNKNOWN
            else "No effect of the library explains it: "
        )
        details.insert(0, f"{lead}{text}.")
        details[1:1] = [*_of_use(unknown, text), *_elsewhere(finding, unknown)]
        if (
            finding.intake.get("share_at_walls", 1.0) < SCAN.alignment.good_share
        ):  # first, because names mean little then
            fit, _, why = str(finding.intake["arena"]).partition(": ")
            details[:0] = [sentence_case(why), headline]
            headline = sentence_case(fit)
    if outcome is not Outcome.NOTHING and (worse := _worse_than_stated(finding)):
        details.append(f"The fit assumes that {worse} than robot.yaml specifies.")
    details += map_sentences(finding)
    details += tolerance_sentences(finding)
    summary = Summary(outcome=outcome, headline=headline, details=tuple(details))
    return summary if finding.simulation is None else _against(finding.simulation, summary, effects)


def _against(compared: SimulationComparison, summary: Summary, effects: Sequence[Amendment]) -> Summary:
    """Turn a summary into one of the difference between robot and simulation."""
    details = list(summary.details)
    changed = {a.name for a, _ in compared.changed}
    headline = summary.headline
    if summary.outcome is Outcome.FOUND:
        lacking = [f"{brief(a)} ({percent(a.probability)})" for a in effects if a.name not in changed]
        headline = (
            f"The simulation lacks {'; '.join(lacking)}."
            if lacking
            else "Robot and simulation show the same effects with different sizes."
        )
    elif summary.outcome is Outcome.NOTHING:
        headline = "Robot and simulation do not differ materially."
        details = details[1:]
    if compared.only_in_simulation:
        only = "; ".join(brief(a) for a in compared.only_in_simulation)
        if summary.outcome is Outcome.NOTHING:
            headline = f"Only the simulation shows {only}."
        else:
            details.insert(0, f"Only the simulation shows {only}.")
        for name, why in compared.not_observable.items():
            details.insert(1, f"The robot's run could not have shown {title_of(name)}: {why}.")
    if changed:
        pairs = [f"{brief(a)} (simulation: {brief(b).partition(', ')[2]})" for a, b in compared.changed]
        details.insert(0, f"Both show, with different sizes: {'; '.join(pairs)}.")
    if compared.shared:
        details.append(f"Both show {'; '.join(brief(a) for a in compared.shared)}: no difference.")
    if compared.unknown is not None:
        text = compared.unknown.statement.removeprefix("something no effect of the library explains: ")
        both = "Robot and simulation both show" if compared.shares_unknown else "The simulation itself shows"
        details.append(f"{both} something that no effect explains: {text}.")
    details += _noise_sentences(compared)
    return replace(summary, headline=headline, details=tuple(details))


def _noise_sentences(compared: SimulationComparison) -> list[str]:
    """Compare the scatter of the two lasers."""
    ours, theirs = compared.robot_noise, compared.simulated_noise
    if ours is None or theirs is None:
        return []
    ratio = max(ours.scatter, 1e-9) / max(theirs.scatter, 1e-9)
    if max(ratio, 1 / ratio) < SCAN.nuisance.stretched_scale:
        return []
    return [
        f"The laser scatters by {100 * ours.scatter:.2f} cm, the simulated one by {100 * theirs.scatter:.2f} cm."
    ]


def _agreement(finding: Finding, who: str) -> str:
    """State that simulation and measurement agree, in the words of `who`, and under which condition."""
    worse = _worse_than_stated(finding)
    if not worse:
        what = "the tolerances" if tolerated(finding) else "the accuracy of a careful setup"
        return f"{who} within {what}{_but_for_poses(finding)}."
    return f"{who} only if {worse} than robot.yaml specifies."


def _but_for_poses(finding: Finding) -> str:
    """State the limits of a short run whose poses were located with its own scans."""
    driving = finding.driving
    if not finding.data.from_scans or (driving is not None and not OF_MOUNT & driving.hidden.keys()):
        return ""
    return "; the poses were located with these scans, so that an error of the laser's mount or delay would not show"


def _worse_than_stated(finding: Finding) -> str:
    """Return the tolerances that the fit widened, with the factor; empty where none is."""
    names = {
        "map": "map is",
        "pose": "reference pose is",
        "stamp": "stamps are",
        "heading": "reference's heading is",
    }
    return " and ".join(
        f"the {names[of]} {factor:.1f} times worse"
        for of, factor in finding.tolerance_factors.items()
        if factor >= SCAN.nuisance.stretched_scale
    )


def _of_use(unknown: Unknown, said: str) -> list[str]:
    """Return the consequence of an unexplained difference, unless `said` has it, and its likely causes."""
    out = []
    if unknown.consequence and unknown.consequence not in said:
        out.append(sentence_case(unknown.consequence))
    causes = [cause for cause in unknown.families if cause not in said]
    if causes:
        out.append(f"It may be {'; or '.join(causes)}.")
    return out


def _elsewhere(finding: Finding, told: Unknown) -> list[str]:
    """Return what is unexplained in other channels than that of the headline; the cause may be the same."""
    others = [one.unknown for one in finding.channels.values() if one.unknown is not None]
    return [
        sentence_case(one.statement.replace(", which no effect of the library explains", "", 1))
        for one in others
        if one is not told
    ]


def _misplaced(unknown: Unknown) -> Summary:
    """Report that arena and run do not belong together."""
    head, _, rest = unknown.statement.partition(": ")
    details = tuple(map(sentence_case, rest.split("; ")))
    return Summary(outcome=Outcome.MISPLACED, headline=sentence_case(head), details=details)


def sentence_case(text: str) -> str:
    """Return text as a sentence, with a capital and one full stop."""
    return text[:1].upper() + text[1:].rstrip(".") + "."


def undecided_rivals(finding: Finding) -> list[tuple[Amendment, Rival]]:
    """Return effects with a rival that explains the data almost as well and is not named itself."""
    named = {a.name for a in finding.effects}
    rivals = [
        rival for result in finding.channels.values() for rival in result.rivals if rival.name not in named
    ]
    return [(a, rival) for a in finding.undecided for rival in rivals if rival.instead_of == a.name]


def map_sentences(finding: Finding) -> list[str]:
    """Report changes of the building, excluded rays, and a map that was built from a log."""
    notes = finding.intake.get("map_of_pixels", finding.intake)
    out = []
    if notes.get("changes"):
        listed = "; ".join(one["statement"] for one in notes["changes"][:MAX_CHANGES])
        more = len(notes["changes"]) - MAX_CHANGES
        rest = f"; and {more} smaller ones" if more > 0 else ""
        share = 100 * notes["changes_share"]
        out.append(
            f"The building differs from its map ({share:.0f} % of the readings, excluded): {listed}{rest}."
        )
    if notes.get("walls_at_cell_borders"):
        out.append(
            "The walls are at the borders of the map's cells, as in a simulated world that was made from the map; in a "
            "robot's map they are in the middle of the cells."
        )
    if notes.get("into_unknown_share", 0.0) > 0.005:
        out.append(
            f"{100 * notes['into_unknown_share']:.0f} % of the rays enter space unknown to the map; they are excluded."
        )
    if finding.intake.get("is_uncommissioned_graph"):
        out.append(
            "The walls were built from a log, so that errors of that log appear as effects. Known-good runs "
            "(--commissioning) distinguish the two."
        )
    return out


def tolerance_sentences(finding: Finding) -> list[str]:
    """Report which effects the tolerances hide, and how much they absorbed in this run."""
    found = tolerated(finding)
    if not found:
        return []
    passed = [
        f"{one.most.effect.title} of up to {largest(one.most)}"
        + (f" (this run may have {largest(one.taken)})" if one.taken is not None else "")
        for one in found
    ]
    keys = ", ".join(one.tolerance for one in found)
    whose = "in robot.yaml"
    if finding.data.site.intervals:
        whose = "shown by the known-good runs"
    elif finding.data.grain > 0:
        whose = "due to the cells of the map"
    return [f"The tolerances {whose} are wide ({keys}); they hide: {'; '.join(passed)}."]


def intake_sentences(finding: Finding) -> list[str]:
    """Report dropped scans and channels that were not evaluated, one line each."""
    out = []
    scans, used = finding.intake.get("scans", 0), finding.intake.get("used", 0)
    dropped = {why: n for why, n in finding.intake.get("dropped", {}).items() if n}
    if dropped and used < scans:
        counted = ", ".join(f"{n:,} {why}" for why, n in dropped.items())
        out.append(f"used {used:,} of {scans:,} scans; dropped: {counted}")
    for name, result in finding.channels.items():
        if result.skipped and finding.explained is not None:
            out.append(f"{name}: not evaluated, {result.skipped}")
    return out


def _place_phrase(deviation: Deviation | None) -> str:
    """Return where an unexplained difference is, or between which signals."""
    if deviation is None:
        return ""
    if deviation.channel in BOTH_SIDES:
        return f": {BOTH_SIDES[deviation.channel]} differ {deviation.label}"
    part, words = deviation.partition, {"hit place": "", "robot place": "where the robot is"}
    where = f"{words.get(part, 'at ' + part)} {deviation.label}{deviation.about()}".strip()
    return minus(f" {where}")


def main_channel(finding: Finding) -> str:
    """Return the channel of the headline: that of the first effect, or of the unexplained difference."""
    if finding.effects or finding.undecided:
        return (*finding.effects, *finding.undecided)[0].effect.channel
    for name, result in finding.channels.items():
        if result.unknown is not None:
            return name
    return next(iter(finding.channels))


def gap_sentences(finding: Finding) -> list[str]:
    """Report the gap before and after in each channel with a named effect; without one, its size."""
    named = [name for name, result in finding.channels.items() if result.effects]
    out, is_widened = [], bool(_worse_than_stated(finding))
    for name in named or [main_channel(finding)]:
        result = finding.channels[name]
        text = gap_sentence(result.gap, channel=name, n_effects=len(result.effects), is_widened=is_widened)
        out.append(f"{name.capitalize()}: {text[0].lower()}{text[1:]}" if text and len(named) > 1 else text)
    return [text for text in (*out, _second_gap_sentence(finding)) if text]


def _second_gap_sentence(finding: Finding) -> str:
    """Report the gap on a second run, or that the runs disagree; empty without a second run or an effect."""
    gap = finding.second_gap
    if gap is None or gap.noise_floor.normalised <= 0:
        return ""
    left = gap.after.normalised / gap.noise_floor.normalised
    rest = f"its gap is {left:.2f} times the noise floor; diagnose it separately"
    is_like = left < SCAN.nuisance.stretched_scale
    if not finding.channels["scan"].effects:
        return "" if is_like else f"The second run disagrees: {rest}."
    lost = gap.after.nats_per_ray - gap.before.nats_per_ray
    if lost > 0:
        return (
            f"The second run disagrees: with the effects in the model its log-likelihood falls by {lost:.3g} per reading. "
            "The effects hold for the first run only."
        )
    said = f"On the second run, which was not used in any fit, it shrinks {from_to(gap, 'cm')})"
    return f"{said}." if is_like else f"{said}, and something else is unexplained: {rest}."
