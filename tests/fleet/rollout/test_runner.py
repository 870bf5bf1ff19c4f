"""The runner over a fleet in memory: passes, stops, rolls back, and goes on after a kill at any look."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fleet_in_memory import SETTINGS, SHA256, FleetInMemory
from sqlalchemy import create_engine
from sqlalchemy.orm import Session

from edge.core.errors import DataError, RequestError
from fleet.database.lease import FleetLease, LeaseLost
from fleet.database.tables import FleetRig, FleetTable, RolloutWave
from fleet.rollout.begin import begin, go_on_by_person, stop_by_person
from fleet.rollout.judge import HOUR_S, HourCost
from fleet.rollout.runner import RolloutRunner
from fleet.rollout.states import News
from fleet.settings import DatabaseSettings
from tests.support.postgres import needs_postgres


@pytest.fixture(params=["sqlite", pytest.param("postgres", marks=needs_postgres)])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[DatabaseSettings]:
    if request.param == "sqlite":
        yield DatabaseSettings(url=f"sqlite:///{tmp_path}/fleet.db")
        return
    url = request.getfixturevalue("postgres").url
    yield DatabaseSettings(url=url)
    engine = create_engine(url)
    FleetTable.metadata.drop_all(engine)
    engine.dispose()


def test_a_good_bundle_reaches_every_rig_in_three_waves(database: DatabaseSettings) -> None:
    fleet = FleetInMemory(database)
    found = fleet.run(hours=300.0, look_h=1.5)
    assert (found.state, found.wave, found.why) == ("done", 3, "all waves have passed")
    assert len(fleet.active) == 36
    for number in (1, 2):
        wave = fleet.wave(number)
        assert wave.why == "shown not worse: every kind is within 10%"
        assert min(row["blocks"] for row in wave.kinds.values()) >= 8
    installs = [rig for rig, order in fleet.orders if order == "install"]
    assert len(installs) == len(set(installs)) == 36  # each obeyed at once, none was asked twice


def test_a_bundle_bad_for_one_kind_stops_in_the_first_wave_and_is_rolled_back(
    database: DatabaseSettings,
) -> None:
    fleet = FleetInMemory(database, dearer={"case": 0.5})
    found = fleet.run(hours=100.0)
    assert (found.state, found.wave) == ("stopped", 1)
    assert "kind case is dearer by" in found.why
    fleet.look()
    assert fleet.active == {}
    back = {rig for rig, order in fleet.orders if order == "roll back"}
    assert len(back) == 18
    assert {fleet.rig(rig).state for rig in back} == {"rolled back"}


def test_a_refused_proof_stops_at_once_and_names_the_rig(database: DatabaseSettings) -> None:
    fleet = FleetInMemory(database)
    fleet.refuses = {f"tent-{number}" for number in range(12)}
    found = fleet.run(hours=3.0)
    assert found.state == "stopped"
    assert "6 of 18 rigs are unhealthy; tent-" in found.why
    assert "golden vector 3 is off" in found.why
    assert fleet.active == {}


def test_a_rig_that_falls_silent_after_the_install_stops_it(database: DatabaseSettings) -> None:
    fleet = FleetInMemory(database)
    fleet.run(hours=1.0)
    rig = sorted(fleet.active)[0]
    fleet.told.append(News(rig, "offline"))
    fleet.silent.add(rig)
    found = fleet.run(hours=2.0)
    assert (found.state, found.why) == ("stopped", f"1 of 18 rigs are unhealthy; {rig}: offline")
    # its order waits, and is sent once more as soon as it is there again
    assert (fleet.rig(rig).state, list(fleet.active)) == ("rolling back", [rig])
    fleet.silent.clear()
    fleet.told.append(News(rig, "online"))
    fleet.look()
    assert fleet.active == {}
    fleet.look()
    assert fleet.rig(rig).state == "rolled back"


def test_a_short_absence_and_a_fault_that_passes_do_not_stop_it(database: DatabaseSettings) -> None:
    fleet = FleetInMemory(database)
    fleet.run(hours=1.0)
    first, second = sorted(fleet.active)[:2]
    fleet.told += [News(first, "offline"), News(second, "controller.late", "late")]
    fleet.run(hours=0.2, look_h=0.1)
    fleet.told += [News(first, "online"), News(second, "controller.late.over", "over")]
    assert fleet.run(hours=6.0).state == "running"


@pytest.mark.parametrize(
    ("what", "hours"), [("bundle.refused", 0.1), ("bundle.rollback", 0.1), ("fallback.failed", 1.0)]
)
def test_a_rig_that_leaves_the_bundle_or_falls_back_for_long_stops_it(
    database: DatabaseSettings, what: str, hours: float
) -> None:
    fleet = FleetInMemory(database)
    fleet.run(hours=1.0)
    rig = sorted(fleet.active)[0]
    fleet.told.append(News(rig, what, "why"))
    found = fleet.run(hours=hours)
    assert (found.state, found.why) == ("stopped", f"1 of 18 rigs are unhealthy; {rig}: {what}: why")


def test_a_rig_that_does_not_answer_is_asked_again_and_then_stops_it(
    database: DatabaseSettings,
) -> None:
    fleet = FleetInMemory(database)
    fleet.silent = {f"tent-{number}" for number in range(12)}
    found = fleet.run(hours=3.0)
    assert "tent-" in found.why and "has not obeyed within 60 min" in found.why
    asked = [rig for rig, order in fleet.orders if order == "install" and rig.startswith("tent")]
    assert len(asked) >= 2 * len(set(asked))


def test_what_lasted_while_nobody_listened_counts_from_then_on(database: DatabaseSettings) -> None:
    fleet = FleetInMemory(database)
    fleet.run(hours=1.0)
    fleet.told.append(News(sorted(fleet.active)[0], "offline"))
    fleet.look()
    runner = fleet.runner()
    fleet.deaf = True
    fleet.utc += 10 * 3600.0
    runner.look(fleet.utc)
    fleet.deaf = False
    runner.look(fleet.utc + 60.0)
    assert fleet.state().state == "running"
    runner.look(fleet.utc + 2400.0)
    assert fleet.state().state == "stopped"


def test_a_bundle_that_cannot_be_fetched_is_not_taken_for_a_bad_one(database: DatabaseSettings) -> None:
    fleet = FleetInMemory(database)
    fleet.silent = {f"tent-{number}" for number in range(12)}
    fleet.run(hours=0.5)
    rig = next(rig for rig, _ in fleet.orders if rig in fleet.silent)
    text = f"remote-install (sha256 {SHA256}, asked for): http://fleet.example/x.zip: refused"
    fleet.told.append(News(rig, "bundle.failed", text))
    fleet.silent.clear()
    fleet.run(hours=1.0)
    assert fleet.rig(rig).state == "active"


def test_without_numbers_a_wave_waits_and_says_why(database: DatabaseSettings) -> None:
    fleet = FleetInMemory(database)
    fleet.run(hours=1.0)

    def broken(rig: str, since_utc: float, until_utc: float) -> list:  # type: ignore[type-arg]
        raise DataError("numbers.url: away")

    runner = RolloutRunner(fleet.engine, SETTINGS.address, fleet, broken, fleet.lease.check)
    assert runner.look(fleet.utc + 30 * 3600.0) == []
    assert runner.problem == "numbers.url: away"
    assert fleet.state().state == "running"


def test_a_wave_whose_time_is_over_is_held_until_a_person_lets_it_go_on(database: DatabaseSettings) -> None:
    fleet = FleetInMemory(database, dearer={"tent": 0.1})
    fleet.run(hours=118.0, look_h=1.5)
    with pytest.raises(RequestError, match="wave 1 is judging: only one that is held can go on"):
        go_on_by_person(fleet.engine, 1, "", fleet.utc)
    assert fleet.run(hours=30.0, look_h=1.5).state == "running"
    assert (fleet.wave(1).state, fleet.wave(1).why) == ("held", "not shown to be within 10%: tent")
    assert len(fleet.active) == 18
    assert [text for text in fleet.said if "held" in text] == [
        "rollout 1: wave 1 is held, not shown to be within 10%: tent; "
        "`greenhouse fleet rollout go-on 1`, or `stop`"
    ]
    assert go_on_by_person(fleet.engine, 1, "the tents are mine", fleet.utc) == 1
    fleet.look()
    assert (fleet.state().wave, fleet.wave(1).state) == (2, "passed")
    assert fleet.wave(1).why == "the tents are mine; not shown to be within 10%: tent"


@pytest.mark.parametrize("decide", [stop_by_person, go_on_by_person])
def test_what_a_person_decides_while_costs_are_read_holds(
    database: DatabaseSettings, decide: Callable[..., object]
) -> None:
    fleet = FleetInMemory(database)
    fleet.run(hours=3.0)
    with Session(fleet.engine) as session, session.begin():
        wave = session.get_one(RolloutWave, (1, 1))
        assert wave.state == "judging"
        wave.state = "held"
    costs, said = fleet.costs, len(fleet.said)

    def costs_while_a_person_decides(*asked: Any) -> list[HourCost]:
        if fleet.state().state == "running" and fleet.wave(1).state == "held":
            decide(fleet.engine, 1, "Ann did", fleet.utc)
        return costs(*asked)

    fleet.costs = costs_while_a_person_decides  # type: ignore[method-assign]
    fleet.utc += 2 * HOUR_S  # a block is due
    fleet.look()
    ended = "stopped" if decide is stop_by_person else "passed"
    assert (fleet.wave(1).state, len(fleet.said)) == (ended, said)
    assert fleet.wave(1).why.startswith("Ann did")


@pytest.mark.parametrize("hours", [0.0, 0.5], ids=["before a wave", "before an answer is taken"])
def test_a_stop_while_the_runner_looks_is_the_end(
    database: DatabaseSettings, monkeypatch: pytest.MonkeyPatch, hours: float
) -> None:
    fleet = FleetInMemory(database)
    if hours:
        fleet.look()
        assert fleet.told  # their answers wait: each would become active
    looking = RolloutRunner._hear

    def hear_while_a_person_stops(runner: RolloutRunner, session: Session, utc: float) -> None:
        with session.no_autoflush:
            looking(runner, session, utc)
            if fleet.state().state == "running":
                stop_by_person(fleet.engine, 1, "Ann did", utc)

    monkeypatch.setattr(RolloutRunner, "_hear", hear_while_a_person_stops)
    for _ in range(3):
        fleet.look()
    assert (fleet.state().state, fleet.state().why, fleet.active) == ("stopped", "Ann did", {})
    assert fleet.state().wave == (1 if hours else 0)


def test_a_wave_that_is_held_is_judged_on_and_stops_by_harm(database: DatabaseSettings) -> None:
    fleet = FleetInMemory(database, dearer={"tent": 0.1})
    fleet.run(hours=130.0, look_h=1.5)
    assert fleet.wave(1).state == "held"
    fleet.dearer = {"tent": 0.6}
    found = fleet.run(hours=200.0, look_h=1.5)
    assert (found.state, found.wave) == ("stopped", 1)
    assert "kind tent is dearer by" in found.why


def test_too_few_rigs_to_compare_hold_a_wave_until_a_person_lets_each_go_on(
    database: DatabaseSettings,
) -> None:
    fleet = FleetInMemory(database, count=3, kinds=("tent",))
    for wave in (1, 2):
        assert fleet.run(hours=125.0, look_h=1.5).wave == wave
        assert (fleet.wave(wave).state, len(fleet.active)) == ("held", wave)
        go_on_by_person(fleet.engine, 1, "few rigs", fleet.utc)
    found = fleet.run(hours=125.0, look_h=1.5)
    assert (found.state, len(fleet.active)) == ("done", 3)
    assert fleet.wave(3).why == "time is over: not shown to be within 10%: tent"


def test_rigs_that_are_away_are_left_out_and_named(database: DatabaseSettings) -> None:
    fleet = FleetInMemory(database, count=8, kinds=("tent",))
    with Session(fleet.engine) as session, session.begin():
        session.get_one(FleetRig, "tent-3").is_online = False
    found = fleet.run(hours=400.0, look_h=1.5)
    assert (found.state, found.why) == ("done", "all waves have passed; away and without it: tent-3")


def test_only_one_rollout_runs_and_a_person_may_stop_it(database: DatabaseSettings) -> None:
    fleet = FleetInMemory(database)
    fleet.run(hours=2.0)
    with pytest.raises(RequestError, match=r"rollout 1 of bundle 2\.0 runs"):
        begin(fleet.engine, SETTINGS, SHA256, "", fleet.utc)
    stop_by_person(fleet.engine, 1, "the tents smell", fleet.utc)
    with pytest.raises(RequestError, match="is stopped already"):
        stop_by_person(fleet.engine, 1, "again", fleet.utc)
    fleet.look()
    assert fleet.active == {}
    assert fleet.state().why == "the tents smell"


def test_a_rollout_without_an_address_or_rigs_is_refused(database: DatabaseSettings) -> None:
    fleet = FleetInMemory(database)
    stop_by_person(fleet.engine, 1, "", fleet.utc)
    with pytest.raises(RequestError, match=r"rollout\.address is empty"):
        begin(fleet.engine, type(SETTINGS)(), SHA256, "", fleet.utc)
    with pytest.raises(RequestError, match="no rig is in group north"):
        begin(fleet.engine, SETTINGS, SHA256, "north", fleet.utc)
    with pytest.raises(RequestError, match="no bundle of sha256 00"):
        begin(fleet.engine, SETTINGS, "00", "", fleet.utc)


def test_a_runner_whose_work_another_one_has_taken_writes_and_sends_nothing(
    database: DatabaseSettings,
) -> None:
    fleet = FleetInMemory(database)
    slow = fleet.runner()
    other = FleetLease(fleet.engine, "rollouts", lease_s=0.0)
    assert other.take() == ""  # as after a pause in which no beat came
    with pytest.raises(LeaseLost, match="rollouts: another process does it now"):
        slow.look(fleet.utc)
    assert (fleet.orders, fleet.state().wave) == ([], 0)
    RolloutRunner(fleet.engine, SETTINGS.address, fleet, fleet.costs, other.check).look(fleet.utc)
    assert fleet.state().wave == 1 and fleet.orders


def test_a_rig_of_which_nothing_was_heard_for_long_is_away_whatever_it_said_last(
    database: DatabaseSettings,
) -> None:
    fleet = FleetInMemory(database, count=6, kinds=("tent",))
    heard_of(fleet, range(6), fleet.utc - 601.0)
    fleet.look()
    assert (fleet.orders, fleet.state().wave) == ([], 0)  # nobody is heard: no wave passes without a rig
    heard_of(fleet, range(3), fleet.utc)
    fleet.look()
    assert fleet.state().wave == 1
    assert {rig for rig, _ in fleet.orders} <= {"tent-0", "tent-1", "tent-2"} and fleet.orders


def heard_of(fleet: FleetInMemory, numbers: Iterable[int], utc: float) -> None:
    with Session(fleet.engine) as session, session.begin():
        for number in numbers:
            session.get_one(FleetRig, f"tent-{number}").last_utc = utc
