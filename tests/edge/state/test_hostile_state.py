"""Hostile state files: the rig starts stopped, with the reason; no crash, no hang, no heat."""

import json
import math
import os
import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from edge.config import loading as config
from edge.config.settings import Settings
from edge.core.messages import Command
from edge.safety.memory import Dose, SafetyMemory
from edge.state.codecs import encode_safety
from edge.state.store import DRIFT, LLM_BUDGET, SKILL, STANDING, restore
from edge.tick.orders import Mode, Operation, apply_orders
from edge.tick.orders_json import to_dict
from edge.tick.steering import DailyTarget, FanRest, Steering
from tests.support.daemon_process import DaemonProcess
from tests.support.virtual_board import virtual_board

pytestmark = pytest.mark.slow

UTC = 1.8e9
STEERING = Steering("a", "warmer", UTC + 60, (DailyTarget(0.0, 25.0),), 1.0, 1.0, 0.5, (FanRest(0.0, 60.0),))
SOUND = {
    "operation": to_dict(Operation("PID", Mode.MANUAL, reference_c=25.0, steering=STEERING)),
    "safety": encode_safety(SafetyMemory(("air",), doses=(Dose(None, UTC, 2.0),))),
}
HOSTILE = (
    None,
    True,
    -1,
    1e300,
    10**400,
    math.nan,
    math.inf,
    "",
    "x" * 9,
    "\ud800",
    [],
    [[]],
    {},
    {"a": 1},
    1e18,
)
DEEP = '{"operation":' * 100_000 + "1" + "}" * 100_000


def settings(path: Path) -> Settings:
    """The defaults, with the state at `path`."""
    return replace(config.default(), state_file=str(path))


def changed(**operation: Any) -> str:
    """A sound file but for these orders."""
    return json.dumps({**SOUND, "operation": {**SOUND["operation"], **operation}})


def places(value: Any) -> list[tuple[Any, Any]]:
    """Every container and key in it."""
    keys = (
        list(value) if isinstance(value, dict) else list(range(len(value))) if isinstance(value, list) else []
    )
    return [(value, key) for key in keys] + [place for key in keys for place in places(value[key])]


def assert_stopped(path: Path) -> None:
    standing = restore(STANDING, settings(path))
    assert standing.operation.emergency_stop
    assert standing.broken.startswith(str(path))


def test_a_sound_file_is_what_was_written(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    path.write_text(json.dumps(SOUND))
    standing = restore(STANDING, settings(path))
    assert standing.broken == ""
    assert standing.operation.steering == STEERING
    assert standing.memory.trips == ("air",)


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(DEEP, id="nested"),
        pytest.param("[" * 100_000, id="brackets"),
        pytest.param(json.dumps(SOUND) + " " * (2 << 20), id="large"),
        pytest.param("", id="empty"),
        pytest.param('{"operation": {}, "safety": {}}', id="no orders"),
        pytest.param(changed(maintenance_until_utc=math.nan), id="maintenance NaN"),
        pytest.param(changed(maintenance_until_utc=1e300), id="maintenance without end"),
        pytest.param(changed(maintenance_until_utc=10**400), id="an integer that is no float"),
        pytest.param(changed(reference_c=1e308), id="reference"),
        pytest.param(changed(emergency_stop=None), id="no stop and no release"),
        pytest.param(changed(manual={"heater_duty": 0.0, "valve_pulse_s": 10.0}), id="water at every tick"),
        pytest.param(changed(steering={**SOUND["operation"]["steering"], "until_utc": 1e15}), id="steering"),
        pytest.param(changed(controller="\ud800"), id="surrogate"),
        pytest.param(
            json.dumps({**SOUND, "safety": {"trips": [], "doses": [[UTC, -1e9]]}}), id="negative water"
        ),
    ],
)
def test_a_file_that_nobody_wrote_is_an_emergency_stop(tmp_path: Path, text: str) -> None:
    path = tmp_path / "state.json"
    path.write_text(text)
    assert_stopped(path)


@pytest.mark.timeout(10)
@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir, lambda path: path.symlink_to("/dev/zero")])
def test_a_thing_that_is_no_file_is_an_emergency_stop(tmp_path: Path, make: Callable[[Path], None]) -> None:
    make(tmp_path / "state.json")
    assert_stopped(tmp_path / "state.json")


def test_each_value_exchanged_for_a_hostile_one_is_a_stop_or_an_order_that_can_be_carried_out(
    tmp_path: Path,
) -> None:
    path, chance, stopped = tmp_path / "state.json", random.Random(13), 0
    count = len(places(SOUND))
    for number in range(count * len(HOSTILE)):
        document = json.loads(json.dumps(SOUND))
        container, key = places(document)[number % count]
        container[key] = HOSTILE[number // count]
        if chance.random() < 0.2:
            other, name = chance.choice(places(document))
            other[name] = chance.choice(HOSTILE)
        path.write_text(json.dumps(document))
        standing = restore(STANDING, settings(path))
        stopped += bool(standing.broken)
        assert standing.operation.emergency_stop or not standing.broken
        json.dumps(to_dict(standing.operation), allow_nan=False).encode()
        command, _ = apply_orders(standing.operation, Command(0.5, True), UTC, 0.0)
        assert 0.0 <= command.heater_duty <= 1.0
        standing.operation.in_maintenance(UTC)
    assert stopped > count * len(HOSTILE) / 2


@pytest.mark.timeout(10)
@pytest.mark.parametrize(
    "text", [DEEP, "[" * 9, '{"day": 1e999}', '{"pairs": {"a": 1}, "widths": 5}', "\x00", "a fifo"]
)
def test_other_states_begin_anew_from_a_file_that_nobody_wrote(tmp_path: Path, text: str) -> None:
    path = tmp_path / "other.json"
    if text == "a fifo":
        os.mkfifo(path)
    else:
        path.write_text(text)
    for stored in (SKILL, DRIFT, LLM_BUDGET):
        moved = replace(stored, place=lambda settings: path)
        assert restore(moved, config.default()) == stored.otherwise(config.default(), "")


@pytest.mark.parametrize("kind", ["nested", "fifo", "nan"])
def test_the_daemon_starts_stopped_with_the_reason_and_answers(tmp_path: Path, kind: str) -> None:
    with virtual_board(tmp_path, "--real-time"):
        daemon = DaemonProcess(tmp_path)
        for name in ("skill.json", "drift.json"):
            os.mkfifo(tmp_path / name)
        if kind == "fifo":
            os.mkfifo(daemon.state_file)
        else:
            daemon.state_file.write_text(
                DEEP if kind == "nested" else changed(maintenance_until_utc=math.nan)
            )
        with daemon:
            daemon.wait_ticks(2)
            status = daemon.ask("status")
            assert status["operation"]["emergency_stop"] is True
            assert status["tick"]["sent"]["heater_duty"] == 0.0
            assert daemon.has_event("state.broken")
            assert daemon.ask("release_emergency_stop")["ok"]
