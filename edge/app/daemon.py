"""Wires a rig together from settings, runs its loop, and takes it apart again."""

import os
import secrets
import signal
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, Self

from edge.app.active_models import ActiveModels
from edge.app.box import bounds_of
from edge.app.nightly_diagnosis import NightlyDiagnosis, Places
from edge.app.request_routes import Commissioning, Routes, ShowState, outbox_of
from edge.app.running_rigs import register
from edge.assistant.llm.language_model import LanguageModel, open_language_model
from edge.assistant.requests.answer import settings_from
from edge.assistant.requests.desk import DeskParts, WishDesk
from edge.assistant.requests.memory import OperatorMemory
from edge.board.board import Board
from edge.board.serial_port import OpenPort, SerialPort
from edge.bundle.keeper import BundleKeeper
from edge.bundle.predictors import loader
from edge.bundle.proof import Prover
from edge.bundle.remote import BundleSource
from edge.bundle.store import BundleStore
from edge.config.loading import config_hash
from edge.config.settings import MqttSettings, SensorCalibration, Settings
from edge.controllers.external import External
from edge.core.clock import Clock, Moment, RealClock, boot_id
from edge.core.controller import Controller
from edge.core.errors import ConfigError, DataError
from edge.core.messages import TickRecord
from edge.core.version import __version__
from edge.drift.monitor import DriftMonitor, Promise
from edge.formats.atomic_file import hold_lock
from edge.mqtt.telemetry import Telemetry
from edge.safety.supervisor import SafetyMemory
from edge.sockets.control_socket import ControlSocket
from edge.sockets.external_proposals import ExternalProposals
from edge.sockets.stop_file import StopFile
from edge.state.codecs import carry_on
from edge.state.store import BOARD_ID, DRIFT, LIMITS, LLM_BUDGET, SKILL, STANDING, restore
from edge.state.writer import DriftTurns, HourlySink, StandingSink, StateWriter
from edge.storage import FactBook, Session, Storage
from edge.tick.calibration import formula
from edge.tick.decider import decision_deadline_s
from edge.tick.estimator import Estimator
from edge.tick.inbox import Inbox
from edge.tick.loop import Loop
from edge.tick.orders import Operation
from edge.tick.reference import Reference, make_reference, zone_of
from edge.tick.rig import Answered, Rig, SaveState, Sink
from edge.tick.sensor_health import SensorHealth
from edge.tick.status import LoopStatus

REQUESTS_VARIABLE = "GREENHOUSE_DIAGNOSIS"  # folder of requests to the diagnosis's unit, set by the daemon's
ANSWER_SHARE = 0.9  # of the decision's deadline that a client of `external` may take


@dataclass(slots=True)
class Daemon:
    """Everything that a running rig holds open. Use as a context manager; `run` blocks until `stop`."""

    settings: Settings
    clock: Clock
    after_tick: Callable[[TickRecord], None] = lambda record: None
    reference: Reference | None = None  # instead of the configured one
    stop_at_s: float = float("inf")
    experiment: str = ""  # a controller that decides this once; orders but stops wait until it has ended
    more_controllers: Sequence[Controller] = ()  # than those of edge/core/controller_names.py
    client_wait_s: float = 0.0  # how long to wait for a client at `external.socket` before the first tick
    open_port: OpenPort = SerialPort  # else a board in this process
    more_sinks: Sequence[Sink] = ()  # a display
    config_file: Path | None = None  # where the settings were read, for commands that the daemon starts
    commissioning: Commissioning | None = None  # of a service that can commission its box
    _stack: ExitStack = field(default_factory=ExitStack)
    _loop: Loop | None = None
    language_model: LanguageModel | None = None  # once it runs, where one is configured

    def __enter__(self) -> Self:
        try:
            self._loop = self._wire()
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        self._stack.close()

    def run(self) -> None:
        """Until `stop`, SIGTERM or SIGINT, or the end of the experiment."""
        assert self._loop is not None
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGTERM, signal.SIGINT):
                before = signal.signal(number, self._on_signal)
                self._stack.callback(signal.signal, number, before)
        self._loop.run()

    def stop(self) -> None:
        """End after the tick that runs; from any thread."""
        assert self._loop is not None
        self._loop.stop()

    def status(self) -> LoopStatus:
        """Return the standing orders, the trips and the last tick. The control thread calls this."""
        assert self._loop is not None
        return self._loop.status()

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self.commissioning is not None:
            self.commissioning.signal()
        self.stop()

    def _wire(self) -> Loop:
        settings, stack = self.settings, self._stack
        bundles = self._bundles()
        llm = self.language_model = self._language_model()
        models = ActiveModels(settings, bundles, restore(SKILL, settings), llm)
        self._lock("history.path", settings.history.path)
        self._lock("state_file", settings.state_file)
        skill = HourlySink(SKILL, settings, lambda: models.forecasting.state)
        stack.callback(skill.close)
        controllers = models.controllers() | {each.name: each for each in self.more_controllers}
        if settings.external.socket:
            external = self._external()
            controllers[external.name] = external
        if self.experiment and self.experiment not in controllers:
            reason = settings.unready(self.experiment)
            step_s = settings.control.step_s
            raise ConfigError(f"control: {reason or f'{self.experiment} needs a model for {step_s:g} s'}")
        first, why = models.first_controller()
        # Only the machine's clock goes on from process to process.
        boot = boot_id() if isinstance(self.clock, RealClock) else ""
        limits, box = restore(LIMITS, settings), bounds_of(settings.box)
        now = Moment(boot, self.clock.now(), self.clock.utc())
        standing, chosen = carry_on(restore(STANDING, settings), limits, now, box.heater_w), ""
        # An experiment may lack models that its rig has, so the orders that come back after it are these.
        ordered = standing.operation
        settings = replace(settings, control=replace(settings.control, controller=first))
        if standing.operation.controller not in controllers:  # chosen when the rig had a model
            standing = replace(standing, operation=replace(standing.operation, controller=first))
            chosen = f"{first} controls: {why}"
        stop_file = StopFile(settings.stop_folder)
        if stop_file.author() is not None:  # the socket's thread says whose, and takes it away
            standing = replace(standing, operation=replace(standing.operation, emergency_stop=True))
        inbox = Inbox()
        stack.callback(inbox.close)
        memory = self._memory()
        desk = self._desk(inbox, models, llm, memory)
        nightly = self._nightly(bundles)
        routes = Routes(settings, inbox, bundles, desk, self.commissioning, nightly)
        socket = ControlSocket(Path(settings.control_socket.path), routes.ask, inbox.post, stop_file)
        stack.callback(socket.close)
        unregistered = self._register()
        session = Session(__version__, config_hash(settings), models.versions(), boot)
        storage = Storage(settings.history, self.clock, session)
        first_seq = storage.open()
        stack.callback(storage.close)
        state = StandingSink(StateWriter(STANDING, settings, LIMITS), self.clock, boot)
        stack.callback(state.writer.close)
        sinks: list[Sink] = [storage, state, skill, *self.more_sinks]
        sinks += [part for part in (bundles, nightly) if part]
        drift = self._drift(sinks)
        show: Callable[[LoopStatus], None] = lambda status: None  # noqa: E731
        show_commissioning: ShowState | None = None
        if settings.mqtt.enabled:
            own_twin = bundles.own_twin_file if bundles else lambda: None
            telemetry = Telemetry(settings, routes.ask, inbox.post, lambda: outbox_of(settings), own_twin)
            stack.callback(telemetry.close)
            desk.listeners.append(telemetry.show_proposal)
            sinks.append(telemetry)
            show = telemetry.show
            show_commissioning = telemetry.show_commissioning
        pin, port = StateWriter(BOARD_ID, settings), settings.board
        stack.callback(pin.close)
        pinned, session_id = restore(BOARD_ID, settings), secrets.randbits(32)
        board = Board(port.port, port.baudrate, self.clock, session_id, self.open_port, pinned, pin.save)
        stack.callback(board.close)
        stack.callback(inbox.close)  # the first to close: nobody shall wait for a loop that has ended
        rig = Rig(
            settings=settings,
            clock=self.clock,
            board=board,
            sensors=SensorHealth(
                settings.sensor_health, settings.calibration, box, standing.memory.air_doubt
            ),
            estimator=Estimator(
                settings.estimator, models.model, settings.control.step_s, settings.control.ambient_default_c
            ),
            reference=self.reference or make_reference(settings.reference),
            zone=zone_of(settings.timezone),
            controllers=controllers,
            models=models,
            sinks=sinks,
            more_events=lambda: [
                event
                for part in (storage, bundles, nightly, llm, memory)
                if part
                for event in part.events_pending()
            ],
            inbox=inbox,
            save_state=self._save(state, ordered),
            after_tick=self.after_tick,
            show=show,
            stop_at_s=self.stop_at_s,
            drift=drift,
            box=box,
            clocks=standing.at,
            foreign_board=lambda: board.foreign,
            accept_board=board.accept,
        )
        loop = Loop(rig, self._orders(standing.operation), standing.memory, first_seq)
        stack.callback(loop.close)
        if standing.broken:
            loop.note("state.broken", standing.broken)
        if isinstance(limits, str) and (limits or settings.watering.enabled):
            why = limits or "no record of what limits had used up before this start"
            loop.announce("limits.unknown", f"{why}; no water for {settings.watering.soak_s / 60:g} min")
        if chosen:
            loop.announce("controller.chosen", chosen)
        self._announce(loop, standing.operation, unregistered)
        if self.commissioning is not None:
            self.commissioning.serve(self.stop, show_commissioning)
        return loop

    def _register(self) -> str:
        """Let commands find this rig, where the machine's clock runs it; return why not, else ""."""
        try:
            if isinstance(self.clock, RealClock):
                self._stack.callback(register(self.settings).unlink, missing_ok=True)
        except OSError as error:  # a user who cannot write there: the rig runs
            way = f"`greenhouse emergency-stop` finds it by --socket {self.settings.control_socket.path} only"
            return f"this daemon cannot register in {error.filename}: {error.strerror}. {way}"
        return ""

    def _lock(self, key: str, path: str) -> None:
        """Refuse a second daemon that would share a file, whatever its socket is. Errors: ConfigError"""
        try:
            self._stack.enter_context(hold_lock(Path(f"{os.path.realpath(path)}.lock"), wait=False))
        except DataError as error:  # a disk that refuses the lock must not end control
            if isinstance(error.__cause__, BlockingIOError):
                raise ConfigError(f"{key}: {path}: another daemon uses this file") from None

    def _announce(self, loop: Loop, standing: Operation, unregistered: str) -> None:
        """Emit an event for each order that holds on and is not expected, and for what names the rig."""
        if unregistered:
            loop.announce("daemon.unregistered", unregistered)
        mqtt = self.settings.mqtt
        if mqtt.enabled and mqtt.rig == MqttSettings().rig:
            text = f"this rig keeps the default name {mqtt.rig}, which no other rig at the broker may have"
            loop.announce("mqtt.default_name", text)
        if standing.profile is not None and not self.experiment:
            loop.announce("profile.resumed", f"goes on with {standing.profile.in_words()}")
        for each in standing.calibrations:
            own = formula(each.signal, SensorCalibration(each.offset, each.gain))
            text = f"{each.signal} is {own}, as a person calibrated it; the configured one waits"
            loop.announce("calibration.holds", text)

    def _external(self) -> External:
        """Return the external controller; its wait ends before the caller's, so that its reason arrives."""
        control = self.settings.control
        proposals = ExternalProposals(Path(self.settings.external.socket))
        self._stack.callback(proposals.close)
        if self.client_wait_s:
            proposals.wait_for_client(self.client_wait_s)
        return External(proposals, ANSWER_SHARE * decision_deadline_s(control))

    def _bundles(self) -> BundleKeeper | None:
        """None where the configuration has no folder for them."""
        own, step_s = self.settings.bundle, self.settings.control.step_s
        if not own.path:
            return None
        keys = Path(own.trusted_keys)
        store = BundleStore(Path(own.path), keys, loader(step_s), prove=Prover(keys, step_s))
        source = BundleSource(own.source, own.source_ca)
        bundles = BundleKeeper(store, self.clock, own.auto == "promote", own.trial_ticks, source)
        self._stack.callback(bundles.close)
        return bundles

    def _language_model(self) -> LanguageModel | None:
        """None where the configuration has no endpoint."""
        settings = self.settings
        if not settings.llm.url:
            return None
        history, spent = Path(settings.history.path), restore(LLM_BUDGET, settings)
        writer = StateWriter(LLM_BUDGET, settings)
        self._stack.callback(writer.close)
        model = open_language_model(settings.llm, history, spent, writer.save, self.clock.utc)
        self._stack.callback(model.close)
        return model

    def _memory(self) -> OperatorMemory:
        settings = self.settings
        book = FactBook(settings.history.path, self.clock.utc)
        return OperatorMemory(book, settings.llm.memory_tokens, zone_of(settings.timezone), self.clock)

    def _desk(
        self, inbox: Inbox, models: ActiveModels, llm: LanguageModel | None, memory: OperatorMemory
    ) -> WishDesk:
        """Return the desk for operators' requests."""
        model = None if llm is None else partial(settings_from, llm)
        around = DeskParts(self.settings, model, inbox.ask, lambda: models.twin, self.clock.utc, memory)
        desk = WishDesk(around)
        self._stack.callback(desk.close)
        return desk

    def _drift(self, sinks: list[Sink]) -> DriftMonitor | None:
        """Watches the running twin, and saves what it knows as one of the sinks."""
        settings = self.settings
        if not settings.drift.enabled:
            return None
        promise = Promise(settings.control.step_s, settings.drift.false_alarm_days, settings.drift.learn_h)
        monitor = DriftMonitor(promise, zone_of(settings.timezone), restore(DRIFT, settings))
        keeping = HourlySink(DRIFT, settings, lambda: monitor.memory, DriftTurns())
        self._stack.callback(keeping.close)
        sinks.append(keeping)
        return monitor

    def _nightly(self, bundles: BundleKeeper | None) -> NightlyDiagnosis | None:
        """None where there are no bundles, whose twin it could diagnose and replace."""
        settings = self.settings
        if bundles is None:
            return None
        places = Places(
            Path(settings.history.path),
            bundles.twin_file,
            self.config_file,
            lambda: bundles.serving.rival is not None,
            Path(folder) if (folder := os.environ.get(REQUESTS_VARIABLE)) else None,
        )
        nightly = NightlyDiagnosis(settings.drift, places, self.clock, zone_of(settings.timezone))
        self._stack.callback(nightly.close)
        return nightly

    def _orders(self, standing: Operation) -> Operation:
        if not self.experiment:
            return standing
        return Operation(self.experiment, **_outliving(standing))

    def _save(self, state: StandingSink, standing: Operation) -> SaveState:
        """Return the sink that saves orders."""
        if not self.experiment:
            return state.save

        def save(operation: Operation, memory: SafetyMemory, answered: Answered | None = None) -> None:
            state.save(replace(standing, **_outliving(operation)), memory, answered)

        return save


def _outliving(operation: Operation) -> dict[str, Any]:
    """Return the orders that hold in an experiment too, and outlive it."""
    names = ("emergency_stop", "maintenance_until_utc", "points", "calibrations")
    return {name: getattr(operation, name) for name in names}
