"""The sockets at which the page listens."""

import socket
from contextlib import ExitStack
from dataclasses import replace

import pytest

from edge.config import loading as config
from edge.page import server
from tests.support.broker import free_port


@pytest.mark.parametrize("opened", [False, True])
def test_the_body_of_an_answer_does_not_wait_for_the_head_to_be_acknowledged(opened: bool) -> None:
    """Else each answer on a connection that is kept, and so a stop, comes 40 ms late."""
    settings = config.default()
    settings = replace(settings, page=replace(settings.page, port=free_port()))
    with ExitStack() as stack:
        listeners = [stack.enter_context(each) for each in server.listen(settings.page, opened)]
        assert listeners
        for listener in listeners:
            stack.enter_context(socket.create_connection(("127.0.0.1", settings.page.port), timeout=10.0))
            connection = stack.enter_context(listener.accept()[0])
            assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
