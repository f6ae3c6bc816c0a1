"""Format numbers for readers: parameters with errors in cm, degrees and ms, probabilities, places, deviations, gaps."""

from __future__ import annotations

import math
import re

from sensorgraph.diagnosis.result import Deviation, Gap
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import EFFECTS, Amendment, Parameter

SYMBOLS = {
    "delta": "δ", "tau": "τ", "gamma": "γ", "beta": "β", "theta0": "θ₀", "theta1": "θ₁", "theta2": "θ₂",
    "alpha_ret": "α_ret", "alpha_max": "α_max", "r0": "r₀", "b1": "b₁",
}  # fmt: skip
SCALES = {"rad": (180 / math.pi, "°"), "m/m": (1000.0, "mm per m"), "m/s": (1.0, "m/s")}
SIGNED = {"b", "b1", "s", "d", "dx", "dy", "delta", "tau", "T"}
"""Parameters that are printed with their sign, if they are sizes."""
UNCHANGED = 0.97
"""Ratio of the RMS gap after to before, above which the gap is described as nearly unchanged."""
QUIET_LASER = (
    " sensor.sigma in robot.yaml is about {factor:.1f} times the scatter of the laser; with the right value, smaller "
    "effects can be detected."
)


def symbol(name: str) -> str:
    """Return the symbol of a parameter in equations."""
    return SYMBOLS.get(name, name)


def scaled(parameter: Parameter, value: float) -> tuple[float, str]:
    """Return factor and unit for printing a value of this parameter."""
    size = abs(value)
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
    """Round to the digits that the standard error justifies; without one, to three digits."""
    if not math.isfinite(value):
        return str(value)
    known = error is not None and math.isfinite(error) and error > 0
    if known and error is not None:
        digits = -math.floor(math.log10(error)) + (1 if f"{error:.1e}"[0] in "12" else 0)
    else:
        digits = 2 if value == 0 else 2 - math.floor(math.log10(abs(value)))
    digits = min(max(digits, 0), 6)
    value = round(value, digits) + 0.0  # without the sign of a zero
    text = f"{value:{'+' if signed else ''}.{digits}f}"
    if known and error is not None:
        text += f" ± {error:.{digits}f}"
    return minus(text)


def minus(text: str) -> str:
    """Replace the hyphen before negative numbers by a minus sign."""
    return re.sub(r"(?<!\w)-(?=\d)", "−", text)


def quantity(a: Amendment, name: str) -> str:
    """Return one parameter of an effect with standard error and unit: `+0.41° ± 0.01°`."""
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
    """Return an effect with its sizes: `mounting yaw, +0.41° ± 0.01°`."""
    sizes = [name for name in a.parameters if name in a.effect.sizes] or list(a.parameters)
    plain = len(sizes) == 1 and "%" not in quantity(a, sizes[0])
    shown = [quantity(a, n) if plain else f"{symbol(n)} = {quantity(a, n)}" for n in sizes[:3]]
    place = f" at {place_text(a)}" if place_text(a) else ""
    return ", ".join([a.effect.title + place, *shown])


def largest(a: Amendment) -> str:
    """Return the norm of the sizes of an effect, without a sign."""
    name = next(iter(a.effect.sizes))
    size = math.hypot(*(a.parameters.get(key, 0.0) for key in a.effect.sizes))
    return quantity(a.effect(**{name: size}), name).lstrip("+")


def place_text(a: Amendment) -> str:
    """Return the place of an effect, empty if it has none."""
    if a.location is None:
        return ""
    name, xy = a.location.name, a.location.xy
    if xy is None:
        return name
    return minus(f"{name} about ({xy[0]:.1f}, {xy[1]:.1f}) m" if name else f"({xy[0]:.2f}, {xy[1]:.2f}) m")


def percent(p: float | None) -> str:
    """Return a probability as a percentage, never 0 or 100."""
    if p is None:
        return "–"
    if p > 0.995:
        return "> 99 %"
    return "< 1 %" if p < 0.01 else f"{100 * round(p, 6):.0f} %"


def title_of(name: str) -> str:
    """Return the readable title of an effect."""
    return EFFECTS[name].title if name in EFFECTS else name


def deviation_text(where: Deviation) -> str:
    """Describe a deviation in words."""
    text = where.sentence().replace("at hit place around", "around")
    text = re.sub(r"-?\d\.\d+e-\d+", "0", text)  # rounding error of a bin edge at zero
    return minus(text.replace(" at omega ", " at turn rate "))


def from_to(gap: Gap, unit: str) -> str:
    """Return a gap before and after in units of the noise floor, with an open bracket.

    Parameters
    ----------
    unit : cm of scans, cm/s of motion
    """
    before, after = (f.normalised / gap.noise_floor.normalised for f in (gap.before, gap.after))
    return (
        f"from {before:.2f} to {after:.2f} times the noise floor "
        f"({100 * gap.before.rmse_m:.2f} to {100 * gap.after.rmse_m:.2f} {unit}"
    )


def gap_sentence(
    gap: Gap | None, *, channel: str = "scan", n_effects: int = 1, is_widened: bool = False
) -> str:
    """Return the gap before and after, in units of the noise floor, which is no measure of a laser if it was widened."""
    if gap is None or gap.noise_floor.normalised <= 0:
        return ""
    before, after, floor = (f.normalised for f in (gap.before, gap.after, gap.noise_floor))
    unit = "cm" if channel == "scan" else "cm/s"
    if not n_effects:
        is_loud = channel == "scan" and not is_widened and after * SCAN.nuisance.stretched_scale < floor
        return (
            f"The gap is {after / floor:.2f} times the noise floor "
            f"({100 * gap.after.rmse_m:.2f} {unit} over {100 * gap.noise_floor.rmse_m:.2f} {unit})."
        ) + (QUIET_LASER.format(factor=floor / after) if is_loud else "")
    found = "the effect" if n_effects == 1 else "the effects"
    gained = minus(f"{gap.before.nats_per_ray - gap.after.nats_per_ray:.3g}")
    if after > UNCHANGED * before:
        return (
            f"With {found} in the model the log-likelihood rises by {gained} per reading, over {gap.n_rays:,} "
            "held-out readings; the RMS gap hardly changes and is "
            f"{after / floor:.2f} times the noise floor."
        )
    return (
        f"With {found} in the model the gap shrinks {from_to(gap, unit)}; the log-likelihood rises by {gained} per reading), "
        "on held-out readings."
    )
