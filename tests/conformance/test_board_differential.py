"""The same script to the Python and the C board: the same bytes, the same pins, the same store."""

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.frame import encode
from firmware_protocol.messages import (
    Capability,
    ClearTrip,
    CommandMessage,
    EmergencyStop,
    EndMaintenance,
    HelloRequest,
    Maintenance,
    Ping,
    ReleaseStop,
    pack,
)
from firmware_protocol.virtual_board.board_config import BoardConfig
from firmware_protocol.virtual_board.board_samples import SIGNALS
from firmware_protocol.virtual_board.core import BoardCore
from tests.support.c_core import CBoardCore

configs = st.builds(
    BoardConfig,
    report_period_s=st.sampled_from([0.1, 1.0, 1.234, 60.0]),
    lease_max_s=st.sampled_from([0.1, 3.0, 10.0, 60.0]),
    temp_trip_c=st.sampled_from([0.0, 25.0, 45.0, 100.0]),
    valve_pulse_max_s=st.sampled_from([0.0, 0.1, 5.0, 60.0]),
    pwm_window_s=st.sampled_from([1.0, 1.1, 20.0, 600.0]),
    fan_safe_on=st.booleans(),
    capabilities=st.one_of(st.just(0x3FF), st.integers(0, 0x3FF)).map(Capability),
    board_id=st.integers(0, 2**64 - 1),
    firmware=st.tuples(*[st.integers(0, 255)] * 3),
)
KNOWN_STORES = [b"", b"\xff" * 4, b"\x01\x00\x2e\x3e", b"\x01\x01", bytes(4), bytes(5)]
stores = st.one_of(st.sampled_from(KNOWN_STORES), st.binary(max_size=4))
commands = st.builds(
    CommandMessage,
    heater_steps=st.sampled_from([0, 1, 10, 19, 20]),
    fan_on=st.one_of(st.integers(0, 1), st.sampled_from([2, 4, 40, 255])),
    led_pct=st.integers(0, 100),
    valve_pulse_s=st.sampled_from([0.0, 0.1, 1.0, 25.5]),
    cutoff_open=st.booleans(),
    lease_s=st.sampled_from([0.0, 0.001, 0.1, 2.999, 10.0, 60.0]),
)
latches = [ClearTrip(), EmergencyStop(), Maintenance(), ReleaseStop(), EndMaintenance()]
others = st.sampled_from([Ping(), *latches, HelloRequest(9)])
requests = st.one_of(commands, commands, others)
frames = st.builds(lambda message, seq: encode(pack(message, seq)), requests, st.integers(0, 4))
raw_frames = st.builds(
    lambda version, kind, seq, body: encode(bytes((version, kind, seq, 0)) + body),
    st.sampled_from([2, 2, 2, 0, 1]), st.integers(0, 15), st.integers(0, 4), st.binary(max_size=48),
)  # fmt: skip
lines = st.one_of(frames, frames, frames, raw_frames, st.binary(min_size=1, max_size=70))
EDGES = [math.nan, math.inf, -math.inf, 44.99, 45.0, 42.0, 42.01, -20.0, -20.01, 80.0, 80.01, 1e300]
numbers = st.one_of(st.none(), st.sampled_from(EDGES), st.floats(20.0, 30.0), st.floats(-400.0, 400.0))
samples = st.dictionaries(
    st.one_of(st.just("temp_air_c"), st.sampled_from(list(SIGNALS))),
    st.tuples(numbers, st.sampled_from([0, 0, 0, 0, 1, 2, 3, 4, 5, 255, 256, -1])),
    min_size=1,
    max_size=3,
)
good_air = st.just({"temp_air_c": (25.0, 0)})
delays = st.sampled_from([0, 0, 1, 10, 99, 100, 100, 101, 999, 1000, 2999, 3000, 3001, 10_000, 70_000, 2**31])
actions = st.one_of(
    st.tuples(st.just("receive"), lines),
    st.tuples(st.just("sample"), st.one_of(good_air, good_air, samples)),
    st.tuples(st.just("step"), st.none()),
)
GREETING = [(0, ("receive", encode(pack(HelloRequest(1), 1)))), (0, ("sample", {"temp_air_c": (21.0, 0)}))]
starts = st.sampled_from([0, 1, 5000, 2**32 - 1, 2**32 - 1000, 2**32 - 12_345])


def act_on(boards, action, what, now_ms):
    """Does the same to both boards, asserts that they show the same, returns the pins of a step."""
    pins, said = [], []
    for board in boards:
        if action == "receive":
            board.receive(what, now_ms)
        elif action == "sample":
            board.sample(what, now_ms)
        else:
            pins.append(board.step(now_ms))
        said.append(board.transmit().hex())
    assert pins[:1] == pins[1:]
    assert said[0] == said[1]
    assert boards[0].persistent() == boards[1].persistent()
    return pins[0] if pins else None


@settings(max_examples=500, deadline=None)
@given(configs, stores, starts, st.lists(st.tuples(delays, actions), max_size=40), st.booleans())
def test_both_boards_do_the_same(config, store, start_ms, script, greeted):
    boards = [make(config, store, 1, 42) for make in (BoardCore, CBoardCore)]
    now_ms = start_ms
    for delay, (action, what) in GREETING * greeted + script:
        now_ms += delay
        act_on(boards, action, what, now_ms % 2**32)


def hour(random):
    """(now_ms, action, what) of a board in use: commands, samples now and then spoiled, noise, silence."""
    now_ms = random.choice([0, 2**32 - 600_000])
    seq = 1
    yield now_ms, "receive", encode(pack(HelloRequest(1), seq))
    air = 25.0
    for k in range(6000):
        now_ms += random.choice([10, 50, 100, 100, 100, 100, random.randrange(1, 4000)])
        air += random.uniform(-0.5, 0.55)
        if k % 10 == 0:
            spoiled = random.choice([None, math.nan, 200.0]) if random.random() < 0.05 else air
            yield now_ms, "sample", {"temp_air_c": (spoiled, 0), "fan_rpm": (1500, 0)}
        if random.random() < 0.05:
            seq = seq % 255 + 1
            yield now_ms, "receive", encode(pack(random_command(random), seq))
        if random.random() < 0.01:
            yield now_ms, "receive", random.randbytes(random.randrange(1, 80)) + b"\0"
        if k % 500 == 499:
            air = 25.0
            yield now_ms, "sample", {"temp_air_c": (air, 0)}
            seq = seq % 255 + 1
            yield now_ms, "receive", encode(pack(ClearTrip(), seq))
        yield now_ms, "step", None


def random_command(random) -> CommandMessage:
    return CommandMessage(
        heater_steps=random.randrange(21),
        fan_on=random.choice([0, 0, 1, 1, 2, 20, 60]),
        led_pct=random.randrange(101),
        valve_pulse_s=random.choice([0.0, 0.0, 0.3, 2.0]),
        cutoff_open=random.random() < 0.1,
        lease_s=random.choice([1.0, 10.0]),
    )


@pytest.mark.parametrize("seed", range(4))
def test_both_boards_do_the_same_in_use(seed):
    config = BoardConfig(capabilities=Capability(0x3FF))
    boards = [make(config, b"", 0, 1) for make in (BoardCore, CBoardCore)]
    seen = set()
    for now_ms, action, what in hour(random.Random(seed)):
        pins = act_on(boards, action, what, now_ms % 2**32)
        seen.add(pins)
    assert {pins.heater_relay for pins in seen if pins} == {True, False}
    assert {pins.valve for pins in seen if pins} == {True, False}
