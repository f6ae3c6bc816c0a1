"""The world of floors with maps of pixels: a map_server map with cells of 5 cm instead of polygons."""

from __future__ import annotations

from dataclasses import replace

from benchmarks.hidden_effects.case import Case, Spec
from benchmarks.hidden_effects.worlds.floors import cases
from benchmarks.hidden_effects.worlds.floors.rooms import raster

SUITES = cases.SUITES


def make(spec: Spec) -> Case:
    """Make a case of the world of floors, and draw its map in pixels."""
    case = cases.make(spec)
    return replace(case, map=raster(case.facts["scene"].plan))
