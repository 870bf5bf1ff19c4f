"""The whole daemon in lock-step with a virtual board: what was measured, what was so, what was driven."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.app.daemon import Daemon
from edge.board.serial_port import OpenPort, SerialPort
from edge.config.settings import Settings
from edge.core.clock import Clock
from edge.core.controller import Controller
from edge.core.controller_names import LLM
from edge.core.messages import ReadingQuality, TickRecord
from training.control.recorded import wait_recorded

Floats = NDArray[np.float64]
Truth = Callable[[], Mapping[str, float]]  # of the chamber, now


@dataclass(frozen=True, slots=True)
class ClosedLoopLog:
    """One run: columns with a row per tick, and what was counted.

    columns : time_s, temp_air_c (measured), true_air_c, sensor_air_c (without noise, steps and bias),
        temp_ambient_c, reference_c, heater_duty, fan_on (as the board confirmed them), solve_ms
    changes : safety rule -> commands it changed
    instead : why another controller decided -> ticks
    time_boxes : decisions that the wall clock cut short
    tokens : of a language model
    plans : per tick the air that the controller expected after each of the next steps [°C], or empty
    """

    columns: Mapping[str, Floats]
    changes: Counter[str]
    instead: Counter[str]
    time_boxes: int
    tokens: int
    plans: tuple[tuple[float, ...], ...] = ()


def closed_loop(
    settings: Settings,
    clock: Clock,
    truth: Truth,
    length_s: float,
    open_port: OpenPort = SerialPort,
    instead: Controller | None = None,
) -> ClosedLoopLog:
    """Run `settings.control.controller`, or another one, for `length_s` from now on.

    Errors : KeyboardInterrupt where a signal has ended it
    """
    name = settings.control.controller if instead is None else instead.name
    rows: list[dict[str, float]] = []
    plans: list[tuple[float, ...]] = []
    changes: Counter[str] = Counter()
    others: Counter[str] = Counter()
    counts: Counter[str] = Counter()

    reads_history = name in LLM and LLM[name].assistance == "sql"

    def after_tick(record: TickRecord) -> None:
        if reads_history:
            wait_recorded(Path(settings.history.path), record.seq)
        rows.append(_row(record, truth()))
        plans.append(tuple(record.decision.forecast))
        changes.update({change.rule: 1 for change in record.changes})
        why = record.decision.why
        if record.decision.controller != name:
            others[str(why.get("failure", "order"))] += 1
        counts["time_boxes"] += bool(why.get("time_box_fired", False))
        counts["tokens"] += int(why.get("tokens", 0) or 0)

    end_s = clock.now() + length_s
    with Daemon(
        settings,
        clock,
        after_tick=after_tick,
        stop_at_s=end_s,
        more_controllers=() if instead is None else (instead,),
        experiment="" if instead is None else instead.name,
        open_port=open_port,
    ) as daemon:
        daemon.run()
    if clock.now() < end_s:
        raise KeyboardInterrupt  # the daemon took the signal for itself
    columns = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    return ClosedLoopLog(columns, changes, others, counts["time_boxes"], counts["tokens"], tuple(plans))


def _row(record: TickRecord, truth: Mapping[str, float]) -> dict[str, float]:
    air = record.readings["temp_air"]
    return {
        "time_s": record.time_s,
        "temp_air_c": air.value if air.quality is ReadingQuality.GOOD and air.value is not None else np.nan,
        "true_air_c": truth["temp_air_c"],
        "sensor_air_c": truth["temp_sensor_c"],
        "temp_ambient_c": record.estimate.temp_ambient,
        "reference_c": record.reference_c,
        "heater_duty": record.echo.heater_duty if record.echo is not None else 0.0,
        "fan_on": float(record.echo.fan_on) if record.echo is not None else 0.0,
        "solve_ms": float(record.decision.why.get("solve_ms", record.decide_ms)),
    }
