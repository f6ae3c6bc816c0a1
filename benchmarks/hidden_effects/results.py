"""Each case with its truth and its answer: what was hidden, what was reported, and whether the two agree."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

MAX_PLACE_ERROR = 0.3
"""[m] a spot counts as found."""
ANGLES = {"theta1", "theta2", "theta0"}
PLACE_PARAMETERS = {("wheel_slip", "x"), ("wheel_slip", "y"), ("wheel_slip", "r")}
"""Where an effect is, scored as a place and not as a parameter."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """One case: the truth and the answer."""

    label: str
    truth: dict[str, Any]
    report: dict[str, Any] | None
    cpu_s: float | None
    """[s] of the answer."""

    @property
    def suite(self) -> str:
        """Suite of the case."""
        return str(self.truth["suite"])

    @property
    def background(self) -> str:
        """Background of the case."""
        return str(self.truth["background"])

    @property
    def hidden(self) -> list[dict[str, Any]]:
        """Library effects in it."""
        return list(self.truth["effects"])

    @property
    def names(self) -> list[str]:
        """Names of the library effects in it."""
        return [effect["name"] for effect in self.hidden]

    @property
    def reported(self) -> list[dict[str, Any]]:
        """Effects that the report names, first first."""
        return list((self.report or {}).get("effects") or [])

    @property
    def reported_names(self) -> list[str]:
        """Their names, first first."""
        return [effect["name"] for effect in self.reported]

    @property
    def is_unknown(self) -> bool:
        """The answer says that something unknown is there."""
        return bool((self.report or {}).get("unknown"))

    @property
    def is_first_right(self) -> bool:
        """The first name reported is a true one."""
        return bool(self.reported_names) and self.reported_names[0] in self.names

    @property
    def is_first_wrong(self) -> bool:
        """Something is named, and the first name is not a true one."""
        return bool(self.reported_names) and not self.is_first_right

    @property
    def is_right(self) -> bool:
        """Exactly the hidden effects are named."""
        return sorted(self.names) == sorted(self.reported_names)

    @property
    def wrong_names(self) -> list[str]:
        """Names reported that are not there."""
        return [name for name in self.reported_names if name not in self.names]

    @property
    def is_material(self) -> bool:
        """All its effects are material and marked."""
        return bool(self.hidden) and all(effect["material"] for effect in self.hidden)

    @property
    def is_below_materiality(self) -> bool:
        """Its (single) effect has a size below the materiality."""
        ratio = self.hidden[0]["materiality_ratio"] if len(self.hidden) == 1 else None
        return ratio is not None and ratio < 1.0


def entrants(folders: Iterable[Path]) -> list[str]:
    """Return the names of all who have answered, the first first in the alphabet."""
    return sorted({path.name for folder in folders for path in folder.glob("answers/*")})


def load(folders: Iterable[Path], entrant: str) -> list[Case]:
    """Read truth and answers; cases that an entrant was never asked about are left out."""
    cases = []
    for folder in folders:
        for path in sorted(folder.glob("truth/*.json")):
            result = folder / "answers" / entrant / path.stem
            if not result.exists():
                continue
            report, run = result / "report.json", result / "run.json"
            cases.append(
                Case(
                    label=f"{folder.name}/{path.stem}",
                    truth=json.loads(path.read_text()),
                    report=json.loads(report.read_text()) if report.exists() else None,
                    cpu_s=json.loads(run.read_text()).get("cpu_s") if run.exists() else None,
                )
            )
    return cases


def found_effects(cases: Sequence[Case]) -> Iterable[tuple[Case, dict[str, Any], dict[str, Any]]]:
    """Yield (case, true effect, the one said) for every material effect that was named."""
    for case in cases:
        for true in case.hidden:
            same = [said for said in case.reported if said["name"] == true["name"]]
            if same and true["material"]:
                yield case, true, same[0]


def is_placed(true: dict[str, Any], said: dict[str, Any]) -> bool:
    """Tell whether the place said is the wall, the obstacle or within MAX_PLACE_ERROR of the spot."""
    place, reported = true["location"], said.get("location") or {}
    if place["name"] and reported.get("name") == place["name"]:
        return True
    if place["xy"] is None or reported.get("xy") is None:
        return False
    return math.dist(place["xy"], reported["xy"]) <= MAX_PLACE_ERROR


def parameters_within(true: dict[str, Any], said: dict[str, Any]) -> Iterable[tuple[str, bool]]:
    """Yield (parameter, true value within two standard errors) for those that both know."""
    values, errors = said.get("parameters") or {}, said.get("stderr") or {}
    for key, value in true["parameters"].items():
        reported, error = values.get(key), errors.get(key)
        if (true["name"], key) in PLACE_PARAMETERS or value is None or reported is None or error is None:
            continue
        off = reported - value
        if key in ANGLES:
            off = math.remainder(off, 2 * math.pi)
        if not (math.isfinite(error) and math.isfinite(off)):
            yield key, False
        else:
            yield key, abs(off) <= 2 * error + 1e-9
