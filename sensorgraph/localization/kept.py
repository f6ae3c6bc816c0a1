"""Locate a file once and keep the result beside it, for as long as the file and the settings stay the same."""

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
from planners.arena import Arena
from sensorgraph.graph import Sensorgraph
from sensorgraph.localization import map_settings, settings
from sensorgraph.localization.locate import (
    MIN_SCANS,
    has_reference,
    locate,
    located_run,
    summary_lines,
)
from sensorgraph.localization.result import Localization
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.types import ProgressBars, no_progress
from sensorgraph.version import __version__

logger = logging.getLogger(__name__)
KEY = "located_as"
"""Entry of a located run's meta: what it was located from, and how."""


@dataclass(frozen=True, kw_only=True)
class KeptRun:
    """A located run and its file."""

    run: Run
    path: Path | None
    """None: nothing could be written beside the run."""
    lines: tuple[str, ...]
    """What was found, where it was located now; empty: the kept one was taken."""


def needs_locating(run: Run, n_scans: int, poses: str | None) -> bool:
    """Tell whether a run is to be located.

    Parameters
    ----------
    run : or its first scans
    n_scans : of the whole run
    poses : `log`: never, `locate`: always, None: where a laser's run has no reference
    """
    if poses is not None:
        return poses == "locate"
    return not has_reference(run) and not measures_cones(run.sensor) and n_scans >= MIN_SCANS


def kept_beside(path: Path) -> Path:
    """Return where the located run of a file is kept."""
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
    """Return the located run of a file: the one kept beside it, or a new one, which is then kept.

    Parameters
    ----------
    path : of the run
    run : as it was read
    place : where it is to be located; None: in a place of its own
    name : of the place; it is part of what a kept run is known by
    options : with which the run was read

    Raises
    ------
    SensorgraphError : the run cannot be located
    """
    key, beside = _key(path, place, name, options or {}), kept_beside(path)
    kept = _kept(beside, key)
    if kept is not None:
        return KeptRun(run=kept, path=beside, lines=())
    found: Localization = locate(run, place, name=name or "the map", progress=progress)
    new = located_run(run, found)
    new = replace(new, meta={**new.meta, KEY: key})
    lines = tuple(summary_lines(found))
    try:
        logs.write(new, beside)
    except OSError as exc:
        logger.warning("the located run cannot be kept beside %s (%s)", path, exc.strerror)
        return KeptRun(run=new, path=None, lines=lines)
    return KeptRun(run=logs.read(beside), path=beside, lines=lines)


def kept_own(path: Path, options: Mapping[str, object] | None = None) -> Run | None:
    """Return the run that is kept beside a file as located in a place of its own; None: there is none."""
    return _kept(kept_beside(path), _key(path, None, "", options or {}))


def _kept(beside: Path, key: str) -> Run | None:
    if not beside.is_file():
        return None
    try:
        run = logs.read(beside)
    except LogError:
        return None
    return run if run.meta.get(KEY) == key else None


def _key(path: Path, place: Arena | Sensorgraph | None, name: str, options: Mapping[str, object]) -> str:
    """Return a digest of the file, the place, and all settings."""
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
        for module in (settings, map_settings)
        for label, value in vars(module).items()
        if hasattr(value, "__dataclass_fields__") and not isinstance(value, type)
    }
    said = {"version": __version__, "options": {k: str(v) for k, v in options.items()}, "settings": tuned}
    digest.update(json.dumps(said, sort_keys=True, default=str).encode())
    return digest.hexdigest()
