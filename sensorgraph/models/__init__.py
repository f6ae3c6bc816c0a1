"""Models of what each ray perceives; registry MODELS."""

from __future__ import annotations

from sensorgraph.models.base import Model
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.faces.model import Faces
from sensorgraph.models.narmax.model import RayNarmax
from sensorgraph.models.polynomial.model import Polynomial

MODELS: dict[str, type[Model]] = {
    "cells": CellModel,
    "faces": Faces,
    "polynomial": Polynomial,
    "narmax": RayNarmax,
}
"""Name -> class with `fit`, `predict`, `state` and `restore`."""
