"""Which law the numbers follow: polynomial, ARMAX and NARMAX identification; knows no robot."""

from robotmodic_ident.bases import BASES, bspline, chebyshev, fourier, legendre, polynomial, wavelet
from robotmodic_ident.dependence import Dependence, independent
from robotmodic_ident.errors import IdentError
from robotmodic_ident.fit import fit
from robotmodic_ident.model import Narmax
from robotmodic_ident.moments import Moments
from robotmodic_ident.records import Lagged, Record, blocks, halves, lagged, lags
from robotmodic_ident.scale import Scale
from robotmodic_ident.score import Outside, Score, Scored, outside, score, scores
from robotmodic_ident.select import Selection, select
from robotmodic_ident.terms import Terms
from robotmodic_ident.validate import Check, false_discoveries, validate

__all__ = [
    "BASES",
    "Check",
    "Dependence",
    "IdentError",
    "Lagged",
    "Moments",
    "Narmax",
    "Outside",
    "Record",
    "Scale",
    "Score",
    "Scored",
    "Selection",
    "Terms",
    "blocks",
    "bspline",
    "chebyshev",
    "false_discoveries",
    "fit",
    "fourier",
    "halves",
    "independent",
    "lagged",
    "lags",
    "legendre",
    "outside",
    "polynomial",
    "score",
    "scores",
    "select",
    "validate",
    "wavelet",
]
