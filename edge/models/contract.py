"""What an ONNX file promises about itself: one JSON document in its metadata, checked before it is believed.

The file holds one graph: from a window of measured rows and the inputs of N steps to N temperatures. Its
golden vectors are rollouts of the trained network; the edge runs the graph on them before it uses it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from edge.core.errors import DataError
from edge.core.names import ACTUATORS, SIGNALS
from edge.core.predictor import Floats
from edge.formats.strict_json import parse_object

KEY = "greenhouse_contract"  # of the metadata
VERSION = 1
FEATURES = {  # kind -> columns of the window, in their order
    "lstm": ("temp_air", "heater_duty", "fan_on"),
    "ham": ("temp_air", "temp_ambient", "heater_duty", "fan_on"),
    "ham_guarded": ("temp_air", "temp_ambient", "heater_duty", "fan_on"),
}
STEP_TOLERANCE_K = 1e-4  # golden vectors of one step
ROLLOUT_TOLERANCE_K = 1e-3  # of more steps
_ROWS_MAX = 120  # of history, see `edge.core.predictor.Predictor`
_FACTS = ("scaler", "data_sha256", "command", "seed", "metrics", "software")  # for people, not looked into
_KEYS = {"contract", "kind", "features", "units", "sample_s", "window", "scaler", "validity", "tolerance",
         "golden", "twin_sha256", "data_sha256", "command", "seed", "metrics", "software"}  # fmt: skip


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
    """Unit of everything that goes into or comes out of a graph of this kind."""
    known = {name: signal.unit for name, signal in SIGNALS.items()}
    known |= {name: actuator.unit for name, actuator in ACTUATORS.items()}
    return {name: known[name] for name in FEATURES[kind]} | {"offset": "K/step", "sample_s": "s"}


def keys(kind: str) -> tuple[str, ...]:
    """The features by their keys at a border."""
    known = {name: signal.key for name, signal in SIGNALS.items()}
    known |= {name: actuator.key for name, actuator in ACTUATORS.items()}
    return tuple(known[name] for name in FEATURES[kind])


def parse_contract(text: str) -> Contract:
    """The contract in `text`. Errors: DataError that names the key."""
    try:
        document = parse_object(text)
    except ValueError as error:
        raise DataError(f"{KEY}: {error}") from None
    if document.get("contract") != VERSION:
        raise DataError(f"contract: {document.get('contract')!r} is not {VERSION}, the one known here")
    if odd := sorted(_KEYS ^ document.keys()):
        raise DataError(f"{odd[0]}: {'missing' if odd[0] in _KEYS else 'unknown key'}")
    kind = document["kind"]
    if kind not in FEATURES:
        raise DataError(f"kind: {kind!r} is none of {', '.join(FEATURES)}")
    _expect("features", document["features"], list(FEATURES[kind]))
    _expect("units", document["units"], units(kind))
    window = document["window"]
    if isinstance(window, bool) or not isinstance(window, int) or not 1 <= window <= _ROWS_MAX:
        raise DataError(f"window: {window!r} is not a number of rows from 1 to {_ROWS_MAX}")
    return Contract(
        kind=kind,
        sample_s=_positive("sample_s", document["sample_s"]),
        window=window,
        validity=_validity(kind, document["validity"]),
        step_tolerance_k=_tolerance(document["tolerance"], "step_k", STEP_TOLERANCE_K),
        rollout_tolerance_k=_tolerance(document["tolerance"], "rollout_k", ROLLOUT_TOLERANCE_K),
        golden=_goldens(kind, document["golden"], window),
        twin_sha256=_twin(kind, document["twin_sha256"]),
        facts={
            key: document[key] for key in ("scaler", "data_sha256", "command", "seed", "metrics", "software")
        },
    )


def _expect(key: str, value: Any, expected: list[str] | dict[str, str]) -> None:
    if value != expected:
        raise DataError(f"{key}: {value!r} is not {expected!r}")


def _positive(key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not (isfinite(value) and value > 0.0):
        raise DataError(f"{key}: {value!r} is not a number above 0")
    return float(value)


def _validity(kind: str, value: Any) -> dict[str, tuple[float, float]]:
    if not isinstance(value, dict) or set(value) != set(keys(kind)):
        raise DataError(f"validity: does not bound exactly {', '.join(keys(kind))}")
    box = {}
    for key, pair in value.items():
        bounds = _numbers(f"validity.{key}", pair, 1)
        if len(bounds) != 2 or not bounds[0] <= bounds[1]:
            raise DataError(f"validity.{key}: {pair!r} is not a lowest and a highest value")
        box[key] = (float(bounds[0]), float(bounds[1]))
    return box


def _tolerance(value: Any, key: str, largest: float) -> float:
    place = f"tolerance.{key}"
    if not isinstance(value, dict):
        raise DataError("tolerance: is no object")
    found = _positive(place, value.get(key))
    if found > largest:
        raise DataError(f"{place}: {found:g} K is more than {largest:g} K")
    return found


def _twin(kind: str, value: Any) -> str:
    if kind == "lstm":
        return ""
    if not isinstance(value, str) or not value:
        raise DataError(f"twin_sha256: {value!r} is no hash of a twin")
    return value


def _goldens(kind: str, value: Any, window: int) -> tuple[Golden, ...]:
    if not isinstance(value, list) or not value:
        raise DataError("golden: no rollouts to prove the graph with")
    goldens = tuple(_golden(f"golden[{i}]", kind, entry, window) for i, entry in enumerate(value))
    if max(golden.temps.shape[1] for golden in goldens) < 2:
        raise DataError("golden: no rollout of more than one step")
    return goldens


def _golden(place: str, kind: str, entry: Any, window: int) -> Golden:
    if not isinstance(entry, dict):
        raise DataError(f"{place}: is no object")
    temps = _numbers(f"{place}.temps", entry.get("temps"), 2)
    batch, horizon = temps.shape
    shapes: dict[str, tuple[int, ...]] = {
        "window": (window, len(FEATURES[kind])),
        "controls": (batch, horizon, 2),
    }
    if "temp_ambient" in FEATURES[kind]:
        shapes["ambient"] = (horizon,)
    found = {key: _numbers(f"{place}.{key}", entry.get(key), len(shape)) for key, shape in shapes.items()}
    for key, numbers in found.items():
        if numbers.shape != shapes[key]:
            raise DataError(f"{place}.{key}: shape {numbers.shape}, not {shapes[key]}")
    return Golden(temps=temps, **found)


def _numbers(place: str, value: Any, rank: int) -> Floats:
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.ndim != rank or not numbers.size or not np.isfinite(numbers).all():
        raise DataError(f"{place}: not numbers in {rank} dimensions")
    return numbers
