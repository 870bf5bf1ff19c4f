"""Diagnoses of a night: a rig whose twin disagrees is diagnosed once, from what ingest has stored of it."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import Engine, select
from sqlalchemy.orm import Session

from edge.__main__ import main
from edge.core.messages import Reading, ReadingQuality
from edge.formats.run_file import RecordedRun
from edge.formats.tick_json import tick_json
from edge.twin.twin_file import twin_document
from fleet.commands.work import WORK
from fleet.database.base import open_database
from fleet.database.lease import FleetLease
from fleet.database.tables import FleetRig, RigDiagnosis, RigEvent, ToldTwin
from fleet.ingest.tick import parse_tick
from fleet.jobs.changes import changes
from fleet.jobs.diagnosis_job import begun_disagreements, diagnose_changed, rig_run
from fleet.numbers.series import lines
from fleet.numbers.victoria import Numbers
from fleet.settings import DatabaseSettings, FleetSettings, NumbersSettings
from tests.support.mqtt_rig import record
from tests.support.simulated_runs import BOX, simulate, twin_file
from tests.support.victoria import Victoria, needs_victoria

START = 1.79e9
HIDDEN = {"heater_lag": {"tau_h": 400.0}}


def store(numbers: Numbers, rig: str, recorded: RecordedRun) -> None:
    """Store a run that begins at START, a tick a minute."""
    text = []
    for row in range(len(recorded)):
        air, room, duty, fan = (
            float(recorded.columns[name][row])
            for name in ("temp_air_c", "temp_ambient_c", "heater_duty", "fan_on")
        )
        readings = {
            name: Reading(name, value, 0.0, ReadingQuality.GOOD)
            for name, value in (("temp_air", air), ("temp_ambient", room))
        }
        made = record(row + 1, utc=START + 60.0 * row, readings=readings)
        assert made.echo is not None
        made = replace(made, echo=replace(made.echo, heater_duty=duty, fan_on=bool(fan)))
        payload = json.dumps({"history_id": "h", **tick_json(made)}).encode()
        tick = parse_tick(rig, payload, 0.0, made.utc)
        text.append(lines(rig, tick.utc, tick.samples))
    numbers.store("".join(text))


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Engine]:
    engine = open_database(DatabaseSettings(url=f"sqlite:///{tmp_path}/fleet.db"))
    with Session(engine) as session, session.begin():
        session.add(FleetRig(name="rig-1", kind="tent", first_utc=START, last_utc=START))
    yield engine
    engine.dispose()


@pytest.fixture
def victoria(tmp_path: Path) -> Iterator[Victoria]:
    with Victoria(tmp_path) as own:
        yield own


def tell(engine: Engine, key: str, seq: int, utc: float) -> None:
    with Session(engine) as session, session.begin():
        event = RigEvent(rig="rig-1", history_id="h", seq=seq, number=0, utc=utc, key=key, severity="warning")
        event.text = f"{key} at {seq}"
        session.add(event)


def test_a_rig_disagrees_until_its_twin_agrees_again(engine: Engine) -> None:
    tell(engine, "twin.disagrees", 1, 10.0)
    tell(engine, "board.link_lost", 2, 15.0)
    tell(engine, "twin.agrees_again", 3, 20.0)
    with Session(engine) as session:
        assert begun_disagreements(session) == {}
    tell(engine, "twin.disagrees", 4, 30.0)
    with Session(engine) as session:
        assert begun_disagreements(session) == {"rig-1": 30.0}


def test_a_rig_that_cannot_be_diagnosed_is_told_and_ends_no_night(engine: Engine) -> None:
    tell(engine, "twin.disagrees", 1, START)
    nowhere = NumbersSettings(url="http://127.0.0.1:9")
    assert diagnose_changed(engine, nowhere, START + 60.0, workers=0) == []  # it has told no twin
    with Session(engine) as session, session.begin():
        session.add(ToldTwin(rig="rig-1", bundle="b", utc=START, document=twin_document(twin_file())))
    ((rig, found),) = diagnose_changed(engine, nowhere, START + 60.0, workers=0)
    assert (rig, found.verdict) == ("rig-1", "failed") and "numbers.url" in found.text


def test_one_process_does_the_jobs_of_a_night(
    engine: Engine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "fleet.yaml").write_text(f'database: {{url: "sqlite:///{tmp_path}/fleet.db"}}\n')
    words = ["fleet", "work", "--settings", f"{tmp_path}/fleet.yaml"]
    monkeypatch.setattr("sys.argv", ["greenhouse", *words])
    lease = FleetLease(engine, WORK)
    assert lease.take() == ""  # as while the service does them
    assert main(words) == 2
    assert "does the jobs of a night now" in capsys.readouterr().err
    lease.give_back()
    assert main(words) == 0
    assert "diagnosis: of 0 rigs whose twins disagree" in capsys.readouterr().out


@needs_victoria
@pytest.mark.slow
def test_what_is_missing_in_a_rigs_twin_is_named_once(
    engine: Engine, victoria: Victoria, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded = simulate({**BOX, **HIDDEN}, 1, 360)
    settings = FleetSettings(
        DatabaseSettings(url=f"sqlite:///{tmp_path}/fleet.db"), NumbersSettings(url=victoria.url)
    )
    numbers = Numbers(settings.numbers)
    store(numbers, "rig-1", recorded)
    found = rig_run(numbers, "rig-1", START, START + 1e5)
    for name in ("time_s", "temp_air_c", "temp_ambient_c", "heater_duty", "fan_on"):
        np.testing.assert_allclose(found.columns[name], recorded.columns[name], atol=1e-4)
    with Session(engine) as session, session.begin():
        session.add(ToldTwin(rig="rig-1", bundle="b", utc=START, document=twin_document(twin_file())))
    tell(engine, "twin.disagrees", 1, START + 60.0 * 300)
    ((_, finding),) = diagnose_changed(engine, settings.numbers, START + 60.0 * 360, workers=0)
    assert finding.effects == ("heater_lag",)
    assert finding.before_k is not None and finding.after_k is not None
    assert finding.after_k < 0.5 * finding.before_k
    assert diagnose_changed(engine, settings.numbers, START + 60.0 * 360, workers=0) == []
    with Session(engine) as session:
        assert session.scalars(select(RigDiagnosis)).one().effects == ["heater_lag"]
        told = [text for _, text in changes(session, START)["rig-1"]]
    assert told[0] == "twin.disagrees at 1" and "heater_lag is missing in its twin; its error goes" in told[1]
