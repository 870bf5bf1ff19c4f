"""Each channel against a real server: what arrives, and in words what went wrong, without any secret."""

import hashlib
import hmac
import socket
import threading
import time
from collections.abc import Callable
from email.header import decode_header, make_header
from pathlib import Path
from typing import Any

import pytest
from alarm_servers import MailSink, http_sink, mail_sink, silent_server
from certificates import make_certificates

from edge.config.alarm_settings import (
    AlarmSettings,
    LifeSignSettings,
    MailSettings,
    NtfySettings,
    WebhookSettings,
)
from edge.page.alarms import exchange
from edge.page.alarms.alarm_book import AlarmBook
from edge.page.alarms.alarm_message import (
    NAMES_MAX,
    TEXT_BYTES,
    TITLE_MAX,
    AlarmMessage,
    message_of,
    trial_message,
)
from edge.page.alarms.channels import channels_of, give_life_sign, header_text
from edge.page.alarms.exchange import Cut, SendError
from tests.support.broker import free_port, wait_for

UTC = 1.7e9
PAGE = "https://rig.example.org/"
HOSTILE = "gone\r\nBcc: all@example.org\r\n\r\n<b>Ü\u2028 \x1b[2J =?utf-8?q?=0d=0aBcc:_x?= \ud800 end"
TOKEN = "tk_5ecret9"


def message(text: str = "the board is silent", rig: str = "rig-1") -> AlarmMessage:
    book = AlarmBook()
    book.begin("board.silent", text, UTC)
    return message_of(book.due("x", UTC, 0.0), rig, PAGE, UTC)


def send(settings: AlarmSettings, what: AlarmMessage | None = None) -> str:
    (channel,) = channels_of(settings)
    return channel.send(what or message(), Cut())


def refusal(settings: AlarmSettings) -> SendError:
    with pytest.raises(SendError) as found:
        send(settings)
    return found.value


@pytest.fixture
def secret(tmp_path: Path) -> Callable[[str], str]:
    def write(text: str) -> str:
        path = tmp_path / f"secret{len(list(tmp_path.iterdir()))}"
        path.touch(0o600)
        path.write_bytes(text.encode())
        return str(path)

    return write


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_certificates(tmp_path_factory.mktemp("certificates"))


# ntfy and webhook


def test_ntfy_gets_title_text_priority_and_token(secret) -> None:
    with http_sink() as sink:
        settings = NtfySettings(url=f"{sink.url}/my-topic", token_file=secret(f"{TOKEN}\n"))
        assert send(AlarmSettings(ntfy=settings)) == ""
    (heard,) = sink.heard
    assert (heard.method, heard.path) == ("POST", "/my-topic")
    assert heard.headers["Title"] == "rig-1: the board is silent"
    assert heard.headers["Authorization"] == f"Bearer {TOKEN}"
    assert (heard.headers["Priority"], heard.headers["Click"]) == ("urgent", PAGE)
    assert "the board is silent" in heard.body.decode()
    assert PAGE in heard.body.decode()


@pytest.mark.parametrize("text", [HOSTILE, "Ü", "x" * 5000, "\r\n", "\x00"])
def test_hostile_texts_make_one_title_and_no_further_header(text: str) -> None:
    with http_sink() as sink, mail_sink() as mail:
        url = f"{sink.url}/t"
        send(AlarmSettings(ntfy=NtfySettings(url=url)), message(text))
        send(AlarmSettings(webhook=WebhookSettings(url=url)), message(text))
        send(AlarmSettings(mail=plain_mail(mail)), message(text))
    ntfy, webhook = sink.heard
    title = str(make_header(decode_header(ntfy.headers["Title"])))
    subject = mail.mails[0]["Subject"]
    for line in (title, subject, webhook.json()["title"]):
        assert line.isprintable()
        assert line.startswith("rig-1:")
        assert len(line) <= TITLE_MAX
    assert title == subject
    names = {"Host", "Accept-Encoding", "Content-Length", "User-Agent", "Content-Type"}
    assert set(ntfy.headers) == names | {"Title", "Priority", "Tags", "Click"}
    assert "Bcc" not in mail.mails[0]
    assert mail.mails[0]["To"] == "you@example.org"
    body = mail.mails[0].get_content()
    assert "\x1b" not in body
    assert "\x1b" not in ntfy.body.decode()


def test_a_plain_title_stays_readable_and_others_are_encoded() -> None:
    assert header_text("rig-1: over") == "rig-1: over"
    for line in ("rig: Ü", "=?utf-8?q?=0d=0a?=", "a\r\nb"):
        encoded = header_text(line)
        assert encoded.isascii()
        assert encoded.isprintable()
        assert str(make_header(decode_header(encoded))) == line


def test_a_webhook_gets_json_with_a_signature(secret) -> None:
    with http_sink() as sink:
        settings = WebhookSettings(
            url=f"{sink.url}/hook?a=b%20c", token_file=secret(TOKEN), secret_file=secret("key")
        )
        send(AlarmSettings(webhook=settings))
    (heard,) = sink.heard
    assert heard.path == "/hook?a=b%20c"
    expected = hmac.new(b"key", heard.body, hashlib.sha256).hexdigest()
    assert heard.headers["X-Greenhouse-Signature"] == f"sha256={expected}"
    assert heard.headers["Authorization"] == f"Bearer {TOKEN}"
    document = heard.json()
    assert (document["kind"], document["rig"], document["page"]) == ("alarm", "rig-1", PAGE)
    (alarm,) = document["alarms"]
    assert (alarm["cause"], alarm["state"], alarm["begun_utc"]) == ("board.silent", "alarm", UTC)


@pytest.mark.parametrize(
    ("status", "lasting"),
    [(301, True), (302, True), (307, True), (401, True), (404, True), (429, False), (503, False)],
)
def test_what_is_not_taken_is_said_and_a_redirect_is_not_followed(status, lasting, secret) -> None:
    with http_sink() as elsewhere, http_sink() as sink:
        sink.status, sink.headers = status, {"location": f"{elsewhere.url}/t0ps3cret"}
        settings = NtfySettings(url=f"{sink.url}/t0ps3cret?k=hidden", token_file=secret(TOKEN))
        error = refusal(AlarmSettings(ntfy=settings))
        assert len(sink.heard) == 1
        assert elsewhere.heard == []
    assert f"127.0.0.1 answers {status}" in str(error)
    assert error.lasting is lasting
    assert ("a redirect, which is not followed" in str(error)) is (status < 400)
    assert not any(word in str(error) for word in ("t0ps3cret", "hidden", TOKEN))


def test_https_needs_a_certificate_that_is_trusted(certificates: Path) -> None:
    with http_sink(tls=(certificates / "broker.crt", certificates / "broker.key")) as sink:
        ca = str(certificates / "ca.crt")
        send(AlarmSettings(ntfy=NtfySettings(url=f"{sink.url}/t", ca=ca)))
        for other in (str(certificates / "stranger.crt"), ""):
            error = refusal(AlarmSettings(ntfy=NtfySettings(url=f"{sink.url}/t", ca=other)))
            assert "certificate is not trusted" in str(error)
        by_name = sink.url.replace("127.0.0.1", "localhost")  # the certificate names the address alone
        assert "not trusted" in str(refusal(AlarmSettings(ntfy=NtfySettings(url=f"{by_name}/t", ca=ca))))
    assert len(sink.heard) == 1
    missing = NtfySettings(url="https://127.0.0.1/t", ca=str(certificates / "none.crt"))
    assert "alarms.ntfy.ca" in str(refusal(AlarmSettings(ntfy=missing)))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "no address",
        "ftp://x/t",
        "http://user:pw@x/t",
        "http://x:99999/t",
        "http://[x/t",
        "http://:80/",
    ],
)
def test_an_address_in_a_file_is_checked_and_never_quoted(text: str, secret) -> None:
    error = refusal(AlarmSettings(ntfy=NtfySettings(url_file=secret(text))))
    assert "alarms.ntfy.url_file" in str(error)
    assert not text or text not in str(error)
    assert error.lasting


def test_an_address_in_a_file_works_and_is_read_anew(secret) -> None:
    with http_sink() as sink:
        path = secret("http://127.0.0.1:1/")
        settings = AlarmSettings(ntfy=NtfySettings(url_file=path))
        assert "refused" in str(refusal(settings))
        Path(path).write_text(f"{sink.url}/t\n")
        send(settings)
        assert len(sink.heard) == 1


def test_a_token_of_two_lines_sends_nothing(secret) -> None:
    with http_sink() as sink:
        settings = NtfySettings(url=f"{sink.url}/t", token_file=secret(f"{TOKEN}\r\nX-Evil: 1"))
        error = refusal(AlarmSettings(ntfy=settings))
        assert sink.heard == []
    assert "alarms.ntfy.token_file" in str(error)
    assert TOKEN not in str(error)


def test_a_secret_that_others_may_read_or_that_is_missing_is_named(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.delenv("CREDENTIALS_DIRECTORY", raising=False)
    open_file = tmp_path / "token"
    open_file.write_text(TOKEN)
    open_file.chmod(0o644)
    for name, words in (
        (str(open_file), "0600"),
        (str(tmp_path / "none"), "No such file"),
        ("secret_x", "systemd"),
    ):
        settings = AlarmSettings(ntfy=NtfySettings(url="http://127.0.0.1:1/t", token_file=name))
        error = refusal(settings)
        assert words in str(error)
        assert error.lasting


def test_a_network_that_is_away_is_said_in_words() -> None:
    port = free_port()
    assert "127.0.0.1: Connection refused" in str(
        refusal(AlarmSettings(ntfy=NtfySettings(url=f"http://127.0.0.1:{port}/t")))
    )
    error = refusal(AlarmSettings(ntfy=NtfySettings(url="http://no-such-host.invalid/t")))
    assert "no-such-host.invalid: this name is not found" in str(error)
    assert not error.lasting


def test_a_server_that_says_nothing_is_left_after_a_time(monkeypatch) -> None:
    monkeypatch.setattr(exchange, "WAIT_MAX_S", 0.2)
    with silent_server() as port:
        assert "no answer within 0.2 s" in str(
            refusal(AlarmSettings(ntfy=NtfySettings(url=f"http://127.0.0.1:{port}/")))
        )
        https = NtfySettings(url=f"https://127.0.0.1:{port}/")
        assert "no answer within" in str(refusal(AlarmSettings(ntfy=https)))


@pytest.mark.parametrize("scheme", ["http", "https"])
def test_an_exchange_is_cut_from_another_thread_in_the_middle_of_a_wait(scheme: str) -> None:
    cut, ended = Cut(), []
    with silent_server() as port:
        (channel,) = channels_of(AlarmSettings(ntfy=NtfySettings(url=f"{scheme}://127.0.0.1:{port}/")))

        def run() -> None:
            try:
                channel.send(message(), cut)
            except SendError as error:
                ended.append(error)

        thread = threading.Thread(target=run)
        thread.start()
        wait_for(lambda: cut._socket is not None)
        time.sleep(0.05)
        cut()
        thread.join(5.0)
        assert not thread.is_alive()
    assert len(ended) == 1


# mail


def plain_mail(sink: MailSink, **values: Any) -> MailSettings:
    given = {"host": "127.0.0.1", "port": sink.port, "tls": "none", "sender": "rig@example.org"}
    return MailSettings(**{**given, "to": ("you@example.org",), **values})


@pytest.mark.parametrize("starttls", [True, False])
def test_mail_goes_encrypted_with_a_login(certificates: Path, secret, starttls: bool) -> None:
    tls = (certificates / "broker.crt", certificates / "broker.key")
    with mail_sink(tls=tls, starttls=starttls) as sink:
        sink.users = {"rig": "pa ss"}
        settings = plain_mail(
            sink, tls="starttls" if starttls else "tls", ca=str(certificates / "ca.crt"), username="rig",
            password_file=secret("pa ss\n"), to=("you@example.org", "she@example.org"),
        )  # fmt: skip
        assert send(AlarmSettings(mail=settings)) == ""
    (mail,) = sink.mails
    assert sink.was_encrypted == [True]
    assert mail["Subject"] == "rig-1: the board is silent"
    assert mail["To"] == "you@example.org, she@example.org"
    assert mail["From"] == "rig@example.org"
    assert mail["Message-ID"].endswith("@example.org>")
    assert mail["Auto-Submitted"] == "auto-generated"
    assert PAGE in mail.get_content()


def test_a_wrong_password_is_told_plainly_and_not_quoted(certificates: Path, secret) -> None:
    with mail_sink(tls=(certificates / "broker.crt", certificates / "broker.key")) as sink:
        sink.users, sink.echoes_password = {"rig": "right"}, True
        settings = plain_mail(
            sink,
            tls="starttls",
            ca=str(certificates / "ca.crt"),
            username="rig",
            password_file=secret("wr0ng"),
        )
        error = refusal(AlarmSettings(mail=settings))
        assert sink.mails == []
    assert str(error) == (
        f"127.0.0.1:{sink.port}: refuses user or password: 535 5.7.8 Username and Password not accepted (…)"
    )
    assert error.lasting


def test_no_password_goes_to_a_server_without_encryption_or_trust(certificates, secret) -> None:
    with mail_sink() as sink:
        sink.users = {"rig": "right"}
        settings = plain_mail(sink, tls="starttls", username="rig", password_file=secret("right"))
        assert "STARTTLS" in str(refusal(AlarmSettings(mail=settings)))
        assert sink.logins == []
    with mail_sink(tls=(certificates / "broker.crt", certificates / "broker.key")) as sink:
        sink.users = {"rig": "right"}
        ca = str(certificates / "stranger.crt")
        settings = plain_mail(sink, tls="starttls", ca=ca, username="rig", password_file=secret("right"))
        assert "not trusted" in str(refusal(AlarmSettings(mail=settings)))
        assert sink.logins == []


def test_recipients_that_are_refused_are_named_and_the_others_get_the_mail() -> None:
    with mail_sink() as sink:
        sink.refuses = {"bad@example.org"}
        settings = plain_mail(sink, to=("you@example.org", "bad@example.org"))
        remark = send(AlarmSettings(mail=settings))
        assert "bad@example.org: 550 5.1.1 no such user" in remark
        assert len(sink.mails) == 1
        sink.refuses.add("you@example.org")
        error = refusal(AlarmSettings(mail=settings))
        assert "you@example.org: 550" in str(error)
        assert error.lasting


def test_a_mail_server_that_is_away_or_silent_or_no_mail_server_is_said(monkeypatch) -> None:
    settings = {"sender": "rig@example.org", "to": ("you@example.org",), "host": "127.0.0.1", "tls": "none"}
    port = free_port()
    assert f"127.0.0.1:{port}: Connection refused" in str(
        refusal(AlarmSettings(mail=MailSettings(port=port, **settings)))
    )
    monkeypatch.setattr(exchange, "WAIT_MAX_S", 0.2)
    monkeypatch.setattr("edge.page.alarms.mail.WAIT_MAX_S", 0.2)
    with silent_server() as silent:
        assert f"127.0.0.1:{silent}:" in str(
            refusal(AlarmSettings(mail=MailSettings(port=silent, **settings)))
        )
    with http_sink() as sink:
        assert f"127.0.0.1:{sink.port}:" in str(
            refusal(AlarmSettings(mail=MailSettings(port=sink.port, **settings)))
        )


# the sign of life, texts


def test_a_sign_of_life_is_a_get() -> None:
    with http_sink() as sink:
        give_life_sign(LifeSignSettings(url=f"{sink.url}/uuid"), Cut())
        assert [(one.method, one.path) for one in sink.heard] == [("GET", "/uuid")]
        sink.status = 404
        with pytest.raises(SendError, match=r"^127.0.0.1 answers 404 Not Found$"):
            give_life_sign(LifeSignSettings(url=f"{sink.url}/uuid"), Cut())


def test_one_message_names_many_alarms_and_counts_the_rest() -> None:
    book = AlarmBook()
    for number in range(40):
        book.begin(f"kind.{number}", f"trouble {number} {'Ü' * 300}", UTC)
    found = message_of(book.due("x", UTC, 0.0), "rig-1", PAGE, UTC)
    assert found.title.startswith("rig-1: 40 alarms")
    assert 1 < found.text.count("ALARM since") <= NAMES_MAX
    assert f"and {40 - found.text.count('ALARM since')} more: see the page" in found.text
    assert len(found.text.encode()) < TEXT_BYTES + 200
    assert len(found.document["alarms"]) == 40


def test_a_test_message_says_that_nothing_is_wrong() -> None:
    found = trial_message("rig-1", PAGE, UTC)
    assert "Nothing is wrong" in found.text
    assert found.document["kind"] == "test"


def test_no_answer_of_a_socket_that_is_closed_harms_a_cut() -> None:
    cut = Cut()
    with socket.socket() as opened:
        cut.watch(opened)
    cut()
    cut()
