"""A tick's payload: every number of a real one, and what no payload can do."""

import json
import re
from collections.abc import Iterator
from typing import Any

import pytest
from history_records import START_UTC, eventful_tick, tick

from edge.core.messages import Reading, ReadingQuality
from edge.core.names import SIGNALS
from edge.formats.tick_json import tick_json
from fleet.ingest.spans import Refused
from fleet.ingest.tick import PAYLOAD_MAX, Tick, parse_tick
from fleet.numbers.series import lines

NOW_UTC = START_UTC + 3600.0
OLDEST_UTC = START_UTC - 86400.0


def body(record: Any = None, **changes: Any) -> dict[str, Any]:
    known = {"history_id": "0f-1", "is_resend": 0, **tick_json(record or tick(5))}
    return {**known, **changes}


def parse(values: Any, rig: str = "rig-1") -> Tick:
    payload = values if isinstance(values, bytes) else json.dumps(values).encode()
    return parse_tick(rig, payload, OLDEST_UTC, NOW_UTC)


def numbers_in(value: Any) -> Iterator[float]:
    if isinstance(value, int | float):
        yield float(value)
    elif isinstance(value, dict | list):
        for item in value.values() if isinstance(value, dict) else value:
            yield from numbers_in(item)


def test_every_number_of_a_tick_is_a_sample() -> None:
    readings = {
        name: Reading(name, 0.5 + place, 0.0, ReadingQuality.GOOD) for place, name in enumerate(SIGNALS)
    }
    whole = body(tick(5, readings=readings))
    found = parse(whole)
    beside = ("history_id", "is_resend", "utc", "why", "changes", "events")
    expected = sorted(numbers_in({key: value for key, value in whole.items() if key not in beside}))
    qualities = [0.0] * len(SIGNALS)
    assert sorted(value for _, value in found.samples) == sorted([*expected, *qualities])
    assert len({name for name, _ in found.samples}) == len(found.samples)
    assert (found.seq, found.utc, found.is_resend, found.unknown) == (5, START_UTC + 300.0, False, "")


def test_a_tick_with_everything_odd_is_taken() -> None:
    found = parse(body(eventful_tick(7)))
    assert [(event.key, event.severity) for event in found.events] == [
        ("board.link_lost", "alarm"),
        ("tick.late", "warning"),
    ]
    text = lines("rig-1", found.utc, found.samples)
    assert 'greenhouse_temp_air_c_quality{rig="rig-1"} 5 ' in text
    assert "greenhouse_temp_air_c{" not in text  # a dead sensor is no number


def test_samples_are_written_as_victoria_metrics_reads_them() -> None:
    found = parse(body())
    text = lines("rig-1", found.utc, found.samples).splitlines()
    at_ms = round(1000 * (START_UTC + 300.0))
    assert f'greenhouse_seq{{rig="rig-1"}} 5 {at_ms}' in text
    assert f'greenhouse_temp_air_c{{rig="rig-1"}} 25.5 {at_ms}' in text
    assert f'greenhouse_forecast_temp_c{{predictor="arx",horizon_min="60",rig="rig-1"}} 27.12 {at_ms}' in text


@pytest.mark.parametrize(
    ("changes", "reason", "text"),
    [
        ({"rig": "rig-2"}, "name", "says that it is 'rig-2'"),
        ({"history_id": 'x"} 1\n'}, "history", "is not a history's"),
        ({"history_id": None}, "history", "is not a history's"),
        ({"seq": 0}, "seq", "seq: 0 is not"),
        ({"seq": -3}, "seq", "seq: -3 is not"),
        ({"seq": True}, "seq", "seq: True is not"),
        ({"seq": 5.0}, "seq", "seq: 5.0 is not"),
        ({"seq": 2**63}, "seq", "is not a whole number"),
        ({"utc": 0.0}, "time", "tick 5: utc: 0.0 is not between"),
        ({"utc": 4102444800.0}, "time", "utc: 4102444800.0 is not between"),
        ({"utc": None}, "time", "utc: None"),
        ({"utc": "now"}, "value", "utc: 'now' is not a number"),
        ({"reference_c": 1e30}, "value", "reference_c: 1e+30 is not a number of at most"),
        ({"reference_c": "26"}, "value", "reference_c: '26' is not a number"),
        ({"link_up": True}, "value", "link_up: True is not a number"),
        ({"sent": {"heater_duty": -1e12}}, "value", "sent_heater_duty: -1000000000000.0"),
        ({"sent": [1]}, "value", "sent: must hold keys and values"),
        (
            {"readings": {"temp_air_c": {"value": 20.0, "quality": "fine"}}},
            "value",
            "'fine' is not a quality",
        ),
        ({"readings": {"temp_air_c": 20.0}}, "value", "temp_air_c: must hold keys and values"),
        ({"forecast_c": [20.0] * 61}, "value", "forecast_c: not a list of at most 60"),
        ({"events": [{}]}, "value", "is not an event"),
        ({"events": [{}] * 201}, "value", "events: not a list of at most 200"),
    ],
)
def test_a_lie_is_refused_and_named(changes: dict[str, Any], reason: str, text: str) -> None:
    with pytest.raises(Refused, match=re.escape(text)) as refused:
        parse(body(**changes))
    assert refused.value.reason == reason


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (b"", "json"),
        (b"\xff\xfe", "json"),
        (b"[1]", "json"),
        (b'{"seq": NaN}', "json"),
        (b'{"seq": 1e999}', "json"),
        (b'{"seq": 1, "seq": 2}', "json"),
        (b"[" * 50_000, "json"),
        (b'{"a": "' + b"x" * PAYLOAD_MAX + b'"}', "size"),
    ],
)
def test_what_is_not_a_document_is_refused(payload: bytes, reason: str) -> None:
    with pytest.raises(Refused, match=r"not JSON|larger than") as refused:
        parse(payload)
    assert refused.value.reason == reason


def test_names_of_a_payload_become_no_series() -> None:
    many = {f"x{number}": {"value": 1.0, "quality": "good"} for number in range(1000)}
    found = parse(body(readings=many, forecasts={"oracle": {"temp_c": {"1": 2.0}}}, extra=3.0))
    names = {name for name, _ in found.samples}
    assert not any("x1" in name or "oracle" in name or "extra" in name for name in names)
    assert found.unknown == "readings.x0 and 1001 more"


def test_a_refused_tick_is_known_by_its_number() -> None:
    with pytest.raises(Refused, match="tick 5") as refused:
        parse(body(utc=0.0))
    assert (refused.value.history_id, refused.value.seq) == ("0f-1", 5)
