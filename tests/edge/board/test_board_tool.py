"""`greenhouse board show`, `configure` and `flash` at boards that cannot do it, and at none."""

from dataclasses import replace

import pytest

from edge.board import board_tool
from edge.board.board_session import BoardSession, NobodyAnswers
from edge.board.serial_port import SerialPort
from edge.commands import board as command
from edge.core.errors import RequestError
from edge.core.names import SIGNALS
from firmware_protocol.board_block import NO_PIN, BoardBlock, BoardKind
from firmware_protocol.messages import Quality
from firmware_protocol.virtual_board.board_samples import Samples

pytest_plugins = ["rig_places"]

BLOCK = BoardBlock(BoardKind.UNO, 7, pins=(7, 8, NO_PIN, NO_PIN, NO_PIN))


@pytest.mark.slow
def test_a_board_that_takes_no_configuration_is_shown_and_says_so(board):
    with BoardSession(str(board.port)) as session:
        shown = "\n".join(board_tool.show(session))
        assert "pins and sensors are compiled into it" in shown
        assert all(signal.label in shown for signal in SIGNALS.values())
        with pytest.raises(RequestError, match="takes no configuration"):
            list(board_tool.configure(session, BLOCK))
        with pytest.raises(RequestError, match="the board has no configuration"):
            board_tool.configuration(session)


@pytest.mark.slow
def test_a_port_that_another_process_has_is_told(board):
    mine = SerialPort(str(board.port), 115_200)
    try:
        with pytest.raises(RequestError, match="`systemctl stop greenhouse` gives it back"):
            BoardSession(str(board.port))
    finally:
        mine.close()


def test_a_port_that_is_not_there_is_told(tmp_path):
    with pytest.raises(RequestError, match="there is no such port"):
        BoardSession(str(tmp_path / "nope"))


@pytest.mark.slow
def test_nobody_at_the_line_is_told_and_is_no_reason_not_to_flash(board, monkeypatch):
    written = []
    monkeypatch.setattr("edge.board.board_session.GREETED_S", 0.3)
    board.ask(
        fault={"name": "drop_bytes", "rate": 1.0, "start_s": board.truth()["time_s"], "duration_s": 1e6}
    )
    lines = board_tool.flash("uno", str(board.port), 115_200, write=lambda *told: written.append(told))
    with pytest.raises(NobodyAnswers):
        for line in lines:
            assert line.startswith(("before: ", "writing "))
    assert [path.name for _, _, path, _ in written] == ["1-stopped.hex", "2-first.hex"]


def test_every_signal_of_a_report_is_shown_with_its_quality():
    report = replace(Samples().report(5), temp_air_c=25.0, temp_air_quality=Quality.GOOD)
    rows = {row[0]: row[1:] for row in board_tool._values(report).rows}
    assert rows["Air temperature"] == ("25", "°C", "good")
    assert rows["CO2"] == ("-", "ppm", "absent")
    assert len(rows) == len(SIGNALS)


def test_a_wrong_file_is_refused_before_the_port_is_opened(tmp_path):
    file = tmp_path / "board.yaml"
    file.write_text("board: uno\nid: 1\noutputs: {heater: {pin: D99}}\n")
    arguments = type("Arguments", (), {"action": "configure", "file": file, "port": str(tmp_path / "nope")})
    with pytest.raises(Exception, match=r"D99|pin 99"):
        command.run(arguments)
