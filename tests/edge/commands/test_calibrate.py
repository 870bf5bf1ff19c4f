"""edge/commands/calibrate.py: the orders that it sends, and what it prints of the answer."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from loop_rig import LoopRig

from edge.__main__ import main
from edge.commands import calibrate


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Iterator[LoopRig]:
    rig = LoopRig()
    rig.tick()
    monkeypatch.setattr(calibrate, "request", lambda socket, message: rig.ask(message))
    yield rig
    rig.close()


def said(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, list[str]]:
    code = main(["calibrate", *words, "--socket", str(Path("no.sock"))])
    return code, capsys.readouterr().out.splitlines()


def test_a_point_shows_what_it_would_change_before_it_is_applied(
    rig: LoopRig, capsys: pytest.CaptureFixture[str]
) -> None:
    code, lines = said(capsys, "point", "temp_ambient", "-3.5")
    assert code == 1
    assert "too far from the reading of 21.00 °C" in lines[0]
    code, lines = said(capsys, "point", "temp_ambient", "20.25")
    assert (code, lines[0].partition("no ")[2]) == (0, "sensor. Points to apply: temp_ambient 20.25 °C.")
    assert lines[1] == "temp_ambient  reads 21.00 °C, 1 * reading + 0.00 °C, as configured"
    assert lines[2].endswith("20.25 °C is true, raw 21.00 °C, noise 0.00 °C")
    assert lines[3] == (
        "  will read 20.25 °C, 1 * reading - 0.75 °C after `greenhouse calibrate apply temp_ambient`"
    )
    code, lines = said(capsys, "apply", "temp_ambient")
    assert lines[1].startswith("temp_ambient  reads 20.25 °C, 1 * reading - 0.75 °C, calibrated 20")
    code, shown = said(capsys, "show")
    assert shown[1:] == lines[1:]
    assert said(capsys, "reset", "temp_ambient")[1][1].endswith("as configured")
    assert said(capsys, "discard", "temp_ambient") == (
        1,
        ["refused: temp_ambient: there is no calibration point"],
    )


def test_a_daemon_of_earlier_software_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(calibrate, "request", lambda socket, message: {"ok": True})
    assert main(["calibrate", "show", "--socket", "no.sock"]) == 2
    assert "knows no calibrations" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", ["point temp_air", "point temp_air nan", "point temp_air X", "point temp_leaf 1", "apply", ""]
)
def test_what_cannot_be_meant_is_refused_before_anybody_is_asked(words: str) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["calibrate", *words.split()])
    assert ended.value.code == 2
