"""Recorded runs through the same tick, in shadow: what would have been decided, and the forecasts' skill."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.app import controllers as registry
from edge.app.box import bounds_of
from edge.board.recorded_board import RecordedBoard, ReplayClock
from edge.config.settings import CalibrationSettings, Settings
from edge.controllers.mpc import Mpc
from edge.controllers.mpc_rollout import MpcRollout
from edge.core.controller import Context, Controller
from edge.core.controller_names import MPC, MPC_TWIN, PID, RULES
from edge.core.errors import DataError
from edge.core.messages import Decision, ReadingQuality, TickRecord
from edge.core.names import SIGNALS
from edge.core.predictor import Predictor
from edge.forecasts.scorer import ahead_of
from edge.formats.run_file import RecordedRun
from edge.formats.tick_json import tick_json
from edge.models.pbm import Pbm
from edge.safety.supervisor import SafetyMemory
from edge.tick.estimator import Estimator
from edge.tick.inbox import Inbox
from edge.tick.loop import Loop
from edge.tick.orders import Operation
from edge.tick.reference import make_reference, zone_of
from edge.tick.rig import Answered, NoForecasts, Rig
from edge.tick.sensor_health import SensorHealth

Floats = NDArray[np.float64]
TIME_BOX_MAX_MS = 60_000.0
REPLAYED = (RULES, PID, *MPC, *MPC_TWIN)  # those that ask nothing but their own model
OTHERS = tuple(name for name in SIGNALS if name not in ("temp_air", "temp_ambient"))


@dataclass(slots=True)
class Tape:
    """Collects the records of one replay."""

    records: list[TickRecord] = field(default_factory=list)

    def write(self, record: TickRecord) -> None:
        """Keep it."""
        self.records.append(record)

    def faults(self) -> dict[str, str]:
        """Return no fault: a list has none."""
        return {}


class ReplayMpc:
    """An MPC whose searches end where they ended before: the wall clock has no say in a replay.

    node_limits : of each decision in turn, how many nodes it may look into; None where its budget decides
    """

    def __init__(self, inner: Mpc | MpcRollout, node_limits: Sequence[int | None]) -> None:
        self.name = inner.name
        self._inner = inner
        self._limits = iter(node_limits)

    def decide(self, context: Context) -> Decision:
        """As the inner one, within the nodes of the next decision."""
        return self._inner.decide(context, node_limit=next(self._limits, None))

    def reset(self) -> None:
        """As the inner one."""
        self._inner.reset()


def replay(
    run: RecordedRun,
    settings: Settings,
    model: Predictor,
    fan_always_on: bool,
    node_limits: Sequence[int | None] = (),
    twin: Pbm | None = None,
) -> list[TickRecord]:
    """One tick per step of the run. Decisions have no effect: the recorded inputs stand.

    node_limits : see `ReplayMpc`; `fired_limits` reads them from the ticks of an earlier replay
    twin : what MPC-Twin and MPC-Twin-P plan with; None: they are not there
    """
    if twin is not None and twin.step_s != settings.control.step_s:
        raise DataError(f"twin: sample_s: {twin.step_s:g}, but a step has {settings.control.step_s:g} s")
    # What was recorded are measurements, calibrated as it was then.
    settings = replace(settings, calibration=CalibrationSettings())
    # The daemon's own loop, with a tape for a board: what is replayed is the code that runs on the rig.
    start_s = float(run.columns["time_s"][0])
    clock = ReplayClock(start_s, run.start_utc or 0.0)
    step_s = settings.control.step_s
    tape, inbox, box = Tape(), Inbox(), bounds_of(settings.box)
    rig = Rig(
        settings=settings,
        clock=clock,
        board=RecordedBoard(run, clock, step_s, fan_always_on),
        sensors=SensorHealth(settings.sensor_health, settings.calibration, box),
        estimator=Estimator(settings.estimator, model, step_s, settings.control.ambient_default_c),
        reference=make_reference(settings.reference),
        zone=zone_of(settings.timezone),
        controllers={
            name: _controller(name, settings, model, node_limits, twin)
            for name in REPLAYED
            if twin is not None or name not in MPC_TWIN
        },
        models=NoForecasts(),
        sinks=[tape],
        more_events=list,
        inbox=inbox,
        save_state=_forget,
        stop_at_s=float(run.columns["time_s"][-1]),
        box=box,
    )
    try:
        Loop(rig, Operation(settings.control.controller), SafetyMemory(), first_seq=1).run()
    finally:
        inbox.close()
    return tape.records


def _controller(
    name: str, settings: Settings, model: Predictor, node_limits: Sequence[int | None], twin: Pbm | None
) -> Controller:
    # Nobody waits for a replay: only nodes bound its searches, unless they were cut short when recorded.
    unhurried = replace(settings.control, time_box_ms=TIME_BOX_MAX_MS)
    predictors = {} if twin is None else {"pbm": twin}
    controller = registry.make(name, registry.ControllerParts(unhurried, model, predictors=predictors))
    return ReplayMpc(controller, node_limits) if isinstance(controller, Mpc | MpcRollout) else controller


def fired_limits(ticks: Sequence[Mapping[str, Any]]) -> list[int | None]:
    """Node counts of the recorded decisions that the wall clock cut short, None for the others.

    ticks : in the form of `edge.formats.tick_json`
    """
    return [tick["why"]["nodes"] if tick["why"].get("time_box_fired") else None for tick in ticks]


def decisions_digest(records: Sequence[TickRecord]) -> str:
    """SHA-256 over every decision and command: equal digests mean equal bit for bit, wall times aside."""
    digest = hashlib.sha256()
    for record in records:
        tick = tick_json(record)
        tick["why"] = {key: value for key, value in tick["why"].items() if not key.endswith("_ms")}
        tick["forecast_c"] = [value.hex() for value in record.decision.forecast]
        del tick["decide_ms"]
        digest.update(json.dumps(tick, sort_keys=True).encode())
    return digest.hexdigest()


@dataclass(frozen=True, slots=True)
class Skill:
    """Absolute errors of all forecasts at one horizon [K]."""

    horizon_s: float
    model: Floats
    persistence: Floats

    @property
    def model_mae_k(self) -> float:
        """Mean absolute error of the predictor."""
        return float(self.model.mean()) if len(self.model) else math.nan


@dataclass(frozen=True, slots=True)
class Series:
    """The records of one replay as columns, one row per tick."""

    measured: Floats  # NaN where the reading was not good [°C]
    estimates: Floats  # [°C]
    offsets: Floats  # [K/step]
    ambient: Floats  # [°C]
    others: Mapping[str, Floats]  # further signals and `utc`, as predictors know them; NaN where not good
    inputs: Floats  # heater_duty and fan_on as driven, [ticks, 2]
    step_s: float

    @classmethod
    def of(cls, records: Sequence[TickRecord]) -> "Series":
        """Columns of at least one record."""
        return cls(
            measured=np.array([_good(record, "temp_air") for record in records]),
            estimates=np.array([record.estimate.temp_air for record in records]),
            offsets=np.array([record.estimate.offset for record in records]),
            ambient=np.array([record.estimate.temp_ambient for record in records]),
            others={name: np.array([_good(record, name) for record in records]) for name in OTHERS}
            | {"utc": np.array([record.utc for record in records])},
            inputs=np.array([_driven_inputs(record) for record in records]),
            step_s=records[0].step_s,
        )

    def forecast(self, model: Predictor, tick: int, steps: int) -> Floats:
        """Temperatures after `tick`, under the inputs that were then recorded; fewer where the run ends [°C].

        It starts from the estimate and its offset at that tick, which know nothing of later rows.
        """
        reach = min(steps, len(self.measured) - 1 - tick)
        history = {
            **{name: values[: tick + 1] for name, values in self.others.items()},
            "temp_air": self.estimates[: tick + 1],
            "temp_ambient": self.ambient[: tick + 1],
            "heater_duty": np.append(self.inputs[:tick, 0], np.nan),
            "fan_on": np.append(self.inputs[:tick, 1], np.nan),
        }
        # What is measured stays as it is, time goes on: as on the rig.
        ahead = ahead_of(history, reach, self.step_s) | {"offset": np.full(reach, self.offsets[tick])}
        rows: Floats = model.rollout(history, self.inputs[None, tick : tick + reach], ahead)
        return np.asarray(rows[0])


def score(records: Sequence[TickRecord], model: Predictor, horizons_s: Sequence[float]) -> list[Skill]:
    """Forecasts from every tick against what was then measured, a Skill per horizon."""
    if not records:
        return [Skill(horizon, np.empty(0), np.empty(0)) for horizon in horizons_s]
    series = Series.of(records)
    steps = [max(1, round(horizon / records[0].step_s)) for horizon in horizons_s]
    errors: list[tuple[list[float], list[float]]] = [([], []) for _ in steps]
    for tick in range(model.rows_needed - 1, len(records) - 1):
        now = series.measured[tick]
        forecast = series.forecast(model, tick, max(steps))
        for (of_model, of_persistence), count in zip(errors, steps, strict=True):
            then = series.measured[tick + count] if count <= len(forecast) else math.nan
            if math.isfinite(then) and math.isfinite(now):
                of_model.append(abs(forecast[count - 1] - then))
                of_persistence.append(abs(now - then))
    return [
        Skill(horizon, np.array(of_model), np.array(of_persistence))
        for horizon, (of_model, of_persistence) in zip(horizons_s, errors, strict=True)
    ]


def _good(record: TickRecord, name: str) -> float:
    reading = record.readings.get(name)
    good = reading is not None and reading.quality is ReadingQuality.GOOD and reading.value is not None
    return float(reading.value) if good and reading is not None and reading.value is not None else math.nan


def _driven_inputs(record: TickRecord) -> tuple[float, float]:
    echo = record.echo
    return (echo.heater_duty, echo.fan) if echo is not None else (0.0, 0.0)


def _forget(operation: Operation, memory: SafetyMemory, answered: Answered | None = None) -> None:
    """Keep nothing, as a replay has no next start: what waits for the disk goes on at once."""
    if answered is not None:
        answered("")
