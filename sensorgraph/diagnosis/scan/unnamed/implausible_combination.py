"""Several effects that together point to one common cause."""

from __future__ import annotations

from sensorgraph.diagnosis.scan.materiality import is_map_error
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed
from sensorgraph.effects import EFFECTS
from sensorgraph.effects.effect import Telltale

NAME = "implausible_combination"


def find(checked: Checked) -> list[Doubt]:
    """Return the combinations of effects of the model that are implausible."""
    model, out = checked.fitted.model, []
    for telltale in _telltales():
        members = [
            i
            for i, a in enumerate(model)
            if a.effect.diagnostics.telltale == telltale
            and a.ratio >= 1  # an immaterial effect is not evidence
            and not is_map_error(checked.fitted, a)
        ]
        count = len({model[i].name for i in members}) if telltale.distinct else len(members)
        if count >= telltale.least:
            out.append(
                Doubt(
                    family=NAME,
                    statement=telltale.statement,
                    misfit=SCAN.goodness_of_fit.failed_law_share * sum(checked.gains[i] for i in members),
                    statistic=float(count),
                    threshold=float(telltale.least),
                    failed=frozenset(members),
                    fringe=frozenset(i for i in members if model[i].effect.diagnostics.explains),
                )
            )
    return out


def _telltales() -> list[Telltale]:
    """Return the combinations of effects that are implausible, each once."""
    found = [effect.diagnostics.telltale for effect in EFFECTS.values()]
    return list(dict.fromkeys(telltale for telltale in found if telltale is not None))


IMPLAUSIBLE_COMBINATION = Unnamed(titles={NAME: "several effects that point to one common cause"}, find=find)
