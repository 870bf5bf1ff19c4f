"""`greenhouse fleet`: found beside the daemon's commands, and what it says where it can do nothing."""

from datetime import datetime
from pathlib import Path

import pytest
from sqlalchemy.orm import Session

from edge.__main__ import main
from fleet.commands.work import seconds_until
from fleet.database.base import open_database
from fleet.database.rigs import FleetRig
from fleet.settings import DatabaseSettings


def settings_file(folder: Path, text: str = "") -> Path:
    path = folder / "fleet.yaml"
    path.write_text(text or f'database: {{url: "sqlite:///{folder}/fleet.db"}}\n')
    return path


def call(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr("sys.argv", ["greenhouse", "fleet", *words])
    return main(["fleet", *words])


def test_rigs_are_listed_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = settings_file(tmp_path)
    with Session(open_database(DatabaseSettings(url=f"sqlite:///{tmp_path}/fleet.db"))) as session:
        for name, air in (("tent-2", 21.26), ("tent-1", None)):
            session.add(
                FleetRig(name=name, kind="tent", first_utc=1.0, last_utc=2.0, state={"temp_air_c": air})
            )
        session.commit()
    assert call(monkeypatch, "rigs", "--settings", str(path)) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first.split() == ["tent-1", "away", "tent", "no", "air", "temperature"]
    assert second.split() == ["tent-2", "away", "tent", "21.3", "°C"]


def test_a_wrong_key_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = settings_file(tmp_path, "database: {url: 'mysql://x'}\nnumbers: {ulr: 'http://x'}\n")
    assert call(monkeypatch, "rigs", "--settings", str(path)) == 2
    said = capsys.readouterr().err
    assert "database.url: 'mysql://x' does not match" in said
    assert "numbers: unknown key 'ulr'" in said


def test_a_package_that_is_missing_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "sqlalchemy", None)
    monkeypatch.delitem(__import__("sys").modules, "fleet.commands.lists", raising=False)
    monkeypatch.delitem(__import__("sys").modules, "fleet.database.base", raising=False)
    assert call(monkeypatch, "rigs", "--settings", str(settings_file(tmp_path))) == 2
    assert "pip install 'greenhouse-twin[fleet]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("at", "now", "hours"), [((3, 0), "02:00", 1.0), ((3, 0), "03:00", 24.0), ((3, 0), "04:30", 22.5)]
)
def test_the_next_night_begins_at_its_time(at: tuple[int, int], now: str, hours: float) -> None:
    moment = datetime.strptime(f"2026-01-31 {now}", "%Y-%m-%d %H:%M")
    assert seconds_until(at, moment) == 3600.0 * hours


def test_a_time_that_is_none_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(monkeypatch, "work", "--at", "25:00", "--settings", str(settings_file(tmp_path))) == 2
    assert "--at: '25:00' is no time like 03:00" in capsys.readouterr().err
