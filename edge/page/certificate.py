"""Checks the page's certificate at the start: a browser would refuse a bad one with less of a reason."""

import ssl
from pathlib import Path

from edge.config.settings import PageSettings
from edge.core.errors import ConfigError
from edge.formats.input_file import read_file

EXPIRED = 10  # X509_V_ERR_CERT_HAS_EXPIRED, openssl/x509_vfy.h


def check_certificate(page: PageSettings) -> None:
    """Refuse files that no browser can be served with; no certificate is fine. Errors: ConfigError

    A certificate that is not valid yet passes: after a power cut the clock of a small computer may be behind.
    """
    if not page.certificate:
        return
    for setting, file in (("certificate", page.certificate), ("key_file", page.key_file)):
        try:
            read_file(Path(file))
        except OSError as error:
            raise ConfigError(f"page.{setting}: {file}: {error.strerror}") from error
    _check_dates(_client_of(page), _server_of(page), page.certificate)


def _client_of(page: PageSettings) -> ssl.SSLContext:
    """Return the side that trusts this certificate and no other one."""
    client = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    client.check_hostname = False
    client.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN  # its issuer need not be in the file
    try:
        client.load_verify_locations(page.certificate)
    except ssl.SSLError as error:
        raise ConfigError(f"page.certificate: {page.certificate}: not a certificate in PEM") from error
    return client


def _server_of(page: PageSettings) -> ssl.SSLContext:
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        server.load_cert_chain(page.certificate, page.key_file, password="")  # else OpenSSL asks a terminal
    except ssl.SSLError as error:
        fault = (
            f"not the key of {page.certificate}"
            if error.reason == "KEY_VALUES_MISMATCH"
            else "not a key in PEM without a password"
        )
        raise ConfigError(f"page.key_file: {page.key_file}: {fault}") from error
    return server


def _check_dates(client: ssl.SSLContext, server: ssl.SSLContext, certificate: str) -> None:
    """Let the two shake hands in memory: the standard library reads no dates out of a certificate."""
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = (client.wrap_bio(to_client, to_server), server.wrap_bio(to_server, to_client, server_side=True))
    for end in (*ends, *ends):
        try:
            end.do_handshake()
        except ssl.SSLWantReadError:
            continue
        except ssl.SSLCertVerificationError as error:
            if error.verify_code == EXPIRED:
                raise ConfigError(f"page.certificate: {certificate}: it has expired") from error
            return
