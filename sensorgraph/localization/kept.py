"""Locate a file once and keep the result next to it, as long as the file and the settings are unchanged."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import logs
from logs.errors import LogError
from logs.run import Run
from logs.usability import MIN_SCANS
from planners.arena import Arena
from sensorgraph.graph import Sensorgraph
from sensorgraph.localization import settings
from sensorgraph.localization.locate import has_reference, locate, located_run, summary_lines
from sensorgraph.localization.result import Localization
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.types import ProgressBars, no_progress
from sensorgraph.version import __version__

logger = logging.getLogger(__name__)
KEY = "located_as"
"""Metadata key of a located run with the digest of its source and settings."""


@dataclass(frozen=True, kw_only=True)
class KeptRun:
    """A located run and its file."""

    run: Run
    path: Path | None
    """None: the file could not be written."""
    lines: tuple[str, ...]
    """Summary of a new localization; empty if a kept run was used."""


def needs_locating(run: Run, n_scans: int, poses: str | None) -> bool:
    """Tell whether a run must be located.

    Parameters
    ----------
    run : The run, or its first scans.
    n_scans : Number of scans of the whole run.
    poses : `log`: never; `locate`: always; None: a laser run without a reference.
    """
    if poses is not None:
        return poses == "locate"
    return not has_reference(run) and not measures_cones(run.sensor) and n_scans >= MIN_SCANS


def kept_beside(path: Path) -> Path:
    """Return the path of the located run of a file."""
    return path.with_name(f"{path.name}.located.mcap")


def located(
    path: Path,
    run: Run,
    place: Arena | Sensorgraph | None = None,
    *,
    name: str = "",
    options: Mapping[str, object] | None = None,
    progress: ProgressBars = no_progress,
) -> KeptRun:
    """Return the located run of a file: the kept one, or a new one, which is then kept.

    Parameters
    ----------
    path : Path of the run.
    run : The run as read.
    place : Place in which it is located; None: its own map.
    name : Name of the place; part of the digest of a kept run.
    options : Options with which the run was read.

    Raises
    ------
    SensorgraphError : The run cannot be located.
    """
    key, kept_path = _key(path, place, name, options or {}), kept_beside(path)
    kept = _kept(kept_path, key)
    if kept is not None:
        return KeptRun(run=kept, path=kept_path, lines=())
    found: Localization = locate(run, place, name=name or "the map", progress=progress)
    new = located_run(run, found)
    new = replace(new, meta={**new.meta, KEY: key})
    lines = tuple(summary_lines(found))
    try:
        logs.write(new, kept_path)
    except OSError as exc:
        logger.warning("cannot keep the located run next to %s (%s)", path, exc.strerror)
        return KeptRun(run=new, path=None, lines=lines)
    return KeptRun(run=logs.read(kept_path), path=kept_path, lines=lines)


def kept_own(path: Path, options: Mapping[str, object] | None = None) -> Run | None:
    """Return the kept run of a file, located in its own map, or None."""
    return _kept(kept_beside(path), _key(path, None, "", options or {}))


def _kept(kept_path: Path, key: str) -> Run | None:
    if not kept_path.is_file():
        return None
    try:
        run = logs.read(kept_path)
    except LogError:
        return None
    return run if run.meta.get(KEY) == key else None


def _key(path: Path, place: Arena | Sensorgraph | None, name: str, options: Mapping[str, object]) -> str:
    """Return a digest of the file, the place and all settings."""
    digest = hashlib.sha256()
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    for file in files:
        if file.is_file():
            digest.update(file.read_bytes())
    if isinstance(place, Arena):
        digest.update(place.walls.tobytes())
    elif place is not None and Path(name).is_file():
        digest.update(Path(name).read_bytes())
    tuned = {
        label: asdict(value)
        for label, value in vars(settings).items()
        if hasattr(value, "__dataclass_fields__") and not isinstance(value, type)
    }
    described = {
        "version": __version__,
        "options": {k: str(v) for k, v in options.items()},
        "settings": tuned,
    }
    digest.update(json.dumps(described, sort_keys=True, default=str).encode())
    return digest.hexdigest()
