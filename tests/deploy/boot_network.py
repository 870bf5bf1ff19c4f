"""The network of a booted machine, and this machine's ways to Debian's and Python's packages, for its disk.

What is copied stays in the tree, below out/: another machine has other ways.
"""

import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

NETWORK = "user,model=virtio-net-pci"  # of qemu's `-nic`: behind this machine's own
HOST = "10.0.2.2"  # this machine, as seen from there
NAMES = "nameserver 10.0.2.3\n"
CARD = "[Match]\nType=ether\n[Network]\nDHCP=ipv4\n"
LOOPBACK = re.compile(r"\b(127\.0\.0\.1|localhost)(?=[:/])")
CERTIFICATES = Path("/etc/ssl/certs/ca-certificates.crt")
OURS = Path("usr/local/share/authorities-of-the-host.crt")  # Debian's own package writes CERTIFICATES
SOURCES = ("sources.list.d/*.sources", "sources.list.d/*.list", "sources.list")
KEYS = ("keyrings/*", "trusted.gpg.d/*")
PIP_KEYS = ("index-url", "extra-index-url", "trusted-host", "timeout", "proxy")


def give_network(root: Path) -> None:
    """Let the system in `root` reach networks and packages. Errors: OSError, CalledProcessError"""
    (root / "etc/systemd/network/80-card.network").write_text(CARD)
    subprocess.run(["chroot", root, "systemctl", "enable", "--quiet", "systemd-networkd"], check=True)
    (root / "etc/resolv.conf").write_text(NAMES)
    give_packages(root, HOST)


def give_packages(root: Path, host: str = "127.0.0.1") -> None:
    """Let it get packages as this machine does, which it knows as `host`. Errors: OSError"""
    shutil.copy(CERTIFICATES, root / OURS)
    _give_apt(root / "etc/apt", host)
    (root / "etc/pip.conf").write_text("[global]\n" + "".join(f"{line}\n" for line in _pip_settings(host)))


def _give_apt(folder: Path, name: str) -> None:
    host = Path("/etc/apt")
    (folder / "sources.list").unlink(missing_ok=True)
    for path in (path for pattern in (*SOURCES, *KEYS) for path in host.glob(pattern)):
        (folder / path.relative_to(host)).parent.mkdir(exist_ok=True)
        shutil.copy(path, folder / path.relative_to(host))
    for path in (path for pattern in SOURCES for path in folder.glob(pattern)):
        path.write_text(LOOPBACK.sub(name, path.read_text()))
    ways = [path.read_text() for path in sorted((host / "apt.conf.d").iterdir()) if _is_a_way(path)]
    trust = f'Acquire::https::CAInfo "/{OURS}";\n'
    (folder / "apt.conf.d" / "90host").write_text(LOOPBACK.sub(name, "\n".join((*ways, trust))))


def _is_a_way(path: Path) -> bool:
    """Return whether a file of apt's says how packages are got, and nothing of what is done with them."""
    text = path.read_text()
    return "Acquire::" in text and "DPkg::" not in text


def _pip_settings(host: str) -> Iterator[str]:
    """Yield lines of pip.conf: those of this machine's files and environment that another machine can use."""
    yield f"cert = /{OURS}"
    listed = subprocess.run(
        [sys.executable, "-m", "pip", "config", "list"], check=True, stdout=subprocess.PIPE, text=True
    )
    for line in listed.stdout.splitlines():
        name, _, value = line.partition("=")
        key = name.rpartition(".")[2].replace("_", "-")
        words = [word for word in value.strip("'\"").replace("\\n", " ").split() if "file:" not in word]
        if key in PIP_KEYS and words:
            yield f"{key} = {LOOPBACK.sub(host, ' '.join(words))}"
