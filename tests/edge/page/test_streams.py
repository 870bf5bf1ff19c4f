"""edge/page/page_state.py and the route: who gets one of the event streams; each place comes back."""

import asyncio
from types import SimpleNamespace

import pytest

from edge.page.access import Role, Visitor
from edge.page.answers import NotAllowed
from edge.page.page_state import STREAMS_MAX, Streams
from edge.page.rig_routes import stream


def of_link(link: int, session: int) -> Visitor:
    return Visitor(session, "guest", Role.VIEW, link)


def test_the_sessions_of_one_link_leave_room_for_everybody_else() -> None:
    streams = Streams()
    crowd = [streams.begin(of_link(1, session)) for session in range(11) for _ in range(4)]
    assert len(streams) == STREAMS_MAX
    others = [streams.begin(of_link(link, 100 + link)) for link in range(2, 21)]
    assert not any(each.ended.is_set() for each in others)
    assert len(streams) == STREAMS_MAX
    still = [each for each in crowd if not each.ended.is_set()]
    assert still == crowd[-len(still) :]  # the oldest have gone
    streams.begin(of_link(1, 99))  # the crowd makes room for itself
    assert not any(each.ended.is_set() for each in others)


def test_where_everybody_has_one_a_further_viewer_takes_nobodys() -> None:
    streams = Streams()
    known = [
        streams.begin(Visitor(session, f"person {session}", Role.VIEW)) for session in range(STREAMS_MAX)
    ]
    with pytest.raises(NotAllowed, match=f"{STREAMS_MAX} viewers look already"):
        streams.begin(Visitor(99, "one more", Role.VIEW))
    streams.begin(Visitor(0, "person 0", Role.VIEW))  # another window of somebody who looks
    assert [each.ended.is_set() for each in known] == [True, *[False] * (STREAMS_MAX - 1)]


def test_who_hangs_up_before_the_first_view_gives_the_place_back() -> None:
    rig = SimpleNamespace(viewers=0)
    page = SimpleNamespace(streams=Streams(), rig=rig)

    async def come_and_go() -> None:
        answer = await stream(page, None, of_link(1, 1))
        assert len(page.streams) == 1

        async def gone() -> dict[str, str]:
            return {"type": "http.disconnect"}

        async def send(message: object) -> None:
            await asyncio.Event().wait()

        await answer({"type": "http", "asgi": {}}, gone, send)

    asyncio.run(asyncio.wait_for(come_and_go(), 20.0))
    assert (list(page.streams), rig.viewers) == ([], 0)
