"""The physics model as a predictor: the twin of a twin file, stepped exactly."""

from dataclasses import dataclass, field

import numpy as np

from edge.core.errors import DataError
from edge.core.predictor import Columns, Floats
from edge.formats.input_file import Source
from edge.twin.model import BoxTwin
from edge.twin.twin_file import read_twin_file
from edge.twin.warm_start import PastColumns, state_now


@dataclass(frozen=True, slots=True)
class Pbm:
    """A twin behind the predictors' call; with no effects it is the paper's PBM."""

    twin: BoxTwin = field(default_factory=BoxTwin)
    name: str = "pbm"
    rows_needed: int = 1  # hidden states are known better from up to 120

    @property
    def version(self) -> str:
        """First 12 hex digits of the twin's hash."""
        return self.twin.sha256[:12]

    @property
    def step_s(self) -> float:
        """Time from one row to the next [s]."""
        return self.twin.step_s

    def rollout(self, history: Columns, controls: Floats, ahead: Columns) -> Floats:
        """Air temperature after each control, as `edge.core.predictor.Predictor.rollout`.

        history : `temp_air`; for a twin with hidden states also `temp_ambient`, `heater_duty` and `fan_on`;
            with an effect that needs more (`light`, `rel_humidity`, `utc`), those too
        controls : [B, N, 2], heater_duty and fan_on
        ahead : `temp_ambient` [N] [°C], and optionally `offset` [N], what the twin misses per step [K/step];
            the same further columns
        Returns : [B, N] [°C]
        Errors : DataError when the history has no temperature to start from, or a column is missing
        """
        horizon = controls.shape[1]
        if len(history["temp_air"]) < self.rows_needed:
            raise DataError("history: no row, the physics model needs one")
        offset = ahead["offset"][:horizon] if "offset" in ahead else None
        return self.twin.rollout(
            self._start(history),
            controls[:, :, 0],
            controls[:, :, 1],
            ahead["temp_ambient"][:horizon],
            offset=offset,
            conditions=_cut(ahead, self._conditions, slice(horizon)),
            before=self._past(history).commands if not self.twin.signals.steady else None,
        )

    @property
    def _conditions(self) -> tuple[str, ...]:
        return (*self.twin.needs, "door_open")

    def _start(self, history: Columns) -> Floats:
        """Return the state at the last row [n]."""
        temp = np.asarray(history["temp_air"], dtype=np.float64)
        if len(self.twin.states) == 1 and np.isfinite(temp[-1]):
            return temp[-1:]
        return state_now(self.twin, self._past(history))

    def _past(self, history: Columns) -> PastColumns:
        temp = np.asarray(history["temp_air"], dtype=np.float64)
        columns = _cut(history, self._conditions, slice(None))
        return PastColumns(temp, history["temp_ambient"], history["heater_duty"], history["fan_on"], columns)


def _cut(columns: Columns, names: tuple[str, ...], rows: slice) -> Columns:
    return {name: columns[name][rows] for name in names if name in columns}


def read_twin(path: Source) -> Pbm:
    """Read the predictor of a twin file.

    Errors : DataError naming file and key, also for a value that is still to be fitted
    """
    file = read_twin_file(path)
    if waiting := file.to_fit():
        raise DataError(f"{path}: {'.'.join(waiting[0])}: is still to be fitted")
    return Pbm(file.twin())
