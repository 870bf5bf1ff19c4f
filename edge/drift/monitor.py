"""The running twin watched: its filter, the sequential test, its memory, and the report of drift."""

import math
from dataclasses import dataclass, field, replace
from datetime import datetime, tzinfo

import numpy as np

from edge.core.errors import DataError
from edge.core.messages import Drift, DriftState, Event, Severity
from edge.core.predictor import Columns, Floats
from edge.drift import evidence, noise, where
from edge.drift.evidence import CLEAR, Evidence
from edge.drift.kalman import DriftFilterState, Filter, Innovation
from edge.drift.regimes import CELLS, REGIMES, WORDS, situation
from edge.twin.model import BoxTwin


@dataclass(frozen=True, slots=True, eq=False)
class DriftMemory:
    """About one twin.

    twin_sha256 : the twin's; what is known of one says nothing of another
    sums : what was learnt of its ordinary errors, see edge/drift/noise.py
    table : errors by regime, see edge/drift/where.py
    since_utc : since when it disagrees, NaN while it agrees
    agreeing_s : time without evidence, while it disagrees
    """

    twin_sha256: str
    evidence: Evidence
    sums: Floats = field(default_factory=noise.nothing_learnt)
    table: Floats = field(default_factory=where.empty)
    since_utc: float = math.nan
    agreeing_s: float = 0.0

    @property
    def disagrees(self) -> bool:
        """True while the alarm stands."""
        return math.isfinite(self.since_utc)


def in_words(drift: Drift, zone: tzinfo | None) -> str:
    """Return `the twin disagrees since ..., mostly with the fan on: ...`;
    in `zone`, None: the machine's own.
    """
    if drift.state is DriftState.DISAGREES and drift.since_utc is not None:
        since = datetime.fromtimestamp(drift.since_utc, zone)
        sign = "warmer" if drift.error_k > 0.0 else "colder"
        return (
            f"the twin disagrees since {since:%Y-%m-%d %H:%M}, mostly {WORDS[drift.where]}: "
            f"there the air ends each step {abs(drift.error_k):.2f} K {sign} than it expects"
        )
    if drift.state is DriftState.UNKNOWN:
        return f"the twin is not judged: {drift.reason}"
    learning = f" ({drift.learnt:.0%} of its ordinary errors learnt)" if drift.learnt < 1.0 else ""
    return f"the twin agrees{learning}"


SETTLE_S = 3600.0  # a filter that began at rest is not judged so long: walls and element are not known
AGREE_S = 3600.0  # time in which it is judged and no evidence is left, before agreement is told
CAUTIOUS_AGREE = 24.0  # times longer where the cell is not learnt: there small disagreement is not seen


@dataclass(frozen=True, slots=True)
class Promise:
    """The false-alarm rate and delay that the test promises.

    step_s : time between ticks [s]
    false_alarm_days : mean time to a false alarm is at least this
    learn_h : time in each cell from which the twin's ordinary errors are learnt
    """

    step_s: float
    false_alarm_days: float = 90.0
    learn_h: float = 24.0


class DriftMonitor:
    """One twin at a time; another one begins anew.

    zone : of the times that are told; None is the machine's own
    memory : of the process before
    """

    def __init__(
        self, promise: Promise, zone: tzinfo | None = None, memory: DriftMemory | None = None
    ) -> None:
        self._promise, self._zone = promise, zone
        self._threshold = evidence.log_threshold(promise.false_alarm_days, promise.step_s)
        self._learn_ticks = max(1, round(promise.learn_h * 3600.0 / promise.step_s))
        self.memory = memory
        self._events: list[Event] = []
        self._off = ""
        self._confirmed = False
        self._filter: Filter | None = None
        self._state: DriftFilterState | None = None
        self._past: noise.InnovationPast | None = None

    def tick(self, twin: BoxTwin | None, history: Columns, confirmed: bool, hands_in: bool = False) -> Drift:
        """How the twin does at the newest row; never raises.

        history : as `Estimator.history()` after `record_sent`
        confirmed : the board said that it drives what the newest row says
        hands_in : maintenance, the door may be open
        """
        known, self._confirmed = self._confirmed, confirmed
        unjudged = "maintenance" if hands_in else "" if known else "the board did not confirm the inputs"
        if self._off:
            return self._unwatched_drift(self._off)
        if not len(history["time_s"]):
            return self._present("no air temperature yet")
        now, utc = float(history["time_s"][-1]), float(history["utc"][-1])
        try:
            return self._observe(twin, history, utc, unjudged)
        except DataError as error:
            self.begin_anew()
            return self._present(str(error))
        except Exception as bug:  # control goes on; the same bug at every tick would fill the history
            self._off = f"internal error: {bug!r}"
            self._events.append(Event("drift.failed", Severity.WARNING, self._off, now, utc))
            return self._unwatched_drift(self._off)

    def begin_anew(self) -> None:
        """Let the filter settle again, as after a start. Evidence and what was learnt stay."""
        self._filter = self._state = self._past = None

    def take_events(self) -> list[Event]:
        """Return the beginnings and ends of alarms since the last call."""
        events, self._events = self._events, []
        return events

    def _observe(self, twin: BoxTwin | None, history: Columns, utc: float, unjudged: str) -> Drift:
        if twin is None:
            self.begin_anew()
            return self._unwatched_drift("no twin runs")
        if self._filter is None or self._filter.twin is not twin:
            self._begin(twin, utc)
        assert self._filter is not None
        if self._state is None:
            self._state = self._filter.begin(history)
            return self._present("the filter settles" if self._state else "air or room temperature not known")
        self._state, innovation = self._filter.step(self._state, history)
        if self._state is None:
            return self._present("the filter begins anew")
        settled = self._state.time_s - self._state.begun_s >= SETTLE_S
        unjudged = unjudged or ("" if settled else "the filter settles")
        if innovation is None or unjudged:
            self._past = None
            return self._present(unjudged or "no measurement")
        return self._judge(innovation, history, utc)

    def _begin(self, twin: BoxTwin, utc: float) -> None:
        if twin.step_s != self._promise.step_s:
            raise DataError(f"the twin is for steps of {twin.step_s:g} s")
        self.begin_anew()
        self._filter = Filter(twin)
        sha256 = twin.sha256
        if self.memory is None or self.memory.twin_sha256 != sha256:
            self.memory = DriftMemory(sha256, Evidence.none(utc))
        self._weights = [self._known_noise(cell) for cell in range(CELLS)]

    def _known_noise(self, cell: int) -> Floats:
        assert self.memory is not None
        known = noise.count(self.memory.sums, cell) >= self._learn_ticks
        return noise.weights(self.memory.sums, cell) if known else noise.cautious()

    def _judge(self, innovation: Innovation, history: Columns, utc: float) -> Drift:
        """One more innovation: evidence, table and what is learnt."""
        memory, step_s = self.memory, self._promise.step_s
        assert memory is not None
        z = np.asarray(innovation.value_k / innovation.sd_k)
        if not np.isfinite(z):
            raise DataError("the twin's prediction is no number")
        past, now = self._past, situation(history, step_s)
        if past is None:
            self._past = noise.InnovationPast(z, z)
            return self._present("the filter begins to be judged")
        white = noise.whiten(self._weights[now.cell], z, past)
        self._past = noise.follow(past, z, step_s)
        found = evidence.hear(memory.evidence, white, now.regimes, float(history["utc"][-2]), self._threshold)
        table = where.note(memory.table, float(white), innovation.value_k, now.regimes, step_s)
        memory = replace(memory, evidence=found, table=table)
        # Nothing is learnt while the twin disagrees: its error would become the usual noise.
        if not memory.disagrees and noise.count(memory.sums, now.cell) < self._learn_ticks:
            memory = replace(memory, sums=noise.learnt(memory.sums, now.cell, z, past))
            if noise.count(memory.sums, now.cell) >= self._learn_ticks:
                self._weights[now.cell] = noise.weights(memory.sums, now.cell)
        self.memory = memory
        learnt = noise.count(memory.sums, now.cell) >= self._learn_ticks
        agreed_s = step_s if learnt else step_s / CAUTIOUS_AGREE
        self._decide(float(found.total), agreed_s, float(history["time_s"][-1]), utc)
        return self._present()

    def _decide(self, total: float, agreed_s: float, now: float, utc: float) -> None:
        """Raise the alarm, or end it. agreed_s: what this tick counts where no evidence is left"""
        memory = self.memory
        assert memory is not None
        if not memory.disagrees:
            if total >= self._threshold:
                since = evidence.change_utc(memory.evidence)
                self.memory = replace(memory, since_utc=since, agreeing_s=0.0)
                self._tell("twin.disagrees", Severity.WARNING, self._present().text, now, utc)
            return
        agreeing_s = memory.agreeing_s + agreed_s if total < self._threshold - CLEAR else 0.0
        self.memory = replace(memory, agreeing_s=agreeing_s)
        if agreeing_s >= AGREE_S:
            lasted_h = (utc - memory.since_utc) / 3600.0
            self.memory = replace(memory, evidence=Evidence.none(utc), since_utc=math.nan, agreeing_s=0.0)
            text = f"the twin agrees again, after {lasted_h:.1f} h"
            self._tell("twin.agrees_again", Severity.INFO, text, now, utc)

    def _tell(self, key: str, severity: Severity, text: str, now: float, utc: float) -> None:
        self._events.append(Event(key, severity, text, now, utc))

    def _unwatched_drift(self, reason: str) -> Drift:
        drift = Drift(reason=reason)
        return replace(drift, text=in_words(drift, self._zone))

    def _present(self, reason: str = "") -> Drift:
        """Return the present drift. An alarm stands until the twin has been seen to agree."""
        memory = self.memory
        if memory is None:
            return self._unwatched_drift(reason)
        worst = where.worst(memory.table, evidence.by_regime(memory.evidence))
        rows = where.rows(memory.table)
        agrees = DriftState.UNKNOWN if reason else DriftState.AGREES
        drift = Drift(
            state=DriftState.DISAGREES if memory.disagrees else agrees,
            reason=reason,
            since_utc=memory.since_utc if memory.disagrees else None,
            where=REGIMES[worst].name,
            error_k=rows[worst].error_k,
            evidence=max(0.0, float(memory.evidence.total) / self._threshold),
            learnt=noise.share_learnt(memory.sums, self._learn_ticks),
            regimes={regime.name: row for regime, row in zip(REGIMES, rows, strict=True) if row.ticks >= 1.0},
        )
        return replace(drift, text=in_words(drift, self._zone))
