"""The 1-Wire search and the driver of the DS18B20 against simulated parts, which follow the datasheet."""

import ctypes
import functools
import random
from collections.abc import Callable, Iterator

import pytest
from drivers.library import (
    FAULT,
    GOOD,
    OK,
    RANGE,
    STUCK,
    U8,
    CDriver,
    Measurement,
    SimulatedOneWire,
    crc8,
    drivers,
)
from hypothesis import given
from hypothesis import strategies as st

# An exception of a simulated part is raised within a callback of C.
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")]

MATCH_ROM, SKIP_ROM, SEARCH_ROM = 0x55, 0xCC, 0xF0
CONVERT_T, READ_SCRATCHPAD, WRITE_SCRATCHPAD = 0x44, 0xBE, 0x4E
FACTORY_EEPROM = (0x4B, 0x46, 0x7F)  # alarms of 75 and 70 degC, 12 bit
POWER_ON = 0x0550  # 85.00 degC
RUNS, FOUND, ENDED, FAILED = range(4)
NEARLY_WRAPPED = 2**32 - 1500


def mirrored(byte: int) -> int:
    return int(f"{byte:08b}"[::-1], 2)


def crc_dow(data: bytes) -> int:
    """CRC-8/MAXIM-DOW, by the mirrored way: another one than the C code's."""
    return mirrored(crc8([mirrored(byte) for byte in data], 0x31, 0x00))


def rom_id(serial: int, family: int = 0x28) -> int:
    """A ROM code: family, 48 bits, CRC."""
    low = bytes([family]) + serial.to_bytes(6, "little")
    return int.from_bytes(low + bytes([crc_dow(low)]), "little")


class Ds18b20:
    """A part as in the datasheet, slot by slot. sixteenths : what the next conversion finds [1/16 degC]"""

    def __init__(
        self, rom: int, sixteenths: int = 20 * 16, eeprom: tuple[int, int, int] = FACTORY_EEPROM
    ) -> None:
        self.rom = rom
        self.sixteenths = sixteenths
        self.eeprom = eeprom
        self.conversion_us = 750_000.0
        self.deaf_to_convert = False
        self.damage: Callable[[bytes], bytes] = bytes  # what it sends instead of its scratchpad
        self.slots_left: int | None = None  # until it is unplugged
        self.plug()

    def plug(self) -> None:
        """Power on."""
        self.plugged = True
        self.slots_left = None
        self.scratchpad = bytearray([POWER_ON & 0xFF, POWER_ON >> 8, *self.eeprom, 0xFF, 0x0C, 0x10])
        self.ready_us: float | None = None
        self.follow = self._deaf()
        self.output = next(self.follow)

    def _advance(self, now_us: float) -> None:
        if self.ready_us is not None and now_us >= self.ready_us:
            self.scratchpad[0:2] = (self.sixteenths & 0xFFFF).to_bytes(2, "little")
            self.ready_us = None

    def reset(self, now_us: float) -> bool:
        self._advance(now_us)
        if self.plugged:
            self.follow = self._listen()
            self.output = next(self.follow)
        return self.plugged

    def level(self, now_us: float) -> bool:
        self._advance(now_us)
        return self.output if self.plugged else True

    def see(self, level: bool, now_us: float) -> None:
        self.now_us = now_us
        if self.plugged:
            self.output = self.follow.send(level)
        if self.slots_left is not None:
            self.slots_left -= 1
            if self.slots_left <= 0:
                self.plugged, self.slots_left = False, None

    def _deaf(self) -> Iterator[bool]:
        while True:
            yield True

    def _receive(self) -> Iterator[bool]:
        byte = 0
        for i in range(8):
            byte |= (yield True) << i
        return byte

    def _send(self, data: bytes) -> Iterator[bool]:
        for byte in data:
            for i in range(8):
                yield bool(byte >> i & 1)

    def _listen(self) -> Iterator[bool]:
        command = yield from self._receive()
        bits = [bool(self.rom >> i & 1) for i in range(64)]
        if command == SEARCH_ROM:
            for bit in bits:
                yield bit
                yield not bit
                if (yield True) != bit:
                    yield from self._deaf()
        elif command == MATCH_ROM:
            for bit in bits:
                if (yield True) != bit:
                    yield from self._deaf()
            yield from self._function()
        elif command == SKIP_ROM:
            yield from self._function()
        yield from self._deaf()

    def _function(self) -> Iterator[bool]:
        command = yield from self._receive()
        if command == READ_SCRATCHPAD:
            content = bytes(self.scratchpad)
            yield from self._send(self.damage(content + bytes([crc_dow(content)])))
        elif command == WRITE_SCRATCHPAD:
            for place in (2, 3, 4):
                self.scratchpad[place] = yield from self._receive()
            self.scratchpad[4] = self.scratchpad[4] & 0x60 | 0x1F
        elif command == CONVERT_T and not self.deaf_to_convert:
            share = 2 ** (3 - (self.scratchpad[4] >> 5 & 3))  # 9 bits take an eighth of the time
            self.ready_us = self.now_us + self.conversion_us / share
            while self.ready_us is not None:
                yield False


class Thermometers(CDriver):
    """The driver with `count` ids."""

    def __init__(self, wire: SimulatedOneWire, *ids: int, start_ms: int = 0) -> None:
        super().__init__("gh_ds18b20", wire, start_ms)
        self.ids = (ctypes.c_uint64 * max(1, len(ids)))(*ids)
        self.init(ctypes.byref(wire.bus), self.ids, U8(len(ids)))

    def run(self, ms: int, stride: int = 1, events: dict[int, Callable[[], None]] | None = None):
        """Step for `ms`. Returns : [(part, raw or None, quality)] in the order told"""
        told = []
        for elapsed in range(0, ms, stride):
            for due in [at for at in events or {} if elapsed <= at < elapsed + stride]:
                events[due]()
            part, found = U8(), Measurement()
            if self.step(ctypes.byref(part), ctypes.byref(found)):
                told.append((part.value, *found.value))
            self.now_ms += stride
        return told


@functools.cache
def dow() -> Callable[[bytes, int], int]:
    function = drivers().gh_one_wire_crc8
    function.restype = U8
    return lambda data, size: function(ctypes.create_string_buffer(data, max(1, size)), U8(size))


def test_the_crc_is_the_one_with_check_value_a1():
    assert dow()(b"123456789", 9) == 0xA1
    assert crc_dow(b"123456789") == 0xA1


@given(st.binary(max_size=20))
def test_the_crc_is_that_of_the_mirrored_way(data):
    assert dow()(data, len(data)) == crc_dow(data)


def search(wire: SimulatedOneWire, calls: int = 2000) -> tuple[list[int], int]:
    """Returns : ids in the order found, and the result that ended it"""
    driver = CDriver("gh_one_wire_search", wire)
    driver._step.restype = ctypes.c_int
    driver.init(ctypes.byref(wire.bus))
    found = []
    for _ in range(calls):
        one = ctypes.c_uint64()
        wire.spent_us = 0.0
        result = driver._step(driver.memory, ctypes.byref(one))
        assert wire.spent_us <= 16 * 70.0
        if result == FOUND:
            found.append(one.value)
        elif result != RUNS:
            assert driver._step(driver.memory, ctypes.byref(one)) == result  # it stays there
            return found, result
    pytest.fail("the search does not end")


@given(st.sets(st.integers(0, 2**48 - 1), min_size=1, max_size=9), st.sampled_from([0x28, 0x10, 0x01]))
def test_the_search_finds_every_id_once(serials, family):
    ids = {rom_id(serial, family) for serial in serials} | {rom_id(7)}
    found, result = search(SimulatedOneWire(*map(Ds18b20, ids)))
    assert result == ENDED
    assert sorted(found) == sorted(ids)


def test_ids_that_differ_in_neighbouring_bits_are_found():
    ids = [rom_id(serial) for serial in range(32)]
    found, result = search(SimulatedOneWire(*map(Ds18b20, ids)), calls=32 * 16 + 1)
    assert (sorted(found), result) == (sorted(ids), ENDED)


def test_the_search_of_an_empty_bus_ends():
    assert search(SimulatedOneWire(), calls=10) == ([], FAILED)


def test_the_search_of_a_bus_that_is_stuck_low_ends():
    wire = SimulatedOneWire(Ds18b20(rom_id(1)))
    wire.result = STUCK
    assert search(wire, calls=10) == ([], FAILED)


def test_zeros_everywhere_are_not_an_id_although_their_crc_is_right():
    wire = SimulatedOneWire(Ds18b20(rom_id(1)))
    wire.disturb = lambda level: False
    assert search(wire) == ([], FAILED)


def test_an_id_with_a_wrong_crc_is_not_told():
    assert search(SimulatedOneWire(Ds18b20(rom_id(1) ^ 1 << 60))) == ([], FAILED)


def test_a_single_disturbed_bit_never_invents_an_id():
    ids = [rom_id(1), rom_id(2), rom_id(77)]
    for disturbed in range(8 + 3 * 64 * len(ids)):
        wire = SimulatedOneWire(*map(Ds18b20, ids))
        slots = iter(range(10**6))
        wire.disturb = lambda level, slots=slots, at=disturbed: level ^ (next(slots) == at)
        found, _ = search(
            wire
        )  # FAILED where a fork was seen that is none; what hides a fork hides the parts behind
        assert set(found) <= set(ids)
        assert len(found) == len(set(found))


def test_a_pass_with_a_wrong_crc_is_repeated():
    wire = SimulatedOneWire(Ds18b20(rom_id(1)))
    slots = iter(range(10**6))
    wire.disturb = lambda level: level ^ (next(slots) in (8 + 3 * 20, 9 + 3 * 20))  # a bit and its complement
    assert search(wire) == ([rom_id(1)], ENDED)


def test_a_part_that_vanishes_during_the_search_ends_it():
    for slots in range(1, 260, 7):
        first, second = Ds18b20(rom_id(1)), Ds18b20(rom_id(2))
        first.slots_left = slots
        found, _ = search(SimulatedOneWire(first, second))
        assert set(found) <= {first.rom, second.rom}


@given(st.integers(0, 2**32))
def test_a_search_over_noise_ends_and_invents_no_id(seed):
    chance = random.Random(seed)
    wire = SimulatedOneWire(Ds18b20(rom_id(1)))
    wire.disturb = lambda level: chance.random() < 0.5
    found, result = search(wire)
    assert result in (ENDED, FAILED)
    assert all(crc_dow(one.to_bytes(8, "little")) == 0 for one in found)


def test_one_part_without_an_id_is_read_every_second():
    wire = SimulatedOneWire(Ds18b20(rom_id(1), 0x0191))  # 25.0625 degC, an example of the datasheet
    assert Thermometers(wire, 0).run(5000) == [(0, 2506, GOOD)] * 5  # the first after 0.76 s


def test_several_parts_are_read_by_their_ids():
    ids = [rom_id(serial) for serial in (5, 2**40 + 3, 77)]
    wire = SimulatedOneWire(*(Ds18b20(one, 16 * (10 + place)) for place, one in enumerate(ids)))
    told = Thermometers(wire, *ids).run(2000)
    assert told[:3] == [(0, 1000, GOOD), (1, 1100, GOOD), (2, 1200, GOOD)]


def test_more_parts_than_the_driver_has_room_for_are_not_read():
    ids = [rom_id(serial) for serial in range(10)]
    told = Thermometers(SimulatedOneWire(*map(Ds18b20, ids)), *ids).run(3000)
    assert {part for part, _, _ in told} == set(range(8))


def test_no_part_tells_nothing():
    assert Thermometers(SimulatedOneWire()).run(2000) == []


def expected(sixteenths: int) -> tuple[int | None, int]:
    celsius = sixteenths / 16
    if not -55 <= celsius <= 125:
        return None, RANGE
    return (None, FAULT) if sixteenths == POWER_ON else (celsius * 100, GOOD)


def test_every_raw_value_is_that_of_floating_point():
    """Through the whole driver; with rounds of 120 ms for speed."""
    part = Ds18b20(rom_id(1))
    part.conversion_us = 0.0
    wire = SimulatedOneWire(part)
    driver = Thermometers(wire, 0)
    driver.run(240, stride=120)
    for sixteenths in [*range(-1000, 2100), -32768, 32767, 4095, -4096]:
        part.sixteenths = sixteenths
        told = driver.run(3600, stride=120)
        value, quality = expected(sixteenths)
        if sixteenths == POWER_ON:
            assert told[-1][1:] == (8500, GOOD)  # by now it has told other values
            continue
        assert told[-1][2] == quality
        if value is None:
            assert told[-1][1] is None
        else:
            assert abs(told[-1][1] - value) <= 0.5


def test_the_first_85_degrees_are_a_fault_and_later_ones_are_believed():
    part = Ds18b20(rom_id(1), POWER_ON)
    driver = Thermometers(SimulatedOneWire(part), 0)
    assert set(driver.run(3500)) == {(0, None, FAULT)}
    part.sixteenths = POWER_ON - 1
    assert driver.run(1200)[-1] == (0, 8494, GOOD)
    part.sixteenths = POWER_ON
    assert driver.run(1200)[-1] == (0, 8500, GOOD)


@pytest.mark.parametrize("others", [0, 2])
def test_a_part_that_loses_its_power_during_the_conversion_is_a_fault_once(others):
    parts = [Ds18b20(rom_id(serial), 16 * 30) for serial in range(1 + others)]
    driver = Thermometers(SimulatedOneWire(*parts), *(part.rom for part in parts))
    assert {row[2] for row in driver.run(2100)} == {GOOD}
    told = driver.run(3000, events={400: parts[0].plug})  # the conversion began at about 2010
    of_first = [row for row in told if row[0] == 0]
    assert [row[2] for row in of_first] == [FAULT, GOOD, GOOD]
    assert all(row[1:] == (3000, GOOD) for row in told if row[0] > 0)


def test_85_degrees_after_any_loss_of_power_are_a_fault_even_without_a_conversion():
    part = Ds18b20(rom_id(1), 16 * 30)
    driver = Thermometers(SimulatedOneWire(part), 0)
    driver.run(2100)
    part.deaf_to_convert = True
    told = driver.run(4000, events={400: part.plug})
    assert len(told) >= 3
    assert {row[1:] for row in told} == {(None, FAULT)}


def test_a_loss_of_power_at_any_time_never_gives_85_degrees():
    for at in range(0, 1100, 13):
        part = Ds18b20(rom_id(1), 16 * 30)
        driver = Thermometers(SimulatedOneWire(part), rom_id(1))
        driver.run(1900)
        told = driver.run(2500, events={at: part.plug, at + 900: part.plug})
        assert {row[1:] for row in told} <= {(3000, GOOD), (None, FAULT)}
        assert driver.run(1100)[-1][1:] == (3000, GOOD)


def test_a_loss_of_power_that_the_new_mark_hides_never_gives_85_degrees():
    """All are marked anew for the first part's sake; by then the second has lost its power, too."""
    first, second = parts = [Ds18b20(rom_id(serial), 16 * 30) for serial in range(2)]
    driver = Thermometers(SimulatedOneWire(*parts), *(part.rom for part in parts))
    driver.run(1900)
    first.plug()
    while not (told := driver.run(1)) or told[0][0] != 1:
        pass
    assert told == [(1, 3000, GOOD)]
    second.plug()
    second.deaf_to_convert = True
    assert [row for row in driver.run(2100) if row[0] == 1] == [(1, None, FAULT)] * 2


def test_the_conversion_is_awaited_even_when_its_command_came_late_in_a_round():
    part = Ds18b20(rom_id(1))
    driver = Thermometers(SimulatedOneWire(part), 0)
    driver.late_ms = 20.0
    while part.ready_us is None:
        assert driver.run(1) == []
    driver.late_ms = 0.0
    driver.now_ms += 20  # that round ends
    assert driver.run(800) == [(0, 2000, GOOD)]


def test_a_part_whose_alarms_cannot_be_written_is_only_doubted_at_85_degrees():
    class Clone(Ds18b20):
        def _receive(self):
            byte = yield from super()._receive()
            return 0x4B if byte in (0xA6, 0x59) else byte

    part = Clone(rom_id(1), 16 * 30)
    driver = Thermometers(SimulatedOneWire(part), 0)
    assert {row[1:] for row in driver.run(3000)} == {(3000, GOOD)}
    part.sixteenths = POWER_ON
    assert driver.run(1200)[-1] == (0, None, FAULT)


def test_a_part_set_to_9_bits_is_set_to_12():
    part = Ds18b20(rom_id(1), 0x0191, eeprom=(0x4B, 0x46, 0x1F))
    assert Thermometers(SimulatedOneWire(part), 0).run(1000) == [(0, 2506, GOOD)]
    assert part.scratchpad[4] == 0x7F


def test_the_undefined_bits_of_9_bits_are_dropped():
    part = Ds18b20(rom_id(1), 0x0191)
    driver = Thermometers(SimulatedOneWire(part), 0)
    driver.run(1000)
    part.eeprom = (0x4B, 0x46, 0x1F)
    part.plug()
    part.sixteenths = 0x0197
    assert driver.run(1000)[-1] == (0, 2500, GOOD)
    assert driver.run(1010)[-1] == (0, 2544, GOOD)  # set to 12 bits again


def test_a_conversion_that_takes_the_whole_750_ms_is_awaited():
    part = Ds18b20(rom_id(1), 320)
    driver = Thermometers(SimulatedOneWire(part), 0)
    assert driver.run(1000) == [(0, 2000, GOOD)]  # the power-on value would be a fault
    part.conversion_us = 770_000.0
    part.sixteenths = 640
    assert driver.run(1000) == [(0, 2000, GOOD)]  # not awaited any longer than needed


def test_a_missing_part_is_a_fault_once_a_second_and_comes_back():
    part = Ds18b20(rom_id(1))
    part.plugged = False
    driver = Thermometers(SimulatedOneWire(part), 0)
    assert driver.run(5001) == [(0, None, FAULT)] * 5
    part.plug()
    assert driver.run(2000)[-1] == (0, 2000, GOOD)


def test_one_missing_part_leaves_the_others():
    parts = [Ds18b20(rom_id(serial)) for serial in range(3)]
    parts[1].plugged = False
    told = Thermometers(SimulatedOneWire(*parts), *(part.rom for part in parts)).run(2500)
    assert told == [(0, 2000, GOOD), (1, None, FAULT), (2, 2000, GOOD)] * 2


def test_a_part_that_vanishes_in_the_middle_of_any_transfer_is_a_fault_and_comes_back():
    for slots in range(1, 280, 3):  # of about 250 in a cycle
        part = Ds18b20(rom_id(1), 16 * 30)
        driver = Thermometers(SimulatedOneWire(part), part.rom)
        part.slots_left = slots
        told = driver.run(2100)
        assert {row[1:] for row in told} <= {(3000, GOOD), (None, FAULT)}
        assert told[-1] == (0, None, FAULT)
        part.plug()
        assert driver.run(2200)[-1] == (0, 3000, GOOD)


def test_a_wrong_crc_is_read_again_and_a_second_one_is_a_fault():
    part = Ds18b20(rom_id(1))
    driver = Thermometers(SimulatedOneWire(part), 0)
    wrong = iter(
        [True, False, True, True]
    )  # in the order of the transfers: two a cycle, when the first is wrong

    def damage(data: bytes) -> bytes:
        return data[:-1] + bytes([data[-1] ^ 0x10]) if next(wrong, False) else data

    part.damage = damage
    assert driver.run(3100) == [(0, 2000, GOOD), (0, None, FAULT), (0, 2000, GOOD)]


def test_every_single_wrong_bit_is_noticed():
    part = Ds18b20(rom_id(1))
    wire = SimulatedOneWire(part)
    driver = Thermometers(wire, 0)
    driver.run(1000)
    for bit in range(72):
        part.damage = lambda data, bit=bit: (int.from_bytes(data, "little") ^ 1 << bit).to_bytes(9, "little")
        assert driver.run(1100)[-1] == (0, None, FAULT)


@pytest.mark.parametrize("content", [bytes(9), b"\xff" * 9])
def test_lines_that_stay_at_one_level_are_a_fault(content):
    part = Ds18b20(rom_id(1))
    part.damage = lambda data: content
    assert Thermometers(SimulatedOneWire(part), 0).run(1000) == [(0, None, FAULT)]


def test_a_bus_that_is_stuck_low_is_a_fault_and_recovers():
    wire = SimulatedOneWire(Ds18b20(rom_id(1)))
    wire.result = STUCK
    driver = Thermometers(wire, 0)
    assert driver.run(2001) == [(0, None, FAULT)] * 2
    wire.result = None
    assert driver.run(2000)[-1] == (0, 2000, GOOD)


def test_a_ds18s20_is_a_fault_and_no_number_of_another_scale():
    part = Ds18b20(rom_id(1, family=0x10), 2 * 20)  # half degrees there

    def damage(data: bytes) -> bytes:
        content = bytes([data[0], data[1], data[2], data[3], 0xFF, 0xFF, 0x0C, 0x10])
        return content + bytes([crc_dow(content)])

    part.damage = damage
    assert Thermometers(SimulatedOneWire(part), part.rom).run(1000) == [(0, None, FAULT)]


def test_two_parts_behind_the_id_0_are_a_fault():
    parts = Ds18b20(rom_id(1), 320), Ds18b20(rom_id(2), 335)
    assert Thermometers(SimulatedOneWire(*parts), 0).run(1000) == [(0, None, FAULT)]


def test_the_clock_may_wrap():
    driver = Thermometers(SimulatedOneWire(Ds18b20(rom_id(1))), 0, start_ms=NEARLY_WRAPPED)
    assert driver.run(5000) == [(0, 2000, GOOD)] * 5


@pytest.mark.parametrize("stride", [1, 3, 10, 100])
def test_slow_rounds_only_make_it_slower(stride):
    ids = [rom_id(serial) for serial in range(2)]
    told = Thermometers(SimulatedOneWire(*map(Ds18b20, ids)), *ids).run(12_000, stride)
    assert set(told) == {(0, 2000, GOOD), (1, 2000, GOOD)}
    assert len(told) >= 4


@given(st.integers(0, 2**32), st.floats(0.0, 0.5), st.integers(0, 2**32 - 1))
def test_noise_gives_a_good_value_only_within_the_range(seed, share, start_ms):
    chance = random.Random(seed)
    wire = SimulatedOneWire(Ds18b20(rom_id(1), chance.randint(-32768, 32767)))
    wire.disturb = lambda level: level ^ (chance.random() < share)
    driver = Thermometers(wire, chance.choice([0, rom_id(1)]), start_ms=start_ms)
    for _ in range(40):
        wire.result = chance.choice([None, None, None, OK, STUCK])
        for _, value, quality in driver.run(chance.randint(1, 40) * 30, stride=30):
            assert (quality == GOOD) == (value is not None)
            assert value is None or -5500 <= value <= 12_500
