"""What a policy's file promises of itself: one JSON document in its metadata, as a predictor's has.

The graph takes `observation` [B, features], as `policy_observation.observe` gives it, and gives `values`
[B, ACTIONS]: what each action is worth from here on.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from edge.core.errors import DataError
from edge.formats.strict_json import parse_object
from edge.models.policy_actions import ACTIONS
from edge.models.policy_observation import FEATURES, NAMES, Floats, table_sha256

KEY = "greenhouse_policy"  # of the metadata
VERSION = 1
TOLERANCE = 1e-4  # of the golden values, which are of order 1
_FACTS = ("variant", "model", "model_sha256", "data_sha256", "command", "seed", "settings", "metrics",
          "software")  # for people, not looked into  # fmt: skip
_CHECKED = ("policy", "features", "table_sha256", "actions", "sample_s", "golden")


@dataclass(frozen=True, slots=True, eq=False)
class PolicyContract:
    """The document, checked.

    observations : [n, features]; values : [n, ACTIONS], what the trained network gives for them
    facts : variant, model, data_sha256, command, seed, ...; for people
    """

    sample_s: float
    observations: Floats
    values: Floats
    facts: Mapping[str, Any]


def document_of(observations: Floats, values: Floats, facts: Mapping[str, Any]) -> dict[str, Any]:
    """The document of a policy that was trained with this software's table; JSON values."""
    return {
        "policy": VERSION,
        "features": list(NAMES),
        "table_sha256": table_sha256(),
        "actions": ACTIONS,
        "golden": {"observations": observations.tolist(), "values": values.tolist()},
        **facts,
    }


def parse_policy_contract(text: str) -> PolicyContract:
    """The contract in `text`. Errors: DataError that names the key."""
    try:
        document = parse_object(text)
    except ValueError as error:
        raise DataError(f"{KEY}: {error}") from None
    keys = {*_FACTS, *_CHECKED}
    if odd := sorted(keys ^ document.keys()):
        raise DataError(f"{odd[0]}: {'missing' if odd[0] in keys else 'unknown key'}")
    for key, expected in (("policy", VERSION), ("features", list(NAMES)), ("actions", ACTIONS)):
        if document[key] != expected:
            raise DataError(f"{key}: {document[key]!r} is not {expected!r}, the one known here")
    if document["table_sha256"] != table_sha256():
        raise DataError("table_sha256: made with another table of the observation: train it anew")
    sample_s = document["sample_s"]
    if isinstance(sample_s, bool) or not isinstance(sample_s, int | float) or not 0.0 < sample_s < np.inf:
        raise DataError(f"sample_s: {sample_s!r} is not a number above 0")
    return PolicyContract(
        float(sample_s), *_golden(document["golden"]), {key: document[key] for key in _FACTS}
    )


def _golden(value: Any) -> tuple[Floats, Floats]:
    if not isinstance(value, dict):
        raise DataError("golden: is no object")
    observations = _table("golden.observations", value.get("observations"), len(FEATURES))
    values = _table("golden.values", value.get("values"), ACTIONS)
    if len(values) != len(observations):
        raise DataError(f"golden.values: {len(values)} rows, not {len(observations)}")
    return observations, values


def _table(place: str, value: Any, columns: int) -> Floats:
    try:
        table = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        table = np.empty(0)
    if table.ndim != 2 or not len(table) or table.shape[1] != columns or not np.isfinite(table).all():
        raise DataError(f"{place}: not rows of {columns} numbers")
    return table
