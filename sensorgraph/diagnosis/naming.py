"""Name the effects of an accepted model, with a probability each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import expit

from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.report.quantities import brief
from sensorgraph.diagnosis.result import ChannelResult, Deviation, Rival, Unknown, Withdrawn
from sensorgraph.diagnosis.scan.families import FAMILIES
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.goodness_of_fit import GoodnessOfFit
from sensorgraph.diagnosis.scan.materiality import changes_too_few, is_map_error, required_ratio
from sensorgraph.diagnosis.scan.model_selection import Explained
from sensorgraph.diagnosis.scan.observability import separation
from sensorgraph.diagnosis.scan.ranking import n_parameters
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.site_variation import is_within_baseline
from sensorgraph.diagnosis.scan.standard_errors import evidence_beside_wander, material_probability
from sensorgraph.effects import Amendment
from sensorgraph.effects.actuator_lag import ACTUATOR_LAG
from sensorgraph.effects.dead_time import DEAD_TIME
from sensorgraph.effects.effect import Effect, size_ratio
from sensorgraph.effects.pose_clock_offset import POSE_CLOCK_OFFSET
from sensorgraph.effects.speed_saturation import SPEED_SATURATION

AT_MOST = 0.99
"""Share of the maximum scale of map and poses, above which they count as widened to the limit."""
CANCELS = 4.0
"""Minimum ratio of a clock offset to its standard error; below it, a dead time may cancel it by chance."""
IMITATED = "the mean error of a reference that drifts may imitate it"
PART_OF_UNKNOWN = "it may be a part of a difference that no effect explains"
"""Reasons why an effect with sufficient evidence is not named."""
WRONG_BY_HALF = 0.5
"""Absolute scale error of a wheel, above which odometry and reference poses do not belong together."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanNames:
    """Result of the scan channel, and the effects that it accepts."""

    result: ChannelResult
    complete: tuple[Amendment, ...] = ()
    """All effects of the model with evidence and probability, in its order."""
    small: Mapping[int, str] = field(default_factory=dict)
    """Index in `complete` -> reason why the effect is within tolerance; empty if it is not."""
    accepted: tuple[Amendment, ...]
    """Fitted effects that are material and not contradicted by unmodelled structure, in the order of the model."""
    rivals: tuple[Amendment, ...]
    """The second-best explanations, in the order of `result.rivals`."""

    @property
    def named(self) -> list[Amendment]:
        """Accepted effects without an equally likely rival."""
        undecided = {(a.name, a.place) for a in self.result.undecided}
        return [a for a in self.accepted if (a.name, a.place) not in undecided]


def name_scan_effects(
    data: ScanData,
    explained: Explained,
    fit: GoodnessOfFit,
    deviations: Sequence[Deviation],
    *,
    echoes: Set[int] = frozenset(),
) -> ScanNames:
    """Sort an accepted model into named effects, effects within tolerance, rivals and unmodelled structure.

    An effect is *named* if it is reported as the cause of a difference.

    Parameters
    ----------
    fit : Goodness of fit of the accepted model.
    deviations : From the simulator without any effect.
    echoes : Indices in the model of whole-sensor effects that only reflect something local.
    """
    final = explained.final
    complete = [
        replace(
            located(amendment, data),
            evidence=explained.gains[index],
            probability=probability(explained, index, fit),
        )
        for index, amendment in enumerate(final.model)
    ]
    small = {i: _why_small(explained, i, data, echoes) for i in range(len(final.model))}
    material = {i for i, words in small.items() if not words}
    # the mean error of a drifting reference is a rival as well
    margin = SCAN.naming.rival_margin
    imitated = {i for i in material if evidence_beside_wander(final, final.model[i]) < margin}
    material -= imitated
    doubted = {i for i in material if is_doubted(explained, i, fit)}
    accepted = sorted(material - doubted)
    order = sorted(accepted, key=lambda i: -explained.gains[i])
    rivals = [(i, *explained.rivals[i]) for i in order if i in explained.rivals]
    result = ChannelResult(
        channel="scan",
        effects=tuple(complete[i] for i in order),
        within_tolerance=tuple(a for i, a in enumerate(complete) if i not in material | imitated),
        withdrawn=tuple(
            Withdrawn(amendment=complete[i], why=IMITATED if i in imitated else _why_doubted(explained, fit))
            for i in sorted(imitated | doubted)
        ),
        not_observable={
            a.name: f"{brief(a)} is within the possible mean error of a reference that drifts"
            for a in (complete[i] for i in sorted(imitated))
        },
        unknown=_unknown(fit),
        rivals=tuple(
            Rival(
                name=rival.name,
                instead_of=complete[i].name,
                evidence_nats=explained.gains[i] - short,
                separates=separation(complete[i], rival),
                required_nats=_margin(data, complete[i], rival),
            )
            for i, rival, short in rivals
        ),
        deviations=tuple(deviations),
        notes={"immaterial": list(fit.immaterial)} if fit.immaterial else {},
    )
    return ScanNames(
        result=without_close_calls(result),
        complete=tuple(complete),
        small=small,
        accepted=tuple(final.model[i] for i in accepted),
        rivals=tuple(rival for _, rival, _ in rivals),
    )


def without_close_calls(result: ChannelResult) -> ChannelResult:
    """Move effects with an equally likely rival to the undecided ones, unless the rival is named itself."""
    names = {a.name for a in result.effects}
    rivals = [rival for rival in result.rivals if rival.name not in names]
    close = [a for a in result.effects if any(_is_close(a, rival) for rival in rivals)]
    named = tuple(a for a in result.effects if a not in close)
    return replace(result, effects=named, undecided=(*result.undecided, *close))


def _is_close(a: Amendment, rival: Rival) -> bool:
    """Tell whether the evidence does not decide between an effect and its rival.

    A rival that is far ahead was rejected for another reason, and is not close.
    """
    return rival.instead_of == a.name and abs((a.evidence or 0.0) - rival.evidence_nats) < rival.required_nats


def _margin(data: ScanData, a: Amendment, rival: Amendment) -> float:
    """Return the lead [nats] that an effect needs over its rival.

    At a commissioned site, the lead must also exceed the evidence that clutter brings.
    """
    usual = data.baseline_intervals.get(rival.name)
    is_special = n_parameters(rival) > n_parameters(a)  # as a warm-up, which is a bias if it ends at once
    if a.name not in data.clutter_leads or usual is None or usual.contains(rival, usual.stderr) or is_special:
        return SCAN.naming.rival_margin
    return max(SCAN.naming.rival_margin, data.clutter_leads[a.name], data.clutter_leads.get(rival.name, 0.0))


def located(amendment: Amendment, data: ScanData) -> Amendment:
    """Return an effect at the place that its fitted parameters give."""
    values = amendment.parameters
    if amendment.effect.place == "spot":
        return amendment.at("", (values["x"], values["y"]))
    if {"a", "b"} <= set(values) and amendment.place in data.arena.names:
        start, end = data.arena.walls[data.arena.names.index(amendment.place)]
        along = (end - start) / max(float(np.hypot(*(end - start))), 1e-9)
        return amendment.at(amendment.place, start + along * (values["a"] + values["b"]) / 2)
    return amendment


def _why_small(explained: Explained, index: int, data: ScanData, echoes: Set[int]) -> str:
    """Return why an effect of the model is within tolerance; empty if it is not."""
    a = explained.final.model[index]
    if index in echoes:
        return "it only reflects something local"
    if words := why_immaterial(explained.final, a):
        return words
    if explained.gains[index] <= data.clutter_leads.get(a.name, 0.0):
        return "the known-good runs of the site bring it as much evidence"
    return ""


def is_material(fitted: Fitted, amendment: Amendment) -> bool:
    """Tell whether an effect is large enough to be named, with sufficient probability."""
    return not why_immaterial(fitted, amendment)


def why_immaterial(fitted: Fitted, amendment: Amendment) -> str:
    """Return why an effect is not surely large enough to be named; empty if it is."""
    if _is_blurred_corner(amendment):
        return f"it is shorter than {100 * SCAN.naming.min_part:.0f} cm, as a blurred corner is"
    if is_within_baseline(fitted, amendment):
        return "it is within what the known-good runs of the site show"
    if not is_measured(amendment):
        return "the run does not determine its size"
    if is_map_error(fitted, amendment):
        return "it is within the errors of the map"
    if changes_too_few(fitted, amendment):
        return "it changes too few readings"
    least = required_ratio(fitted, amendment)
    chance = material_probability(amendment, amendment.stderr, least)
    if chance >= SCAN.naming.min_material_probability:
        return ""
    return (
        f"the probability that it exceeds {least:.2g} times its materiality is {100 * chance:.0f} %, "
        f"and {100 * SCAN.naming.min_material_probability:.0f} % is required"
    )


def _is_blurred_corner(amendment: Amendment) -> bool:
    """Tell whether a part of a wall is so short that it may be a blurred corner."""
    values = amendment.parameters
    return amendment.effect.on_part_of_wall and values["b"] - values["a"] < SCAN.naming.min_part


def is_measured(amendment: Amendment) -> bool:
    """Tell whether the run determines the size of an effect: the size exceeds its standard error."""
    sizes = [k for k in amendment.effect.sizes if k in amendment.parameters]
    error = sum((amendment.stderr.get(k, 0.0) / amendment.effect.sizes[k]) ** 2 for k in sizes) ** 0.5
    return not sizes or error < size_ratio(amendment.effect, amendment.parameters)


def is_doubted(explained: Explained, index: int, fit: GoodnessOfFit) -> bool:
    """Tell whether an effect loses its name to unmodelled structure, of the same kind or of the whole room."""
    if index in fit.failed or _fits_nowhere(explained.final):
        return True
    if explained.final.model[index].effect.diagnostics.is_lattice:
        return False
    naming, is_coarse = SCAN.naming, explained.final.solver.data.grain > 0
    share = naming.max_pixel_share if is_coarse else naming.max_unexplained_share
    if fit.is_of_building:
        share = naming.max_building_share
    return fit.is_doubted and fit.misfit > share * explained.gains[index]


def _why_doubted(explained: Explained, fit: GoodnessOfFit) -> str:
    """Return why effects lose their names (`is_doubted`)."""
    if _fits_nowhere(explained.final):
        return "map and reference poses are both far less accurate than specified"
    if not fit.is_doubted:
        return "it is a fringe of the readings of another effect, or a bulge of a wall"
    return f"it may be a part of what no effect explains: {FAMILIES.get(fit.family, fit.statement)}"


def probability(explained: Explained, index: int, fit: GoodnessOfFit) -> float:
    """Return the probability that a name is right and its size material, calibrated on development cases."""
    naming, fitted, gain = SCAN.naming, explained.final, explained.gains[index]
    margin = explained.rivals[index][1] if index in explained.rivals else gain
    p = naming.max_probability * float(expit(naming.probability_per_nat * min(gain, margin)))
    if fit.is_doubted and not fit.is_of_building:
        p *= naming.doubted_factor
    amendment = fitted.model[index]
    return float(p * material_probability(amendment, amendment.stderr, required_ratio(fitted, amendment)))


def _fits_nowhere(fitted: Fitted) -> bool:
    """Tell whether map and poses were both widened to the limit, so that no effect can be named."""
    return min(fitted.state.pose_scale, fitted.state.map_scale) > AT_MOST * SCAN.noise.max_scale


def _unknown(fit: GoodnessOfFit) -> Unknown | None:
    if not fit.is_doubted:
        return None
    size = "" if fit.size is None else f"; {fit.size.sentence()}"
    return Unknown(
        statement=f"something no effect of the library explains: {fit.statement}{size}",
        deviation=fit.deviation,
        statistic=fit.statistic,
        threshold=fit.threshold,
        size={} if fit.size is None else fit.size.to_dict(),
        consequence="" if fit.size is None else fit.size.sentence(),
        families=fit.causes,
        family=fit.family,
        profile=fit.profile,
    )


def name_motion_effects(result: ChannelResult, known: Sequence[Amendment]) -> ChannelResult:
    """Remove effects of a motion channel that are known, implausible or contradicted by unmodelled structure."""
    is_absurd = any(
        a.effect.channel == "odometry" and abs(a.parameters.get("s", 0.0)) > WRONG_BY_HALF
        for a in result.effects
    )
    if is_absurd:
        words = "odometry and reference poses do not belong together: distance or turn differ in sign or by more than half"
        gone = dict.fromkeys(
            range(len(result.effects)), "odometry and reference poses do not belong together"
        )
        return without_close_calls(replace(result.without(gone), unknown=Unknown(statement=words)))
    if result.unknown is not None:  # an effect with less evidence may be a part of it
        least = result.unknown.statistic
        weaker = [i for i, a in enumerate(result.effects) if (a.evidence or 0.0) <= least]
        result = result.without(dict.fromkeys(weaker, PART_OF_UNKNOWN))
    slips = [a for a in result.effects if a.effect.place == "spot"]
    # several patches may imitate the unknown
    mimics = slips if len(slips) > 1 and result.unknown is not None else []
    expected = {a.name: a.parameters for a in known if a.effect not in (ACTUATOR_LAG, DEAD_TIME)}
    as_known = {a.name for a in result.effects if _is_expected(a, expected)}
    why = {i: PART_OF_UNKNOWN for i, a in enumerate(result.effects) if a in mimics}
    why |= {
        i: "it is already in the model, as given" for i, a in enumerate(result.effects) if a.name in as_known
    }
    rivals = tuple(rival for rival in result.rivals if rival.instead_of not in as_known)
    return without_close_calls(replace(result.without(why), rivals=rivals))


def without_echoes_of_doubted_wheels(drive: ChannelResult, odometry: ChannelResult) -> ChannelResult:
    """Remove motor effects that unexplained wheel errors may imitate.

    Wheels that misread at speed resemble a speed limit. A wheel error with more evidence than the effect
    (clock drift, one late encoder) may resemble a lag or a dead time.
    """
    unknown = odometry.unknown
    if unknown is None or "reference_m" in unknown.size:
        return drive
    why = {
        SPEED_SATURATION: "the odometry has an unexplained error: wheels that misread at speed resemble a speed limit"
    }
    weak = {a.effect for a in drive.effects if (a.evidence or 0.0) <= unknown.statistic}
    why |= dict.fromkeys(weak - why.keys(), "the odometry has an unexplained error with more evidence")
    return _without(drive, why)


def beside_shown_reference(odometry: ChannelResult, pose_scale: float) -> ChannelResult:
    """Remove wheel effects whose evidence is too small for a reference as inaccurate as the scans show.

    Evidence is half a chi-square statistic, in which the error of the reference is the scale. It falls with
    the square of that scale.

    Parameters
    ----------
    pose_scale : Ratio of the reference error that the scans show to the specified one.
    """
    if pose_scale < SCAN.nuisance.stretched_scale:
        return odometry
    least = EVIDENCE.threshold * pose_scale**2
    why = (
        f"the scans show a reference error of {pose_scale:.1f} times the specified one, which may cause this"
    )
    return _without(odometry, {a.effect: why for a in odometry.effects if (a.evidence or 0.0) < least})


def _without(result: ChannelResult, why: Mapping[Effect, str]) -> ChannelResult:
    """Return a channel without some effects; each becomes not observable, for the given reason."""
    gone = {i: why[a.effect] for i, a in enumerate(result.effects) if a.effect in why}
    left_out = {result.effects[i].name: words for i, words in gone.items()}
    return replace(result.without(gone), not_observable={**result.not_observable, **left_out})


def as_one_doubt(odometry: ChannelResult, drive: ChannelResult) -> tuple[ChannelResult, ChannelResult]:
    """Replace an odometry clock offset and a dead time that cancel by one unknown cause.

    If they cancel, the wheels follow the commands as robot.yaml specifies. One cause then shifts commands and
    odometry relative to the poses.
    """
    clocks = [a for a in odometry.effects if a.effect is POSE_CLOCK_OFFSET]
    delays = [a for a in drive.effects if a.effect is DEAD_TIME]
    if not (clocks and delays) or odometry.unknown is not None:
        return odometry, drive
    (clock,), (delay,) = clocks, delays
    error = float(np.hypot(clock.stderr["tau"], delay.stderr["L"]))
    if abs(clock["tau"] + delay["L"]) > 2 * error or abs(clock["tau"]) < CANCELS * error:
        return odometry, drive
    words = f"poses come {1000 * abs(clock['tau']):.0f} ms {'after' if clock['tau'] < 0 else 'before'} commands and odometry"
    unknown = Unknown(
        statement=f"the wheels follow the commands as robot.yaml specifies, but the {words}, which no single effect of the library explains",
        statistic=clock.evidence or 0.0,
        threshold=EVIDENCE.threshold,
        consequence=words,
        families=(
            "the clock of the base, which stamps commands and odometry",
            "wheels that slip while the speed changes",
            "a filter on the poses",
        ),
    )
    why = "a clock offset and a dead time cancel, so that one unknown cause explains both"
    return (
        replace(odometry.without({odometry.effects.index(clock): why}), unknown=unknown),
        drive.without({drive.effects.index(delay): why}),
    )


def _is_expected(amendment: Amendment, known: Mapping[str, Mapping[str, float]]) -> bool:
    """Tell whether an effect is already known, with a size that differs by less than its materiality."""
    if amendment.name not in known:
        return False
    values = known[amendment.name]
    off = {k: amendment[k] - values.get(k, 0.0) for k in amendment.effect.sizes}
    return size_ratio(amendment.effect, off) < 1.0
