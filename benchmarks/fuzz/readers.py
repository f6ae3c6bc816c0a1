"""Everything that opens a file, and damaged files for it."""

from __future__ import annotations

import gzip
import shutil
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

import logs
from benchmarks.fuzz import samples
from benchmarks.fuzz.damage import mutate, remcap, repack, rezip, swap_token
from benchmarks.fuzz.judge import judge
from logs.inspection import inspect
from logs.recovery import recover
from logs.stream import open_log
from planners import maps
from planners.maps import geojson, no_go
from planners.trajectory import read_csv
from robotmodic_ident import Moments, select
from robotmodic_ident.model import Narmax
from sensorgraph.effects import effects_file
from sensorgraph.graph import Sensorgraph
from sensorgraph.identification.signals import signals_of_table
from sensorgraph.loading import read_poses
from sensorgraph.recording.controllers import PolynomialController
from sensorgraph.world.identified_arena import arena_of
from sensorgraph.world.robot import load_robot

Damage = Callable[[bytes, np.random.Generator], bytes]


@dataclass(frozen=True)
class Reader:
    """One thing that opens a file."""

    make: Callable[[], tuple[bytes, ...]]
    """Makes small whole files."""
    suffix: str
    read: Callable[[Path], object]
    inner: Damage | None = None
    """Damages what lies within a container whose checksums are right afterwards; 7 of 10 files are damaged so."""

    @cached_property
    def seeds(self) -> tuple[bytes, ...]:
        """Small whole files."""
        return self.make()


def damaged(reader: Reader, rng: np.random.Generator) -> bytes:
    """Return one of a reader's files, damaged."""
    data = reader.seeds[int(rng.integers(len(reader.seeds)))]
    kind = rng.random()
    if reader.inner is not None and kind < 0.7:
        return reader.inner(data, rng)
    return swap_token(data, rng) if kind < 0.5 else mutate(data, rng)


def read_log(path: Path) -> None:
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


def _read_walls(path: Path) -> None:
    arena_of(Sensorgraph.load(path))


def _map_yaml(path: Path) -> None:
    path.with_name("map.pgm").write_bytes(samples.PGM)
    maps.load(path)


def _map_image(path: Path) -> None:
    path.with_name("map.yaml").write_bytes(samples.MAP.replace(b"map.pgm", path.name.encode()))
    maps.load(path.with_name("map.yaml"))


def _bag_metadata(path: Path) -> None:
    folder = path.with_name("bag")
    folder.mkdir(exist_ok=True)
    shutil.copy(path, folder / "metadata.yaml")
    (folder / "a.db3").write_bytes(samples.small_bag())
    logs.read(folder)


def _effects(path: Path) -> None:
    effects_file.read(path, geojson.loads(samples.GEOJSON.decode()))


def _model(path: Path) -> None:
    model = Narmax.load(path)
    model.equation()
    names = sorted({f.signal for term in model.terms for f in term} | {model.output})
    record = {name: np.linspace(0.1, 1.0, 20) for name in names}
    with np.errstate(all="ignore"):
        model.predict_osa(record)
        model.predict_mpo(record)


def _controller(path: Path) -> None:
    robot = load_robot()
    PolynomialController.load(path, robot)(np.ones(robot.sensor.n_rays))


def _moments(path: Path) -> None:
    sums = Moments.load(path)
    with np.errstate(all="ignore"):
        select(sums, n_terms=2)


def _runs() -> tuple[bytes, ...]:
    return samples.of_runs(".mcap")


def _bags() -> tuple[bytes, ...]:
    return (*samples.ros1_bags(), *samples.interrupted_bags())


def _zipped() -> tuple[bytes, ...]:
    return (gzip.compress(samples.carmen(), mtime=0),)


READERS: dict[str, Reader] = {
    "mcap": Reader(_runs, ".mcap", read_log, remcap),
    "recover": Reader(_runs, ".mcap", _recover, remcap),
    "table": Reader(lambda: samples.of_runs(".csv"), ".csv", read_log),
    "carmen": Reader(lambda: (samples.carmen(),), ".log", read_log),
    "carmen_gzip": Reader(_zipped, ".log.gz", read_log, repack),
    "wean": Reader(lambda: (samples.wean(),), ".log", read_log),
    "db3": Reader(lambda: (samples.small_bag(),), ".db3", read_log),
    "bag": Reader(samples.ros1_bags, ".bag", read_log),
    "open_bag": Reader(samples.interrupted_bags, ".bag", read_log),
    "lasers": Reader(samples.other_lasers, ".bag", read_log),
    "recover_bag": Reader(_bags, ".bag", _recover),
    "bag_metadata": Reader(lambda: (samples.METADATA,), ".yaml", _bag_metadata),
    "geojson": Reader(lambda: (samples.GEOJSON,), ".geojson", maps.load),
    "no_go": Reader(lambda: (samples.NO_GO,), ".geojson", no_go.read),
    "map_yaml": Reader(lambda: (samples.MAP,), ".yaml", _map_yaml),
    "map_image": Reader(lambda: (samples.PGM,), ".pgm", _map_image),
    "robot": Reader(lambda: samples.ROBOTS, ".yaml", load_robot),
    "effects": Reader(samples.every_effect, ".yaml", _effects),
    "sensorgraph": Reader(samples.graphs, ".sensorgraph", _read_graph, rezip),
    "walls": Reader(samples.graphs, ".sensorgraph", _read_walls, rezip),
    "trajectory": Reader(lambda: (samples.TRAJECTORY,), ".csv", read_csv),
    "poses": Reader(lambda: (samples.POSES,), ".csv", read_poses),
    "signals": Reader(lambda: (samples.SIGNALS,), ".csv", lambda path: signals_of_table(path, ["y", "u"])),
    "model": Reader(samples.models, ".json", _model),
    "controller": Reader(lambda: samples.models()[-1:], ".json", _controller),
    "moments": Reader(lambda: (samples.moments(),), ".npz", _moments, rezip),
}
"""Everything that opens a file, with small whole files to begin from."""


def fuzz_reader(name: str, n: int, seed: int, folder: Path) -> Counter[str]:
    """Try n damaged files; return what was found, counted. One file of each finding is kept in `folder`/found."""
    reader, rng = READERS[name], np.random.default_rng([seed, zlib.crc32(name.encode())])
    found: Counter[str] = Counter()
    path = folder / f"a{reader.suffix}"
    for _ in range(n):
        data = damaged(reader, rng)
        path.write_bytes(data)
        wrong = judge(lambda: reader.read(path)).wrong
        if wrong:
            found[wrong] += 1
            if found[wrong] == 1:
                kept = folder / "found" / f"{name}-{len(found)}{reader.suffix}"
                kept.parent.mkdir(exist_ok=True)
                kept.write_bytes(data)
    return found
