"""Each tuned number of the diagnosis and of localization, halved and doubled: which answers change.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.sensitivity [--only selection,motion.EvidenceSettings]

A few short runs of `benchmarks.hidden_effects` (development seeds) are diagnosed with the settings as they are, and
again with one setting at a time times 0.5 and times 2. An answer is the set of names with their places, and whether
something unknown is said. A setting that moves no answer is counted; one that moves any is listed with what it moved.
Of `--only localization.`, the answer is how many scans of a drive in a simulated office are located, and their ATE to one digit.

So are constants of modules (`CUT` of `likelihood`), but for those of mathematics. Counts are rounded and at least 1;
shares and probabilities keep below 1 (twice 0.7 becomes 0.85, half the way to 1).
Each variant is a process of its own, begun before anything that a setting decides is imported.
"""

from __future__ import annotations

import importlib
import inspect
import logging
import multiprocessing
import os
import pkgutil
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from multiprocessing.connection import Connection
from types import ModuleType
from typing import Any

import numpy as np
from numba.core.caching import NullCache
from numba.core.dispatcher import Dispatcher

import sensorgraph.diagnosis.motion
import sensorgraph.diagnosis.scan
import sensorgraph.localization
from benchmarks.arguments import parser_of
from benchmarks.hidden_effects.case import Spec
from benchmarks.hidden_effects.entrants.product import run_of
from benchmarks.hidden_effects.worlds.own.cases import make
from benchmarks.locate import aligned, office_run
from logs import Run
from planners.maps import geojson
from planners.types import Floats
from sensorgraph.diagnosis.motion import settings as motion
from sensorgraph.diagnosis.result import ChannelResult
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.localization import settings as localization
from sensorgraph.world.robot import parse_robot

FACTORS = (0.5, 2.0)
SHARE = re.compile(
    "share|quantile|probability|chance|correlation|confidence|matching|cosine|dropout|absorber"
)
"""Names of numbers that are below 1 by their nature."""
NOT_OF_ANSWERS = {"held_out", "observability", "site"}
"""Groups that decide on the gap, on what a run could show, and on runs against a commissioning run."""
OF_KNOWN_PLACES = {"KnownMapSettings", "GlobalSearchSettings", "MapTrackingSettings"}
"""Settings of localization in a known place, which no drive here tests."""
OF_MATHEMATICS = {
    "CHI2_MEDIAN_1", "CHI2_MEDIAN_3", "GOLDEN_RATIO", "SIGMA_OF_MAD", "ROUND_OFF",
}  # fmt: skip
"""Constants that nobody has tuned."""
NOT_ASKED = re.compile(r"settings|calibration|\.site_")
"""Modules whose constants no case needs: runs without a reference, and against a commissioning run."""
OFFICES = ("101",)
"""Offices of `benchmarks.offices` in which a robot follows the walls."""
N_SCANS = 800
"""Number of scans of such a drive that are located."""
TIME_LIMIT = 120.0
"""[s] of one variant."""


@dataclass(frozen=True, kw_only=True)
class Hidden:
    """A case by what is hidden in it."""

    suite: str
    effect: str = ""
    strength: float = 0.35
    """Of a single effect: weak ones are the first to go."""
    background: str = "dirty"
    index: int = 5
    duration: float = 30.0
    """[s] of the run that is used."""

    @property
    def label(self) -> str:
        """What a table calls it."""
        return self.effect or f"nothing, {self.background}"

    def make(self, channel: str) -> tuple[Run, str, str]:
        """Return run, arena and robot file, with what a channel needs."""
        spec = Spec(
            suite=self.suite,
            index=self.index,
            background=self.background,
            effect=self.effect,
            strength=self.strength if self.suite == "singles" else None,
        )
        case = make(spec)
        run = run_of(case)
        kept = run.stamps < run.stamps[0] + self.duration
        run = replace(run, stamps=run.stamps[kept], ranges=run.ranges[kept])
        if channel == "scan":  # what the motion channels take would be measured in vain
            unused = ("odom_stamps", "odometry", "odom_twists", "cmd_stamps", "commands")
            run = replace(run, **{name: getattr(run, name)[:0] for name in unused})
        return run, str(case.map["arena.geojson"]), case.robot


SCAN_CASES = (
    Hidden(suite="none", index=2),
    Hidden(suite="singles", effect="range_bias"),
    Hidden(suite="singles", effect="unmapped_obstacle"),
    Hidden(suite="foreign", effect="bias_jump", duration=70.0),  # it jumps at 42 s
    Hidden(suite="foreign", effect="crosstalk_rotating"),
)
MOTION_CASES = (
    Hidden(suite="none", index=2),
    Hidden(suite="singles", effect="wheel_base", strength=0.5),
    Hidden(suite="singles", effect="wheel_slip", strength=0.6),
    Hidden(suite="singles", effect="dead_time"),
    Hidden(suite="foreign", effect="battery_sag"),
)


@dataclass(frozen=True, kw_only=True)
class Setting:
    """One number: the group, or the module, that holds it, and its name there."""

    channel: str
    group: Any
    name: str

    @property
    def label(self) -> str:
        """What a table calls it."""
        return f"{self.channel}.{self.holder}.{self.name}"

    @property
    def holder(self) -> str:
        """Name of the group or the module."""
        is_module = isinstance(self.group, ModuleType)
        return self.group.__name__.split(".")[-1] if is_module else type(self.group).__name__

    @property
    def value(self) -> Any:
        """As it stands."""
        return getattr(self.group, self.name)

    def set_to(self, value: Any) -> None:
        """Let it be another number, in every module that has imported it, too."""
        held = self.value
        if not isinstance(self.group, ModuleType):
            object.__setattr__(self.group, self.name, value)
            return
        for module in list(sys.modules.values()):
            if getattr(module, "__name__", "").startswith("sensorgraph") and (
                module.__dict__.get(self.name) is held
            ):
                setattr(module, self.name, value)
        kernels: Any = [one for one in vars(self.group).values() if isinstance(one, Dispatcher)]
        for kernel in kernels:  # compiled code holds the constants of its module
            kernel._cache = NullCache()
            kernel.recompile()


def settings_of(channel: str, group: Any) -> Iterator[Setting]:
    """Yield the numbers of a settings object, of its groups too."""
    for one in fields(group):
        value = getattr(group, one.name)
        if is_dataclass(value) and not isinstance(value, type):
            if one.name not in NOT_OF_ANSWERS:
                yield from settings_of(channel, value)
        elif scaled(one.name, value, 2.0) is not None:
            yield Setting(channel=channel, group=group, name=one.name)


def constants_of(channel: str, package: ModuleType) -> Iterator[Setting]:
    """Yield the constants of the modules of a package that are written as numbers."""
    for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if NOT_ASKED.search(found.name):
            continue
        module = importlib.import_module(found.name)
        assigned = re.findall(
            r"^([A-Z][A-Z0-9_, ]+)(?::.+)? = (?=\(?-?\d)", inspect.getsource(module), re.MULTILINE
        )
        for name in sorted({name for line in assigned for name in line.split(", ")} - OF_MATHEMATICS):
            if scaled(name, getattr(module, name), 2.0) is not None:
                yield Setting(channel=channel, group=module, name=name)


def scaled(name: str, value: Any, factor: float) -> Any:
    """Return a number, or each number of a tuple or mapping, times a factor; None for what is no number."""
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return None
    if isinstance(value, int):
        return max(1, round(value * factor))
    if isinstance(value, float):
        if SHARE.search(name.lower()) and value < 1.0 <= value * factor:
            return (1.0 + value) / 2
        return value * factor
    if isinstance(value, tuple):
        parts = [scaled(name, part, factor) for part in value]
        return None if any(part is None for part in parts) else tuple(parts)
    if isinstance(value, Mapping):
        return {key: scaled(name, part, factor) for key, part in value.items()}
    return None


def answers(channel: str, cases: list[tuple[Run, str, str]]) -> list[str]:
    """Return what is said of each case; imports only now, so that settings hold for what is decided on import."""
    from sensorgraph.diagnosis.diagnose import diagnose, diagnose_motion

    out = []
    for run, arena, file in cases:
        robot = parse_robot(file)
        if channel == "scan":
            scan = diagnose(run, geojson.loads(arena), robot, plan_next=False).channels["scan"]
            results = [scan]
        else:
            results = list(diagnose_motion(run, robot, ()))
        out.append(_said(results))
    return out


def located(cases: list[tuple[Run, Floats]]) -> list[str]:
    """Return how many scans of each run are located, and their error to one digit."""
    from sensorgraph.localization.mapping import map_run

    out = []
    for run, truth in cases:
        found = map_run(run)
        off, _ = aligned(found.poses, truth)
        ate = np.sqrt((off[:, :2] ** 2).sum(axis=1).mean())
        out.append(f"{found.status.count('ok')} ok, ATE {1000 * ate:.1g} mm")
    return out


def driven(office: str) -> tuple[Run, Floats]:
    """Return the first part of a drive in a simulated office, and its true poses."""
    run, truth = office_run(int(office))
    return run.take_scans(slice(N_SCANS)), truth[:N_SCANS]


def _said(results: Sequence[ChannelResult]) -> str:
    """Return names with their places, and whether something is unknown."""
    names = sorted(a.name + (f" {a.place}" if a.place else "") for r in results for a in r.effects)
    doubt = ["unknown"] if any(r.unknown for r in results) else []
    return ", ".join([*names, *doubt]) or "silent"


def in_process(
    answer: Callable[[], list[str]], setting: Setting | None, factor: float = 1.0
) -> list[str] | str:
    """Return the answers of a process in which one setting differs, or what went wrong there."""
    here, there = multiprocessing.get_context("fork").Pipe(duplex=False)
    child = multiprocessing.get_context("fork").Process(target=_answer, args=(there, answer, setting, factor))
    child.start()
    there.close()
    try:
        got = here.recv() if here.poll(TIME_LIMIT) else f"longer than {TIME_LIMIT:.0f} s"
    except EOFError:
        got = "no answer"
    child.kill()
    child.join()
    return got  # type: ignore[no-any-return]


def _answer(to: Connection, answer: Callable[[], list[str]], setting: Setting | None, factor: float) -> None:
    logging.disable(logging.ERROR)
    if setting is not None:
        setting.set_to(scaled(setting.name, setting.value, factor))
    try:
        to.send(answer())
    except Exception as exc:
        to.send(f"{type(exc).__name__}: {exc}")


def main() -> None:
    """Print what moves."""
    parser = parser_of(__doc__)
    parser.add_argument("--only", default="", help="parts of the names of settings, comma-separated")
    options = parser.parse_args()
    wanted = [part for part in options.only.split(",") if part]
    scan, motions = sensorgraph.diagnosis.scan, sensorgraph.diagnosis.motion
    groups = {id(group): group for group in vars(localization).values()}.values()
    of_localization = [
        s
        for one in groups
        if type(one).__name__.endswith("Settings") and type(one).__name__ not in OF_KNOWN_PLACES
        for s in settings_of("localization", one)
    ]
    of_localization += constants_of("localization", sensorgraph.localization)
    parts: dict[str, tuple[Sequence[str], list[Setting], Callable[[], Callable[[], list[str]]]]] = {
        "motion": (
            [one.label for one in MOTION_CASES],
            [*settings_of("motion", motion.EVIDENCE), *constants_of("motion", motions)],
            lambda: partial(answers, "motion", [one.make("motion") for one in MOTION_CASES]),
        ),
        "scan": (
            [one.label for one in SCAN_CASES],
            [*settings_of("scan", SCAN), *constants_of("scan", scan)],
            lambda: partial(answers, "scan", [one.make("scan") for one in SCAN_CASES]),
        ),
        "localization": (
            OFFICES,
            of_localization,
            lambda: partial(located, [driven(one) for one in OFFICES]),
        ),
    }
    for channel, (labels, settings, prepared) in parts.items():
        settings = [s for s in settings if not wanted or any(part in s.label for part in wanted)]
        if not settings:
            continue
        answer = prepared()
        begin = time.perf_counter(), os.times().children_user
        usual = in_process(answer, None)
        if isinstance(usual, str):
            raise SystemExit(f"{channel}: {usual}")
        took, cpu = time.perf_counter() - begin[0], os.times().children_user - begin[1]
        print(
            f"{channel}: {len(settings)} settings, {len(labels)} cases, {took:.0f} s ({cpu:.1f} of CPU) a variant"
        )
        for label, said in zip(labels, usual, strict=True):
            print(f"  {label}: {said}")
        still = 0
        for setting in settings:
            lines = []
            for factor in FACTORS:
                got = in_process(answer, setting, factor)
                if isinstance(got, str):
                    lines.append(f"x {factor:g}: {got}")
                    continue
                changed = [k for k in range(len(labels)) if got[k] != usual[k]]
                lines += [f"x {factor:g}: {labels[k]} -> {got[k]}" for k in changed]
            still += not lines
            for line in lines:
                print(f"  {setting.label} = {setting.value}, {line}")
        print(f"{channel}: {still} of {len(settings)} settings move no answer")


if __name__ == "__main__":
    main()
