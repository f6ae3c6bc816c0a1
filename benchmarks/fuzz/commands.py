"""Every command with odd options; `readers` damages the files that they read."""

from __future__ import annotations

import contextlib
import io
import shutil
import zlib
from collections import Counter
from pathlib import Path

import numpy as np

from benchmarks.fuzz import samples
from benchmarks.fuzz.damage import TOKENS
from benchmarks.fuzz.judge import judge
from sensorgraph.cli import run as cli

COMMAND_SECONDS = 120.0
"""[s] of CPU time; a command may have to compile its kernels first."""
COST = 10.0
"""A command takes so many times the time of a reader, or more, and gets so many times fewer inputs."""
COSTLY = {"locate": 20.0, "show": 20.0, "identify": 20.0, "plan": 40.0, "diagnose": 40.0}
"""Those that take more."""
VALUES = (
    "", "0", "-1", "1", "1e308", "nan", "inf", "x", "1,1,0", "1,1", "nan,0,0", "a=b", "scan=/scan", "=", "every10", "block",
    "auto", "mode", "99999999999999999999", "1e-9", "--", "-", "é", "faces", "polynomial", "{run}", "{graph}", "{arena}",
    "{robot}", "{out}", "{out}/none", "{bad}", "/dev/null", "square", "{effects}", "{model}", "{no_go}", "{map}",
    "mujoco", "irsim", "gazebo", "nav2",
)  # fmt: skip
COMMANDS: dict[str, tuple[str, tuple[str, ...]]] = {
    "inspect": ("inspect {run} --arena {arena} --robot {robot}", ("--topic", "--arena", "--json", "--no-return", "--robot")),
    "recover": ("recover {run} -o {out}/o.mcap", ("--out",)),
    "locate": ("locate {run} --robot {robot} -o {out}/o.mcap", ("--arena", "--csv", "--json", "--topic", "--no-return")),
    "build": (
        "build {run} -o {out}/o.sensorgraph --arena {arena} --robot {robot} --no-calibrate",
        ("--arena", "--robot", "--model", "--split", "--degree", "--harmonics", "--terms", "--update", "--topic"),
    ),
    "evaluate": (
        "evaluate {graph} {run} --effects {effects}",
        ("--split", "--cap", "--point", "--effects", "--json", "--topic"),
    ),
    "predict": ("predict {graph} --poses {poses} -o {out}/o.npz", ("--poses", "--point", "-o")),
    "show": ("show {graph} --run {run} -o {out}/o.png", ("--ray", "--bearing", "--out", "--run")),
    "record": (
        "record {plan} --effects {effects} -o {out}/o.mcap",
        ("--arena", "--robot", "--effects", "--seed", "--start", "--graph", "--controller"),
    ),
    "drive": (
        "record {plan} --arena {arena} --controller {model} -o {out}/o.mcap",
        ("--arena", "--robot", "--controller", "--seed", "--start", "--graph"),
    ),
    "review": (
        "review {run} --graph {graph} --plan {plan} -o {out}/o.rrd",
        ("--graph", "--plan", "--arena", "--ray", "-o", "--topic"),
    ),
    "plan": (
        "plan {arena} --robot {robot} --no-go {no_go} --planner random_bounce --duration 2 -o {out}/o",
        ("--robot", "--planner", "--cell", "--headings", "--start", "--seed", "--no-go", "--resume", "--duration"),
    ),
    "diagnose": (
        "diagnose {run} --arena {arena} --robot {robot} -o {out}/o",
        ("--robot", "--effects", "--seed", "--topic", "--commissioning"),
    ),
    "export": (
        "export {arena} --robot {robot} --effects {effects} --to irsim -o {out}/o",
        ("--to", "--robot", "--effects", "--wall-height", "--no-go", "--run"),
    ),
    "twin of a graph": ("export {graph} --to mujoco -o {out}/o", ("--to", "--robot", "--wall-height")),
    "nav2": (
        "export {arena} --run {run} --no-go {no_go} --to nav2 -o {out}/o",
        ("--to", "--robot", "--run", "--no-go", "--effects"),
    ),
    "identify": (
        "identify {signals} --output y --inputs u --lags 1 -o {out}/o.json",
        ("--output", "--inputs", "--lags", "--output-lags", "--degree", "--noise-lags", "--split", "--every", "--terms"),
    ),
}  # fmt: skip
"""Name -> words that work, and options to add; what bears no command's name is another use of one."""


def write_samples(folder: Path) -> dict[str, Path]:
    """Write what the commands read and an empty folder for what they write; return name -> place."""
    files = {
        "arena": ("arena.geojson", samples.GEOJSON),
        "no_go": ("no_go.geojson", samples.NO_GO),
        "map": ("map.yaml", samples.MAP),
        "image": ("map.pgm", samples.PGM),
        "robot": ("robot.yaml", samples.ROBOT),
        "effects": ("effects.yaml", samples.EFFECTS_FILE),
        "poses": ("poses.csv", samples.POSES),
        "signals": ("signals.csv", samples.SIGNALS),
        "bad": ("bad.mcap", b"\x89"),
        "model": ("model.json", samples.models()[-1]),
        "run": ("run.mcap", samples.of_runs(".mcap")[0]),
        "graph": ("graph.sensorgraph", samples.graphs()[0]),
        "plan_way": ("plan/trajectory.csv", samples.TRAJECTORY),
        "plan_facts": ("plan/plan.json", samples.PLAN),
        "plan_arena": ("plan/arena.geojson", samples.GEOJSON),
        "plan_robot": ("plan/robot.yaml", samples.ROBOT),
    }
    for name in ("plan", "out"):
        (folder / name).mkdir(parents=True)
    for path, data in files.values():
        (folder / path).write_bytes(data)
    return {name: folder / path for name, (path, _) in files.items()} | {
        name: folder / name for name in ("plan", "out")
    }


def _words(name: str, rng: np.random.Generator) -> list[str]:
    base, options = COMMANDS[name]
    words = base.split()
    for option in rng.choice(options, int(rng.integers(1, 3))):
        words += [str(option), VALUES[int(rng.integers(len(VALUES)))]]
    if rng.random() < 0.2:
        words[int(rng.integers(1, len(words)))] = VALUES[int(rng.integers(len(VALUES)))]
    if rng.random() < 0.1:
        token = TOKENS[int(rng.integers(len(TOKENS)))].decode(errors="replace").replace("\x00", "")
        words[-1] = token.replace("{", "{{").replace("}", "}}")
    return words


def fuzz_command(name: str, n: int, seed: int, folder: Path) -> Counter[str]:
    """Give odd options to a command n times; return what was found, counted."""
    rng = np.random.default_rng([seed, 1, zlib.crc32(name.encode())])
    folder = folder / "commands"
    found: Counter[str] = Counter()
    for _ in range(n):
        shutil.rmtree(folder, ignore_errors=True)
        places = write_samples(folder)
        words = [word.format(**places) for word in _words(name, rng)]
        ending = judge(lambda words=words, out=places["out"]: _run(words, out), COMMAND_SECONDS)  # type: ignore[misc]
        if wrong := ending.wrong:
            found[f"{wrong}: {' '.join(words)}".replace(str(folder), "")] += 1
    shutil.rmtree(folder, ignore_errors=True)
    return found


def _run(words: list[str], folder: Path) -> None:
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.chdir(folder):
        code = cli(words)
    errors = [line for line in said.getvalue().splitlines() if line.startswith("error")]
    if code not in (0, 2) or (code == 2 and len(errors) != 1):
        raise RuntimeError(f"exit {code}: {errors}")
