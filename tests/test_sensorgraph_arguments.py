"""Arguments of a wrong type are refused in one line that names the argument, what came and what is expected."""

from __future__ import annotations

import copy
import inspect
import pickle
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

import numpy as np
import pytest

import sensorgraph as sg
from logs.run import RangeSensor, Run
from planners.arena import Arena
from sensorgraph.arguments import MADE_BY, AtLeast, Count, expected, fits
from sensorgraph.building.build import build, option_types
from sensorgraph.effects import Amendment
from sensorgraph.errors import (
    MissingFileError,
    SensorgraphError,
    SensorgraphFileError,
    as_sensorgraph_error,
)
from sensorgraph.graph import Sensorgraph
from sensorgraph.models import MODELS
from sensorgraph.models.base import Prediction, TrainingScans
from sensorgraph.nearby_likelihood import NearbyLikelihood
from sensorgraph.planning.plan import CoveragePlan
from sensorgraph.types import Floats
from sensorgraph.watching.observation import Observation

FUNCTIONS = [getattr(sg, name) for name in sg.__all__ if inspect.isfunction(getattr(sg, name))]
METHODS = [
    Sensorgraph.predict, Sensorgraph.log_likelihood, Sensorgraph.near, Sensorgraph.sample, Sensorgraph.save,
    Sensorgraph.with_pose_errors, Prediction.interval, Prediction.save, CoveragePlan.save,
]  # fmt: skip
BOTH: list[Callable[..., Any]] = [*FUNCTIONS, *METHODS]


class Stranger:
    """An object that no argument takes."""


@pytest.fixture(scope="module")
def graph(room: Arena, sensor: RangeSensor) -> Sensorgraph:
    rng = np.random.default_rng(1)
    poses = np.column_stack([rng.uniform(0.4, 2.2, (200, 2)), rng.uniform(-np.pi, np.pi, 200)])
    scans = TrainingScans(
        sensor=sensor, poses=poses, ranges=rng.uniform(1.0, 2.0, (200, sensor.n_rays)), run=np.zeros(200, dtype=np.intp)
    )  # fmt: skip
    model = MODELS["polynomial"].fit(scans, degree=1, harmonics=1)
    return Sensorgraph(model=model, sensor=sensor, pose_frame="base_link", origin={})


@pytest.mark.parametrize(
    ("hint", "right", "wrong", "words"),
    [
        (int, [3, np.int64(3), np.array(3)], ["3", 3.0, True, None, [3]], "a whole number"),
        (float, [3, 0.5, np.float32(2), np.array(0.5)], ["0.5", True, None, [0.5], 1j], "a number"),
        (bool, [True, np.True_, 0, 1], ["no", None, 2, 0.5], "True or False"),
        (str, ["a", np.str_("a")], [b"a", 1, None, ["a"]], "a text"),
        (Path | str, ["a", Path("a")], [b"a", 1, None, ["a"]], "a path"),
        (float | None, [None, 1.0], ["1"], "a number or None"),
        (Literal["a", "b"], ["a"], ["c", ["a"], None], "'a' or 'b'"),
        (Count, [0, np.int32(4)], [-1, 1.5, "1"], "a whole number from 0 on"),
        (Annotated[float, AtLeast(0)], [0.0, 1], [-0.1, np.nan], "a number from 0 on"),
        (
            Sequence[str],
            [["a"], ("a",), {"a"}, np.array(["a"]), iter([1])],
            ["a", [1], {"a": 1}, 5, None],
            "a list (each a text)",
        ),
        (str | Sequence[str], ["a", ["a"]], [5, [5]], "a text or a list of these"),
        (Mapping[str, str], [{"a": "b"}], [{"a": 1}, "a=b", ["a"]], "a dict"),
        (
            tuple[float, float],
            [(0.1, 1), [0.1, 1.0], np.array([0.0, 1.0])],
            [0.3, (1,), "01", ("0", "1")],
            "2 values (each a number)",
        ),
        (Callable[[int], None], [print], [True, None], "a function"),
        (Run, [], [Run, None, "a"], "a Run (from `sg.read(...)`)"),
        (Floats, ["anything", None], [], None),
        (Any, [None, Stranger()], [], None),
    ],
)
def test_what_a_type_hint_allows(hint: Any, right: list[Any], wrong: list[Any], words: str | None) -> None:
    assert [value for value in right if not fits(value, hint)] == []
    assert [value for value in wrong if fits(value, hint)] == []
    assert words is None or expected(hint) == words


def test_a_wrong_element_is_named() -> None:
    @as_sensorgraph_error
    def function(effects: Sequence[Amendment] | Path | str) -> None: ...

    effect = sg.EFFECTS["range_bias"]
    function([effect(b=0.1)])
    with pytest.raises(SensorgraphError, match=r"^`effects\[1\]` is an Effect, expected an Amendment \(from"):
        function([effect(b=0.1), effect])  # type: ignore[list-item]
    with pytest.raises(
        SensorgraphError, match=r"^`effects` is an Amendment, expected a list \(each an Amend"
    ):
        function(effect(b=0.1))  # type: ignore[arg-type]


def test_an_iterator_is_not_consumed() -> None:
    @as_sensorgraph_error
    def function(texts: Sequence[str] | Iterator[str]) -> list[str]:
        return list(texts)

    assert function(iter("ab")) == ["a", "b"]


@pytest.mark.parametrize("function", BOTH, ids=lambda function: function.__qualname__)
def test_every_function_refuses_a_stranger_for_each_argument(function: Callable[..., Any]) -> None:
    hints = get_type_hints(function, include_extras=True)
    named = [name for name in hints if name not in ("return", "options")]
    checked = [name for name in named if not fits(Stranger(), hints[name])]
    if function.__name__ != "near":
        assert checked
    for name in checked:
        with pytest.raises(SensorgraphError, match=rf"^`{name}` is a Stranger, expected ") as error:
            function(**{name: Stranger()})
        assert "\n" not in str(error.value)


def test_options_of_models_and_specifications_have_types() -> None:
    hints = get_type_hints(build)
    for model in MODELS.values():
        for name, kind in model.OPTIONS.items():
            assert option_types()[name] == kind and name not in hints
    for call, words in (
        (lambda: sg.build("absent.mcap", degree="2"), "`degree` is '2', expected a whole number or 'auto'"),
        (
            lambda: sg.build("absent.mcap", calibrate="no"),
            "`calibrate` is 'no', expected True or False or None",
        ),
        (lambda: sg.build("absent.mcap", cell="10 cm"), "`cell` is '10 cm', expected a number"),
        (lambda: sg.build("absent.mcap", update=4), "`update` is 4, expected a Sensorgraph"),
        (
            lambda: sg.identify("absent.csv", output="y", lags=-1),
            "`lags` is -1, expected a whole number from 0",
        ),
        (
            lambda: sg.identify("absent.csv", output="y", every=0),
            "`every` is 0, expected a whole number from 1",
        ),
        (lambda: sg.EFFECTS["range_bias"](b="3 cm"), "`b` is '3 cm', expected a number"),
    ):  # type: tuple[Callable[[], object], str]
        with pytest.raises(SensorgraphError, match="^" + re.escape(words)):
            call()


def test_the_call_that_makes_an_object_exists() -> None:
    made = {name: call.partition("(")[0] for name, call in MADE_BY.items() if call.startswith("sg.")}
    for name, call in made.items():
        maker = getattr(sg, re.sub(r"\W.*", "", call.removeprefix("sg.")))
        result = maker["range_bias"].__call__ if isinstance(maker, dict) else maker
        returned = maker if inspect.isclass(maker) else get_type_hints(result)["return"]
        assert returned.__name__ == name


@pytest.mark.parametrize(
    "call",
    [
        lambda path: sg.read(path),
        lambda path: sg.load(path),
        lambda path: sg.load_robot(path),
        lambda path: sg.build(path),
        lambda path: sg.predict(path, [0.0, 0.0, 0.0]),
        lambda path: sg.read(path, robot=path),
        lambda path: sg.plan("square", priority=path),
        lambda path: next(sg.watch(path, path)),
    ],
)
def test_a_missing_file_is_named(call: Callable[[str], object], tmp_path: Path) -> None:
    path = str(tmp_path / "absent.mcap")
    with pytest.raises(
        MissingFileError, match=r"absent.mcap: No such file or directory; give a path"
    ) as error:
        call(path)
    assert isinstance(error.value, SensorgraphError) and isinstance(error.value, FileNotFoundError)
    assert error.value.filename == path
    assert str(pickle.loads(pickle.dumps(error.value))) == str(error.value)


def test_a_file_that_cannot_be_written_is_named(graph: Sensorgraph, tmp_path: Path) -> None:
    for folder, kind in ((tmp_path, SensorgraphFileError), (tmp_path / "no" / "a.npz", MissingFileError)):
        for save in (graph.save, graph.predict([1.0, 1.0, 0.0]).save):
            with pytest.raises(kind, match=re.escape(str(folder))) as error:
                save(folder)
            assert isinstance(error.value, OSError)


def test_poses_changed_after_a_prediction_do_not_change_it(graph: Sensorgraph) -> None:
    particles = np.array([[1.0, 1.0, 0.3], [1.5, 1.0, 0.0]])
    found = graph.predict(particles)
    before = found.quantile(0.3)
    particles += 0.5
    np.testing.assert_array_equal(found.quantile(0.3), before)


def test_wrong_values_of_a_distribution_are_one_line(graph: Sensorgraph) -> None:
    found = graph.predict([[1.0, 1.0, 0.3], [1.5, 1.0, 0.0]])
    n = graph.sensor.n_rays
    for q in (0.3, np.float32(0.3), np.full(n, 0.3), [[0.3], [0.4]], np.full((2, n), 0.3)):
        assert found.quantile(q).shape == found.cdf(q).shape == found.pdf(q).shape == (2, n)
    calls: dict[str, Callable[[], object]] = {
        f"q has shape (2,), expected one number, ({n},) for one of each ray": lambda: found.quantile(
            [0.1, 0.5]
        ),
        "z has shape (0,), expected": lambda: found.cdf([]),
        "z of type str holds no real numbers": lambda: found.pdf("a"),  # type: ignore[arg-type]
        "q of type NoneType holds no real numbers": lambda: found.quantile(None),  # type: ignore[arg-type]
        "q is 2, expected": lambda: found.quantile(2.0),
        "`p` is '90%', expected a number": lambda: found.interval("90%"),  # type: ignore[arg-type]
        "p is 90, expected a number above 0": lambda: found.interval(90),
        "point is 'avg', expected one of": lambda: found.point("avg"),  # type: ignore[arg-type]
        "the prediction has no distribution": lambda: found.take(slice(1)).quantile(0.5),
    }
    for words, call in calls.items():
        with pytest.raises(SensorgraphError, match="^" + re.escape(words)) as error:
            call()
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "poses", [None, "1,2,0", [1.0, 2.0], [], np.zeros((3, 4)), np.datetime64(5, "s"), [1j] * 3]
)
def test_poses_that_are_none_are_refused_everywhere(graph: Sensorgraph, poses: Any) -> None:
    near: NearbyLikelihood | None = None
    for call in (
        lambda: graph.predict(poses),
        lambda: graph.log_likelihood(np.ones(graph.sensor.n_rays), poses),
        lambda: graph.near(np.ones(graph.sensor.n_rays), poses),
        lambda: graph.sample(poses),
        lambda: (near or graph.near(np.ones(graph.sensor.n_rays), [1.0, 1.0, 0.0])).log_likelihood(poses),
    ):  # type: Callable[[], object]
        with pytest.raises(SensorgraphError, match=r"poses (has shape|of type)"):
            call()


def test_tables_take_lists_and_single_poses(graph: Sensorgraph) -> None:
    near = graph.near(np.ones(graph.sensor.n_rays), [1.0, 1.0, 0.0])
    one, several = near.log_likelihood([1.0, 1.0, 0.0]), near.log_likelihood([[1.0, 1.0, 0.0]] * 2)
    np.testing.assert_array_equal(several, [one[0], one[0]])
    with pytest.raises(SensorgraphError, match="poses is empty"):
        graph.near(np.ones(graph.sensor.n_rays), np.zeros((0, 3)))


def test_observations_are_arrays_or_refused() -> None:
    made = Observation(stamp=0, ranges=[1, 2], odometry=[0, 0, 0])  # type: ignore[arg-type]
    assert made.ranges.dtype == made.odometry.dtype == np.float64  # type: ignore[union-attr]
    for values, words in (
        ({"stamp": "0"}, "`stamp` is '0', expected a number"),
        ({"ranges": None}, "ranges of type NoneType"),
        ({"ranges": [[1.0]]}, r"ranges has shape \(1, 1\), expected \(n_rays,\)"),
        ({"odometry": [0.0, 0.0]}, r"odometry has shape \(2,\), expected \(3,\): x, y, phi"),
    ):  # type: tuple[dict[str, Any], str]
        with pytest.raises(SensorgraphError, match=words):
            Observation(**{"stamp": 0.0, "ranges": np.ones(2), **values})


def test_the_message_on_the_page_is_the_message(graph: Sensorgraph) -> None:
    page = (Path(__file__).parents[1] / "docs/pages/api/sensorgraph.md").read_text()
    sensor = RangeSensor(bearings=np.zeros(1))
    run = Run(sensor=sensor, stamps=np.zeros(1), ranges=np.ones((1, 1)))
    with pytest.raises(SensorgraphError) as error:
        sg.predict(run, [0.0, 0.0, 0.0])  # type: ignore[arg-type]
    assert f"sensorgraph.errors.SensorgraphError: {error.value}\n" in page
    for array in (np.array([1, 2, 0]), np.float32([1, 2, 0]), [1, 2, 0], np.ma.masked_array([1.0, 2.0, 0.0])):
        assert sg.predict(graph, array).ranges.dtype == np.float64


@pytest.mark.parametrize(
    "copied", [copy.copy, copy.deepcopy, lambda thing: pickle.loads(pickle.dumps(thing))]
)
def test_graphs_and_predictions_are_copied(graph: Sensorgraph, copied: Callable[[Any], Any]) -> None:
    pose = [1.0, 1.0, 0.3]
    found = graph.predict(pose)
    again = copied(found)
    np.testing.assert_array_equal(again.quantile(0.3), found.quantile(0.3))
    np.testing.assert_array_equal(copied(graph).predict(pose).mean, found.mean)
