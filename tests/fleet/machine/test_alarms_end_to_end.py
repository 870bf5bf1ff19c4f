"""Alarms from numbers: VictoriaMetrics, vmalert by the fleet's rules, and the page that stores them."""

import re
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest
import requests
from fleet_pages import TOKEN, FleetPageOfTest, fleet_page

from edge.core.errors import RequestError
from edge.core.processes import die_with_parent, end_process
from fleet.machine.alarm_rules import EVERY, alarm_rules
from fleet.machine.engines import Engine, engines
from fleet.machine.places import FleetMachine, Ports, places_of
from fleet.page.alarm_shelf import WATCHDOG
from fleet.settings import AlarmRuleSettings, NumbersSettings
from tests.support.broker import free_port, wait_for
from tests.support.page_process import Client, listens

STORED_S = 80.0


@contextmanager
def running(engine: Engine, folder: Path) -> Iterator[None]:
    log = folder / f"{engine.name}.log"
    with log.open("wb") as file:
        process = subprocess.Popen(engine.command, stdout=file, stderr=file, preexec_fn=die_with_parent)
    try:
        wait_for(lambda: listens(engine.port) or process.poll() is not None, engine.name, STORED_S)
        assert process.poll() is None, log.read_text()
        yield
    finally:
        end_process(process, 20.0)


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[tuple[FleetPageOfTest, dict[str, Engine], Path]]:
    """A page and VictoriaMetrics; vmalert waits in the list of engines."""
    numbers = NumbersSettings(url=f"http://127.0.0.1:{free_port()}")
    places = places_of(tmp_path / "fleet")
    places.folder.mkdir()
    with fleet_page(tmp_path, numbers=numbers) as page:
        places.alert_token.write_text(TOKEN)
        ports = Ports(numbers=int(numbers.url.rpartition(":")[2]), alerts=free_port(), page=page.port)
        try:
            found = list(
                engines(places, FleetMachine(str(tmp_path / "data"), names=("localhost",), ports=ports))
            )
        except RequestError as error:
            pytest.skip(str(error))
        known = {engine.name: engine for engine in found}
        with running(known["numbers"], tmp_path):
            yield page, known, places.rules


def store(page: FleetPageOfTest, rig: str, ago_s: float, **values: float) -> None:
    """Write numbers as ingest does, and have them readable."""
    at_ms = round(1000 * (time.time() - ago_s))
    lines = [f'greenhouse_{name}{{rig="{rig}"}} {value} {at_ms}\n' for name, value in values.items()]
    url = page.settings.numbers.url
    assert requests.post(f"{url}/api/v1/import/prometheus", data="".join(lines), timeout=10).ok
    assert requests.get(f"{url}/internal/force_flush", timeout=10).ok


def alarms(client: Client) -> set[tuple[str, str]]:
    found: list[dict[str, Any]] = client.get("/api/alarms?lasting=1").json()["alarms"]
    return {(alarm["name"], alarm["rig"]) for alarm in found}


def test_rigs_that_are_silent_hot_or_tripped_raise_alarms_that_end(fleet, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    page, known, rules = fleet
    good = {"seq": 7.0, "temp_air_c": 24.0, "echo_tripped": 0.0, "link_up": 1.0, "temp_air_c_quality": 0.0}
    for rig, ago_s, changes in (
        ("well", 5.0, {}),
        ("silent", 900.0, {}),
        ("hot", 5.0, {"temp_air_c": 45.5}),
        ("tripped", 5.0, {"echo_tripped": 1.0}),
        ("unplugged", 5.0, {"link_up": 0.0}),
        ("blind", 5.0, {"temp_air_c_quality": 1.0}),
    ):
        page.add_rig(rig, "north")
        store(page, rig, ago_s, **good | changes)
    rules.write_text(alarm_rules(AlarmRuleSettings()).replace(f"interval: {EVERY}", "interval: 1s"))
    ann = page.client("Ann")
    expected = {
        ("rig_silent", "silent"),
        ("air_too_hot", "hot"),
        ("rig_tripped", "tripped"),
        ("board_silent", "unplugged"),
        ("no_air_temperature", "blind"),
    }
    with running(known["alerts"], tmp_path):
        wait_for(lambda: alarms(ann) >= expected, f"the alarms: {expected}", STORED_S)
        assert alarms(ann) == expected
        texts = {row["rig"]: row["text"] for row in ann.get("/api/alarms").json()["alarms"]}
        assert texts["hot"] == "hot: air at 45.5 °C, above 41 °C"
        assert re.fullmatch(r"silent: no tick for 1[4-6]m [0-9.]+s", texts["silent"])
        store(page, "silent", 0.0, **good)
        wait_for(lambda: ("rig_silent", "silent") not in alarms(ann), "the end of the silence", STORED_S)
        assert ann.get("/api/rigs").json()["alarms_silent_s"] is None


def test_the_rules_are_what_vmalert_reads(fleet) -> None:  # type: ignore[no-untyped-def]
    _, known, rules = fleet
    rules.write_text(alarm_rules(AlarmRuleSettings(silent_s=120.0, air_max_c=38.0)))
    done = subprocess.run([*known["alerts"].command, "-dryRun"], capture_output=True, text=True, timeout=30)
    assert done.returncode == 0, done.stderr
    assert "> 120" in rules.read_text()
    assert f"alert: {WATCHDOG}" in rules.read_text()


def test_the_last_day_of_a_rig_is_drawn_from_its_numbers(fleet) -> None:  # type: ignore[no-untyped-def]
    page, _, _ = fleet
    page.add_rig("rig-1")
    for minute in range(10, 0, -1):
        store(page, "rig-1", 60.0 * minute, temp_air_c=20.0 + minute, reference_c=24.0, echo_heater_duty=0.35)
    now = time.time()
    client = page.client("Ann")
    found = client.get(f"/api/rigs/rig-1/course?from_utc={now - 3600}&to_utc={now}&points=60").json()[
        "columns"
    ]
    lengths = {len(column) for column in found.values()}
    assert lengths == {len(found["utc"])}
    air = [value for value in found["air_c"] if value is not None]
    assert set(air) <= {20.0 + minute for minute in range(1, 11)}
    assert len(set(air)) >= 9
    assert air == sorted(air, reverse=True)  # the older ones were warmer
    assert {value for value in found["reference_c"] if value is not None} == {24.0}
    assert {value for value in found["heater"] if value is not None} == {0.35}
    assert found["air_c"][:45] == [None] * 45  # nothing is made up before the first sample
    assert set(found["fan"]) == {None}
    # A name that looks like a query asks for nothing but itself.
    evil = 'x"} or greenhouse_temp_air_c{rig="rig-1'
    page.add_rig(evil)
    answer = client.get(f"/api/rigs/{quote(evil)}/course?from_utc={now - 3600}&to_utc={now}")
    assert answer.ok, answer.text
    assert set(answer.json()["columns"]["air_c"]) == {None}
