"""The command line: one file per command, which parses, calls the library, saves and prints a summary.

This package imports nothing heavy: each command imports what it needs when it runs.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from typing import Annotated, Any

import typer

from sensorgraph.cli.amend import amend
from sensorgraph.cli.build import build
from sensorgraph.cli.compile import compile_kernels
from sensorgraph.cli.demo import demo
from sensorgraph.cli.design import design
from sensorgraph.cli.diagnose import diagnose
from sensorgraph.cli.evaluate import evaluate
from sensorgraph.cli.export import export
from sensorgraph.cli.fleet import fleet
from sensorgraph.cli.identify import identify
from sensorgraph.cli.influence import influence
from sensorgraph.cli.inspect import inspect
from sensorgraph.cli.locate import locate
from sensorgraph.cli.messages import reset_warnings, with_flags
from sensorgraph.cli.narrow_help import is_narrow, set_narrow
from sensorgraph.cli.plan import plan
from sensorgraph.cli.predict import predict
from sensorgraph.cli.progress import reset_silence
from sensorgraph.cli.record import record
from sensorgraph.cli.recover import recover
from sensorgraph.cli.review import review
from sensorgraph.cli.show import show
from sensorgraph.cli.watch import watch
from sensorgraph.cli.why import why
from sensorgraph.garbage import search_less_often
from sensorgraph.termination import INTERRUPTED, TERMINATED, Terminated, install

COMMANDS: dict[str, Callable[..., None]] = {
    "demo": demo,
    "plan": plan,
    "inspect": inspect,
    "recover": recover,
    "locate": locate,
    "build": build,
    "evaluate": evaluate,
    "predict": predict,
    "show": show,
    "review": review,
    "diagnose": diagnose,
    "why": why,
    "watch": watch,
    "identify": identify,
    "design": design,
    "influence": influence,
    "record": record,
    "export": export,
    "amend": amend,
    "fleet": fleet,
    "compile": compile_kernels,
}

TERMINATED_LINE = "terminated"
THREADS_OF_BLAS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""One thread each, unless they are set: on systems of a few hundred unknowns, threads wait more than they compute."""

app = typer.Typer(
    name="sensorgraph",
    help="Plan a coverage run, log it, and identify equations that predict every range reading at any pose.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

for _name, _command in COMMANDS.items():
    app.command(_name)(_command)


def _show_version(value: bool) -> None:
    if value:
        from sensorgraph.version import __version__

        typer.echo(f"sensorgraph {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and exit."),
    ] = False,
    allow_outside: Annotated[
        bool,
        typer.Option(
            "--allow-outside",
            help="Allow a map's `image` and a bag's file list to refer to files outside their folder.",
        ),
    ] = False,
) -> None:
    reset_silence()
    reset_warnings()
    if allow_outside:
        os.environ["SENSORGRAPH_ALLOW_OUTSIDE"] = "1"


def _one_line(exc: BaseException) -> str:
    return with_flags(" ".join(str(exc).split())) or type(exc).__name__


@cache
def _parser(narrow: bool) -> Any:
    """Return the parser of all commands, made once; a narrow one prints its help as a list."""
    command = typer.main.get_command(app)
    if narrow:
        set_narrow(command)
    return command


def run(arguments: list[str] | None = None) -> int:
    """Run one command; return 0 on success, 2 for an error in the input, 1 for an internal error.

    Ctrl-C returns 130, and SIGTERM 143.
    """
    try:
        code = int(
            _parser(is_narrow()).main(args=arguments, prog_name="sensorgraph", standalone_mode=False) or 0
        )
        if code == INTERRUPTED:  # typer turns Ctrl-C into an exit code
            _print_error("interrupted")
        return code
    except (KeyboardInterrupt, typer.Abort):
        _print_error("interrupted")
        return INTERRUPTED
    except Terminated:
        _print_error(TERMINATED_LINE)
        return TERMINATED
    except Exception as exc:
        cause = _signal_of(exc)
        if cause is None:
            return _report_error(exc)
        is_terminated = isinstance(cause, Terminated)
        _print_error(TERMINATED_LINE if is_terminated else "interrupted")
        return TERMINATED if is_terminated else INTERRUPTED


def _signal_of(exc: BaseException | None) -> BaseException | None:
    """Return the signal that caused an error, or None; a signal while compiled code returns raises a SystemError."""
    while exc is not None and not isinstance(exc, KeyboardInterrupt | Terminated):
        exc = exc.__cause__ or exc.__context__
    return exc


def _report_error(exc: Exception) -> int:
    """Print the error as one line; return the exit code."""
    if hasattr(exc, "format_message") and hasattr(exc, "exit_code"):  # a usage error of the command line
        if type(exc).__name__ == "NoArgsIsHelpError":
            typer.echo(exc.format_message())
            return 0
        context = getattr(exc, "ctx", None)
        used = "sensorgraph" if context is None else context.command_path
        _print_error(f"error: {' '.join(exc.format_message().split()).rstrip('.')}; see `{used} --help`")
        return int(exc.exit_code)
    from logs.errors import LogError
    from planners.errors import PlanError
    from robotmodic_ident.errors import IdentError
    from sensorgraph.errors import SensorgraphError, file_fault

    if isinstance(exc, OSError) and (exc.filename is not None or exc.errno is not None):
        _print_error(f"error: {file_fault(exc)}")
        return 2
    if isinstance(exc, LogError | PlanError | IdentError | SensorgraphError):
        _print_error(f"error: {_one_line(exc)}")
        return 2
    if os.environ.get("SENSORGRAPH_DEBUG"):
        raise exc
    _print_error(
        f"error: internal: {type(exc).__name__}: {_one_line(exc)}; this is a bug in sensorgraph, please report it "
        "with the traceback that SENSORGRAPH_DEBUG=1 prints"
    )
    return 1


def _print_error(line: str) -> None:
    sys.stderr.write(line + "\n")


def main() -> None:
    """Run as the console script `sensorgraph`."""
    if hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # `sensorgraph show ... | head` ends quietly
    install(TERMINATED_LINE)
    search_less_often()
    for name in THREADS_OF_BLAS:
        os.environ.setdefault(name, "1")  # read by numpy when it is imported, which the commands do
    code = run()
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):  # closed by the caller, or a full disk
            stream.flush()
    os._exit(code)  # skip the interpreter's shutdown, where OMPL's bindings print leak notes
