"""The processes that answer for OMPL: one fork for each question, whatever happened before."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from planners.errors import PlanError
from planners.joins.ompl_process import HEADER, call_ompl

MODULE = """
import os, sys, signal
import numpy as np
from planners.joins.ompl_process import serve

def work(base, geometric, question):
    print("noise on standard output", flush=True)
    if question["what"] == "die":
        os.kill(os.getpid(), signal.SIGSEGV)
    if question["what"] == "raise":
        raise ValueError("too bad")
    import ompl.util as util
    return {"draw": [util.RNG().uniform01() for _ in range(3)], "twice": 2 * question["number"]}

sys.exit(serve(work))
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "answering.py").write_text(textwrap.dedent(MODULE))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return "answering"


def test_the_same_question_has_the_same_answer_whatever_was_asked_before(module: str) -> None:
    first = call_ompl(module, seed=3, what="draw", number=np.arange(5))
    other = call_ompl(module, seed=4, what="draw", number=np.arange(5))
    again = call_ompl(module, seed=3, what="draw", number=np.arange(5))
    np.testing.assert_array_equal(first["twice"], 2 * np.arange(5))
    np.testing.assert_array_equal(first["draw"], again["draw"])
    assert not np.allclose(first["draw"], other["draw"])


@pytest.mark.parametrize(("what", "said"), [("die", "code -11"), ("raise", "ValueError: too bad")])
def test_a_crash_is_one_error_and_the_next_question_is_answered(module: str, what: str, said: str) -> None:
    with pytest.raises(PlanError, match=said):
        call_ompl(module, seed=1, what=what, number=0)
    assert call_ompl(module, seed=1, what="draw", number=4)["twice"] == 8


def test_questions_side_by_side_are_not_mixed_up(module: str) -> None:
    found: dict[int, float] = {}

    def one(k: int) -> None:
        found[k] = float(call_ompl(module, seed=k, what="draw", number=k)["twice"])

    threads = [threading.Thread(target=one, args=(k,)) for k in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {k: 2.0 * k for k in range(6)}


def test_no_process_outlives_the_one_that_asked(module: str) -> None:
    code = f"""
        import planners.joins.ompl_process as p
        p.call_ompl("{module}", seed=1, what="draw", number=1)
        (servers,) = p._idle.values()
        print(servers[0].process.pid)
    """
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", textwrap.dedent(code)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == ""
    assert not Path(f"/proc/{int(done.stdout)}").exists()


def test_an_answer_that_nobody_waits_for_any_more_is_given_up(tmp_path: Path) -> None:
    working = tmp_path / "pid"
    server = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import os, pathlib, time\n"
            "from planners.joins.ompl_process import serve\n"
            "def work(base, geometric, question):\n"
            f"    pathlib.Path({str(working)!r}).write_text(str(os.getpid()))\n"
            "    while True: time.sleep(0.1)\n"
            "serve(work)",
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
    )
    question = io.BytesIO()
    np.savez(question, seed=np.array(1))
    assert server.stdin is not None
    server.stdin.write(HEADER.pack(len(question.getvalue()), 0) + question.getvalue())
    server.stdin.flush()
    while not (working.exists() and working.read_text()):
        assert server.poll() is None
        time.sleep(0.05)
    server.stdin.close()  # as when the asker is killed
    assert server.wait(timeout=20) == 0
    with pytest.raises(ProcessLookupError):
        os.kill(int(working.read_text()), 0)
