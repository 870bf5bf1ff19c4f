"""The host's own link and a board with a bad line between them: commands get through, silence is safe."""

from itertools import pairwise

import pytest
from board_exchange import BoardExchange
from line import BytewiseLine, CutLine, DelayedLine, DuplicatingLine, GoodLine, LossyLine, NoisyLine

from firmware_protocol.link import BoardReset, LinkEcho, LinkLost, LinkUp, Report, RequestRefused
from firmware_protocol.messages import ClearTrip, CommandMessage, EmergencyStop, ErrorCode

LEASE_S = 5.0
HEATING = CommandMessage(20, True, 60, 0.0, False, LEASE_S)

LINES = {
    "good": lambda seed: GoodLine(),
    "bytewise": lambda seed: BytewiseLine(),
    "delayed": lambda seed: DelayedLine(0.1),
    "duplicating": lambda seed: DuplicatingLine(seed),
    "lossy": lambda seed: LossyLine(seed, drop=0.005, flip=0.005, insert=0.005),
    "noisy": lambda seed: NoisyLine(seed, share=0.01),
}


@pytest.fixture(params=LINES)
def rig(request, new_board):
    line = LINES[request.param]
    return BoardExchange(new_board, line(1), line(2))


def test_the_link_comes_up_and_reports_arrive(rig):
    rig.drive(20)
    assert rig.seen(LinkUp)
    assert {event.report.temp_air_c for event in rig.seen(Report)} <= {None, 25.0}
    assert len(rig.seen(Report)) >= 8


def test_heat_is_held_through_a_bad_line(rig):
    rig.drive(5)
    pins = rig.drive(30, HEATING)[500:]
    assert sum(p.heater_relay for p in pins) > 0.9 * len(pins)
    assert [event.state.heater_steps for event in rig.seen(LinkEcho)].count(20) > 10


def test_the_heater_is_off_one_lease_after_the_host_stops(rig):
    rig.drive(5)
    rig.drive(10, HEATING)
    rig.drive(LEASE_S + 1.5)  # what was on its way may still come: five sends of one request
    assert not any(pins.heater_relay or pins.led for pins in rig.drive(10))


def test_one_pulse_asked_for_is_at_most_one_pulse(rig):
    rig.drive(5)
    asked = CommandMessage(0, False, 0, 0.3, False, LEASE_S)
    openings = 0
    for k in range(5):
        rig.request(asked)
        valve = [False, *(pins.valve for pins in rig.drive(3))]
        openings += sum(now and not before for before, now in pairwise(valve))
        assert openings <= k + 1
    assert openings >= 1


@pytest.mark.parametrize("way", ["to_board", "to_host", "both"])
def test_a_cut_line_turns_the_heater_off_and_comes_back(new_board, way):
    cut = {name: CutLine(10.0, 20.0) for name in ("to_board", "to_host") if way in (name, "both")}
    rig = BoardExchange(new_board, **cut)
    rig.drive(10, HEATING)
    assert rig.pins.heater_relay
    pins = rig.drive(10, HEATING)
    assert rig.seen(LinkLost)
    assert not any(p.heater_relay for p in pins[600:])  # a lease and a second
    rig.drive(5, HEATING)
    rig.drive(3, HEATING)
    assert rig.pins.heater_relay


def test_a_reset_board_heats_only_after_a_new_greeting_and_command(new_board):
    rig = BoardExchange(new_board)
    rig.drive(5, HEATING)
    assert rig.pins.heater_relay
    rig.reset_board()
    assert not rig.drive(0.02)[0].heater_relay
    assert not any(pins.heater_relay for pins in rig.drive(3))
    assert len(rig.seen(BoardReset)) >= 1 and rig.link.state == "up"
    rig.drive(3, HEATING)
    assert rig.pins.heater_relay


def test_a_reset_while_a_command_waits_for_its_answer_is_not_obeyed_twice(new_board):
    rig = BoardExchange(new_board, to_host=CutLine(5.0, 6.0))
    rig.drive(5.0)
    rig.request(HEATING)
    rig.drive(0.1)
    rig.reset_board()
    assert not any(pins.heater_relay or pins.led for pins in rig.drive(5))
    assert rig.seen(RequestRefused)[0].error.code is ErrorCode.NOT_GREETED


def test_an_emergency_stop_gets_through_and_latches(rig):
    rig.drive(5)
    rig.drive(5, HEATING)
    for _ in range(5):
        if rig.link.state == "up":
            rig.request(EmergencyStop())
        rig.drive(1.5)
    assert not any(pins.heater_relay for pins in rig.drive(5, HEATING))
    assert rig.seen(RequestRefused)
    rig.reset_board()
    assert not any(pins.heater_relay for pins in rig.drive(8, HEATING))


def test_a_trip_is_cleared_by_the_host_and_heat_comes_back(new_board):
    rig = BoardExchange(new_board)
    rig.drive(3, HEATING)
    rig.temp_air = 46.0
    assert not any(pins.heater_relay for pins in rig.drive(5, HEATING)[150:])
    rig.temp_air = 25.0
    rig.drive(3, HEATING)
    assert not rig.pins.heater_relay
    rig.request(ClearTrip())
    rig.drive(4, HEATING)
    assert rig.pins.heater_relay
