"""Settings of the messages about alarms that leave the page: channels, and the sign of life."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from edge.formats.address import host_problem, url_problem
from edge.formats.cross_check import Section, items, number, text, whole

MAIL_ADDRESS = r"[^\s@<>,;:\"]+@[^\s@<>,;:\"]+"
URL_FILE = "file that holds the address instead, where the address itself is a secret"
CREDENTIAL = "a bare name is a systemd credential of greenhouse-page.service"
CA = "authority of the server's certificate, PEM; empty: the system's"


@dataclass(frozen=True, slots=True)
class HttpTarget(Section):
    """An address that is asked by HTTP."""

    url: str = text("", "its address; empty: none", form=url_problem)
    url_file: str = text("", f"{URL_FILE}; {CREDENTIAL}")
    ca: str = text("", CA)

    def cross_check(self) -> None:
        """Check that there is one address at most."""
        if self.url and self.url_file:
            self.refuse("url_file", "url is given too: one of the two")

    @property
    def is_set(self) -> bool:
        """An address is configured."""
        return bool(self.url or self.url_file)


@dataclass(frozen=True, slots=True)
class NtfySettings(HttpTarget):
    """Messages to telephones by ntfy; `url` is that of the topic, e.g. https://ntfy.sh/TOPIC."""

    token_file: str = text("", f"file that holds an access token; {CREDENTIAL}; empty: none")


@dataclass(frozen=True, slots=True)
class WebhookSettings(HttpTarget):
    """A POST of JSON to a program of yours."""

    token_file: str = text("", f"file whose text is sent as Authorization: Bearer; {CREDENTIAL}; empty: none")
    secret_file: str = text("", f"key of the signature X-Greenhouse-Signature; {CREDENTIAL}; empty: none")


@dataclass(frozen=True, slots=True)
class MailSettings(Section):
    """E-mail through an SMTP server."""

    host: str = text("", "SMTP server; empty: no mail", form=host_problem)
    port: int = whole(587, "its port (465 with tls: tls)", 1, 65535)
    tls: str = text("starttls", "how the line is encrypted; none: not at all", ("starttls", "tls", "none"))
    ca: str = text("", CA)
    username: str = text("", "user; empty: no login")
    password_file: str = text("", f"file that holds the password; {CREDENTIAL}")
    sender: str = text("", "address that the mail comes from", pattern=f"({MAIL_ADDRESS})?")
    to: tuple[str, ...] = items("addresses that it goes to", "you@example.org")

    def cross_check(self) -> None:
        """Check that a server has addresses, and that no password goes over an open line."""
        if not self.host:
            return
        for key in ("sender", "to"):
            if not getattr(self, key):
                self.refuse(key, "is empty but host is given")
        for place, address in enumerate(self.to):
            if not re.fullmatch(MAIL_ADDRESS, address):
                self.refuse(f"to[{place}]", "is not an address such as you@example.org")
        if bool(self.username) != bool(self.password_file):
            self.refuse("password_file", "username and password_file go together")
        if self.username and self.tls == "none":
            self.refuse("tls", "a password is sent over an encrypted line alone: starttls or tls")


@dataclass(frozen=True, slots=True)
class LifeSignSettings(HttpTarget):
    """A sign of life to a service elsewhere, e.g. healthchecks.io, which tells you when it stays away."""

    every_s: float = number(300.0, "from one sign to the next", "s", 10.0, 86_400.0)


@dataclass(frozen=True, slots=True)
class AlarmSettings(Section):
    """Alarms by message, from the page's process, to people who do not look at it."""

    repeat_min: float = number(
        30.0, "an alarm is repeated so often until it is acknowledged or over; 0: never", "min", 0.0, 1440.0
    )
    silent_s: float = number(
        120.0, "a daemon that has not answered so long, or made no tick, is an alarm", "s", 5.0, 3600.0
    )
    page_url: str = text(
        "", "the page's address in messages; empty: made of page.names and page.port", form=url_problem
    )
    ntfy: NtfySettings = field(default_factory=NtfySettings)
    mail: MailSettings = field(default_factory=MailSettings)
    webhook: WebhookSettings = field(default_factory=WebhookSettings)
    life_sign: LifeSignSettings = field(default_factory=LifeSignSettings)

    @property
    def is_on(self) -> bool:
        """A channel or a sign of life is configured."""
        return bool(self.mail.host) or any(one.is_set for one in (self.ntfy, self.webhook, self.life_sign))

    def secret_files(self) -> Iterator[tuple[str, str]]:
        """Yield the key of each file with a secret, and the file's name."""
        for section, keys in (
            ("ntfy", ("url_file", "token_file")),
            ("mail", ("password_file",)),
            ("webhook", ("url_file", "token_file", "secret_file")),
            ("life_sign", ("url_file",)),
        ):
            for key in keys:
                if name := getattr(getattr(self, section), key):
                    yield f"alarms.{section}.{key}", name
