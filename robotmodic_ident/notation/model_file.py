"""Convert the fields of a model to and from the plain data of its JSON file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robotmodic_ident.errors import IdentError
from robotmodic_ident.scale import Scale
from robotmodic_ident.terms import Terms
from robotmodic_ident.types import Floats

MODEL_FORMAT = "robotmodic-narmax-1"


def to_plain(fields: Mapping[str, Any], stderr: Floats) -> dict[str, Any]:
    """Convert the fields of a model to plain data; `from_plain` is the inverse.

    Parameters
    ----------
    fields : field of `Narmax` -> its value
    stderr : (n_parameters,) standard errors of theta, denominator_theta and noise_theta, only for information
    """
    n, m = len(fields["terms"]), len(fields["denominator"])
    rows = _rows(fields["terms"], fields["theta"], stderr[:n])
    return {
        "format": MODEL_FORMAT,
        "output": fields["output"],
        "terms": [{**row, "err": _plain(err)} for row, err in zip(rows, fields["err"].tolist(), strict=True)],
        "denominator": _rows(fields["denominator"], fields["denominator_theta"], stderr[n : n + m]),
        "noise_terms": _rows(fields["noise_terms"], fields["noise_theta"], stderr[n + m :]),
        "covariance": [[_plain(v) for v in row] for row in fields["covariance"].tolist()],
        "sigma": _plain(fields["sigma"]),
        "n_samples": fields["n_samples"],
        "scale": fields["scale"].to_dict(),
        "spans": dict(fields["spans"]),
        "stop": fields["stop"],
        "estimator": fields["estimator"],
        "limits": [_plain(limit) for limit in fields["limits"]],
        "is_magnitude": fields["is_magnitude"],
        "notes": list(fields["notes"]),
    }


def from_plain(data: Mapping[str, Any]) -> dict[str, Any]:
    """Restore the fields of a model from plain data.

    Raises
    ------
    IdentError
        If the data have another format.
    KeyError, TypeError, ValueError
        If a field is missing or has a wrong type.
    """
    if data["format"] != MODEL_FORMAT:
        raise IdentError(f"format {data['format']!r}, expected {MODEL_FORMAT!r}; use a file of Narmax.save")
    for name, default in (("output", None), ("stop", None), ("estimator", "ls")):
        if not isinstance(data.get(name, default), str):
            raise TypeError(f"{name} is {data.get(name)!r}, expected a text")
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
        "spans": {str(name): float(span) for name, span in data.get("spans", {}).items()},
        "stop": data["stop"],
        "denominator": denominator,
        "denominator_theta": denominator_theta,
        "noise_terms": noise_terms,
        "noise_theta": noise_theta,
        "estimator": data.get("estimator", "ls"),
        "limits": _limits(*data.get("limits", (None, None))),
        "is_magnitude": bool(data.get("is_magnitude", False)),
        "notes": tuple(map(str, data.get("notes", ()))),
    }


def _limits(low: float | None, high: float | None) -> tuple[float, float]:
    return -math.inf if low is None else float(low), math.inf if high is None else float(high)


def _rows(terms: Terms, theta: Floats, stderr: Floats) -> list[dict[str, Any]]:
    rows = zip(terms.names, theta.tolist(), stderr.tolist(), strict=True)
    return [{"name": name, "theta": value, "stderr": _plain(spread)} for name, value, spread in rows]


def _plain(value: float) -> float | None:
    """Return None for values that JSON cannot represent, such as the standard errors of as many terms as samples."""
    return value if math.isfinite(value) else None


def _read_rows(rows: Sequence[Mapping[str, Any]]) -> tuple[Terms, Floats]:
    theta = np.array([row["theta"] for row in rows], dtype=np.float64)
    if not np.isfinite(theta).all():
        raise ValueError(f"theta is {theta.tolist()}, expected finite numbers")
    return Terms.parse(*(row["name"] for row in rows)), theta
