"""Certificates for tests, made with the openssl program."""

import subprocess
from pathlib import Path


def make_certificates(folder: Path) -> Path:
    """An authority `ca`, `broker` (127.0.0.1) and `client` signed by it, and an authority `stranger`."""
    folder.mkdir(exist_ok=True)
    for authority in ("ca", "stranger"):
        _openssl(folder, f"req -x509 -days 2 -subj /CN={authority} -out {authority}.crt", new_key=authority)
    (folder / "broker.ext").write_text("subjectAltName=IP:127.0.0.1\n")
    (folder / "client.ext").write_text("extendedKeyUsage=clientAuth\n")
    for name in ("broker", "client"):
        _openssl(folder, f"req -subj /CN={name} -out {name}.csr", new_key=name)
        _openssl(
            folder,
            f"x509 -req -days 2 -in {name}.csr -CA ca.crt -CAkey ca.key -CAcreateserial"
            f" -extfile {name}.ext -out {name}.crt",
        )
    for key in folder.glob("*.key"):
        key.chmod(0o600)
    return folder


def _openssl(folder: Path, arguments: str, new_key: str = "") -> None:
    elliptic = "-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes"
    key = f"{elliptic} -keyout {new_key}.key".split() if new_key else []
    subprocess.run(["openssl", *arguments.split(), *key], cwd=folder, check=True, capture_output=True)
