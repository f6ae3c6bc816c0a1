"""Names from before 0.1.0 that were documented keep working for one release, with a warning."""

from __future__ import annotations

import subprocess
import sys

import pytest

import robotmodic_ident
from robotmodic_ident import analysis


def test_old_modules_are_found_with_a_warning_and_leave_the_functions_callable() -> None:
    code = (
        "import warnings; warnings.simplefilter('error', ResourceWarning)\n"
        "with warnings.catch_warnings(record=True) as said:\n"
        "    warnings.simplefilter('always')\n"
        "    from sensorgraph.build import build\n"
        "    from sensorgraph.evaluate import evaluate\n"
        "import sensorgraph as sg\n"
        "from sensorgraph.building.build import build as new\n"
        "print(sum(w.category is DeprecationWarning for w in said), build is new, callable(sg.build), evaluate.__name__)"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.split() == ["2", "True", "True", "evaluate"]


@pytest.mark.parametrize(
    ("module", "old", "new"),
    [
        *((robotmodic_ident, old, new) for old, new in robotmodic_ident._RENAMED.items()),
        *((analysis, old, new) for old, new in analysis._RENAMED.items()),
    ],
)
def test_old_names_of_identification_are_the_new_ones(module: object, old: str, new: str) -> None:
    with pytest.warns(DeprecationWarning, match=f"{old} is now {new}"):
        assert getattr(module, old) is getattr(module, new)
