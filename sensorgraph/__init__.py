"""Sensorgraph: transparent equations of what a range sensor perceives at every (x, y, phi) of an arena.

The whole loop in Python, with objects or the paths of their files:

    import sensorgraph as sg

    plan = sg.plan("square")
    run = sg.record(plan)
    graph = sg.build(run)
    print(sg.evaluate(graph, sg.read("other.mcap")))

Nothing heavy is imported until a name is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from sensorgraph.packages import check_packages
from sensorgraph.version import __version__ as __version__

if TYPE_CHECKING:
    from planners.arena import Arena
    from sensorgraph import errors
    from sensorgraph.amending.amend import amend
    from sensorgraph.api import (
        build,
        diagnose,
        evaluate,
        export,
        identify,
        locate,
        plan,
        predict,
        read,
        record,
        review,
    )
    from sensorgraph.effects import EFFECTS
    from sensorgraph.graph import Sensorgraph, load
    from sensorgraph.identification.design import design
    from sensorgraph.identification.design_task import DesignTask
    from sensorgraph.loading import load_arena
    from sensorgraph.surveying.fleet import fleet
    from sensorgraph.watching.watch import watch
    from sensorgraph.world.robot import Robot, load_robot


__all__ = [
    "EFFECTS",
    "Arena",
    "DesignTask",
    "Robot",
    "Sensorgraph",
    "amend",
    "build",
    "design",
    "diagnose",
    "errors",
    "evaluate",
    "export",
    "fleet",
    "identify",
    "load",
    "load_arena",
    "load_robot",
    "locate",
    "plan",
    "predict",
    "read",
    "record",
    "review",
    "watch",
]

_MODULES = {
    "planners.arena": "Arena",
    "sensorgraph.amending.amend": "amend",
    "sensorgraph.api": "build diagnose evaluate export identify locate plan predict read record review",
    "sensorgraph.effects": "EFFECTS",
    "sensorgraph.graph": "Sensorgraph load",
    "sensorgraph.identification.design": "design",
    "sensorgraph.identification.design_task": "DesignTask",
    "sensorgraph.loading": "load_arena",
    "sensorgraph.surveying.fleet": "fleet",
    "sensorgraph.watching.watch": "watch",
    "sensorgraph.world.robot": "Robot load_robot",
}
"""Module -> its public names."""


check_packages()  # before anything else can fail on a package of the same name


def __getattr__(name: str) -> Any:
    """Import a public name from its module on first use."""
    if name == "errors":
        return import_module("sensorgraph.errors")
    module = next((module for module, names in _MODULES.items() if name in names.split()), None)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(module), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
