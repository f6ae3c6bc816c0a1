"""Draw the ranking of the candidates by selection round."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.report.quantities import (
    place_text,
)
from sensorgraph.diagnosis.scan.model_selection import Step
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.show.figures.style import (
    ALARM,
    INK,
    SOFT,
    TEAL,
    new_figure,
    reduce_frame,
    save_figure,
)

MAX_ROUNDS, MAX_CANDIDATES = 5, 5
"""Maximum numbers of rounds and of candidates per round in the picture."""


def ranking_picture(finding: Finding, path: Path) -> None:
    """Draw the log Bayes factor of each candidate, by selection round."""
    assert finding.explained is not None
    steps = [step for step in finding.explained.steps if step.tried][:MAX_ROUNDS]
    rounds = [(step, _distinct(step.tried)) for step in steps]
    lines = sum(len(tried) for _, tried in rounds) + 0.9 * len(rounds)
    height = max(0.27 * lines + 0.5, 1.5)
    figure = new_figure(10.0, height, layout=None)
    axes = figure.subplots()
    figure.subplots_adjust(right=0.97, top=1 - 0.08 / height, bottom=0.42 / height)
    y = 0.0
    ticks: list[float] = []
    labels: list[str] = []
    best = max(gain for _, tried in rounds for _, gain in tried)
    top = max(best, 2 * SCAN.selection.threshold)
    for k, (step, tried) in enumerate(rounds, start=1):
        axes.text(
            0.008 * top,
            y + 0.05,
            f"round {k}: {_outcome(step, k)}",
            fontsize=8,
            color=SOFT,
            va="center",
            fontweight="bold",
        )
        y -= 0.9
        lead = tried[0][1]
        for i, (a, gain) in enumerate(tried):
            taken = bool(step.chosen) and i == 0
            axes.barh(y, max(gain, 0.0), color=TEAL if taken else "#b9c0cc", height=0.7)
            behind = "" if i == 0 else f"   ({gain - lead:+,.0f} to the first)"
            axes.text(
                max(gain, 0) + 0.006 * top,
                y,
                f"{gain:,.0f}{behind}".replace("-", "−"),
                va="center",
                fontsize=8,
                color=INK,
            )
            ticks.append(y)
            labels.append(", ".join(filter(None, [a.effect.title, place_text(a)])))
            y -= 1.0
    axes.set_yticks(ticks, labels, fontsize=8.5, color=INK)
    widest = max(label.get_window_extent().width for label in axes.get_yticklabels())
    figure.subplots_adjust(left=max(0.30, widest / figure.bbox.width + 0.015))
    axes.set(xlim=(0, 1.25 * top), ylim=(y + 0.4, 0.6))
    axes.axvline(SCAN.selection.threshold, color=ALARM, lw=0.9, ls=(0, (4, 3)))
    axes.set_xlabel(
        f"log Bayes factor; dashed: threshold for a name ({SCAN.selection.threshold:g})",
        fontsize=8,
        color=INK,
        loc="right",
    )
    reduce_frame(axes)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    save_figure(figure, path)


def _outcome(step: Step, number: int) -> str:
    """Describe the result of a round."""
    if not step.chosen:
        return "no further effect is accepted" if number > 1 else "no effect is accepted"
    if not step.became:
        return "the first is accepted"
    model = ", ".join(a.effect.title for a in step.became)
    return f"the first is accepted; the model becomes {model}"


def _distinct(tried: Sequence[tuple[Amendment, float]]) -> list[tuple[Amendment, float]]:
    """Return the best candidates, with each effect at each place once."""
    out: list[tuple[Amendment, float]] = []
    for a, gain in tried:
        if not any(a.name == b.name and (a.place == b.place and abs(gain - g) < 1) for b, g in out):
            out.append((a, gain))
    return out[:MAX_CANDIDATES]
