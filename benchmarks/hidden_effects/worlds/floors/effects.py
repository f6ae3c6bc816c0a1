"""The effects of this world: the 35 of the library, and 43 that no library has a name for."""

from __future__ import annotations

import inspect

from benchmarks.hidden_effects.worlds.floors import (
    foreign_laser,
    foreign_motion,
    foreign_places,
    library_laser,
    library_motion,
)
from benchmarks.hidden_effects.worlds.floors.effect import Effect

FOREIGN = (
    "g_halfmirror", "g_mast", "g_wrap", "g_chairs", "g_posters", "g_restart", "g_interp", "g_median", "g_endstamp",
    "g_reversed", "g_radiators", "g_plaster", "g_disparity", "g_square", "g_facets", "g_packetshift", "g_nearbias",
    "g_cart", "g_overhang", "g_pipes", "g_average", "g_blanking", "g_pitch", "g_tyre", "g_payload", "g_joints",
    "g_scrub", "g_turnasym", "g_crab", "g_gaps", "g_ntp", "g_yawsteps", "g_extrapolate", "g_lever", "g_markerswap",
    "g_stale", "g_setsteps", "g_resonance", "g_lagasym", "g_bursts", "g_powershare", "g_slope", "g_windup",
)  # fmt: skip
"""In this order, which the turns of the suite are drawn from."""
MODULES = (library_laser, library_motion, foreign_laser, foreign_places, foreign_motion)
"""Where they are; each class is in `effect.EFFECTS` once its module is imported."""


def note_of(effect: Effect) -> str:
    """Return what an effect outside the library is, and which effects of the library it comes near to."""
    if effect.name not in FOREIGN:
        return ""
    doc = " ".join((inspect.getdoc(effect) or "").split())
    return doc[0].lower() + doc[1:-1]
