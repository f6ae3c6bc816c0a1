"""Differences in the scans that have no name among the effects: one file and one line here for each kind.

They are hypotheses as effects are: each is tested on the accepted model, and listed in the ledger with its evidence.
"""

from sensorgraph.diagnosis.scan.unnamed.absorbed_readings import ABSORBED_READINGS
from sensorgraph.diagnosis.scan.unnamed.change_in_time import CHANGE_IN_TIME
from sensorgraph.diagnosis.scan.unnamed.error_profiles import ERROR_PROFILES
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed, sure
from sensorgraph.diagnosis.scan.unnamed.objects import OBJECT_AT_WALL, TEMPORARY_OBJECT
from sensorgraph.diagnosis.scan.unnamed.scans_elsewhere import SCANS_ELSEWHERE
from sensorgraph.diagnosis.scan.unnamed.unexplained import SCANS_DIFFER, UNEXPLAINED
from sensorgraph.diagnosis.scan.unnamed.worse_than_specified import WORSE_LASER, WORSE_THAN_SPECIFIED

UNNAMED: dict[str, Unnamed] = {
    "absorbed_readings": ABSORBED_READINGS,
    "object_at_wall": OBJECT_AT_WALL,
    "temporary_object": TEMPORARY_OBJECT,
    "worse_than_specified": WORSE_THAN_SPECIFIED,
    "worse_laser": WORSE_LASER,
    "scans_differ": SCANS_DIFFER,
    "unexplained": UNEXPLAINED,
    "error_profiles": ERROR_PROFILES,
    "change_in_time": CHANGE_IN_TIME,
    "scans_elsewhere": SCANS_ELSEWHERE,
}
"""Name of each test -> the kinds of difference that it finds, in the order in which they are tested and listed."""


def titles() -> dict[str, str]:
    """Return the noun phrase of each kind of difference, by its name."""
    return {name: title for unnamed in UNNAMED.values() for name, title in unnamed.titles.items()}


__all__ = ["UNNAMED", "Checked", "Doubt", "Unnamed", "sure", "titles"]
