"""What the next run should answer: two models at a time, one of which is taken for true."""

from __future__ import annotations

from collections.abc import Sequence

from sensorgraph.diagnosis.next_run.forecast import Question
from sensorgraph.diagnosis.result import ChannelResult
from sensorgraph.diagnosis.scan.observability import TIMES, TYPICAL, separation
from sensorgraph.effects import EFFECTS, Amendment

OPEN = 50.0  # [nats] between a name and its rival, above which nothing is left to ask


def ask(result: ChannelResult, model: Sequence[Amendment], rivals: Sequence[Amendment]) -> list[Question]:
    """Make the questions of a scan result.

    What is open comes first: rivals within OPEN nats of a name; then effects that the run could not have shown at
    all; then how large the least sure effect is, or those that could not be shown at some places. A rival that lies
    far behind is asked about no more.

    Parameters
    ----------
    model : the accepted effects
    rivals : of each effect the second best explanation, in the order of `result.rivals`
    """
    accepted = tuple(model)
    close = _close(result, accepted, rivals)
    if close:
        return close[:1]
    hidden = [(name, why, typical(name, why)) for name, why in result.not_observable.items()]
    everywhere = [
        _is_there(one, accepted, why) for _, why, one in hidden if one is not None and not one.place
    ]
    if everywhere:
        return everywhere[:3]
    if accepted:
        worst = max(accepted, key=_doubt)
        rest = tuple(a for a in accepted if a is not worst)
        words, hint = f"how large is the effect of {_called(worst)}", f"it varies with {worst.effect.varies}"
        return [Question(a=accepted, b=rest, words=words, hint=hint)]
    somewhere = [_is_there(one, accepted, why) for _, why, one in hidden if one is not None]
    if somewhere:
        return somewhere[:3]
    usual = (typical(name) for name in ("latency", "mount_yaw", "range_scale"))
    return [_is_there(one, (), "") for one in usual if one is not None]


def _close(
    result: ChannelResult, accepted: tuple[Amendment, ...], rivals: Sequence[Amendment]
) -> list[Question]:
    """Ask about the rivals that the run leaves open, the closest first."""
    evidence = {a.name: a.evidence or 0.0 for a in result.effects}
    found = []
    for told, rival in zip(result.rivals, rivals, strict=True):
        own = next((a for a in accepted if a.name == told.instead_of), None)
        margin = evidence.get(told.instead_of, 0.0) - told.evidence_nats
        if own is not None and margin < OPEN:
            rest = tuple(a for a in accepted if a is not own)
            found.append((margin, between((*rest, own), (*rest, rival))))
    return [question for _, question in sorted(found, key=lambda pair: pair[0])]


def _is_there(unseen: Amendment, accepted: tuple[Amendment, ...], why: str) -> Question:
    """Ask whether an effect of a size that should show is there as well."""
    hint = f"this time {why}" if why else f"it varies with {unseen.effect.varies}"
    return Question(a=(*accepted, unseen), b=accepted, words=f"is there any {_called(unseen)}", hint=hint)


def between(a: Sequence[Amendment], b: Sequence[Amendment]) -> Question:
    """Ask which of two models holds; they differ in their last effect."""
    one, other = a[-1], b[-1]
    words = f"{_called(one)} or {_called(other)}"
    return Question(a=tuple(a), b=tuple(b), words=words, hint=separation(one, other))


def typical(name: str, why: str = "") -> Amendment | None:
    """Return an effect at a size that should show; None where it has no such size or its place is not known.

    Parameters
    ----------
    why : what `not_observable` says; the place of an effect is the first that it names
    """
    effect = EFFECTS[name]
    values = {k: TIMES * m for k, m in effect.sizes.items()}
    if name == "range_drift":
        values["tau"] = 0.0
    if name == "map_scale":
        values |= {"dx": 0.0, "dy": 0.0}
    if name in ("min_range", "incidence_dropout"):
        values = dict(TYPICAL[name])
    elif name == "tilt":
        values = {"beta": TYPICAL[name]["beta"], "theta0": 0.0}
    place = why.split(":")[0].split(",")[0] if ":" in why else ""
    if effect.place in ("wall", "obstacle") and place:
        span = {"a": 0.0, "b": 1e3}
        values |= span if any(p.name == "a" for p in effect.parameters) else {}
        values |= {"glass": {"alpha_ret": 0.35, "depth": 1.0}, "black_surface": {"r0": 1.0}}.get(name, {})
        return effect(**values).at(place)
    if effect.place is not None or not values or name in ("people", "random_outliers"):
        return None
    return effect(**values)


def _doubt(a: Amendment) -> float:
    sizes = a.effect.sizes
    return max((a.stderr.get(k, 0.0) / m for k, m in sizes.items()), default=0.0)


def _called(a: Amendment) -> str:
    """Return an effect as people say it."""
    return f"{a.effect.title} at {a.place}" if a.place else a.effect.title
