"""The drivers on single pins, and the vote of two air sensors, against simulated parts."""

import ctypes
import itertools
import random
import shutil
import subprocess
from collections.abc import Callable

import pytest
from drivers.library import (
    DRIVERS,
    FAULT,
    GOOD,
    LOW,
    NO_VALUE,
    RANGE,
    RELEASED,
    U8,
    U16,
    CDriver,
    Measurement,
    SimulatedLines,
    drivers,
)
from hypothesis import given
from hypothesis import strategies as st

from tests.support.c_core import SOURCES

# An assertion of a simulated part fails within a callback of C.
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")]

PIN, TRIGGER, ECHO, CHANNEL = 3, 4, 5, 6
NEARLY_WRAPPED = 2**32 - 2500
RAM_BYTES = {  # of an ATmega328P's 2048, for each part
    "gh_one_wire_search": 16,
    "gh_ds18b20": 32,
    "gh_dht22": 20,
    "gh_hcsr04": 32,
    "gh_float": 20,
    "gh_soil": 24,
    "gh_vote": 32,
}
Events = dict[int, Callable[[], None]]


class LineDriver(CDriver):
    """A driver whose step has `measurements` results. arguments : of the step, before them"""

    measurements = 1

    def run(self, ms: int, *arguments, stride: int = 1, events: Events | None = None) -> list:
        """Step for `ms`. Returns : the values told, one or a tuple of them"""
        told = []
        for elapsed in range(0, ms, stride):
            for due in [at for at in events or {} if elapsed <= at < elapsed + stride]:
                events[due]()
            found = [Measurement() for _ in range(self.measurements)]
            if self.step(*arguments, *map(ctypes.byref, found)):
                values = tuple(one.value for one in found)
                told.append(values if self.measurements > 1 else values[0])
            self.now_ms += stride
        return told


class Silence:
    """A part that does nothing; base of the others."""

    def __init__(self) -> None:
        self.planned: list[tuple[float, float]] = []
        self.held: bool | None = None  # the level of a line that is stuck

    def driven(self, pin: int, level: int, now_us: float) -> None:
        pass

    def pulsed(self, pin: int, high_us: int, now_us: float) -> None:
        pass

    def level(self, pin: int, now_us: float) -> bool | None:
        return self.held

    def highs(self, pin: int) -> list[tuple[float, float]]:
        return self.planned


# --- DHT22 ---


class Dht22(Silence):
    """An AM2302. It answers with what it measured at the call before.

    tenths : 0.1 %, 0.1 degC; timing : us of the gap, both halves of the presence, a bit's low, a 0 and a 1
    """

    def __init__(self, humidity: int = 652, temperature: int = 351) -> None:
        super().__init__()
        self.tenths = humidity, temperature
        self.measured = 400, 99  # before anybody called
        self.timing = 30.0, 80.0, 80.0, 50.0, 26.0, 70.0
        self.bits = 40
        self.jitter: Callable[[], float] = lambda: 0.0
        self.wrong: Callable[[], int] = lambda: 0  # what to xor the 40 bits with
        self.plugged = True
        self.low_us: float | None = None
        self.called_us = [0.0]

    def driven(self, pin: int, level: int, now_us: float) -> None:
        if pin != PIN:
            return
        if level == LOW:
            self.low_us = now_us
        elif level == RELEASED and self.low_us is not None:
            low_us, self.low_us = self.low_us, None
            if self.plugged and self.held is None and now_us - low_us >= 1000.0:
                self._answer(now_us)

    def _answer(self, now_us: float) -> None:
        assert now_us - self.called_us[-1] >= 1_990_000.0
        self.called_us.append(now_us)
        humidity, temperature = self.measured
        self.measured = self.tenths
        data = humidity.to_bytes(2, "big") + ((temperature < 0) << 15 | abs(temperature)).to_bytes(2, "big")
        word = int.from_bytes(data + bytes([sum(data) & 0xFF]), "big") ^ self.wrong()
        gap, presence_low, presence, low, zero, one = self.timing
        lengths = [presence] + [one if word >> (39 - i) & 1 else zero for i in range(self.bits)]
        time_us = now_us + gap
        self.planned = [(now_us, time_us)]
        for i, length in enumerate(lengths):
            time_us += low if i else presence_low
            self.planned.append((time_us, time_us + length + self.jitter()))
            time_us += length


class Thermometer(LineDriver):
    """The DHT22's driver."""

    measurements = 2

    def __init__(self, *parts, start_ms: int = 0) -> None:
        self.lines = SimulatedLines(*parts)
        super().__init__("gh_dht22", self.lines, start_ms)
        self.listening = ctypes.c_bool(False)
        self.init(ctypes.byref(self.lines.bus), ctypes.byref(self.listening), U8(PIN), self.clock())


BOTH_GOOD = ((3510, GOOD), (6520, GOOD))
BOTH_FAULT = ((None, FAULT), (None, FAULT))


def test_the_example_of_the_dht22s_datasheet():
    """65.2 % and 35.1 degC; and the first answer is not told, since it is from before."""
    driver = Thermometer(Dht22(652, 351))
    assert driver.run(3900) == []
    assert driver.run(6000) == [BOTH_GOOD] * 3


def test_a_temperature_below_zero_has_a_sign_bit():
    assert Thermometer(Dht22(652, -101)).run(4100)[-1][0] == (-1010, GOOD)


def dht22_tells(humidity: int, temperature: int):
    return Thermometer(Dht22(humidity, temperature)).run(4100, stride=10)[-1]


def test_every_temperature_of_the_dht22_is_that_of_floating_point():
    part = Dht22()
    driver = Thermometer(part)
    driver.run(4100, stride=10)
    for tenths in [*range(-420, 820), -32767, 32767, 5000]:
        part.measured = 500, tenths
        ((value, quality), _), *others = driver.run(2000, stride=10)
        assert others == []
        celsius = tenths / 10
        assert quality == (GOOD if -40 <= celsius <= 80 else RANGE)
        assert value == (round(celsius * 100) if quality == GOOD else None)


def test_every_humidity_of_the_dht22_is_that_of_floating_point():
    part = Dht22()
    driver = Thermometer(part)
    driver.run(4100, stride=10)
    for tenths in [*range(1100), 32768, 65535]:
        part.measured = tenths, 200
        (_, (value, quality)), *others = driver.run(2000, stride=10)
        assert others == []
        assert quality == (GOOD if tenths / 10 <= 100 else RANGE)
        assert value == (round(tenths / 10 * 100) if quality == GOOD else None)


def test_one_value_out_of_range_leaves_the_other():
    assert dht22_tells(500, 900) == ((None, RANGE), (5000, GOOD))
    assert dht22_tells(1001, 200) == ((2000, GOOD), (None, RANGE))


@pytest.mark.parametrize("gap", [20.0, 200.0])
@pytest.mark.parametrize("timing", [(75.0, 75.0, 48.0, 22.0, 68.0), (85.0, 85.0, 55.0, 30.0, 75.0)])
def test_the_dht22s_timing_may_be_at_either_limit_of_its_datasheet(gap, timing):
    for tenths in ((0xFFFF >> 6, 0), (0, 0x1FF), (652, 351)):
        part = Dht22(*tenths)
        part.timing = (gap, *timing)
        assert Thermometer(part).run(4200)[-1][0] == (tenths[1] * 10, GOOD)


def test_edges_that_interrupts_time_late_do_no_harm():
    part = Dht22()
    chance = random.Random(1)
    part.jitter = lambda: chance.uniform(-12.0, 12.0)
    assert set(Thermometer(part).run(60_000, stride=2)) == {BOTH_GOOD}


def test_one_wrong_checksum_tells_nothing_and_two_in_a_row_are_a_fault():
    part = Dht22()
    driver = Thermometer(part)
    driver.run(4100)
    wrong = iter([1 << 9, 0, 1 << 33, 1, 1 << 39, 0])
    part.wrong = lambda: next(wrong)
    assert driver.run(2000) == []
    assert driver.run(2000) == [BOTH_GOOD]
    assert driver.run(6000) == [BOTH_FAULT] * 2
    assert driver.run(2000) == []  # from before the fault
    part.wrong = lambda: 0
    assert driver.run(2000) == [BOTH_GOOD]


@pytest.mark.parametrize("bits", range(40))
def test_a_dht22_that_vanishes_in_the_middle_is_a_fault(bits):
    part = Dht22()
    driver = Thermometer(part)
    driver.run(4100, stride=2)
    part.bits = bits
    assert driver.run(2000) == [BOTH_FAULT]


def test_all_zeros_are_a_fault():
    assert Thermometer(Dht22(0, 0)).run(4100)[-1] == BOTH_FAULT


def test_a_line_stuck_low_is_a_fault_and_recovers():
    part = Dht22()
    part.held = False
    driver = Thermometer(part)
    assert driver.run(6100) == [BOTH_FAULT] * 3
    part.held = None
    assert driver.run(4000)[-1] == BOTH_GOOD


def test_a_line_that_becomes_stuck_during_the_call_is_a_fault():
    part = Dht22()
    driver = Thermometer(part)
    assert driver.run(2100, events={2001: lambda: setattr(part, "held", False)}) == [BOTH_FAULT]


def test_an_unplugged_dht22_is_a_fault_and_an_old_answer_is_not_told():
    part = Dht22()
    driver = Thermometer(part)
    driver.run(4100)
    part.plugged = False
    assert driver.run(4000) == [BOTH_FAULT] * 2
    part.plugged, part.tenths = True, (400, 100)
    assert driver.run(4000) == [((1000, GOOD), (4000, GOOD))]


def test_the_dht22s_clock_may_wrap():
    assert Thermometer(Dht22(), start_ms=NEARLY_WRAPPED).run(8100) == [BOTH_GOOD] * 3


@pytest.mark.parametrize("stride", [1, 2, 3, 5, 10])
def test_the_dht22_works_with_slow_rounds(stride):
    assert set(Thermometer(Dht22()).run(20_000, stride=stride)) == {BOTH_GOOD}


def test_the_call_lasts_a_millisecond_even_when_the_time_is_a_round_old():
    """Rounds of 6 ms; the driver comes last in one round and first in the next."""
    driver = Thermometer(Dht22())
    told = []
    for late_ms in itertools.islice(itertools.cycle([5.5, 0.0]), 2000):
        driver.late_ms = late_ms
        told += driver.run(6, stride=6)
    assert len(told) == 4
    assert set(told) == {BOTH_GOOD}


def run_in_short_rounds(driver: LineDriver, ms: int) -> list:
    """Rounds of 0.3 ms, of which the driver's clock shows whole milliseconds."""
    told = []
    begin_ms = driver.now_ms
    for tenths in range(0, ms * 10, 3):
        driver.now_ms, driver.late_ms = begin_ms + tenths // 10, tenths % 10 / 10
        told += driver.run(1)
    return told


def test_the_call_lasts_a_millisecond_in_short_rounds():
    assert run_in_short_rounds(Thermometer(Dht22()), 8000) == [BOTH_GOOD] * 2


def test_the_longest_answer_is_awaited():
    """All bits 1, at the slow limits of the datasheet: 5.6 ms."""
    part = Dht22(0xFFFF, -0x7FFF)
    part.timing = (200.0, 85.0, 85.0, 55.0, 30.0, 75.0)
    assert run_in_short_rounds(Thermometer(part), 8000) == [((None, RANGE), (None, RANGE))] * 2


def test_a_dht22_waits_while_another_driver_listens():
    driver = Thermometer(Dht22())
    driver.listening.value = True
    assert driver.run(5000) == []
    driver.listening.value = False
    assert driver.run(2000) == []
    assert driver.run(2000) == [BOTH_GOOD]


class Babbler(Dht22):
    """It answers with high levels of any lengths."""

    lengths: list[int] = []  # noqa: RUF012

    def _answer(self, now_us: float) -> None:
        self.planned = [(now_us + i, now_us + i + us) for i, us in enumerate(self.lengths)]


ANY_HIGHS = st.lists(st.integers(0, 7000), max_size=50)
NEARLY_RIGHT_HIGHS = st.lists(st.sampled_from([8, 26, 48, 49, 70, 80, 100]), min_size=41, max_size=42)


@given(
    st.lists(ANY_HIGHS | NEARLY_RIGHT_HIGHS, max_size=8),
    st.integers(0, 2**32 - 1),
    st.randoms(use_true_random=False),
)
def test_arbitrary_highs_give_a_good_value_only_within_the_dht22s_range(pulses, start_ms, chance):
    part = Babbler()
    driver = Thermometer(part, start_ms=start_ms)
    for part.lengths in pulses:
        part.held = chance.choice([None, None, None, True, False])
        for temperature, humidity in driver.run(2000, stride=2):
            assert temperature[0] is None or -4000 <= temperature[0] <= 8000
            assert humidity[0] is None or 0 <= humidity[0] <= 10_000


@given(st.lists(st.sampled_from([26, 30, 68, 75]), min_size=40, max_size=40), st.booleans())
def test_any_40_bits_give_a_good_value_only_within_the_range_and_with_the_right_sum(lengths, right):
    part = Dht22()
    word = sum((us > 48) << (39 - i) for i, us in enumerate(lengths))
    data = word.to_bytes(5, "big")
    if right:
        word = int.from_bytes(data[:4] + bytes([sum(data[:4]) & 0xFF]), "big")
    own = 652 << 24 | 351 << 8 | (2 + 0x8C + 1 + 0x5F) & 0xFF
    driver = Thermometer(part)
    driver.run(4100, stride=10)
    part.wrong = lambda: own ^ word
    for temperature, humidity in driver.run(4000, stride=10):
        assert right or sum(data[:4]) & 0xFF == data[4] or temperature[1] == humidity[1] == FAULT
        assert temperature[0] is None or -4000 <= temperature[0] <= 8000
        assert humidity[0] is None or 0 <= humidity[0] <= 10_000


# --- HC-SR04 ---


class Hcsr04(Silence):
    """An HC-SR04 over water. mm : distance, None: nothing reflects; celsius : of the air"""

    def __init__(self, mm: float | None = 300.0, celsius: float = 20.0) -> None:
        super().__init__()
        self.mm = mm
        self.speed = 331.3 + 0.606 * celsius
        self.plugged = True
        self.shots_us: list[float] = []
        self.extra: Callable[[], float] = lambda: 0.0  # us

    def pulsed(self, pin: int, high_us: int, now_us: float) -> None:
        if pin != TRIGGER or not self.plugged or high_us < 10:
            return
        assert not self.shots_us or now_us - self.shots_us[-1] >= 60_000.0
        self.shots_us.append(now_us)
        start_us = now_us + 450.0  # eight cycles of 40 kHz and some
        length = 38_000.0 if self.mm is None else self.mm * 2000.0 / self.speed
        self.planned = [(start_us, start_us + length + self.extra())]

    def level(self, pin: int, now_us: float) -> bool | None:
        if pin != ECHO or not self.plugged:
            return None
        return self.held or any(start <= now_us < end for start, end in self.planned)


class TankDriver(LineDriver):
    """The HC-SR04's driver: empty at 500 mm, full at 100."""

    def __init__(self, *parts, start_ms: int = 0, empty_mm: int = 500, full_mm: int = 100) -> None:
        self.lines = SimulatedLines(*parts)
        super().__init__("gh_hcsr04", self.lines, start_ms)
        self.listening = ctypes.c_bool(False)
        pins = ctypes.byref(self.lines.bus), ctypes.byref(self.listening), U8(TRIGGER), U8(ECHO)
        self.init(*pins, U16(empty_mm), U16(full_mm))

    def run(self, ms, temp_air: int = 2000, **keywords) -> list:
        """Temperature : 0.01 degC, as the driver gets it"""
        return super().run(ms, ctypes.c_int32(temp_air), **keywords)


def test_half_a_tank_is_half_full():
    told = TankDriver(Hcsr04(300.0)).run(6000)
    assert len(told) == 4  # the first two shots only fill the median
    assert all(quality == GOOD and abs(level - 5000) <= 5 for level, quality in told)


def test_without_a_temperature_it_is_that_of_20_degrees():
    (level, quality) = TankDriver(Hcsr04(300.0)).run(3000, temp_air=NO_VALUE)[-1]
    assert quality == GOOD
    assert abs(level - 5000) <= 10


@pytest.mark.parametrize("celsius", [-20, 0, 20, 40, 80])
def test_the_speed_of_sound_follows_the_temperature(celsius):
    part = Hcsr04(300.0, celsius)
    assert abs(TankDriver(part).run(3000, temp_air=celsius * 100)[-1][0] - 5000) <= 5
    wrong = TankDriver(Hcsr04(300.0, celsius)).run(3000)[-1][0]
    assert (wrong > 5000) == (celsius > 20) or celsius == 20


@pytest.mark.parametrize("temp_air", [-2001, 8001, 2**31 - 1, -(2**31) + 1])
def test_a_temperature_beyond_the_air_sensors_is_not_used(temp_air):
    assert TankDriver(Hcsr04()).run(3000, temp_air=temp_air) == TankDriver(Hcsr04()).run(
        3000, temp_air=NO_VALUE
    )


def test_the_echo_of_the_datasheets_4_m_is_awaited():
    assert TankDriver(Hcsr04(4000.0, -20.0), empty_mm=4000).run(3000, temp_air=-2000)[-1] == (0, GOOD)


def test_a_tank_sensor_waits_while_another_driver_listens():
    driver = TankDriver(part := Hcsr04())
    driver.listening.value = True
    assert driver.run(5000) == []
    assert part.shots_us == []


def test_every_echo_is_that_of_floating_point():
    part = Hcsr04()
    driver = TankDriver(part, empty_mm=4400, full_mm=20)
    driver.run(3000, stride=20)
    for us in [*range(100, 30_000, 211), 30_000]:
        part.mm = us * part.speed / 2000.0
        told = driver.run(3000, stride=20)[-1]
        share = (4400 - us * 1e-6 * part.speed / 2 * 1000) / (4400 - 20)
        if -0.0499 < share < 1.0499:
            assert told[1] == GOOD
            assert abs(told[0] - min(max(share, 0.0), 1.0) * 10_000) <= 1.5
        elif not -0.0501 < share < 1.0501:
            assert told == (None, RANGE)


@pytest.mark.parametrize(
    ("mm", "value"),
    [(519.5, (0, GOOD)), (520.5, (None, RANGE)), (80.5, (10_000, GOOD)), (79.5, (None, RANGE))],
)
def test_the_level_is_clipped_within_5_percent_beyond_both_ends(mm, value):
    assert TankDriver(Hcsr04(mm)).run(3000)[-1] == value


def test_one_false_or_missing_echo_of_three_is_not_told():
    part = Hcsr04(300.0)
    driver = TankDriver(part)
    driver.run(3000)
    for false in (30.0, 4000.0, None):
        part.mm = false
        (level, quality) = driver.run(1000)[-1]
        assert quality == GOOD
        assert abs(level - 5000) <= 5
        part.mm = 300.0
        assert len(driver.run(2000)) == 2


def test_no_reflection_is_a_fault_from_the_second_shot_and_recovers_after_three():
    part = Hcsr04(300.0)
    driver = TankDriver(part)
    driver.run(3000)
    part.mm = None
    assert [quality for _, quality in driver.run(4000)] == [GOOD, FAULT, FAULT, FAULT]
    part.mm = 300.0
    assert [quality for _, quality in driver.run(4000)] == [GOOD, GOOD]


def test_an_unplugged_hcsr04_is_a_fault_once_a_second_and_comes_back():
    part = Hcsr04()
    part.plugged = False
    driver = TankDriver(part)
    assert driver.run(5000) == [(None, FAULT)] * 5
    part.plugged = True
    assert [quality for _, quality in driver.run(4000)] == [GOOD, GOOD]


def test_an_echo_pin_that_stays_low_is_a_fault():
    part = Silence()
    part.held = False
    assert TankDriver(part).run(2000) == [(None, FAULT)] * 2


def test_an_echo_pin_that_stays_high_is_not_shot_at():
    part = Hcsr04()
    part.held = True
    assert TankDriver(part).run(3000) == [(None, FAULT)] * 3
    assert part.shots_us == []


def test_two_pulses_for_one_shot_are_not_believed():
    part = Hcsr04()
    driver = TankDriver(part)
    driver.lines.parts.append(other := Silence())
    other.planned = [(ms * 1000.0, ms * 1000.0 + 500.0) for ms in range(10, 9000, 40)]
    assert driver.run(3000) == [(None, FAULT)] * 3


@pytest.mark.parametrize(
    ("empty_mm", "full_mm"), [(100, 100), (100, 500), (4501, 100), (65535, 0), (0, 65535)]
)
def test_a_tank_that_cannot_be_is_a_fault(empty_mm, full_mm):
    assert TankDriver(Hcsr04(), empty_mm=empty_mm, full_mm=full_mm).run(3000)[-1] == (None, FAULT)


def test_the_hcsr04s_clock_may_wrap():
    assert len(TankDriver(Hcsr04(), start_ms=NEARLY_WRAPPED).run(6000)) == 4


@pytest.mark.parametrize("stride", [1, 7, 50, 100])
def test_the_hcsr04_works_with_slow_rounds(stride):
    told = TankDriver(Hcsr04(300.0)).run(20_000, stride=stride)
    assert len(told) > 10
    assert all(quality == GOOD for _, quality in told)


def test_a_jitter_of_the_edges_is_small_in_the_level():
    part = Hcsr04(300.0)
    chance = random.Random(2)
    part.extra = lambda: chance.uniform(-60.0, 60.0)  # 10 mm
    assert all(abs(level - 5000) <= 260 for level, _ in TankDriver(part).run(30_000, stride=3))


def test_two_drivers_that_listen_take_turns():
    lines = SimulatedLines(Dht22(), Hcsr04(300.0))
    tank, air = TankDriver(), Thermometer()
    air.init(ctypes.byref(lines.bus), ctypes.byref(tank.listening), U8(PIN), air.clock())
    arguments = U8(TRIGGER), U8(ECHO), U16(500), U16(100)
    tank.init(ctypes.byref(lines.bus), ctypes.byref(tank.listening), *arguments)
    tank.bus = air.bus = lines
    levels, airs = [], []
    for _ in range(20_000):
        levels += tank.run(1)
        airs += air.run(1)
    assert len(levels) >= 17
    assert all(abs(level - 5000) <= 5 for level, _ in levels)
    assert len(airs) >= 7
    assert set(airs) == {BOTH_GOOD}


@given(
    st.lists(st.lists(st.integers(0, 65535), max_size=3), max_size=10),
    st.integers(0, 2**32 - 1),
    st.integers(0, 65535),
    st.integers(0, 65535),
    st.integers(-(2**31), 2**31 - 1),
)
def test_arbitrary_echoes_give_a_good_level_only_within_the_range(
    shots, start_ms, empty_mm, full_mm, temp_air
):
    part = Silence()
    part.held = False
    driver = TankDriver(part, start_ms=start_ms, empty_mm=empty_mm, full_mm=full_mm)
    for lengths in shots:
        begin = driver.now_ms * 1000.0 + 5000.0
        part.planned = [(begin, begin + us) for us in lengths]
        for level, quality in driver.run(1000, temp_air=temp_air, stride=4):
            assert (level is not None and 0 <= level <= 10_000) == (quality == GOOD)


# --- float switch ---


class FloatSwitch(Silence):
    """A switch to ground."""

    closed = False

    def level(self, pin: int, now_us: float) -> bool | None:
        return False if self.closed else None


class Float(LineDriver):
    """The float switch's driver."""

    def __init__(self, part, *, closed_is_water: bool = True, start_ms: int = 0) -> None:
        super().__init__("gh_float", lines := SimulatedLines(part), start_ms)
        self.lines = lines
        self.init(ctypes.byref(lines.bus), U8(PIN), ctypes.c_bool(closed_is_water))


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("closed_is_water", [False, True])
def test_a_float_switch_tells_water_once_a_second_after_2_s(closed, closed_is_water):
    part = FloatSwitch()
    part.closed = closed
    driver = Float(part, closed_is_water=closed_is_water)
    assert driver.lines.levels[PIN] == RELEASED
    assert driver.run(2000) == []
    assert driver.run(3000) == [(10_000 if closed == closed_is_water else 0, GOOD)] * 3


def test_a_float_switch_changes_after_2_s_and_not_before():
    part = FloatSwitch()
    driver = Float(part)
    driver.run(2500)
    part.closed = True
    assert driver.run(1999) == [(0, GOOD)] * 2
    part.closed = False
    driver.run(1)
    part.closed = True
    assert driver.run(2000) == [(0, GOOD)] * 2
    assert driver.run(1001) == [(10_000, GOOD)]


def test_a_float_switch_that_bounces_keeps_its_level():
    part = FloatSwitch()
    driver = Float(part)
    driver.run(3000)
    for i in range(20):
        part.closed = i % 2 == 0
        assert set(driver.run(1700)) == {(0, GOOD)}


def test_a_float_switch_that_bounces_from_the_start_tells_nothing():
    part = FloatSwitch()
    driver = Float(part)
    for i in range(20):
        part.closed = i % 2 == 0
        assert driver.run(1700) == []


def test_the_float_switchs_clock_may_wrap():
    assert len(Float(FloatSwitch(), start_ms=NEARLY_WRAPPED).run(6000)) == 4


def test_a_float_switch_that_stands_still_for_weeks_changes_after_2_s_as_ever():
    part = FloatSwitch()
    driver = Float(part)
    driver.run(3000)
    driver.run(2**32, stride=2**24)
    part.closed = True
    assert set(driver.run(1999)) == {(0, GOOD)}


@given(st.lists(st.tuples(st.booleans(), st.integers(1, 4000)), max_size=30), st.integers(0, 2**32 - 1))
def test_a_float_switch_tells_only_levels_that_held_for_2_s(levels, start_ms):
    part = FloatSwitch()
    driver = Float(part, start_ms=start_ms)
    steady: set[bool] = set()
    runs = [
        (level, sum(ms for _, ms in group))
        for level, group in itertools.groupby(levels, lambda pair: pair[0])
    ]
    for closed, ms in runs:
        part.closed = closed
        steady |= {closed} if ms > 2000 else set()
        told = {raw for raw, _ in driver.run(ms)}
        assert told <= {10_000 if one else 0 for one in steady}


# --- soil probe ---


class SoilDriver(LineDriver):
    """The soil probe's driver. counts : what the converter gives"""

    def __init__(
        self, counts: int | Callable[[int], int], dry: int = 800, wet: int = 400, start_ms: int = 0
    ) -> None:
        super().__init__("gh_soil", lines := SimulatedLines(), start_ms)
        lines.counts = counts if callable(counts) else lambda _channel: counts
        self.lines = lines
        self.init(ctypes.byref(lines.bus), U8(CHANNEL), U16(dry), U16(wet))


@pytest.mark.parametrize(
    ("dry", "wet"), [(800, 400), (300, 700), (1000, 4), (4, 1019), (500, 501), (501, 500)]
)
def test_every_count_is_that_of_floating_point(dry, wet):
    counts = [0]
    driver = SoilDriver(lambda _channel: counts[0], dry, wet)
    for counts[0] in range(1024):
        told = driver.run(1000, stride=200)
        assert len(told) == 1
        share = (counts[0] - dry) / (wet - dry)
        if counts[0] <= 3 or counts[0] >= 1020:
            assert told == [(None, FAULT)]
        elif 10 * share < -1 or 10 * (share - 1) > 1 + 1e-12:
            assert told == [(None, RANGE)]
        else:
            assert told[0][1] == GOOD
            assert abs(told[0][0] - min(max(share, 0.0), 1.0) * 10_000) < 1.0


def test_the_median_of_five_takes_two_disturbed_samples():
    samples = itertools.cycle([0, 600, 1023, 600, 600])
    assert set(SoilDriver(lambda _channel: next(samples)).run(5000)) == {(5000, GOOD)}


def test_one_sample_a_step_and_one_value_a_second():
    driver = SoilDriver(600)
    assert driver.run(4) == []
    assert driver.run(1) == [(5000, GOOD)]
    assert driver.run(995) == []
    assert driver.run(5) == [(5000, GOOD)]


def test_the_same_count_for_dry_and_wet_is_a_fault():
    assert SoilDriver(600, 600, 600).run(5) == [(None, FAULT)]


def test_an_unplugged_probe_is_a_fault_and_comes_back():
    counts = [0]
    driver = SoilDriver(lambda _channel: counts[0])
    assert driver.run(3000) == [(None, FAULT)] * 3
    counts[0] = 400
    assert driver.run(1000) == [(10_000, GOOD)]


def test_the_probes_channel_is_asked():
    asked = set()
    SoilDriver(lambda channel: asked.add(channel) or 500).run(100)
    assert asked == {CHANNEL}


def test_the_probes_clock_may_wrap():
    assert SoilDriver(600, start_ms=NEARLY_WRAPPED).run(6000) == [(5000, GOOD)] * 6


@given(
    st.lists(st.integers(0, 65535), min_size=1, max_size=40),
    st.integers(0, 65535),
    st.integers(0, 65535),
    st.integers(0, 2**32 - 1),
)
def test_arbitrary_counts_give_a_good_value_only_within_the_range(counts, dry, wet, start_ms):
    samples = itertools.cycle(counts)
    for value, quality in SoilDriver(lambda _channel: next(samples), dry, wet, start_ms).run(9000, stride=50):
        assert (value is not None and 0 <= value <= 10_000) == (quality == GOOD)


# --- vote ---

AGREE, ALONE, DISAGREE, NONE = range(4)


class Vote(CDriver):
    """The vote of two sensors that may differ by 1 K."""

    def __init__(self, start_ms: int = 0, limit: int = 100) -> None:
        super().__init__("gh_vote", None, start_ms)
        self.init(U16(limit))

    def hear(self, sensor: int, raw: int | None, quality: int = GOOD) -> None:
        one = Measurement(NO_VALUE if raw is None else raw, quality)
        drivers().gh_vote_hear(self.memory, U8(sensor), ctypes.byref(one), self.clock())

    def run(self, ms: int, stride: int = 10) -> list:
        """Returns : [(raw or None, quality, verdict)]"""
        told = []
        for _ in range(0, ms, stride):
            found, verdict = Measurement(), U8(255)
            if self.step(ctypes.byref(found), ctypes.byref(verdict)):
                told.append((*found.value, verdict.value))
            self.now_ms += stride
        return told


def test_two_sensors_that_agree_give_their_mean():
    vote = Vote()
    vote.hear(0, 2000)
    vote.hear(1, 2100)
    assert vote.run(900) == [(2050, GOOD, AGREE)]


@pytest.mark.parametrize("swapped", [False, True])
def test_of_two_that_disagree_the_warmer_is_told(swapped):
    vote = Vote()
    vote.hear(int(swapped), 2000)
    vote.hear(int(not swapped), 2101)
    assert vote.run(900) == [(2101, GOOD, DISAGREE)]


def test_one_that_is_good_is_told_alone():
    vote = Vote()
    vote.hear(0, None, FAULT)
    vote.hear(1, -512)
    assert vote.run(900) == [(-512, GOOD, ALONE)]


def test_two_that_are_not_good_are_a_fault_once_a_second():
    vote = Vote()
    told = []
    for _ in range(30):
        vote.hear(0, None, FAULT)
        vote.hear(1, None, RANGE)
        told += vote.run(100)
    assert told == [(None, FAULT, NONE)] * 3


def test_nothing_heard_is_nothing_told():
    assert Vote().run(10_000) == []


def test_a_sensor_that_falls_silent_is_left_out_after_3_s_and_then_both_are_a_fault():
    vote = Vote()
    vote.hear(1, 2500)
    told = []
    for _ in range(5):
        vote.hear(0, 2000)
        told += vote.run(1000)
    assert told[0] == (2500, GOOD, DISAGREE)
    assert told[-1] == (2000, GOOD, ALONE)
    assert vote.run(5000) == [(None, FAULT, NONE)]
    vote.hear(0, 2000)
    assert vote.run(100) == [(2000, GOOD, ALONE)]


def test_one_false_warm_value_is_told_once_since_the_trip_needs_two():
    vote = Vote()
    told = []
    for second in range(10):
        vote.hear(0, 2000)
        if second % 2 == 0:  # a slow sensor
            vote.hear(1, 6000 if second == 4 else 2010)
        told += vote.run(1000)
    assert [row[0] for row in told].count(6000) == 1
    assert {row[0] for row in told} == {6000, 2005}


def test_a_warm_sensor_is_not_hidden_by_a_cold_dead_one():
    vote = Vote()
    told = []
    for _ in range(5):
        vote.hear(0, 0)
        vote.hear(1, 5500)
        told += vote.run(1000)
    assert told == [(5500, GOOD, DISAGREE)] * 5


def test_the_votes_clock_may_wrap_and_an_old_value_stays_old():
    vote = Vote(start_ms=NEARLY_WRAPPED)
    vote.hear(0, 2000)
    vote.hear(1, 2000)
    assert len(vote.run(2**32 + 2000, stride=2**20)) == 2  # the value, then that it is too old
    assert vote.run(3000) == []


def test_a_sensor_that_does_not_exist_is_not_heard():
    vote = Vote()
    vote.hear(2, 2000)
    assert vote.run(1000) == []


@given(
    st.lists(
        st.tuples(st.integers(0, 1), st.integers(-5500, 12_500), st.integers(0, 4), st.integers(0, 4000))
    ),
    st.integers(0, 2**32 - 1),
    st.integers(0, 65535),
)
def test_the_vote_is_never_colder_than_the_mean_nor_warmer_than_the_warmer(heard, start_ms, limit):
    vote = Vote(start_ms, limit)
    good: dict[int, int] = {}
    for sensor, raw, quality, ms in heard:
        vote.hear(sensor, raw if quality == GOOD else None, quality)
        good.pop(sensor, None)
        if quality == GOOD:
            good[sensor] = raw
        told = vote.run(ms, stride=200)
        for value, its_quality, verdict in told:
            assert (value is None) == (its_quality == FAULT) == (verdict == NONE)
            assert value is None or min(good.values()) <= value <= max(good.values())
            if verdict == DISAGREE:
                assert value == max(good.values())


# --- all of them ---


@pytest.mark.parametrize("name", RAM_BYTES)
def test_a_driver_takes_little_of_an_atmega328ps_memory(name, tmp_path):
    if shutil.which("avr-gcc") is None:
        pytest.fail("avr-gcc is missing: `make test` installs gcc-avr and avr-libc")
    header = "gh_one_wire" if name == "gh_one_wire_search" else name
    source = tmp_path / "size.c"
    source.write_text(
        f'#include "{header}.h"\n_Static_assert(sizeof({name}) <= {RAM_BYTES[name]}, "too large");\n'
    )
    flags = ["-mmcu=atmega328p", "-std=c11", "-Os", "-I", str(SOURCES), "-I", str(DRIVERS)]
    subprocess.run(["avr-gcc", *flags, "-c", str(source), "-o", str(tmp_path / "size.o")], check=True)
