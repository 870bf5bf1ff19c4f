"""Contract of an ONNX file: one JSON document in its metadata, checked before the model is trusted.

The file holds one graph: from a window of measured rows and the inputs of N steps to N temperatures. Its
golden vectors are rollouts of the trained network; the edge runs the graph on them before it uses it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np

from edge.core.errors import DataError
from edge.core.names import ACTUATORS, SIGNALS
from edge.core.plain_text import quote
from edge.core.predictor import Floats
from edge.formats.cross_check import CheckedDocument, Rule
from edge.formats.input_file import MODEL
from edge.formats.reader import parse_json, read

KEY = "greenhouse_contract"  # of the metadata
FEATURES = {  # kind -> columns of the window, in their order
    "lstm": ("temp_air", "heater_duty", "fan_on"),
    "window": ("temp_air", "heater_duty", "fan_on"),  # any other network of the same window
    "ham": ("temp_air", "temp_ambient", "heater_duty", "fan_on"),
    "ham_guarded": ("temp_air", "temp_ambient", "heater_duty", "fan_on"),
}
WITHOUT_A_TWIN = ("lstm", "window")
STEP_TOLERANCE_K = 1e-4  # golden vectors of one step
ROLLOUT_TOLERANCE_K = 1e-3  # of more steps
ROWS_MAX = 120  # of history, see `edge.core.predictor.Predictor`
_FACTS = ("scaler", "data_sha256", "command", "seed", "metrics", "software")  # for people, not looked into
Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Golden:
    """One rollout of the trained network.

    window : [rows, features]; controls : [B, N, 2]; temps : [B, N] [°C]
    ambient : [N] [°C], None where it is no feature
    """

    window: Floats
    controls: Floats
    temps: Floats
    ambient: Floats | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Contract:
    """The document, checked.

    window : rows of history that the graph takes
    validity : lowest and highest value of each feature in the data of the training, by its key at a border
    twin_sha256 : of the twin that a hybrid corrects, "" for others
    facts : scaler, data_sha256, command, seed, metrics, software; for people
    """

    kind: str
    sample_s: float
    window: int
    validity: Mapping[str, tuple[float, float]]
    step_tolerance_k: float
    rollout_tolerance_k: float
    golden: tuple[Golden, ...]
    twin_sha256: str
    facts: Mapping[str, Any]

    @property
    def features(self) -> tuple[str, ...]:
        """Columns of the window, in their order."""
        return FEATURES[self.kind]


def units(kind: str) -> dict[str, str]:
    """Return the unit of every input and output of a graph of this kind."""
    known = {name: signal.unit for name, signal in SIGNALS.items()}
    known |= {name: actuator.unit for name, actuator in ACTUATORS.items()}
    return {name: known[name] for name in FEATURES[kind]} | {"offset": "K/step", "sample_s": "s"}


def keys(kind: str) -> tuple[str, ...]:
    """Return the features by their keys at a border."""
    known = {name: signal.key for name, signal in SIGNALS.items()}
    known |= {name: actuator.key for name, actuator in ACTUATORS.items()}
    return tuple(known[name] for name in FEATURES[kind])


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How far the graph may be from the golden vectors: of one step, of more steps [K]."""

    step_k: Annotated[float, Rule(above=0.0, high=STEP_TOLERANCE_K)]
    rollout_k: Annotated[float, Rule(above=0.0, high=ROLLOUT_TOLERANCE_K)]


@dataclass(frozen=True, slots=True)
class GoldenDocument:
    """One rollout as it stands in the file."""

    window: Rows
    controls: tuple[Rows, ...]
    temps: Rows
    ambient: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True)
class ContractDocument(CheckedDocument):
    """The document, key by key; those without a type are for people."""

    contract: Literal[1]
    kind: Literal["lstm", "window", "ham", "ham_guarded"]
    features: tuple[str, ...]
    units: Mapping[str, str]
    sample_s: Annotated[float, Rule(above=0.0)]
    window: Annotated[int, Rule(low=1, high=ROWS_MAX)]
    scaler: Any
    validity: Mapping[str, tuple[float, float]]
    tolerance: Tolerance
    golden: Annotated[tuple[GoldenDocument, ...], Rule(least=1)]
    twin_sha256: str | None
    data_sha256: Any
    command: Any
    seed: Any
    metrics: Any
    software: Any

    def cross_check(self) -> None:
        """Check that the contract fits its kind."""
        for key, expected in (("features", FEATURES[self.kind]), ("units", units(self.kind))):
            if (found := getattr(self, key)) != expected:
                self.refuse(key, f"{quote(found)} is not {expected!r}")
        if set(self.validity) != set(keys(self.kind)):
            self.refuse("validity", f"does not bound exactly {', '.join(keys(self.kind))}")
        for key, (low, high) in self.validity.items():
            if not low <= high:
                self.refuse(f"validity.{key}", f"{low:g}, {high:g} are not a lowest and a highest value")
        if self.kind not in WITHOUT_A_TWIN and not self.twin_sha256:
            self.refuse("twin_sha256", f"{quote(self.twin_sha256)} is no hash of a twin")


def parse_contract(text: str) -> Contract:
    """Parse the contract in `text`. Errors: DataError that names the key"""
    found = read(ContractDocument, parse_json(text, KEY, MODEL))
    golden = tuple(_golden(f"golden[{i}]", found, entry) for i, entry in enumerate(found.golden))
    if max(entry.temps.shape[1] for entry in golden) < 2:
        raise DataError("golden: no rollout of more than one step")
    return Contract(
        kind=found.kind,
        sample_s=found.sample_s,
        window=found.window,
        validity=found.validity,
        step_tolerance_k=found.tolerance.step_k,
        rollout_tolerance_k=found.tolerance.rollout_k,
        golden=golden,
        twin_sha256="" if found.kind in WITHOUT_A_TWIN else found.twin_sha256 or "",
        facts={key: getattr(found, key) for key in _FACTS},
    )


def _golden(place: str, contract: ContractDocument, entry: GoldenDocument) -> Golden:
    temps = array(f"{place}.temps", entry.temps, 2)
    batch, horizon = temps.shape
    features = FEATURES[contract.kind]
    window = array(f"{place}.window", entry.window, 2, (contract.window, len(features)))
    controls = array(f"{place}.controls", entry.controls, 3, (batch, horizon, 2))
    if "temp_ambient" not in features:
        return Golden(window, controls, temps)
    return Golden(window, controls, temps, array(f"{place}.ambient", entry.ambient, 1, (horizon,)))


def array(place: str, values: Any, rank: int, shape: tuple[int, ...] | None = None) -> Floats:
    """Numbers that were read as an array of this shape. Errors: DataError, also for ragged rows"""
    try:
        numbers = np.array(values, dtype=np.float64)
    except ValueError:
        numbers = np.empty(0)
    if numbers.ndim != rank or not numbers.size:
        raise DataError(f"{place}: not numbers in {rank} dimensions")
    if shape is not None and numbers.shape != shape:
        raise DataError(f"{place}: shape {numbers.shape}, not {shape}")
    return numbers
