"""The process that `limited` starts: it reads tasks from standard input and writes answers to standard output."""

from __future__ import annotations

import gc
import json
import os
import sys
import threading
from importlib import import_module
from queue import SimpleQueue
from typing import Any, TextIO

from sensorgraph.termination import install


def _limit_memory(megabytes: float) -> None:
    """Limit the data of this process, on systems that can."""
    try:
        import resource
    except ImportError:
        return
    most = int(megabytes * 1e6)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))


def _read_tasks(tasks: SimpleQueue[str]) -> None:
    """Pass tasks on; end this process with the one that started it, also in the middle of a task."""
    for line in sys.stdin:
        tasks.put(line)
    os._exit(0)


def _answer(task: dict[str, Any]) -> dict[str, Any]:
    module, _, name = task["work"].partition(":")
    try:
        return {"result": getattr(import_module(module), name)(task["arguments"])}
    except MemoryError:
        return {"error": "memory", "is_memory": True}
    except Exception as exc:  # every failure is the error line of its log
        text = " ".join(str(exc).split()) or type(exc).__name__
        return {"error": text if _is_ours(exc) else f"{type(exc).__name__}: {text}"}


def _is_ours(exc: Exception) -> bool:
    return type(exc).__module__.split(".")[0] in ("sensorgraph", "logs", "planners", "robotmodic_ident")


def main() -> None:
    """Answer tasks until standard input ends."""
    install()
    _limit_memory(float(sys.argv[1]))
    # other code may print: it goes to standard error
    answers: TextIO = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    tasks: SimpleQueue[str] = SimpleQueue()
    threading.Thread(target=_read_tasks, args=(tasks,), daemon=True).start()
    answers.write("ready\n")
    answers.flush()
    while True:
        answer = _answer(json.loads(tasks.get()))
        answers.write(json.dumps(answer) + "\n")
        answers.flush()
        gc.collect()


if __name__ == "__main__":
    main()
