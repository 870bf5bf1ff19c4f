"""The ways by which alarms leave the page, and the sign of life; each call waits for the network."""

import base64
import hashlib
import hmac
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from edge.config.alarm_settings import (
    AlarmSettings,
    HttpTarget,
    LifeSignSettings,
    NtfySettings,
    WebhookSettings,
)
from edge.page.alarms.alarm_message import ALARM, OVER, REPEAT, TEST, AlarmMessage
from edge.page.alarms.exchange import Cut, SendError, ask, secret, url_of
from edge.page.alarms.mail import send_mail

Send = Callable[[AlarmMessage, Cut], str]

NTFY, MAIL, WEBHOOK, LIFE_SIGN = "ntfy", "mail", "webhook", "life_sign"
# Urgent: it breaks through "do not disturb" where the telephone allows that, docs.ntfy.sh/publish
_PRIORITY = {ALARM: "urgent", REPEAT: "high", OVER: "default", TEST: "default"}
_TAG = {ALARM: "rotating_light", REPEAT: "rotating_light", OVER: "white_check_mark", TEST: "test_tube"}
SIGNATURE = "X-Greenhouse-Signature"


@dataclass(frozen=True, slots=True)
class Channel:
    """A way to tell people.

    to : the server's name, for people;  send : returns a remark, "" for none. Errors: SendError
    """

    name: str
    to: str
    send: Send


def channels_of(settings: AlarmSettings) -> tuple[Channel, ...]:
    """Return the channels that are configured."""
    found = []
    if settings.ntfy.is_set:
        found.append(Channel(NTFY, host_of(settings.ntfy, NTFY), partial(_ntfy, settings.ntfy)))
    if settings.mail.host:
        server = f"{settings.mail.host}:{settings.mail.port}"
        found.append(Channel(MAIL, server, partial(send_mail, settings.mail)))
    if settings.webhook.is_set:
        webhook = settings.webhook
        found.append(Channel(WEBHOOK, host_of(webhook, WEBHOOK), partial(_webhook, webhook)))
    return tuple(found)


def host_of(target: HttpTarget, name: str) -> str:
    """Return the host of an address, "" while it cannot be read; path and query may be secrets."""
    try:
        return str(url_of(target, f"alarms.{name}").hostname)
    except SendError:
        return ""


def give_life_sign(settings: LifeSignSettings, cut: Cut) -> None:
    """Tell the service elsewhere that all goes well. Errors: SendError"""
    ask(settings, f"alarms.{LIFE_SIGN}", cut, "GET", None, {})


def _ntfy(settings: NtfySettings, message: AlarmMessage, cut: Cut) -> str:
    headers = {
        "Title": header_text(message.title),
        "Priority": _PRIORITY[message.kind],
        "Tags": _TAG[message.kind],
        "Click": header_text(message.page),
        "Content-Type": "text/plain; charset=utf-8",
        **_bearer(settings.token_file, "alarms.ntfy.token_file"),
    }
    ask(settings, "alarms.ntfy", cut, "POST", message.text.encode(), headers)
    return ""


def _webhook(settings: WebhookSettings, message: AlarmMessage, cut: Cut) -> str:
    body = json.dumps(message.document | {"text": message.text}, allow_nan=False).encode()
    headers = {
        "Content-Type": "application/json",
        **_bearer(settings.token_file, "alarms.webhook.token_file"),
    }
    if key := secret(settings.secret_file, "alarms.webhook.secret_file"):
        headers[SIGNATURE] = f"sha256={hmac.new(key.encode(), body, hashlib.sha256).hexdigest()}"
    ask(settings, "alarms.webhook", cut, "POST", body, headers)
    return ""


def _bearer(token_file: str, setting: str) -> dict[str, str]:
    token = secret(token_file, setting)
    return {"Authorization": f"Bearer {token}"} if token else {}


def header_text(line: str) -> str:
    """Return a line as an HTTP header may carry it: other than plain ASCII as an encoded word of RFC 2047."""
    if line.isascii() and line.isprintable() and "=?" not in line:
        return line
    return f"=?UTF-8?B?{base64.b64encode(line.encode(errors='replace')).decode()}?="
