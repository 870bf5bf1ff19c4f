"""`greenhouse board flash` with avrdude and the Arduinos' own bootloaders, in simavr."""

import re
import shutil
from contextlib import suppress

import pytest
from avr.arduino import BLANK, BOOTLOADERS, Arduino
from avr.sensor_parts import WIRINGS, all_parts, configured
from avr.simulated_avr import hex_pieces

from edge.board import board_session, board_tool
from edge.board import firmware_file as firmware_file_module
from edge.board.board_session import BoardSession
from edge.board.firmware_file import FOLDER, firmware_file, write_stages
from edge.core.errors import DataError, RequestError
from firmware_protocol import link
from firmware_protocol.board_block import decode_block

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

BAUDRATE = 115_200
HALF_OF_THE_PROGRAM = 12_000  # bytes on the line
GREETED_S = 40.0
TRIES = 3  # a simulator that gets no processor for a while loses a byte
NOBODY_S = 3.0  # to wait for a board that has no program


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """Waits of the host's side that a simulator on a busy machine keeps."""
    for name, seconds in (("SILENCE_S", 20.0), ("RETRY_S", 2.0)):
        monkeypatch.setattr(link, name, seconds)
    for name, seconds in (("GREETED_S", GREETED_S), ("ANSWERED_S", 12.0), ("RESET_S", 40.0)):
        monkeypatch.setattr(board_session, name, seconds)


@pytest.fixture(autouse=True)
def tools():
    for path in BOOTLOADERS.values():
        assert path.exists(), "arduino-core-avr is missing: `make test` installs it"
    assert shutil.which("avrdude"), "avrdude is missing: `make test` installs it"


def flashed(board: str, port) -> str:
    """All that a flash of a board says which has no program."""
    try:
        return flash(board, port, NOBODY_S)
    except RequestError as error:  # a simulator that gets no processor for a while loses a byte
        assert "Run the same command again" in str(error)
        return flash(board, port, NOBODY_S)


def flash(board: str, port, before_s: float) -> str:
    """All that it says. before_s : patience with the program that is there, or is not"""
    lines = board_tool.flash(board, str(port), BAUDRATE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(board_session, "GREETED_S", before_s)
        before = next(lines)
    return "\n".join([before, *lines])


def program_of(board: str):
    return firmware_file(board).path


@pytest.mark.parametrize("board", WIRINGS)
def test_a_new_arduino_is_flashed_configured_and_shown(avr_host, tmp_path, board):
    wiring, port = WIRINGS[board], tmp_path / "port"
    (tmp_path / "blank.hex").write_text(BLANK)
    with Arduino(avr_host, board, wiring, port, tmp_path / "blank.hex"):
        said = flashed(board, port)
        assert "before: " in said and "no board answers" in said
        assert re.search(r"after: board 0, program \d+\.\d+\.\d+;", said) and "no configuration yet" in said
        block = decode_block(configured(wiring, all_parts(wiring))[16:])
        with BoardSession(str(port)) as session:
            assert "no configuration: blank" in "\n".join(board_tool.show(session))
            assert "configured: board 7" in "\n".join(board_tool.configure(session, block))
            assert "already" in "\n".join(board_tool.configure(session, block))
            session.report()
            shown = "\n".join(board_tool.show(session))
        assert "on the 1-Wire: 28-000000000001, 28-000000000002" in shown
        assert "heater relay" in shown and re.search(r"Air temperature +25 ", shown)


def test_a_renewed_program_keeps_its_configuration(avr_host, tmp_path):
    wiring, port = WIRINGS["uno"], tmp_path / "port"
    eeprom = configured(wiring, all_parts(wiring))
    said = ""
    for _ in range(TRIES):  # after one that failed the old program is gone
        with (
            Arduino(avr_host, "uno", wiring, port, program_of("uno"), eeprom),
            suppress(RequestError),
        ):
            said = flash("uno", port, GREETED_S)
            break
    assert re.search("before: board 7, program", said) and re.search("after: board 7, program", said)
    assert "the configuration is the same" in said


def test_a_flash_that_breaks_off_leaves_a_board_that_drives_nothing(avr_host, tmp_path, monkeypatch):
    wiring, port = WIRINGS["uno"], tmp_path / "port"
    eeprom = configured(wiring, all_parts(wiring))
    with Arduino(avr_host, "uno", wiring, port, program_of("uno"), eeprom) as arduino:
        for _ in range(TRIES):
            lines = board_tool.flash("uno", str(port), BAUDRATE)
            stopped = pytest.raises(RequestError, match="the board is stopped and drives nothing")
            with monkeypatch.context() as patch, stopped:
                # avrdude spins for ever at a dead terminal
                patch.setattr(firmware_file_module, "FLASH_S", 8.0)
                for line in lines:
                    if line.startswith("writing 1"):
                        arduino.cut_after = HALF_OF_THE_PROGRAM
            if arduino.cut_after is None:
                break
        assert arduino.cut_after is None
        arduino.events.clear()
        with monkeypatch.context() as patch, pytest.raises(RequestError, match="no board answers"):
            patch.setattr(board_session, "GREETED_S", 5.0)
            BoardSession(str(port))
        outputs = {port for port, _ in wiring.output_places}
        led = 1 << 5  # of the bootloader
        assert not [e for e in arduino.events if e.kind == "D" and e.port in outputs and e.value & ~led]
        assert "the program that was written" not in flashed("uno", port)
        with BoardSession(str(port)) as session:
            assert session.hello.board_id == 7


@pytest.mark.parametrize(("board", "page"), [("uno", 128), ("mega2560", 256)])
def test_the_stages_together_are_the_program(tmp_path, board, page):
    text = program_of(board).read_text()
    begun, first = (list(hex_pieces(path.read_text())) for path in write_stages(text, page, tmp_path))
    assert dict(begun + first) == dict(hex_pieces(text))
    assert all(address < page for address, _ in first)
    assert [address for address, _ in begun] == sorted(address for address, _ in begun)
    assert b"".join(data for _, data in begun)[:page] == b"\xff\xcf" * (page // 2)


def test_a_damaged_file_is_not_flashed(tmp_path):
    for path in FOLDER.iterdir():
        shutil.copy(path, tmp_path)
    path = firmware_file("uno", tmp_path).path
    path.write_text(path.read_text().replace("0", "1", 1))
    with pytest.raises(DataError, match="damaged"):
        firmware_file("uno", tmp_path)
