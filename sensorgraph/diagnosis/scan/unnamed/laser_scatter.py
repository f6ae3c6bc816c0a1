"""A laser that scatters more than specified, which `scan.scatter_scale` tests before the effects."""

from __future__ import annotations

from sensorgraph.diagnosis.scan.unnamed.family import Unnamed

NAME = "laser_scatter"
LASER_SCATTER = Unnamed(titles={NAME: "a laser that scatters more than specified"})
