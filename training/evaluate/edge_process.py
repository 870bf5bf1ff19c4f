"""One model in a process of its own, as a rig has it: loaded, run, and what that took. Nothing of torch.

python -m training.evaluate.edge_process KIND FILE [TWIN_SHA256]     prints one line of JSON
"""

import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from edge.core.predictor import Predictor

HISTORY_ROWS, HORIZON, SEQUENCES = 10, 20, 42
REPEATS = 50
_STATUS = Path("/proc/self/status")


def main(words: list[str]) -> None:
    """Print the figures. The modules that a model needs count as its memory: they are imported late."""
    kind, file, *twin = words
    before_mib = resident_mib()
    began = time.perf_counter()
    predictor = _read(kind, Path(file), *twin)
    load_s = time.perf_counter() - began
    loaded_mib = resident_mib()
    rollout = _rollout(predictor, 1)
    rollout()
    figures = {
        "before_mib": before_mib,
        "loaded_mib": loaded_mib,
        "ran_mib": resident_mib(),
        "load_s": load_s,
        "one_ms": _median_ms(rollout),
        "batch_ms": _median_ms(_rollout(predictor, SEQUENCES)),
    }
    print(json.dumps(figures))


def resident_mib() -> float:
    """Resident memory of this process [MiB]; NaN where the system doesn't say."""
    if not _STATUS.exists():
        return float("nan")
    line = next(line for line in _STATUS.read_text().splitlines() if line.startswith("VmRSS:"))
    return int(line.split()[1]) / 1024


def _read(kind: str, file: Path, twin_sha256: str = "") -> Predictor:
    if kind == "arx":
        from edge.models.arx_file import read_arx

        return read_arx(file)
    if kind == "pbm":
        from edge.models.pbm import read_twin

        return read_twin(file)
    if kind == "lstm":
        from edge.models.onnx_predictor import read_lstm

        return read_lstm(file)
    from edge.models.onnx_predictor import read_ham

    return read_ham(file, twin_sha256)


def _rollout(predictor: Predictor, sequences: int) -> Callable[[], object]:
    history = {
        "temp_air": np.full(HISTORY_ROWS, 27.0),
        "temp_ambient": np.full(HISTORY_ROWS, 22.0),
        "heater_duty": np.full(HISTORY_ROWS, 0.4),
        "fan_on": np.zeros(HISTORY_ROWS),
    }
    ahead = {"temp_ambient": np.full(HORIZON, 22.0)}
    controls = np.zeros((sequences, HORIZON, 2))
    controls[:, :, 0] = np.linspace(0.0, 1.0, sequences)[:, None]
    return lambda: predictor.rollout(history, controls, ahead)


def _median_ms(call: Callable[[], object]) -> float:
    times = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return 1e3 * statistics.median(times)


if __name__ == "__main__":
    main(sys.argv[1:])
