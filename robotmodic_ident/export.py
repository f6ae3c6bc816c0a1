"""Export a model as C, LaTeX or JSON text, and restore it from JSON."""

from __future__ import annotations

import json
import math
import re

from robotmodic_ident.analysis.algebra import polynomial_part
from robotmodic_ident.errors import IdentError
from robotmodic_ident.model import Narmax
from robotmodic_ident.notation.printing import max_cancellation, significant_digits
from robotmodic_ident.scale import Scale
from robotmodic_ident.terms import Factor, Term

MAX_CANCELLATION_IN_C = 1e3
"""Maximum ratio of cancelling terms to the result in the C code; 13 digits remain."""
GREEK = ("alpha", "beta", "gamma", "omega", "phi", "psi", "theta", "sigma")


def to_json(model: Narmax) -> str:
    """Return the model as JSON text."""
    return json.dumps(model.to_dict(), indent=1) + "\n"


def from_json(text: str) -> Narmax:
    """Restore a model from the text of `to_json`."""
    try:
        return Narmax.from_dict(json.loads(text))
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as exc:
        if isinstance(exc, IdentError):
            raise
        raise IdentError(f"not a model: {exc}; expected the text of to_json") from exc


def to_c(model: Narmax, *, name: str | None = None) -> str:
    """Return C99 source of one step, `double NAME(const double s[])`; a comment lists the signals s.

    Past outputs are ordinary signals. With measured past outputs, the function predicts one step ahead; with its own
    results, it runs freely. Noise terms are omitted, as their expectation is 0. Variables far from 0 stay centred.
    """
    _check_signed(model)
    plain = polynomial_part(model.readable(MAX_CANCELLATION_IN_C))
    function = name or f"{model.output}_step"
    if not re.fullmatch(r"[A-Za-z_]\w*", function):
        raise ValueError(
            f"{function!r} is not a valid C function name; expected letters, digits and underscores"
        )
    place = {signal: i for i, signal in enumerate(plain.terms.signals)}
    lines = [
        f"    y += {float(c)!r}{_c_factors(t, place, plain.scale)};"
        for t, c in zip(plain.terms, plain.theta, strict=True)
    ]
    uses_math = any(f.function for term in plain.terms for f in term)
    return "\n".join(
        [
            f"/* {plain.equation()}",
            *(f" *   s[{i}] = {signal}" for signal, i in place.items()),
            " */",
            *(["#include <math.h>", ""] if uses_math else [""]),
            f"#define {function.upper()}_SIGNALS {len(place)}",
            "",
            f"double {function}(const double s[])",
            "{",
            "    double y = 0.0;",
            *([] if place else ["    (void)s;"]),
            *lines,
            *(f"    if (y < {low!r}) y = {low!r};" for low in model.limits[:1] if math.isfinite(low)),
            *(f"    if (y > {high!r}) y = {high!r};" for high in model.limits[1:] if math.isfinite(high)),
            "    return y;",
            "}",
            "",
        ]
    )


def _check_signed(model: Narmax) -> None:
    if model.is_magnitude:
        raise IdentError(
            f"the terms describe the signed {model.output}, but only its magnitude is measured; export "
            "replace(model, is_magnitude=False), and take the magnitude of its result"
        )


def _c_factors(term: Term, place: dict[str, int], scale: Scale) -> str:
    text = ""
    for f in term:
        value = f"s[{place[f.signal]}]"
        if f.function:
            inner = value if f.harmonic == 1 else f"{float(f.harmonic)!r} * {value}"
            value = f"{f.function}({inner})"
        elif centre := scale.pair(f.variable)[0]:
            value = f"({value} - {centre!r})" if centre > 0 else f"({value} + {-centre!r})"
        text += f" * {value}" * f.power
    return text


def to_latex(model: Narmax, *, digits: int = 4, per_line: int = 3) -> str:
    r"""Return the equation as LaTeX, in an `aligned` block if it needs more than one line."""
    _check_signed(model)
    plain = polynomial_part(model.readable(max_cancellation(digits)))
    left = _latex_name(model.output) + ("(k)" if model.is_dynamic else "")
    low, high = model.limits
    parts = []
    theta = plain.theta.tolist()
    needed = significant_digits(plain.terms, theta, digits, plain.spans)
    for term, c, n_digits in zip(plain.terms, theta, needed, strict=True):
        size = _latex_number(abs(c), n_digits)
        factors = r"\,".join(_latex_factor(f, plain.scale) for f in term)
        body = size if not factors else (factors if size == "1" else rf"{size}\,{factors}")
        parts.append(("- " if c < 0 else "+ ") + body)
    if not parts:
        return f"{left} = 0"
    if parts[0].startswith("+ "):
        parts[0] = parts[0][2:]
    rows = [" ".join(parts[i : i + per_line]) for i in range(0, len(parts), per_line)]
    if math.isfinite(high):
        rows[0], rows[-1] = rf"\min({high:.15g}, {rows[0]}", f"{rows[-1]})"
    if math.isfinite(low):
        rows[0], rows[-1] = rf"\max({low:.15g}, {rows[0]}", f"{rows[-1]})"
    if len(rows) == 1:
        return f"{left} = {rows[0]}"
    body = " \\\\\n  &\\quad ".join(rows)
    return f"\\begin{{aligned}}\n{left} &= {body}\n\\end{{aligned}}"


def _latex_number(value: float, digits: int) -> str:
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    return rf"{mantissa} \cdot 10^{{{int(exponent)}}}" if exponent else mantissa


def _latex_name(variable: str) -> str:
    head, _, tail = variable.partition("_")
    head = f"\\{head}" if head in GREEK else (head if len(head) == 1 else rf"\mathrm{{{head}}}")
    return head + (rf"_{{\mathrm{{{tail.replace('_', ',')}}}}}" if tail else "")


def _latex_factor(f: Factor, scale: Scale) -> str:
    lag = "" if f.lag is None else ("(k)" if f.lag == 0 else f"(k-{f.lag})")
    text = _latex_name(f.variable) + lag
    if f.function:
        text = rf"\{f.function}\left({'' if f.harmonic == 1 else f.harmonic}{text}\right)"
    elif centre := scale.pair(f.variable)[0]:
        text = rf"\left({text} {'+' if centre < 0 else '-'} {abs(centre):.15g}\right)"
        return text if f.power == 1 else f"{text}^{{{f.power}}}"
    if f.power == 1:
        return text
    return rf"{text}^{{{f.power}}}" if not lag and not f.function else rf"\left[{text}\right]^{{{f.power}}}"
