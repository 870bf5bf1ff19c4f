"""The programs that are flashed, c/../hex, on simulated boards with simulated sensors at their pins."""

import os
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from avr.sensor_parts import BLOCK_AT, DRY, NOW, WET, WIRINGS, SensorParts, all_parts, configured, wire_up
from avr.simulated_avr import FREQUENCY, AvrRig, SimulatedAvr

import firmware_protocol
from firmware_protocol.board_block import Output, Part, PartConfig
from firmware_protocol.frame import encode
from firmware_protocol.link import LinkEcho, LinkUp, PairTold, Report
from firmware_protocol.messages import (
    AirPair,
    AirVerdict,
    BlockCommit,
    BlockWrite,
    CommandMessage,
    HelloRequest,
    Ping,
    Quality,
    TripCause,
    pack,
)
from tests.support.c_core import SOURCES

pytestmark = pytest.mark.slow

HEX = Path(firmware_protocol.__file__).parent / "hex"
FLASH_MAX = 24 * 1024  # of the 32 kB of an ATmega328P, where the bootloader stands too
RAM_MAX = int(1.85 * 1024)  # of the 2 kB of an ATmega328P
INTERRUPTS_OFF_MAX = 80 * FREQUENCY // 1_000_000
STEP_MAX = 2 * FREQUENCY // 1000
HEAT = CommandMessage(20, True, 60, 0.0, False, 60.0)
QUALITIES = ("temp_air_quality", "rel_humidity_quality", "co2_quality", "light_quality",
             "soil_moisture_quality", "tank_level_quality", "temp_ambient_quality")  # fmt: skip


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Folder with the programs built anew, with their symbols."""
    folder = tmp_path_factory.mktemp("hex")
    command = ["sh", str(SOURCES / "build.sh"), str(folder)]
    subprocess.run(command, check=True, env=os.environ | {"KEEP_ELF": "1"}, capture_output=True)
    return folder


class BoardWithSensors(AvrRig):
    """A board with every sensor, the host's link at its line."""

    def __init__(self, avr: SimulatedAvr, parts: SensorParts) -> None:
        super().__init__(avr, has_sensor=False)
        self.parts = parts
        wire_up(avr, parts.wiring)

    def report(self, within_s: float, name: str, quality: Quality):
        """The first report of this quality, at most so many seconds later."""
        self.run(within_s, until=lambda rig: qualities(rig, name) == {quality})
        assert qualities(self, name) == {quality}
        return self.seen(Report)[-1].report

    def warm_up(self) -> None:
        """Run until every signal is good."""
        self.run(12.0, until=lambda rig: qualities(rig) == {Quality.GOOD})
        assert qualities(self) == {Quality.GOOD}


def qualities(board: AvrRig, *names: str) -> set[Quality]:
    """Those of the last report; none before the first."""
    reports = [event.report for event in board.seen(Report)[-1:]]
    return {getattr(report, name) for report in reports for name in names or QUALITIES}


@pytest.fixture(params=WIRINGS)
def wiring(request):
    return WIRINGS[request.param]


@pytest.fixture
def board(avr_host, wiring):
    """A board with all parts but the DHT22."""
    yield from powered(avr_host, wiring, all_parts(wiring))


def on(*boards: str) -> pytest.MarkDecorator:
    """For what the boards share: their pins are tried on both by the tests without this mark."""
    return pytest.mark.parametrize("wiring", [WIRINGS[board] for board in boards], ids=boards)


def powered(avr_host, wiring, config_parts, program: Path | None = None, **values):
    name = "mega2560" if wiring is WIRINGS["mega2560"] else "uno"
    program = program or next(HEX.glob(f"{name}-*.hex"))
    parts = SensorParts(wiring)
    eeprom = configured(wiring, config_parts, **values)
    with SimulatedAvr(avr_host, program, eeprom, wiring.microcontroller, parts) as avr:
        yield BoardWithSensors(avr, parts)


def test_the_files_of_the_package_are_what_the_sources_give(built):
    assert (built / "SHA256SUMS").read_text() == (HEX / "SHA256SUMS").read_text()
    assert subprocess.run(["sha256sum", "--check", "--quiet", "SHA256SUMS"], cwd=HEX).returncode == 0


def test_every_signal_of_a_full_rig_is_reported_and_stays_good(board):
    board.warm_up()
    first = len(board.seen(Report))
    board.run(7.0)  # the slowest part measures every 5 s
    report = board.seen(Report)[-1].report
    assert report.temp_air_c == pytest.approx(25.0, abs=0.02)
    assert report.temp_ambient_c == 18.0
    assert report.co2_ppm == 500
    assert report.light == pytest.approx(28067 / 40_000, abs=1e-4)
    assert report.soil_moisture == pytest.approx((DRY - NOW) / (DRY - WET), abs=3e-3)
    assert report.tank_level == pytest.approx(1 / 3, abs=5e-3)
    assert report.rel_humidity_pct == pytest.approx(40.25, abs=0.1)
    reports = [event.report for event in board.seen(Report)[first:]]
    assert {getattr(one, name) for one in reports for name in QUALITIES} == {Quality.GOOD}
    assert board.parts.wire.wrong == [] and len(reports) == 7


@pytest.fixture
def dht22_board(avr_host, wiring):
    """A board whose only air sensor is a DHT22, beside a DS18B20 outside."""
    outside = replace(all_parts(wiring)[2], serial=0)
    yield from powered(avr_host, wiring, (PartConfig(Part.DHT22, wiring.dht22[0]), outside))


def test_a_dht22_and_a_lone_ds18b20_are_read_and_silence_turns_the_heater_off(dht22_board):
    dht22_board.parts.wire.parts.remove(dht22_board.parts.inside)
    report = dht22_board.report(8.0, "temp_air_quality", Quality.GOOD)
    assert (report.temp_air_c, report.rel_humidity_pct, report.temp_ambient_c) == (25.1, 50.0, 18.0)
    first = len(dht22_board.seen(Report))
    dht22_board.run(6.0)
    assert {event.report.temp_air_quality for event in dht22_board.seen(Report)[first:]} == {Quality.GOOD}
    dht22_board.ask(HEAT)
    assert state(dht22_board).heater_steps == 20
    dht22_board.parts.dht22.plugged = False
    dht22_board.report(8.0, "temp_air_quality", Quality.FAULT)
    assert state(dht22_board).heater_steps == 0


def state(board):
    board.ask(Ping())
    return board.seen(LinkEcho)[-1].state


def levels_of(board, wiring) -> tuple[int, ...]:
    """Level of each output that is driven, None for one that is not."""
    return tuple(driven(board.avr, *place) for place in wiring.output_places)


def driven(avr, port: str, bit: int) -> int | None:
    first = 0x20 + 3 * (ord(port) - ord("A"))
    direction, output = avr.read(first + 1, 2)
    return output >> bit & 1 if direction >> bit & 1 else None


@pytest.mark.parametrize(
    ("wiring", "inverted"),
    [(WIRINGS["mega2560"], frozenset()), (WIRINGS["uno"], frozenset(Output))],
    ids=["mega2560 on high", "uno on low"],
)
def test_every_output_is_driven_on_its_pin(avr_host, wiring, inverted):
    for board in powered(avr_host, wiring, all_parts(wiring), inverted=inverted):
        on = 0 if inverted else 1
        board.run(3.0)
        assert levels_of(board, wiring) == (1 - on, on, 1 - on, 1 - on)  # the fan, on its own
        board.ask(replace(HEAT, valve_pulse_s=2.0))
        board.run(1.2)  # a slot of the heater's relay
        assert levels_of(board, wiring) == (on, on, on, on)
        board.ask(replace(HEAT, heater_steps=0, fan_on=False, led_pct=0))
        board.run(2.0)
        assert levels_of(board, wiring) == (1 - on, 1 - on, 1 - on, on)


FAULTS = {
    "no sht": (lambda parts: parts.sht.unplug(), lambda parts: parts.sht.plug(), "rel_humidity_quality"),
    "no scd4x": (lambda parts: parts.co2.unplug(), lambda parts: parts.co2.plug(), "co2_quality"),
    "no bh1750": (lambda parts: parts.light.unplug(), lambda parts: parts.light.plug(), "light_quality"),
    "sht with wrong CRCs": (
        lambda parts: parts.sht.damages.extend([lambda data: data[:2] + b"\x5a" + data[3:]] * 60),
        lambda parts: parts.sht.damages.clear(),
        "rel_humidity_quality",
    ),
    "no ds18b20 outside": (
        lambda parts: setattr(parts.outside, "plugged", False),
        lambda parts: parts.outside.plug(),
        "temp_ambient_quality",
    ),
    "no echo": (
        lambda parts: setattr(parts.tank, "plugged", False),
        lambda parts: setattr(parts.tank, "plugged", True),
        "tank_level_quality",
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("wiring", "faults"),
    [(WIRINGS["uno"], list(FAULTS)[::2]), (WIRINGS["mega2560"], list(FAULTS)[1::2])],
    ids=["uno", "mega2560"],
)
def test_a_part_at_fault_is_told_the_others_stay_and_it_comes_back(board, faults):
    board.warm_up()
    for fault in faults:
        begin, end, name = FAULTS[fault]
        first = len(board.seen(Report))
        begin(board.parts)
        board.report(14.0, name, Quality.FAULT)
        board.run(2.0)
        end(board.parts)
        board.report(16.0, name, Quality.GOOD)
        others = set(QUALITIES) - {name}
        reports = [event.report for event in board.seen(Report)[first:]]
        assert {getattr(one, other) for one in reports for other in others} == {Quality.GOOD}, fault


@on("uno")
def test_a_probe_that_is_cut_off_is_a_fault(board):
    board.report(4.0, "soil_moisture_quality", Quality.GOOD)
    for millivolts in (0, 5000):
        board.avr.set_millivolts(board.parts.wiring.channel, millivolts)
        board.report(5.0, "soil_moisture_quality", Quality.FAULT)
        board.avr.set_millivolts(board.parts.wiring.channel, 2500)
        board.report(5.0, "soil_moisture_quality", Quality.GOOD)


@on("mega2560")
def test_a_wire_that_is_stuck_low_is_a_fault_and_recovers(board):
    place = board.parts.wiring.wire[1:]
    board.report(4.0, "temp_ambient_quality", Quality.GOOD)
    board.parts.wire.is_stuck = True
    board.avr.set_level(*place, 0)
    during = board.report(6.0, "temp_ambient_quality", Quality.FAULT)
    assert during.temp_air_c == 25.0 and during.temp_air_quality is Quality.GOOD  # the SHT's alone
    board.parts.wire.is_stuck = False
    board.avr.set_level(*place, 1)
    board.report(6.0, "temp_ambient_quality", Quality.GOOD)


@pytest.mark.parametrize(
    ("wiring", "clocks"), [(WIRINGS["uno"], 1), (WIRINGS["mega2560"], 9)], ids=["uno", "mega2560"]
)
def test_a_part_that_holds_the_i2c_bus_is_clocked_out(board, clocks):
    board.warm_up()
    board.parts.clocks_until_free = clocks
    board.avr.set_level(*board.parts.wiring.sda[1:], 0)
    board.run(3.0)
    assert board.parts.clocks_until_free is None
    reports = [event.report for event in board.seen(Report)[-3:]]
    assert {getattr(one, name) for one in reports for name in QUALITIES} == {Quality.GOOD}


@on("uno")
def test_an_i2c_bus_that_stays_stuck_is_a_fault_of_its_parts_alone(board):
    board.warm_up()
    board.avr.set_level(*board.parts.wiring.sda[1:], 0)
    dead = {"rel_humidity_quality", "co2_quality", "light_quality"}
    board.run(14.0, until=lambda rig: qualities(rig, *dead) == {Quality.FAULT})
    assert qualities(board, *dead) == {Quality.FAULT}
    assert qualities(board, *(set(QUALITIES) - dead)) == {Quality.GOOD}
    assert board.seen(Report)[-1].report.temp_air_c == 25.0  # of the DS18B20


@on("mega2560")
def test_of_two_air_sensors_the_warmer_counts_where_they_disagree_and_trips_the_board(board):
    board.report(5.0, "temp_air_quality", Quality.GOOD)
    board.parts.inside.sixteenths = 46 * 16
    board.run(8.0, until=lambda rig: rig.seen(Report)[-1].report.temp_air_c == 46.0)
    board.run(1.1)
    assert board.seen(Report)[-1].report.temp_air_c == 46.0
    assert board.seen(PairTold)[-1].pair == AirPair(25.0, 46.0, AirVerdict.APART)
    assert state(board).trip_cause is TripCause.OVER_TEMPERATURE


@on("uno")
def test_the_line_loses_no_byte_while_every_sensor_is_read(board):
    board.run(4.0)
    frames = b"".join(encode(pack(HEAT, seq)) for seq in range(1, 256))
    sent = 0
    while sent < 115_200 / 10 * 8.0:  # 8 s of a full line
        board.avr.run(len(frames) / 11.52, frames)
        sent += len(frames)
    assert board.avr.measured().lost_bytes == 0
    board.run(2.1)
    assert qualities(board) == {Quality.GOOD}


def test_flash_memory_and_times_are_within_their_limits(avr_host, wiring, built, capsys):
    name = "mega2560" if wiring is WIRINGS["mega2560"] else "uno"
    program = next(built.glob(f"{name}-*.elf"))
    rows = subprocess.run(["avr-size", str(program)], check=True, capture_output=True, text=True)
    text, data, bss = map(int, rows.stdout.splitlines()[1].split()[:3])
    # The worst that the program does: all parts, a full line, a configuration that is written and committed.
    for board in powered(avr_host, wiring, all_parts(wiring), program):
        for function in ("gh_sensors_step", "gh_board_step", "gh_board_receive"):
            board.avr.time_function(function)
        board.warm_up()
        for _ in range(20):
            board.avr.run(
                10, bytes(range(1, 56)) + b"\0" + encode(pack(HEAT, 3)) + encode(pack(HelloRequest(3), 4))
            )
        board.run(3.0)
        board.ask(replace(HEAT, heater_steps=0))
        write_block(board, configured(wiring, all_parts(wiring), report_period_ms=2000)[BLOCK_AT:])
        board.ask(BlockCommit())
        board.run(2.0)
        measured = board.avr.measured()
        assert board.seen(LinkUp)[-1].hello.report_period_s == 2.0
    with capsys.disabled():
        print(f"\n{name}: flash {text + data}, static RAM {data + bss}, stack {measured.stack_bytes} bytes")
        print(f"interrupts off at most {measured.longest_without_interrupts} cycles")
        for function, timing in measured.functions.items():
            print(f"{function:18} mean {timing.mean:6.0f}, longest {timing.longest:6} cycles")
    assert text + data <= FLASH_MAX
    assert name != "uno" or data + bss + measured.stack_bytes <= RAM_MAX
    assert measured.longest_without_interrupts <= INTERRUPTS_OFF_MAX
    assert measured.functions["gh_sensors_step"].longest <= STEP_MAX


def write_block(board, block: bytes) -> None:
    for part in range(len(block) // 16):
        low, high = (int.from_bytes(block[part * 16 + at :][:8], "little") for at in (0, 8))
        board.ask(BlockWrite(part, low, high))
