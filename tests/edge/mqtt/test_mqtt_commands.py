import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.app.request_routes import ASKED_OF_THE_DESK
from edge.config.settings import ReferenceSettings
from edge.core.errors import RequestError
from edge.mqtt.commands import COMMANDS, PAYLOAD_MAX, parse
from edge.tick.orders import Operation, operate
from tests.support.mqtt_rig import desk

REFERENCE = ReferenceSettings(min_c=15.0, max_c=38.0)


@pytest.mark.parametrize(
    ("what", "payload", "request_"),
    [
        ("mode", b"auto", {"do": "set_mode", "mode": "auto"}),
        ("mode", b"fan_only", {"do": "set_mode", "mode": "fan_only"}),
        ("temperature", b"26", {"do": "set_reference", "reference_c": 26.0}),
        ("temperature", b"25.5", {"do": "set_reference", "reference_c": 25.5}),
        ("temperature", b"15", {"do": "set_reference", "reference_c": 15.0}),
        ("temperature", b"38.0", {"do": "set_reference", "reference_c": 38.0}),
        ("fan_mode", b"on", {"do": "set_fan_mode", "fan_mode": "on"}),
        ("controller", b"MPC-P", {"do": "set_controller", "name": "MPC-P"}),
        ("controller", b"none", {"do": "set_controller", "name": None}),
        ("maintenance", b"30", {"do": "maintenance", "minutes": 30.0}),
        ("maintenance", b"0", {"do": "maintenance", "minutes": 0.0}),
        ("maintenance", b"1440", {"do": "maintenance", "minutes": 1440.0}),
        (
            "manual",
            b'{"heater_duty": 0.5, "fan_on": 1}',
            {"do": "set_manual", "heater_duty": 0.5, "fan_on": 1},
        ),
        ("ask", b"26 by day", {"do": "ask", "words": "26 by day"}),
        ("confirm", b"a1b2c3", {"do": "confirm", "id": "a1b2c3"}),
        ("discard", b"a1b2c3", {"do": "discard", "id": "a1b2c3"}),
        ("discard", b"a1b2c3 too warm ", {"do": "discard", "id": "a1b2c3", "why": "too warm"}),
        ("discard", b"a1b2c3 ", {"do": "discard", "id": "a1b2c3"}),
        ("undo", b"PRESS", {"do": "undo"}),
        ("commission", b"PRESS", {"do": "commission"}),
        ("end_commissioning", b"PRESS", {"do": "commission", "end": True}),
        ("why", b"", {"do": "why", "at_utc": None}),
        ("why", b"1767225600.5", {"do": "why", "at_utc": 1767225600.5}),
        ("resend", b'{"first_seq": 3, "last_seq": 9}', {"do": "resend", "first_seq": 3, "last_seq": 9}),
        ("emergency_stop", b"PRESS", {"do": "emergency_stop"}),
        *(
            ("emergency_stop", payload, {"do": "emergency_stop"})
            for payload in (
                b"ON",
                b"on",
                b"true",
                b"1",
                b"off",
                b"press",
                b" OFF",
                b"OFF\n",
                b"\xff",
                b"{}",
                b"x" * 5000,
            )
        ),
        *(
            (what, text, {"do": "emergency_stop"})
            for what in ("mode", "ask")
            for text in (b"stop", b"STOP!", b"Emergency stop", b"emergency_stop", b"e-stop")
        ),
        ("ask", b"stop the fan at night", {"do": "ask", "words": "stop the fan at night"}),
        ("emergency_stop", b"OFF", {"do": "release_emergency_stop"}),
        ("release_emergency_stop", b"PRESS", {"do": "release_emergency_stop"}),
        ("clear_trip", b"PRESS", {"do": "clear_trip"}),
        ("follow_schedule", b"PRESS", {"do": "set_reference", "reference_c": None}),
        ("status", b"PRESS", {"do": "status"}),
        (
            "install_bundle",
            b'{"url": "http://fleet/b.zip", "sha256": "%s"}' % (b"a" * 64),
            {"do": "bundle", "action": "remote-install", "url": "http://fleet/b.zip", "sha256": "a" * 64},
        ),
        (
            "rollback_bundle",
            b'{"version": "2.0"}',
            {"do": "bundle", "action": "remote-rollback", "version": "2.0"},
        ),
    ],
)
def test_a_well_formed_command_becomes_a_request(what, payload, request_):
    assert parse(what, payload, REFERENCE) == request_


@pytest.mark.parametrize(
    ("what", "payload"),
    [
        *(("temperature", text) for text in (b"nan", b"NaN", b"inf", b"-inf", b"1e1", b"14.99", b"38.01")),
        *(("temperature", text) for text in (b"2_5", b"+25", b"0x19", b"25,5", b"-25", b"true", b"null")),
        *(("temperature", text) for text in (b"", b" 25", b"25\n", "٢٥".encode(), b"9" * 400)),
        ("mode", b"cool"),
        ("mode", b"AUTO"),
        ("fan_mode", b"high"),
        ("controller", b"mpc"),
        ("controller", b"None"),
        ("maintenance", b"-1"),
        ("maintenance", b"1440.1"),
        ("maintenance", b"1e9"),
        ("emergency_stop", b""),
        ("confirm", b""),
        ("discard", b""),
        ("discard", b" why"),
        ("install_bundle", b"{}"),
        ("install_bundle", b'{"url": "http://fleet/b.zip", "sha256": "A"}'),
        ("install_bundle", b'{"url": "http://fleet/b.zip", "sha256": "%s", "action": "x"}' % (b"a" * 64)),
        ("rollback_bundle", b"PRESS"),
        ("rollback_bundle", b'{"version": "../x"}'),
        ("manual", b"{}"),
        ("manual", b'{"heater_duty": 1.0001}'),
        ("manual", b'{"heater_duty": -0.01}'),
        ("manual", b'{"valve_pulse_s": 1}'),
        ("manual", b"0.5"),
        ("manual", b"\xff"),
        ("resend", b'{"first_seq": 2, "last_seq": 1}'),
        ("resend", b'{"first_seq": 0, "last_seq": 1}'),
        ("resend", b'{"first_seq": 1, "last_seq": 9223372036854775808}'),
        ("reboot", b"PRESS"),
        ("", b"PRESS"),
    ],
)
def test_anything_else_is_refused(what, payload):
    with pytest.raises(RequestError):
        parse(what, payload, REFERENCE)


def test_a_payload_at_the_size_limit_is_read_and_one_byte_more_is_refused():
    fits = b'{"heater_duty": 0.5}'.ljust(PAYLOAD_MAX)
    assert parse("manual", fits, REFERENCE)["heater_duty"] == 0.5
    with pytest.raises(RequestError, match="longer than"):
        parse("manual", fits + b" ", REFERENCE)


def test_an_error_does_not_repeat_a_long_payload():
    with pytest.raises(RequestError) as error:
        parse("mode", b"x" * PAYLOAD_MAX, REFERENCE)
    assert len(str(error.value)) < 200


@given(what=st.sampled_from(COMMANDS) | st.text(max_size=20), payload=st.binary(max_size=PAYLOAD_MAX + 50))
def test_garbage_is_refused_or_is_an_order_the_loop_understands(what, payload):
    try:
        request = parse(what, payload, REFERENCE)
    except RequestError:
        return
    others = ("status", "clear_trip", "resend", "undo", "why", "commission")
    if request["do"] not in (*others, *ASKED_OF_THE_DESK):
        operate(Operation("MPC"), request, desk())


@given(
    what=st.sampled_from(("temperature", "maintenance")), value=st.floats() | st.integers() | st.decimals()
)
def test_no_number_outside_the_range_passes(what, value):
    try:
        request = parse(what, str(value).encode(), REFERENCE)
    except RequestError:
        return
    if what == "temperature":
        assert 15.0 <= request["reference_c"] <= 38.0
    else:
        assert 0.0 <= request["minutes"] <= 1440.0
