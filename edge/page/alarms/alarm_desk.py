"""The desk of the alarms: one task looks, one for each channel sends what is due, one gives signs of life.

All of them are tasks of the page's loop, and whatever waits for disk or network does so in a thread. The book
in memory counts; it is saved with every change, and a disk that takes nothing keeps no alarm back.
"""

import asyncio
from collections.abc import Awaitable, Callable
from functools import partial
from pathlib import Path
from typing import Any

from edge.config.settings import Settings
from edge.core.errors import DataError, RequestError
from edge.page.access import Access
from edge.page.address import address
from edge.page.alarms import alarm_state, trial
from edge.page.alarms.alarm_book import AlarmBook, DueAlarms
from edge.page.alarms.alarm_message import alarm_json, message_of, trial_message
from edge.page.alarms.alarm_state import AlarmState, ChannelNote
from edge.page.alarms.alarm_watch import AlarmWatch, Clocks
from edge.page.alarms.channels import LIFE_SIGN, channels_of
from edge.page.alarms.life_sign import LifeSign
from edge.page.alarms.messenger import Messenger
from edge.page.alarms.sender import complain
from edge.page.answers import in_thread
from edge.page.rig_link import RigLink

PAUSE_S, LOOK_S = 1.0, 3.0  # between two looks: at least; and at most, where the rig has no news
DUE_S = 2.0  # between two looks of a channel at what is due, where the book has no news
UNSAVED = "alarms.unsaved"
Json = dict[str, Any]


class AlarmDesk:
    """The alarms of one page. Use `run` as a task; the other calls are for the page's loop, while it runs."""

    def __init__(
        self, settings: Settings, access: Access, rig: RigLink, clocks: Clocks | None = None
    ) -> None:
        self._all, self._settings = settings, settings.alarms
        self._access, self._rig = access, rig
        self._clocks = clocks or Clocks()
        self._saving, self._news = asyncio.Lock(), asyncio.Event()
        self._page_url = self._settings.page_url
        self._take(AlarmState())

    async def run(self) -> None:
        """Notice, remember and send alarms; never ends, unless nothing is configured."""
        if not self._settings.is_on:
            # Whoever configures a channel next year is not told of this year's alarms.
            await self._whole(lambda: in_thread(self._access.set_fact, alarm_state.FACT, None))
            return
        await self._whole(self._load)
        async with asyncio.TaskGroup() as group:
            group.create_task(self._again(self._look, PAUSE_S))
            for messenger in self._messengers.values():
                group.create_task(self._again(partial(self._send_due, messenger), 0.0))
            if self._life_sign is not None:
                group.create_task(self._again(self._give_sign, 0.0))

    def json(self) -> Json:
        """Return channels, the sign of life (null for none) and the alarms that are open."""
        waiting = {name: len(self._due(name)) for name in self._messengers}
        return {
            "channels": [one.json(waiting[name]) for name, one in self._messengers.items()],
            "life_sign": self._life_sign and self._life_sign.json(),
            "alarms": [alarm_json(alarm) for alarm in self._book.open_causes().values()],
        }

    async def acknowledge(self, number: int, name: str) -> None:
        """Note who has seen an alarm, and its events in the history. Errors: RequestError, DataError"""
        alarm = self._book.acknowledge(number, name)
        if alarm is None:
            raise RequestError(f"there is no alarm {number}")
        await self._save()
        for place in alarm.places:
            await in_thread(self._access.acknowledge, place.seq, place.number, name)

    async def test(self, name: str) -> str:
        """Try a channel now; return why it failed, "" where it worked. Errors: RequestError"""
        if name == LIFE_SIGN and self._life_sign is not None:
            reason = await self._life_sign.give()
        elif (messenger := self._messengers.get(name)) is not None:
            message = trial_message(self._all.mqtt.rig, self._page_url, self._clocks.utc())
            arrived = await messenger.send(message)
            reason = "" if arrived else messenger.note.reason
        else:
            raise RequestError(f"{name!r} is not configured: see alarms in edge.yaml")
        self._tell()
        await self._save()
        return reason

    def _take(self, state: AlarmState) -> None:
        """Go on where the page's last run has ended."""
        self._saved, self._book = state, AlarmBook(state.alarms)
        self._watch = AlarmWatch(
            self._settings,
            Path(self._all.history.path),
            self._access,
            self._rig,
            self._book,
            state.place,
            self._clocks,
        )
        utc, now, notes = self._clocks.utc, self._clocks.now, state.notes
        self._messengers = {
            each.name: Messenger(each, notes.get(each.name, ChannelNote()), utc, now)
            for each in channels_of(self._settings)
        }
        note, own = notes.get(LIFE_SIGN, ChannelNote()), self._settings.life_sign
        self._life_sign = LifeSign(own, note, self._watch.problem, utc, now) if own.is_set else None

    async def _load(self) -> None:
        self._page_url = self._page_url or address(
            self._all, bool(self._all.page.host) or await in_thread(lambda: self._access.is_open_to_network)
        )
        self._take(await in_thread(alarm_state.load, self._access))

    async def _whole(self, call: Callable[[], Awaitable[Any]]) -> None:
        """Do something that may fail without harm: what follows begins without it."""
        try:
            await call()
        except DataError as error:
            complain(error)

    async def _again(self, call: Callable[[], Awaitable[Any]], pause_s: float) -> None:
        """Call again and again. A mistake in one call ends neither this task nor another one."""
        while True:
            try:
                await call()
            except Exception as error:
                complain(error)
                await asyncio.sleep(LOOK_S)
            await asyncio.sleep(pause_s)

    async def _look(self) -> None:
        await self._rig.next_news(LOOK_S - PAUSE_S)
        await self._watch.look()
        self._book.forget_old(self._messengers, self._clocks.utc())
        self._tell()
        await self._save()
        await self._serve_trial()

    async def _serve_trial(self) -> None:
        """Do the test that the command line asks for."""
        name = await in_thread(trial.take, self._access, self._clocks.utc())
        if name is not None:
            channels = [*self._messengers, *([LIFE_SIGN] if self._life_sign else [])]
            reasons = await asyncio.gather(*map(self.test, channels))
            answer = dict(zip(channels, reasons, strict=True))
            await in_thread(trial.answer, self._access, name, answer)

    async def _send_due(self, messenger: Messenger) -> None:
        """Send one message, if something is due and the channel may; else wait for news."""
        due = self._due(messenger.channel.name)
        if not due or messenger.wait_s > 0.0:
            await self._next_news()
            return
        utc = self._clocks.utc()
        message = message_of(due, self._all.mqtt.rig, self._page_url, utc, self._settings.repeat_min > 0.0)
        if await messenger.send_alarms(message):
            self._book.note_delivery(messenger.channel.name, due, utc)
        await self._save()

    def _due(self, name: str) -> DueAlarms:
        return self._book.due(name, self._clocks.utc(), 60.0 * self._settings.repeat_min)

    async def _give_sign(self) -> None:
        assert self._life_sign is not None
        await self._life_sign.give_if_due()
        await asyncio.sleep(DUE_S)

    async def _save(self) -> None:
        """Save what has changed. A file that takes nothing is an alarm, and no reason to end."""
        async with self._saving:
            state = self._state()
            if _gist(state) == _gist(self._saved):
                return
            try:
                await in_thread(alarm_state.save, self._access, state)
            except DataError as error:
                text = f"the page cannot save its alarms, so a restart repeats them: {error}"
                self._book.begin(UNSAVED, text, self._clocks.utc())
                return
            self._saved = state
            self._book.end(UNSAVED, self._clocks.utc())

    def _state(self) -> AlarmState:
        notes = {name: one.note for name, one in self._messengers.items()}
        if self._life_sign is not None:
            notes[LIFE_SIGN] = self._life_sign.note
        return AlarmState(self._watch.place, tuple(self._book.alarms.values()), notes)

    def _tell(self) -> None:
        self._news.set()
        self._news = asyncio.Event()

    async def _next_news(self) -> None:
        news = self._news
        try:
            async with asyncio.timeout(DUE_S):
                await news.wait()
        except TimeoutError:
            return


def _gist(state: AlarmState) -> tuple[object, ...]:
    """Return what is worth a write: each sign of life and each failed try would wear a card out."""
    notes = {
        name: (note.reason, note.sent_utc if name != LIFE_SIGN else 0) for name, note in state.notes.items()
    }
    return state.alarms, notes
