"""Ray terms of a laser: reading = rho + c_j0 + c_j1 rho + S(v, q).

The equation holds for ray j at the true range rho. The variable v = 1 - |n·u| increases with the incidence, and
q = min(rho, R) / R with the range up to R = 4 m. S is a polynomial
in v and q that all rays share. `matching` inverts the equation to obtain corrected ranges.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from planners.kernel import inner_kernel, outer_kernel
from sensorgraph.types import Floats

INCIDENCE_POWERS = ((1, 0), (2, 0), (3, 0), (1, 1), (2, 1), (1, 2), (2, 2))
"""Exponents of v and q in the terms of S."""
N_INCIDENCE = len(INCIDENCE_POWERS)
MAX_OPTIC_RANGE = 4.0
"""[m] range R beyond which S is independent of the range."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RayTerms:
    """Coefficients of the ray terms of all rays."""

    constant: Floats
    """(n_rays,) [m] c_j0."""
    slope: Floats
    """(n_rays,) [m/m] c_j1."""
    incidence: Floats
    """(N_INCIDENCE,) [m] coefficients of S, in the order of `INCIDENCE_POWERS`."""

    @classmethod
    def none(cls, n_rays: int) -> Self:
        """Return terms that leave readings unchanged."""
        return cls(constant=np.zeros(n_rays), slope=np.zeros(n_rays), incidence=np.zeros(N_INCIDENCE))

    @property
    def is_none(self) -> bool:
        """Return whether readings are left unchanged."""
        return not (self.constant.any() or self.slope.any() or self.has_incidence)

    @property
    def has_incidence(self) -> bool:
        """Return whether the reading depends on the incidence."""
        return bool((self.incidence != 0).any())

    def equation(self, ray: int) -> str:
        """Return the text of what is added to the range rho of one ray; empty without terms."""
        parts = [(self.constant[ray], ""), (self.slope[ray], "rho")]
        parts += [(s, _power_text(a, b)) for s, (a, b) in zip(self.incidence, INCIDENCE_POWERS, strict=True)]
        text = ""
        for value, name in parts:
            if value != 0:
                text += f" {'-' if value < 0 else '+'} {abs(value):.5f}{' ' + name if name else ''}"
        return text


def _power_text(a: int, b: int) -> str:
    """Return v^a q^b as text."""
    powers = [("v", a), ("q", b)]
    return " ".join(f"{x}^{p}" if p > 1 else x for x, p in powers if p > 0)


@inner_kernel
def incidence_terms(v: Any, q: Any, out: Any) -> Any:
    """Fill the terms of S in the order of `INCIDENCE_POWERS`; v and q are scalars, or arrays (n,) with `out` (7, n)."""
    out[0] = v
    out[1] = v * v
    out[2] = v * v * v
    out[3] = v * q
    out[4] = v * v * q
    out[5] = v * q * q
    out[6] = v * v * q * q


@outer_kernel
def incidence_bias(den: Any, rho: Any, s: Any) -> Any:
    """Return S [m] for den = n·u at range rho."""
    v = 1.0 - abs(den)
    q = min(rho, MAX_OPTIC_RANGE) / MAX_OPTIC_RANGE
    return v * (s[0] + q * (s[3] + q * s[5]) + v * (s[1] + q * (s[4] + q * s[6]) + v * s[2]))
