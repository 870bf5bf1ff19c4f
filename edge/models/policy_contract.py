"""Contract of a policy's file: one JSON document in its metadata, as a predictor's.

The graph takes `observation` [B, features], as `policy_observation.observe` gives it, and gives `values`
[B, ACTIONS]: what each action is worth from here on.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from edge.core.plain_text import quote
from edge.formats.cross_check import CheckedDocument, Rule
from edge.formats.input_file import MODEL
from edge.formats.reader import parse_json, read
from edge.models.contract import Rows, array
from edge.models.policy_actions import ACTIONS
from edge.models.policy_observation import FEATURES, NAMES, Floats, table_sha256

KEY = "greenhouse_policy"  # of the metadata
TOLERANCE = 1e-4  # of the golden values, which are of order 1
_FACTS = ("variant", "model", "model_sha256", "data_sha256", "command", "seed", "settings", "metrics",
          "software")  # for people, not looked into  # fmt: skip


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
    """Return the document of a policy that was trained with this software's table; JSON values."""
    return {
        "policy": 1,
        "features": list(NAMES),
        "table_sha256": table_sha256(),
        "actions": ACTIONS,
        "golden": {"observations": observations.tolist(), "values": values.tolist()},
        **facts,
    }


@dataclass(frozen=True, slots=True)
class PolicyGolden:
    """Observations and what the trained network gives for them, row by row."""

    observations: Rows
    values: Rows


@dataclass(frozen=True, slots=True)
class PolicyDocument(CheckedDocument):
    """The document, key by key; those without a type are for people."""

    policy: Literal[1]
    features: tuple[str, ...]
    table_sha256: str
    actions: int
    sample_s: Annotated[float, Rule(above=0.0)]
    golden: PolicyGolden
    variant: Any
    model: Any
    model_sha256: Any
    data_sha256: Any
    command: Any
    seed: Any
    settings: Any
    metrics: Any
    software: Any

    def cross_check(self) -> None:
        """Compare with this software's table of the observation."""
        for key, expected in (("features", tuple(NAMES)), ("actions", ACTIONS)):
            if (found := getattr(self, key)) != expected:
                self.refuse(key, f"{quote(found)} is not {expected!r}, the one known here")
        if self.table_sha256 != table_sha256():
            self.refuse("table_sha256", "made with another table of the observation: train it anew")


def parse_policy_contract(text: str) -> PolicyContract:
    """Parse the contract in `text`. Errors: DataError that names the key"""
    found = read(PolicyDocument, parse_json(text, KEY, MODEL))
    rows = len(found.golden.observations)
    return PolicyContract(
        found.sample_s,
        array("golden.observations", found.golden.observations, 2, (rows, len(FEATURES))),
        array("golden.values", found.golden.values, 2, (rows, ACTIONS)),
        {key: getattr(found, key) for key in _FACTS},
    )
