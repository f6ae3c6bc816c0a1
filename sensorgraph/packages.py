"""Check that `logs`, `planners` and `robotmodic_ident` are the packages that come with sensorgraph.

Two of the names are common: a folder `logs/` or a file `planners.py` of the user's project can precede them on the
search path. The failure would otherwise be an AttributeError far from its cause.
"""

from __future__ import annotations

import os.path  # not pathlib, so that `import sensorgraph` stays fast
import sys
from importlib.util import find_spec

COMPANIONS = ("logs", "planners", "robotmodic_ident")
"""Top-level packages that are installed next to `sensorgraph`."""


def check_packages() -> None:
    """Check the locations of the companion packages without importing them.

    Raises
    ------
    ImportError : Python finds no package or another package with one of the names.
    """
    home = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
    for name in COMPANIONS:
        found = _location(name)
        if found is None:
            raise ImportError(
                f"sensorgraph needs its package `{name}`, which is missing in {home}; "
                "install sensorgraph again",
                name=name,
            )
        if os.path.dirname(found) != home:
            raise ImportError(
                f"Python finds another package `{name}` in {found}, but sensorgraph needs the package in {home}; "
                f"rename yours, or remove {os.path.dirname(found)} from the search path "
                "(PYTHONPATH, the current folder)",
                name=name,
                path=found,
            )


def _location(name: str) -> str | None:
    """Return the folder (or file) of a top-level package; None if it does not exist."""
    if name in sys.modules:
        origin = getattr(sys.modules[name], "__file__", None)
        places = list(getattr(sys.modules[name], "__path__", ()))
    else:
        spec = find_spec(name)
        origin = spec.origin if spec is not None else None
        places = list(spec.submodule_search_locations or ()) if spec is not None else []
    place = places[0] if places else origin
    return os.path.realpath(place) if place else None
