"""What several tests share: shipped arenas, a small sensor, the folder of real logs."""

from __future__ import annotations

import gc
import os
import signal
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

for _threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(
        _threads, "1"
    )  # `-n auto` has a process for each core already; read when numpy loads

# where Python is told to keep no compiled modules, each process that a test starts would compile all of ours again
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# rewritten tests, trees of our modules and compiled kernels are millions of objects; the default is a search every 700
gc.set_threshold(50_000)

import numpy as np
import pytest
import shapely
from hypothesis import settings

from logs.run import RangeSensor
from planners.arena import Arena
from planners.search.settings import SPIN_ROOM
from planners.trajectory import Trajectory
from sensorgraph.cli import run as cli

settings.register_profile("steady", derandomize=True, deadline=None)  # the same examples in every run
settings.register_profile("few", parent=settings.get_profile("steady"), max_examples=40)

REAL = Path(__file__).parents[2] / "shared" / "data"


@pytest.fixture(scope="session", autouse=True)
def ctrl_c() -> Iterator[None]:
    """Let Ctrl-C interrupt, also where the tests run in the background of a shell that has it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def pytest_configure(config: pytest.Config) -> None:
    """Show laws by 40 examples in the quick suite, where they state no number, and by 100 with the slow tests."""
    settings.load_profile("few" if config.getoption("markexpr") == "not slow" else "steady")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let one worker compile the kernels of `build`, half a minute, while the others are at the planners.

    Two that meet a kernel at the same time compile it twice.
    """
    items.sort(
        key=lambda item: (
            item.path.name != "test_building_stream.py",
            not item.path.name.startswith("test_planners"),
        )
    )


def pytest_collection_finish() -> None:
    """Leave the thousands of collected tests out of every later search for garbage."""
    gc.freeze()


@contextmanager
def without_pictures() -> Iterator[None]:
    """Let plans, reports and models of signals be written without pictures, which take a third of the time: where none is looked at."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr("sensorgraph.diagnosis.report.files.draw_all", lambda *_: {})
        for name in ("plan_picture", "reach_picture", "headings_picture"):
            monkeypatch.setattr(f"sensorgraph.planning.plan_folder.{name}", lambda *_: None)
        monkeypatch.setattr("sensorgraph.show.figures.identified.identified_picture", lambda *_: None)
        yield


@pytest.fixture
def no_pictures() -> Iterator[None]:
    """Let a test write no pictures; fixtures of a module use `without_pictures`."""
    with without_pictures():
        yield


@contextmanager
def trusting_scans() -> Iterator[None]:
    """Let graphs be built without the checks of a log and the search for readings of the robot itself.

    Both take up to half of the time of a small graph, and leave the scans of a good log as they are. Their tests are
    test_building_stream.py, test_building_robot_parts.py, test_logs_jumps.py and test_world_self_fit.py.
    """
    with pytest.MonkeyPatch.context() as monkeypatch:
        intake = "sensorgraph.building.training_data"
        for name in ("orientation", "self_fit", "check_jumps"):
            monkeypatch.setattr(f"{intake}.{name}", lambda *_, **__: None)
        monkeypatch.setattr(
            f"{intake}.robot_parts_at_poses", lambda run, _: np.full(run.sensor.n_rays, np.nan)
        )
        yield


@pytest.fixture(scope="module")
def trusted_scans() -> Iterator[None]:
    """Let a module about graphs trust its scans: before its own fixtures, by `pytestmark`."""
    with trusting_scans():
        yield


@contextmanager
def searching_narrowly() -> Iterator[None]:
    """Let drives be searched by a fifth of the beam, a tenth longer: where the claim is not how long they are."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        narrow = SPIN_ROOM._replace(beam_width=SPIN_ROOM.beam_width // 5)
        monkeypatch.setattr("planners.methods.coverage_spins.SPIN_ROOM", narrow)
        yield


@pytest.fixture(scope="module")
def narrow_search() -> Iterator[None]:
    """Let a module search narrowly; single tests use `narrow_search_once`."""
    with searching_narrowly():
        yield


@pytest.fixture
def narrow_search_once() -> Iterator[None]:
    """Let one test search narrowly."""
    with searching_narrowly():
        yield


@pytest.fixture
def no_next_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let commands of a test plan no next run, a third of a diagnosis, where the claim is not about it."""
    monkeypatch.setattr("sensorgraph.diagnosis.diagnose._planned", lambda *_: None)


@pytest.fixture(scope="session")
def real_logs() -> Path:
    """Return the folder of real logs beside the project, or skip."""
    if not REAL.is_dir():
        pytest.skip(f"real logs are not at hand: no folder {REAL.parent.name}/{REAL.name} beside the project")
    return REAL


def further(*examples: object) -> list[object]:
    """Return more examples of a claim that the quick suite shows by others; tuples are several arguments."""
    return [
        pytest.param(*(example if isinstance(example, tuple) else (example,)), marks=pytest.mark.slow)
        for example in examples
    ]


def polygon_arena(*rings: list[tuple[float, float]]) -> Arena:
    """Make an arena of an outer ring and obstacles, corners in order."""
    walls = [(ring[i], ring[(i + 1) % len(ring)]) for ring in rings for i in range(len(ring))]
    free = shapely.Polygon(rings[0])
    for ring in rings[1:]:
        free = free.difference(shapely.Polygon(ring))
    n = len(walls)
    return Arena(
        free=free,
        walls=np.array(walls, dtype=float),
        names=tuple(f"w/edge_{i}" for i in range(n)),
        surfaces=("wall",) * n,
    )


@pytest.fixture(scope="session")
def room() -> Arena:
    """Return a 4 x 3 m room with one square pillar."""
    return polygon_arena(
        [(0, 0), (4, 0), (4, 3), (0, 3)],
        [(2.5, 1.0), (3.0, 1.0), (3.0, 1.5), (2.5, 1.5)],
    )


@pytest.fixture(scope="session")
def hall() -> Arena:
    """Return `scan_samples.hall_arena()`, a 6 x 5 m hall with two pillars."""
    from scan_samples import hall_arena

    return hall_arena()


@pytest.fixture(scope="session")
def sensor() -> RangeSensor:
    """Return 61 rays over half a turn, mounted a little off the centre."""
    return RangeSensor(
        bearings=np.linspace(-np.pi / 2, np.pi / 2, 61), range_max=8.0, mount=np.array([0.1, 0.02, 0.01])
    )


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Drive a little in the square arena; return a folder with the plan folder `plan`, run.mcap, g.sensorgraph and poses.csv."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "plan").mkdir()
    t = np.arange(0, 8.0, 0.02)
    v = 0.1 * np.sin(np.pi * t / t[-1]) ** 2
    x = 0.6 + np.concatenate([[0], np.cumsum((v[1:] + v[:-1]) / 2 * 0.02)])
    poses = np.column_stack([x, np.full_like(t, 0.6), np.zeros_like(t)])
    plan = Trajectory(
        stamps=t, poses=poses, twists=np.column_stack([v, 0 * t]), primitives=np.full(len(t), "move")
    )
    plan.write_csv(folder / "plan" / "trajectory.csv")
    (folder / "plan" / "plan.json").write_text('{"planning_s": 1.25, "seed": 0}')
    assert cli(["record", str(folder / "plan"), "--arena", "square", "-o", str(folder / "run.mcap")]) == 0
    assert cli(["build", str(folder / "run.mcap"), "-o", str(folder / "g.sensorgraph")]) == 0
    (folder / "poses.csv").write_text("x,y,phi\n" + "1,1,0.5\n" * 50)
    return folder


def peak(action: Callable[[], object]) -> int:
    """Return the most memory [bytes] that Python held meanwhile."""
    tracemalloc.start()
    try:
        action()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
