"""bench/board_fuzz.py, shortly: it runs, reaches what it is for, and tells a failure."""

import pytest

from bench import board_fuzz

pytestmark = pytest.mark.slow


def test_a_short_run_ends_well_and_reaches_heat_answers_and_configurations():
    done = board_fuzz.fuzz(300_000, seed=3)
    assert done.returncode == 0, done.stderr
    rows = (line.rpartition(" ") for line in done.stdout.splitlines())
    counts = {name: int(number) for name, _, number in rows}
    assert counts["bytes"] >= 300_000 and min(counts.values()) > 10


def test_a_run_that_fails_is_told(monkeypatch, capsys):
    monkeypatch.setattr(board_fuzz, "blocks", lambda: b"\xff" * 100)  # no block: the program refuses
    assert board_fuzz.main(["--bytes", "1000"]) == 1
    assert "ended with 2" in capsys.readouterr().out
