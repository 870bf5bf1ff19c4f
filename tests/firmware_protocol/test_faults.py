"""Every fault of the virtual board: how it is told, what it does, and that the heater pin falls then."""

import math
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st
from line import LineHost

from firmware_protocol.link import BoardReset, LinkLost, LinkUp, Nonsense, VersionRefused
from firmware_protocol.messages import Capability, Quality
from firmware_protocol.virtual_board.core import Pins
from firmware_protocol.virtual_board.device import BoardClock
from firmware_protocol.virtual_board.faults import KINDS, FaultError, Schedule, make_fault
from firmware_protocol.virtual_board.plant import Plant
from firmware_protocol.virtual_board.port import FaultyLine
from firmware_protocol.virtual_board.sensors import SensorFaults
from tests.support.virtual_board import CORES, on_cores_in_turn, virtual_board

pytestmark = pytest.mark.slow

LEASE_S = 10.0


def fault(name, now_ms=0, seed="0", **keys):
    return make_fault({"name": name, **keys}, now_ms=now_ms, seed=seed, place="test")


# Telling them


def test_every_fault_that_needs_nothing_can_be_told_by_its_name_alone():
    needy = {"sensor_value", "sensor_offset", "sensor_spike"}
    for name in KINDS.keys() - needy:
        assert fault(name).name == name
    for name in needy:
        with pytest.raises(FaultError, match="is missing"):
            fault(name)


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        (None, "a fault is a mapping"),
        ([], "a fault is a mapping"),
        ({}, "unknown fault None"),
        ({"name": 5}, "unknown fault 5"),
        ({"name": "heater_stuck"}, "nearest known: 'heater_stuck_on'"),
        ({"name": "mute", "durations_s": 5}, "unknown key 'durations_s'; nearest known: 'duration_s'"),
        ({"name": "reset", "duration_s": 5}, "unknown key 'duration_s'"),  # it happens at once
        ({"name": "mute", "direction": "to_hots"}, "direction: unknown 'to_hots'; nearest known: 'to_host'"),
        ({"name": "sensor_stuck", "signal": "temp_air"}, "nearest known: 'temp_air_c'"),
        ({"name": "drop_bytes", "rate": 1.001}, "rate: 1.001 is outside 0..1"),
        ({"name": "drop_bytes", "rate": -0.001}, "is outside"),
        ({"name": "drop_bytes", "rate": math.nan}, "rate: nan is outside"),
        ({"name": "drop_bytes", "rate": math.inf}, "is outside"),
        ({"name": "drop_bytes", "rate": True}, "True is not a number"),
        ({"name": "drop_bytes", "rate": "0.1"}, "'0.1' is not a number"),
        ({"name": "drop_bytes", "rate": None}, "rate is missing"),
        ({"name": "mute", "duration_s": 0}, "duration_s: 0 is outside"),
        ({"name": "mute", "duration_s": math.nan}, "duration_s: nan is outside"),
        ({"name": "mute", "start_s": -1}, "start_s: -1 is outside"),
        ({"name": "mute", "start_s": 4.999}, "has passed, it is 5"),
    ],
)
def test_a_wrong_fault_is_refused_with_its_place(entry, says):
    with pytest.raises(FaultError) as caught:
        make_fault(entry, now_ms=5000, seed="0", place="here")
    assert str(caught.value).startswith("here: ") and says in str(caught.value)


def test_the_edges_of_a_range_are_in_it():
    for rate in (0, 1, 0.0, 1.0):
        assert fault("drop_bytes", rate=rate).number("rate") == rate
    assert fault("mute", now_ms=5000, start_s=5.0).start_ms == 5000


# When


def test_a_fault_lasts_from_its_start_to_just_before_its_end():
    schedule = Schedule([fault("mute", start_s=1, duration_s=2)])
    for now_ms, active in ((0, 0), (999, 0), (1000, 1), (2999, 1), (3000, 0), (9000, 0)):
        schedule.pass_to(now_ms)
        assert len(schedule.active) == active, now_ms


def test_a_fault_that_happens_at_once_begins_once_and_never_lasts():
    schedule = Schedule([fault("reset", start_s=1)])
    begun = [len(schedule.pass_to(now_ms)) for now_ms in (0, 999, 1000, 1001, 5000)]
    assert begun == [0, 0, 1, 0, 0] and schedule.active == []


def test_the_next_change_is_a_start_or_an_end():
    schedule = Schedule([fault("mute", start_s=5, duration_s=1), fault("delay", start_s=2)])
    changes = []
    for _ in range(3):
        schedule.pass_to(int(schedule.next_change_ms) if changes else 0)
        changes.append(schedule.next_change_ms)
    assert changes == [2000, 5000, 6000]
    schedule.clear()
    assert schedule.next_change_ms == math.inf


# The line


def through(data, *faults, now_ms=0, direction="to_host"):
    line = FaultyLine(direction)
    line.set_faults(list(faults))
    line.send(data, now_ms)
    return line.arrive(now_ms)


@given(st.binary(max_size=200))
def test_rate_0_changes_nothing_and_rate_1_everything(data):
    for name in ("drop_bytes", "duplicate_bytes", "flip_bits"):
        assert through(data, fault(name, rate=0)) == data
    assert through(data, fault("drop_bytes", rate=1)) == b""
    assert through(data, fault("duplicate_bytes", rate=1)) == bytes(b for byte in data for b in (byte, byte))
    flipped = through(data, fault("flip_bits", rate=1))
    assert all((a ^ b).bit_count() == 1 for a, b in zip(data, flipped, strict=True))


@given(st.integers(0, 1000))
def test_the_same_seed_spoils_the_same_bytes(seed):
    data = bytes(range(256))
    for name in ("drop_bytes", "duplicate_bytes", "flip_bits"):
        runs = [through(data, fault(name, rate=0.3, seed=str(seed))) for _ in range(2)]
        assert runs[0] == runs[1]


def test_another_seed_spoils_others():
    data = bytes(range(256))
    spoilt = {through(data, fault("flip_bits", rate=0.3, seed=str(seed))) for seed in range(5)}
    spoilt |= {
        through(data, make_fault({"name": "flip_bits", "rate": 0.3, "seed": 9}, now_ms=0, seed="0", place=""))
    }
    assert len(spoilt) == 6


def test_a_rate_is_a_share_of_the_bytes():
    kept = through(bytes(100_000), fault("drop_bytes", rate=0.1))
    assert 89_000 < len(kept) < 91_000  # 10 standard deviations


def test_a_fault_of_one_direction_leaves_the_other_alone():
    assert through(b"abc", fault("mute", direction="to_board"), direction="to_host") == b"abc"
    assert through(b"abc", fault("mute", direction="to_board"), direction="to_board") == b""
    assert through(b"abc", fault("mute"), direction="to_board") == b""


def test_delayed_bytes_come_in_order_also_when_the_delay_ends():
    line = FaultyLine("to_host")
    line.set_faults([fault("delay", delay_s=0.5)])
    line.send(b"a", 0)
    line.set_faults([])
    line.send(b"b", 100)
    assert line.next_arrival_ms == 500
    assert line.arrive(499) == b""
    assert line.arrive(500) == b"ab"
    assert line.next_arrival_ms == math.inf


def test_garbage_is_a_burst_of_its_length():
    line = FaultyLine("to_host")
    line.garbage(fault("garbage", count=33), 0)
    line.garbage(fault("garbage", count=33, direction="to_board"), 0)
    assert len(line.arrive(0)) == 33


# Sensors


def shown(*faults, air=20.0, before=()):
    sensors = SensorFaults()
    for value in before:
        sensors.spoil({"temp_air_c": value, "light": 0.5})
    sensors.set_faults(list(faults))
    samples = sensors.spoil({"temp_air_c": air, "light": 0.5})
    assert samples["light"] == (0.5, Quality.GOOD)
    return samples["temp_air_c"]


def test_what_a_faulty_sensor_shows():
    assert shown() == (20.0, Quality.GOOD)
    assert shown(fault("sensor_none")) == (None, Quality.FAULT)
    value, quality = shown(fault("sensor_nan"))
    assert math.isnan(value) and quality == Quality.GOOD
    assert shown(fault("sensor_value", value=150)) == (150, Quality.GOOD)
    assert shown(fault("sensor_offset", offset=-3.5)) == (16.5, Quality.GOOD)
    assert shown(fault("sensor_spike", size=30)) == (50.0, Quality.GOOD)
    assert shown(fault("sensor_spike", size=30, rate=0)) == (20.0, Quality.GOOD)
    assert shown(fault("sensor_stuck"), before=[18.0, 19.0]) == (19.0, Quality.GOOD)
    assert shown(fault("sensor_none"), fault("sensor_offset", offset=1)) == (None, Quality.FAULT)


def test_a_stuck_sensor_stays_stuck():
    sensors = SensorFaults()
    sensors.spoil({"temp_air_c": 19.0})
    sensors.set_faults([fault("sensor_stuck")])
    assert [sensors.spoil({"temp_air_c": air})["temp_air_c"][0] for air in (20.0, 25.0)] == [19.0, 19.0]


def test_a_spike_is_one_sample_unless_told_otherwise():
    spike = fault("sensor_spike", size=30)
    assert spike.end_ms - spike.start_ms == 1000


# The clock


def test_the_board_clock_wraps():
    clock = BoardClock(0)
    clock.set_before_wrap(1.5, 10_000)
    assert [clock.read(now_ms) for now_ms in (10_000, 11_499, 11_500, 11_501)] == [
        2**32 - 1500,
        2**32 - 1,
        0,
        1,
    ]


def test_the_board_clock_drifts_and_keeps_what_it_has_gained():
    clock = BoardClock(1000)
    clock.set_factor(1.5, 2000)
    assert clock.read(4000) == 1000 + 3000
    clock.set_factor(1.0, 4000)
    assert clock.read(5000) == 5000


# What flows


@dataclass
class FakeChamber:
    steps: list = field(default_factory=list)

    def step(self, dt_s, heater_power_fraction, fan, led, valve):
        self.steps.append((dt_s, heater_power_fraction, fan))

    def sense(self):
        return {"temp_air_c": 20.0}

    def truth(self):
        return {"temp_air_c": 20.0}

    def energy(self):
        return {}


def flows(relay, fan, cutoff_open, *faults):
    plant = Plant(FakeChamber(), Capability.HEATER_CUTOFF)
    plant.set_faults(set(faults), 0)
    plant.drive(Pins(relay, fan, 0.0, False, cutoff_open), 0)
    return plant.heat, plant.fan


@pytest.mark.parametrize("relay", [False, True])
@pytest.mark.parametrize("fan", [False, True])
def test_what_flows_whatever_the_pins_say(relay, fan):
    assert flows(relay, fan, False) == (relay, fan)
    assert flows(relay, fan, False, "heater_stuck_on") == (True, fan)
    assert flows(relay, fan, True, "heater_stuck_on") == (False, fan)  # the second cut-off
    assert flows(relay, fan, True) == (False, fan)
    assert flows(relay, fan, False, "heater_dead") == (False, fan)
    assert flows(relay, fan, False, "heater_dead", "heater_stuck_on") == (False, fan)
    assert flows(relay, fan, False, "fan_stuck_on") == (relay, True)
    assert flows(relay, fan, False, "fan_stuck_off") == (relay, False)


def test_the_chamber_gets_every_millisecond_with_what_flowed_in_it():
    plant = Plant(FakeChamber(), Capability(0))
    plant.drive(Pins(True, False, 0.0, False, False), 100)
    plant.set_faults({"heater_dead"}, 350)
    plant.sense(1000)
    assert plant.chamber.steps == [(0.1, 0.0, False), (0.25, 1.0, False), (0.65, 0.0, False)]
    assert plant.heat_on_ms == 250
    assert plant.heater_pin_on_at_ms == 100 and plant.last_on_ms["heater_relay"] == 1000


# The whole board

FATAL = {  # after each of these the heater pin is off within one lease, and stays off
    "mute": {},
    "mute to the board": {"direction": "to_board"},
    "unplug": {},
    "drop_bytes": {"rate": 1.0},
    "flip_bits": {"rate": 0.5},  # nonsense
    "delay": {"delay_s": 60},
    "sensor_none": {},
    "sensor_nan": {},
    "sensor_value": {"value": 200},
    "sensor_value below": {"value": -21},
    "other_protocol": {},
}


@pytest.mark.parametrize(("name", "core"), on_cores_in_turn(FATAL))
def test_the_heater_pin_is_off_within_one_lease(tmp_path, name, core):
    with virtual_board(tmp_path, "--core", CORES[core]) as board, LineHost(board) as host:
        host.heat()
        host.serve(30)
        assert board.truth()["pins"]["heater_relay"]
        board.inject(name=name.split()[0], **FATAL[name])
        host.serve(30 + LEASE_S + 0.1)
        assert not board.truth()["pins"]["heater_relay"]
        host.serve(70)
        truth = board.truth()
        assert not truth["pins"]["heater_relay"]
        assert 29 < truth["heater_pin_last_on_s"] <= 30 + LEASE_S + 0.1


@pytest.mark.parametrize(("cause", "core"), on_cores_in_turn(["external", "watchdog", "brown_out"]))
def test_a_reset_lets_go_at_once_and_heat_comes_back_only_through_a_new_greeting(tmp_path, cause, core):
    entry = {"name": "brown_out", "count": 1} if cause == "brown_out" else {"name": "reset", "cause": cause}
    with virtual_board(tmp_path, "--core", CORES[core]) as board, LineHost(board) as host:
        host.heat()
        host.serve(30)
        board.inject(**entry, boot_time_s=2.0)
        host.serve(30.2)
        assert not board.truth()["pins"]["heater_relay"]
        silent = len(host.received)
        host.serve(31.9)
        assert len(host.received) == silent  # it boots
        host.serve(50)
        assert [reset.hello.reset_cause.name.lower() for reset in host.seen(BoardReset)] == [
            "power_on",
            cause,
        ]
        assert host.seen(LinkUp)[-1].hello.boot_count == 2
        assert [boot["cause"] for boot in board.truth()["boots"]] == ["power_on", cause]
        assert board.truth()["pins"]["heater_relay"]
        board_ms = [report.board_ms for report in host.reports()]
        assert board_ms[-1] < 30_000  # the clock began anew


def test_a_brown_out_repeats(tmp_path):
    faults = [{"name": "brown_out", "start_s": 10, "count": 4, "period_s": 5}]
    with virtual_board(tmp_path, faults=faults) as board, LineHost(board) as host:
        host.serve(40)
        boots = board.truth()["boots"]
        assert [boot["time_s"] for boot in boots] == [0.0, 11.5, 16.5, 21.5, 26.5]
        assert host.seen(LinkUp)[-1].hello.boot_count == 5


def test_a_board_that_browns_out_faster_than_it_boots_stays_silent(tmp_path):
    faults = [{"name": "brown_out", "start_s": 10, "count": 30, "period_s": 1, "boot_time_s": 2}]
    with virtual_board(tmp_path, faults=faults) as board, LineHost(board) as host:
        host.heat()
        host.serve(60)
        assert [boot["time_s"] for boot in board.truth()["boots"]] == [0.0, 41.0]
        assert host.up and len(host.seen(LinkLost)) == 1


@pytest.mark.parametrize("core", CORES)
def test_the_wrap_of_the_board_clock_disturbs_nothing(tmp_path, core):
    faults = [{"name": "clock_wrap", "before_s": 30}]
    with virtual_board(tmp_path, "--core", CORES[core], faults=faults) as board, LineHost(board) as host:
        host.heat()
        host.serve(60)
        board_ms = [report.board_ms for report in host.reports()]
        assert max(board_ms) > 2**32 - 1500 and board_ms[-1] < 31_000
        assert board.truth()["pins"]["heater_relay"]
        assert not host.seen(LinkLost)
        host.command = None  # and the lease still ends
        host.serve(60 + LEASE_S + 0.1)
        assert not board.truth()["pins"]["heater_relay"]


def test_a_board_with_a_fast_clock_reports_faster(tmp_path):
    with (
        virtual_board(tmp_path, faults=[{"name": "clock_drift", "factor": 1.5}]) as board,
        LineHost(board) as host,
    ):
        host.serve(20.5)
        assert len(host.reports()) == 30
        assert not host.seen(LinkLost)


@pytest.mark.parametrize("core", CORES)
def test_a_board_of_another_protocol_is_refused_by_name_and_never_heats(tmp_path, core):
    faults = [{"name": "other_protocol", "version": 3}]
    with virtual_board(tmp_path, "--core", CORES[core], faults=faults) as board, LineHost(board) as host:
        host.heat()
        host.serve(30)
        refused = host.seen(VersionRefused)
        assert refused and (refused[0].protocol_min, refused[0].protocol_max) == (3, 3)
        assert board.truth()["heater_pin_last_on_s"] is None


@pytest.mark.parametrize("core", CORES)
def test_over_temperature_trips_whatever_the_host_says(tmp_path, core):
    with virtual_board(tmp_path, "--core", CORES[core]) as board, LineHost(board) as host:
        host.heat()
        host.serve(20)
        board.inject(name="sensor_value", value=45.0, duration_s=5)
        host.serve(23)
        truth = board.truth()
        assert not truth["pins"]["heater_relay"] and truth["pins"]["fan"]
        host.serve(60)
        assert board.truth()["heater_pin_last_on_s"] <= 23


def test_one_spike_does_not_trip(tmp_path):
    with virtual_board(tmp_path) as board, LineHost(board) as host:
        host.heat()
        host.serve(20.5)
        board.inject(name="sensor_spike", size=40)
        host.serve(30)
        assert max(report.temp_air_c for report in host.reports()) > 60
        assert board.truth()["pins"]["heater_relay"]


def test_a_stuck_relay_heats_with_the_pin_off_and_the_second_cut_off_ends_it(tmp_path):
    for parts, heats in (((), True), (("--with", "heater_cutoff"), False)):
        with virtual_board(tmp_path, *parts) as board:
            board.inject(name="heater_stuck_on")
            board.ask(advance_to_s=600)
            truth = board.truth()
            assert not truth["pins"]["heater_relay"]
            assert truth["heat_on"] is heats
            assert (truth["energy"]["heater_in_j"] > 40_000) is heats


def test_a_dead_heater_and_a_stuck_fan_do_not_do_what_the_pins_say(tmp_path):
    with virtual_board(tmp_path) as board, LineHost(board) as host:
        board.inject(name="heater_dead")
        board.inject(name="fan_stuck_on")
        host.heat()
        host.serve(60)
        truth = board.truth()
        assert truth["pins"]["heater_relay"] and not truth["heat_on"]
        assert not truth["pins"]["fan"] and truth["fan_on"]
        assert truth["energy"]["heater_in_j"] == 0.0


def test_a_noisy_line_is_counted_and_got_over(tmp_path):
    faults = [{"name": name, "rate": 0.002} for name in ("drop_bytes", "flip_bits", "duplicate_bytes")]
    with virtual_board(tmp_path, faults=faults) as board, LineHost(board) as host:
        host.heat()
        host.serve(300)
        assert host.seen(Nonsense)
        assert board.truth()["heat_on_s"] > 200


def test_cleared_faults_are_over(tmp_path):
    with virtual_board(tmp_path) as board, LineHost(board) as host:
        host.serve(3)
        for entry in (
            {"name": "mute"},
            {"name": "unplug"},
            {"name": "sensor_none"},
            {"name": "reset", "start_s": 9},
        ):
            board.inject(**entry)
        host.serve(6)
        assert board.truth()["faults"] == ["mute", "unplug", "sensor_none"]
        board.ask(clear_faults=True)
        host.serve(12)
        truth = board.truth()
        assert truth["faults"] == [] and truth["plugged"] and len(truth["boots"]) == 1
        assert host.up and host.reports()[-1].temp_air_quality == Quality.GOOD
