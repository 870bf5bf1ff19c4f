"""The alarms that are known, and what each channel still has to say of them; values alone, handed the time.

One cause is one alarm as long as it lasts. That, and a limit of new alarms an hour for each cause, keeps a
loose contact from filling the night with messages.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace

OFTEN, OFTEN_S = 3, 3600.0  # new alarms of a cause in that time; a further one is a return of the last
GAP_S = 1800.0  # between two messages of an alarm that returns, where nothing is repeated
ALARMS_MAX = 200  # that are remembered: days without a network
PLACES_MAX = 50  # events of one alarm by which it can be acknowledged
EARLY_S, LATE_S = 60.0, 5.0  # of an event before and after an alarm that the page itself has noticed
DROPPED = "alarms.dropped"


@dataclass(frozen=True, slots=True)
class EventPlace:
    """An event of the history: event `number` of tick `seq`."""

    seq: int
    number: int


@dataclass(frozen=True, slots=True)
class Delivery:
    """The newest message of one channel about an alarm. over : it said that the alarm is over"""

    utc: float
    times: int
    over: bool = False


@dataclass(frozen=True, slots=True)
class RigAlarm:
    """One alarm. All times in seconds since 1970.

    cause : equal for alarms of the same kind, e.g. "board.silent" or the key of an event
    lasts : its end can be seen; without, it is closed when a person has acknowledged it
    times : how often its cause has come
    """

    id: int
    cause: str
    text: str
    begun_utc: float
    last_utc: float
    lasts: bool = True
    times: int = 1
    over_utc: float | None = None
    seen_by: str = ""
    places: tuple[EventPlace, ...] = ()
    deliveries: Mapping[str, Delivery] = field(default_factory=dict)

    @property
    def is_open(self) -> bool:
        """It goes on, or waits for somebody who acknowledges it."""
        return self.over_utc is None and (self.lasts or not self.seen_by)


@dataclass(frozen=True, slots=True)
class DueAlarms:
    """Alarms that a channel has to name now: new ones, repeated ones, and those that are over."""

    new: tuple[RigAlarm, ...] = ()
    still: tuple[RigAlarm, ...] = ()
    over: tuple[RigAlarm, ...] = ()

    def __len__(self) -> int:
        return len(self.new) + len(self.still) + len(self.over)


class AlarmBook:
    """All alarms by their number, the oldest first."""

    def __init__(self, alarms: Iterable[RigAlarm] = ()) -> None:
        self.alarms = {alarm.id: alarm for alarm in alarms}

    def begin(
        self, cause: str, text: str, utc: float, place: EventPlace | None = None, lasts: bool = True
    ) -> None:
        """Take an alarm that begins at `utc`, or has begun already. place : its event in the history"""
        known = self._newest(cause)
        places = () if place is None else (place,)
        if known is not None and (known.is_open or (place is not None and _belongs(utc, known))):
            if place is not None or not lasts:
                all_places = (*known.places, *places)[-PLACES_MAX:]
                times, last_utc = known.times + (not lasts), max(utc, known.last_utc)
                self._keep(replace(known, places=all_places, times=times, last_utc=last_utc))
            return
        recent = [one for one in self.alarms.values() if one.cause == cause and utc - one.begun_utc < OFTEN_S]
        if known is not None and len(recent) >= OFTEN:
            back = replace(known, over_utc=None, seen_by="", times=known.times + 1)
            self._keep(replace(back, text=text, last_utc=utc, places=places))
            return
        number = 1 + max(self.alarms, default=0)
        self._keep(RigAlarm(number, cause, text, utc, utc, lasts, places=places))
        if len(self.alarms) > ALARMS_MAX:
            self._drop(utc)

    def end(self, cause: str, utc: float) -> None:
        """Note that a cause does not hold any more."""
        known = self._newest(cause)
        if known is not None and known.is_open:
            self._keep(replace(known, over_utc=max(utc, known.begun_utc)))

    def open_causes(self) -> dict[str, RigAlarm]:
        """Return the alarms that are open, by their cause."""
        return {alarm.cause: alarm for alarm in self.alarms.values() if alarm.is_open}

    def acknowledge(self, number: int, name: str) -> RigAlarm | None:
        """Note who has seen an alarm; the first one stays. Returns it, None where there is none"""
        alarm = self.alarms.get(number)
        if alarm is not None and not alarm.seen_by:
            self._keep(replace(alarm, seen_by=name))
        return alarm

    def note_seen(self, names: Mapping[tuple[int, int], str]) -> None:
        """Note alarms that were acknowledged as events. names : by tick and number of the event"""
        for alarm in list(self.alarms.values()):
            found = [names[place.seq, place.number] for place in alarm.places if _key(place) in names]
            if found and not alarm.seen_by:
                self._keep(replace(alarm, seen_by=found[0]))

    def due(self, channel: str, utc: float, repeat_s: float) -> DueAlarms:
        """Return what a channel has to say. repeat_s : 0 for once"""
        new, still, over = [], [], []
        for alarm in self.alarms.values():
            said = alarm.deliveries.get(channel)
            if said is None and alarm.seen_by:
                continue  # somebody knows it already
            if alarm.over_utc is not None:
                if said is None or not said.over:
                    over.append(alarm)
            elif said is None:
                new.append(alarm)
            elif not alarm.seen_by and _is_due_again(alarm, said, utc, repeat_s):
                still.append(alarm)
        return DueAlarms(tuple(new), tuple(still), tuple(over))

    def note_delivery(self, channel: str, named: DueAlarms, utc: float) -> None:
        """Note that a channel has said this."""
        for alarm in (*named.new, *named.still, *named.over):
            if (now := self.alarms.get(alarm.id)) is not None:
                said = Delivery(utc, alarm.times, over=alarm.over_utc is not None)
                self._keep(replace(now, deliveries={**now.deliveries, channel: said}))

    def forget_old(self, channels: Collection[str], utc: float) -> None:
        """Remove alarms that are over, said by each channel, and no longer count as often."""
        for alarm in list(self.alarms.values()):
            is_old = not 0.0 <= utc - alarm.begun_utc < OFTEN_S
            waits = any(_waits(alarm, channel) for channel in channels)
            if is_old and not alarm.is_open and not waits:
                del self.alarms[alarm.id]

    def _drop(self, utc: float) -> None:
        """Remove the oldest alarm, a closed one if there is one, and say so by an alarm."""
        kept_back = [one for one in self.alarms.values() if one.cause != DROPPED]
        oldest = min(kept_back, key=lambda one: (one.is_open, one.begun_utc))
        del self.alarms[oldest.id]
        text = f"over {ALARMS_MAX} alarms waited for a message; the oldest were dropped, see the history"
        self.begin(DROPPED, text, utc, lasts=False)

    def _newest(self, cause: str) -> RigAlarm | None:
        return max(
            (one for one in self.alarms.values() if one.cause == cause), key=lambda one: one.id, default=None
        )

    def _keep(self, alarm: RigAlarm) -> None:
        self.alarms[alarm.id] = alarm


def _belongs(utc: float, alarm: RigAlarm) -> bool:
    """Return whether an event is the history's word for an alarm that the page has noticed and that ended."""
    return alarm.over_utc is not None and alarm.begun_utc - EARLY_S <= utc <= alarm.over_utc + LATE_S


def _is_due_again(alarm: RigAlarm, said: Delivery, utc: float, repeat_s: float) -> bool:
    """Return whether an open alarm that nobody has seen is to be said once more."""
    returned = said.over or alarm.times > said.times
    if not repeat_s and not returned:
        return False
    return not 0.0 <= utc - said.utc < (repeat_s or GAP_S)  # a clock that was set back counts as passed


def _waits(alarm: RigAlarm, channel: str) -> bool:
    said = alarm.deliveries.get(channel)
    if said is None:
        return not alarm.seen_by
    return alarm.over_utc is not None and not said.over


def _key(place: EventPlace) -> tuple[int, int]:
    return place.seq, place.number
