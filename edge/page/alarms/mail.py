"""Alarms by e-mail: one exchange with an SMTP server."""

import smtplib
import socket
import ssl
from collections.abc import Mapping
from email.message import EmailMessage
from email.utils import format_datetime, localtime, make_msgid
from typing import Any

from edge.config.alarm_settings import MailSettings
from edge.core.plain_text import plain
from edge.page.alarms.alarm_message import AlarmMessage
from edge.page.alarms.exchange import WAIT_MAX_S, Cut, SendError, connect, reason_of, secret, tls_of

SETTING = "alarms.mail"
REFUSED_FOR_GOOD = 500  # SMTP replies from here on; those below say "later"


def send_mail(settings: MailSettings, message: AlarmMessage, cut: Cut) -> str:
    """Send a message to all recipients; return which of them the server refused. Errors: SendError"""
    password = secret(settings.password_file, f"{SETTING}.password_file")
    tls = None if settings.tls == "none" else tls_of(settings.ca, f"{SETTING}.ca")
    place = f"{settings.host}:{settings.port}"
    try:
        with SmtpLine(settings, tls, cut) as line:
            if settings.tls == "starttls":
                line.starttls(context=tls)
                assert line.sock is not None
                cut.watch(line.sock)
            if settings.username:
                line.login(settings.username, password)
            refused = line.send_message(_mail(settings, message), settings.sender, list(settings.to))
    except smtplib.SMTPException as error:
        raise _refusal(error, place, password) from None
    except (OSError, UnicodeError, ValueError) as error:
        raise SendError(reason_of(error, place)) from None
    return "" if not refused else f"{place}: refused for {_replies(refused, password)}"


class SmtpLine(smtplib.SMTP):
    """A connection to an SMTP server, which `cut` can end."""

    def __init__(self, settings: MailSettings, tls: ssl.SSLContext | None, cut: Cut) -> None:
        self._tls, self._cut = tls if settings.tls == "tls" else None, cut
        # A name is given, as the library would ask the network for it, without a limit of time.
        name = socket.gethostname() or "greenhouse"
        super().__init__(settings.host, settings.port, local_hostname=name, timeout=WAIT_MAX_S)

    def _get_socket(self, host: str, port: int, timeout: float) -> socket.socket:
        return connect(host, port, self._tls, self._cut)


def _mail(settings: MailSettings, message: AlarmMessage) -> EmailMessage:
    mail = EmailMessage()
    mail["Subject"] = message.title
    mail["From"] = settings.sender
    mail["To"] = ", ".join(settings.to)
    mail["Date"] = format_datetime(localtime())
    mail["Message-ID"] = make_msgid(domain=settings.sender.rpartition("@")[2])
    mail["Auto-Submitted"] = "auto-generated"  # nobody's holiday notice answers it, RFC 3834
    mail.set_content(message.text)
    return mail


def _refusal(error: smtplib.SMTPException, place: str, password: str) -> SendError:
    """Return in words what the server refused."""
    match error:
        case smtplib.SMTPAuthenticationError():
            reply = _reply(error.smtp_code, error.smtp_error, password)
            return SendError(f"{place}: refuses user or password: {reply}", lasting=True)
        case smtplib.SMTPRecipientsRefused():
            codes = [code for code, _ in error.recipients.values()]
            lasting = all(code >= REFUSED_FOR_GOOD for code in codes)
            return SendError(f"{place}: refused for {_replies(error.recipients, password)}", lasting)
        case smtplib.SMTPNotSupportedError():
            return SendError(f"{place}: {plain(str(error))}", lasting=True)
        case smtplib.SMTPServerDisconnected():
            return SendError(f"{place}: {plain(str(error))}")
        case smtplib.SMTPResponseException():
            reply = _reply(error.smtp_code, error.smtp_error, password)
            return SendError(f"{place}: refuses: {reply}", error.smtp_code >= REFUSED_FOR_GOOD)
    return SendError(f"{place}: {plain(_without(str(error), password))}", lasting=True)


def _replies(refused: Mapping[str, tuple[int, Any]], password: str) -> str:
    return plain("; ".join(f"{to}: {_reply(code, text, password)}" for to, (code, text) in refused.items()))


def _reply(code: int, text: bytes | str, password: str) -> str:
    words = text.decode(errors="replace") if isinstance(text, bytes) else text
    return f"{code} {plain(_without(words, password))}"


def _without(text: str, password: str) -> str:
    """Return a server's words without a password that it has echoed."""
    return text.replace(password, "…") if password else text
