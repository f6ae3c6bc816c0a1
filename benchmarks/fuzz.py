"""Feed damaged and hostile files to every reader, and odd options to every command; count what is not one clear line.

    python -m benchmarks.fuzz [--inputs 100000] [--seed 0] [--only mcap,robot]

A reader may return or raise an error of ours with one line; a command may end with exit code 0 or 2. Everything else is
a finding: another exception, several lines, more than SECONDS, more than MEMORY. The same seed gives the same inputs.
"""

from __future__ import annotations

import argparse
import contextlib
import gzip
import io
import json
import resource
import shutil
import signal
import sqlite3
import struct
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import numpy as np

import logs
from logs.errors import LogError
from logs.inspection import inspect
from logs.recovery import recover
from logs.run import RangeSensor, Run
from logs.stream import open_log
from planners import maps
from planners.errors import PlanError
from planners.maps import no_go
from planners.trajectory import read_csv
from robotmodic_ident.errors import IdentError
from robotmodic_ident.model import Narmax
from sensorgraph.building.build import build
from sensorgraph.cli import run as cli
from sensorgraph.effects import effects_file
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.identification.signals import signals_of_table
from sensorgraph.loading import read_poses
from sensorgraph.world.robot import load_robot

OURS = (LogError, PlanError, IdentError, SensorgraphError)
SECONDS = 10.0
"""[s] of CPU time; a small file takes less."""
COMMAND_SECONDS = 120.0
"""[s] of CPU time; a command may have to compile its kernels first."""
MEMORY = 3 * 1024**3
"""[bytes] of address space that a small file may take beyond what is taken at the start."""
TOKENS = (
    b"0", b"-1", b"1e308", b"-1e308", b"1e-320", b"nan", b"inf", b"-inf", b"null", b"true", b"[]", b"{}", b'""', b"1e9",
    b"99999999999999999999", b"2147483648", b"-0.0", b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"\r", b"\n", b",", b":", b"#",
    b"&a [*a, *a]", b"!!python/object:os.system x", b"../../../../etc/passwd", b"/dev/zero", b"~", b"0x10", b"1_000",
    b"[" * 5000, b"{a: " * 3000, b"2026-11-22", "é".encode(), b"' ", b'"',
)  # fmt: skip


@dataclass(frozen=True)
class Reader:
    """One thing that opens a file."""

    name: str
    seeds: tuple[bytes, ...]
    suffix: str
    read: Callable[[Path], object]


class Chunk(NamedTuple):
    """A chunk as rosbags describes it."""

    datasize: int
    datapos: int
    decompressor: Any


class Hung(BaseException):
    """It took longer than SECONDS."""


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage a file as disks, programs and people do, a few times over."""
    out = bytearray(data)
    for _ in range(int(rng.choice([1, 1, 2, 4, 16]))):
        if not out:
            break
        at = int(rng.integers(len(out)))
        size = int(min(rng.choice([1, 2, 4, 8, 64, 1024]), len(out) - at))
        match int(rng.integers(9)):
            case 0:
                out[at] ^= 1 << int(rng.integers(8))
            case 1:
                out[at : at + size] = rng.bytes(size)
            case 2:
                del out[at : at + size]
            case 3:
                out[at:at] = out[at : at + size]
            case 4:
                del out[at:]
            case 5:
                odd = int(rng.choice([0, 1, 0x7F, 0xFF]))
                out[at : at + size] = bytes([odd]) * size
            case 6:
                value = int(rng.choice([0, 1, 2**31 - 1, 2**32 - 1, 10**6]))
                out[at : at + 4] = struct.pack("<I", value)[: len(out) - at]
            case 7:
                other = int(rng.integers(len(out)))
                out[at : at + size] = out[other : other + size]
            case _:
                out[at : at + size] = TOKENS[int(rng.integers(len(TOKENS)))]
    return bytes(out)


def swap_token(data: bytes, rng: np.random.Generator) -> bytes:
    """Put an odd value in the place of one of a text's numbers, names or separators."""
    starts = [i for i, c in enumerate(data) if chr(c) in " :,[\t\n="]
    if not starts:
        return mutate(data, rng)
    at = int(rng.choice(starts)) + 1
    end = at
    while end < len(data) and chr(data[end]) not in " ,]}\t\n":
        end += 1
    return data[:at] + TOKENS[int(rng.integers(len(TOKENS)))] + data[end:]


def rezip(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage one member of a zip file, and zip it again with right checksums."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as file:
            members = {name: file.read(name) for name in file.namelist()}
    except Exception:  # damaged already
        return mutate(data, rng)
    name = list(members)[int(rng.integers(len(members)))]
    text = name.endswith(".json") and rng.random() < 0.8
    members[name] = swap_token(members[name], rng) if text else mutate(members[name], rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        for member, content in members.items():
            file.writestr(member, content)
    return out.getvalue()


def remcap(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage the content of one chunk or record of an MCAP file whose checksums are then right (or 0, not given)."""
    out, pos, records = bytearray(data), 8, []
    while pos + 9 <= len(out) - 8:
        opcode, length = struct.unpack_from("<BQ", out, pos)
        records.append((opcode, pos + 9, pos + 9 + length))
        pos += 9 + length
    for opcode, body, _ in records:
        if opcode == 15:  # data end: its checksum is optional
            out[body : body + 4] = bytes(4)
        if opcode == 2:  # footer: so is that of the summary
            out[body + 16 : body + 20] = bytes(4)
    opcode, body, end = records[int(rng.integers(len(records)))]
    if opcode == 6:
        name_size = struct.unpack_from("<I", out, body + 28)[0]
        head = body + 32 + name_size + 8
        content = mutate(bytes(out[head:end]), rng)[: end - head]
        content += bytes(end - head - len(content))
        out[head:end] = content
        struct.pack_into("<I", out, body + 24, zlib.crc32(content) if rng.random() < 0.5 else 0)
    else:
        content = mutate(bytes(out[body:end]), rng)[: end - body]
        out[body:end] = content + bytes(end - body - len(content))
    return bytes(out)


def some_run() -> Run:
    """Return a run of 30 scans of 7 rays with every signal."""
    n = 30
    t = np.arange(n) / 10
    poses = np.column_stack([1 + 0.05 * t, 1 + 0 * t, 0.1 * t])
    ranges = 1.0 + 0.3 * np.sin(np.add.outer(3 * t, np.arange(7)))
    ranges[3, 2], ranges[4, 1], ranges[5, 0] = np.inf, -np.inf, np.nan
    arena = b'{"type": "FeatureCollection", "features": []}'
    return Run(
        sensor=RangeSensor(bearings=np.linspace(-1.5, 1.5, 7), range_min=0.05, range_max=8.0, sweep_time=0.01),
        stamps=t, ranges=ranges, pose_stamps=t, poses=poses, odom_stamps=t, odometry=poses,
        odom_twists=np.column_stack([0.05 + 0 * t, 0.1 + 0 * t]), cmd_stamps=t, commands=np.zeros((n, 2)),
        meta={"source": "fuzz"}, attachments={"arena.geojson": arena, "robot.yaml": b"name: a\n"},
    )  # fmt: skip


def _bytes(suffix: str, write: Callable[[Path], object]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a{suffix}"
        write(path)
        return path.read_bytes()


def _read_log(path: Path) -> None:
    """Read a log whole, in pieces, and look into it."""
    run = logs.read(path)
    logs.pair(run)
    for _ in open_log(path).pieces():
        pass
    inspect(path)


def _recover(path: Path) -> None:
    out = path.with_name("recovered.mcap")
    recover(path, out)
    logs.formats.mcap_file.load(out)


def _read_graph(path: Path) -> None:
    graph = Sensorgraph.load(path)
    repr(graph)
    graph.predict(np.array([[1.0, 1.0, 0.2]]))
    graph.equation(0)


def small_bag() -> bytes:
    """Return a rosbag2 sqlite3 file of twelve small scans."""

    def write(path: Path) -> None:
        with contextlib.closing(sqlite3.connect(path)) as base:
            base.execute(
                "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)"
            )
            base.execute(
                "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
            )
            base.execute("INSERT INTO topics VALUES(1, '/scan', 'sensor_msgs/msg/LaserScan', 'cdr')")
            message = (
                b"\x00\x01\x00\x00" + struct.pack("<iI", 1, 0) + struct.pack("<I", 6) + b"laser\0" + bytes(2)
            )
            message += struct.pack("<7f", -1, 1, 1, 0, 0.1, 0, 8) + struct.pack("<I3f", 3, 1, 2, 3) + bytes(4)
            for i in range(12):
                base.execute("INSERT INTO messages VALUES(?, 1, ?, ?)", (i, i * 10**8, message))
            base.commit()

    return _bytes(".db3", write)


def _carmen() -> bytes:
    lines = ["# CARMEN", "PARAM robot_frontlaser_offset 0.1"]
    for i in range(12):
        ranges = " ".join(["1.00"] * 9)
        lines.append(f"ODOM {i / 10} 0 0 0.1 0 0 {i}.0 host {i}.0")
        lines.append(f"FLASER 9 {ranges} {i / 10} 0 0 {i / 10} 0 0 {i}.0 host {i}.0")
        lines.append(
            f"ROBOTLASER1 0 -1.5 3.0 0.4 8.0 0.01 0 9 {ranges} 0 {i / 10} 0 0 0 0 0 0 0 0 0 0 {i}.0 host {i}.0"
        )
    return ("\n".join(lines) + "\n").encode()


GEOJSON = json.dumps({"type": "FeatureCollection", "features": [
    {"type": "Feature", "properties": {"name": "room", "kind": "arena", "surfaces": {"1": "glass"}},
     "geometry": {"type": "Polygon", "coordinates": [[[0, 0], [4, 0], [4, 3], [0, 3], [0, 0]]]}},
    {"type": "Feature", "properties": {"name": "box", "kind": "obstacle"},
     "geometry": {"type": "Polygon", "coordinates": [[[1, 1], [2, 1], [2, 2], [1, 2], [1, 1]]]}}]}).encode()  # fmt: skip
NO_GO = GEOJSON.replace(b'"obstacle"', b'"no_go"')
MAP = b"image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\nmode: trinary\n"
PGM = b"P5\n8 6\n255\n" + bytes([254] * 40 + [0] * 8)
ROBOT = b"""name: a
drive: diff
footprint_radius: 0.2
limits: {v: 0.4, omega: 1.0, a: 0.5, alpha: 2.0, turning_radius: 0.0}
sensor: {mount: [0.1, 0.0, 0.0], n_rays: 18, fov: 3.1, range_min: 0.05, range_max: 8.0, sigma: 0.01, rate: 10.0}
pose: {rate: 30.0, sigma_xy: 0.002}
actuators: {tau: 0.1, delay: 0.0}
"""
EFFECTS = b"""- name: mount_yaw
  parameters: {dyaw: 0.02}
  stderr: {dyaw: 0.001}
  location: {name: null, xy: null}
  probability: 0.9
  evidence: 12.0
"""
TRAJECTORY = (
    b"t,x,y,phi,v,omega,primitive\n0,1,1,0,0,0,move\n0.02,1,1,0,0.1,0,move\n0.04,1.1,1,0,0.1,0,move\n"
)
POSES = b"x,y,phi\n1,1,0\n1.5,1,0.2\n"
SIGNALS = b"t,record,u,y\n" + b"".join(b"%d,0,%d,0.%d\n" % (i, i % 3, i % 7) for i in range(40))
METADATA = b"""rosbag2_bagfile_information:
  version: 5
  storage_identifier: sqlite3
  relative_file_paths: [a.db3]
  message_count: 12
  compression_format: ""
  compression_mode: ""
"""


def _map_yaml(path: Path) -> None:
    path.with_name("map.pgm").write_bytes(PGM)
    maps.load(path)


def _map_image(path: Path) -> None:
    path.with_name("map.yaml").write_bytes(MAP.replace(b"map.pgm", path.name.encode()))
    maps.load(path.with_name("map.yaml"))


def _bag_metadata(path: Path, db3: bytes) -> None:
    folder = path.with_name("bag")
    folder.mkdir(exist_ok=True)
    shutil.copy(path, folder / "metadata.yaml")
    (folder / "a.db3").write_bytes(db3)
    logs.read(folder)


def _graphs() -> tuple[bytes, ...]:
    """Return a small sensorgraph of each of two models."""
    options = {"faces": {"calibrate": False}, "polynomial": {"degree": 2, "harmonics": 1, "n_terms": 4}}
    run = some_run()
    return tuple(_bytes(".sensorgraph", build([run], model=m, **given).save) for m, given in options.items())


def _mcap() -> tuple[bytes, ...]:
    run = some_run()
    return (_bytes(".mcap", lambda p: logs.write(run, p)),)


def _table() -> tuple[bytes, ...]:
    run = some_run()
    return (_bytes(".csv", lambda p: logs.write(run, p)),)


READERS: dict[str, Callable[[], Reader]] = {
    "mcap": lambda: Reader("mcap", _mcap(), ".mcap", _read_log),
    "recover": lambda: Reader("recover", _mcap(), ".mcap", _recover),
    "table": lambda: Reader("table", _table(), ".csv", _read_log),
    "carmen": lambda: Reader("carmen", (_carmen(), gzip.compress(_carmen(), mtime=0)), ".log", _read_log),
    "db3": lambda: Reader("db3", (small_bag(),), ".db3", _read_log),
    "bag_metadata": lambda: Reader(
        "bag_metadata", (METADATA,), ".yaml", partial(_bag_metadata, db3=small_bag())
    ),
    "geojson": lambda: Reader("geojson", (GEOJSON,), ".geojson", maps.load),
    "no_go": lambda: Reader("no_go", (NO_GO,), ".geojson", no_go.read),
    "map_yaml": lambda: Reader("map_yaml", (MAP,), ".yaml", _map_yaml),
    "map_image": lambda: Reader("map_image", (PGM,), ".pgm", _map_image),
    "robot": lambda: Reader("robot", (ROBOT,), ".yaml", load_robot),
    "effects": lambda: Reader("effects", (EFFECTS,), ".yaml", effects_file.read),
    "sensorgraph": lambda: Reader("sensorgraph", _graphs(), ".sensorgraph", _read_graph),
    "trajectory": lambda: Reader("trajectory", (TRAJECTORY,), ".csv", read_csv),
    "poses": lambda: Reader("poses", (POSES,), ".csv", read_poses),
    "signals": lambda: Reader("signals", (SIGNALS,), ".csv", lambda p: signals_of_table(p, ["y", "u"])),
    "model": lambda: Reader("model", (json.dumps(_narmax()).encode(),), ".json", Narmax.load),
}
"""Everything that opens a file, with small whole files to begin from."""


def _narmax() -> object:
    from robotmodic_ident import Terms, fit

    rng = np.random.default_rng(0)
    u = rng.normal(size=200)
    y = np.zeros(200)
    for k in range(1, 200):
        y[k] = 0.5 * y[k - 1] + u[k - 1]
    return fit({"y": y, "u": u}, "y", Terms.parse("1", "y(k-1)", "u(k-1)", "u(k-1)^2"), n_terms=3).to_dict()


@contextlib.contextmanager
def limits(seconds: float) -> Iterator[None]:
    """Stop what takes longer than `seconds`, and refuse more than MEMORY."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise Hung

    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    before = signal.signal(signal.SIGPROF, stop)
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, hard))
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.signal(signal.SIGPROF, before)


def judge(action: Callable[[], object], seconds: float = SECONDS) -> str:
    """Run something; return what is wrong with how it ends, or nothing."""
    try:
        with limits(seconds), warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("error", RuntimeWarning)
            action()
    except OURS as exc:
        text = str(exc)
        if not text.strip() or len(text.splitlines()) > 1:
            return f"{type(exc).__name__} of {len(text.splitlines())} lines: {text[:60]!r}"
        return "" if len(text) < 1500 else f"a line of {len(text)} characters: {text[:60]!r}"
    except Hung:
        return f"takes longer than {seconds:g} s"
    except BaseException as exc:
        frame = next(
            (
                f
                for f in reversed(traceback.extract_tb(exc.__traceback__))
                if "/site-packages/" not in f.filename
            ),
            None,
        )
        where = "" if frame is None else f" at {Path(frame.filename).name}:{frame.lineno}"
        return f"{type(exc).__name__}{where}: {' '.join(str(exc).split())[:80]}"
    return ""


def fuzz_reader(reader: Reader, n: int, seed: int, folder: Path) -> Counter[str]:
    """Try n damaged files; return what was found, counted."""
    rng = np.random.default_rng([seed, zlib.crc32(reader.name.encode())])
    found: Counter[str] = Counter()
    path = folder / f"a{reader.suffix}"
    for _ in range(n):
        data = reader.seeds[int(rng.integers(len(reader.seeds)))]
        kind = rng.random()
        if reader.name == "sensorgraph" and kind < 0.7:
            data = rezip(data, rng)
        elif reader.name in ("mcap", "recover") and kind < 0.7:
            data = remcap(data, rng)
        elif kind < 0.5:
            data = swap_token(data, rng)
        else:
            data = mutate(data, rng)
        path.write_bytes(data)
        wrong = judge(lambda: reader.read(path))
        if wrong:
            found[wrong] += 1
            if found[wrong] == 1:
                kept = folder / "found" / f"{reader.name}-{len(found)}{reader.suffix}"
                kept.parent.mkdir(exist_ok=True)
                kept.write_bytes(data)
    return found


VALUES = (
    "", "0", "-1", "1", "1e308", "nan", "inf", "x", "1,1,0", "1,1", "nan,0,0", "a=b", "scan=/scan", "=", "every10", "block",
    "auto", "mode", "99999999999999999999", "1e-9", "--", "-", "é", "faces", "polynomial", "{run}", "{graph}", "{arena}",
    "{robot}", "{folder}", "{folder}/none", "{bad}", "/dev/null", "square",
)  # fmt: skip
COMMANDS = {
    "inspect": ("inspect {run}", ("--topic", "--arena", "--json", "--no-return")),
    "recover": ("recover {run} -o {folder}/o.mcap", ("--out",)),
    "build": (
        "build {run} -o {folder}/o.sensorgraph --no-calibrate",
        (
            "--arena",
            "--robot",
            "--model",
            "--split",
            "--degree",
            "--harmonics",
            "--terms",
            "--update",
            "--topic",
        ),
    ),
    "evaluate": (
        "evaluate {graph} {run}",
        ("--split", "--cap", "--point", "--effects", "--json", "--topic"),
    ),
    "predict": ("predict {graph} --poses {poses} -o {folder}/o.npz", ("--poses", "--point", "-o")),
    "show": ("show {graph}", ("--ray", "--bearing", "--out", "--run")),
    "record": (
        "record {plan} --arena {arena} -o {folder}/o.mcap",
        ("--arena", "--robot", "--effects", "--seed", "--start", "--graph"),
    ),
    "review": ("review {run} -o {folder}/o.rrd", ("--graph", "--plan", "--arena", "--ray", "-o", "--topic")),
    "plan": (
        "plan {arena} --planner random_bounce --duration 2 -o {folder}/o",
        (
            "--robot",
            "--planner",
            "--cell",
            "--headings",
            "--start",
            "--seed",
            "--no-go",
            "--resume",
            "--duration",
        ),
    ),
    "diagnose": (
        "diagnose {bad} --arena {arena}",
        ("--robot", "--effects", "--seed", "--topic", "--commissioning"),
    ),
    "identify": (
        "identify {signals} --output y --inputs u --lags 1 -o {folder}/o.json",
        (
            "--output",
            "--inputs",
            "--lags",
            "--output-lags",
            "--degree",
            "--noise-lags",
            "--split",
            "--every",
            "--terms",
        ),
    ),
}


def fuzz_commands(n: int, seed: int, folder: Path, names: Sequence[str] = tuple(COMMANDS)) -> Counter[str]:
    """Give n odd options to the commands; return what was found, counted."""
    rng = np.random.default_rng([seed, 1])
    run, files = some_run(), {}
    texts = {
        "arena": (".geojson", GEOJSON),
        "robot": (".yaml", ROBOT),
        "poses": (".csv", POSES),
        "bad": (".mcap", b"\x89"),
    }
    texts |= {"plan": (".csv", TRAJECTORY), "signals": (".csv", SIGNALS)}
    for name, (suffix, data) in texts.items():
        files[name] = folder / f"{name}{suffix}"
        files[name].write_bytes(data)
    files |= {"run": folder / "run.mcap", "graph": folder / "g.sensorgraph", "folder": folder / "out"}
    logs.write(run, files["run"])
    build([run], calibrate=False).save(files["graph"])
    found: Counter[str] = Counter()
    for _ in range(n):
        name = names[int(rng.integers(len(names)))]
        base, options = COMMANDS[name]
        words = base.split()
        for option in rng.choice(options, int(rng.integers(1, 3))):
            words += [str(option), VALUES[int(rng.integers(len(VALUES)))]]
        if rng.random() < 0.2:
            words[int(rng.integers(1, len(words)))] = VALUES[int(rng.integers(len(VALUES)))]
        files["folder"].mkdir(exist_ok=True)
        words = [word.format(**files) for word in words]
        said = io.StringIO()

        def command(words: list[str] = words, said: io.StringIO = said) -> None:
            with contextlib.redirect_stderr(said), contextlib.chdir(folder):
                code = cli(words)
            errors = [line for line in said.getvalue().splitlines() if line.startswith("error")]
            if code not in (0, 2) or (code == 2 and len(errors) != 1):
                raise RuntimeError(f"exit {code}: {errors}")

        wrong = judge(command, COMMAND_SECONDS)
        if wrong:
            found[f"{wrong.replace(str(folder), '')}: {' '.join(words).replace(str(folder), '')}"] += 1
        shutil.rmtree(files["folder"], ignore_errors=True)
        for left in folder.glob("*.part"):
            left.unlink()
    return found


def main() -> int:
    """Fuzz, print a table, and return 1 if anything was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="names of readers, or commands, separated by commas")
    parser.add_argument("--keep", type=Path, help="folder for one input of each finding")
    given = parser.parse_args()
    names = [name for name in (*READERS, "commands") if not given.only or name in given.only.split(",")]
    share = max(given.inputs // len(names), 1)
    folder = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    total = 0
    for name in names:
        began = time.monotonic()
        if name == "commands":
            found = fuzz_commands(share, given.seed, folder)
        else:
            found = fuzz_reader(READERS[name](), share, given.seed, folder)
        seconds = time.monotonic() - began
        print(
            f"{name:14} {share:7,} inputs {seconds:6.0f} s  {found.total():5,} findings of {len(found)} kinds",
            flush=True,
        )
        for wrong, count in found.most_common(12):
            print(f"    {count:5}  {wrong}", flush=True)
        total += found.total()
    print(f"{share * len(names):,} inputs, {total:,} findings", flush=True)
    if given.keep and (folder / "found").is_dir():
        shutil.copytree(folder / "found", given.keep, dirs_exist_ok=True)
    shutil.rmtree(folder)
    return int(total > 0)


if __name__ == "__main__":
    sys.exit(main())
