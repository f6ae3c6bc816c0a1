"""No-go zones: polygons that the robot may not enter, and that its sensor sees through.

A zone is taken out of the free space, and no wall is put round it. Whatever keeps clear of the border of free space
(the reachable set, the search, joins, the checker) then keeps the robot's whole disc out of the zone, while the walls
that a scan sees stay as they are.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry import MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.validation import explain_validity

from planners.arena import Arena
from planners.errors import PlanError
from planners.maps.geojson import MAX_COORDINATE

KIND = "no_go"


Zone = Polygon
"""Where the robot may not go [m, map]."""


def zones(given: str) -> list[Polygon]:
    """Return the polygons of a GeoJSON file (features of kind no_go), or the one of corners x,y,x,y,... [m].

    Raises
    ------
    PlanError : neither a file nor corners, or not a valid polygon
    """
    if Path(given).is_file():
        return read(Path(given))
    try:
        numbers = [float(part) for part in given.split(",")]
    except ValueError:
        raise PlanError(
            f"no-go zone {given!r} is no file, nor corners x,y,x,y,... in metres such as 1,1,2,1,2,2"
        ) from None
    if len(numbers) < 6 or len(numbers) % 2:
        raise PlanError(
            f"no-go zone {given!r} has {len(numbers)} numbers, expected x,y of at least three corners"
        )
    return [_checked(f"no-go zone {given!r}", [np.array(numbers).reshape(-1, 2).tolist()])]


def read(path: Path) -> list[Polygon]:
    """Read the features of kind no_go; others, such as the arena itself, are passed over.

    Raises
    ------
    PlanError : the file is no GeoJSON, has no zone, or a zone is no valid polygon
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as exc:
        raise PlanError(f"{path}: not GeoJSON ({exc}); expected polygons of kind {KIND}") from exc
    features = data.get("features") if isinstance(data, dict) else None
    if not isinstance(features, list):
        raise PlanError(f"{path}: no features; expected a FeatureCollection with polygons of kind {KIND}")
    found: list[Polygon] = []
    for number, feature in enumerate(features):
        properties = feature.get("properties") if isinstance(feature, dict) else None
        if not isinstance(properties, dict) or properties.get("kind") != KIND:
            continue
        found += _polygons(f"{path}: feature {properties.get('name', number)!r}", feature.get("geometry"))
    if not found:
        raise PlanError(f"{path}: none of its {len(features)} features is of kind {KIND}")
    return found


def without(arena: Arena, given: Sequence[Polygon]) -> Arena:
    """Return the arena with free space less the zones, its walls being as before.

    Raises
    ------
    PlanError : a zone lies outside of the free space, or the zones cover all of it
    """
    free: BaseGeometry = arena.free
    for zone in given:
        if not zone.intersection(arena.free).area > 0:
            x, y = zone.exterior.coords[0][:2]
            raise PlanError(
                f"the no-go zone from ({x:g}, {y:g}) lies outside the arena's free space "
                f"({', '.join(f'{bound:g}' for bound in arena.bounds)}); metres in frame map are meant"
            )
        free = free.difference(zone)
    parts = [part for part in getattr(free, "geoms", [free]) if isinstance(part, Polygon)]
    if not parts:
        raise PlanError("the no-go zones cover all of the arena's free space; nothing is left to drive in")
    return replace(arena, free=parts[0] if len(parts) == 1 else MultiPolygon(parts))


def _polygons(name: str, geometry: Any) -> list[Polygon]:
    kind = geometry.get("type") if isinstance(geometry, dict) else geometry
    if kind not in ("Polygon", "MultiPolygon"):
        raise PlanError(f"{name} of kind {KIND} is a {kind}, expected Polygon or MultiPolygon")
    coordinates = geometry.get("coordinates")
    return [_checked(name, rings) for rings in ([coordinates] if kind == "Polygon" else coordinates)]


def _checked(name: str, rings: Any) -> Polygon:
    try:
        chains = [np.array(ring, dtype=np.float64)[:, :2] for ring in rings]
        is_finite = all((np.abs(chain) <= MAX_COORDINATE).all() for chain in chains)
        polygon = Polygon(chains[0], chains[1:]) if is_finite else Polygon()
    except (TypeError, ValueError, IndexError, shapely.errors.GEOSException):
        raise PlanError(f"{name} is no polygon; expected rings of at least three x, y in metres") from None
    if not is_finite:
        raise PlanError(f"{name} has a coordinate that is not finite, or beyond {MAX_COORDINATE:g} m")
    if not polygon.is_valid:
        raise PlanError(f"{name} crosses or touches itself: {explain_validity(polygon)}")
    if not polygon.area > 0:
        raise PlanError(f"{name} has no area; expected a polygon with room inside")
    return polygon
