"""The desk against real servers, with a view and clocks set by hand: once, again, restarts, storms."""

import asyncio
import contextlib
import json
import sqlite3
import threading
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest
from alarm_servers import HttpSink, http_sink, mail_sink, silent_server
from history_records import START_UTC, HandClock, store, tick
from page_process import view

from edge.config.loading import parse
from edge.core.errors import RequestError
from edge.core.messages import Event, Severity
from edge.page.access import Access
from edge.page.alarms import alarm_desk, sender, trial
from edge.page.alarms.alarm_desk import AlarmDesk
from edge.page.alarms.alarm_watch import UNREAD_S, Clocks
from edge.page.alarms.channels import LIFE_SIGN
from edge.page.alarms.exchange import SendError
from edge.page.alarms.messenger import AGAIN_MAX_S, MESSAGES_MAX, MESSAGES_S
from edge.page.rig_link import RigLink
from tests.support.broker import PATIENCE_S, free_port

REPEAT_S = 1800.0
STOPPED: Any = {"operation": {"emergency_stop": True}}


class FakeRig(RigLink):
    """A rig whose view is set by hand."""

    def __init__(self) -> None:
        self.now: dict[str, Any] = view()
        self.looks = 0

    def view(self) -> dict[str, Any]:
        return self.now

    async def next_news(self, at_most_s: float) -> None:
        self.looks += 1
        await asyncio.sleep(0.01)


class DeskRig:
    """A page's folder, a rig and clocks; `desk()` begins a page of it anew, as a restart does."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.rig, self.clock = folder, FakeRig(), HandClock()
        self.access = Access(folder / "page" / "page.db", self.clock.utc)
        self.history = folder / "history.db"
        store(self.history, tick(1))

    def desk(self, **alarms: Any) -> AlarmDesk:
        sections = {
            "history": {"path": str(self.history)},
            "page": {"folder": str(self.folder / "page"), "names": ["rig.example.org"]},
            "mqtt": {"rig": "rig-1"},
            "alarms": alarms,
        }
        clocks = Clocks(self.clock.utc, self.clock.now)
        return AlarmDesk(parse(json.dumps(sections)), self.access, self.rig, clocks)

    def pass_s(self, seconds: float) -> None:
        self.clock.time_s += seconds
        self.clock.wall += seconds
        if self.rig.now["reached"] and (now := self.rig.now["status"]["tick"]):
            now["seq"] += 1

    def event(self, seq: int, key: str, text: str) -> None:
        """Have the daemon write an alarm of tick `seq` into the history."""
        happened = Event(key, Severity.ALARM, text, 0.0, self.clock.wall)
        store(self.history, tick(seq, events=(happened,)))


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> DeskRig:
    for name in ("PAUSE_S", "LOOK_S", "DUE_S"):
        monkeypatch.setattr(alarm_desk, name, 0.02)
    return DeskRig(tmp_path)


@contextlib.asynccontextmanager
async def running(desk: AlarmDesk) -> AsyncIterator[AlarmDesk]:
    task = asyncio.create_task(desk.run())
    try:
        yield desk
        assert not task.done(), task.exception()
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


async def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, "never happened"
        await asyncio.sleep(0.01)


async def looks(desk: AlarmDesk, count: int = 3) -> None:
    """Wait for so many whole looks, and for what is due after them."""
    rig: Any = desk._rig
    before = rig.looks
    await until(lambda: rig.looks > before + count)
    await asyncio.sleep(0.1)


def titles(sink: HttpSink) -> list[str]:
    return [one.headers["Title"] for one in sink.heard if one.method == "POST"]


def named(sink: HttpSink) -> list[dict[str, Any]]:
    """Return all alarms that a webhook has heard of."""
    return [alarm for one in sink.heard for alarm in one.json()["alarms"]]


def test_once_repeated_acknowledged_and_over(rig: DeskRig) -> None:
    async def scene() -> None:
        async with running(rig.desk(ntfy={"url": f"{sink.url}/t"})) as desk:
            await looks(desk)
            assert titles(sink) == []
            rig.rig.now = view(**STOPPED)
            await until(lambda: len(titles(sink)) == 1)
            await looks(desk)
            assert len(titles(sink)) == 1
            rig.pass_s(REPEAT_S)
            await until(lambda: len(titles(sink)) == 2)
            (alarm,) = desk.json()["alarms"]
            await desk.acknowledge(alarm["id"], "Ann")
            rig.pass_s(5 * REPEAT_S)
            await looks(desk)
            assert len(titles(sink)) == 2
            rig.rig.now = view()
            await until(lambda: len(titles(sink)) == 3)
            assert "over" in titles(sink)[-1]
            assert desk.json()["alarms"] == []
            with pytest.raises(RequestError):
                await desk.acknowledge(99, "Ann")

    with http_sink() as sink:
        asyncio.run(scene())
        assert "http://rig.example.org:8420/" in sink.texts()[0]


def test_an_alarm_of_the_history_is_told_until_it_is_acknowledged_in_its_list(
    rig: DeskRig,
) -> None:
    async def scene() -> None:
        async with running(rig.desk(ntfy={"url": f"{sink.url}/t"})) as desk:
            await looks(desk)
            rig.event(2, "history.ticks_lost", "ticks 5 to 9 are not in the history")
            await until(lambda: len(titles(sink)) == 1)
            rig.access.acknowledge(2, 0, "Ann")
            await until(lambda: desk.json()["alarms"] == [])
            rig.pass_s(3 * REPEAT_S)
            await looks(desk)
            rig.event(3, "history.ticks_lost", "ticks 20 to 30 are not in the history")
            await until(lambda: len(titles(sink)) == 2)
            (alarm,) = desk.json()["alarms"]
            await desk.acknowledge(alarm["id"], "Bo")
            assert rig.access.who_acknowledged(0) == {(2, 0): "Ann", (3, 0): "Bo"}

    with http_sink() as sink:
        asyncio.run(scene())
    assert "ticks 5 to 9" in sink.texts()[0]


def test_what_was_acknowledged_in_another_history_is_not_seen(rig: DeskRig) -> None:
    async def scene() -> None:
        rig.access.acknowledge(2, 0, "Ann")  # of a history that has been deleted since
        rig.pass_s(60.0)
        async with running(rig.desk(ntfy={"url": f"{sink.url}/t"})) as desk:
            await looks(desk)
            rig.event(2, "history.ticks_lost", "ticks 5 to 9")
            await until(lambda: len(titles(sink)) == 1)

    with http_sink() as sink:
        asyncio.run(scene())


def test_past_alarms_are_not_told_when_the_page_runs_for_the_first_time(rig: DeskRig) -> None:
    async def scene() -> None:
        rig.event(2, "history.ticks_lost", "long ago")
        async with running(rig.desk(ntfy={"url": f"{sink.url}/t"})) as desk:
            await looks(desk)
            assert titles(sink) == []
            rig.event(3, "history.ticks_lost", "now")
            await until(lambda: len(titles(sink)) == 1)

    with http_sink() as sink:
        asyncio.run(scene())


def test_a_restart_neither_repeats_nor_forgets(rig: DeskRig) -> None:
    alarms: dict[str, Any] = {}

    async def before() -> None:
        async with running(rig.desk(**alarms)) as desk:
            await looks(desk)
            rig.rig.now = view(**STOPPED)
            await until(lambda: len(titles(sink)) == 1)
            await until(lambda: "emergency_stop" in (rig.access.fact("alarms") or ""))
            await looks(desk)

    async def after() -> None:
        rig.event(2, "history.ticks_lost", "while no page ran")
        rig.rig.now = view(reached=False, silent_s=None)  # nothing is known yet
        async with running(rig.desk(**alarms)) as desk:
            await until(lambda: len(titles(sink)) == 2)
            assert "while no page ran" in sink.texts()[-1]
            assert "emergency" not in sink.texts()[-1]
            rig.rig.now = view(**STOPPED)
            await looks(desk)
            assert len(titles(sink)) == 2
            assert desk.json()["channels"][0]["sent_utc"] == rig.clock.wall
            rig.pass_s(REPEAT_S)
            await until(lambda: len(titles(sink)) == 3)
            assert "emergency stop" in sink.texts()[-1]

    with http_sink() as sink:
        alarms = {"ntfy": {"url": f"{sink.url}/t"}}
        asyncio.run(before())
        asyncio.run(after())


def test_without_a_network_nothing_is_lost_and_said_once_it_is_back(rig: DeskRig) -> None:
    port = free_port()

    async def scene() -> None:
        async with running(rig.desk(ntfy={"url": f"http://127.0.0.1:{port}/t"})) as desk:
            await looks(desk)
            rig.rig.now = view(**STOPPED)
            await until(lambda: "Connection refused" in desk.json()["channels"][0]["reason"])
            rig.rig.now = view()
            rig.event(2, "history.ticks_lost", "ticks 5 to 9")
            await until(lambda: desk.json()["channels"][0]["waiting"] == 2)
            tries = []
            for _ in range(8):  # pauses grow, to their limit
                await until(lambda: desk.json()["channels"][0]["wait_s"] > 0.0)
                tries.append(desk.json()["channels"][0]["wait_s"])
                rig.pass_s(tries[-1] + 0.1)
                failed_utc = round(rig.clock.wall, 3)
                await until(lambda utc=failed_utc: desk.json()["channels"][0]["failed_utc"] == utc)
            assert tries == sorted(tries)
            assert tries[-1] == AGAIN_MAX_S
            with http_sink(port) as sink:
                rig.pass_s(AGAIN_MAX_S)
                await until(lambda: sink.heard)
                await looks(desk)
                (text,) = sink.texts()
                assert "ticks 5 to 9" in text
                assert "Over since" in text
                assert "emergency stop" in text
                assert desk.json()["channels"][0]["waiting"] == 0

    asyncio.run(scene())


def test_a_test_that_works_ends_the_waiting(rig: DeskRig) -> None:
    port = free_port()

    async def scene() -> None:
        async with running(rig.desk(ntfy={"url": f"http://127.0.0.1:{port}/t"})) as desk:
            await looks(desk)
            rig.rig.now = view(**STOPPED)
            await until(lambda: desk.json()["channels"][0]["wait_s"] > 0.0)
            assert "Connection refused" in await desk.test("ntfy")
            with http_sink(port) as sink:
                assert await desk.test("ntfy") == ""
                await until(lambda: len(titles(sink)) == 2)
            with pytest.raises(RequestError):
                await desk.test("mail")

    asyncio.run(scene())


@pytest.mark.slow
def test_a_storm_of_alarms_is_few_messages_that_name_them_all(rig: DeskRig) -> None:
    async def scene() -> None:
        async with running(rig.desk(webhook={"url": f"{sink.url}/t"})) as desk:
            await looks(desk)
            for seq in range(2, 42):
                rig.event(seq, f"kind.{seq}", f"trouble {seq}")
                await looks(desk, 1)
            assert len(sink.heard) == MESSAGES_MAX
            rig.pass_s(MESSAGES_S)
            await until(lambda: len(sink.heard) == MESSAGES_MAX + 1)

    with http_sink() as sink:
        asyncio.run(scene())
    assert sorted(alarm["cause"] for alarm in named(sink)) == sorted(f"kind.{seq}" for seq in range(2, 42))


@pytest.mark.slow
def test_a_channel_that_hangs_keeps_neither_the_page_nor_another_channel(rig: DeskRig, monkeypatch) -> None:
    monkeypatch.setattr(sender, "EXCHANGE_MAX_S", 0.5)

    async def scene() -> None:
        alarms = {"ntfy": {"url": f"http://127.0.0.1:{port}/t"}, "webhook": {"url": f"{sink.url}/t"}}
        async with running(rig.desk(**alarms)) as desk:
            await looks(desk)
            rig.rig.now = view(**STOPPED)
            await until(lambda: len(sink.heard) == 1)
            await until(lambda: "did not end within 0.5 s" in desk.json()["channels"][0]["reason"])
            assert desk.json()["channels"][0]["waiting"] == 1
            await asyncio.sleep(0.1)  # its thread has ended: the next try is an exchange, not a refusal
            assert "did not end within" in await desk.test("ntfy")

    with silent_server() as port, http_sink() as sink:
        asyncio.run(scene())


def test_a_second_exchange_does_not_wait_behind_a_thread_that_never_ends() -> None:
    async def scene() -> None:
        one = sender.Sender()
        started, release = asyncio.Event(), threading.Event()
        loop = asyncio.get_running_loop()

        def hang(cut: Any) -> None:
            loop.call_soon_threadsafe(started.set)
            release.wait(PATIENCE_S)

        first = asyncio.create_task(one.run(hang))
        await started.wait()
        first.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await first
        with pytest.raises(SendError, match="hangs still"):
            await one.run(lambda cut: None)
        release.set()

    asyncio.run(scene())


def test_a_disk_that_takes_nothing_keeps_no_alarm_back_and_is_an_alarm_itself(rig: DeskRig) -> None:
    async def scene() -> None:
        async with running(rig.desk(webhook={"url": f"{sink.url}/t"})) as desk:
            await looks(desk)
            with contextlib.closing(sqlite3.connect(rig.access.path)) as db:
                db.execute(
                    "CREATE TRIGGER full BEFORE INSERT ON facts BEGIN SELECT raise(FAIL, 'disk is full'); END"
                )
            rig.rig.now = view(**STOPPED)
            await until(
                lambda: {alarm["cause"] for one in sink.heard for alarm in one.json()["alarms"]} >= causes
            )
            with contextlib.closing(sqlite3.connect(rig.access.path)) as db:
                db.execute("DROP TRIGGER full")
            await until(lambda: [alarm["cause"] for alarm in desk.json()["alarms"]] == ["emergency_stop"])

    causes = {"emergency_stop", "alarms.unsaved"}
    with http_sink() as sink:
        asyncio.run(scene())


def test_a_history_that_cannot_be_read_is_an_alarm(rig: DeskRig) -> None:
    async def scene() -> None:
        async with running(rig.desk(ntfy={"url": f"{sink.url}/t"})) as desk:
            await looks(desk)
            rig.history.rename(rig.history.with_name("away"))
            for suffix in ("-wal", "-shm"):
                rig.history.with_name(f"history.db{suffix}").unlink(missing_ok=True)
            await looks(desk)
            rig.pass_s(UNREAD_S + 1.0)
            await until(lambda: len(titles(sink)) == 1)
            assert "cannot read the history" in sink.texts()[0]
            rig.history.with_name("away").rename(rig.history)
            await until(lambda: len(titles(sink)) == 2)

    with http_sink() as sink:
        asyncio.run(scene())


def test_a_state_that_cannot_be_read_begins_anew(rig: DeskRig) -> None:
    async def scene() -> None:
        rig.access.set_fact("alarms", '{"alarms": 7}')
        async with running(rig.desk(ntfy={"url": f"{sink.url}/t"})) as desk:
            rig.rig.now = view(**STOPPED)
            await until(lambda: len(titles(sink)) == 1)
            await until(lambda: "emergency_stop" in (rig.access.fact("alarms") or ""))
            assert desk.json()["alarms"]

    with http_sink() as sink:
        asyncio.run(scene())


# the sign of life


@pytest.mark.slow
def test_signs_of_life_end_with_the_daemon_its_ticks_or_the_looks(rig: DeskRig) -> None:
    async def scene() -> None:
        async with running(rig.desk(life_sign={"url": f"{sink.url}/ping", "every_s": 60})) as desk:
            await until(lambda: len(sink.heard) == 1)
            await looks(desk)
            assert len(sink.heard) == 1
            rig.pass_s(61.0)
            await until(lambda: len(sink.heard) == 2)
            rig.rig.now = view(reached=False, silent_s=5.0)
            rig.pass_s(61.0)
            await looks(desk)
            assert len(sink.heard) == 2
            assert "does not answer" in desk.json()["life_sign"]["withheld"]
            assert "withheld" in await desk.test(LIFE_SIGN)  # no false sign by a test, either
            rig.rig.now = view()
            await until(lambda: len(sink.heard) == 3)
            await looks(desk)  # that tick is seen before the time that passes without another
            rig.clock.time_s += 200.0  # it answers, but its last tick stays the same
            await looks(desk)
            heard = len(sink.heard)  # a look that was under way may have given one more
            assert "no ticks" in desk.json()["life_sign"]["withheld"]
            rig.clock.time_s += 100.0
            await looks(desk)
            assert len(sink.heard) == heard
            rig.pass_s(1.0)
            await until(lambda: len(sink.heard) == heard + 1)

    with http_sink() as sink:
        asyncio.run(scene())


def test_a_sign_that_does_not_arrive_is_tried_again_soon_and_named(rig: DeskRig) -> None:
    async def scene() -> None:
        async with running(rig.desk(life_sign={"url": f"{sink.url}/t0ps3cret"})) as desk:
            await until(
                lambda: desk.json()["life_sign"]["reason"] == "127.0.0.1 answers 503 Service Unavailable"
            )
            sink.status = 200
            rig.pass_s(11.0)
            await until(lambda: len(sink.heard) == 2)
            await until(lambda: desk.json()["life_sign"]["sent_utc"])
            assert "t0ps3cret" not in json.dumps(desk.json())

    with http_sink() as sink:
        sink.status = 503
        asyncio.run(scene())


# the command line's test


def test_the_running_page_tests_every_channel_for_the_command_line(rig: DeskRig) -> None:
    async def scene() -> None:
        mail_settings = {"host": "127.0.0.1", "port": mail.port, "tls": "none", "sender": "a@example.org"}
        alarms = {
            "ntfy": {"url": f"{sink.url}/t"},
            "mail": {**mail_settings, "to": ["b@example.org"]},
            "webhook": {"url": f"http://127.0.0.1:{free_port()}/t"},
            "life_sign": {"url": f"{sink.url}/ping"},
        }
        async with running(rig.desk(**alarms)) as desk:
            await looks(desk)
            name = trial.ask(rig.access, rig.clock.wall)
            await until(lambda: trial.answer_of(rig.access, name) is not None)
            reasons = dict(trial.answer_of(rig.access, name) or {})
            assert "Connection refused" in reasons.pop("webhook")
            assert reasons == {"ntfy": "", "mail": "", LIFE_SIGN: ""}
            assert len(mail.mails) == 1
            assert trial.answer_of(rig.access, "another") is None

    with http_sink() as sink, mail_sink() as mail:
        asyncio.run(scene())
    assert any("a test" in title for title in titles(sink))


def test_a_test_that_was_asked_for_long_ago_is_not_done(rig: DeskRig) -> None:
    async def scene() -> None:
        trial.ask(rig.access, START_UTC - 3600.0)
        async with running(rig.desk(ntfy={"url": f"{sink.url}/t"})) as desk:
            await looks(desk)
            assert rig.access.fact(trial.ASKED) is None

    with http_sink() as sink:
        asyncio.run(scene())
    assert sink.heard == []


def test_without_a_channel_the_desk_ends_and_forgets(rig: DeskRig) -> None:
    rig.access.set_fact("alarms", "{}")
    desk = rig.desk()
    asyncio.run(desk.run())
    assert rig.access.fact("alarms") is None
    assert desk.json() == {"channels": [], "life_sign": None, "alarms": []}
