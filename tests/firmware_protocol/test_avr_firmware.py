"""The program for the ATmega2560, as it would be flashed, on a simulated one with the host's own link.

Replaced are the sensors (avr/sensors.c) and the hardware; what simavr cannot show stands in c/README.md.
"""

import json
import random
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from avr.simulated_avr import FAN, FREQUENCY, HEATER, SUPPLY, VALVE, AvrRig, SimulatedAvr, transmitted
from block_slots import BlockSlots

import firmware_protocol
from firmware_protocol.board_block import NO_PIN, BoardBlock, BoardKind, encode_block
from firmware_protocol.frame import FrameDecoder, encode
from firmware_protocol.link import BoardReset, LinkEcho, LinkSetup, LinkUp, Report, RequestRefused
from firmware_protocol.messages import (
    LAYOUTS,
    BlockCommit,
    BlockPart,
    BlockWrite,
    ClearTrip,
    CommandMessage,
    EmergencyStop,
    EndMaintenance,
    ErrorCode,
    ErrorMessage,
    Hello,
    HelloRequest,
    Maintenance,
    Ping,
    Quality,
    ReleaseStop,
    ResetCause,
    StateEcho,
    TripCause,
    WirePart,
    pack,
    unpack,
)
from firmware_protocol.virtual_board.board_config import BoardConfig
from firmware_protocol.virtual_board.core import BoardCore
from tests.support.c_core import SOURCES

pytestmark = pytest.mark.slow

HERE = Path(__file__).parent / "avr"
VECTORS = json.loads((Path(firmware_protocol.__file__).parent / "vectors.json").read_text(encoding="utf-8"))
HANGS, KEEPS_INTERRUPTS_OFF, STOPS_THE_CLOCK, TELLS_NOTHING = 1, 2, 3, 4
HEAT = CommandMessage(20, True, 60, 0.0, False, 60.0)
COLD = replace(HEAT, heater_steps=0, led_pct=0)
OUTPUTS = (22, 23, 24, 25, 6)  # PA0 to PA3, and PH3 with a timer
BLOCK_AT = 16  # in the EEPROM
CONFIGURED = b"\xff" * BLOCK_AT + encode_block(BoardBlock(BoardKind.MEGA2560, board_id=1, pins=OUTPUTS))
BLOCK_PART = LAYOUTS[BlockPart].kind
BYTE_CYCLES = 1389  # 10 bits at 115200 baud
SMALL_FLASH = 32_768  # of an ATmega328P


def compile_for_avr(target: Path, *sources: Path) -> Path:
    """The board's program without its drivers, with further sources."""
    if shutil.which("avr-gcc") is None:
        pytest.fail("avr-gcc is missing: `make test` installs gcc-avr and avr-libc")
    wire = SOURCES / "drivers" / "gh_one_wire.c"  # for the search, which is no driver
    all_sources = [*sorted(SOURCES.glob("gh_*.c")), *sorted((SOURCES / "boards").glob("*.c")), wire, *sources]
    includes = [f"-I{SOURCES / folder}" for folder in (".", "drivers", "boards")]
    flags = ["-mmcu=atmega2560", "-DF_CPU=16000000UL", "-std=gnu11", "-Os", "-Wall", "-Wextra", "-Werror"]
    subprocess.run(["avr-gcc", *flags, *includes, *map(str, all_sources), "-o", str(target)], check=True)
    return target


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """The board's program with sensors that a test sets."""
    return compile_for_avr(tmp_path_factory.mktemp("avr") / "board.elf", HERE / "sensors.c")


@pytest.fixture
def avr(avr_host, program):
    with SimulatedAvr(avr_host, program, CONFIGURED) as simulated:
        yield simulated


def greeted(avr: SimulatedAvr) -> AvrRig:
    """A rig whose link has just come up."""
    rig = AvrRig(avr)
    rig.run(1.0, until=lambda rig: rig.link.state == "up")
    assert rig.link.state == "up"
    return rig


def sampled(avr: SimulatedAvr) -> AvrRig:
    """A greeted rig with a good air sample."""
    rig = greeted(avr)
    rig.run(2.0, until=lambda rig: rig.seen(Report))
    return rig


def heating(avr: SimulatedAvr) -> AvrRig:
    """A rig whose heater is on."""
    rig = sampled(avr)
    rig.ask(HEAT)
    rig.run(2.0, until=lambda rig: rig.port() & HEATER)
    assert rig.port() == HEATER | FAN | SUPPLY
    return rig


def state(rig: AvrRig) -> StateEcho:
    rig.ask(Ping())
    return rig.seen(LinkEcho)[-1].state


def test_it_greets_and_reports_every_second(avr):
    rig = AvrRig(avr)
    rig.run(3.3)
    [up] = rig.seen(LinkUp)
    assert (up.hello.board_id, up.hello.reset_cause) == (1, ResetCause.POWER_ON)
    reports = [event.report for event in rig.seen(Report)]
    assert [report.board_ms for report in reports] == [1000, 2000, 3000]
    assert {(r.temp_air_c, r.temp_air_quality) for r in reports} == {(25.0, Quality.GOOD)}


def on_outputs(trace):
    """Kind and value of the events of the outputs' port, and of whatever has none."""
    return [(event.kind, event.value) for event in trace if event.port == "A" or event.kind in "RTE"]


BECOME_OUTPUTS = [("D", HEATER), ("D", HEATER | FAN), ("D", HEATER | FAN | VALVE), ("D", 0xF)]


def test_the_pins_are_safe_before_they_are_outputs_and_before_the_first_byte(avr):
    shown = [event for event in on_outputs(avr.run(50)) if event[0] in "PDT"]
    assert shown[:5] == [*BECOME_OUTPUTS, ("P", FAN)]
    assert all(kind == "T" for kind, _ in shown[5:]) and len(shown) > 40


@pytest.mark.parametrize(
    "eeprom",
    [b"\xff" * 4096, CONFIGURED[:40] + b"\0" + CONFIGURED[41:], CONFIGURED[:16] + bytes(144)],
    ids=["blank", "damaged", "all zero"],
)
def test_without_a_configuration_no_pin_is_driven(avr_host, program, eeprom):
    with SimulatedAvr(avr_host, program, eeprom) as plain:
        rig = AvrRig(plain)
        rig.run(2.2)
        rig.ask(replace(HEAT, led_pct=0, cutoff_open=False))
        rig.run(2.0)
        assert not [event for event in rig.trace if event.kind in "PD"]
        [up] = rig.seen(LinkUp)
        assert up.hello.board_id == 0


def test_a_command_drives_every_output_and_the_relay_in_slots(avr):
    rig = sampled(avr)
    rig.ask(CommandMessage(3, False, 60, 0.5, False, 5.0))
    pins = rig.run(2.5)
    asked_s = pins[0][0]
    assert {led for time_s, _, led in pins} == {60 * 255 // 100}
    assert not any(port & FAN for _, port, _ in pins) and all(port & SUPPLY for _, port, _ in pins)
    assert 0.4 <= sum(bool(port & VALVE) for _, port, _ in pins) / 100 <= 0.52
    closed = [time_s for time_s, port, _ in pins if port & HEATER]
    assert asked_s < 2.0  # in slot 1; of 0, 1 and 2 only slot 2 is left; board_ms 0 is 30 ms late
    assert 2.0 < closed[0] < 2.06 and 2.98 < closed[-1] < 3.05


def test_the_heater_goes_off_ten_seconds_after_the_host_fell_silent(avr):
    rig = heating(avr)
    rig.ask(HEAT)  # asks for 60 s
    asked_s = avr.now
    while rig.port() & HEATER:
        avr.run(10)
    assert 9.95 < avr.now - asked_s <= 10.01
    assert (rig.port(), rig.led()) == (FAN, 0)


def test_a_sensor_fault_turns_the_heater_off_and_only_a_command_turns_it_on(avr):
    rig = heating(avr)
    rig.sense(None)
    rig.run(1.1)
    assert rig.port() == FAN and rig.led() > 0
    rig.sense(25.0)
    rig.run(2.1)
    assert rig.port() == FAN
    rig.ask(HEAT)
    rig.run(1.1)
    assert rig.port() & HEATER


def test_a_sensor_that_is_never_read_again_turns_the_heater_off_in_three_seconds(avr):
    rig = heating(avr)
    rig.fail(TELLS_NOTHING)
    pins = rig.run(3.2)
    on = [time_s for time_s, port, _ in pins if port & HEATER]
    assert 1.9 < on[-1] - pins[0][0] <= 3.02
    assert pins[-1][1] == FAN


def test_over_temperature_latches_through_resets_and_power_failures_until_it_is_cleared(
    avr_host, program, avr
):
    rig = heating(avr)
    rig.sense(46.0)
    rig.run(2.1)
    assert rig.port() == FAN
    rig.run(0.1)  # the store is written
    avr.reset()
    rig.run(0.5)
    assert rig.seen(BoardReset)[-1].hello.reset_cause is ResetCause.EXTERNAL
    assert state(rig).trip_cause is TripCause.OVER_TEMPERATURE
    with SimulatedAvr(avr_host, program, avr.eeprom()) as again:
        rig = sampled(again)
        assert rig.seen(BoardReset)[0].hello.boot_count == 2
        rig.sense(46.0)
        rig.run(1.1)
        rig.ask(HEAT)
        rig.ask(ClearTrip())
        assert [event.error.code.name for event in rig.seen(RequestRefused)] == ["TRIPPED"] * 2
        rig.sense(25.0)
        rig.run(1.1)
        rig.ask(ClearTrip())
        assert not rig.seen(LinkEcho)[-1].state.tripped and rig.port() == FAN
        rig.run(0.1)
        cleared = again.eeprom()
    with SimulatedAvr(avr_host, program, cleared) as cold:
        assert not state(greeted(cold)).tripped


STOPS = [
    (EmergencyStop(), ReleaseStop(), TripCause.EMERGENCY_STOP),
    (Maintenance(), EndMaintenance(), TripCause.MAINTENANCE),
]


@pytest.mark.parametrize(("stop", "release", "cause"), STOPS)
def test_a_stop_opens_everything_at_once_the_fan_too(avr, stop, release, cause):
    rig = heating(avr)
    rig.ask(replace(HEAT, lease_s=1.0))
    rig.run(0.1)
    rig.trace.clear()
    rig.ask(stop)
    assert (rig.port(), rig.led()) == (0, 0)
    kinds = "".join(kind for kind, _ in on_outputs(rig.trace) if kind in "PE")
    assert kinds == "PPPEEE"  # the heater's, the fan's and the supply's pin first
    rig.ask(HEAT)
    assert rig.seen(RequestRefused)[-1].error.detail == cause
    rig.run(2.0)  # every lease has ended
    assert (rig.port(), rig.led()) == (0, 0)
    rig.ask(release)
    rig.run(0.1)
    assert rig.port() == FAN  # on its own again: fan_safe_on


@pytest.mark.parametrize(("stop", "cause"), [(stop, cause) for stop, _, cause in STOPS])
def test_no_pin_moves_in_a_reset_or_a_power_failure_while_stopped(avr_host, program, avr, stop, cause):
    rig = heating(avr)
    rig.ask(stop)
    rig.run(0.1)  # the store is written
    rig.trace.clear()
    avr.reset()
    rig.run(1.5)
    assert rig.seen(BoardReset)
    assert not any(kind == "P" and value for kind, value in on_outputs(rig.trace))
    assert state(rig).trip_cause is cause
    with SimulatedAvr(avr_host, program, avr.eeprom()) as again:
        trace = again.run(500)
        assert any(event.kind == "D" for event in trace)
        assert not any(kind == "P" and value for kind, value in on_outputs(trace))


@pytest.mark.parametrize("bytes_written", [1, 2, 3])
def test_power_that_fails_while_a_trip_is_stored_never_leaves_a_board_that_heats(
    avr_host, program, avr, bytes_written
):
    rig = greeted(avr)
    rig.run(0.1)
    rig.link.request(EmergencyStop(), avr.now)
    trace = avr.run(1, rig.link.outgoing())
    while sum(event.kind == "E" for event in trace) < bytes_written:
        trace += avr.run(0.5)
    with SimulatedAvr(avr_host, program, avr.eeprom()) as again:
        whole = bytes_written == 3  # cause and CRC
        expected = TripCause.EMERGENCY_STOP if whole else TripCause.STORAGE_DAMAGED
        assert state(greeted(again)).trip_cause is expected


@pytest.mark.parametrize("fault", [HANGS, KEEPS_INTERRUPTS_OFF, STOPS_THE_CLOCK])
def test_a_program_that_hangs_or_whose_clock_stands_is_reset_and_safe(avr, fault):
    rig = heating(avr)
    rig.fail(fault)
    rig.trace.clear()
    rig.run(1.6, until=lambda rig: any(event.kind == "R" for event in rig.trace))
    rig.fail(0)
    rig.run(0.5)
    begin = next(k for k, event in enumerate(rig.trace) if event.kind == "R")
    shown = [event for event in on_outputs(rig.trace[begin:]) if event[0] in "RPDT"]
    assert shown[:6] == [("R", 0), *BECOME_OUTPUTS, ("P", FAN)]
    assert {kind for kind, _ in shown[6:]} == {"T"}
    hello = rig.seen(BoardReset)[-1].hello
    assert (hello.reset_cause, hello.boot_count) == (ResetCause.WATCHDOG, 1)
    assert rig.link.state == "up" and state(rig).heater_steps == 0


def test_garbage_changes_nothing_and_is_never_obeyed(avr):
    rig = heating(avr)
    noise = random.Random(1)
    before = (rig.port(), rig.led())
    for _ in range(100):
        avr.run(10, noise.randbytes(115))
        assert (rig.port(), rig.led()) == before
    avr.run(20, b"\0")
    assert avr.measured().lost_bytes == 0
    rig.run(2.0)
    assert state(rig).heater_steps == 20


def test_a_line_full_of_requests_starves_neither_the_leases_nor_the_watchdog(avr):
    rig = sampled(avr)
    rig.ask(replace(HEAT, lease_s=1.5))
    pings = b"".join(encode(pack(Ping(), seq)) for seq in range(1, 256))
    trace = [event for _ in range(10) for event in avr.run(200, pings)]  # 197 ms of line
    assert not rig.port() & HEATER and rig.led() == 0
    assert "R" not in {event.kind for event in trace}
    assert avr.measured().lost_bytes == 0
    assert len(transmitted(trace)) > 1000  # answers that find no room are dropped whole
    avr.run(100)
    assert state(rig).heater_steps == 0


def ask_in_parallel(rig: AvrRig, core: BoardCore, data: bytes) -> tuple[list, list]:
    """Return both boards' answers to the same bytes, with the times taken out."""
    core.receive(data, 2000)
    reference = core.transmit()
    # The EEPROM takes 3.4 ms a byte: a trip is stored before it is answered, 16 bytes of a block too.
    wait_ms = 90 if BLOCK_PART in reference[:3] else 30
    said = [transmitted(rig.avr.run(wait_ms + len(data) / 10, data)), reference]
    answers = []
    for stream in said:
        messages = [unpack(payload) for payload in FrameDecoder().feed(b"\0" + stream)]
        answers.append([_timeless(m) for header, m in messages if header.ack != 0 and not _unasked(m)])
    return answers[0], answers[1]


def _timeless(message):
    if isinstance(message, StateEcho):
        return replace(message, board_ms=0, lease_left_s=0.0)
    return replace(message, boot_count=0, reset_cause=0) if isinstance(message, Hello) else message


def _unasked(message) -> bool:
    return not isinstance(message, StateEcho | ErrorMessage | Hello | BlockPart | WirePart)


def test_the_golden_vectors_are_answered_as_the_reference_answers(avr):
    rig = sampled(avr)
    hello = rig.seen(LinkUp)[0].hello
    config = BoardConfig(
        report_period_s=hello.report_period_s, lease_max_s=hello.lease_max_s, temp_trip_c=hello.temp_trip_c,
        valve_pulse_max_s=hello.valve_pulse_max_s, pwm_window_s=hello.pwm_window_s,
        fan_safe_on=hello.fan_safe_on, capabilities=hello.capabilities, board_id=hello.board_id,
        firmware=(hello.firmware_major, hello.firmware_minor, hello.firmware_patch),
    )  # fmt: skip
    core = BoardCore(config, b"", 0, 0, BlockSlots(BoardKind.MEGA2560, CONFIGURED[BLOCK_AT:]))
    core.sample({"temp_air_c": (25.0, 0)}, 2000)
    core.step(2000)
    core.transmit()
    answered = 0
    for vector in VECTORS:
        data = b"\0" + bytes.fromhex(vector["hex"]) + b"\0"
        for asked in (encode(pack(HelloRequest(1), 1)), data, encode(pack(ClearTrip(), 250))):
            simulated, reference = ask_in_parallel(rig, core, asked)
            assert simulated == reference, vector["name"]
            answered += len(reference)
    assert answered > 2 * len(VECTORS)


def test_the_cost_in_cycles_stack_and_flash_is_what_the_comments_say(avr, program, capsys):
    names = ["gh_board_step", "gh_board_receive", "gh_board_transmit", "gh_board_sample", "gh_sensors_step"]
    rig = heating(avr)
    for name in names:
        avr.time_function(name)
    rig.ask(HEAT)
    rig.run(1.0)
    for _ in range(20):
        avr.run(10, bytes(range(1, 56)) + b"\0" + encode(pack(HEAT, 3)) + encode(pack(HelloRequest(3), 4)))
    measured = avr.measured()
    rows = subprocess.run(["avr-size", str(program)], check=True, capture_output=True, text=True)
    text, data, bss = map(int, rows.stdout.splitlines()[1].split()[:3])
    with capsys.disabled():
        print(f"\nflash {text + data}, static RAM {data + bss}, stack {measured.stack_bytes} bytes")
        print(f"interrupts off at most {measured.longest_without_interrupts} cycles")
        for name, timing in measured.functions.items():
            print(f"{name:18} mean {timing.mean:6.0f}, longest {timing.longest:6} cycles")
    assert text + data < SMALL_FLASH // 2
    assert measured.longest_without_interrupts < BYTE_CYCLES // 10
    assert measured.functions["gh_board_receive"].mean < BYTE_CYCLES
    assert all(timing.longest < FREQUENCY // 1000 for timing in measured.functions.values())


def test_the_program_brings_no_eeprom_of_its_own(program):
    listed = subprocess.run(["avr-objdump", "-h", str(program)], check=True, capture_output=True, text=True)
    assert ".eeprom" not in listed.stdout


def written(rig: AvrRig, block: bytes) -> None:
    """Write all parts of a block."""
    for part in range(9):
        data = block[part * 16 :][:16]
        low, high = int.from_bytes(data[:8], "little"), int.from_bytes(data[8:], "little")
        rig.ask(BlockWrite(part, low, high))
        assert rig.seen(LinkSetup)[-1].answer == BlockPart(part, low, high)


MOVED = encode_block(BoardBlock(BoardKind.MEGA2560, board_id=9, pins=(30, 31, NO_PIN, NO_PIN, NO_PIN)))


def test_a_new_configuration_is_in_force_after_its_commit_and_the_old_one_until_then(avr):
    rig = greeted(avr)
    written(rig, MOVED)
    assert rig.seen(LinkUp)[-1].hello.board_id == 1
    rig.ask(BlockCommit())
    rig.run(1.5)
    hello = rig.seen(BoardReset)[-1].hello
    assert (hello.board_id, hello.reset_cause) == (9, ResetCause.SOFTWARE)
    assert avr.read(0x28) == bytes([0x40])  # PORTC: the fan of pin 31 is on, on its own
    assert avr.read(0x21) == b"\0"  # DDRA: no output any more
    written(rig, CONFIGURED[BLOCK_AT:])
    rig.ask(BlockCommit())
    rig.run(1.5)
    assert rig.seen(BoardReset)[-1].hello.board_id == 1


def test_power_that_fails_during_the_commit_leaves_the_old_or_the_new_configuration(avr_host, program, avr):
    rig = greeted(avr)
    written(rig, MOVED)
    rig.link.request(BlockCommit(), avr.now)
    found = set()
    trace = avr.run(0.2, rig.link.outgoing())
    for _ in range(100):
        trace += avr.run(0.2)
        with SimulatedAvr(avr_host, program, avr.eeprom()) as again:
            found.add(greeted(again).seen(LinkUp)[0].hello.board_id)
        if len(found) == 2:
            return
    pytest.fail(f"only {found}")


def test_a_board_that_heats_takes_no_configuration(avr):
    rig = heating(avr)
    before = avr.eeprom()
    rig.ask(BlockWrite(0, 1, 2))
    rig.ask(BlockCommit())
    assert [event.error.code for event in rig.seen(RequestRefused)] == [ErrorCode.HEATING] * 2
    assert avr.eeprom() == before
