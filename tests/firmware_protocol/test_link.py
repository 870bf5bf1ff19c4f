"""The host's end of the link, alone: bytes made by hand go in, time is an argument."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.errors import LocalProtocolError
from firmware_protocol.frame import FrameDecoder, encode
from firmware_protocol.link import (
    BoardReset,
    Link,
    LinkEcho,
    LinkEvent,
    LinkLost,
    LinkUp,
    Nonsense,
    Report,
    RequestRefused,
    RequestTimedOut,
    VersionRefused,
)
from firmware_protocol.messages import (
    ClearTrip,
    CommandMessage,
    EmergencyStop,
    ErrorCode,
    ErrorMessage,
    Header,
    HeaterOffCause,
    Hello,
    HelloRequest,
    Maintenance,
    Message,
    Ping,
    ResetCause,
    StateEcho,
    TripCause,
    pack,
    unpack,
)
from firmware_protocol.virtual_board.board_config import BoardConfig
from firmware_protocol.virtual_board.board_samples import Samples

SESSION = 0xFFFFFFFF  # the next one is 0
COMMAND = CommandMessage(10, True, 0, 0.0, False, 10.0)
COLDER = CommandMessage(5, True, 0, 0.0, False, 10.0)
STATE = StateEcho(5, 10, HeaterOffCause.NONE, True, 0, False, False, False, TripCause.NONE, 10.0, None)


def hello(session: int, boot_count: int = 1, protocol_min: int = 2, protocol_max: int = 2) -> Hello:
    values = BoardConfig().hello(session, ResetCause.POWER_ON, boot_count)
    return Hello(values.session, protocol_min, protocol_max, *list(_values(values))[3:])


def _values(message: Hello) -> list[object]:
    return [getattr(message, name) for name in Hello.__dataclass_fields__]


class FarEnd:
    """The far end, by hand: numbers its frames and answers what it is told to."""

    def __init__(self, link: Link) -> None:
        self.link = link
        self.seq = 0

    def heard(self) -> list[tuple[Header, Message]]:
        """Return the host's events now."""
        return [unpack(payload) for payload in FrameDecoder().feed(self.link.outgoing())]

    def says(self, message: Message, now: float, ack: int = 0) -> list[LinkEvent]:
        self.seq = self.seq % 255 + 1
        return self.link.receive(encode(pack(message, self.seq, ack)), now)

    def greeted(self, now: float, boot_count: int = 1) -> list[LinkEvent]:
        """Answers a greeting."""
        self.link.poll(now)
        ((header, request),) = self.heard()
        assert isinstance(request, HelloRequest)
        return self.says(hello(request.session, boot_count), now, header.seq)


@pytest.fixture
def link() -> Link:
    return Link(session=SESSION, now=0.0)


@pytest.fixture
def board(link: Link) -> FarEnd:
    return FarEnd(link)


@pytest.fixture
def up(link: Link, board: FarEnd) -> FarEnd:
    """A board whose link is up at 0 s."""
    board.greeted(0.0)
    return board


def greetings(link: Link, board: FarEnd, end_s: float, reports_at: tuple[float, ...] = ()) -> list[float]:
    """Times of the greetings, polled every tenth of a second, while the board reports at these times."""
    found = []
    for tick in range(round(end_s * 10) + 1):
        now = tick / 10
        if now in reports_at:
            board.says(Samples().report(tick), now)
        link.poll(now)
        heard = board.heard()
        assert all((header.seq, message) == (1, HelloRequest(SESSION)) for header, message in heard)
        found += [now] * len(heard)
    return found


def test_a_board_that_is_heard_is_greeted_every_second_with_one_session_and_seq(
    link: Link, board: FarEnd
) -> None:
    assert greetings(link, board, 4.4, (0.4, 1.4, 2.4, 3.4)) == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_a_board_that_was_lost_is_greeted_every_second_for_a_while(link: Link, up: FarEnd) -> None:
    sent = []
    for tick in range(1, 301):
        link.poll(tick / 10)
        sent += [tick / 10 for _ in up.heard()]
    assert sent == [3.0, 4.0, 5.0, 6.0, 18.0, 30.0]  # heard at 0 s, lost 3 s later


def test_a_board_whose_port_was_closed_may_be_in_its_bootloader(link: Link, up: FarEnd) -> None:
    link.disconnect(1.0)
    sent = []
    for tick in range(10, 141):
        link.poll(tick / 10)
        sent += [tick / 10 for _ in up.heard()]
    assert sent == [1.0, 13.0]


def test_a_silent_board_is_left_in_peace_for_its_bootloader_and_greeted_when_it_speaks(
    link: Link, board: FarEnd
) -> None:
    assert greetings(link, board, 24.5) == [0.0, 12.0, 24.0]
    assert link.next_deadline() == 36.0
    board.says(Samples().report(1), 30.0)
    link.poll(30.0)
    assert [message for _, message in board.heard()] == [HelloRequest(SESSION)]


def test_a_hello_that_answers_the_greeting_brings_the_link_up(link: Link, board: FarEnd) -> None:
    assert board.greeted(0.0) == [LinkUp(hello(SESSION))]
    assert link.state == "up"


@pytest.mark.parametrize("session", [0, 1, SESSION - 1])
def test_a_hello_of_another_session_does_not(link: Link, board: FarEnd, session: int) -> None:
    link.poll(0.0)
    assert board.says(hello(session), 0.1, ack=1) == []
    assert link.state == "down"
    assert link.statistics["stale"] == 1


@pytest.mark.parametrize("ack", [2, 255])
def test_a_hello_that_answers_another_request_does_not(link: Link, board: FarEnd, ack: int) -> None:
    link.poll(0.0)
    assert board.says(hello(SESSION), 0.1, ack) == []
    assert link.state == "down"


@pytest.mark.parametrize("versions", [(1, 1), (3, 9), (0, 0)])
def test_a_board_of_other_versions_is_refused_and_greeted_every_10_s(
    link: Link, board: FarEnd, versions: tuple[int, int]
) -> None:
    link.poll(0.0)
    assert board.says(hello(SESSION, 1, *versions), 0.1, ack=1) == [VersionRefused(*versions)]
    assert link.state == "refused"
    link.outgoing()
    assert link.poll(10.0) == []
    assert board.heard() == []
    link.poll(10.2)
    assert [type(message) for _, message in board.heard()] == [HelloRequest]
    assert board.says(hello(SESSION, 1, *versions), 10.3, ack=1) == []  # said once
    assert board.says(hello(SESSION), 20.0, ack=1) == [LinkUp(hello(SESSION))]


@pytest.mark.parametrize("versions", [(2, 2), (0, 2), (1, 3), (0, 255)])
def test_a_range_with_our_version_is_accepted(link: Link, board: FarEnd, versions: tuple[int, int]) -> None:
    link.poll(0.0)
    board.says(hello(SESSION, 1, *versions), 0.1, ack=1)
    assert link.state == "up"


@pytest.mark.parametrize("frame_version", [1, 2, 255])
def test_a_version_error_refuses_in_whatever_version_it_is_said(link: Link, frame_version: int) -> None:
    link.poll(0.0)
    error = bytes((frame_version, 8, 1, 1, ErrorCode.VERSION, 1))
    assert link.receive(encode(error), 0.1) == [VersionRefused(1, 1)]
    assert link.state == "refused"


@pytest.mark.parametrize(
    "payload",
    [
        pytest.param(bytes((1, 8, 1, 7, ErrorCode.VERSION, 1)), id="to another request"),
        pytest.param(bytes((1, 8, 1, 1, ErrorCode.VERSION)), id="without its detail"),
        pytest.param(bytes((1, 7, 1, 1, ErrorCode.VERSION, 1)), id="of another kind"),
        pytest.param(bytes((1, 8, 1, 1, ErrorCode.LENGTH, 2)), id="another error"),
        pytest.param(bytes((2, 8, 1, 1, ErrorCode.LENGTH, 2)), id="another error in our version"),
    ],
)
def test_nothing_else_refuses(link: Link, payload: bytes) -> None:
    link.poll(0.0)
    link.receive(encode(payload), 0.1)
    assert link.state == "down"


def test_a_version_error_while_up_refuses_only_the_request(link: Link, up: FarEnd) -> None:
    link.request(COMMAND, 0.0)
    error = ErrorMessage(ErrorCode.VERSION, 2)
    assert up.says(error, 0.1, ack=2) == [RequestRefused(error, COMMAND)]
    assert link.state == "up"


def test_the_next_deadline_is_the_repetition_or_the_end_of_the_silence(link: Link, up: FarEnd) -> None:
    assert link.next_deadline() == 3.0
    link.request(COMMAND, 1.0)
    assert link.next_deadline() == 1.25
    link.poll(1.25)
    assert link.next_deadline() == 1.5
    up.says(STATE, 1.3, ack=2)
    assert link.next_deadline() == 4.3


def test_a_request_goes_out_once_and_its_answer_is_told_with_it(link: Link, up: FarEnd) -> None:
    link.request(COMMAND, 0.0)
    ((header, message),) = up.heard()
    assert message == COMMAND
    assert up.says(STATE, 0.1, header.seq) == [LinkEcho(STATE, COMMAND)]
    link.poll(0.3)
    assert up.heard() == []


def test_an_unanswered_request_is_sent_five_times_and_then_given_up(link: Link, up: FarEnd) -> None:
    link.request(COMMAND, 0.0)
    sends = []
    events: list[LinkEvent] = []
    for tick in range(200):
        now = tick / 100
        events += link.poll(now)
        sends += [(now, header.seq) for header, message in up.heard() if message == COMMAND]
    assert sends == [(0.0, 2), (0.25, 2), (0.5, 2), (0.75, 2), (1.0, 2)]
    assert events == [RequestTimedOut(COMMAND), LinkLost(1.25)]
    assert link.statistics["retries"] == 4


def test_a_repetition_begins_with_a_zero_so_that_noise_cannot_swallow_it(link: Link, up: FarEnd) -> None:
    link.request(COMMAND, 0.0)
    first = link.outgoing()
    link.poll(0.25)
    assert link.outgoing() == b"\0" + first


def test_a_request_given_up_is_followed_by_a_greeting_of_a_new_session(link: Link, up: FarEnd) -> None:
    link.request(COMMAND, 0.0)
    for tick in range(6):
        link.poll(tick / 4)
    ((_, message),) = up.heard()
    assert message == HelloRequest(0)  # SESSION + 1, wrapped


def test_a_newer_command_replaces_the_one_that_waits_and_not_the_one_under_way(
    link: Link, up: FarEnd
) -> None:
    for command in (COMMAND, CommandMessage(1, False, 0, 0.0, False, 1.0), COLDER):
        link.request(command, 0.0)
    assert [message for _, message in up.heard()] == [COMMAND]
    assert up.says(STATE, 0.1, ack=2) == [LinkEcho(STATE, COMMAND)]
    assert [(header.seq, message) for header, message in up.heard()] == [(3, COLDER)]
    assert up.says(STATE, 0.2, ack=3) == [LinkEcho(STATE, COLDER)]
    assert up.heard() == []
    assert link.statistics["replaced"] == 1


def test_requests_of_other_kinds_wait_in_their_order(link: Link, up: FarEnd) -> None:
    for message in (COMMAND, Ping(), ClearTrip()):
        link.request(message, 0.0)
    heard = []
    for ack in (2, 3, 4):
        heard += [message for _, message in up.heard()]
        up.says(STATE, 0.1, ack)
    assert heard == [COMMAND, Ping(), ClearTrip()]


def test_an_emergency_stop_waits_for_nothing(link: Link, up: FarEnd) -> None:
    for message in (COMMAND, COLDER, ClearTrip()):
        link.request(message, 0.0)
    link.outgoing()
    link.request(EmergencyStop(), 0.1)
    assert [message for _, message in up.heard()] == [EmergencyStop()]
    assert link.next_deadline() == 0.0
    assert link.poll(0.1) == [RequestTimedOut(message) for message in (COMMAND, COLDER, ClearTrip())]
    assert up.says(STATE, 0.2, ack=2) == []  # the answer to the command comes too late
    assert up.says(STATE, 0.3, ack=3) == [LinkEcho(STATE, EmergencyStop())]


@pytest.mark.parametrize("stops", [(EmergencyStop(), Maintenance()), (Maintenance(), EmergencyStop())])
def test_two_stops_never_give_up_each_other_but_all_else(
    link: Link, up: FarEnd, stops: list[Message]
) -> None:
    first, second = stops
    link.request(first, 0.0)
    link.request(COMMAND, 0.0)
    link.request(second, 0.0)
    assert [message for _, message in up.heard()] == [first]
    assert link.poll(0.0) == [RequestTimedOut(COMMAND)]
    link.request(COLDER, 0.1)  # a command waits behind both
    assert up.says(STATE, 0.2, ack=2) == [LinkEcho(STATE, first)]
    assert [message for _, message in up.heard()] == [second]
    assert up.says(STATE, 0.3, ack=3) == [LinkEcho(STATE, second)]
    assert [message for _, message in up.heard()] == [COLDER]


@pytest.mark.parametrize("ack", [1, 3, 255])
def test_a_stale_answer_is_ignored_and_counted(link: Link, up: FarEnd, ack: int) -> None:
    link.request(COMMAND, 0.0)
    assert up.says(STATE, 0.1, ack) == []
    assert up.says(ErrorMessage(ErrorCode.TRIPPED, 1), 0.1, ack) == []
    assert link.statistics["stale"] == 2
    assert up.says(STATE, 0.2, ack=2) == [LinkEcho(STATE, COMMAND)]


def test_an_answer_given_twice_is_told_once(link: Link, up: FarEnd) -> None:
    link.request(COMMAND, 0.0)
    assert up.says(STATE, 0.1, ack=2) == [LinkEcho(STATE, COMMAND)]
    assert up.says(STATE, 0.2, ack=2) == []


def test_a_frame_that_the_line_repeats_is_told_once(link: Link, up: FarEnd) -> None:
    frame = encode(pack(STATE, 9))
    assert link.receive(frame + frame, 0.1) == [LinkEcho(STATE, None)]
    assert link.statistics["duplicates"] == 1


def test_an_error_is_told_with_its_request_and_the_next_one_goes_out(link: Link, up: FarEnd) -> None:
    link.request(COMMAND, 0.0)
    link.request(Ping(), 0.0)
    link.outgoing()
    error = ErrorMessage(ErrorCode.TRIPPED, TripCause.OVER_TEMPERATURE)
    assert up.says(error, 0.1, ack=2) == [RequestRefused(error, COMMAND)]
    assert [message for _, message in up.heard()] == [Ping()]
    assert link.state == "up"


def test_a_board_that_was_not_greeted_is_greeted_and_named_as_reset(link: Link, up: FarEnd) -> None:
    link.request(COMMAND, 0.0)
    link.outgoing()
    error = ErrorMessage(ErrorCode.NOT_GREETED, 4)
    assert up.says(error, 0.5, ack=2) == [RequestRefused(error, COMMAND), LinkLost(0.0)]
    assert up.greeted(0.5, boot_count=2) == [BoardReset(hello(0, 2)), LinkUp(hello(0, 2))]


def test_an_unasked_hello_means_a_reset_and_is_greeted_at_once(link: Link, up: FarEnd) -> None:
    link.request(COMMAND, 0.0)
    link.request(Ping(), 0.0)
    link.outgoing()
    reset = hello(0, boot_count=2)
    assert up.says(reset, 0.1) == [BoardReset(reset), RequestTimedOut(COMMAND), RequestTimedOut(Ping())]
    assert link.state == "down"
    assert up.greeted(0.1, boot_count=2) == [LinkUp(hello(0, 2))]  # the reset is told once


@pytest.mark.parametrize(("now", "lost"), [(3.99, []), (4.0, [LinkLost(3.0)]), (4.5, [LinkLost(3.5)])])
def test_three_seconds_without_a_frame_lose_the_link(
    link: Link, up: FarEnd, now: float, lost: list[LinkEvent]
) -> None:
    up.says(STATE, 1.0)
    assert link.poll(now) == lost


def test_noise_does_not_count_as_a_sign_of_life(link: Link, up: FarEnd) -> None:
    for tick in range(30):
        link.receive(b"\x55\xaa\0" + encode(b"\x02\xee\x01\x00"), tick / 10)  # damaged, and whole but unknown
    assert [type(event) for event in link.poll(3.0)] == [LinkLost]


def test_a_slow_reporter_is_given_three_periods(link: Link, board: FarEnd) -> None:
    link.poll(0.0)
    slow = BoardConfig(report_period_s=2.0).hello(SESSION, ResetCause.POWER_ON, 1)
    board.says(slow, 0.0, ack=1)
    assert link.poll(5.9) == []
    assert link.poll(6.0) == [LinkLost(6.0)]


@pytest.mark.parametrize("message", [COMMAND, Ping(), ClearTrip(), EmergencyStop(), Maintenance()])
def test_nothing_but_the_greeting_is_sent_while_the_link_is_down(link: Link, message: Message) -> None:
    link.request(message, 0.0)
    assert link.next_deadline() == 0.0
    assert link.poll(0.0) == [RequestTimedOut(message)]
    assert [type(m) for _, m in FarEnd(link).heard()] == [HelloRequest]


def test_what_was_not_written_while_the_port_was_away_does_not_pile_up(link: Link) -> None:
    for second in range(3600):
        link.poll(float(second))
    assert len(link.outgoing()) < 60


def test_a_lost_port_ends_the_session_and_forgets_half_a_frame(link: Link, up: FarEnd) -> None:
    link.request(COMMAND, 0.0)
    link.receive(encode(pack(STATE, 9))[:6], 0.1)
    assert link.disconnect(0.2) == [RequestTimedOut(COMMAND), LinkLost(pytest.approx(0.2))]
    assert link.receive(encode(pack(STATE, 9)), 0.3) == [LinkEcho(STATE, None)]
    assert [type(event) for event in up.greeted(0.3)] == [LinkUp]


def test_a_lost_port_says_nothing_when_the_link_was_down(link: Link) -> None:
    assert link.disconnect(1.0) == []


def test_reports_are_told_in_any_state(link: Link, board: FarEnd) -> None:
    report = Samples().report(5)
    assert board.says(report, 0.0) == [Report(report)]


def test_a_line_that_leads_back_to_the_host_is_no_board(link: Link) -> None:
    link.poll(0.0)
    assert link.receive(link.outgoing(), 0.0) == [Nonsense(1)]
    assert link.state == "down"


def test_sequence_numbers_go_round_without_the_zero(link: Link, up: FarEnd) -> None:
    seen = []
    for count in range(600):
        link.request(Ping(), count / 100)
        ((header, _),) = up.heard()
        seen.append(header.seq)
        assert len(up.says(STATE, count / 100, header.seq)) == 1
    assert seen[:254] == list(range(2, 256))
    assert seen[254:509] == list(range(1, 256))


@pytest.mark.parametrize("message", [HelloRequest(1), STATE, hello(1), ErrorMessage(ErrorCode.NONE, 0)])
def test_what_is_no_request_is_a_bug_of_ours(link: Link, message: Message) -> None:
    with pytest.raises(LocalProtocolError):
        link.request(message, 0.0)


@pytest.mark.parametrize("lease_s", [-0.001, 60.001, math.nan, math.inf])
def test_a_request_out_of_range_is_a_bug_of_ours(link: Link, up: FarEnd, lease_s: float) -> None:
    with pytest.raises(LocalProtocolError, match="lease_s"):
        link.request(CommandMessage(0, False, 0, 0.0, False, lease_s), 0.0)
    assert up.heard() == []


def test_damaged_frames_are_told_and_counted(link: Link) -> None:
    assert link.receive(b"\x05\x01\0" + b"\x55" * 99 + b"\0", 0.0) == [Nonsense(2)]
    assert (link.statistics["bad_cobs"], link.statistics["too_long"]) == (1, 1)


@given(
    st.lists(
        st.binary(max_size=80)
        | st.builds(encode, st.binary(min_size=4, max_size=52))
        | st.builds(lambda kind, seq, ack, body: encode(bytes((1, kind, seq, ack)) + body),
                    st.integers(1, 9), st.integers(0, 255), st.integers(0, 4), st.binary(max_size=48)),
    )
)  # fmt: skip
def test_no_bytes_from_the_board_ever_raise_or_stop_the_clock(pieces: list[bytes]) -> None:
    link = Link(SESSION, 0.0)
    now = 0.0
    for piece in pieces:
        now += 0.1
        link.poll(now)
        link.receive(piece, now)
        link.request(COMMAND, now)
        link.outgoing()
    board = FarEnd(link)
    link.disconnect(now)
    assert [type(event) for event in board.greeted(now)][-1] is LinkUp  # whatever was said before


@given(st.lists(st.sampled_from([0.0, 0.001, 0.24, 0.25, 0.26, 1.0, 2.99, 3.0, 11.0]), max_size=40))
def test_the_deadline_is_never_in_the_past_after_a_poll(waits: list[float]) -> None:
    link = Link(SESSION, 0.0)
    now = 0.0
    for wait in waits:
        now += wait
        link.poll(now)
        assert link.next_deadline() > now
        for payload in FrameDecoder().feed(link.outgoing()):
            header, message = unpack(payload)
            if isinstance(message, HelloRequest):
                link.receive(encode(pack(hello(message.session), 1, header.seq)), now)
        link.request(COMMAND, now)
        link.poll(now)
