"""The page over https, with a certificate of its own."""

import socket
import ssl
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path

import pytest
import requests
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from bench.default_daemon import memory_of
from edge.core.processes import end_process
from edge.page.__main__ import main
from edge.page.access import Role
from edge.page.protocol import CONNECTIONS_MAX
from tests.support.broker import free_port, wait_for
from tests.support.daemon_process import ROOT
from tests.support.page_process import Client, PageProcess, cookie_of, listens, page_of

OTHER_FILES = 30  # that the page has open beside connections
pytestmark = pytest.mark.slow
Refusal = Callable[[Path, dict], str]


def make_certificate(folder: Path, first_day: int = -1, last_day: int = 30, password: bytes = b"") -> dict:
    """Return settings of a page with a new certificate, valid between two days from now."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "page")])
    names = x509.SubjectAlternativeName([x509.IPAddress(ip_address("127.0.0.1"))])
    builder = x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
    now = datetime.now(UTC)
    builder = builder.not_valid_before(now + timedelta(first_day)).not_valid_after(now + timedelta(last_day))
    signed = builder.add_extension(names, critical=False).sign(key, hashes.SHA256())
    how = serialization.BestAvailableEncryption(password) if password else serialization.NoEncryption()
    pem = serialization.Encoding.PEM
    folder.mkdir(exist_ok=True)
    certificate, key_file = folder / "page.crt", folder / "page.key"
    certificate.write_bytes(signed.public_bytes(pem))
    key_file.write_bytes(key.private_bytes(pem, serialization.PrivateFormat.PKCS8, how))
    return {"certificate": str(certificate), "key_file": str(key_file)}


@pytest.fixture(scope="module")
def page() -> Iterator[PageProcess]:
    with (
        tempfile.TemporaryDirectory(prefix="gh-") as name,
        page_of(Path(name), **make_certificate(Path(name))) as running,
    ):
        yield running


def test_with_a_certificate_the_page_is_served_and_its_cookie_never_leaves_https(page: PageProcess) -> None:
    client = page.client(Role.OPERATE)
    assert page.base.startswith("https://")
    assert client.get("/").headers["strict-transport-security"] == "max-age=2592000"
    assert cookie_of(client).secure
    assert client.view()["ok"]
    assert client.post("/api/stop").json()["waits"]
    # Of http with the same name a change is refused: the browser would have sent it in the clear.
    insecure = client.post("/api/stop", origin=page.base.replace("https", "http"))
    assert insecure.status_code == 403


def test_who_does_not_trust_the_certificate_gets_nothing(page: PageProcess) -> None:
    with pytest.raises(requests.exceptions.SSLError):
        Client(page.base).get("/")


def test_plain_http_on_the_port_of_https_gives_no_page(page: PageProcess) -> None:
    with socket.create_connection(("127.0.0.1", page.port), timeout=20) as connection:
        connection.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        answer = b""
        try:
            while part := connection.recv(4096):
                answer += part
        except ConnectionResetError:
            pass
    assert b"HTTP/" not in answer
    assert b"html" not in answer
    assert page.client(None).get("/").ok


def test_connections_that_only_wait_take_little_memory_and_are_limited(page: PageProcess) -> None:
    """Each took 300 kB by asyncio's own choice: a few hundred ended the page."""
    assert page.process is not None
    trusting = ssl.create_default_context(cafile=str(page.config.parent / "page.crt"))
    with ExitStack() as stack:
        for _ in range(CONNECTIONS_MAX // 2):
            connection = socket.create_connection(("127.0.0.1", page.port), timeout=20)
            stack.enter_context(trusting.wrap_socket(connection, server_hostname="127.0.0.1"))
        assert page.client(None).get("/").ok
        assert memory_of(str(page.process.pid)).pss < 60.0
        for _ in range(CONNECTIONS_MAX):
            stack.enter_context(socket.create_connection(("127.0.0.1", page.port), timeout=20))
        wait_for(lambda: open_files(page) <= CONNECTIONS_MAX + OTHER_FILES)
        assert page.client(None).get("/").ok


def open_files(page: PageProcess) -> int:
    assert page.process is not None
    return len(list(Path(f"/proc/{page.process.pid}/fd").iterdir()))


BAD = {
    "a missing certificate": ("certificate", "No such file", lambda page: unlink(page["certificate"])),
    "a missing key": ("key_file", "No such file", lambda page: unlink(page["key_file"])),
    "a folder": ("key_file", "not a regular file", lambda page: page.update(key_file="/")),
    "no certificate": ("certificate", "PEM", lambda page: Path(page["certificate"]).write_text("x")),
    "an empty certificate": ("certificate", "PEM", lambda page: Path(page["certificate"]).write_text("")),
    "no key": ("key_file", "PEM", lambda page: Path(page["key_file"]).write_text("x")),
    "the certificate as key": ("key_file", "PEM", lambda page: page.update(key_file=page["certificate"])),
}


def unlink(file: str) -> None:
    Path(file).unlink()


@pytest.fixture
def refusal(capsys: pytest.CaptureFixture[str]) -> Refusal:
    """Return the message of a page that ends with exit code 2."""

    def told(folder: Path, page: dict) -> str:
        assert main(str(PageProcess(folder, free_port(), **page).config)) == 2
        (line,) = capsys.readouterr().err.splitlines()
        return line

    return told


@pytest.mark.parametrize("case", BAD)
def test_a_file_that_is_none_is_refused_by_setting_and_name(
    tmp_path: Path, refusal: Refusal, case: str
) -> None:
    setting, reason, spoil = BAD[case]
    page = make_certificate(tmp_path)
    spoil(page)
    told = refusal(tmp_path, page)
    assert f"page.{setting}: {page[setting]}: " in told
    assert reason in told


def test_a_key_of_another_certificate_or_behind_a_password_is_refused(
    tmp_path: Path, refusal: Refusal
) -> None:
    page, other = make_certificate(tmp_path / "a"), make_certificate(tmp_path / "b", password=b"hello")
    told = refusal(tmp_path, page | {"key_file": other["key_file"]})
    assert f"page.key_file: {other['key_file']}: not a key in PEM without a password" in told
    other = make_certificate(tmp_path / "b")
    told = refusal(tmp_path, page | {"key_file": other["key_file"]})
    assert f"page.key_file: {other['key_file']}: not the key of {page['certificate']}" in told


def test_an_expired_certificate_is_refused_and_one_of_tomorrow_is_not(
    tmp_path: Path, refusal: Refusal
) -> None:
    page = make_certificate(tmp_path, -9, -1)
    assert f"page.certificate: {page['certificate']}: it has expired" in refusal(tmp_path, page)
    # The clock of a computer without a battery is behind until it has a network.
    page = make_certificate(tmp_path, 1, 9)
    process = PageProcess(tmp_path, free_port(), **page)
    running = subprocess.Popen(process.command, cwd=ROOT, stderr=subprocess.PIPE)
    try:
        wait_for(lambda: listens(process.port) or running.poll() is not None)
        assert running.poll() is None
    finally:
        end_process(running, patience_s=15.0)
        running.communicate()
