"""One random fault scenario, drawn from a seed."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from firmware_protocol.virtual_board.faults import KINDS, Choice, Number
from tests.support.watched_clock import TimedRequest

SILENT = ("mute", "unplug", "other_protocol")  # line faults after which the board surely hears nothing valid
LENGTHS_S = (180.0, 1500.0)  # of one life of the daemon, simulated
DEAD_S = (2.0, 60.0)  # between a kill and the next start
SPANS = {  # narrower than the board's ranges where those would only make a rig that never works
    "rate": (0.001, 0.5),
    "delay_s": (0.0, 15.0),
    "boot_time_s": (0.1, 20.0),
    "count": (1, 40),
    "period_s": (0.5, 60.0),
    "before_s": (0.0, 300.0),
    "factor": (0.5, 2.0),
    "offset": (-20.0, 20.0),
    "size": (-50.0, 50.0),
    "value": (-100.0, 150.0),
}
CONTROLLERS = ("rules", "PID", "MPC", "MPC-P")
STOPS = ("emergency_stop", "maintenance")


@dataclass(frozen=True, slots=True)
class Life:
    """One process of the daemon: its length, how it ends, and what keeps its files from being written.

    killed : kill -9 at the end; else it is stopped in good order
    file_max : largest file that may be written [bytes], as on a full disk; None: no limit
    """

    length_s: float
    killed: bool
    dead_s: float
    file_max: int | None


@dataclass(frozen=True, slots=True)
class AttackPlan:
    """Everything that is drawn. Times in s of simulated time since the board's start."""

    seed: int
    core: str
    settings: Mapping[str, Any]
    chamber: Mapping[str, Any]
    lives: tuple[Life, ...]
    faults: tuple[Mapping[str, Any], ...]
    orders: tuple[TimedRequest, ...]

    @property
    def end_s(self) -> float:
        """When the last life ends."""
        return sum(life.length_s + life.dead_s for life in self.lives)


def draw(seed: int) -> AttackPlan:
    """Draw the scenario of one seed, the same at every call."""
    rng = np.random.default_rng(seed)
    # The last one has room on its disk and ends in good order: by then everything is stored or reported.
    lives = (
        *(_life(rng) for _ in range(rng.integers(0, 3))),
        replace(_life(rng), killed=False, file_max=None),
    )
    end_s = sum(life.length_s + life.dead_s for life in lives)
    return AttackPlan(
        seed=seed,
        core="c" if rng.random() < 0.3 else "python",
        settings=_settings(rng),
        chamber={"soil": {"water_start": 0.45}},
        lives=lives,
        faults=tuple(_fault(rng, end_s) for _ in range(rng.integers(1, 6))),
        orders=tuple(sorted(_orders(rng, end_s), key=lambda order: order.at_s)),
    )


def _life(rng: np.random.Generator) -> Life:
    killed = bool(rng.random() < 0.5)
    return Life(
        length_s=round(float(np.exp(rng.uniform(*np.log(LENGTHS_S)))), 1),
        killed=killed,
        dead_s=round(float(rng.uniform(*DEAD_S)), 1),
        file_max=int(rng.integers(4096, 400_000)) if rng.random() < 0.15 else None,
    )


def _settings(rng: np.random.Generator) -> dict[str, Any]:
    step_s = float(rng.choice([60.0, 60.0, 60.0, 10.0, 5.0]))
    controllers = CONTROLLERS if step_s == 60.0 else CONTROLLERS[:2]
    return {
        "timezone": "UTC",
        "control": {"step_s": step_s, "controller": str(rng.choice(controllers))},
        "reference": {"kind": "constant", "reference_c": round(float(rng.uniform(18.0, 36.0)), 1)},
        "safety": {"heater_rise_per_s": 1.0},
        "lighting": {"enabled": bool(rng.random() < 0.5), "on": "00:00", "off": "23:59"},
        "watering": {"enabled": True, "threshold": 0.75, "pulse_s": 2.0, "soak_s": 60.0, "daily_max_s": 60.0},
        "drift": {"enabled": False},
    }


def _fault(rng: np.random.Generator, end_s: float) -> dict[str, Any]:
    name = str(rng.choice(sorted(KINDS)))
    kind = KINDS[name]
    fault: dict[str, Any] = {"name": name, "start_s": round(float(rng.uniform(0.0, end_s)), 2)}
    if kind.duration_s is not None:
        fault["duration_s"] = round(float(np.exp(rng.uniform(np.log(0.2), np.log(1200.0)))), 2)
    for key, parameter in kind.parameters.items():
        fault[key] = _value(rng, key, parameter)
    return fault


def _value(rng: np.random.Generator, key: str, parameter: Number | Choice) -> float | int | str:
    if isinstance(parameter, Choice):
        return str(rng.choice(parameter.words))
    low, high = SPANS.get(key, (parameter.low, parameter.high))
    if key in ("count", "version"):
        return int(rng.integers(int(low), int(high) + 1))
    return round(float(rng.uniform(low, high)), 3)


def _orders(rng: np.random.Generator, end_s: float) -> list[TimedRequest]:
    """Among them at least one stop, so that every scenario tests one."""
    kinds = [str(rng.choice(STOPS)), *(str(kind) for kind in rng.choice(ORDERS, rng.integers(0, 6)))]
    return [TimedRequest(round(float(rng.uniform(5.0, end_s)), 2), _request(rng, kind)) for kind in kinds]


ORDERS = (
    "emergency_stop", "release_emergency_stop", "maintenance", "set_manual", "set_manual", "set_mode",
    "set_fan_mode", "set_reference", "clear_trip",
)  # fmt: skip


def _request(rng: np.random.Generator, kind: str) -> dict[str, Any]:
    match kind:
        case "maintenance":
            return {"do": kind, "minutes": float(rng.choice([0.0, 1.0, 5.0, 30.0]))}
        case "set_manual":
            return {"do": kind, "heater_duty": 1.0, "fan_on": int(rng.integers(2)), "led": 1.0}
        case "set_mode":
            return {"do": kind, "mode": str(rng.choice(["auto", "heat", "fan_only", "off", "manual"]))}
        case "set_fan_mode":
            return {"do": kind, "fan_mode": str(rng.choice(["auto", "on", "off"]))}
        case "set_reference":
            return {"do": kind, "reference_c": 34.0}
    return {"do": kind}
