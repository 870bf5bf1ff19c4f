"""The fleet's own authority, and the certificates that it signs: the server's, the fleet's and each rig's."""

import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from edge.core.errors import DataError
from edge.formats.atomic_file import write_atomically

AUTHORITY_DAYS = 7300
SERVER_DAYS = 820  # browsers refuse a server's certificate of more than 825 days
CLIENT_DAYS = 3650
RENEW_DAYS = 60  # before its end a certificate is made anew
BACKDATE = timedelta(days=1)  # a rig's clock may be behind


@dataclass(frozen=True, slots=True)
class Credential:
    """A certificate and its key, both PEM."""

    certificate: bytes
    key: bytes

    def write(self, certificate: Path, key: Path) -> None:
        """Write both files, the key for its owner and group alone. Errors: OSError"""
        write_secret(key, self.key)
        write_atomically(certificate, self.certificate)


def write_secret(path: Path, content: bytes, mode: int = 0o640) -> None:
    """Write a file that others cannot read at any moment. Errors: OSError"""
    path.touch(0o600)
    path.chmod(mode)
    write_atomically(path, content)  # the mode stays


class Authority:
    """Signs certificates. Errors : DataError for files that are not its own"""

    def __init__(self, certificate: Path, key: Path) -> None:
        try:
            self._certificate = x509.load_pem_x509_certificate(certificate.read_bytes())
            found = serialization.load_pem_private_key(key.read_bytes(), None)
        except (OSError, ValueError, TypeError) as error:
            raise DataError(f"{certificate}, {key}: not the fleet's authority: {error}") from None
        if not isinstance(found, ec.EllipticCurvePrivateKey):
            raise DataError(f"{key}: not a key of an elliptic curve")
        self._key = found

    def for_server(self, names: Sequence[str]) -> Credential:
        """Return a server's credential. names : host names and addresses, the first one is its own"""
        shown = x509.SubjectAlternativeName([_general_name(name) for name in names])
        usage = [ExtendedKeyUsageOID.SERVER_AUTH]
        return self._sign(names[0][:64], SERVER_DAYS, usage, shown)

    def for_client(self, common_name: str) -> Credential:
        """Return a client's credential. common_name : the broker's name for it"""
        return self._sign(common_name, CLIENT_DAYS, [ExtendedKeyUsageOID.CLIENT_AUTH])

    def _sign(
        self,
        common_name: str,
        days: int,
        usage: list[x509.ObjectIdentifier],
        names: x509.SubjectAlternativeName | None = None,
    ) -> Credential:
        key = ec.generate_private_key(ec.SECP256R1())
        builder = _builder(_name(common_name), self._certificate.subject, key, days)
        builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        builder = builder.add_extension(x509.ExtendedKeyUsage(usage), critical=False)
        own = x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key())
        builder = builder.add_extension(own, critical=False)
        if names is not None:
            builder = builder.add_extension(names, critical=False)
        return Credential(_pem(builder.sign(self._key, hashes.SHA256())), _key_pem(key))


def make_authority(name: str) -> Credential:
    """Return a new authority's certificate, signed by itself, and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    builder = _builder(_name(name), _name(name), key, AUTHORITY_DAYS)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    signs = dict.fromkeys(_USES, False) | {"key_cert_sign": True, "crl_sign": True}
    builder = builder.add_extension(x509.KeyUsage(**signs), critical=True)
    return Credential(_pem(builder.sign(key, hashes.SHA256())), _key_pem(key))


def is_fresh(path: Path, names: Sequence[str] = (), days: float = RENEW_DAYS) -> bool:
    """Return whether a certificate is there, is for these names and holds for some days."""
    try:
        certificate = x509.load_pem_x509_certificate(path.read_bytes())
    except (OSError, ValueError):
        return False
    if names:
        try:
            found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        except x509.ExtensionNotFound:
            return False
        if set(found) != {_general_name(name) for name in names}:
            return False
    return certificate.not_valid_after_utc - datetime.now(UTC) > timedelta(days=days)


_USES = (
    *("digital_signature", "content_commitment", "key_encipherment", "data_encipherment", "key_agreement"),
    *("key_cert_sign", "crl_sign", "encipher_only", "decipher_only"),
)


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, days: int
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    builder = x509.CertificateBuilder(issuer, subject, key.public_key(), x509.random_serial_number())
    builder = builder.not_valid_before(now - BACKDATE).not_valid_after(now + timedelta(days=days))
    own = x509.SubjectKeyIdentifier.from_public_key(key.public_key())
    return builder.add_extension(own, critical=False)


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _general_name(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
