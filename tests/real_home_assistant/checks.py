"""Checks of a rig in a real Home Assistant; each raises AssertionError, and says what it has measured."""

import time
from collections.abc import Callable, Iterator
from typing import Any

from home_run import LIMIT_S, RIG, Holds, HomeRun

from edge.config import loading as config
from edge.mqtt import discovery
from tests.support.broker import wait_for

ENTITIES_S = 90.0  # the first tick may come before the board's first report: values come with the second
WISH = "keep 26 by day and 20 at night, go easy on the fan"
# Complaints of Home Assistant about how it was installed here.
NOT_OURS = ("Skipping pip installation", "zlib_ng and isal are not available", "[haffmpeg.")
# No value before something happens: a first event or answer, a judged twin, an hour of forecasts.
UNKNOWN_AT_FIRST = ("last_event", "last_answer", "twin_disagrees", "error_", "skill_")
SIDES = ("Home Assistant", "the rig")


def check_entities(run: HomeRun, when: str, begin: float) -> None:
    """Every announced entity is there, with its unit, class, icon and a value; no other is."""
    wanted = components(run)
    ids = {component["default_entity_id"] for component in wanted.values()}
    while bad := faults(run, wanted):
        assert time.monotonic() - begin < ENTITIES_S, bad
        time.sleep(0.1)
    found = {id for id in run.home.states() if RIG.replace("-", "_") in id}
    assert found == ids, found ^ ids  # none that is retired or disabled
    run.say(f"{when}: {len(ids)} entities valid after {time.monotonic() - begin:.1f} s")


def faults(run: HomeRun, wanted: dict[str, dict[str, Any]]) -> list[str]:
    """Return a line for each entity that is not as announced."""
    states = run.home.states()
    return [
        f"{key}: {fault}"
        for key, component in wanted.items()
        for fault in _entity_faults(key, component, states.get(component["default_entity_id"]))
    ]


def _entity_faults(key: str, component: dict[str, Any], entity: dict[str, Any] | None) -> Iterator[str]:
    if entity is None:
        yield "missing"
        return
    attributes = entity["attributes"]
    for name in ("unit_of_measurement", "device_class", "icon", "state_class"):
        if attributes.get(name) != component.get(name):
            yield f"{name} is {attributes.get(name)}, announced was {component.get(name)}"
    if "icon" not in attributes and "device_class" not in attributes:
        yield "no icon"
    if (entity["state"] == "unavailable") != (key in ("confirm_proposal", "discard_proposal")):
        yield entity["state"]
    may_be_unknown = component["platform"] == "button" or key.startswith(UNKNOWN_AT_FIRST)
    if entity["state"] == "unknown" and not may_be_unknown:
        yield "unknown"


def components(run: HomeRun) -> dict[str, dict[str, Any]]:
    """Return the components that a new Home Assistant enables, by key."""
    announced = discovery.device(config.load(run.daemon.config))["components"]
    return {
        key: component
        for key, component in announced.items()
        if "unique_id" in component and component.get("enabled_by_default", True)
    }


def check_climate(run: HomeRun) -> None:
    """Set point, preset, mode and fan, from both sides."""
    climate = "climate.climate"

    def pair(what: str, service: str, key: str, ours: Any, theirs: Any, do: tuple[str, str]) -> None:
        name = "temperature" if what == "set point" else what

        def shows(value: Any) -> bool:
            return bool(
                run.state(climate) == value if name == "hvac_mode" else run.attribute(climate, name) == value
            )

        run.order(
            f"{what} {theirs} by Home Assistant",
            lambda: run.call(f"climate.{service}", climate, **{name: theirs}),
            lambda: run.operation()[key] == theirs,
            lambda: shows(theirs),
        )
        run.order(
            f"{what} {ours} by the rig",
            lambda: run.daemon.ask(do[0], **{do[1]: ours}),
            lambda: run.operation()[key] == ours,
            lambda: shows(ours),
        )

    pair("set point", "set_temperature", "reference_c", 25.0, 27.5, ("set_reference", "reference_c"))
    pair("preset_mode", "set_preset_mode", "controller", "rules", "PID", ("set_controller", "name"))
    for ours, theirs in (("heat", "off"), ("auto", "fan_only"), ("auto", "heat")):
        pair("hvac_mode", "set_hvac_mode", "mode", ours, theirs, ("set_mode", "mode"))
    for ours, theirs in (("off", "on"), ("on", "auto"), ("auto", "off")):
        pair("fan_mode", "set_fan_mode", "fan_mode", ours, theirs, ("set_fan_mode", "fan_mode"))
    run.order(
        "the schedule again by Home Assistant",
        lambda: run.call("button.press", "button.follow_schedule"),
        lambda: run.operation()["reference_c"] is None,
        lambda: run.attribute(climate, "temperature") == 32.0,
    )


def check_switches(run: HomeRun) -> None:
    """Emergency stop and maintenance: everything is off at the board, and shown."""
    wait_for(lambda: not _is_off(run), "the rig heats before it is stopped")
    _check_switch(
        run,
        "emergency stop",
        "switch.stop",
        lambda: run.operation()["emergency_stop"],
        (("emergency_stop", {}), ("release_emergency_stop", {})),
    )
    _check_switch(
        run,
        "maintenance",
        "switch.maintenance",
        lambda: run.operation()["maintenance_until_utc"] is not None,
        (("maintenance", {"minutes": 30.0}), ("maintenance", {"minutes": 0.0})),
    )


def _check_switch(
    run: HomeRun, name: str, id: str, holds: Holds, orders: tuple[tuple[str, Any], tuple[str, Any]]
) -> None:
    """Turn on and off by each side. orders : the rig's own, that for on and that for off"""
    for side in SIDES:
        for is_on, (do, values) in zip((True, False), orders, strict=True):

            def by_home(is_on: bool = is_on) -> None:
                run.call("switch.turn_on" if is_on else "switch.turn_off", id)

            def by_rig(do: str = do, values: Any = values) -> None:
                run.daemon.ask(do, **values)

            def obeyed(is_on: bool = is_on) -> bool:
                return holds() is is_on and (_is_off(run) or not is_on)

            run.order(
                f"{name} {'on, all off' if is_on else 'off'} by {side}",
                by_home if side == SIDES[0] else by_rig,
                obeyed,
                lambda is_on=is_on: run.state(id) == ("on" if is_on else "off"),
            )


def _is_off(run: HomeRun) -> bool:
    pins = run.board.truth()["pins"]
    return not pins["heater_relay"] and not pins["fan"]


def check_manual(run: HomeRun) -> None:
    """Manual heater duty."""
    run.order(
        "manual heater duty 40 % by Home Assistant",
        lambda: run.call("number.set_value", "number.manual_heater_duty", value=40),
        lambda: run.operation()["manual"]["heater_duty"] == 0.4 and run.operation()["mode"] == "manual",
        lambda: float(run.state("number.manual_heater_duty")) == 40.0,
    )
    run.daemon.ask("set_mode", mode="auto")


def check_words(run: HomeRun) -> None:
    """Ask, confirm, undo and discard, from both sides; at last a proposal waits, for the picture."""
    for side in SIDES:
        words = Words(run, side)
        id = words.ask_and_read()
        text = run.state("sensor.proposal")
        assert text.startswith("reference every day: 26 °C from 06:00, 20 °C from 22:00"), text
        assert len(run.attribute("sensor.proposal", "lines")) > 3
        words.confirm(id)
        words.undo()
        words.discard(words.ask_and_read())
    check_unread(run)
    words = Words(run, SIDES[0])
    words.discard(run.attribute("sensor.proposal", "id"))
    run.daemon.ask("set_controller", name="MPC-Twin-P")
    words.ask_and_read()


def check_unread(run: HomeRun) -> None:
    """A press within a second of a new proposal was meant for the one before, and confirms nothing."""
    words = Words(run, SIDES[1])
    id = words.shown_id()
    run.daemon.ask("ask", words=WISH)
    wait_for(lambda: words.shown_id() != id and words.stage() == "ready", "a proposal", 60.0)
    run.call("button.press", "button.confirm_proposal")
    wait_for(lambda: "no proposal is named" in run.state("sensor.last_answer"), "the refusal", LIMIT_S)
    assert run.operation()["steering"] is None
    time.sleep(discovery.READ_S)
    run.say("  a proposal that nobody can have read yet is not confirmed, and the refusal is shown")


class Words:
    """Requests in words, given by one side."""

    def __init__(self, run: HomeRun, side: str) -> None:
        self._run, self._side = run, side
        self._is_home = side == SIDES[0]

    def shown_id(self) -> Any:
        """Return the id of the proposal that Home Assistant shows."""
        return self._run.attribute("sensor.proposal", "id")

    def stage(self) -> Any:
        """Return how far it is: thinking, ready, confirmed..."""
        return self._run.attribute("sensor.proposal", "stage")

    def ask_and_read(self) -> Any:
        """Ask, wait for the proposal, and take the time that a person needs to read; return its id."""
        run, before = self._run, self.shown_id()

        def is_new() -> bool:
            return bool(self.shown_id() != before)

        def by_home() -> None:
            run.call("text.set_value", "text.ask", value=WISH)

        def by_rig() -> None:
            run.daemon.ask("ask", words=WISH)

        give = by_home if self._is_home else by_rig
        run.order(f"ask by {self._side}", give, is_new, lambda: run.state("text.ask") == WISH)
        wait_for(lambda: self.stage() != "thinking", "an answer of the model", 60.0)
        assert self.stage() == "ready", run.state("sensor.proposal")
        time.sleep(discovery.READ_S + 0.1)
        return self.shown_id()

    def confirm(self, id: Any) -> None:
        """Confirm: the buttons are gone then."""
        button = "button.confirm_proposal"

        def is_shown() -> bool:
            return bool(self.stage() == "confirmed" and self._run.state(button) == "unavailable")

        self._press("confirm", button, lambda: (self._steering() or {}).get("id") == id, is_shown, id=id)

    def undo(self) -> None:
        """Take back what was confirmed."""
        self._press("undo", "button.undo", lambda: self._steering() is None, lambda: self.stage() == "undone")

    def discard(self, id: Any) -> None:
        """Discard."""

        def is_discarded() -> bool:
            answer = self._run.daemon.ask("proposal", id=id)
            return bool(answer["proposal"]["state"] == "discarded")

        is_shown: Holds = lambda: self.stage() == "discarded"  # noqa: E731
        self._press("discard", "button.discard_proposal", is_discarded, is_shown, id=id)

    def _steering(self) -> Any:
        return self._run.operation()["steering"]

    def _press(self, do: str, button: str, obeyed: Holds, shown: Holds, **values: Any) -> None:
        def by_home() -> None:
            self._run.call("button.press", button)

        def by_rig() -> None:
            self._run.daemon.ask(do, **values)

        give: Callable[[], None] = by_home if self._is_home else by_rig
        self._run.order(f"{do} by {self._side}", give, obeyed, shown)


def check_availability(run: HomeRun) -> None:
    """After kill -9 every entity is unavailable, and a restart of either side brings them back."""
    ids = [component["default_entity_id"] for component in components(run).values()]

    def all_gone() -> bool:
        states = run.home.states()
        return all(states[id]["state"] == "unavailable" for id in ids)

    begin = time.monotonic()
    run.daemon.kill()
    wait_for(all_gone, "entities unavailable after kill -9", LIMIT_S)
    run.say(f"kill -9 of the daemon: all unavailable after {time.monotonic() - begin:.2f} s")
    begin = time.monotonic()
    run.daemon.start()
    check_entities(run, "after its restart", begin)
    run.home.stop()
    begin = time.monotonic()
    run.home.start()
    check_entities(run, "after a restart of Home Assistant", begin)


def check_log(run: HomeRun) -> None:
    """Refuse every complaint in Home Assistant's log but those on its own installation."""
    complaints = run.home.complaints()
    assert complaints, "its own complaints are missing, so this did not look where they are"
    bad = [line for line in complaints if not any(known in line for known in NOT_OURS)]
    assert not bad, bad
    run.say("no warning and no error in its log about the rig or the dashboard")
