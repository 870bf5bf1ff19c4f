"""Link and board together over bad lines: what is acknowledged was done once, and heat ends by itself."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest
from exchange import STEP_MS, Exchange
from hypothesis import given, settings
from hypothesis import strategies as st
from line import BytewiseLine, CutLine, DelayedLine, DuplicatingLine, GoodLine, LossyLine, NoisyLine

from firmware_protocol.link import BoardReset, LinkEcho, LinkLost, LinkUp, Report, RequestTimedOut
from firmware_protocol.messages import ClearTrip, CommandMessage, EmergencyStop, HeaterOffCause, TripCause

pytestmark = pytest.mark.slow

LEASE_S = 5.0
LINES: dict[str, Callable[[int], GoodLine]] = {
    "good": lambda seed: GoodLine(),
    "3 bytes in 10 ms": lambda seed: BytewiseLine(3),
    "200 ms late": lambda seed: DelayedLine(0.2),
    "900 ms late": lambda seed: DelayedLine(0.9),
    "every other frame twice": lambda seed: DuplicatingLine(seed),
    "noise between": lambda seed: NoisyLine(seed, 0.02),
    "1 % of bytes lost": lambda seed: LossyLine(seed, drop=0.01),
    "1 % of bytes flipped": lambda seed: LossyLine(seed, flip=0.01),
    "0.5 % of everything": lambda seed: LossyLine(seed, drop=0.005, flip=0.005, insert=0.005),
    "cut for 20 s": lambda seed: CutLine(10.0, 30.0),
}


def heat(number: int, lease_s: float = LEASE_S) -> CommandMessage:
    """Full heat; the number (up to 9999) makes each command another."""
    return CommandMessage(20, True, number % 100, number // 100 / 10, False, lease_s)


@dataclass
class ExchangeRun:
    """A host that asks for heat every half second, and what must hold whatever the line does."""

    exchange: Exchange
    asked: list[CommandMessage] = field(default_factory=list)
    heated_ms: int = 0

    def run(self, seconds: float, ask: bool = True) -> None:
        for _ in range(round(seconds * 1000 / STEP_MS)):
            exchange = self.exchange
            if ask and exchange.now_ms % 500 == 0 and exchange.link.state == "up":
                self.asked.append(heat(len(self.asked)))
                exchange.request(self.asked[-1])
            if exchange.step().heater_relay:
                self.heated_ms += STEP_MS
                obeyed_ms, command = exchange.obeyed[-1]
                assert command.heater_steps > 0
                assert exchange.now_ms - obeyed_ms < command.lease_s * 1000

    def acknowledged(self) -> list[CommandMessage]:
        return [
            event.request
            for event in self.exchange.events
            if isinstance(event, LinkEcho) and isinstance(event.request, CommandMessage)
        ]

    def check_exactly_once(self) -> None:
        obeyed = Counter(command for _, command in self.exchange.obeyed)
        acknowledged = Counter(self.acknowledged())
        assert set(obeyed) <= set(self.asked)
        assert max([*obeyed.values(), *acknowledged.values()], default=1) == 1
        assert set(acknowledged) <= set(obeyed)


def test_a_good_line_heats_acknowledges_and_reports_every_second() -> None:
    exchange = Exchange()
    exchange.run(1.5)
    exchange.request(heat(1, 10.0))
    exchange.run(9.0)
    assert [type(event) for event in exchange.events if isinstance(event, LinkUp)] == [LinkUp]
    assert sum(isinstance(event, Report) for event in exchange.events) == 10
    assert exchange.pins is not None
    assert exchange.pins.heater_relay


@pytest.mark.parametrize("name", LINES)
@pytest.mark.parametrize("way", ["to the board", "to the host", "both ways"])
def test_over_any_line_the_link_comes_up_and_every_acknowledged_command_was_obeyed_once(
    name: str, way: str
) -> None:
    make = LINES[name]
    exchange = Exchange(
        to_board=make(1) if way != "to the host" else GoodLine(),
        to_host=make(2) if way != "to the board" else GoodLine(),
    )
    run = ExchangeRun(exchange)
    run.run(40.0)
    run.check_exactly_once()
    assert run.heated_ms > 5000
    assert len(run.acknowledged()) > 20 or "900" in name
    run.run(LEASE_S, ask=False)  # what is still on its way may be obeyed
    run.run(LEASE_S, ask=False)
    assert exchange.pins is not None
    assert not exchange.pins.heater_relay


@settings(max_examples=25, deadline=None)
@given(
    seeds=st.tuples(st.integers(0, 2**16), st.integers(0, 2**16)),
    rates=st.tuples(*[st.sampled_from([0.0, 0.01, 0.05, 0.3, 1.0])] * 6),
    resets=st.sets(st.integers(1, 19)),
    clock_start_ms=st.sampled_from([0, 2**31 - 5000, 2**32 - 5000]),
)
def test_whatever_is_lost_the_heater_is_off_within_a_lease_of_the_last_obeyed_command(
    seeds: tuple[int, int], rates: tuple[float, ...], resets: set[int], clock_start_ms: int
) -> None:
    exchange = Exchange(
        to_board=LossyLine(seeds[0], *rates[:3]),
        to_host=LossyLine(seeds[1], *rates[3:]),
        clock_start_ms=clock_start_ms,
    )
    run = ExchangeRun(exchange)
    for second in range(20):
        if second in resets:
            exchange.reset_board()
            assert not exchange.core.step(clock_start_ms + exchange.now_ms).heater_relay
        run.run(1.0)
    run.check_exactly_once()


@pytest.mark.parametrize("cut_host", [True, False])
def test_a_cut_line_is_noticed_within_seconds_and_ends_the_heat_within_the_lease(cut_host: bool) -> None:
    exchange = Exchange()
    run = ExchangeRun(exchange)
    run.run(10.0)
    cut = CutLine(10.0, 100.0)
    if cut_host:
        exchange.to_host = cut
    else:
        exchange.to_board = cut
    run.run(4.0)
    assert exchange.link.state == "down"
    assert any(isinstance(event, LinkLost) for event in exchange.events)
    run.run(LEASE_S)
    assert exchange.pins is not None
    assert not exchange.pins.heater_relay


def test_a_line_that_comes_back_is_used_again() -> None:
    exchange = Exchange(to_board=CutLine(5.0, 60.0), to_host=CutLine(5.0, 60.0))
    run = ExchangeRun(exchange)
    run.run(59.0)
    assert exchange.link.state == "down"
    run.run(3.0)
    assert exchange.link.state == "up"


def test_a_reset_ends_the_heat_at_once_and_is_told_once() -> None:
    exchange = Exchange()
    run = ExchangeRun(exchange)
    run.run(10.0)
    exchange.reset_board()
    assert not exchange.step().heater_relay
    exchange.run(2.0)
    told = [event.hello.boot_count for event in exchange.events if isinstance(event, BoardReset)]
    assert told == [1, 2]
    assert exchange.link.state == "up"
    assert exchange.pins is not None
    assert not exchange.pins.heater_relay


def test_a_reset_whose_hello_is_lost_is_found_by_the_next_command() -> None:
    exchange = Exchange()
    exchange.run(5.0)
    exchange.reset_board()
    exchange.core.transmit()  # the line swallows it
    exchange.request(heat(1))
    events = exchange.run(1.0)
    assert [event.hello.boot_count for event in events if isinstance(event, BoardReset)] == [2]
    assert exchange.link.state == "up"
    assert exchange.obeyed == []


def test_a_host_that_restarts_is_not_taken_for_a_repetition_of_the_old_one() -> None:
    exchange = Exchange()
    exchange.run(2.0)
    exchange.request(heat(1))
    exchange.run(0.1)
    exchange.link = type(exchange.link)(session=99, now=exchange.now)
    exchange.run(0.1)
    exchange.request(heat(2))  # with the seq of the old host's command
    exchange.run(0.1)
    assert [command for _, command in exchange.obeyed] == [heat(1), heat(2)]


def test_a_trip_is_told_unasked_and_cleared_only_when_cool() -> None:
    exchange = Exchange(temp_air=46.0)
    events = exchange.run(3.0)
    causes = [event.state.trip_cause for event in events if isinstance(event, LinkEcho)]
    assert causes[-1] is TripCause.OVER_TEMPERATURE
    exchange.temp_air = 30.0
    exchange.run(1.0)
    exchange.request(ClearTrip())
    events = exchange.run(0.5)
    assert [event.state.tripped for event in events if isinstance(event, LinkEcho)] == [False]


@pytest.mark.parametrize("name", LINES)
def test_an_emergency_stop_gets_through_every_line_that_lets_anything_through(name: str) -> None:
    exchange = Exchange(to_board=LINES[name](3), to_host=LINES[name](4))
    run = ExchangeRun(exchange)
    run.run(9.0)
    for _ in range(40):
        if exchange.link.state == "up":
            exchange.request(EmergencyStop())
        exchange.run(2.0)
        if any(isinstance(e, LinkEcho) and isinstance(e.request, EmergencyStop) for e in exchange.events):
            break
    assert exchange.core.step(exchange.now_ms).heater_relay is False
    echoes = [event.state for event in exchange.events if isinstance(event, LinkEcho)]
    assert echoes[-1].trip_cause is TripCause.EMERGENCY_STOP
    assert echoes[-1].heater_off_cause is HeaterOffCause.TRIPPED


def test_a_one_way_line_never_makes_an_old_answer_count_for_a_new_command() -> None:
    exchange = Exchange()
    exchange.run(2.0)
    exchange.request(heat(0))
    exchange.run(0.5)
    exchange.to_board = CutLine(0.0, 1e9)  # the board is still heard
    run = ExchangeRun(exchange)
    run.run(600.0)  # more requests than there are sequence numbers
    assert run.acknowledged() == [heat(0)]
    assert not any(isinstance(event, RequestTimedOut) for event in exchange.events[-20:])
