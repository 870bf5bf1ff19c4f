"""The programs that are flashed, c/../hex, on simulated boards with simulated sensors at their pins."""

import os
import subprocess
from pathlib import Path

import pytest
from avr.sensor_parts import DRY, NOW, WET, WIRINGS, SensorParts, all_parts, configured, wire_up
from avr.simulated_avr import FREQUENCY, AvrRig, SimulatedAvr

import firmware_protocol
from firmware_protocol.link import Report
from firmware_protocol.messages import CommandMessage, Quality
from firmware_protocol.virtual_board.c_core import SOURCES

pytestmark = pytest.mark.slow

HEX = Path(firmware_protocol.__file__).parent / "hex"
FLASH_MAX = 24 * 1024  # of the 32 kB of an ATmega328P, where the bootloader stands too
RAM_MAX = int(1.85 * 1024)
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

    def report(self, seconds: float):
        """The last report after so many seconds more."""
        self.run(seconds)
        return self.seen(Report)[-1].report


@pytest.fixture(params=WIRINGS)
def wiring(request):
    return WIRINGS[request.param]


@pytest.fixture
def board(host, wiring):
    """A board with all parts but the DHT22."""
    yield from powered(host, wiring, all_parts(wiring))


def powered(host, wiring, config_parts, program: Path | None = None, **values):
    name = "mega2560" if wiring is WIRINGS["mega2560"] else "uno"
    program = program or next(HEX.glob(f"{name}-*.hex"))
    parts = SensorParts(wiring)
    eeprom = configured(wiring, config_parts, **values)
    with SimulatedAvr(host, program, eeprom, wiring.microcontroller, parts) as avr:
        yield BoardWithSensors(avr, parts)


def test_the_files_of_the_package_are_what_the_sources_give(built):
    assert (built / "SHA256SUMS").read_text() == (HEX / "SHA256SUMS").read_text()
    assert subprocess.run(["sha256sum", "--check", "--quiet", "SHA256SUMS"], cwd=HEX).returncode == 0


def test_every_signal_of_a_full_rig_is_reported_and_stays_good(board):
    board.run(12.0)
    first = len(board.seen(Report))
    report = board.report(12.0)
    assert report.temp_air_c == pytest.approx(25.0, abs=0.02)
    assert report.temp_ambient_c == 18.0
    assert report.co2_ppm == 500
    assert report.light == pytest.approx(28067 / 40_000, abs=1e-4)
    assert report.soil_moisture == pytest.approx((DRY - NOW) / (DRY - WET), abs=3e-3)
    assert report.tank_level == pytest.approx(1 / 3, abs=5e-3)
    assert report.rel_humidity_pct == pytest.approx(40.25, abs=0.1)
    reports = [event.report for event in board.seen(Report)[first:]]
    assert {getattr(one, name) for one in reports for name in QUALITIES} == {Quality.GOOD}
    assert board.parts.wire.wrong == [] and len(reports) == 12
