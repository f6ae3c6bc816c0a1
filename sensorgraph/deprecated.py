"""Module names from before 0.1.0 that were documented: they work, with a warning, until 0.2.

A module `sensorgraph.build` would stand before the function `sensorgraph.build`; the old modules are therefore callable
and pass the call on.
"""

from __future__ import annotations

import sys
import warnings
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

RENAMED = {
    "sensorgraph.build": "sensorgraph.building.build",
    "sensorgraph.evaluate": "sensorgraph.evaluation.evaluate",
}
"""Old module -> where its function of the same name lives."""


class OldModule(ModuleType):
    """A module under its old name, which passes every access on to its new home."""

    def __getattr__(self, name: str) -> Any:
        return getattr(import_module(RENAMED[self.__name__]), name)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        package, _, name = self.__name__.rpartition(".")
        return getattr(import_module(f"{package}.api"), name)(*args, **kwargs)


class OldNames:
    """Finds the old modules; asked by Python only where no file of that name exists."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Return how to make an old module, None for any other name."""
        return ModuleSpec(name, OldNames()) if name in RENAMED else None  # type: ignore[arg-type]

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Make the module that passes on."""
        return OldModule(spec.name)

    def exec_module(self, module: ModuleType) -> None:
        """Warn, once for each old name."""
        warnings.warn(
            f"{module.__name__} is now {RENAMED[module.__name__]}, or simply `import sensorgraph`; the old name goes "
            "with 0.2",
            DeprecationWarning,
            stacklevel=2,
        )


def install() -> None:
    """Let Python find the old modules."""
    if not any(isinstance(finder, OldNames) for finder in sys.meta_path):
        sys.meta_path.append(OldNames())
