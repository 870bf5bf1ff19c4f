"""Messages: what can be said comes through, what can't is refused, on the way out and on the way in."""

import math
from dataclasses import fields, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.errors import DecodeError, LocalProtocolError
from firmware_protocol.make_vectors import report
from firmware_protocol.messages import (
    HEADER_LENGTH,
    LAYOUTS,
    MAX_BODY,
    PROTOCOL_VERSION,
    CommandMessage,
    ErrorCode,
    Message,
    Quality,
    SensorReport,
    pack,
    unpack,
)

NAN, INF = math.nan, math.inf
COMMAND = CommandMessage(10, True, 50, 2.5, False, 10.0)
REPORT = report(1000, 21.3, 50.0, 600, 0.5, 0.4, 0.9, 20.0)


@st.composite
def messages(draw: st.DrawFn) -> Message:
    """Any message, every field anywhere in its range."""
    message_class, layout = draw(st.sampled_from(list(LAYOUTS.items())))
    raws = []
    for field in layout.fields:
        allowed = st.integers(field.low, field.high)
        raws.append(draw(allowed if field.none is None else allowed | st.just(field.none)))
    return message_class(*layout.values(tuple(raws)))


@given(messages(), st.integers(0, 255), st.integers(0, 255))
def test_every_message_comes_through_unchanged(message: Message, seq: int, ack: int) -> None:
    payload = pack(message, seq, ack)
    header, received = unpack(payload)
    assert received == message
    assert (header.kind, header.seq, header.ack) == (LAYOUTS[type(message)].kind, seq, ack)
    assert len(payload) <= HEADER_LENGTH + MAX_BODY


@given(st.binary(min_size=HEADER_LENGTH, max_size=60))
def test_any_payload_is_a_message_or_a_decode_error(payload: bytes) -> None:
    try:
        header, message = unpack(payload)
    except DecodeError as error:
        assert error.code in (ErrorCode.VERSION, ErrorCode.UNKNOWN_KIND, ErrorCode.LENGTH, ErrorCode.RANGE)
        assert 0 <= error.detail <= 255
    else:
        assert pack(message, header.seq, header.ack) == payload


@given(messages(), st.data())
def test_any_body_of_the_right_length_is_judged_field_by_field(message: Message, data: st.DataObject) -> None:
    layout = LAYOUTS[type(message)]
    body = data.draw(st.binary(min_size=layout.struct.size, max_size=layout.struct.size))
    refused = layout.first_refused(layout.struct.unpack(body))
    payload = pack(message, 1)[:HEADER_LENGTH] + body
    if refused is None:
        assert pack(unpack(payload)[1], 1) == payload
    else:
        with pytest.raises(DecodeError) as raised:
            unpack(payload)
        assert (raised.value.code, raised.value.detail) == (ErrorCode.RANGE, refused)


EDGES: list[tuple[Message, str, list[Any], list[Any]]] = [
    (COMMAND, "heater_steps", [0, 20], [-1, 21, 256, None, NAN, INF, 10.5]),
    (COMMAND, "fan_on", [0, 1, 255], [-1, 256, None, NAN, 0.5]),
    (COMMAND, "led_pct", [0, 100], [-1, 101, None, NAN, 0.5]),
    (COMMAND, "valve_pulse_s", [0.0, 0.1, 25.5], [-0.1, 25.6, None, NAN, INF, -INF]),
    (COMMAND, "lease_s", [0.0, 0.001, 60.0], [-0.001, 60.001, None, NAN, INF, -INF]),
    (REPORT, "temp_air_c", [-50.0, 150.0, None], [-50.01, 150.01, INF, -INF]),
    (REPORT, "co2_ppm", [0, 10000, None], [-1, 10001, 65535, INF]),
    (REPORT, "light", [0.0, 1.0, None], [-0.0001, 1.0001, INF]),
    (REPORT, "board_ms", [0, 2**32 - 1], [-1, 2**32, None, NAN]),
    (REPORT, "temp_air_quality", list(Quality), [-1, 5]),
]


@pytest.mark.parametrize(("message", "name", "good", "bad"), EDGES, ids=[f"{e[1]}" for e in EDGES])
def test_a_sender_may_go_to_the_edge_and_not_beyond(
    message: Message, name: str, good: list[Any], bad: list[Any]
) -> None:
    for value in good:
        assert getattr(unpack(pack(replace(message, **{name: value}), 1))[1], name) == value
    for value in bad:
        with pytest.raises(LocalProtocolError, match=name):
            pack(replace(message, **{name: value}), 1)


def test_nan_travels_as_no_number_where_the_wire_has_a_word_for_it() -> None:
    report = unpack(pack(replace(REPORT, temp_air_c=NAN, co2_ppm=NAN), 1))[1]
    assert isinstance(report, SensorReport)
    assert report.temp_air_c is None
    assert report.co2_ppm is None


@pytest.mark.parametrize("value", [-50.0, -0.01, 0.0, 0.01, 20.99, 21.3, 150.0])
def test_a_scaled_value_is_the_nearest_float_of_its_decimal(value: float) -> None:
    report = unpack(pack(replace(REPORT, temp_air_c=value), 1))[1]
    assert isinstance(report, SensorReport)
    assert report.temp_air_c == value


def test_the_version_is_looked_at_before_everything_else() -> None:
    with pytest.raises(DecodeError) as raised:
        unpack(b"\1\xff\1\0" + bytes(50))
    assert (raised.value.code, raised.value.detail) == (ErrorCode.VERSION, 2)


WRONG_LENGTHS = [
    (layout.kind, length)
    for layout in LAYOUTS.values()
    for length in (layout.struct.size - 1, layout.struct.size + 1)
    if length >= 0
]


@pytest.mark.parametrize(("kind", "length"), WRONG_LENGTHS)
def test_one_byte_more_or_less_is_a_length_error(kind: int, length: int) -> None:
    with pytest.raises(DecodeError) as raised:
        unpack(bytes((PROTOCOL_VERSION, kind, 1, 0)) + bytes(length))
    assert (raised.value.code, raised.value.detail) == (ErrorCode.LENGTH, length)


def test_the_layout_of_a_message_names_its_fields_in_order() -> None:
    for message_class, layout in LAYOUTS.items():
        assert [f.name for f in layout.fields] == [f.name for f in fields(message_class)]
