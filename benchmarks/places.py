"""Where the benchmarks drive: shipped arenas and random offices by name, and the vehicle of the planners."""

from __future__ import annotations

from benchmarks.offices import office
from planners.arena import Arena
from planners.maps import geojson
from planners.vehicle import Drive, Limits, Vehicle
from sensorgraph.loading import load_arena


def arena_named(name: str) -> Arena:
    """Return a random office by its number, or else a shipped arena or that of a file."""
    return geojson.loads(office(int(name))) if name.isdigit() else load_arena(name)


def vehicle(drive: Drive) -> Vehicle:
    """Return a vehicle with the limits of the shipped robot; cars turn at 0.4 m or wider."""
    return Vehicle(drive=drive, limits=Limits(turning_radius=0.0 if drive == "diff" else 0.4))
