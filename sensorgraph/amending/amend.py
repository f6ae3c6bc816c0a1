"""Amend model files: recognize the format, apply the effects, and write all files or none."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import logs
from logs.files import atomic_file
from logs.run import Run
from planners.arena import Arena
from sensorgraph.amending.findings import MeasuredLaser
from sensorgraph.amending.mjcf import amend_mjcf
from sensorgraph.amending.nav2 import amend_nav2
from sensorgraph.amending.robot_yaml import amend_robot
from sensorgraph.amending.sdf import amend_sdf
from sensorgraph.amending.text import TextFile, declared_encoding
from sensorgraph.amending.urdf import amend_urdf
from sensorgraph.amending.xacro import Document, expand
from sensorgraph.amending.xml_tree import Element, parse_xml
from sensorgraph.amending.yaml_text import YamlFile
from sensorgraph.effects import Amendment, effects_file
from sensorgraph.errors import SensorgraphError, as_sensorgraph_error
from sensorgraph.exporting.amcl import (
    BootstrapEstimate,
    LaserModelChoice,
    compare_laser_models,
    estimate_amcl,
)
from sensorgraph.exporting.nav2 import chosen, map_of
from sensorgraph.loading import arena_in, load_arena
from sensorgraph.robust import robust_sigma

MODELS = {"robot": amend_urdf, "sdf": amend_sdf, "mujoco": amend_mjcf, "mujocoinclude": amend_mjcf}
"""Root element -> function of the format."""
MAX_BYTES = 20_000_000
"""Maximum size of a file."""
SAME_STEP = 1e-4
"""[rad] Largest deviation of the angle between neighbouring rays of a laser from its mean."""
MIN_SCANS = 3
"""Minimum number of scans from which the rate is measured."""
Amcl = tuple[dict[str, BootstrapEstimate], LaserModelChoice | None]


@dataclass(frozen=True, kw_only=True)
class AmendedFile:
    """One amended file."""

    path: Path
    text: bytes
    """Text with the changes."""
    diff: str
    """Unified diff; empty if nothing changes."""


@dataclass(frozen=True, kw_only=True)
class AmendedModel:
    """Result of an amendment, not yet written."""

    files: tuple[AmendedFile, ...]
    left_out: tuple[str, ...]
    """What the files cannot hold, with the Python layer that can, one line each."""

    def __repr__(self) -> str:
        """Summarise the changes in one line."""
        changed = ", ".join(file.path.name for file in self.files if file.diff)
        return f"AmendedModel: changes {changed or 'nothing'}, left out: {len(self.left_out)}"

    @property
    def diff(self) -> str:
        """Unified diff of all files."""
        return "\n".join(file.diff for file in self.files if file.diff)

    @as_sensorgraph_error
    def write(self, out: Path | str | None = None) -> list[Path]:
        """Write the changed files; return their paths.

        Parameters
        ----------
        out : File for one input, or folder. None: the input files are replaced, with their permissions.

        Raises
        ------
        SensorgraphError : Several files cannot be written to one file, or a file is read-only.
        """
        out = None if out is None else Path(out)
        is_folder = out is not None and (out.is_dir() or len(self.files) > 1)
        if out is not None and is_folder:
            if out.exists() and not out.is_dir():
                raise SensorgraphError(f"{out} is a file; give a folder for {len(self.files)} files")
            out.mkdir(parents=True, exist_ok=True)
        names = [file.path.name for file in self.files]
        double = next((name for name in names if names.count(name) > 1), None)
        if is_folder and double is not None:
            raise SensorgraphError(
                f"two files are named {double}, and {out} can hold one; amend them one at a time, or without --out"
            )
        if out is None:
            targets = [file.path.resolve() for file in self.files]
        else:
            targets = [out / name if is_folder else out for name in names]
        for target in targets:
            if target.exists() and not os.access(target, os.W_OK):
                raise SensorgraphError(f"{target} is read-only; make it writable, or give another --out")
        written = []
        for file, target in zip(self.files, targets, strict=True):
            if out is None and not file.diff:
                continue
            with atomic_file(target) as part:
                part.write_bytes(file.text)
                shutil.copymode(file.path, part)
            written.append(target)
        return written


@as_sensorgraph_error
def amend(
    files: Path | str | Sequence[Path | str],
    effects: Sequence[Amendment] | Path | str,
    *,
    run: Run | Path | str | None = None,
    arena: Arena | Path | str | None = None,
    laser: str | None = None,
) -> AmendedModel:
    """Write found effects into the text of model files; `AmendedModel.write` saves it.

    XML files of one format are one model: a xacro with its includes, or an MJCF with its includes.

    Parameters
    ----------
    files : URDF, xacro, SDF, MJCF, nav2_params.yaml or robot.yaml.
    effects : Effects, or an effects.yaml. Changes are relative to the numbers of the files.
    run : Run whose rate, angles and ranges are written too. With poses and an arena, AMCL's parameters are
        estimated from it.
    arena : Arena of the run. None: the one kept in it.
    laser : Name of the laser: its sensor, link, body or site. None: the only one.

    Returns
    -------
    AmendedModel with `diff`, `left_out` (what the files cannot hold, one line each) and `files`.

    Raises
    ------
    SensorgraphError : A file is no model, is amended already, or can hold no change; or the laser is not known.
    """
    paths = [Path(one) for one in ([files] if isinstance(files, str | Path) else files)]
    amendments = effects_file.read(Path(effects)) if isinstance(effects, str | Path) else tuple(effects)
    log = logs.read(run) if isinstance(run, str | Path) else run
    walls = load_arena(arena) if isinstance(arena, str | Path) else arena
    if walls is None and log is not None:
        walls = arena_in(log)
    if not paths:
        raise SensorgraphError(
            "no file is given; give a URDF, xacro, SDF, MJCF, nav2_params.yaml or robot.yaml"
        )
    if len({path.resolve() for path in paths}) < len(paths):
        raise SensorgraphError("a file is given twice; give each file once")
    if not amendments and log is None:
        raise SensorgraphError("there is no effect to write; give an effects.yaml with effects, or a run")
    return _amended(paths, amendments, log, walls, laser)


def _amended(
    paths: Sequence[Path],
    amendments: tuple[Amendment, ...],
    run: Run | None,
    arena: Arena | None,
    laser: str | None,
) -> AmendedModel:
    files = [_read(path) for path in paths]
    for file in files:
        _check_not_amended(file, amendments)
    measured = None if run is None else _measured(run)
    left_out: list[str] = []
    options = {"laser": laser, "measured": measured}
    by_format: dict[str, list[Element]] = {}
    for file in files:
        if file.is_xml:
            root = parse_xml(file)
            if root.tag not in MODELS:
                raise SensorgraphError(
                    f"{file.path}: the root element is <{root.tag}>; expected <robot> (URDF, xacro), <sdf> or <mujoco>"
                )
            by_format.setdefault(root.tag.removesuffix("include"), []).append(root)
        else:
            left_out += _amend_yaml(YamlFile.of(file), amendments, laser, measured, run, arena)
    for tag, elements in by_format.items():
        document: Document = expand(elements)
        name = elements[0].file.path.name
        left_out += MODELS[tag](document, amendments, file=name, **options)  # type: ignore[arg-type]
    amended = [_checked(file) for file in files]
    if not any(file.diff for file in amended):
        reason = left_out[0] if left_out else "its numbers are already those of the effects"
        raise SensorgraphError(f"nothing to write: {reason}")
    return AmendedModel(files=tuple(amended), left_out=tuple(left_out))


def _measured(run: Run) -> MeasuredLaser:
    """Return the settings of a run's laser; the rate is the inverse of the median period.

    Raises
    ------
    SensorgraphError : The run has too few scans, or its laser is not one fan with even steps.
    """
    name = str(run.meta.get("source", "the run"))
    if run.n_scans < MIN_SCANS:
        raise SensorgraphError(
            f"{name}: {run.n_scans} scans; expected {MIN_SCANS} or more to measure the rate"
        )
    bearings = np.unwrap(run.sensor.bearings)
    steps = np.diff(bearings)
    if run.sensor.is_composite or len(steps) == 0 or np.ptp(steps) > SAME_STEP:
        raise SensorgraphError(f"{name}: the laser is not one fan with even steps; leave the run out")
    periods = np.diff(run.stamps)
    period = float(np.median(periods))
    if period <= 0:
        raise SensorgraphError(f"{name}: its scans have no increasing times; leave the run out")
    scatter = robust_sigma(periods - period)
    returns = run.ranges[np.isfinite(run.ranges)]
    return MeasuredLaser(
        n_rays=run.sensor.n_rays,
        angle_min=float(bearings.min()),
        angle_max=float(bearings.max()),
        range_min=float(run.sensor.range_min),
        range_max=float(run.sensor.range_max),
        rate=1 / period,
        # the median of n periods has 1.25 times the standard error of their mean
        rate_sigma=max(1.25 * scatter / np.sqrt(len(periods)), 1e-6 * period) / period**2,
        mean_square_range=float(np.mean(returns**2)) if len(returns) else 0.0,
        name=name,
    )


def _read(path: Path) -> TextFile:
    if path.is_dir():
        raise SensorgraphError(f"{path} is a directory; give its model files")
    if not path.exists():
        raise SensorgraphError(f"{path} does not exist; give a URDF, xacro, SDF, MJCF or YAML file")
    if path.stat().st_size > MAX_BYTES:
        raise SensorgraphError(f"{path} has more than {MAX_BYTES // 10**6} MB; expected a model file")
    data = path.read_bytes()
    encoding = declared_encoding(data)
    try:
        data.decode(encoding)
    except (UnicodeDecodeError, LookupError) as exc:
        raise SensorgraphError(
            f"{path} is not {encoding.upper()} text; expected a model file in the encoding that it declares"
        ) from exc
    if not data.strip():
        raise SensorgraphError(f"{path} is empty; expected a URDF, xacro, SDF, MJCF or YAML file")
    is_xml = data.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<")
    return TextFile(path, data, is_xml)


def _check_not_amended(file: TextFile, amendments: Sequence[Amendment]) -> None:
    """Refuse to add the same effect twice: changes are relative to the numbers of the file."""
    for a in amendments:
        for name, value in a.parameters.items():
            if file.holds(a.name, f"{name} = {value:.4g}"):
                raise SensorgraphError(
                    f"{file.path}: already amended with {a.name} {name} = {value:.4g}; "
                    "amend the original file, or leave the effect out"
                )


def _amend_yaml(
    data: YamlFile,
    amendments: tuple[Amendment, ...],
    laser: str | None,
    measured: MeasuredLaser | None,
    run: Run | None,
    arena: Arena | None,
) -> list[str]:
    name = data.file.path.name
    text = data.file.data
    if b"ros__parameters" in text:
        amcl: Amcl | None = None
        if run is not None and arena is not None:
            grid = map_of(arena)
            found = estimate_amcl(run, arena, grid)
            amcl = found, compare_laser_models(run, grid, chosen(found))
        return amend_nav2(data, amendments, amcl=amcl, file=name)
    return amend_robot(data, amendments, laser=laser, measured=measured, file=name)


def _checked(file: TextFile) -> AmendedFile:
    """Return the amended file, after reading it again."""
    new = file.amended()
    again = TextFile(file.path, new, file.is_xml)
    if file.is_xml:
        parse_xml(again)
    else:
        YamlFile.of(again)
    return AmendedFile(path=file.path, text=new, diff=file.diff(new))
