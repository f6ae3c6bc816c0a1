"""A misspelt option of a public function is refused with the option that was probably meant."""

from __future__ import annotations

import inspect
import re

import pytest

import sensorgraph as sg
from sensorgraph.building.build import option_types
from sensorgraph.errors import SensorgraphError, suggestion
from sensorgraph.models import MODELS

FUNCTIONS = [
    name
    for name in sg.__all__
    if inspect.isfunction(getattr(sg, name)) and name not in ("load", "load_arena", "load_robot")
]


def keywords(name: str) -> list[str]:
    """Return the keyword-only options of a public function."""
    parameters = inspect.signature(getattr(sg, name)).parameters.values()
    return [one.name for one in parameters if one.kind is one.KEYWORD_ONLY]


def test_misspelt_model_is_named() -> None:
    with pytest.raises(SensorgraphError, match=r"^unknown option `modl`; did you mean `model`\?$"):
        sg.build("absent.mcap", modl="faces")  # refused before the log is opened


@pytest.mark.parametrize("name", FUNCTIONS)
def test_misspelt_option_of_every_function_is_named(name: str) -> None:
    function, options = getattr(sg, name), keywords(name)
    assert options
    for option in options:
        if len(option) > 3:  # a shorter word, without a letter, is as near to others
            misspelt = option[:2] + option[3:]
            wanted = re.escape(f"unknown option `{misspelt}`; did you mean `{option}`?")
            with pytest.raises(SensorgraphError, match=wanted):
                function(**{misspelt: None})


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS.keys())
def test_options_of_models_are_known(model: type) -> None:
    assert set(model.OPTIONS) <= set(option_types())


def test_misspelt_option_of_a_model_or_a_specification_is_named() -> None:
    with pytest.raises(SensorgraphError, match=r"`degre`; did you mean `degree`\?"):
        sg.identify("absent.csv", output="y", degre=3)
    with pytest.raises(SensorgraphError, match=r"`harmonic`; did you mean `harmonics`\?"):
        sg.build("absent.mcap", harmonic=3)


@pytest.mark.parametrize(
    ("name", "known", "said"),
    [
        ("modle", ["model", "poses"], "did you mean `model`?"),
        ("V", ["v", "w"], "did you mean `v`?"),
        ("colour", ["poses"], "expected `poses`"),
        ("colour", [], "none is expected"),
    ],
)
def test_only_a_similar_name_is_suggested(name: str, known: list[str], said: str) -> None:
    assert suggestion(name, known) == said


def test_missing_argument_stays_a_type_error() -> None:
    with pytest.raises(TypeError, match="missing"):
        sg.record()  # type: ignore[call-arg]
