"""Each limit, dose, timer and programme after a kill: what was used stays used, whatever the clock does."""

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from loop_rig import UTC_0, LoopRig

from edge.app.daemon import Daemon
from edge.config import loading as config
from edge.config.settings import RampReference, ReferenceSettings, Settings, WateringSettings
from edge.core.clock import RealClock
from edge.core.messages import Command
from edge.safety.memory import AirDoubt, SafetyMemory
from edge.safety.relay_proof import RelayProof
from edge.safety.thermal_supervision import ThermalMemory
from edge.state.codecs import StandingState, encode_limits
from edge.state.store import LIMITS, SURVIVORS, restore
from edge.tick.orders import Operation

DAY_S = 86400.0
WATER = WateringSettings(enabled=True, threshold=0.3, pulse_s=2.0, soak_s=600.0, daily_max_s=4.0)
MANUAL = Path(__file__).parents[3] / "docs" / "run-a-rig.md"


def settings(**parts: object) -> Settings:
    base = config.default()
    return replace(base, **{key: replace(getattr(base, key), **value) for key, value in parts.items()})  # type: ignore[arg-type,call-overload]


@pytest.fixture
def rig(request: pytest.FixtureRequest) -> Iterator[LoopRig]:
    rig = LoopRig(settings=getattr(request, "param", config.default()))
    rig.board.soil = 0.1
    yield rig
    rig.close()


def configured(**parts: object) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("rig", [settings(**parts)], indirect=True, ids=[""])


def water_s(rig: LoopRig) -> float:
    return sum(command.valve_pulse_s for command, _, _ in rig.board.driven)


# water


watered = pytest.mark.parametrize("rig", [replace(config.default(), watering=WATER)], indirect=True, ids=[""])


@watered
def test_a_pulse_is_given_one_tick_after_its_dose_is_on_the_disk(rig: LoopRig) -> None:
    first, second, third = rig.tick(), rig.tick(), rig.tick()
    assert (first.sent.valve_pulse_s, second.sent.valve_pulse_s, third.sent.valve_pulse_s) == (0.0, 2.0, 0.0)
    assert [change.rule for change in first.changes if change.actuator == "valve_pulse"] == ["valve.unsaved"]
    for _ in range(30):
        rig.tick()
    assert water_s(rig) == 4.0


@watered
@pytest.mark.parametrize("ticks", [1, 2, 3], ids=lambda ticks: f"kill after tick {ticks}")
@pytest.mark.parametrize("jump_s", [0.0, 2 * DAY_S, -2 * DAY_S, 600.0])
def test_kills_give_no_more_water_than_a_day_allows_and_no_pulse_before_it_has_soaked(
    rig: LoopRig, ticks: int, jump_s: float
) -> None:
    given: list[float] = []
    while rig.clock.now_s < 3600.0:
        for _ in range(ticks):
            if rig.tick(10.0).sent.valve_pulse_s:
                given.append(rig.clock.now_s)
        rig.kill(off_s=5.0, jump_s=jump_s)
    assert water_s(rig) <= 4.0
    assert all(later - earlier >= 590.0 for earlier, later in pairwise(given))


@watered
@pytest.mark.parametrize(("off_s", "jump_s"), [(60.0, 0.0), (3600.0, 0.0), (60.0, -30 * DAY_S)])
def test_a_reboot_forgets_no_dose(rig: LoopRig, off_s: float, jump_s: float) -> None:
    for _ in range(30):
        rig.tick()
    rig.kill(off_s, jump_s, boot_id="another")
    for _ in range(30):
        rig.tick()
    assert water_s(rig) == 4.0


@watered
def test_the_clock_that_the_network_sets_after_a_reboot_grants_no_second_dose(rig: LoopRig) -> None:
    for _ in range(30):
        rig.tick()
    rig.kill(60.0, boot_id="another")
    rig.clock.utc_offset += 2 * DAY_S
    for _ in range(30):
        rig.tick()
    assert water_s(rig) == 4.0


@watered
def test_a_day_later_there_is_water_again_after_a_kill(rig: LoopRig) -> None:
    for _ in range(30):
        rig.tick()
    rig.kill(off_s=DAY_S)
    rig.tick()
    rig.tick()
    assert water_s(rig) == 6.0


@watered
def test_a_disk_that_takes_no_dose_gets_no_water(rig: LoopRig) -> None:
    rig.disk_works = False
    for _ in range(5):
        rig.tick()
    rig.save_answers[-1]("read-only file system")
    assert rig.tick().sent.valve_pulse_s == 0.0
    assert rig.tick().sent.valve_pulse_s == 0.0  # booked again, and no answer yet
    rig.save_answers[-1]("")
    assert rig.tick().sent.valve_pulse_s == 2.0


@watered
def test_a_dose_that_the_soil_no_longer_needs_is_not_counted(rig: LoopRig) -> None:
    rig.tick()
    rig.board.soil = 0.5
    rig.tick()
    assert rig.loop._memory.doses == ()
    rig.board.soil = 0.1
    rig.tick()
    assert rig.tick().sent.valve_pulse_s == 2.0


@watered
@pytest.mark.parametrize("known", [True, False], ids=["with doses of an older file", "nothing known"])
def test_without_a_record_nothing_is_watered_for_the_soak_time(rig: LoopRig, known: bool) -> None:
    for _ in range(3 if known else 0):
        rig.tick()
    before_s = water_s(rig)
    rig.documents = (rig.documents[0], "") if rig.documents else None
    rig.kill()
    for _ in range(10):
        rig.tick()
    assert water_s(rig) == before_s
    for _ in range(30):
        rig.tick()
    assert water_s(rig) == 4.0


@watered
def test_water_that_earlier_software_gave_in_between_counts(rig: LoopRig) -> None:
    rig.tick()
    assert rig.documents is not None
    limits = rig.documents[1]
    for _ in range(30):
        rig.tick()
    rig.documents = (rig.documents[0], limits)  # a downgrade: it has left this file alone
    rig.kill()
    for _ in range(30):
        rig.tick()
    assert water_s(rig) == 4.0


# maintenance, and what runs by time


@pytest.mark.parametrize(
    ("off_s", "jump_s", "boot_id", "left_s"),
    [
        (60.0, 0.0, "boot", 3540.0),
        (60.0, 7200.0, "boot", 3540.0),  # the monotonic clock knows better
        (60.0, -7200.0, "boot", 3540.0),
        (60.0, 0.0, "another", 3540.0),
        (60.0, -7200.0, "another", 3600.0),  # no clock ran meanwhile: as if no time had passed
        (60.0, 1800.0, "another", 1740.0),  # only the wall clock is left, see docs/run-a-rig.md
    ],
)
def test_a_maintenance_lasts_as_long_as_was_asked_for(
    rig: LoopRig, off_s: float, jump_s: float, boot_id: str, left_s: float
) -> None:
    rig.tick()
    rig.ask({"do": "maintenance", "minutes": 60.0})
    rig.kill(off_s, jump_s, boot_id)
    start_s = rig.clock.now_s
    rig.run(120.0)
    until_utc = rig.loop._operation.maintenance_until_utc
    assert until_utc is not None
    assert until_utc - rig.clock.utc_offset - start_s == pytest.approx(left_s)
    assert rig.board.maintained


def test_a_maintenance_that_ends_between_two_jumps_ends_when_it_should(rig: LoopRig) -> None:
    rig.tick()
    rig.ask({"do": "maintenance", "minutes": 60.0})
    rig.tick()
    rig.clock.utc_offset += 3000.0  # seen by no tick before the kill
    rig.kill(off_s=60.0)
    rig.loop._follow_clock()
    assert rig.loop._operation.in_maintenance(rig.clock.utc())
    rig.clock.now_s += 3480.0 - 1.0
    assert rig.loop._operation.in_maintenance(rig.clock.utc())
    rig.clock.now_s += 2.0
    assert not rig.loop._operation.in_maintenance(rig.clock.utc())


RAMP = ReferenceSettings(
    kind="ramp", ramp=RampReference(from_c=22.0, to_c=28.0, start_s=0.0, duration_s=3600.0)
)
STEPS = config.parse(
    "reference: {kind: steps, steps: [{at_s: 0, reference_c: 22}, {at_s: 1500, reference_c: 25}]}"
).reference


def reference_c(rig: LoopRig) -> float:
    return rig.sink.records[-1].reference_c


@pytest.mark.parametrize("reference", [RAMP, STEPS], ids=["ramp", "steps"])
@pytest.mark.parametrize("boot_id", ["boot", "another"])
@pytest.mark.parametrize("kills", [1, 6])
def test_a_reference_over_time_goes_on_after_kills(
    reference: ReferenceSettings, boot_id: str, kills: int
) -> None:
    rig = LoopRig(settings=replace(config.default(), reference=reference))
    for _ in range(kills):
        rig.run(1800.0 / kills)
        rig.kill(60.0, boot_id=boot_id)
    rig.run(60.0)
    assert reference_c(rig) == pytest.approx(
        25.0 + (6.0 / 60.0 * kills if reference is RAMP else 0.0), abs=0.11
    )
    assert rig.loop.status().reference_time_s == pytest.approx(1860.0 + 60.0 * kills, abs=10.0)
    rig.close()


def test_another_reference_begins_with_the_start_that_reads_it() -> None:
    rig = LoopRig(settings=replace(config.default(), reference=RAMP))
    rig.run(1800.0)
    rig.settings = replace(rig.settings, reference=STEPS)
    rig.kill()
    rig.run(60.0)
    assert reference_c(rig) == 22.0
    rig.close()


# limits of safety


@configured(safety={"energy_day_max_wh": 10.0})
@pytest.mark.parametrize("off_s", [5.0, 400.0])
def test_kills_heat_no_more_than_the_cap_of_the_day(rig: LoopRig, off_s: float) -> None:
    heat_wh = 0.0
    for _ in range(100):
        rig.run(60.0)
        heat_wh += rig.sink.records[-1].sent.heater_duty * 100.0 / 60.0
        rig.kill(off_s)
    assert 0.5 < heat_wh <= 10.0  # what was off for minutes counts as heat too: nobody saw the end


@configured(safety={"fan_switches_hour_max": 6})
def test_kills_start_the_fan_no_more_often_than_an_hour_allows(rig: LoopRig) -> None:
    rig.chosen.command = Command(fan_on=True)
    starts = 0
    for _ in range(30):
        rig.run(60.0)
        starts += rig.sink.records[-1].sent.fan_on
        rig.kill()
    assert 1 <= starts <= 3


@configured(safety={"fan_min_off_s": 120.0})
def test_a_kill_counts_as_the_fans_last_switch(rig: LoopRig) -> None:
    rig.chosen.command = Command(fan_on=True)
    assert rig.tick().sent.fan_on
    rig.run(60.0)
    rig.kill()
    assert [rig.tick().sent.fan_on for _ in range(3)] == [False, True, True]


def test_kills_do_not_put_off_the_proof_of_the_relay(rig: LoopRig) -> None:
    proof = RelayProof(since_s=10000.0, heated_s=5000.0, fanned_s=5000.0)
    rig.loop._memory = replace(rig.loop._memory, thermal=ThermalMemory(proof=proof))
    for _ in range(3):
        rig.run(60.0)
        rig.kill(off_s=300.0)
    after = rig.loop._memory.thermal.proof
    assert after.since_s >= 10900.0 and after.is_busy


def test_kills_give_no_further_releases(rig: LoopRig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edge.tick.loop.RELEASES", 2)
    rig.tick()
    answers = []
    for _ in range(3):
        rig.ask({"do": "emergency_stop"})
        answers.append(rig.ask({"do": "release_emergency_stop"})["ok"])
        rig.kill()
    assert answers == [True, True, False]
    rig.kill(off_s=300.0)
    assert rig.ask({"do": "release_emergency_stop"})["ok"]


# the file

SOUND = json.dumps(encode_limits(StandingState(Operation("MPC"), SafetyMemory())))


def test_a_kill_ends_no_doubt_of_the_air(rig: LoopRig) -> None:
    rig.tick()
    rig.rig.sensors.air_doubt = AirDoubt(rig.clock.now_s, "from 38.0 to 0.0 °C", 38.0)
    rig.board.temp_air = 0.0
    rig.tick()
    since_s = rig.clock.now_s - 60.0
    rig.kill()
    assert rig.rig.sensors.air_doubt == AirDoubt(since_s, "from 38.0 to 0.0 °C", 38.0)
    rig.tick()
    assert rig.sink.records[-1].sent.heater_duty == 0.0
    rig.board.temp_air = 38.0
    for _ in range(10):
        rig.tick(1.0)
    rig.kill()
    assert rig.rig.sensors.air_doubt is None


def test_limits_are_read_as_they_were_written(rig: LoopRig) -> None:
    rig.tick()
    rig.run(120.0)
    assert rig.documents is not None
    written = json.loads(rig.documents[1])
    assert written["heat"] and written["reference_start"]
    read = LIMITS.decode(written)
    assert read.at.boot_id == "boot" and read.at.utc > UTC_0
    assert read.heat == tuple(map(tuple, written["heat"]))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "null",
        '{"at": 1}',
        '{"heat": [[1]]}',
        '{"doses": [[0, 0, -1]]}',
        SOUND.replace('"releases_s": 0.0', '"releases_s": 1e18'),
        "a folder",
    ],
)
def test_damaged_limits_are_reported_and_stop_nothing(tmp_path: Path, text: str) -> None:
    path = tmp_path / "limits.json"
    if text == "a folder":
        path.mkdir()
    else:
        path.write_text(text)
    places = f"""
    state_file: {tmp_path}/state.json
    control_socket: {{path: {tmp_path}/control.sock}}
    history: {{path: {tmp_path}/history.db}}
    board: {{port: {tmp_path}/no-board}}
    bundle: {{path: ""}}
    drift: {{enabled: false}}
    control: {{controller: rules}}
    """
    found = config.parse(places)
    assert isinstance(restore(LIMITS, found), str)
    with Daemon(found, RealClock()) as daemon:
        assert daemon._loop is not None
        assert not daemon._loop._operation.emergency_stop
        (event,) = (event for event in daemon._loop._events.take() if event.key == "limits.unknown")
    assert str(path) in event.text and event.text.endswith("no water for 10 min")


def test_the_manual_names_each_file_that_survives() -> None:
    text = MANUAL.read_text()
    places = [survivor.place(config.default()) for survivor in SURVIVORS]
    folder = Path(config.default().state_file).parent
    beside = [place.name for place in places if place.parent == folder]
    assert [name for name in beside if f"`{name}`" not in text] == []
