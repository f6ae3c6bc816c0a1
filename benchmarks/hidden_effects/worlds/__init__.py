"""The worlds: each has physics of its own, and shares nothing with another but the form of a case."""

from __future__ import annotations

WORLDS = {
    "own": "benchmarks.hidden_effects.worlds.own.cases",
    "blind": "benchmarks.hidden_effects.worlds.blind.cases",
    "floors": "benchmarks.hidden_effects.worlds.floors.cases",
    "pixels": "benchmarks.hidden_effects.worlds.floors.pixels",
    "mujoco": "benchmarks.hidden_effects.worlds.simulators.mujoco",
    "irsim": "benchmarks.hidden_effects.worlds.simulators.irsim",
}
"""Name -> a module with SUITES and make(spec) -> Case; the simulators need `mujoco` and `ir-sim`."""
