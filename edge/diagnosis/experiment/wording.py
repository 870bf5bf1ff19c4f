"""An experiment in sentences."""

from edge.diagnosis.experiment.experiment import PlannedExperiment
from edge.diagnosis.experiment.independent import calibration, checks
from edge.diagnosis.report.number_text import duration, nats, odds
from edge.diagnosis.report.wording import join_names
from edge.diagnosis.search import RIVAL_NATS


def why(found: PlannedExperiment) -> str:
    """Return the experiment's purpose, its expected evidence and its limits."""
    return " ".join([*_plan_lines(found), *_same(found), *_weak(found), *_calibration_lines(found)])


def asks(found: PlannedExperiment) -> list[str]:
    """Return the further steps that a person is asked to take."""
    told = []
    if found.profile:
        told.append("Begin with the box at rest at the room's temperature, the door shut.")
    if found.swing_log_odds is not None:
        told.append(
            "If you can, let the room warm by 3 K and cool again meanwhile (a window, its heating): "
            f"what is hard to tell without would then have log odds of {nats(found.swing_log_odds)}."
        )
    return told


def _plan_lines(found: PlannedExperiment) -> list[str]:
    if not found.profile or found.expected_log_odds is None:
        return []
    kind = found.kind[:1].upper() + found.kind[1:]
    expected = f"expected log odds {nats(found.expected_log_odds)} ({odds(found.expected_log_odds)})"
    if len(found.separates) > 1 or any(len(sides) > 2 for sides in found.separates):
        expected += " between the two that are hardest to separate"
    told = (
        "separates"
        if found.expected_log_odds >= RIVAL_NATS
        else "is best to separate, though it tells little,"
    )
    sides = "; ".join(_apart([" or ".join(side) for side in sides]) for sides in found.separates)
    return [f"{kind}, {duration(found.duration_s)}, {told} {sides}: {expected}."]


def _apart(sides: list[str]) -> str:
    return " from ".join(sides) if len(sides) == 2 else f"{join_names(sides)} from one another"


def _same(found: PlannedExperiment) -> list[str]:
    return [
        f"No experiment with heater and fan can tell {join_names(group)} apart: they say the same. "
        f"What would: {_either(checks(group))}."
        for group in found.inseparable
    ]


def _weak(found: PlannedExperiment) -> list[str]:
    if not found.weak:
        return []
    pairs = join_names([f"{one} from {other}" for one, other in found.weak])
    return [f"It can hardly tell {pairs}."]


def _calibration_lines(found: PlannedExperiment) -> list[str]:
    item = found.calibration
    if item is None:
        return []
    how = calibration(item.place)
    if item.alone >= RIVAL_NATS:
        return [
            f"Calibrating {item.name} first ({how}) would settle it by itself: "
            f"expected log odds {nats(item.alone)} with that value exact."
        ]
    return [
        f"Calibrating {item.name} first ({how}) would make the experiment tell more: "
        f"expected log odds {nats(item.with_experiment)} with that value exact."
    ]


def _either(words: tuple[str, ...]) -> str:
    return ", or ".join(words)
