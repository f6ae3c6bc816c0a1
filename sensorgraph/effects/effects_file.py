"""Read and write effects.yaml, the amendments of a model, which `diagnose` writes and other commands read."""

from __future__ import annotations

import difflib
import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from logs.errors import MAX_LISTED
from logs.files import atomic_file
from planners.arena import Arena
from planners.yaml_text import parse_yaml
from sensorgraph.effects import EFFECTS, Amendment, Effect, Location
from sensorgraph.effects.places import named_walls
from sensorgraph.errors import SensorgraphError, refuse_unknown, suggestion
from sensorgraph.quantities import ANGLE, LENGTH, NO_UNIT, SPEED, TIME, Dimension, quantity

logger = logging.getLogger(__name__)

KEYS = ("name", "parameters", "stderr", "location", "probability", "evidence")
OPTIONAL = {"map_scale": ("dx", "dy"), "range_drift": ("tau",)}
"""Effect -> optional parameters, which are neutral if left out."""
DIMENSIONS = {"": NO_UNIT, "m/m": NO_UNIT, "m": LENGTH, "rad": ANGLE, "s": TIME, "m/s": SPEED}
"""Unit of a parameter -> its dimension, whose other units a file may use."""


def write(amendments: Iterable[Amendment], path: Path) -> None:
    """Write effects.yaml; after an error there is no partial file."""
    with atomic_file(path) as part:
        part.write_text(dumps(amendments), encoding="utf-8")


def dumps(amendments: Iterable[Amendment]) -> str:
    """Return the text of effects.yaml."""
    entries = [to_dict(a) for a in amendments]
    return yaml.safe_dump(entries, sort_keys=False, allow_unicode=True, default_flow_style=None, width=110)


def to_dict(a: Amendment) -> dict[str, Any]:
    """Return an amendment as plain data without empty entries."""
    out: dict[str, Any] = {"name": a.name, "parameters": {k: float(v) for k, v in a.parameters.items()}}
    if a.stderr:
        out["stderr"] = {k: float(v) for k, v in a.stderr.items()}
    if a.location is not None:
        out["location"] = {"name": a.location.name} if a.location.name else {}
        if a.location.xy is not None:
            out["location"]["xy"] = [float(v) for v in a.location.xy]
    for key in ("probability", "evidence"):
        if getattr(a, key) is not None:
            out[key] = float(getattr(a, key))
    return out


def read(path: Path, arena: Arena | None = None) -> tuple[Amendment, ...]:
    """Read effects.yaml, and check its places if an arena is given.

    Raises
    ------
    SensorgraphError : The file is not a text file, or not a list of known effects with valid numbers and places.
    """
    if path.is_dir():
        raise SensorgraphError(f"{path} is a directory, expected an effects.yaml")
    if not path.exists():
        raise SensorgraphError(f"{path} does not exist; give an effects.yaml, as `diagnose` writes it")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as exc:
        raise SensorgraphError(f"{path} is not a text file; expected an effects.yaml") from exc
    amendments = loads(text, arena, name=str(path))
    if not amendments:
        logger.warning("%s contains no effect; the model is unchanged", path)
    return amendments


def loads(text: str, arena: Arena | None = None, *, name: str = "effects.yaml") -> tuple[Amendment, ...]:
    """Parse the text of effects.yaml.

    Raises
    ------
    SensorgraphError : The text is not YAML, or not a list of known effects with valid numbers and places.
    """
    try:
        data = parse_yaml(text)
    except ValueError as exc:
        raise SensorgraphError(f"{name}: not YAML: {' '.join(str(exc).split())}") from exc
    data = [] if data is None else data
    if not isinstance(data, list):
        kind = "mapping" if isinstance(data, dict) else type(data).__name__
        raise SensorgraphError(f"{name}: contains a {kind}, expected a list of effects, `- name: ...`")
    return tuple(_amendment(entry, f"{name}: effect {i}", arena) for i, entry in enumerate(data, start=1))


def check_places(amendments: Sequence[Amendment], arena: Arena, *, name: str = "effects") -> None:
    """Check that the arena has the walls, the obstacles and the parts of walls of amendments.

    Raises
    ------
    SensorgraphError : The arena lacks a place, or a part is beyond the end of its wall.
    """
    for i, a in enumerate(amendments, start=1):
        where = f"{name}: effect {i} ({a.name})"
        _check_place(a.effect, a.location, arena, where)
        _check_part(a.effect, a.parameters, a.place, arena, where)


def _amendment(entry: Any, where: str, arena: Arena | None) -> Amendment:
    if not isinstance(entry, dict) or not isinstance(entry.get("name"), str):
        raise SensorgraphError(f"{where} is {entry!r}, expected keys {', '.join(KEYS)}; name is required")
    refuse_unknown(entry, KEYS, "key", where=where)
    refuse_unknown([entry["name"]], EFFECTS, "effect", where=where)
    effect = EFFECTS[entry["name"]]
    where = f"{where} ({effect.name})"
    known = {p.name: DIMENSIONS[p.unit] for p in effect.parameters}
    parameters = _numbers(entry.get("parameters"), known, where, "parameter")
    for p in effect.parameters:
        if p.name not in parameters:
            if p.name in OPTIONAL.get(effect.name, ()):
                continue
            raise SensorgraphError(
                f"{where}: parameter `{p.name}` is missing ({_unit(p.unit)}, {p.doc}); add it"
            )
        if not p.low <= parameters[p.name] <= p.high:
            raise SensorgraphError(
                f"{where}: parameter `{p.name}` is {parameters[p.name]:g}, expected {p.low:g} to {p.high:g}"
            )
    location = _location(entry.get("location"), where)
    _check_place(effect, location, arena, where)
    _check_part(effect, parameters, location.name if location is not None else "", arena, where)
    return Amendment(
        effect=effect,
        parameters=parameters,
        stderr=_numbers(entry.get("stderr"), known, where, "stderr", is_finite=False),
        location=location,
        probability=_optional(entry, "probability", where),
        evidence=_optional(entry, "evidence", where),
    )


def _location(data: Any, where: str) -> Location | None:
    if data is None:
        return None
    if not isinstance(data, dict):
        raise SensorgraphError(f"{where}: location is {data!r}, expected keys name, xy")
    refuse_unknown(data, ("name", "xy"), "key of location", where=where)
    name, xy = data.get("name") or "", data.get("xy")
    if not isinstance(name, str):
        raise SensorgraphError(
            f"{where}: location.name is {name!r}, expected the name of a wall or an obstacle"
        )
    if xy is None:
        return Location(name=name)
    if not isinstance(xy, list) or len(xy) != 2:
        raise SensorgraphError(f"{where}: location.xy is {xy!r}, expected [x, y] in m")
    x, y = (_number(value, f"{where}: location.xy", LENGTH) for value in xy)
    return Location(name=name, xy=(x, y))


def _check_place(effect: Effect, location: Location | None, arena: Arena | None, where: str) -> None:
    """Refuse a wall or obstacle that is not given, or that the arena lacks."""
    if effect.place not in ("wall", "obstacle"):
        return
    name = "" if location is None else location.name
    like = "`NAME/edge_0`" if effect.place == "wall" else "a feature's name"
    if not name:
        raise SensorgraphError(
            f"{where}: the name of its {effect.place} is missing; add location: {{name: ...}}, {like}"
        )
    if arena is None:
        return
    obstacles = list(dict.fromkeys(wall.rsplit("/", 1)[0] for wall in arena.names))
    known = list(arena.names) if effect.place == "wall" else obstacles
    if name not in known:
        raise SensorgraphError(
            f"{where}: the arena has no {effect.place} `{name}`; {_places_like(name, known)}"
        )
    named_walls(arena, name)


def _check_part(
    effect: Effect, values: Mapping[str, float], wall: str, arena: Arena | None, where: str
) -> None:
    """Refuse a part of a wall with a >= b, or outside the wall."""
    if effect.place != "wall" or not {"a", "b"} <= set(values):
        return
    a, b = values["a"], values["b"]
    if a >= b:
        raise SensorgraphError(
            f"{where}: the part is from a = {a:g} m to b = {b:g} m; expected a < b, both along "
            "the wall from its first corner"
        )
    if arena is None:
        return
    length = float(np.hypot(*np.diff(arena.walls[arena.names.index(wall)], axis=0)[0]))
    if a >= length or b <= 0:
        raise SensorgraphError(
            f"{where}: the part from a = {a:g} m to b = {b:g} m is outside `{wall}`, which is {length:.2f} m "
            "long; expected a and b along the wall from its first corner"
        )


def _numbers(
    data: Any, known: Mapping[str, Dimension], where: str, what: str, *, is_finite: bool = True
) -> dict[str, float]:
    data = {} if data is None else data
    if not isinstance(data, dict):
        raise SensorgraphError(
            f"{where}: {what} is {data!r}, expected NAME: NUMBER for {', '.join(known) or 'none'}"
        )
    refuse_unknown(data, known, what, where=where)
    return {
        key: _number(value, f"{where}: {what} `{key}`", known[key], is_finite=is_finite)
        for key, value in data.items()
    }


def _optional(entry: Mapping[str, Any], key: str, where: str) -> float | None:
    value = entry.get(key)
    return None if value is None else _number(value, f"{where}: {key}", is_finite=False)


def _number(value: Any, where: str, dimension: Dimension = NO_UNIT, *, is_finite: bool = True) -> float:
    """Return a number in the SI unit of its dimension; without `is_finite`, of any size, as a standard error is."""
    if not is_finite and isinstance(value, float) and math.isinf(value):
        return value
    return quantity(value, where, dimension, most=None if is_finite else math.inf)


def _places_like(name: str, known: Sequence[str]) -> str:
    """Suggest places: the edges of the given feature, a similar name, or the first places of the arena."""
    feature = name.rsplit("/", 1)[0]
    own = [wall for wall in known if wall.startswith(f"{feature}/")]
    if own:
        return f"{feature} has `{own[0]}`" + (f" to `{own[-1]}`" if len(own) > 1 else "")
    if difflib.get_close_matches(name, known, n=1):
        return suggestion(name, known)
    more = ", ..." if len(known) > MAX_LISTED else ""
    return f"it has {', '.join(f'`{one}`' for one in known[:MAX_LISTED]) or 'none'}{more}"


def _unit(unit: str) -> str:
    return unit or "no unit"
