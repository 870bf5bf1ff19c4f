"""The next experiment as diagnosis.json has it, in sentences, and as a profile for `greenhouse
experiment`.
"""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from edge.diagnosis.diagnosis_document import NextExperiment
from edge.diagnosis.experiment.plan import RIVAL_NATS, PlannedExperiment
from edge.diagnosis.report.number_text import duration, nats, odds
from edge.diagnosis.report.wording import join_names
from edge.formats.number_table import write_table
from edge.twin.effects.library import EFFECTS
from edge.twin.effects.named import FLOW_CHECK, POWER_CHECK
from edge.twin.twin_file import Place

PROFILE = "next_experiment.csv"
ASKS = "Begin with the box at rest at the room's temperature, the door shut."
GEOMETRY: Mapping[str, str] = {
    "heater_max_w": POWER_CHECK,
    "fan_max_m3_s": FLOW_CHECK,
    "volume_m3": "a tape measure",
    "air_density_kg_m3": "a barometer",
    "air_heat_capacity_j_kg_k": "a hygrometer",
}


def checks(names: Iterable[str]) -> tuple[str, ...]:
    """Return the independent checks of these effects, each once."""
    return tuple(dict.fromkeys(check for name in names if (check := EFFECTS[name].check)))


def calibration(place: Place) -> str:
    """Return how a value is calibrated."""
    check = GEOMETRY.get(place[1], "") if place[0] == "geometry" else EFFECTS[place[1]].check
    return check or "a measurement of its own"


def experiment_document(found: PlannedExperiment) -> NextExperiment:
    """Return the experiment as diagnosis.json has it."""
    known: NextExperiment = {
        "why": " ".join(_sentences(found)),
        "separates": found.names,
        "duration_s": found.duration_s,
        "expected_log_odds": found.expected_log_odds,
    }
    if found.profile:
        known |= {"profile": PROFILE, "asks": [ASKS], "largest_temp_air_c": found.largest_temp_air_c}
    return known


def write_profile(found: PlannedExperiment | None, folder: Path) -> None:
    """Write an experiment's profile into a folder and replace an older one. Errors: OSError"""
    path = folder / PROFILE
    if found is None or not found.profile:
        path.unlink(missing_ok=True)
        return
    write_table(path, found.profile, {"notes": f"{found.kind}, to separate {', '.join(found.names)}"})


def _sentences(found: PlannedExperiment) -> Iterator[str]:
    """Yield the experiment's purpose, its expected evidence and its limits."""
    if found.expected_log_odds is not None:
        yield _plan_sentence(found, found.expected_log_odds)
    for group in found.inseparable:
        yield (
            f"No experiment with {found.inputs} can tell {join_names(group)} apart: they say the same. "
            f"What would: {', or '.join(checks(group))}."
        )
    if found.weak:
        pairs = join_names([f"{one} from {other}" for one, other in found.weak])
        yield f"{'It' if found.profile else 'An experiment within the limits'} can hardly tell {pairs}."
    if found.calibration is not None:
        place, log_odds = found.calibration
        yield (
            f"Calibrating {_value_name(place)} first ({calibration(place)}) would settle it by itself: "
            f"expected log odds {nats(log_odds)} with that value exact."
        )


def _plan_sentence(found: PlannedExperiment, log_odds: float) -> str:
    kind = found.kind[:1].upper() + found.kind[1:]
    does = "separates" if log_odds >= RIVAL_NATS else "is the best way to separate"
    sides = "; ".join(" from ".join(own) if len(own) == 2 else join_names(own) for own in found.separates)
    settles = "" if log_odds >= RIVAL_NATS else ", but may not settle it"
    expected = f"expected log odds {nats(log_odds)} ({odds(log_odds)})"
    if len(found.names) > 2:
        expected += " between the two that are hardest to separate"
    return f"{kind}, {duration(found.duration_s)}, {does} {sides}{settles}: {expected}."


def _value_name(place: Place) -> str:
    """Return a value as the twin file has it: `fan_effectiveness.eps_f`, `geometry.heater_max_w`."""
    return ".".join(place[1:] if place[0] == "effects" else place)
