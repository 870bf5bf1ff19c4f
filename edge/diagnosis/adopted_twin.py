"""The twin file that a diagnosis hands on: the effects it names, and where they come from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from edge.core.version import __version__
from edge.twin.effects.library import EFFECTS, check_names
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value

DIGITS = 6  # of a value: the intervals are wider by far


@dataclass(frozen=True, slots=True)
class AddedEffect:
    """An effect that is added.

    parameters : by name, each with its 95 % interval where it has one
    alternatives : effects that the data can't tell from it
    log_odds : against the best model without it [nat]
    """

    name: str
    parameters: Mapping[str, Value]
    alternatives: Sequence[str] = ()
    log_odds: float | None = None


@dataclass(frozen=True, slots=True)
class Origin:
    """The origin of an adopted twin.

    data_sha256 : of the runs that it was fitted on
    before, after : errors of free runs, `{"train": {"rmse_k": 0.4, "mae_k": 0.3}, "test": ...}`, without and
        with what is added; what is not known is left out
    created_utc : 2026-07-01T12:00:00Z
    """

    data_sha256: str
    before: Mapping[str, Any]
    after: Mapping[str, Any]
    created_utc: str
    command: str = "greenhouse twin diagnose"
    further: Mapping[str, Any] = field(default_factory=dict)


def twin_after(
    file: TwinFile,
    added: Sequence[AddedEffect],
    origin: Origin,
    refitted: Mapping[Place, Value] | None = None,
) -> TwinFile:
    """`file` with the effects added, most important first, and a provenance that says why.

    refitted : values of `file` that the data have moved, with their intervals
    Returns : a file whose values are all known, as `edge.models.pbm.read_twin` needs
    Errors : DataError for an effect or a parameter that the library has not, or a value outside its bounds
    """
    for effect in added:
        check_names(effect.name, effect.parameters)
    changed = {place: plain_value(value) for place, value in (refitted or {}).items()}
    effects = {name: dict(own) for name, own in file.effects.items()}
    for effect in added:
        effects[effect.name] = {
            item.name: plain_value(effect.parameters[item.name]) for item in EFFECTS[effect.name].parameters
        }
    result = replace(file, effects=effects, provenance=_provenance(file, added, origin)).with_values(changed)
    result.twin()  # values that no twin can have are refused here, not on the rig
    return result


def _provenance(file: TwinFile, added: Sequence[AddedEffect], origin: Origin) -> dict[str, Any]:
    return {
        "added": {
            effect.name: {
                **{name: plain_value(value).document() for name, value in effect.parameters.items()},
                "alternatives": list(effect.alternatives),
                "log_odds": None if effect.log_odds is None else round_value(effect.log_odds),
            }
            for effect in added
        },
        "data_sha256": origin.data_sha256,
        "before": plain_numbers(origin.before),
        "after": plain_numbers(origin.after),
        "twin_before_sha256": file.twin().sha256,
        "software": f"greenhouse-twin {__version__}",
        "created_utc": origin.created_utc,
        "command": origin.command,
        **plain_numbers(origin.further),
    }


def plain_value(value: Value) -> Value:
    """Numbers that YAML knows, of a length that a person reads; inside their interval still."""
    low, high = (None if bound is None else round_value(bound) for bound in (value.low, value.high))
    middle = round_value(value.value)
    if low is not None and high is not None:
        middle = min(max(middle, low), high)
    return replace(
        value,
        value=middle,
        rel_sd=None if value.rel_sd is None else float(value.rel_sd),
        low=low,
        high=high,
        fit=False,
    )


def round_value(value: float) -> float:
    """Return a value as a file has it."""
    return float(f"{float(value):.{DIGITS}g}")


def plain_numbers(document: Any) -> Any:
    """Return the document with plain numbers in place of NumPy's; None for what is not finite."""
    if isinstance(document, Mapping):
        return {str(key): plain_numbers(item) for key, item in document.items()}
    if isinstance(document, list | tuple):
        return [plain_numbers(item) for item in document]
    if isinstance(document, bool | np.bool_):
        return bool(document)
    if isinstance(document, int | np.integer):
        return int(document)
    if isinstance(document, float | np.floating):
        return round_value(float(document)) if np.isfinite(document) else None
    return document
