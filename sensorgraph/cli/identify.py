"""`sensorgraph identify`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from logs.errors import MAX_LISTED
from sensorgraph.cli.options import Topics

if TYPE_CHECKING:
    from robotmodic_ident.validation.score import Extrapolation, Score
    from sensorgraph.identification.identify import IdentifiedSignal
    from sensorgraph.identification.signals import SignalData

MAX_NOISE_LAGS = 100
MIN_P_VALUE = 0.001
"""p-value of the residual test below which the standard errors are too small."""


IdentifyFile = Annotated[
    Path,
    typer.Argument(
        metavar="FILE", help="Run, or CSV with named columns (a column `record` separates records)."
    ),
]
IdentifyOutput = Annotated[list[str], typer.Option(metavar="NAME", help="Signal to explain.")]
IdentifyOut = Annotated[
    Path, typer.Option("-o", "--out", metavar="MODEL.json", help="Model file to write, *.json.")
]
IdentifyInputs = Annotated[
    str, typer.Option(metavar="NAME,...", help="Signals that explain the output, separated by commas.")
]
IdentifyLags = Annotated[
    int, typer.Option(min=0, max=1000, metavar="N", help="Input lags: use inputs at k, k-1, ..., k-N.")
]
IdentifyOutputLags = Annotated[
    int, typer.Option(min=0, max=1000, metavar="N", help="Output lags: use outputs at k-1, ..., k-N.")
]
IdentifyDegree = Annotated[int, typer.Option(min=1, max=8, help="Degree of the polynomial.")]
IdentifyNoiseLags = Annotated[
    str,
    typer.Option(
        metavar="N|auto", help="Noise lags: use e(k-1), ..., e(k-N); auto: chosen from the residual."
    ),
]
IdentifySplit = Annotated[
    str,
    typer.Option(
        metavar="half|block|none",
        help="Test data: half (the second half), block (every second tenth) or none (the training data).",
    ),
]
IdentifyEvery = Annotated[int, typer.Option(min=1, help="Use every K-th sample.", metavar="K")]
IdentifyCriterion = Annotated[
    str | None, typer.Option(help="Selects the number of terms: bic, aic, ebic, cv, err_tol or n_terms.")
]
IdentifyTerms = Annotated[
    int | None, typer.Option(min=1, metavar="N", help="Number of terms, or their maximum with --criterion.")
]
IdentifyAuto = Annotated[
    bool, typer.Option("--auto", help="Choose lags, degree and terms with the best free run.")
]


def identify(
    context: typer.Context,
    file: IdentifyFile,
    output: IdentifyOutput,
    out: IdentifyOut,
    inputs: IdentifyInputs = "",
    lags: IdentifyLags = 2,
    output_lags: IdentifyOutputLags = 0,
    degree: IdentifyDegree = 2,
    noise_lags: IdentifyNoiseLags = "0",
    split: IdentifySplit = "half",
    every: IdentifyEvery = 1,
    criterion: IdentifyCriterion = None,
    terms: IdentifyTerms = None,
    auto: IdentifyAuto = False,
    topic: Topics = None,
) -> None:
    """Identify a polynomial model of one signal from others, and test it on held-out data.

    Signals of a run: x y phi cos_phi sin_phi v omega cmd_v cmd_omega, L67
    (the ray nearest to 67°, measured counter-clockwise from the robot's
    right, so 90 is ahead), L45-90 (the mean over these rays).

    Examples:

      sensorgraph identify run.mcap --output L67 --inputs x,y --lags 2 --every 15 -o L67.json

      sensorgraph identify run.mcap --output cmd_omega --inputs L45-90 --lags 1 -o turn.json

      sensorgraph identify motor.csv --output speed --inputs volts --output-lags 2 --noise-lags auto -o motor.json

      sensorgraph identify motor.csv --output speed --inputs volts --auto -o motor.json
    """
    from sensorgraph.cli.inputs import check_output, write_json
    from sensorgraph.cli.messages import print_warnings
    from sensorgraph.identification.identify import IdentificationSpec
    from sensorgraph.identification.identify import identify as identify_model
    from sensorgraph.show.figures.identified import identified_picture

    check_output(out, file, suffix=".json")
    if auto:
        _check_left_to_auto(context)
    question = IdentificationSpec(
        output=_one_output(output), inputs=tuple(n.strip() for n in inputs.split(",") if n.strip()), lags=lags,
        output_lags=output_lags, degree=degree, noise_lags=_noise_lags(noise_lags), split=split,  # type: ignore[arg-type]
        criterion=criterion, n_terms=terms, auto=auto,  # type: ignore[arg-type]
    )  # fmt: skip
    data = _read(file, [question.output, *question.inputs], every, topic)
    found = identify_model(data, question)
    print_warnings(data.log_notes)
    for line in summary_lines(found):
        typer.echo(line)
    write_json(out, {**found.report(), "every": every, "source": file.name})
    picture = out.with_suffix(".png")
    identified_picture(found, picture)
    typer.echo(f"wrote {out}, {picture}")


def _check_left_to_auto(context: typer.Context) -> None:
    """Refuse options that `--auto` does not use."""
    from sensorgraph.errors import SensorgraphError

    sources = {name: context.get_parameter_source(name) for name in ("lags", "output_lags", "degree")}
    given = [
        f"--{name.replace('_', '-')}"
        for name, source in sources.items()
        if source is not None and source.name == "COMMANDLINE"
    ]
    if given:
        raise SensorgraphError(f"--auto chooses lags and degree; leave out {' and '.join(given)}")


def _one_output(given: Sequence[str]) -> str:
    from sensorgraph.errors import SensorgraphError

    names = [name.strip() for text in given for name in text.split(",") if name.strip()]
    if len(names) != 1:
        several = " and ".join(dict.fromkeys(names))
        raise SensorgraphError(
            f"--output names {len(names)} signals, expected 1; "
            + (f"run `identify` once for each of {several}" if names else "name one")
        )
    return names[0]


def _noise_lags(text: str) -> int | Literal["auto"]:
    from sensorgraph.errors import SensorgraphError

    word = text.strip().lower()
    if word == "auto":
        return "auto"
    if word.isdecimal() and int(word) <= MAX_NOISE_LAGS:
        return int(word)
    raise SensorgraphError(f"--noise-lags is {text}, expected 0 to {MAX_NOISE_LAGS}, or auto")


def _read(file: Path, names: list[str], every: int, topic: list[str] | None) -> SignalData:
    from logs import parse_topics, read
    from sensorgraph.cli.progress import reading_bar
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.identification.signals import is_table, signals_of_run, signals_of_table

    if not file.exists():
        raise SensorgraphError(f"{file} does not exist; give a CSV or a run")
    if is_table(file):
        if topic:
            raise SensorgraphError(f"{file} is a CSV and has no topics; leave out --topic")
        return signals_of_table(file, names, every=every)
    with reading_bar() as tick:
        run = read(file, topics=parse_topics(topic or []), progress=tick)
    return signals_of_run(run, names, every=every)


def summary_lines(found: IdentifiedSignal) -> list[str]:
    """Return the printed lines: the data, the terms, the scores, the tests."""
    q, model, scores = found.question, found.model, found.scores
    parts = {"half": "the second half", "block": "every second tenth", "none": "the training data"}
    lines = list(found.data.notes)
    lines += [
        f"{name}: {100 * share:.1f} % of the samples are unknown and left out"
        for name, share in found.unknown.items()
        if share
    ]
    period = "" if found.data.period is None else f" every {found.data.period:g} s"
    reason = "until none was left" if model.stop == "exhausted" else f"selected by {model.stop}"
    lines.append(
        f"{found.n_train:,} samples{period} for training, {scores['one_step'].n:,} for scores ({parts[q.split]}); "
        f"{len(model.terms)} of {len(q.terms)} candidate terms, {reason}"
    )
    lines += _notes(model.notes)
    low, high = model.limits
    if math.isfinite(low) or math.isfinite(high):
        lines.append(f"note: {q.output} is limited to {low:g} ... {high:g}, its range in the training data")
    lines += ["", f"{'term':<28}{'theta':>13}{'stderr':>12}{'err':>10}"]
    for name, theta, stderr, err in zip(
        model.terms.names, model.theta.tolist(), model.stderr.tolist(), model.err.tolist(), strict=True
    ):
        lines.append(
            f"{name:<28}{_coefficient(theta, stderr):>13}{_or_dash(stderr, '.2g'):>12}{_or_dash(err, '.5f'):>10}"
        )
    for name, theta, stderr in zip(
        model.noise_terms.names, model.noise_theta.tolist(), model.noise_stderr.tolist(), strict=True
    ):
        lines.append(f"{name:<28}{theta:>13.6g}{_or_dash(stderr, '.2g'):>12}{'noise':>10}")
    lines += ["", f"{'':<14}{'rmse':>11}{'rrse':>8}{'r':>8}  95 % interval      p      n (effective)"]
    for label, key in (
        ("one step", "one_step"), ("free run", "free_run"), ("persistence", "persistence"), ("mean", "constant")
    ):  # fmt: skip
        lines.append(_row(label, scores[key]))
    if found.free_run is found.one_step:
        lines.append("the model has no output lags: one step and free run are identical")
    if not scores["one_step"].n:
        lines.append(f"no score: {q.output} or its inputs are unknown in the test data")
    elif not found.varies:
        lines.append(f"no r: {q.output} is constant in the test data; use more data or --split block")
    lines += _extrapolation(found.outside)
    if found.validation:
        lines += ["", f"{'residual test':<32}{'statistic':>12}{'p':>10}"]
        lines += [f"{t['test']:<32}{t['statistic']:>12.4g}{t['p_value']:>10.3g}" for t in found.validation]
        lines += _warning_of_stderr(found)
    return [*lines, ""]


def _notes(notes: Sequence[str]) -> list[str]:
    """Return the notes of the model; of many notes on dependent terms only the first `MAX_LISTED`."""
    given = [note for note in notes if note.endswith("was left out")]
    rest = [note for note in notes if note not in given]
    more = (
        [f"{len(given) - MAX_LISTED} more such terms (in the model file)"] if len(given) > MAX_LISTED else []
    )
    return [f"note: {note}" for note in [*given[:MAX_LISTED], *more, *rest]]


def _warning_of_stderr(found: IdentifiedSignal) -> list[str]:
    """Return a warning if the residual is correlated and the standard errors are therefore too small."""
    p_value = next((t["p_value"] for t in found.validation if t["test"] == "e-e"), 1.0)
    if (
        p_value >= MIN_P_VALUE or found.question.auto
    ):  # the standard errors of `auto` already allow for a correlated residual
        return []
    hint = "try --noise-lags auto" if not found.question.noise_lags else "more terms or lags may be missing"
    return [f"the residual is correlated (e-e): the standard errors are too small; {hint}"]


def _extrapolation(outside: Extrapolation) -> list[str]:
    """Return a line with the share of the scored samples outside the training data."""
    if math.isnan(outside.share):
        return []
    if outside.share == 0:
        return ["all scored samples are inside the range of the training data"]
    there = f"RMSE {outside.rmse_outside:.4g} outside"
    if outside.share < 1:
        there += f", {outside.rmse_inside:.4g} inside"
    return [
        f"{100 * outside.share:.1f} % of the scored samples are outside the range of the training data (one step: {there})"
    ]


def _coefficient(theta: float, stderr: float) -> str:
    """Format a coefficient with the digits that are significant given its standard error, at least 6."""
    digits = math.log10(abs(theta) / stderr) if stderr > 0 and theta else 0.0
    return f"{theta:.{min(max(6, math.ceil(digits) + 1), 13)}g}"


def _or_dash(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "–"


def _row(label: str, s: Score) -> str:
    if not math.isfinite(s.r):
        return f"{label:<14}{_or_dash(s.rmse, '.4g'):>11}{_or_dash(s.rrse, '.3f'):>8}{'–':>8}"
    return (
        f"{label:<14}{s.rmse:>11.4g}{s.rrse:>8.3f}{s.r:>8.3f}  {s.r_low:>6.3f} to {s.r_high:<6.3f}"
        f"{s.p_value:>9.2g}  {s.n:,} ({s.n_effective:,.0f})"
    )
