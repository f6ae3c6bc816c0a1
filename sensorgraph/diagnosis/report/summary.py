"""What a diagnosis says in one line and a few sentences: the top of the report, and the console."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.report.quantities import (
    brief,
    deviation_text,
    largest,
    minus,
    percent,
    title_of,
)
from sensorgraph.diagnosis.report.tolerated import tolerated
from sensorgraph.diagnosis.result import Deviation, Gap, Rival, Unknown
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.simulation import NOISE_RATIO, SimulationComparison
from sensorgraph.effects import Amendment

MIN_LEAD = 6.0
"""[nats] by which an effect must lead its runner-up to be called found."""
UNCHANGED = 0.97
"""Of the RMS gap: when more than this is left, the gap is said to hardly change."""
QUIET_LASER = " sensor.sigma of robot.yaml is about {factor:.1f} times what the laser scatters; stated as it is, smaller effects show."
MAX_CHANGES = 5
"""Changes of the building that are listed."""

BOTH_SIDES = {"odometry": "odometry and reference pose", "drive": "commands and odometry"}
"""Channel of motion -> what is compared."""


class Outcome(StrEnum):
    """What kind of result a diagnosis has."""

    FOUND = "found"
    UNDECIDED = "undecided"
    """A rival explains the data almost as well."""
    UNKNOWN = "unknown"
    """No effect of the library explains what differs."""
    NOTHING = "nothing"
    MISPLACED = "misplaced"
    """Arena and run do not belong together."""
    SKIPPED = "skipped"
    """No channel could be compared."""


@dataclass(frozen=True, kw_only=True)
class Summary:
    """What the top of the report says."""

    outcome: Outcome
    headline: str
    details: tuple[str, ...]
    """Further sentences."""


def summarise(finding: Finding) -> Summary:
    """Summarise a finding: one headline, and the sentences that go with it."""
    effects, unknown, undecided = finding.effects, finding.unknown, undecided_rivals(finding)
    details = gap_sentences(finding)
    if finding.explained is None and unknown is not None and unknown.deviation is None:
        return _misplaced(unknown)
    compared = [name for name, one in finding.channels.items() if not one.skipped]
    if not compared:
        why = "; ".join(f"{name}: {one.skipped}" for name, one in finding.channels.items())
        return Summary(outcome=Outcome.SKIPPED, headline="Nothing could be compared.", details=(why,))
    if undecided:
        a, rival = undecided[0]
        headline = f"Undecided between {brief(a)} and {title_of(rival.name)}."
        details.insert(0, f"What would tell them apart: {rival.separates}.")
        rest = [b for b in effects if b is not a]
        if rest:
            details.insert(0, f"Found besides: {'; '.join(brief(b) for b in rest)}.")
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
        details.insert(0, _agreement(finding))
    if unknown is not None:
        text = deviation_text(unknown.deviation) if unknown.deviation is not None else unknown.statement
        text = text.removeprefix("something no effect of the library explains: ")
        lead = (
            "Besides, something unknown is left: "
            if outcome is not Outcome.UNKNOWN
            else "No effect of the library explains it: "
        )
        details.insert(0, f"{lead}{text}.")
        details[1:1] = [*_of_use(unknown, text), *_elsewhere(finding, unknown)]
        if (
            finding.intake.get("share_at_walls", 1.0) < SCAN.alignment.good_share
        ):  # said first: names mean little there
            fit, _, why = str(finding.intake["arena"]).partition(": ")
            details[:0] = [sentence_case(why), headline]
            headline = sentence_case(fit)
    if outcome is not Outcome.NOTHING and (worse := _worse_than_stated(finding)):
        details.append(f"The fit assumes that {worse} than robot.yaml says.")
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
            f"The robot shows what the simulation lacks: {'; '.join(lacking)}."
            if lacking
            else "Robot and simulation show the same effects, but not alike."
        )
    elif summary.outcome is Outcome.NOTHING:
        headline = "Robot and simulation do not differ materially."
        details = details[1:]
    if compared.only_in_simulation:
        only = "; ".join(brief(a) for a in compared.only_in_simulation)
        if summary.outcome is Outcome.NOTHING:
            headline = f"The simulation shows what the robot lacks: {only}."
        else:
            details.insert(0, f"Only the simulation shows {only}.")
        for name, why in compared.not_observable.items():
            details.insert(1, f"The robot's run could not have shown {title_of(name)}: {why}.")
    if changed:
        pairs = [f"{brief(a)} (simulation: {brief(b).partition(', ')[2]})" for a, b in compared.changed]
        details.insert(0, f"Both show, but not alike: {'; '.join(pairs)}.")
    if compared.shared:
        details.append(f"Both show {'; '.join(brief(a) for a in compared.shared)}: no difference.")
    if compared.unknown is not None:
        text = compared.unknown.statement.removeprefix("something no effect of the library explains: ")
        both = "Robot and simulation both show" if compared.shares_unknown else "The simulation itself shows"
        details.append(f"{both} something unknown: {text}.")
    details += _noise_sentences(compared)
    return replace(summary, headline=headline, details=tuple(details))


def _noise_sentences(compared: SimulationComparison) -> list[str]:
    """Say how the lasers differ."""
    ours, theirs = compared.robot_noise, compared.simulated_noise
    if ours is None or theirs is None:
        return []
    ratio = max(ours.scatter, 1e-9) / max(theirs.scatter, 1e-9)
    if 1 / NOISE_RATIO < ratio < NOISE_RATIO:
        return []
    return [
        f"The laser scatters by {100 * ours.scatter:.2f} cm, the simulated one by {100 * theirs.scatter:.2f} cm."
    ]


def _agreement(finding: Finding) -> str:
    """Say that nothing is left, and what that takes."""
    worse = _worse_than_stated(finding)
    if not worse:
        what = "the tolerances" if tolerated(finding) else "what a careful set-up holds"
        return f"Simulation and measurement agree within {what}{_but_for_poses(finding)}."
    text = f"Simulation and measurement agree only if {worse} than robot.yaml says"
    gap = finding.channels["scan"].gap
    if gap is None or gap.stated_floor is None:
        return f"{text}."
    stated, widened = 100 * gap.stated_floor.rmse_m, 100 * gap.noise_floor.rmse_m
    return f"{text} (noise floor {widened:.2f} cm; {stated:.2f} cm with the tolerances as stated)."


def _but_for_poses(finding: Finding) -> str:
    """Say what nobody can tell of a run whose poses were located with its own scans, and that drove too little for more."""
    if not finding.data.from_scans or finding.driving is not None:
        return ""
    return "; the poses were located with these scans, so that a mount or a delay of the laser would not show"


def _worse_than_stated(finding: Finding) -> str:
    """Say which tolerances the fit had to widen, and by how much; empty where they hold."""
    scales = (
        ("map is", finding.map_tolerance_factor),
        ("reference pose is", finding.pose_tolerance_factor),
        ("stamps are", finding.stamp_tolerance_factor),
        ("reference's heading is", finding.heading_tolerance_factor),
    )
    least = SCAN.nuisance.stretched_scale
    return " and ".join(
        f"the {name} {scale:.1f} times worse"
        for name, scale in scales
        if scale is not None and scale >= least
    )


def _of_use(unknown: Unknown, said: str) -> list[str]:
    """Say what the unknown costs, unless that is said, and what it may be."""
    out = []
    if unknown.consequence and unknown.consequence not in said:
        out.append(sentence_case(unknown.consequence))
    causes = [cause for cause in unknown.families if cause not in said]
    if causes:
        out.append(f"It may be {'; or '.join(causes)}.")
    return out


def _elsewhere(finding: Finding, told: Unknown) -> list[str]:
    """Say what is unknown in other channels than the one of the headline: it may be the same thing."""
    others = [one.unknown for one in finding.channels.values() if one.unknown is not None]
    return [
        sentence_case(one.statement.replace(", which no effect of the library explains", "", 1))
        for one in others
        if one is not told
    ]


def _misplaced(unknown: Unknown) -> Summary:
    """Say that arena and run do not belong together, before anything else."""
    head, _, rest = unknown.statement.partition(": ")
    details = tuple(map(sentence_case, rest.split("; ")))
    return Summary(outcome=Outcome.MISPLACED, headline=sentence_case(head), details=details)


def sentence_case(text: str) -> str:
    """Return text as a sentence: capital first, one full stop at the end."""
    return text[:1].upper() + text[1:].rstrip(".") + "."


def undecided_rivals(finding: Finding) -> list[tuple[Amendment, Rival]]:
    """Return named effects with a rival that explains the data almost as well; an effect that is named is no rival."""
    names = {a.name for a in finding.effects}
    out = []
    for a in (*finding.undecided, *finding.effects):
        for result in finding.channels.values():
            for rival in result.rivals:
                close = a in finding.undecided or (a.evidence or 0.0) - rival.evidence_nats < MIN_LEAD
                if rival.instead_of == a.name and rival.name not in names and close:
                    out.append((a, rival))
    return out


def map_sentences(finding: Finding) -> list[str]:
    """Say where the building is not as its map, what of the run was not judged, and where the map is from a log."""
    notes = finding.intake.get("map_of_pixels", finding.intake)
    out = []
    if notes.get("changes"):
        listed = "; ".join(one["statement"] for one in notes["changes"][:MAX_CHANGES])
        more = len(notes["changes"]) - MAX_CHANGES
        rest = f"; and {more} smaller ones" if more > 0 else ""
        share = 100 * notes["changes_share"]
        out.append(
            f"The building is not as its map ({share:.0f} % of the readings, not judged): {listed}{rest}."
        )
    if notes.get("into_unknown_share", 0.0) > 0.005:
        out.append(
            f"{100 * notes['into_unknown_share']:.0f} % of the rays enter space that the map does not know: not judged."
        )
    if finding.intake.get("is_uncommissioned_graph"):
        out.append(
            "The walls were found in a log: what it has wrong counts as an effect here; runs known to be good "
            "(--commissioning) tell the two apart."
        )
    return out


def tolerance_sentences(finding: Finding) -> list[str]:
    """Say what the tolerances are too wide to show, and what they took in this run."""
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
    if finding.data.baseline_intervals:
        whose = "that the good runs show"
    elif finding.data.grain > 0:
        whose = "that the cells of the map leave"
    return [f"The tolerances {whose} are wide ({keys}), so that these get no name: {'; '.join(passed)}."]


def intake_sentences(finding: Finding) -> list[str]:
    """Say which scans were dropped and which channels were not looked at, one line each."""
    out = []
    scans, used = finding.intake.get("scans", 0), finding.intake.get("used", 0)
    dropped = {why: n for why, n in finding.intake.get("dropped", {}).items() if n}
    if dropped and used < scans:
        counted = ", ".join(f"{n:,} {why}" for why, n in dropped.items())
        out.append(f"used {used:,} of {scans:,} scans; dropped: {counted}")
    for name, result in finding.channels.items():
        if result.skipped and finding.explained is not None:
            out.append(f"{name}: not looked at, {result.skipped}")
    return out


def _place_phrase(deviation: Deviation | None) -> str:
    """Say where something unknown is, or between what."""
    if deviation is None:
        return " is left"
    if deviation.channel in BOTH_SIDES:
        return f": {BOTH_SIDES[deviation.channel]} differ {deviation.label}"
    part = deviation.partition.removesuffix(" and half of the run")
    words = {"hit place": "", "robot place": "where the robot is"}
    where = f"{words.get(part, 'at ' + part)} {deviation.label}{deviation.about()}".strip()
    return minus(f" {where}")


def main_channel(finding: Finding) -> str:
    """Return the channel that the headline is about: the first-named effect's, or that of the unknown."""
    if finding.effects or finding.undecided:
        return (*finding.effects, *finding.undecided)[0].effect.channel
    for name, result in finding.channels.items():
        if result.unknown is not None:
            return name
    return next(iter(finding.channels))


def gap_sentences(finding: Finding) -> list[str]:
    """Say how far the gap shrinks in each channel with a named effect; without one, how large the gap is."""
    named = [name for name, result in finding.channels.items() if result.effects]
    out = []
    for name in named or [main_channel(finding)]:
        result = finding.channels[name]
        text = gap_sentence(result.gap, channel=name, n_effects=len(result.effects))
        out.append(f"{name.capitalize()}: {text[0].lower()}{text[1:]}" if text and len(named) > 1 else text)
    return [text for text in (*out, _second_gap_sentence(finding)) if text]


def _second_gap_sentence(finding: Finding) -> str:
    """Say how far the gap shrinks on a second run, or that the runs disagree; empty where there is none, or nothing to prove."""
    gap = finding.second_gap
    if gap is None or gap.noise_floor.normalised <= 0:
        return ""
    left = gap.after.normalised / gap.noise_floor.normalised
    rest = f"its gap is {left:.2f} times the noise floor; diagnose it by itself"
    is_like = left < SCAN.nuisance.stretched_scale
    if not finding.channels["scan"].effects:
        return "" if is_like else f"The second run disagrees: {rest}."
    lost = gap.after.nats_per_ray - gap.before.nats_per_ray
    if lost > 0:
        return (
            f"The second run disagrees: with that in the model its readings are less likely, by {lost:.3g} nats each; "
            "what was found is of the first run alone."
        )
    said = f"On the second run, of which nothing was fitted, it shrinks {_from_to(gap, 'cm')})"
    return f"{said}." if is_like else f"{said}, and something else is left: {rest}."


def _from_to(gap: Gap, unit: str) -> str:
    """Say how far a gap shrinks, the bracket open.

    Parameters
    ----------
    unit : cm of scans, cm/s of motion
    """
    before, after = (f.normalised / gap.noise_floor.normalised for f in (gap.before, gap.after))
    return (
        f"from {before:.2f} to {after:.2f} times the noise floor "
        f"({100 * gap.before.rmse_m:.2f} to {100 * gap.after.rmse_m:.2f} {unit}"
    )


def gap_sentence(gap: Gap | None, *, channel: str = "scan", n_effects: int = 1) -> str:
    """Say how far the gap shrinks, in units of the noise floor."""
    if gap is None or gap.noise_floor.normalised <= 0:
        return ""
    before, after, floor = (f.normalised for f in (gap.before, gap.after, gap.noise_floor))
    unit = "cm" if channel == "scan" else "cm/s"
    if not n_effects:
        is_loud = channel == "scan" and after * SCAN.nuisance.stretched_scale < floor
        return (
            f"The gap is {after / floor:.2f} times the noise floor "
            f"({100 * gap.after.rmse_m:.2f} {unit} over {100 * gap.noise_floor.rmse_m:.2f} {unit})."
        ) + (QUIET_LASER.format(factor=floor / after) if is_loud else "")
    it = "it" if n_effects == 1 else "them"
    gained = minus(f"{gap.before.nats_per_ray - gap.after.nats_per_ray:.3g} nats")
    if after > UNCHANGED * before:
        return (
            f"With {it} in the model every reading is better explained, by {gained} on average over {gap.n_rays:,} "
            "readings that no fit has seen; the RMS gap, which it hardly changes, is "
            f"{after / floor:.2f} times the noise floor."
        )
    return (
        f"With {it} in the model the gap shrinks {_from_to(gap, unit)}; a reading is likelier by {gained}), "
        "on readings that no fit has seen."
    )
