"""Words for people: numbers with their errors in cm, degrees and ms, and what a diagnosis says in one line."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from sensorgraph.diagnosis.diagnose import Finding
from sensorgraph.diagnosis.result import Deviation, Gap, Rival, Unknown
from sensorgraph.diagnosis.scan.map_alignment import PARTLY
from sensorgraph.effects import Amendment, Parameter

SYMBOLS = {
    "delta": "δ", "tau": "τ", "gamma": "γ", "beta": "β", "theta0": "θ₀", "theta1": "θ₁", "theta2": "θ₂",
    "alpha_ret": "α_ret", "alpha_max": "α_max", "r0": "r₀", "b1": "b₁",
}  # fmt: skip
SCALES = {"rad": (180 / math.pi, "°"), "m/m": (1000.0, "mm per m"), "m/s": (1.0, "m/s")}
UNDECIDED = 6.0
"""[nats] by which a name must lead its runner-up to be called found."""
SIGNED = {"b", "b1", "s", "d", "dx", "dy", "delta", "tau", "T"}
"""Parameters of which the sign says something, where they are sizes."""


@dataclass(frozen=True, kw_only=True)
class Said:
    """What the top of the report says."""

    kind: str
    """`found`, `undecided`, `unknown`, `nothing`, `misplaced` or `skipped`."""
    headline: str
    details: tuple[str, ...]
    """Further sentences."""


def symbol(name: str) -> str:
    """Return a parameter as it stands in equations."""
    return SYMBOLS.get(name, name)


def scaled(parameter: Parameter, value: float, size: float | None = None) -> tuple[float, str]:
    """Return (factor, unit) in which people would say a value of this parameter."""
    size = abs(value) if size is None else size
    if parameter.unit == "m":
        if parameter.materiality is not None:
            return (100.0, "cm") if size < 1 else (1.0, "m")
        return (1000.0, "mm") if 0 < size < 0.1 and parameter.name == "q" else (1.0, "m")
    if parameter.unit == "s":
        return (1000.0, "ms") if size < 1 else (1.0, "s")
    if parameter.unit == "":
        return 100.0, "%"
    return SCALES.get(parameter.unit, (1.0, parameter.unit))


def number(value: float, error: float | None = None, *, signed: bool = False) -> str:
    """Round to what the error leaves sure; three digits where it is not known."""
    if not math.isfinite(value):
        return str(value)
    known = error is not None and math.isfinite(error) and error > 0
    if known and error is not None:
        digits = -math.floor(math.log10(error)) + (1 if f"{error:.1e}"[0] in "12" else 0)
    else:
        digits = 2 if value == 0 else 2 - math.floor(math.log10(abs(value)))
    digits = min(max(digits, 0), 6)
    text = f"{value:{'+' if signed else ''}.{digits}f}"
    if known and error is not None:
        text += f" ± {error:.{digits}f}"
    return minus(text)


def minus(text: str) -> str:
    """Set a proper sign before negative numbers."""
    return re.sub(r"(?<!\w)-(?=\d)", "−", text)


def quantity(a: Amendment, name: str) -> str:
    """Return one parameter of an effect with its standard error and unit: `+0.41° ± 0.01°`."""
    parameter = next((p for p in a.effect.parameters if p.name == name), None)
    value, error = a.parameters[name], a.stderr.get(name)
    if parameter is None:
        return number(value, error)
    factor, unit = scaled(parameter, value)
    text = number(
        factor * value, None if error is None else factor * error, signed=name in SIGNED & set(a.effect.sizes)
    )
    if unit == "°":
        return text.replace(" ± ", "° ± ") + "°"
    return f"{text} {unit}".strip()


def parameters(a: Amendment) -> list[str]:
    """Return `b = −2.4 ± 0.1 cm` for every parameter."""
    return [f"{symbol(name)} = {quantity(a, name)}" for name in a.parameters]


def brief(a: Amendment) -> str:
    """Return an effect in a few words: `mounting yaw, +0.41° ± 0.01°`."""
    sizes = [name for name in a.parameters if name in a.effect.sizes] or list(a.parameters)
    plain = len(sizes) == 1 and "%" not in quantity(a, sizes[0])
    shown = [quantity(a, n) if plain else f"{symbol(n)} = {quantity(a, n)}" for n in sizes[:3]]
    place = f" at {place_words(a)}" if place_words(a) else ""
    return ", ".join([a.effect.title + place, *shown])


def place_words(a: Amendment) -> str:
    """Return where an effect sits, empty where it has no place."""
    if a.location is None:
        return ""
    if a.location.name:
        return a.location.name
    return "" if a.location.xy is None else minus(f"({a.location.xy[0]:.2f}, {a.location.xy[1]:.2f}) m")


def percent(p: float | None) -> str:
    """Return a probability; never quite certain."""
    if p is None:
        return "–"
    if p > 0.995:
        return "> 99 %"
    return "< 1 %" if p < 0.01 else f"{100 * p:.0f} %"


def tolerance(name: str, value: float) -> str:
    """Return one of robot.yaml's tolerances with a unit."""
    if name.endswith("yaw"):
        return f"{math.degrees(value):.3g}°"
    return f"{1000 * value:.3g} {'ms' if name == 'stamp' else 'mm'}"


def undecided(finding: Finding) -> list[tuple[Amendment, Rival]]:
    """Return the names that a runner-up explains almost as well (a runner-up that is itself named is none)."""
    names = {a.name for a in finding.effects}
    out = []
    for a in (*finding.undecided, *finding.effects):
        for result in finding.channels.values():
            for rival in result.rivals:
                close = (a.evidence or 0.0) - rival.evidence_nats < UNDECIDED
                if rival.instead_of == a.name and rival.name not in names and close:
                    out.append((a, rival))
    return out


def title_of(name: str) -> str:
    """Return the readable title of an effect."""
    from sensorgraph.effects import EFFECTS

    return EFFECTS[name].title if name in EFFECTS else name


def said(finding: Finding) -> Said:
    """Say what came out."""
    effects, unknown, doubt = finding.effects, finding.unknown, undecided(finding)
    details = gap_sentences(finding)
    if finding.explained is None and unknown is not None and unknown.deviation is None:
        return misplaced(unknown)
    seen = [name for name, one in finding.channels.items() if not one.skipped]
    if not seen:
        why = "; ".join(f"{name}: {one.skipped}" for name, one in finding.channels.items())
        return Said(kind="skipped", headline="Nothing could be compared.", details=(why,))
    if doubt:
        a, rival = doubt[0]
        headline = f"Undecided between {brief(a)} and {title_of(rival.name)}."
        details.insert(0, f"What would tell them apart: {rival.separates}.")
        rest = [b for b in effects if b is not a]
        if rest:
            details.insert(0, f"Found besides: {'; '.join(brief(b) for b in rest)}.")
        kind = "undecided"
    elif unknown is not None and all((a.probability or 0.0) <= 0.5 for a in effects):
        headline, kind = f"Something unknown {_at(unknown.deviation)}.", "unknown"
        if effects:
            details.insert(0, f"Part of it is explained by {'; '.join(brief(a) for a in effects)}.")
    elif effects:
        sure = [f"{brief(a)} ({percent(a.probability)})" for a in effects]
        headline = (
            f"Found: {sure[0]}." if len(sure) == 1 else f"Found {len(sure)} effects: {'; '.join(sure)}."
        )
        kind = "found"
    else:
        headline, kind = "Nothing material found.", "nothing"
        details.insert(0, "Simulation and measurement agree within what a careful set-up holds.")
    if unknown is not None:
        text = deviation(unknown.deviation) if unknown.deviation is not None else unknown.statement
        text = text.removeprefix("something no effect of the library explains: ")
        lead = (
            "Besides, something unknown is left: "
            if kind != "unknown"
            else "No effect of the library explains it: "
        )
        details.insert(0, f"{lead}{text}.")
        if finding.intake.get("share_at_walls", 1.0) < PARTLY:  # said first: names mean little there
            fit, _, why = str(finding.intake["arena"]).partition(": ")
            details[:0] = [sentence_case(why), headline]
            headline = sentence_case(fit)
    details += tolerance_sentences(finding)
    return Said(kind=kind, headline=headline, details=tuple(details))


def misplaced(unknown: Unknown) -> Said:
    """Say that arena and run do not belong together, before anything else."""
    head, _, rest = unknown.statement.partition(": ")
    return Said(
        kind="misplaced", headline=sentence_case(head), details=tuple(map(sentence_case, rest.split("; ")))
    )


def sentence_case(text: str) -> str:
    """Return words as a sentence: a capital first, one full stop at the end."""
    return text[:1].upper() + text[1:].rstrip(".") + "."


def tolerance_sentences(finding: Finding) -> list[str]:
    """Say what robot.yaml's tolerances are too wide to show, and what they took in this run."""
    from sensorgraph.diagnosis.report.tolerated import tolerated

    found = tolerated(finding)
    if not found:
        return []
    passed = [
        f"{one.most.effect.title} up to {largest(one.most)}"
        + (f" (here {largest(one.taken)})" if one.taken is not None else "")
        for one in found
    ]
    keys = ", ".join(one.tolerance for one in found)
    return [f"The tolerances in robot.yaml are wide ({keys}): without a name pass {'; '.join(passed)}."]


def largest(a: Amendment) -> str:
    """Return the size of an effect, several sizes taken together, without a sign."""
    name = next(iter(a.effect.sizes))
    size = math.hypot(*(a.parameters.get(key, 0.0) for key in a.effect.sizes))
    return quantity(a.effect(**{name: size}), name).lstrip("+")


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


def deviation(where: Deviation) -> str:
    """Say one deviation in words."""
    text = where.sentence().replace(" and half of the run ", " ").replace("at hit place around", "around")
    text = re.sub(r"-?\d\.\d+e-\d+", "0", text)  # what rounding leaves of an edge at zero
    return minus(text.replace(" at omega ", " at turn rate "))


def _at(where: Deviation | None) -> str:
    if where is None:
        return "is left"
    part = where.partition.removesuffix(" and half of the run")
    words = {"hit place": "", "robot place": "where the robot is"}
    return f"{words.get(part, 'at ' + part)} {where.label}".strip()


def main_channel(finding: Finding) -> str:
    """Return the channel that the headline is about: the first-named effect's, or that of the unknown."""
    if finding.effects or finding.undecided:
        return (*finding.effects, *finding.undecided)[0].effect.channel
    for name, result in finding.channels.items():
        if result.unknown is not None:
            return name
    return next(iter(finding.channels))


def gap_sentences(finding: Finding) -> list[str]:
    """Say how far the gap shrinks in every channel with a name; without one, how large it is."""
    named = [name for name, result in finding.channels.items() if result.effects]
    out = []
    for name in named or [main_channel(finding)]:
        result = finding.channels[name]
        text = gap_sentence(result.gap, channel=name, n_effects=len(result.effects))
        out.append(f"{name.capitalize()}: {text[0].lower()}{text[1:]}" if text and len(named) > 1 else text)
    return [text for text in out if text]


def gap_sentence(gap: Gap | None, *, channel: str = "scan", n_effects: int = 1) -> str:
    """Say how far the gap shrinks, over what noise alone leaves."""
    if gap is None or gap.noise_floor.normalised <= 0:
        return ""
    before, after, floor = (f.normalised for f in (gap.before, gap.after, gap.noise_floor))
    unit, factor = ("cm", 100.0) if channel == "scan" else ("cm/s", 100.0)
    if not n_effects:
        return (
            f"The gap is {after / floor:.2f} times the noise floor "
            f"({factor * gap.after.rmse_m:.2f} {unit} over {factor * gap.noise_floor.rmse_m:.2f} {unit})."
        )
    it = "it" if n_effects == 1 else "them"
    gained = minus(f"{gap.before.nats_per_ray - gap.after.nats_per_ray:.3g} nats")
    if after > 0.97 * before:
        return (
            f"With {it} in the model every reading is better explained, by {gained} on average over {gap.n_rays:,} "
            "readings that no fit has seen; the RMS gap, which it hardly changes, is "
            f"{after / floor:.2f} times the noise floor."
        )
    return (
        f"With {it} in the model the gap shrinks from {before / floor:.2f} to {after / floor:.2f} times the noise floor "
        f"({factor * gap.before.rmse_m:.2f} to {factor * gap.after.rmse_m:.2f} {unit}, and {gained} per reading), "
        "on readings that no fit has seen."
    )
