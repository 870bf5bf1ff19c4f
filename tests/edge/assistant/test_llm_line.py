"""edge/assistant/llm/line.py: on real sockets, a server that drips, hangs, never ends or hangs up."""

import socket
import ssl
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from certificates import make_certificates

from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.language_model import open_line
from edge.assistant.llm.line import Interrupt, post
from edge.config.settings import LlmSettings
from edge.core.errors import ConfigError
from training.llm_stand_in.server import StandIn

BODY = b'{"messages": []}'


@pytest.fixture
def stand_in() -> Iterator[StandIn]:
    with StandIn() as server:
        yield server


def kind_of(stand_in: StandIn, behave: str, deadline_s: float = 20.0, stop: Interrupt | None = None) -> str:
    stand_in.behave = behave
    with pytest.raises(LlmFailure) as caught:
        post(f"{stand_in.url}/chat/completions", BODY, {}, deadline_s, stop or Interrupt())
    return caught.value.kind


def test_a_reply_comes_back_whole(stand_in: StandIn) -> None:
    stand_in.behave = "429"
    response = post(f"{stand_in.url}/chat/completions", BODY, {"X-Y": "z"}, 20.0, Interrupt())
    assert (response.status, response.retry_after) == (429, "20")
    assert b"Rate limit" in response.raw
    assert stand_in.headers[0]["X-Y"] == "z"


@pytest.mark.parametrize("behave", ["hanging", "dripping"])
def test_the_deadline_holds_for_the_whole_reply(stand_in: StandIn, behave: str) -> None:
    begun = time.monotonic()
    assert kind_of(stand_in, behave, deadline_s=0.3) == "timeout"
    assert time.monotonic() - begun < 10.0  # dripping it would take half a minute, hanging for ever


def test_a_reply_without_an_end_is_cut_off(stand_in: StandIn) -> None:
    assert kind_of(stand_in, "endless_reply") == "malformed"


def test_a_server_that_hangs_up_is_unreachable(stand_in: StandIn) -> None:
    assert kind_of(stand_in, "cut") == "unreachable"


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_certificates(tmp_path_factory.mktemp("certificates"))


def test_a_server_with_a_certificate_of_its_own_is_known_by_its_authority(certificates: Path) -> None:
    tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    tls.load_cert_chain(certificates / "broker.crt", certificates / "broker.key")
    with StandIn("429", tls=tls) as server:
        for ca, trusted in (("ca.crt", True), ("stranger.crt", False)):
            line = open_line(LlmSettings(url=server.url, model="m", ca=str(certificates / ca)))
            if trusted:
                assert line(f"{server.url}/chat/completions", BODY, {}, 20.0, Interrupt()).status == 429
            else:
                with pytest.raises(LlmFailure, match="unreachable: the line failed: SSLError"):
                    line(f"{server.url}/chat/completions", BODY, {}, 20.0, Interrupt())
        with pytest.raises(LlmFailure, match="SSLError"):
            post(f"{server.url}/chat/completions", BODY, {}, 20.0, Interrupt())


@pytest.mark.parametrize("content", [None, "no certificate"])
def test_an_authority_that_cannot_be_read_is_named(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "ca.crt").write_text(content)
    with pytest.raises(ConfigError, match=r"llm\.ca: .*ca\.crt"):
        open_line(LlmSettings(url="https://there/v1", model="m", ca=str(tmp_path / "ca.crt")))


def test_nobody_at_the_address_is_unreachable() -> None:
    with StandIn() as gone:
        url = gone.url
    with pytest.raises(LlmFailure, match="unreachable"):
        post(url, BODY, {}, 5.0, Interrupt())


def test_an_interrupt_from_another_thread_ends_a_read(stand_in: StandIn) -> None:
    stop = Interrupt()

    def fire() -> None:
        while not stand_in.requests:
            time.sleep(0.005)
        stop.fire()

    threading.Thread(target=fire).start()
    assert kind_of(stand_in, "hanging", stop=stop) == "interrupted"


def test_an_interrupt_that_was_fired_before_ends_it_at_once(stand_in: StandIn) -> None:
    stop = Interrupt()
    stop.fire()
    assert kind_of(stand_in, "hanging", stop=stop) == "interrupted"


def test_a_handshake_that_never_ends_ends_at_the_deadline() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        drip = threading.Thread(target=_drip, args=(silent,))
        drip.start()
        begun = time.monotonic()
        with pytest.raises(LlmFailure, match="timeout"):
            post(f"https://127.0.0.1:{silent.getsockname()[1]}/v1", BODY, {}, 0.3, Interrupt())
        assert time.monotonic() - begun < 10.0
        drip.join(20.0)
        assert not drip.is_alive()  # its client has hung up


def _drip(server: socket.socket) -> None:
    """Accept, and send the record of a handshake byte by byte: each one would restart a socket's timeout."""
    connection, _ = server.accept()
    with connection, suppress(OSError):
        for byte in b"\x16\x03\x03\x40\x00" + bytes(1000):
            connection.sendall(bytes([byte]))
            time.sleep(0.05)
