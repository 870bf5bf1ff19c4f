"""The control loop: the only file that knows the order of a tick.

    board -> readings -> estimate -> controller -> safety -> board
                                                        \\-> history, telemetry

`tick` is that arrow; `run` says when to tick; what each failure gets stands in `edge/tick/faults.py`.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from edge.config.settings import CalibrationSettings
from edge.core.clock import Moment
from edge.core.controller import Context
from edge.core.errors import RequestError
from edge.core.event_log import EventLog
from edge.core.messages import (
    AirSensorPair,
    Change,
    Command,
    Echo,
    Estimate,
    Event,
    Reading,
    ReadingQuality,
    Severity,
    TickRecord,
)
from edge.core.plain_text import fan_in_words
from edge.safety.memory import Dose, survives_as
from edge.safety.supervisor import (
    SafetyMemory,
    SafetyVerdict,
    SafetyView,
    clear_trip,
    follow_calibration,
    planning_limits,
    supervise,
)
from edge.tick.calibration import RawMinute, SensorDesk, in_force, point_words, states
from edge.tick.context import TickTime, context_of
from edge.tick.decider import Decider
from edge.tick.faults import Conditions
from edge.tick.inbox import ORDINARY, Letter, Reply, Request
from edge.tick.light_and_water import led_level, watering_pulse
from edge.tick.order_words import order_words
from edge.tick.orders import (
    UTC_MAX,
    Desk,
    NoKeys,
    Operation,
    acts_at_once,
    apply_orders,
    has_lost_date,
    is_released,
    operate,
    read_request,
    with_author,
)
from edge.tick.reference import seconds_of_day
from edge.tick.rig import Rig
from edge.tick.status import STATUS, LoopStatus

ECHO_TIMEOUT_S = 1.5  # five sends of one request, then the tick goes on without the board's answer
NOT_REACHED = "no link to the board: it obeys as soon as it is back; what it drives now ends with its lease"
ANOTHER_BOARD = "another board is at the port and gets stops alone; the rig's own obeys once it is back"
# Each release lets the next stop write the board's EEPROM, which takes 100 000 writes: it lasts 11 months so.
RELEASES, RELEASE_EVERY_S = 100, 300.0  # at once; at length [s]
RELEASED_TOO_OFTEN = "released too often: each time wears the board's memory; it stays off, try in 5 minutes"
ENDED_BY = {"release_emergency_stop": "emergency_stop", "maintenance": "maintenance"}  # order -> its stop
START_WAIT_S = 5.0  # for the board, before the first tick
ORDERS_TOLD = 20  # between two ticks, each with its words; more than a person gives in a minute
LATE_SHARE = 0.1  # a tick that begins later than this share of a step is told
SINK_FAULTS = (
    "history.behind", "history.replaced", "telemetry.offline", "state.unwritten", "bundle.refused",
    "output.behind", "telemetry.flooded", "telemetry.name_taken",
)  # fmt: skip
Booking = tuple[Dose, list[str]]  # a dose that goes to the disk before it is given, and the disk's answer
CLOCK_JUMP_S = 2.0  # difference between wall clock and monotonic clock from tick to tick


class Loop:
    """State that lives from tick to tick, and nothing else."""

    def __init__(self, rig: Rig, operation: Operation, memory: SafetyMemory, first_seq: int) -> None:
        self._rig = rig
        self._operation = operation
        self._memory = memory
        self._seq = first_seq
        self._step_s = rig.settings.control.step_s
        self._start_s = rig.clock.now()  # of the tick grid, set anew when the board is there
        self._sent = Command()
        clocks = rig.clocks or Moment("", self._start_s, rig.clock.utc())
        self._wall_minus_monotonic = clocks.utc - clocks.time_s
        self._jump_s = 0.0  # of the wall clock since the last tick
        self._followed_s = self._start_s  # until when the profile's time has been counted
        self._conditions = Conditions()
        self._events = EventLog(ORDERS_TOLD)
        self._decider = Decider(rig.controllers, rig.settings.control, self._conditions, self._answer_urgent)
        self._booking: Booking | None = None  # by the last tick, of water that has not been given yet
        self._stopping = False
        rig.sensors.calibrate(self._calibration(), self._start_s)
        self._shown = self._outputs()  # what was published last
        self.last_record: TickRecord | None = None

    def run(self) -> None:
        """Tick on a fixed grid until stopped; then all off, confirmed by a board that still answers."""
        number = skipped = 0  # number: of the grid point that is next
        try:
            self._follow_clock()
            self._stop_board()
            self._wait_for_board()
            start = (self._rig.reference.sha256, self._reference_start_s())
            self._operation = replace(self._operation, reference_start=start)
            self._rig.save_state(self._operation, self._memory)
            while self._serve_until(self._start_s + number * self._step_s):
                now = self._rig.clock.now()
                late_s = now - (self._start_s + number * self._step_s)
                self.tick(now, late_s, skipped)
                # Grid points that went by meanwhile are counted and never made up for.
                following = max(number + 1, math.ceil((self._rig.clock.now() - self._start_s) / self._step_s))
                skipped, number = following - number - 1, following
        finally:
            self._shut_down()
            self.close()

    def note(self, key: str, detail: str) -> None:
        """Note a failure of the table that was found at start."""
        self._conditions.set(key, True, self._rig.clock.now(), self._rig.clock.utc(), detail)

    def announce(self, key: str, text: str) -> None:
        """Emit an event about the start, with the first tick."""
        self._tell(key, Severity.INFO, text, self._rig.clock.now())

    def close(self) -> None:
        """End the decision thread; can be called twice."""
        self._decider.close()

    def stop(self) -> None:
        """Ask the loop to end; safe in a signal handler and from any thread."""
        self._stopping = True
        self._rig.inbox.ring()

    def tick(self, now: float, late_s: float = 0.0, skipped: int = 0) -> TickRecord:
        """One step of control: the arrow."""
        rig, utc = self._rig, self._rig.clock.utc()
        self._follow_clock()
        if exchanged := rig.models.exchange(rig.estimator, rig.controllers):
            self._tell("models.exchanged", Severity.INFO, exchanged, now)
        readings = rig.sensors.readings(rig.board.take_samples(), now, self._sent)
        estimate = rig.estimator.update(readings, now, utc)
        self._end_steering(now, utc)
        self._end_maintenance(now, utc)
        self._follow_profile(now, utc)
        context = self._context(estimate, now, utc)
        decision, decide_ms = self._decider.decide(self._operation.controller, context)
        booking = self._take_booking()  # nothing is saved without it before the dose of this tick is in
        wanted, orders = self._apply_orders(
            self._with_light_and_water(decision.command, readings, now, utc), utc
        )
        verdict = self._book(self._supervise(wanted, readings, estimate, now, utc), booking)
        echo = self._drive(verdict)
        # Forecasts start from what the board was sent, not from what the controller wanted.
        rig.estimator.record_sent(self._sent)
        history, confirmed = rig.estimator.history(), echo is not None
        forecasts, skill = rig.models.forecast(history, decision, self._sent, confirmed)
        drift = None
        if rig.drift is not None:
            hands_in = self._operation.in_maintenance(utc)
            drift = rig.drift.tick(rig.models.twin, history, confirmed, hands_in)
        self._note_conditions(readings, estimate, echo, late_s, now, utc)
        record = TickRecord(
            seq=self._seq,
            time_s=now,
            utc=utc,
            step_s=self._step_s,
            mode="emergency_stop" if self._operation.emergency_stop else self._operation.mode.value,
            readings=readings,
            estimate=estimate,
            reference_c=float(context.reference[0]),
            decision=decision,
            wanted=wanted,
            changes=orders + verdict.changes,
            sent=verdict.sent,
            echo=echo,
            link_up=rig.board.link_up,
            events=self._take_events(verdict),
            ticks_skipped=skipped,
            late_s=late_s,
            decide_ms=decide_ms,
            forecasts=forecasts,
            skill=skill,
            drift=drift,
        )
        self._hand_out(record)
        return record

    def _context(self, estimate: Estimate, now: float, utc: float) -> Context:
        rig = self._rig
        limits = planning_limits(self._memory, rig.settings.safety, now, self._step_s, rig.box)
        since_s = now - self._reference_start_s()
        moment = TickTime(now, utc, since_s, seconds_of_day(utc, rig.zone), self._step_s)
        history = rig.estimator.history()
        return context_of(moment, self._operation, rig.reference, history, estimate, self._sent, limits)

    def _reference_start_s(self) -> float:
        """Return when the configured reference began: at this start, if it was another one before."""
        start = self._operation.reference_start
        return start[1] if start is not None and start[0] == self._rig.reference.sha256 else self._start_s

    def _end_steering(self, now: float, utc: float) -> None:
        """Expire the operator's request and emit one event."""
        ended = self._operation.steering
        if ended is None or self._operation.steering_at(utc) is not None:
            return
        self._operation = replace(self._operation, steering=None, before=None)
        self._rig.save_state(self._operation, self._memory)
        self._tell("steering.ended", Severity.INFO, f"{ended.id} has ended: {ended.words}", now)

    def _follow_profile(self, now: float, utc: float) -> None:
        """Count the profile's time, but not while a person holds everything off."""
        passed_s, self._followed_s = now - self._followed_s, now
        before, operation = self._operation.profile, self._operation
        if before is None or operation.emergency_stop or operation.in_maintenance(utc):
            return
        after = before.later(passed_s)
        self._operation = replace(operation, profile=after)
        if after.is_due(before):
            self._rig.save_state(self._operation, self._memory)
        if after.is_over and not before.is_over:
            text = f"the profile {after.name} is over; its last target, {after.targets_c[-1]:g} °C, holds"
            self._tell("profile.over", Severity.INFO, text, now)

    def _follow_clock(self) -> None:
        """Set the end of a maintenance with the wall clock: hands are inside for as long as was said."""
        now, utc = self._rig.clock.now(), self._rig.clock.utc()
        jump_s = (utc - now) - self._wall_minus_monotonic
        self._wall_minus_monotonic = utc - now
        self._jump_s += jump_s
        until = self._operation.maintenance_until_utc
        if abs(jump_s) <= CLOCK_JUMP_S:
            return
        if until is not None and not has_lost_date(until, utc - jump_s):
            moved = min(max(until + jump_s, 0.0), UTC_MAX)
            self._operation = replace(self._operation, maintenance_until_utc=moved)
        self._rig.save_state(self._operation, self._memory)

    def _end_maintenance(self, now: float, utc: float) -> None:
        """Release the board when the time is over, also where it ended while no daemon ran."""
        operation, board = self._operation, self._rig.board
        if operation.maintenance_until_utc is None or operation.in_maintenance(utc):
            return
        if board.in_maintenance:
            board.end_maintenance()
            board.serve_until_answered(ECHO_TIMEOUT_S)
            self._tell("maintenance.ended", Severity.INFO, "maintenance has ended", now)

    def _apply_orders(self, command: Command, utc: float) -> tuple[Command, tuple[Change, ...]]:
        return apply_orders(self._operation, command, utc, seconds_of_day(utc, self._rig.zone))

    def _with_light_and_water(
        self, command: Command, readings: Mapping[str, Reading], now: float, utc: float
    ) -> Command:
        """Heater and fan are the controller's, light too where it asks for it; else simple rules decide."""
        level = led_level(self._rig.settings.lighting, seconds_of_day(utc, self._rig.zone))
        level = max(level, command.led)
        watering, soil = self._rig.settings.watering, readings.get("soil_moisture")
        pulse_s = watering_pulse(watering, soil, self._memory.doses, now, utc)
        return replace(command, led=level, valve_pulse_s=pulse_s)

    def _take_booking(self) -> Booking | None:
        """Return the dose that the last tick has booked, and take it back: this tick decides on it."""
        booking, self._booking = self._booking, None
        doses = tuple(dose for dose in self._memory.doses if booking is None or dose is not booking[0])
        self._memory = replace(self._memory, doses=doses)
        return booking

    def _book(self, verdict: SafetyVerdict, booking: Booking | None) -> SafetyVerdict:
        """Hold a pulse back until its dose is on the disk: no kills can give more than the dose of a day."""
        pulse_s = verdict.sent.valve_pulse_s
        answers = booking[1] if booking and pulse_s <= booking[0].length_s else ["not booked"]
        if pulse_s == 0.0 or answers == [""]:
            return verdict
        if answers:  # a failure; else the disk has not answered yet
            answers = []
            self._rig.save_state(self._operation, self._memory, answers.append)
        self._booking = self._memory.doses[-1], answers
        change = Change("valve.unsaved", "valve_pulse", pulse_s, 0.0, "its dose goes to the disk first")
        sent = replace(verdict.sent, valve_pulse_s=0.0)
        return replace(verdict, sent=sent, changes=(*verdict.changes, change))

    def _supervise(
        self, wanted: Command, readings: Mapping[str, Reading], estimate: Estimate, now: float, utc: float
    ) -> SafetyVerdict:
        rig = self._rig
        view = SafetyView(
            readings=readings,
            estimate=estimate,
            echo=rig.board.echo,
            link_up=rig.board.link_up,
            emergency_stop=self._operation.emergency_stop,
            maintenance=self._operation.in_maintenance(utc),
            now_s=now,
            utc=utc,
            dt_s=self._step_s,
            box=rig.box,
            air_doubt=rig.sensors.air_doubt,
            is_foreign=bool(rig.foreign_board()),
        )
        verdict = supervise(wanted, view, self._memory, rig.settings.safety)
        if not survives_as(verdict.memory, self._memory):
            rig.save_state(self._operation, verdict.memory)
        self._memory = verdict.memory
        return verdict

    def _drive(self, verdict: SafetyVerdict) -> Echo | None:
        """Send what safety allows; what the board confirms is what counts from here on."""
        board = self._rig.board
        board.drive(verdict.sent, verdict.open_cutoff, self._step_s)
        echo = board.serve_until_echo(min(ECHO_TIMEOUT_S, self._step_s / 2)) if board.link_up else None
        self._sent = Command()
        if echo is not None:
            self._sent = Command(echo.heater_duty, echo.fan_on, echo.led, fan_share=echo.fan_share)
        return echo

    def _note_conditions(
        self,
        readings: Mapping[str, Reading],
        estimate: Estimate,
        echo: Echo | None,
        late_s: float,
        now: float,
        utc: float,
    ) -> None:
        air = readings.get("temp_air")
        quality = ReadingQuality.ABSENT if air is None else air.quality
        link_up, foreign = self._rig.board.link_up, self._rig.foreign_board()
        note = self._conditions.set
        note("reading.not_good", quality is not ReadingQuality.GOOD, now, utc, quality.value)
        doubt = self._rig.sensors.air_doubt
        note("air.jump_contradicted", doubt is not None, now, utc, doubt.words if doubt else "")
        heats = self._rig.settings.safety.heater_max_duty > 0.0
        note("heater.unknown_power", heats and not self._rig.box.heater_w > 0.0, now, utc)
        pair = self._rig.board.air_pair
        apart = pair is not None and pair.are_apart
        note("air_sensors.apart", apart, now, utc, _witness(pair, air, estimate) if pair and apart else "")
        note("air_sensors.alone", pair is not None and pair.is_alone, now, utc)
        note("board.foreign", bool(foreign), now, utc, foreign)
        note("board.link_down", not link_up and not foreign, now, utc)
        note("board.no_echo", link_up and echo is None, now, utc)
        note("tick.late", late_s > LATE_SHARE * self._step_s, now, utc, f"{late_s:.2f} s")
        note("clock.jumped", abs(self._jump_s) > CLOCK_JUMP_S, now, utc, f"by {self._jump_s:+.0f} s")
        self._jump_s = 0.0
        faults = {key: detail for sink in self._rig.sinks for key, detail in sink.faults().items()}
        for key in SINK_FAULTS:
            note(key, key in faults, now, utc, faults.get(key, ""))

    def _take_events(self, verdict: SafetyVerdict) -> tuple[Event, ...]:
        rig = self._rig
        return (
            *self._events.take(),
            *rig.board.take_events(),
            *self._decider.take_events(),
            *verdict.events,
            *(rig.drift.take_events() if rig.drift else ()),
            *rig.more_events(),
            *self._conditions.take_events(),
        )

    def _hand_out(self, record: TickRecord) -> None:
        self._seq += 1
        self.last_record = record
        for sink in self._rig.sinks:
            sink.write(record)
        self._show()
        self._rig.after_tick(record)

    def _stop_board(self) -> None:
        """Pass stops of an earlier process on: the link's first requests, before any command."""
        if self._operation.emergency_stop:
            self._rig.board.emergency_stop()
        if self._operation.in_maintenance(self._rig.clock.utc()):
            self._rig.board.maintain()

    def _wait_for_board(self) -> None:
        """Give the board a moment to greet: a first tick without readings would be a tick of alarms."""
        board, clock = self._rig.board, self._rig.clock
        give_up_s = clock.now() + START_WAIT_S
        while not self._stopping and not (board.link_up and board.has_samples) and clock.now() < give_up_s:
            self._serve_and_answer(min(give_up_s, clock.now() + 0.1))
        self._start_s = clock.now()

    def _serve_until(self, tick_s: float) -> bool:
        """Keep the line alive and answer requests until the tick is due; False when the loop shall end."""
        while not self._stopping and self._rig.clock.now() < self._rig.stop_at_s:
            self._serve_and_answer(min(tick_s, self._rig.stop_at_s))
            if self._rig.clock.now() >= tick_s:
                return not self._stopping
        return False

    def _serve_and_answer(self, until_s: float) -> None:
        self._rig.board.serve(until_s, self._rig.inbox.wake, self._has_news)
        # One at a time: the line is served, and a stop overtakes, between two of a flood.
        if (letter := self._rig.inbox.take()) is not None:
            self._answer(letter)
        if self._has_news():
            self._show()

    def _outputs(self) -> tuple[bool, Echo | None]:
        return self._rig.board.link_up, self._rig.board.echo

    def _has_news(self) -> bool:
        """Return whether the board's outputs differ from those published last."""
        (link_up, echo), (link_shown, shown) = self._outputs(), self._shown
        return link_up != link_shown or not (echo is shown or (echo is not None and echo.drives_as(shown)))

    def _show(self) -> None:
        self._shown = self._outputs()
        self._rig.show(self.status())

    def _answer_urgent(self) -> None:
        """Obey stop and maintenance while a controller thinks; the tick ends under the new orders."""
        if (letter := self._rig.inbox.take(ORDINARY)) is not None:  # one: a flood must not hold up the tick
            self._answer(letter)

    def _answer(self, letter: Letter) -> None:
        """Carry out a request or refuse it with the reason; a change is answered when it is on disk."""
        request = letter.request
        try:
            match request.get("do"):
                case "status":
                    read_request(NoKeys, request)
                    letter.answer.put({"ok": True, STATUS: self.status()})
                    return
                case "clear_trip":
                    read_request(NoKeys, request)
                    said = self._clear_trip(request)
                case "accept_board":
                    read_request(NoKeys, request)
                    said = self._answer_keys(*self._rig.accept_board(), "", request)
                case _:
                    said = self._order(request)
        except RequestError as error:
            letter.answer.put({"ok": False, "error": str(error)})
            return
        reply: Reply = {"ok": True, **said, STATUS: self.status()}
        self._show()
        # The state writer's thread answers: this one never waits for the disk.
        self._rig.save_state(
            self._operation, self._memory, lambda error: letter.answer.put(_as_saved(reply, error))
        )

    def status(self) -> LoopStatus:
        """Standing orders, the last tick, what the board drives now, the line's counters."""
        board, now, operation = self._rig.board, self._rig.clock.now(), self._operation
        utc, configured = self._rig.clock.utc(), self._rig.settings.calibration
        if self.last_record is not None:  # the first tick waits for a sample
            self._rig.sensors.take(board.take_samples())
        raw = partial(self._rig.sensors.raw, now=now)
        return LoopStatus(
            operation.at(min(utc, self.last_record.utc if self.last_record else utc)),  # a tick ends them
            now - self._start_s,
            self._memory.trips,
            self.last_record,
            board.echo,
            board.link_up,
            dict(board.statistics),
            self._conditions.standing(),
            tuple(states(operation.points, operation.calibrations, configured, raw)),
            now - self._reference_start_s(),
            self._rig.foreign_board(),
        )

    def _order(self, request: Request) -> Reply:
        """Change the standing orders, and return the answer's keys. The board gets a repeated stop again."""
        clock = self._rig.clock
        self._follow_clock()
        self._follow_profile(clock.now(), clock.utc())
        before, of_board = self._operation, self._board_trip()
        after = operate(before, request, self._desk())
        if is_released(before, after):
            until_s = max(self._memory.releases_until_s, clock.now()) + RELEASE_EVERY_S
            if until_s - clock.now() > RELEASES * RELEASE_EVERY_S:
                raise RequestError(RELEASED_TOO_OFTEN)
            self._memory = replace(self._memory, releases_until_s=until_s)
        self._operation = after
        warning = self._order_board(request)
        changed, message = order_words(request["do"], before, after, clock.utc())
        if not changed and of_board == ENDED_BY.get(request["do"]) and not request.get("minutes"):
            changed, message = True, f"The board's {of_board.replace('_', ' ')} is over."
        said = self._answer_keys(changed, message, warning, request)
        self._follow_calibration(before)
        if acts_at_once(before, self._operation):
            self._act_now()
        return said

    def _answer_keys(self, changed: bool, message: str, warning: str, request: Request) -> Reply:
        """Return an answer's keys, and record an order that changed something."""
        if changed:
            kind = request["do"] if request["do"] in ("clear_trip", "accept_board") else "order"
            text, now = with_author(message, request), self._rig.clock.now()
            self._tell(f"operator.{kind}", Severity.INFO, text, now)
        return {"changed": changed, "message": message} | ({"warning": warning} if warning else {})

    def _board_trip(self) -> str:
        """Return why the board has tripped, "" where it has not."""
        echo = self._rig.board.echo
        return echo.trip_cause if echo is not None and echo.tripped else ""

    def _calibration(self) -> CalibrationSettings:
        return in_force(self._rig.settings.calibration, self._operation.calibrations)

    def _follow_calibration(self, before: Operation) -> None:
        """Go on as if another calibration had always held: the jump is neither heat nor a fault."""
        rig, now = self._rig, self._rig.clock.now()
        for point in self._operation.points[len(before.points) :]:
            self._tell("calibration.point", Severity.INFO, point_words(point), now)
        if self._operation.calibrations == before.calibrations:
            return
        changes = rig.sensors.calibrate(self._calibration(), now)
        for change in changes:
            rig.estimator.recalibrate(change)
            self._tell("calibration.changed", Severity.INFO, change.in_words(), now)
        jumps = {change.signal: change.jump for change in changes}
        air_k, room_k = jumps.get("temp_air", 0.0), jumps.get("temp_ambient", 0.0)
        self._memory = follow_calibration(self._memory, air_k, room_k)
        rig.models.begin_anew()
        if rig.drift is not None:
            rig.drift.begin_anew()

    def _raw_minute(self, signal: str) -> RawMinute:
        self._rig.sensors.take(self._rig.board.take_samples())
        return self._rig.sensors.minute(signal, self._rig.clock.now())

    def _order_board(self, request: Request) -> str:
        """Pass a stop or its end on to the board, before anything else; return why it has not confirmed."""
        board = self._rig.board
        match request["do"]:
            case "emergency_stop":
                board.emergency_stop()
            case "release_emergency_stop":
                board.release_stop()
            case "maintenance" if self._operation.maintenance_until_utc is not None:
                board.maintain()
            case "maintenance":
                board.end_maintenance()
            case "clear_trip":
                board.clear_trip()
            case _:
                return ""
        if board.serve_until_answered(ECHO_TIMEOUT_S):
            return ""
        no_link = ANOTHER_BOARD if self._rig.foreign_board() else NOT_REACHED
        return "the board has not confirmed it yet" if board.link_up else no_link

    def _desk(self) -> Desk:
        settings = self._rig.settings
        limits = settings.reference
        names, echo = tuple(self._rig.controllers), self._rig.board.echo
        return Desk(
            self._rig.clock.utc(),
            names,
            limits.min_c,
            limits.max_c,
            settings.control.controller,
            settings.unready,
            SensorDesk(
                settings.calibration,
                self._raw_minute,
                settings.safety.temp_air_max_c,
                echo is None or echo.heater_duty > 0.0,
            ),
        )

    def _clear_trip(self, request: Request) -> Reply:
        trips, of_board = self._memory.trips, self._board_trip()
        self._memory = clear_trip(self._memory, self._rig.settings.safety, self._temp_air())
        doubt, self._rig.sensors.air_doubt = self._rig.sensors.air_doubt, None
        warning, left = self._order_board(request), self._board_trip()
        causes = dict.fromkeys(each for each in (*trips, of_board) if each not in ("", *ENDED_BY.values()))
        changed, message = bool(causes), f"Trips are cleared: {', '.join(causes)}."
        if left in causes:
            changed, message = bool(trips), f"The board holds its trip, {left}, as long as its cause lasts."
        elif not causes and doubt is not None:
            changed, message = True, "The measured air temperature is accepted."
        elif not causes:
            message = "Nothing changed: no trip is latched."
        return self._answer_keys(changed, message, warning, request)

    def _act_now(self) -> None:
        """Apply new orders to the last decision at once, not a step later; an event, not a tick, says so."""
        record = self.last_record
        if record is None:
            return
        rig, now, utc = self._rig, self._rig.clock.now(), self._rig.clock.utc()
        readings = rig.sensors.readings(rig.board.take_samples(), now, self._sent)
        command = replace(record.decision.command, led=record.wanted.led)
        wanted, _ = self._apply_orders(command, utc)
        verdict = self._supervise(wanted, readings, record.estimate, now, utc)
        echo = self._drive(verdict)
        rig.estimator.record_sent(self._sent)
        self._events.add(*verdict.events)
        rules = ", ".join(dict.fromkeys(change.rule for change in verdict.changes)) or "unchanged by safety"
        driven = verdict.sent if echo is None else echo
        outputs = f"heater {driven.heater_duty:.2f}, fan {fan_in_words(driven.fan)}"
        who = "sent at once, not confirmed" if echo is None else "at once, confirmed by the board"
        self._tell("operator.sent", Severity.INFO, f"{who}: {outputs}; {rules}", now)

    def _temp_air(self) -> float | None:
        reading = self.last_record.readings.get("temp_air") if self.last_record else None
        return reading.value if reading is not None and reading.quality is ReadingQuality.GOOD else None

    def _shut_down(self) -> None:
        self._rig.save_state(self._operation, self._memory)
        self._rig.board.drive(Command(), False, 0.0)
        if self._rig.board.link_up:
            self._rig.board.serve_until_echo(ECHO_TIMEOUT_S)

    def _tell(self, key: str, severity: Severity, text: str, now: float) -> None:
        self._events.add(Event(key, severity, text, now, self._rig.clock.utc()))


def _as_saved(reply: Reply, error: str) -> Reply:
    """Return the reply to a change that the disk has taken, or has not."""
    if not error:
        return reply
    return {
        **reply,
        "ok": False,
        "error": f"in force now, but it will not survive a restart: not saved, {error}",
    }


def _witness(pair: AirSensorPair, air: Reading | None, estimate: Estimate) -> str:
    """Return what each of two air sensors shows, and which one the model's forecast for now speaks for."""
    assert pair.first is not None and pair.second is not None
    expected = estimate.temp_air  # without a measurement that is the model's forecast
    if estimate.innovation is not None and air is not None and air.value is not None:
        expected = air.value - estimate.innovation
    said = f"{pair.first:.1f} and {pair.second:.1f} °C"
    if not math.isfinite(expected):
        return said
    nearer = "first" if abs(pair.first - expected) < abs(pair.second - expected) else "second"
    return f"{said}; the model expected {expected:.1f} °C, so the {nearer} one is likely right"
