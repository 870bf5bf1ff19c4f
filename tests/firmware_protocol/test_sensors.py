"""c/drivers/gh_sensors.c: each part of a configuration gets its turn, its signal reaches the report."""

import ctypes
from dataclasses import replace

import pytest
from drivers.library import STEP_MAX_US, I2c, Lines, OneWire, SimulatedLines, SimulatedOneWire, drivers
from test_i2c_drivers import Bh1750, Bus, BusClock, Scd4x, Sht
from test_one_wire import Ds18b20, rom_id
from test_pulse_drivers import ECHO, PIN, TRIGGER, Dht22, Hcsr04

from firmware_protocol.board_block import BoardBlock, BoardKind, Part, PartConfig, encode_block
from firmware_protocol.frame import FrameDecoder
from firmware_protocol.messages import Quality, SensorReport, unpack
from tests.support.c_core import CPins

pytestmark = pytest.mark.slow

SHT = PartConfig(Part.SHT4X, 0x44)
INSIDE, OUTSIDE = (
    PartConfig(Part.DS18B20, 2, outside=out, serial=number) for number, out in ((1, 0), (2, 1))
)
REST = (
    PartConfig(Part.SCD4X, 0x62),
    PartConfig(Part.BH1750, 0x23, first=4000),
    PartConfig(Part.SOIL, 14, first=620, last=280),
    PartConfig(Part.HCSR04, TRIGGER, ECHO, first=400, last=100),
)
OUTPUTS = (7, 8, 9, 10, 11)


class Buses(ctypes.Structure):
    """gh_buses"""

    _fields_ = (("i2c", I2c), ("wire", OneWire), ("lines", Lines))


class BoardRig:
    """A board with its sensors, as the main loop runs them; all parts are there, configured or not."""

    def __init__(self, *parts: PartConfig) -> None:
        self.clock = BusClock()
        self.sht, self.co2, self.light = Sht(self.clock, 1), Scd4x(self.clock), Bh1750(self.clock)
        self.i2c = Bus({0x44: self.sht, 0x62: self.co2, 0x23: self.light}, self.clock)
        self.inside, self.outside = Ds18b20(rom_id(1), 25 * 16), Ds18b20(rom_id(2), 18 * 16)
        self.wire = SimulatedOneWire(self.inside, self.outside)
        self.dht22, self.tank = Dht22(), Hcsr04(celsius=25.0)
        self.lines = SimulatedLines(self.dht22, self.tank)
        self.lines.counts = lambda channel: 450
        block = BoardBlock(BoardKind.UNO, 7, pins=OUTPUTS, parts=parts, air_apart=150)
        self.config, self.board, self.sensors = ((ctypes.c_uint64 * 256)() for _ in range(3))
        self.library = drivers()
        self.library.gh_config_read.restype = ctypes.c_bool
        self.library.gh_board_step.restype = CPins
        self.library.gh_board_transmit.restype = ctypes.c_size_t
        self.buses = Buses(self.i2c.bus, self.wire.bus, self.lines.bus)
        assert self.library.gh_config_read(encode_block(block), BoardKind.UNO, self.config)
        self.library.gh_board_init(self.board, self.config, b"\xff" * 4, 0, 0)
        self.library.gh_sensors_init(self.sensors, self.config, ctypes.byref(self.buses), 0)
        self.decoder = FrameDecoder()
        self.reports: list[SensorReport] = []
        self.now_ms = 0

    def run(self, seconds: float) -> SensorReport:
        """Rounds of 1 ms; returns the last report."""
        for _ in range(round(seconds * 1000)):
            self.now_ms += 1
            self.clock.us = self.now_ms * 1000.0
            self.wire.now_ms = self.lines.now_ms = float(self.now_ms)
            self.i2c.spent_us = self.wire.spent_us = self.lines.spent_us = 0.0
            self.library.gh_sensors_step(self.sensors, self.board, self.now_ms)
            assert self.i2c.spent_us + self.wire.spent_us + self.lines.spent_us <= STEP_MAX_US
            self.library.gh_board_step(self.board, self.now_ms)
            self._transmit()
        return self.reports[-1]

    def _transmit(self) -> None:
        out = ctypes.create_string_buffer(192)
        size = self.library.gh_board_transmit(self.board, out, 192)
        for payload in self.decoder.feed(out.raw[:size]):
            _, message = unpack(payload)
            if isinstance(message, SensorReport):
                self.reports.append(message)


def test_every_signal_of_a_full_rig_is_reported_and_stays_good():
    rig = BoardRig(SHT, INSIDE, OUTSIDE, *REST)
    rig.run(12.0)
    first = len(rig.reports)
    rig.run(20.0)
    report = rig.reports[-1]
    assert report.temp_air_c == pytest.approx(25.0, abs=0.02)  # the mean of 25.00 and 25.00
    assert report.temp_ambient_c == 18.0
    assert report.co2_ppm == 500  # 0x01F4
    assert report.light == pytest.approx(28067 / 40_000, abs=1e-4)  # the datasheet's 0x8390
    assert report.soil_moisture == pytest.approx((620 - 450) / (620 - 280), abs=1e-4)
    assert report.tank_level == pytest.approx(1 / 3, abs=2e-3) and report.rel_humidity_pct == pytest.approx(
        40.25, abs=0.1
    )
    qualities = [
        quality
        for one in rig.reports[first:]
        for quality in (
            one.temp_air_quality, one.rel_humidity_quality, one.co2_quality, one.light_quality,
            one.soil_moisture_quality, one.tank_level_quality, one.temp_ambient_quality,
        )
    ]  # fmt: skip
    assert set(qualities) == {Quality.GOOD}


def test_what_is_not_configured_is_absent():
    report = BoardRig(SHT).run(5.0)
    assert report.temp_air_quality is Quality.GOOD
    assert report.co2_quality is report.temp_ambient_quality is report.tank_level_quality is Quality.ABSENT


def test_without_a_part_there_is_no_air_temperature():
    report = BoardRig().run(3.0)
    assert (report.temp_air_c, report.temp_air_quality) == (None, Quality.ABSENT)


def test_of_two_air_sensors_the_one_that_is_left_is_reported():
    rig = BoardRig(SHT, INSIDE)
    rig.sht.words = (rig.sht.words[0] + 0x0200, rig.sht.words[1])  # 1.37 K warmer: within 1.5 K
    assert rig.run(8.0).temp_air_c == pytest.approx(25.68, abs=0.03)
    rig.sht.unplug()
    assert rig.run(6.0).temp_air_c == 25.0
    rig.sht.plug()
    assert rig.run(6.0).temp_air_c == pytest.approx(25.68, abs=0.03)


def test_of_two_air_sensors_that_disagree_the_warmer_is_reported():
    rig = BoardRig(SHT, INSIDE)
    rig.inside.sixteenths = 40 * 16
    assert rig.run(8.0).temp_air_c == 40.0


def test_both_air_sensors_dead_is_a_fault():
    rig = BoardRig(SHT, INSIDE)
    rig.run(5.0)
    rig.sht.unplug()
    rig.inside.plugged = False
    report = rig.run(8.0)
    assert (report.temp_air_c, report.temp_air_quality) == (None, Quality.FAULT)


def test_co2_stays_known_between_two_values_and_not_longer():
    rig = BoardRig(SHT, REST[0])
    rig.run(15.0)
    assert {one.co2_quality for one in rig.reports[-5:]} == {Quality.GOOD}
    rig.co2.unplug()
    assert rig.run(15.0).co2_quality is Quality.FAULT


def test_a_dht22_reports_both_its_values_and_lets_the_wire_wait_while_it_listens():
    rig = BoardRig(replace(SHT, part=Part.DHT22, pin=PIN), OUTSIDE)
    rig.dht22.tenths = 500, 251
    report = rig.run(12.0)
    assert (report.temp_air_c, report.rel_humidity_pct, report.temp_ambient_c) == (25.1, 50.0, 18.0)


def test_capabilities_are_those_of_outputs_and_parts():
    rig = BoardRig(SHT, OUTSIDE, *REST)
    bits = rig.library.gh_config_capabilities(rig.config)
    assert bits == 0b01_1111_1111  # all but the tacho
    assert BoardRig(INSIDE).library.gh_config_capabilities(BoardRig(INSIDE).config) == 0b01_0000_0011
