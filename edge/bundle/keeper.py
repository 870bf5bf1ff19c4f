"""The running daemon's bundles: changed in a thread of their own, exchanged between two ticks.

The control thread reads `serving` once a tick and hands in scores; it never waits for the disk or for a
model that loads. Requests become jobs: the asker gets a number at once and asks again how it went, so a slow
disk does not hold up the control socket either.
"""

import queue
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from edge.bundle import remote
from edge.bundle.inventory import Inventory, take_inventory
from edge.bundle.manifest import PACKAGED, TWIN, Sha256
from edge.bundle.roles import Roles, activate, last_adopted, marked_good, reject_shadow
from edge.bundle.store import BundleStore, LoadedBundle
from edge.bundle.trial import HorizonScore, Judgement, Scores, TrialVerdict, judge
from edge.core.clock import Clock
from edge.core.errors import DataError, RequestError
from edge.core.messages import Event, Severity, TickRecord
from edge.core.plain_text import plain, quote
from edge.formats.cross_check import Rule
from edge.tick.orders import read_request, with_author


@dataclass(frozen=True, slots=True)
class Serving:
    """The models that forecast at each tick. Exchanged whole, never changed."""

    active: LoadedBundle | None  # None: not even the packaged bundle is fit for this rig
    rival: LoadedBundle | None = None  # runs beside it and is scored
    on_probation: bool = False  # the active one is on trial against the rival; else the rival against it
    problems: tuple[str, ...] = ()  # bundles that should serve and can't, with the reason


def choose(store: BundleStore, loaded: Mapping[str, LoadedBundle] | None = None) -> Serving:
    """Choose the active bundle, the previous one if that is damaged, else the packaged one.

    loaded : bundles that are in memory already, by name: they are not read again

    Nothing is written: the store keeps what was asked for, and the next start tries it again.
    """
    problems: list[str] = []

    def load(name: str | None) -> LoadedBundle | None:
        if name is None:
            return None
        try:
            return (loaded or {}).get(name) or store.load(name)
        except (DataError, RequestError) as error:
            problems.append(str(error))
            return None

    try:
        roles = store.roles()
    except DataError as error:
        problems.append(str(error))
        roles = Roles()
    active = load(roles.active)
    if active is not None:
        rival = load(roles.rival)
        return Serving(active, rival, roles.on_probation and rival is not None, tuple(problems))
    # The active bundle may also be the previous one; it is damaged and not read a second time.
    instead = dict.fromkeys((roles.previous, PACKAGED))
    active = next((bundle for name in instead if name != roles.active and (bundle := load(name))), None)
    return Serving(active, problems=tuple(problems))


Action = Callable[[BundleStore, str | None], Roles]


def _undo_adoption(store: BundleStore, version: str | None) -> Roles:
    """Take back the twin that was adopted last, from shadow or from the active bundle."""
    roles = store.roles()
    last = last_adopted(roles)
    if last is None:
        beside = roles.shadow or "none"
        raise RequestError(f"no adopted twin runs: bundle {roles.active} is active, {beside} beside it")
    return ACTIONS["reject" if last == roles.shadow else "rollback"](store, version or last)


ACTIONS: dict[str, Action] = {
    "activate": lambda store, version: store.change(partial(activate, version=version)),
    "rollback": BundleStore.roll_back,
    "mark-good": lambda store, version: store.change(marked_good),
    "reject": lambda store, version: store.change(partial(reject_shadow, version=version)),
    "undo-adoption": _undo_adoption,
    # Changes nothing: the daemon reads again what others have changed.
    "refresh": lambda store, version: store.roles(),
    "refresh-older": lambda store, version: store.roles(),  # after `install --allow-older VERSION`
}


def carry_out(store: BundleStore, action: str, version: str | None) -> Roles:
    """Do one of ACTIONS. Errors: RequestError, DataError; nothing has changed then."""
    if action not in ACTIONS:
        raise RequestError(f"action: {action!r} is none of {', '.join(ACTIONS)}")
    return ACTIONS[action](store, version)


JOBS_REMEMBERED = 32
JOBS_WAITING = 8
ERROR_MAX = 400  # characters of what is said of a job that failed
_FOLLOWS = {
    TrialVerdict.PROMOTE: "activate",
    TrialVerdict.REJECT: "reject",
    TrialVerdict.MARK_GOOD: "mark-good",
    TrialVerdict.ROLL_BACK: "rollback",
}


@dataclass(frozen=True, slots=True)
class _Job:
    number: int
    action: str
    version: str | None
    why: str
    order: remote.Order | None = None  # instead of one of ACTIONS


_LOOK = _Job(0, "list", None, "")


class _Age(Enum):
    """State of the inventory. Looking takes a process for each signature, so nobody looks unasked."""

    OLD = "old"
    ASKED = "asked"
    NEW = "new"


@dataclass(frozen=True, slots=True)
class BundleRequest:
    """Keys of the request; job : whose outcome is asked for with the status; url, sha256 : of a fleet's."""

    action: Annotated[str, Rule(choices=("status", "list", *ACTIONS, *remote.ACTIONS))]
    version: str | None = None
    job: int | None = None
    url: str | None = None
    sha256: Sha256 | None = None


class BundleKeeper:
    """Made before the first tick: the first bundles are loaded by the caller's thread.

    automatic : follow the scores without being asked
    trial_ticks : scored forecasts per horizon before a bundle on trial is judged
    source : where a fleet's bundles stand
    """

    def __init__(
        self,
        store: BundleStore,
        clock: Clock,
        automatic: bool,
        trial_ticks: int,
        source: remote.BundleSource | None = None,
    ) -> None:
        self._store, self._clock = store, clock
        self._source = source or remote.BundleSource()
        self._automatic, self._trial_ticks = automatic, trial_ticks
        self.serving: Serving = choose(store)
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._posting = threading.Lock()
        self._posted = self._done = 0
        self._outcomes: dict[int, str] = {}  # number of a job that is done -> error, "" without one
        self._told: deque[tuple[Severity, str, str]] = deque()
        self._judgement: Judgement | None = None
        self._decided: Serving | None = None  # what the scores have had their say on
        self._inventory = Inventory()
        self._inventory_age = _Age.OLD
        self._thread = threading.Thread(target=self._run, name="bundles", daemon=True)
        self._thread.start()

    def answer(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Reply to a request `{"do": "bundle", "action": ..., "version": ..., "job": ...}`; never waits."""
        try:
            asked = read_request(BundleRequest, request)
            order, what = self._remote_order(asked)
        except RequestError as error:
            return _refusal(str(error))
        if asked.action == "status":
            return {"ok": True, **self._status(asked.job)}
        if asked.action == "list":
            return {"ok": True, **self._status(None), **self._list()}
        job = self._post(asked.action, asked.version, with_author(f"{what}asked for", request), order)
        return _refusal("too many requests wait") if job is None else {"ok": True, "job": job}

    def consider(self, serving: Serving, rows: Sequence[HorizonScore]) -> None:
        """Judge the bundle on trial, and where so configured do what follows. Never waits.

        serving : the value of `serving` whose bundles the rows are about
        """
        scores = _scores(serving, rows)
        if scores is None or serving is not self.serving:  # exchanged meanwhile
            self._judgement = None
            return
        judgement = judge(scores, serving.on_probation, self._trial_ticks)
        self._judgement = judgement
        action = _FOLLOWS.get(judgement.verdict)
        if self._automatic and action is not None and serving is not self._decided:
            self._decided = serving  # once: an order that fails would fail at each tick
            self._post(action, scores.rival if action == "activate" else None, judgement.why)

    def write(self, record: TickRecord) -> None:
        """Ticks are none of its business; with `faults` this makes it one of the loop's sinks."""

    def faults(self) -> Mapping[str, str]:
        """Bundles that should serve and can't, while that is so."""
        problems = self.serving.problems
        return {"bundle.refused": "; ".join(problems)} if problems else {}

    def events_pending(self) -> list[Event]:
        """Return the events since the last call. The control thread calls this."""
        now, utc = self._clock.now(), self._clock.utc()
        told = [self._told.popleft() for _ in range(len(self._told))]
        return [Event(key, severity, text, now, utc) for severity, key, text in told]

    def twin_file(self) -> Path | None:
        """Return the twin file of the active bundle. Thread-safe."""
        active = self.serving.active
        return None if active is None else self._store.folder_of(active.name) / TWIN

    def own_twin_file(self) -> Path | None:
        """Return the twin file of the active bundle, None where that is the packaged one. Thread-safe."""
        active = self.serving.active
        return None if active is None or active.name == PACKAGED else self.twin_file()

    def close(self) -> None:
        """End the thread after the job that runs."""
        self._jobs.put(None)
        self._thread.join(timeout=5.0)

    def _remote_order(self, asked: BundleRequest) -> tuple[remote.Order | None, str]:
        """Return a fleet's order, and the words by which it knows the event. Errors: RequestError"""
        if asked.action == remote.INSTALL:
            return remote.install_order(self._source, asked.url, asked.sha256), f"sha256 {asked.sha256}, "
        if asked.action == remote.ROLL_BACK:
            return remote.rollback_order(self._source, asked.version), f"bundle {asked.version}, "
        return None, ""

    def _post(
        self, action: str, version: str | None, why: str, order: remote.Order | None = None
    ) -> int | None:
        with self._posting:
            if self._posted - self._done >= JOBS_WAITING:
                return None
            self._posted += 1
            self._jobs.put(_Job(self._posted, action, version, why, order))
            return self._posted

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            if job is _LOOK:
                self._look()
                continue
            try:
                error = self._do(job)
            except Exception as bug:  # told and gone on: the thread must be there for the next job
                error = f"internal error: {bug!r}"
            error = plain(error, ERROR_MAX)
            if error:
                self._told.append((Severity.WARNING, "bundle.failed", f"{job.action} ({job.why}): {error}"))
            with self._posting:
                self._outcomes[job.number] = error
                self._outcomes.pop(job.number - JOBS_REMEMBERED, None)
                self._done = job.number
                self._inventory_age = _Age.OLD

    def _do(self, job: _Job) -> str:
        """Change the store, then what serves. Returns the error, "" without one."""
        try:
            if job.order is not None:
                job.order(self._store)
            else:
                carry_out(self._store, job.action, job.version)
        except (DataError, RequestError) as error:
            return str(error)
        loaded = {bundle.name: bundle for bundle in (self.serving.active, self.serving.rival) if bundle}
        self.serving = choose(self._store, loaded)
        severity, why = Severity.INFO, job.why
        if job.action == "refresh-older":
            severity, why = Severity.WARNING, f"--allow-older took in {quote(job.version)}"
        self._told.append((severity, f"bundle.{job.action}", f"{why}; {_in_words(self.serving)}"))
        return ""

    def _list(self) -> dict[str, Any]:
        """Return what is known of all installed bundles; `looking` where the thread is about to know more."""
        with self._posting:
            if self._inventory_age is _Age.OLD:
                self._inventory_age = _Age.ASKED
                self._jobs.put(_LOOK)
            looking = self._inventory_age is _Age.ASKED
        return {"looking": looking, **asdict(self._inventory)}

    def _look(self) -> None:
        inventory = take_inventory(self._store, self._inventory)
        with self._posting:
            self._inventory, self._inventory_age = inventory, _Age.NEW

    def _status(self, job: int | None) -> dict[str, Any]:
        serving, judgement = self.serving, self._judgement
        with self._posting:
            error = None if job is None else self._outcomes.get(job)
        return {
            "active": serving.active.name if serving.active else None,
            "rival": serving.rival.name if serving.rival else None,
            "on_probation": serving.on_probation,
            "problems": list(serving.problems),
            "judgement": asdict(judgement) | {"verdict": judgement.verdict.value} if judgement else None,
            "job_done": error is not None,
            "job_error": error or "",
        }


def _scores(serving: Serving, rows: Sequence[HorizonScore]) -> Scores | None:
    active, rival = serving.active, serving.rival
    if active is None or rival is None:
        return None
    return Scores(
        active.name, rival.name, tuple(name for name in active.predictors if name in rival.predictors), rows
    )


def _in_words(serving: Serving) -> str:
    active = serving.active.name if serving.active else "no bundle"
    probation = ", on probation" if serving.on_probation else ""
    rival = f"; {serving.rival.name} runs beside it" if serving.rival else ""
    return f"{active} is active{probation}{rival}"


def _refusal(error: str) -> dict[str, Any]:
    return {"ok": False, "error": error}
