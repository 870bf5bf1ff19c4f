"""The drivers of I2C sensors against simulated parts, which follow the state machines of their datasheets."""

import ctypes
import random
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import pytest
from drivers.library import (
    FAULT,
    GOOD,
    NO_VALUE,
    OK,
    RANGE,
    SILENT,
    SLOW,
    STEP_MAX_US,
    STUCK,
    I2c,
    Measurement,
    SimulatedI2c,
    crc8,
    drivers,
)
from hypothesis import given, settings
from hypothesis import strategies as st

pytestmark = pytest.mark.slow

MS, SECOND = 1000, 1_000_000  # [us]
MASK = 0xFFFFFFFF
SHT3X, SHT4X = 0, 1
NO_NUMBER = (None, FAULT)
OUT_OF_RANGE = (None, RANGE)
BIT_US, START_AND_STOP_BITS = 10.0, 2  # I2C at 100 kHz
WRONG = 0x5A  # no CRC of these tests is changed into itself by it


def word(number: int) -> bytes:
    """A word as Sensirion's parts send it."""
    pair = number.to_bytes(2, "big")
    return pair + bytes([crc8(pair)])


def nearest(number: Fraction) -> int:
    """The nearest integer; halves go up."""
    return (2 * number + 1).__floor__() // 2


class BusClock:
    """Time of the simulated world [us]. end_us : when the transfer that is under way ends"""

    def __init__(self, us: float = 0.0) -> None:
        self.us = self.end_us = us


class I2cPart:
    """A part with a power supply that can be taken away.

    damages : what to do to the answers to come; early : how often a number was read that was not there yet
    """

    POWER_UP_US = 0

    def __init__(self, clock: BusClock) -> None:
        self.clock = clock
        self.damages: list[Callable[[bytes], bytes]] = []
        self.early = 0
        self.plug()

    def plug(self) -> None:
        """Starts anew, without what it was told before."""
        self.plugged = True
        self.busy_us = self.clock.us + self.POWER_UP_US
        self.reset()

    def unplug(self) -> None:
        """Off the bus."""
        self.plugged = False

    def exchange(self, written: bytes, in_size: int | None) -> bytes | None:
        """Return the bytes that are read, all of them for None, None where nobody acknowledges."""
        if not self.plugged or self.clock.us < self.busy_us or (written and in_size):
            return None
        if written:
            return b"" if self.command(written) else None
        answer = self.read()
        assert answer is None or in_size in (None, len(answer))
        if answer is not None and self.damages:
            answer = self.damages.pop(0)(answer)
        return answer


class Sht(I2cPart):
    """SHT3x or SHT4x in single shot mode."""

    POWER_UP_US = 1500

    def __init__(self, clock: BusClock, kind: int) -> None:
        self.known, self.measuring_us = ((b"\x24\x00", 15_500), (b"\xfd", 8300))[kind]
        self.words = (0x6667, 0x5EB9)
        super().__init__(clock)

    def reset(self) -> None:
        self.measured = False

    def command(self, written: bytes) -> bool:
        if written != self.known:
            return False
        self.busy_us = self.clock.end_us + self.measuring_us
        self.measured = True
        return True

    def read(self) -> bytes | None:
        measured, self.measured = self.measured, False
        return b"".join(map(word, self.words)) if measured else None


class Scd4x(I2cPart):
    """SCD40 or SCD41. refuses_idle_stop : idle, it does not acknowledge a stop"""

    POWER_UP_US = SECOND
    INTERVAL_US = 5 * SECOND

    def __init__(self, clock: BusClock) -> None:
        self.words = (0x01F4, 0x6667, 0x5EB9)
        self.refuses_idle_stop = False
        self.idle_bits = 0x8000  # a part that is not ready may set the highest five bits
        super().__init__(clock)

    def reset(self) -> None:
        self.started_us: float | None = None
        self.taken = 0
        self.answer: bytes | None = None

    def ready(self) -> bool:
        return self.started_us is not None and self._measured() > self.taken

    def _measured(self) -> int:
        return int((self.clock.us - self.started_us) // self.INTERVAL_US)

    def command(self, written: bytes) -> bool:
        self.answer = None
        match written.hex():
            case "3f86":
                if self.started_us is None:
                    return not self.refuses_idle_stop
                self.reset()
                self.busy_us = self.clock.end_us + 500 * MS
                return True
            case "21b1":
                if self.started_us is not None:
                    return False
                self.reset()
                self.started_us = self.clock.end_us
                return True
            case "e4b8":
                self.answer = word(self.idle_bits | (6 if self.ready() else 0))
            case "ec05":
                if not self.ready():
                    self.early += 1
                    return False
                self.taken = self._measured()
                self.answer = b"".join(map(word, self.words))
            case _:
                return False
        self.busy_us = self.clock.end_us + MS
        return True

    def read(self) -> bytes | None:
        answer, self.answer = self.answer, None
        return answer


class Bh1750(I2cPart):
    """BH1750: its register holds 0 until a measurement is complete, and acknowledges always."""

    def __init__(self, clock: BusClock) -> None:
        self.counts = 0x8390
        super().__init__(clock)

    def reset(self) -> None:
        self.on = False
        self.started_us: float | None = None
        self.register = 0

    def command(self, written: bytes) -> bool:
        if written == b"\x01":
            self.on = True
        elif written == b"\x10":
            if self.on:
                self.started_us = self.clock.end_us
        else:
            return False
        return True

    def read(self) -> bytes:
        if self.started_us is not None:
            if self.clock.us >= self.started_us + 180 * MS:
                self.register = self.counts
            else:
                self.early += 1
        return self.register.to_bytes(2, "big")


class Bus(SimulatedI2c):
    """Counts the transfers, and tells the parts when each ends."""

    def __init__(self, slaves: dict[int, object], clock: BusClock) -> None:
        super().__init__(slaves)
        self.clock = clock
        self.transfers = 0

    def _transfer(self, context, address, out, out_size, into, in_size) -> int:
        self.transfers += 1
        bits = START_AND_STOP_BITS + 9 * (1 + out_size + in_size)
        self.clock.end_us = self.clock.us + bits * BIT_US
        return super()._transfer(context, address, out, out_size, into, in_size)


class I2cRig:
    """One driver, its part and a loop. lag_us : age of the loop's time when the driver gets it"""

    def __init__(self, kind: "Kind", clock: BusClock | None = None, part: object = None) -> None:
        self.kind = kind
        self.clock = clock or BusClock()
        self.part = part or kind.part(self.clock)
        self.bus = Bus({kind.address: self.part}, self.clock)
        self.measurements = (Measurement * kind.values)(*[(-1, 77)] * kind.values)
        self.step_driver = kind.step
        self._references = [ctypes.byref(measurement) for measurement in self.measurements]
        self._told = bytes(self.measurements)
        self.lag_us: Callable[[], float] = lambda: 0.0
        self.start_board()

    def start_board(self) -> None:
        """As after a reset of the board: the part is not asked."""
        self.driver = (ctypes.c_uint64 * 8)()
        self.kind.init(self.driver, self.bus.bus)

    def step(self) -> tuple | None:
        """One call: what is new"""
        now_ms = int(self.clock.us // MS) & MASK
        self.clock.us += self.lag_us()
        self.bus.spent_us, self.bus.transfers = 0.0, 0
        new = self.step_driver(self.driver, ctypes.c_uint32(now_ms), *self._references)
        assert self.bus.transfers <= 1
        assert self.bus.spent_us <= STEP_MAX_US
        self.clock.us += self.bus.spent_us
        before, self._told = self._told, bytes(self.measurements)
        assert new or self._told == before
        return tuple(measurement.value for measurement in self.measurements) if new else None

    def run(self, seconds: float, round_us: float = 3700.0) -> list[tuple[float, tuple]]:
        """Return the new measurements, each with its time [s]."""
        found = []
        end_us = self.clock.us + seconds * SECOND
        while self.clock.us < end_us:
            values = self.step()
            if values is not None:
                found.append((self.clock.us / SECOND, values))
            self.clock.us += round_us
        assert self.part.early == 0
        return found

    def run_on_ticks(self, seconds: float) -> list[tuple]:
        """A loop that comes right after each transfer, and else as soon as the millisecond has changed."""
        found = []
        end_us = self.clock.us + seconds * SECOND
        while self.clock.us < end_us:
            values = self.step()
            if values is not None:
                found.append(values)
            if self.bus.transfers == 0:
                self.clock.us = (self.clock.us // MS + 1) * MS
        assert self.part.early == 0
        return found

    def values(self, seconds: float) -> list[tuple]:
        return [values for _, values in self.run(seconds)]

    def next_values(self) -> tuple:
        """The next that is new, within two periods."""
        while (values := self.step()) is None:
            self.clock.us += 10 * MS
        return values


@dataclass(frozen=True)
class Kind:
    """One driver and its part. good : what the part tells; recovery_s : from plugging in to a value"""

    name: str
    address: int
    part: Callable[[BusClock], I2cPart]
    arguments: Callable[[], tuple]
    good: tuple
    ranges: tuple[tuple[int, int], ...]
    period_s: float
    recovery_s: float

    @property
    def values(self) -> int:
        return len(self.ranges)

    def init(self, driver: ctypes.Array, bus: I2c) -> None:
        getattr(drivers(), f"gh_{self.name}_init")(ctypes.byref(driver), ctypes.byref(bus), *self.arguments())

    @property
    def step(self) -> Callable[..., bool]:
        function = getattr(drivers(), f"gh_{self.name}_step")
        function.restype = ctypes.c_bool
        return function


def bh1750(full_lux: int) -> Kind:
    """The driver of a BH1750 whose light of `full_lux` is called 1."""
    counts_of_full = Fraction(12, 10) * full_lux
    good = nearest(0x8390 / counts_of_full * 10_000) if full_lux else None
    arguments = lambda: (ctypes.c_uint8(0x23), ctypes.c_uint16(full_lux))  # noqa: E731
    return Kind("bh1750", 0x23, Bh1750, arguments, ((good, GOOD),), ((0, 10_000),), 1.0, 1.3)


def sht(kind: int, address: int) -> Kind:
    """The driver of an SHT; the words of its part are those of 25 degC and 37 % in the SCD4x datasheet."""
    humidity = nearest(Fraction(0x5EB9, 0xFFFF) * (10_000, 12_500)[kind]) - (0, 600)[kind]
    arguments = lambda: (ctypes.c_int(kind), ctypes.c_uint8(address))  # noqa: E731
    good = ((2500, GOOD), (humidity, GOOD))
    return Kind("sht", address, lambda clock: Sht(clock, kind), arguments, good, SHT_RANGES, 1.0, 1.1)


SHT_RANGES = ((-4000, 12_500), (0, 10_000))
SHT3X_KIND, SHT4X_KIND = sht(SHT3X, 0x45), sht(SHT4X, 0x44)
SCD4X_KIND = Kind("scd4x", 0x62, Scd4x, tuple, ((500, GOOD),), ((1, 10_000),), 5.0, 8.2)
BH1750_KIND = bh1750(40_000)
KINDS = [SHT3X_KIND, SHT4X_KIND, SCD4X_KIND, BH1750_KIND]
SENSIRION = KINDS[:3]
every_driver = pytest.mark.parametrize("kind", KINDS, ids=["sht3x", "sht4x", "scd4x", "bh1750"])
every_sensirion = pytest.mark.parametrize("kind", SENSIRION, ids=["sht3x", "sht4x", "scd4x"])


def faults(found: list[tuple[float, tuple]]) -> list[float]:
    """When a fault was reported."""
    return [at_s for at_s, values in found if values[0] == NO_NUMBER]


def settled(rig: I2cRig) -> None:
    """Up to the first value, which is right."""
    assert rig.next_values() == rig.kind.good


def alone(kind: Kind) -> tuple:
    """A fault of all its signals."""
    return (NO_NUMBER,) * kind.values


# ---- working parts


@every_driver
def test_values_come_once_a_period(kind):
    found = I2cRig(kind).run(20 * kind.period_s)
    assert {values for _, values in found} == {kind.good}
    steps = [later - before for (before, _), (later, _) in pairwise(found)]
    assert len(found) >= 18
    assert all(kind.period_s - 0.51 <= step <= kind.period_s + 0.51 for step in steps)
    assert sum(steps) / len(steps) == pytest.approx(kind.period_s, rel=0.02)


@every_driver
def test_the_clock_may_wrap_at_any_moment(kind):
    for before_s in (0.001, 0.1, 0.99, 1.3, 2.4, 4.0, 6.5, 6.6):
        rig = I2cRig(kind, BusClock((2**32 - before_s * 1000) * MS))
        found = rig.run(20.0)
        assert {values for _, values in found} == {kind.good}
        assert len(found) >= 20 / kind.period_s - 2


@every_driver
@pytest.mark.parametrize("round_us", [200.0, 3 * MS, 40 * MS])
def test_a_loop_that_is_late_and_has_an_old_time_reads_no_part_too_early(kind, round_us):
    rig = I2cRig(kind)
    wait = random.Random(7)
    rig.lag_us = lambda: wait.choice((0, 0, 0, 999, 7000, 25_000)) * wait.random() if round_us > MS else 0.0
    found = rig.run(30.0, round_us)
    assert {values for _, values in found} == {kind.good}
    assert len(found) >= 30 / (kind.period_s * 1.15) - 2


@every_driver
def test_no_pause_is_shorter_than_that_of_the_datasheet(kind):
    draw = random.Random(9)
    for _ in range(30):
        rig = I2cRig(kind, BusClock(draw.uniform(0, MS)))
        rig.lag_us = lambda: draw.choice((0.0, 0.0, draw.uniform(0, 990)))
        rig.run_on_ticks(kind.recovery_s / 2)
        rig.start_board()
        assert set(rig.run_on_ticks(min(kind.recovery_s, 3.0))) <= {kind.good}


def test_an_scd4x_is_left_alone_while_it_powers_up():
    rig = I2cRig(SCD4X_KIND)
    while rig.clock.us < SECOND:
        rig.step()
        assert rig.bus.transfers == 0
        rig.clock.us += MS


@every_driver
def test_a_reset_of_the_board_finds_a_working_part(kind):
    for after_s in (*(i * 0.003 for i in range(20)), 1.01, 1.5, 1.6, 6.5, 6.9, 12.0):
        rig = I2cRig(kind)
        rig.run(after_s)
        rig.start_board()
        assert rig.values(kind.recovery_s + 1.0)[0] == kind.good


def test_an_scd4x_that_is_idle_may_refuse_the_stop():
    rig = I2cRig(SCD4X_KIND)
    rig.part.refuses_idle_stop = True
    assert set(rig.values(20.0)) == {SCD4X_KIND.good}


# ---- numbers

SAMPLED = sorted({*range(0, 65_536, 61), *range(40), *range(65_500, 65_536)})


@pytest.mark.parametrize("kind", [SHT3X_KIND, SHT4X_KIND], ids=["sht3x", "sht4x"])
def test_every_word_of_an_sht_is_converted_as_the_datasheet_tells(kind):
    rig = I2cRig(kind)
    for number in SAMPLED:
        rig.part.words = (number, 65_535 - number)
        temp, humidity = rig.next_values()
        celsius = -45 + 175 * number / 65_535
        percent = 100 * (1 - number / 65_535)
        if kind is SHT4X_KIND:
            percent = min(max(-6 + 125 * (1 - number / 65_535), 0.0), 100.0)
        if -40.005 < celsius < 125.005:
            assert temp == (round(celsius * 100), GOOD)
            assert humidity == (round(percent * 100), GOOD)
        else:
            assert temp == humidity == OUT_OF_RANGE


def test_the_range_of_an_sht_ends_with_that_of_its_datasheet():
    rig = I2cRig(SHT3X_KIND)
    inside = [number for number in range(65_536) if -4000.5 < -4500 + 17_500 * number / 65_535 < 12_500.5]
    for number, found in ((inside[0], -4000), (inside[-1], 12_500)):
        rig.part.words = (number, 0)
        assert rig.next_values() == ((found, GOOD), (0, GOOD))
    for number in (0, inside[0] - 1, inside[-1] + 1, 65_535):
        rig.part.words = (number, 0x8000)
        assert rig.next_values() == (OUT_OF_RANGE, OUT_OF_RANGE)


def test_the_example_of_the_datasheet_is_25_degrees_and_37_percent():
    # SCD4x datasheet, "read_measurement": 0x6667 is 25 degC, 0x5EB9 is 37 %, by the formulas of the SHT3x
    assert I2cRig(SHT3X_KIND).next_values() == ((2500, GOOD), (3700, GOOD))


def test_the_humidity_of_an_sht4x_is_cropped():
    rig = I2cRig(SHT4X_KIND)
    for number, humidity in (
        (0, 0),
        (3140, 0),  # -0.01 %
        (3145, 0),
        (3149, 1),
        (55_571, 9999),
        (55_574, 10_000),
        (65_535, 10_000),
    ):
        rig.part.words = (0x6667, number)
        assert rig.next_values()[1] == (humidity, GOOD)


def test_an_scd4x_gives_ppm_up_to_what_the_signal_carries():
    rig = I2cRig(SCD4X_KIND)
    for ppm in (1, 399, 400, 2000, 5000, 9999, 10_000):
        rig.part.words = (ppm, 0x6667, 0x5EB9)
        assert rig.next_values() == ((ppm, GOOD),)
    for ppm in (10_001, 40_000, 40_001, 65_535):
        rig.part.words = (ppm, 0x6667, 0x5EB9)
        assert rig.next_values() == (OUT_OF_RANGE,)


def test_no_co2_at_all_is_a_fault():
    rig = I2cRig(SCD4X_KIND)
    settled(rig)
    rig.part.words = (0, 0x6667, 0x5EB9)
    assert rig.next_values() == (NO_NUMBER,)
    rig.part.words = (500, 0x6667, 0x5EB9)
    assert set(rig.values(20.0)) == {SCD4X_KIND.good}
    rig.part.words = (0, 0x6667, 0x5EB9)
    damage_measurements(rig, flip(8))
    assert rig.values(5.0) == []  # nothing is known about an answer whose CRC is wrong
    rig.part.words = (500, 0x6667, 0x5EB9)
    assert set(rig.values(20.0)) == {SCD4X_KIND.good}


@pytest.mark.parametrize("full_lux", [1, 3, 1000, 28_067, 40_000, 54_612, 65_535])
def test_every_count_of_a_bh1750_is_a_part_of_full(full_lux):
    rig = I2cRig(bh1750(full_lux))
    for counts in SAMPLED[::3]:
        rig.part.counts = counts
        light = nearest(Fraction(counts * 10, 12 * full_lux) * 10_000)
        inside = light <= 10_000 and counts != 65_535
        assert rig.next_values() == ((light, GOOD) if inside else OUT_OF_RANGE,)


def test_the_example_of_the_bh1750_is_28067_lux():
    # BH1750FVI datasheet, "Read Format": 0x8390 / 1.2 = 28067 lx
    assert I2cRig(bh1750(28_067)).next_values() == ((10_000, GOOD),)
    assert I2cRig(bh1750(56_134)).next_values() == ((5000, GOOD),)


def test_a_saturated_bh1750_is_out_of_range_whatever_full_is():
    rig = I2cRig(bh1750(65_535))
    rig.part.counts = 65_534
    assert rig.next_values()[0][1] == GOOD
    rig.part.counts = 65_535
    assert rig.next_values() == (OUT_OF_RANGE,)


def test_a_full_of_no_lux_is_taken_as_one():
    rig = I2cRig(bh1750(0))
    rig.part.counts = 1
    assert rig.next_values() == ((8333, GOOD),)


def test_the_crc_is_the_one_with_the_check_value_f7():
    crc = drivers().gh_crc8_f7
    crc.restype = ctypes.c_uint8
    assert crc(b"123456789", 9) == 0xF7
    assert crc(b"\xbe\xef", 2) == 0x92  # SHT3x-DIS datasheet, "Checksum Calculation"
    assert crc(b"", 0) == 0xFF
    draw = random.Random(3)
    assert all(crc(pair, 2) == crc8(pair) for pair in (draw.randbytes(2) for _ in range(2000)))


# ---- damaged answers


def flip(at: int) -> Callable[[bytes], bytes]:
    """One byte of an answer changed."""
    return lambda answer: answer[:at] + bytes([answer[at] ^ WRONG]) + answer[at + 1 :]


def let_go(at: int) -> Callable[[bytes], bytes]:
    """The part lets go of the line: ones from there on."""
    return lambda answer: answer[:at] + b"\xff" * (len(answer) - at)


def same(answer: bytes) -> bytes:
    return answer


def damage_measurements(rig: I2cRig, *damages: Callable[[bytes], bytes]) -> None:
    """Damage measurements alone: the statuses of an SCD4x, its shorter answers, stay right."""
    left = list(damages)

    def damage(answer: bytes) -> bytes:
        return left.pop(0)(answer) if left and len(answer) > 3 else answer

    rig.part.damages = [damage] * 1000


@every_sensirion
@pytest.mark.parametrize("kind_of_damage", [flip, let_go])
def test_one_wrong_crc_is_read_again_and_two_in_a_row_are_a_fault(kind, kind_of_damage):
    for at in range(3 * (len(kind.ranges) if kind.name == "sht" else 3)):
        damage = kind_of_damage(at)
        rig = I2cRig(kind)
        settled(rig)
        damage_measurements(rig, damage)
        assert set(rig.values(3 * kind.period_s)) == {kind.good}
        damage_measurements(rig, damage, same, damage)
        assert set(rig.values(5 * kind.period_s)) == {kind.good}
        damage_measurements(rig, damage, damage)
        found = rig.values(3 * kind.period_s + kind.recovery_s)
        assert found[0] == alone(kind)
        assert set(found[1:]) == {kind.good}
        damage_measurements(rig, damage, damage, damage)  # the third is a first one again
        found = rig.values(4 * kind.period_s + 2 * kind.recovery_s)
        assert found[0] == alone(kind)
        assert set(found[1:]) == {kind.good}


def test_an_sht_whose_crc_was_wrong_is_read_again_at_once():
    rig = I2cRig(SHT3X_KIND)
    settled(rig)
    rig.part.damages = [flip(2)]
    start_s = rig.clock.us / SECOND
    assert rig.run(1.2)[0][0] - start_s < 1.05


def test_a_status_whose_crc_is_wrong_is_asked_for_again():
    rig = I2cRig(SCD4X_KIND)
    settled(rig)
    for at in range(3):
        rig.part.damages = [flip(at)]
        assert set(rig.values(12.0)) == {SCD4X_KIND.good}
    rig.part.damages = [flip(0), flip(0)]
    found = rig.values(20.0)
    assert found[0] == (NO_NUMBER,)
    assert set(found[1:]) == {SCD4X_KIND.good}


@every_sensirion
def test_a_line_that_changes_every_answer_is_a_fault_at_most_once_a_second(kind):
    rig = I2cRig(kind)
    rig.part.damages = [flip(1)] * 100_000
    found = rig.run(40.0)
    assert {values for _, values in found} == {alone(kind)}
    assert_faults_are_rare(faults(found))
    rig.part.damages = []
    assert rig.values(kind.recovery_s + 1.0)[-1] == kind.good


# ---- faults of the bus


def assert_faults_are_rare(moments: list[float]) -> None:
    """A millisecond less: the board's time has no smaller part."""
    assert all(later - before >= 0.999 for before, later in pairwise(moments))


@every_driver
@pytest.mark.parametrize("result", [SILENT, STUCK, SLOW], ids=["silent", "stuck", "slow"])
@pytest.mark.parametrize("after_s", [0.0, 1.0, 6.4, 13.2])
def test_a_bus_that_fails_is_a_fault_once_a_second_and_recovers(kind, result, after_s):
    rig = I2cRig(kind)
    rig.run(after_s)
    rig.bus.result = result
    found = rig.run(12.0)
    assert {values for _, values in found} <= {alone(kind)}
    assert 7 <= len(found) <= 13
    assert_faults_are_rare(faults(found))
    rig.bus.result = None
    found = rig.values(kind.recovery_s + 1.0)
    assert found[-1] == kind.good
    assert set(found[:-1]) <= {alone(kind), kind.good}


@every_driver
def test_a_part_that_was_never_there_is_a_fault(kind):
    rig = I2cRig(kind)
    rig.part.unplug()
    found = rig.run(10.0)
    assert {values for _, values in found} == {alone(kind)}
    assert_faults_are_rare(faults(found))


@every_driver
def test_a_part_may_be_unplugged_and_plugged_in_at_any_moment(kind):
    draw = random.Random(11)
    rig = I2cRig(kind)
    for _ in range(40):
        rig.run(draw.uniform(0, 3 * kind.period_s))
        rig.part.unplug()
        found = rig.run(draw.uniform(2.0, 5.0))
        assert faults(found)
        assert {values for _, values in found[1:]} <= {alone(kind)}
        assert_faults_are_rare(faults(found))
        rig.part.plug()
        found = rig.values(kind.recovery_s + 2.0)
        assert found[-1] == kind.good
        assert set(found) <= {alone(kind), kind.good}


@every_driver
def test_a_part_that_lost_its_power_for_a_moment_is_set_up_anew(kind):
    draw = random.Random(12)
    for _ in range(25):
        rig = I2cRig(kind)
        rig.run(kind.recovery_s + draw.uniform(0, kind.period_s))
        rig.part.plug()  # as after a drop of the supply between two transfers
        found = rig.run(25.0)
        assert {values for _, values in found[-2:]} == {kind.good}
        assert len(faults(found)) <= 1
        silent_s = [later[0] - before[0] for before, later in pairwise(found)]
        assert max(silent_s) < 8.5


def test_a_bh1750_that_lost_its_power_while_at_rest_never_calls_it_dark():
    for at_ms in range(5, 800, 45):
        rig = I2cRig(BH1750_KIND)
        settled(rig)
        rig.clock.us += at_ms * MS
        rig.part.plug()
        assert set(rig.values(4.0)) == {BH1750_KIND.good}


def test_a_bh1750_in_the_dark_is_not_a_fault():
    rig = I2cRig(BH1750_KIND)
    rig.part.counts = 0
    assert set(rig.values(5.0)) == {((0, GOOD),)}


def test_an_scd4x_that_is_never_ready_is_a_fault():
    rig = I2cRig(SCD4X_KIND)
    settled(rig)
    rig.part.reset()  # idle: it acknowledges, and has nothing to say
    start_s = rig.clock.us / SECOND
    found = rig.run(20.0)
    assert found[0][1] == (NO_NUMBER,)
    assert 7.5 < found[0][0] - start_s < 8.6
    assert {values for _, values in found[1:]} == {SCD4X_KIND.good}


# ---- any bytes


class Scripted:
    """Answers anything. answers : byte strings, None for silence, used in turn"""

    def __init__(self, answers: list[bytes | None], fills: bytes) -> None:
        self.answers, self.fills, self.asked, self.early = answers, fills, 0, 0

    def exchange(self, written: bytes, in_size: int | None) -> bytes | None:
        """A command is acknowledged as an answer is: sometimes."""
        answer = self.answers[self.asked % len(self.answers)]
        self.asked += 1
        if answer is None or not in_size:
            return None if answer is None else b""
        return (answer + self.fills * in_size)[:in_size]


ANY_WORDS = st.lists(st.integers(0, 65_535), min_size=1, max_size=3).map(
    lambda all_: b"".join(map(word, all_))
)
ANSWERS = st.lists(st.one_of(st.none(), st.binary(max_size=9), ANY_WORDS, ANY_WORDS), min_size=1, max_size=12)


@every_driver
@settings(max_examples=150)
@given(
    answers=ANSWERS, fills=st.binary(min_size=1, max_size=1), start_ms=st.integers(0, MASK), data=st.data()
)
def test_no_bytes_make_a_good_value_outside_its_range(kind, answers, fills, start_ms, data):
    rig = I2cRig(kind, BusClock(start_ms * MS), Scripted(answers, fills))
    results = data.draw(st.lists(st.sampled_from([None, None, None, OK, SILENT, STUCK, SLOW]), max_size=5))
    moments = []
    for number in range(300):
        rig.bus.result = results[number % len(results)] if results else None
        values = rig.step()
        rig.clock.us += 60 * MS
        for measurement, (low, high) in zip(rig.measurements, kind.ranges, strict=True) if values else ():
            good = measurement.quality == GOOD and low <= measurement.raw <= high
            assert good or (measurement.quality in (RANGE, FAULT) and measurement.raw == NO_VALUE)
        if values and values[0] == NO_NUMBER:
            moments.append(rig.clock.us / SECOND)
    assert_faults_are_rare(moments)
