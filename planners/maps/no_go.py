"""No-go zones: polygons that the robot may not enter and that do not block its sensor.

A zone is subtracted from the free space, without a wall around it. All parts of the planner keep clear of the
border of free space: the reachable set, the search, joins and the checker. The robot's whole disc therefore
stays outside the zone, and the walls in a scan do not change.
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
from planners.types import MAX_COORDINATE

KIND = "no_go"


Zone = Polygon
"""Area that the robot may not enter [m, map]."""


def zones(given: str) -> list[Polygon]:
    """Return the polygons of a GeoJSON file (features of kind no_go), or the polygon with corners x,y,x,y,... [m].

    Raises
    ------
    PlanError : The text is neither a file nor corners, or a polygon is invalid.
    """
    if Path(given).is_file():
        return read(Path(given))
    try:
        numbers = [float(part) for part in given.split(",")]
    except ValueError:
        raise PlanError(
            f"no-go zone {given!r} is neither a file nor corners x,y,x,y,... in metres such as 1,1,2,1,2,2"
        ) from None
    if len(numbers) < 6 or len(numbers) % 2:
        raise PlanError(
            f"no-go zone {given!r} has {len(numbers)} numbers, expected x,y of at least three corners"
        )
    return [_checked(f"no-go zone {given!r}", [np.array(numbers).reshape(-1, 2).tolist()])]


def read(path: Path) -> list[Polygon]:
    """Read the features of kind no_go; skip all others, such as the arena itself.

    Raises
    ------
    PlanError : The file is not GeoJSON, has no zone, or has a zone that is not a valid polygon.
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
    """Return the arena with the zones subtracted from its free space, and with the same walls.

    Raises
    ------
    PlanError : A zone lies outside the free space, or the zones cover all of it.
    """
    free: BaseGeometry = arena.free
    for zone in given:
        if not zone.intersection(arena.free).area > 0:
            x, y = zone.exterior.coords[0][:2]
            raise PlanError(
                f"the no-go zone from ({x:g}, {y:g}) lies outside the arena's free space "
                f"({', '.join(f'{bound:g}' for bound in arena.bounds)}); expected metres in frame map"
            )
        free = free.difference(zone)
    parts = [part for part in getattr(free, "geoms", [free]) if isinstance(part, Polygon)]
    if not parts:
        raise PlanError("the no-go zones cover all of the arena's free space; remove or shrink one")
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
        raise PlanError(f"{name} is not a polygon; expected rings of at least three x, y in metres") from None
    if not is_finite:
        raise PlanError(f"{name} has a coordinate that is not finite, or beyond {MAX_COORDINATE:g} m")
    if not polygon.is_valid:
        raise PlanError(f"{name} crosses or touches itself: {explain_validity(polygon)}")
    if not polygon.area > 0:
        raise PlanError(f"{name} has no area; expected a polygon with a positive area")
    return polygon
