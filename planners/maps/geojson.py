"""Arena <-> GeoJSON in metres, frame map: polygons of kind arena or obstacle, lines of kind wall.

The wall from vertex i to i+1 of feature NAME is `NAME/edge_i`; in its k-th hole it is `NAME/ring_k/edge_i`.
`surfaces` maps `"i"` or `"ring_k/i"` to a surface name. Two additions can store any Arena:

- An arena with `"walls": false` bounds the free space without being a wall. It may be a MultiPolygon.
- A LineString or MultiLineString of kind `wall` holds walls that bound no area. Its optional `names` name
  them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry import MultiPolygon, Polygon, mapping
from shapely.validation import explain_validity

from planners.arena import Arena
from planners.errors import PlanError
from planners.types import MAX_COORDINATE, Floats

KINDS = ("arena", "obstacle", "wall")
PROPERTIES = ("name", "kind", "surfaces", "walls", "names")
GEOMETRIES = {
    "arena": ("Polygon", "MultiPolygon"),
    "obstacle": ("Polygon", "MultiPolygon"),
    "wall": ("LineString", "MultiLineString"),
}
MIN_EXTENT = 0.05
"""[m] An arena smaller than this is assumed to be in degrees."""
_EDGE = re.compile(r"(?P<stem>.*)/edge_(?P<number>0|[1-9]\d*)")
_RING = re.compile(r"(?P<feature>.*)/ring_(?P<number>[1-9]\d*)")


@dataclass(frozen=True, kw_only=True)
class _Feature:
    """One checked feature: its area, if any, and its walls with their names and surfaces."""

    name: str
    kind: str
    area: Polygon | MultiPolygon | None
    segments: list[Floats]
    names: list[str]
    surfaces: list[str]


def read(path: Path) -> Arena:
    """Read an arena file.

    Raises
    ------
    PlanError : The file is invalid; the message states where.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as exc:
        raise PlanError(f"{path}: not text ({exc.reason} at byte {exc.start}); expected GeoJSON") from exc
    try:
        return loads(text)
    except PlanError as exc:
        raise PlanError(f"{path}: {exc}") from exc


def loads(text: str) -> Arena:
    """Parse the text of an arena file.

    Raises
    ------
    PlanError : The text is invalid; the message states where.
    """
    features = [_feature(item, index) for index, item in enumerate(_items(text))]
    arenas = [f for f in features if f.kind == "arena"]
    if len(arenas) != 1:
        raise PlanError(f"{len(arenas)} features of kind arena, expected exactly one")
    outline = arenas[0].area
    assert outline is not None
    x0, y0, x1, y1 = outline.bounds
    if max(x1 - x0, y1 - y0) < MIN_EXTENT:
        raise PlanError(
            f"the arena is {x1 - x0:.3g} by {y1 - y0:.3g}, which looks like degrees; expected metres"
        )
    obstacles = [f.area for f in features if f.kind == "obstacle"]
    free = outline.difference(shapely.union_all(obstacles)) if obstacles else outline
    if not isinstance(free, Polygon | MultiPolygon):
        raise PlanError(f"free space is a {free.geom_type}; expected an area")
    names = [name for f in features for name in f.names]
    _refuse_repeats("wall", names)
    segments = [segment for f in features for segment in f.segments]
    return Arena(
        free=free,
        walls=np.array(segments, dtype=np.float64).reshape(-1, 2, 2),
        names=tuple(names),
        surfaces=tuple(surface for f in features for surface in f.surfaces),
    )


def _items(text: str) -> list[Any]:
    try:
        data = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as exc:
        raise PlanError(f"not JSON: {exc}; expected a GeoJSON FeatureCollection") from exc
    if not isinstance(data, dict) or data.get("type") != "FeatureCollection":
        kind = data.get("type") if isinstance(data, dict) else type(data).__name__
        raise PlanError(f"top level is {kind!r}, expected a GeoJSON FeatureCollection")
    if re.search(r"4326|CRS84", json.dumps(data.get("crs")), re.IGNORECASE):
        raise PlanError("crs is longitude and latitude in degrees; expected metres in frame map")
    items = data.get("features")
    if not isinstance(items, list) or not items:
        raise PlanError("no features; expected one of kind arena and any number of obstacles")
    _refuse_repeats("feature", [_name(item) for item in items if _name(item)])
    return items


def _name(item: Any) -> str:
    properties = item.get("properties") if isinstance(item, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    return name if isinstance(name, str) else ""


def _refuse_repeats(what: str, names: list[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise PlanError(f"two {what}s are named {name!r}; give each its own name")
        seen.add(name)


def _feature(item: Any, index: int) -> _Feature:
    name = _name(item)
    if not name:
        raise PlanError(f"feature {index} has no name; expected properties name and kind")
    properties: dict[str, Any] = item["properties"]
    _refuse_misspelt(name, properties)
    kind = properties.get("kind")
    if kind not in KINDS:
        near = get_close_matches(str(kind), KINDS, n=1, cutoff=0.0)
        hint = f"did you mean {near[0]!r}? " if near and kind is not None else ""
        raise PlanError(f"feature {name!r} has kind {kind!r}; {hint}expected one of {', '.join(KINDS)}")
    geometry = item.get("geometry")
    shape = geometry.get("type") if isinstance(geometry, dict) else geometry
    if shape not in GEOMETRIES[kind]:
        raise PlanError(
            f"feature {name!r} of kind {kind} is a {shape}, expected {' or '.join(GEOMETRIES[kind])}"
        )
    walls = properties.get("walls", True)
    if not isinstance(walls, bool):
        raise PlanError(f"feature {name!r} has walls {walls!r}, expected true or false")
    if shape == "MultiPolygon" and walls:
        raise PlanError(f'feature {name!r} is a MultiPolygon; split it, or set "walls": false')
    parts = geometry.get("coordinates")
    if not isinstance(parts, list):
        raise PlanError(f"feature {name!r} has coordinates {parts!r:.40}, expected a list")
    if kind == "wall":
        chains = [_points(name, part) for part in (parts if shape == "MultiLineString" else [parts])]
        return _with_walls(name, kind, None, {name: chains}, properties)
    polygons = [_polygon(name, part) for part in (parts if shape == "MultiPolygon" else [parts])]
    area = polygons[0] if shape == "Polygon" else MultiPolygon(polygons)
    if not area.is_valid:
        raise PlanError(f"feature {name!r} is not a valid area: {explain_validity(area)}")
    rings: dict[str, list[Floats]] = {}
    if walls:
        rings[name] = [_points(name, parts[0])]
        rings |= {f"{name}/ring_{k}": [_points(name, ring)] for k, ring in enumerate(parts[1:], start=1)}
    return _with_walls(name, kind, area, rings, properties)


def _refuse_misspelt(name: str, properties: Mapping[str, Any]) -> None:
    for key in properties:
        near = get_close_matches(str(key), PROPERTIES, n=1, cutoff=0.75)
        if key not in PROPERTIES and near:
            raise PlanError(f"feature {name!r} has a property {key!r}; did you mean {near[0]!r}?")


def _points(name: str, part: Any) -> Floats:
    """Check one chain of vertices and return it, (n, 2) [m]."""
    try:
        points = np.array([[x, y] for x, y, *_ in part])
    except (TypeError, ValueError):
        points = np.zeros((0, 2), dtype=object)
    if points.dtype.kind not in "if" or len(points) < 2:
        raise PlanError(f"feature {name!r} has coordinates {part!r:.60}, expected a list of [x, y] in metres")
    if not np.isfinite(points).all():
        bad = int(np.argmin(np.isfinite(points).all(axis=1)))
        raise PlanError(f"feature {name!r}, vertex {bad} is {points[bad].tolist()}, expected finite numbers")
    if np.abs(points).max() > MAX_COORDINATE:
        raise PlanError(
            f"feature {name!r} reaches {np.abs(points).max():g} m, expected metres within {MAX_COORDINATE:g}"
        )
    repeated = np.flatnonzero((points[1:] == points[:-1]).all(axis=1))
    if len(repeated):
        raise PlanError(f"feature {name!r}, vertex {repeated[0] + 1} repeats the one before it; remove it")
    return points.astype(np.float64)


def _polygon(name: str, rings: Any) -> Polygon:
    if not isinstance(rings, list) or not rings:
        raise PlanError(
            f"feature {name!r} has no rings; expected [[[x, y], ...]] whose last point equals the first"
        )
    chains = [_points(name, ring) for ring in rings]
    for chain in chains:
        if len(chain) < 4 or (chain[0] != chain[-1]).any():
            raise PlanError(
                f"feature {name!r} has an open ring from {chain[0].tolist()} to {chain[-1].tolist()}; "
                "expected at least three corners, and the first one repeated at the end"
            )
    polygon = Polygon(chains[0], chains[1:])
    if not polygon.is_valid:
        raise PlanError(f"feature {name!r} crosses or touches itself: {explain_validity(polygon)}")
    if not polygon.area > 1e-9:
        raise PlanError(
            f"feature {name!r} has an area of {polygon.area:g} m²; expected a polygon with a positive area"
        )
    return polygon


def _with_walls(
    name: str,
    kind: str,
    area: Polygon | MultiPolygon | None,
    chains: Mapping[str, list[Floats]],
    properties: Mapping[str, Any],
) -> _Feature:
    segments: list[Floats] = []
    names: list[str] = []
    for stem, lines in chains.items():
        found = [np.stack(ends) for line in lines for ends in pairwise(line)]
        segments += found
        names += [f"{stem}/edge_{i}" for i in range(len(found))]
    surfaces = _surfaces(name, names, properties.get("surfaces"))
    given = properties.get("names")
    if given is not None:
        if not isinstance(given, list) or [type(g) for g in given] != [str] * len(names):
            raise PlanError(f"feature {name!r}: names must be a list of {len(names)} strings")
        names = list(given)
    return _Feature(name=name, kind=kind, area=area, segments=segments, names=names, surfaces=surfaces)


def _surfaces(name: str, names: list[str], given: Any) -> list[str]:
    if given is None:
        given = {}
    if not isinstance(given, dict):
        raise PlanError(f'feature {name!r} has surfaces {given!r:.40}, expected {{"edge number": "surface"}}')
    by_key = dict.fromkeys((_key(name, wall) for wall in names), "wall")
    for key, surface in given.items():
        if key not in by_key:
            raise PlanError(f"feature {name!r} has a surface for edge {key!r}; its edges are {_span(by_key)}")
        if not isinstance(surface, str) or not surface:
            raise PlanError(
                f"feature {name!r}, edge {key}: surface {surface!r}, expected a name such as glass"
            )
        by_key[key] = surface
    return list(by_key.values())


def _span(keys: Mapping[str, str]) -> str:
    return f"{next(iter(keys))} to {next(reversed(list(keys)))}" if keys else "none"


def _key(feature: str, wall: str) -> str:
    """Shorten `F/edge_3` to `3` and `F/ring_1/edge_3` to `ring_1/3`."""
    return wall.removeprefix(feature + "/").replace("edge_", "")


def dumps(arena: Arena) -> str:
    """Return an arena as text; `loads` restores its walls, names, surfaces and free space exactly."""
    for items in (_polygons(arena), _outline_and_lines(arena, by_feature=True)):
        text = _text(items) if items else ""
        if text and _is_equal(arena, text):
            return text
    return _text(_outline_and_lines(arena, by_feature=False))


def _is_equal(arena: Arena, text: str) -> bool:
    try:
        other = loads(text)
    except PlanError:
        return False
    return (
        other.names == arena.names
        and other.surfaces == arena.surfaces
        and np.array_equal(other.walls, arena.walls)
        and other.free.wkb == arena.free.wkb
    )


def _text(items: list[dict[str, Any]]) -> str:
    lines = ",\n".join("  " + json.dumps(item, ensure_ascii=False) for item in items)
    return '{"type": "FeatureCollection", "features": [\n' + lines + "\n]}\n"


def _item(geometry: Mapping[str, Any], **properties: Any) -> dict[str, Any]:
    kept = {key: value for key, value in properties.items() if value is not None}
    return {"type": "Feature", "properties": kept, "geometry": dict(geometry)}


def _groups(arena: Arena) -> Iterator[tuple[str, slice]]:
    """Yield each stem of wall names with its slice of consecutive walls."""
    stems = [match["stem"] if (match := _EDGE.fullmatch(name)) else "" for name in arena.names]
    at = 0
    for stem, run in groupby(stems):
        count = len(list(run))
        yield stem, slice(at, at + count)
        at += count


def _given(arena: Arena, feature: str, walls: slice) -> dict[str, str] | None:
    found = zip(arena.names[walls], arena.surfaces[walls], strict=True)
    return {_key(feature, name): surface for name, surface in found if surface != "wall"} or None


def _polygons(arena: Arena) -> list[dict[str, Any]]:
    """Reconstruct the features from the wall names, with the largest as the arena; `dumps` verifies the result."""
    rings: dict[str, list[list[list[float]]]] = {}
    spans: dict[str, slice] = {}
    for stem, span in _groups(arena):
        walls = arena.walls[span]
        hole = _RING.fullmatch(stem)
        feature = hole["feature"] if hole else stem
        if bool(hole) != (feature in rings) or not np.array_equal(
            walls[:, 1], np.roll(walls[:, 0], -1, axis=0)
        ):
            return []
        rings.setdefault(feature, []).append([*walls[:, 0].tolist(), walls[0, 0].tolist()])
        spans[feature] = slice(spans[feature].start if hole else span.start, span.stop)
    if not rings:
        return []
    area = {name: Polygon(found[0]).area for name, found in rings.items() if len(found[0]) > 3}
    arena_name = max(area, key=lambda name: area[name], default="")
    return [
        _item(
            {"type": "Polygon", "coordinates": found},
            name=name,
            kind="arena" if name == arena_name else "obstacle",
            surfaces=_given(arena, name, spans[name]),
        )
        for name, found in rings.items()
    ]


def _outline_and_lines(arena: Arena, *, by_feature: bool) -> list[dict[str, Any]]:
    """Return free space as an outline without walls, and the walls as lines that bound no area."""
    groups = list(_groups(arena)) if by_feature else [("walls", slice(0, arena.n_walls))]
    stems = {stem for stem, _ in groups}
    outline = next(name for name in ("free", "free space", "free space of the arena") if name not in stems)
    items = [_item(mapping(arena.free), name=outline, kind="arena", walls=False)]
    for stem, span in groups:
        if span.start == span.stop:
            continue
        surfaces = {str(i): s for i, s in enumerate(arena.surfaces[span]) if s != "wall"} or None
        items.append(
            _item(
                {"type": "MultiLineString", "coordinates": arena.walls[span].tolist()},
                name=stem,
                kind="wall",
                surfaces=surfaces,
                names=None if by_feature else list(arena.names),
            )
        )
    return items
