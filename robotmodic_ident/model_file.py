"""The plain data of a model, as its JSON file holds them; the names of the terms say which they are."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robotmodic_ident.errors import IdentError
from robotmodic_ident.scale import Scale
from robotmodic_ident.terms import Terms
from robotmodic_ident.types import Floats

if TYPE_CHECKING:
    from robotmodic_ident.model import Narmax

FORMAT = "robotmodic-narmax-1"


def written(model: Narmax) -> dict[str, Any]:
    """Return a model as plain data."""
    rows = _rows(model.terms, model.theta, model.stderr)
    return {
        "format": FORMAT,
        "output": model.output,
        "terms": [{**row, "err": _plain(err)} for row, err in zip(rows, model.err.tolist(), strict=True)],
        "denominator": _rows(model.denominator, model.denominator_theta, model.denominator_stderr),
        "noise_terms": _rows(model.noise_terms, model.noise_theta, model.noise_stderr),
        "covariance": [[_plain(v) for v in row] for row in model.covariance.tolist()],
        "sigma": _plain(model.sigma),
        "n_samples": model.n_samples,
        "scale": model.scale.to_dict(),
        "spans": dict(model.spans),
        "stop": model.stop,
        "estimator": model.estimator,
        "notes": list(model.notes),
    }


def fields_of(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of the model that `written` gave."""
    if data["format"] != FORMAT:
        raise IdentError(
            f"format {data['format']!r}, expected {FORMAT!r}; a model is written with Narmax.save"
        )
    terms, theta = _read_rows(data["terms"])
    denominator, denominator_theta = _read_rows(data.get("denominator", []))
    noise_terms, noise_theta = _read_rows(data.get("noise_terms", []))
    n = len(terms) + len(denominator) + len(noise_terms)
    err = [math.nan if row["err"] is None else row["err"] for row in data["terms"]]
    return {
        "output": data["output"],
        "terms": terms,
        "theta": theta,
        "covariance": np.array(data["covariance"], dtype=np.float64).reshape(n, n),
        "err": np.array(err, dtype=np.float64),
        "sigma": math.nan if data["sigma"] is None else float(data["sigma"]),
        "n_samples": int(data["n_samples"]),
        "scale": Scale.from_dict(data["scale"]),
        "spans": dict(data.get("spans", {})),
        "stop": data["stop"],
        "denominator": denominator,
        "denominator_theta": denominator_theta,
        "noise_terms": noise_terms,
        "noise_theta": noise_theta,
        "estimator": data.get("estimator", "ls"),
        "notes": tuple(data.get("notes", ())),
    }


def _rows(terms: Terms, theta: Floats, stderr: Floats) -> list[dict[str, Any]]:
    rows = zip(terms.names, theta.tolist(), stderr.tolist(), strict=True)
    return [{"name": name, "theta": value, "stderr": _plain(spread)} for name, value, spread in rows]


def _plain(value: float) -> float | None:
    """Return None for what JSON cannot hold: as many terms as samples leave no standard error."""
    return value if math.isfinite(value) else None


def _read_rows(rows: Sequence[Mapping[str, Any]]) -> tuple[Terms, Floats]:
    theta = np.array([row["theta"] for row in rows], dtype=np.float64)
    return Terms.parse(*(row["name"] for row in rows)), theta
