"""A Debian machine under qemu, arm64 or amd64: its disk, its power and a shell in it.

The disk has a write cache of its own, which is lost when the power is cut: what the machine has not flushed
is not there afterwards (nbdkit's filter `cache`). A serial adapter's other end is a pseudo-terminal.
"""

import itertools
import json
import shutil
import socket
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from edge.core.processes import die_with_parent

AGENT = Path(__file__).with_name("boot_agent.py")
DEBIAN = Path(__file__).with_name("debian.sh")
UNIT = """[Unit]
StartLimitIntervalSec=0
[Service]
ExecStart=/usr/bin/python3 /srv/agent.py
Restart=always
RestartSec=1
[Install]
WantedBy=multi-user.target
"""
UNNEEDED = ("e2scrub_reap.service", "getty-static.service", "apt-daily.timer", "apt-daily-upgrade.timer")
DISK = "6G"
START_MAX_S, AGENT_S, FLUSH_MAX_S = 20.0, 60.0, 120.0
BOOT_MAX_S = 1800.0  # an emulated processor on a busy machine


@dataclass(frozen=True, slots=True)
class MachineArchitecture:
    """A kind of machine. name : Debian's; console : the kernel's word for the first serial line"""

    name: str
    qemu: tuple[str, ...]
    console: str


ARM64 = MachineArchitecture("arm64", ("qemu-system-aarch64", "-M", "virt", "-cpu", "cortex-a72"), "ttyAMA0")
AMD64 = MachineArchitecture("amd64", ("qemu-system-x86_64", "-M", "q35", "-cpu", "max"), "ttyS0")
# This machine's own processor; asked for, because a /dev/kvm of kvm_pvm runs no kernel of Debian's.
KVM = ("-accel", "kvm")


class ShellError(Exception):
    """A command in the machine failed; the text has its output."""


def run(*words: object) -> None:
    """Run a command of this machine. Errors: CalledProcessError"""
    subprocess.run([str(word) for word in words], check=True, stdout=subprocess.DEVNULL)


def make_tree(
    folder: Path,
    files: Sequence[Path],
    architecture: MachineArchitecture = ARM64,
    packages: Sequence[str] = (),
) -> Path:
    """Make `folder`/root: Debian 12 with its kernel, and `files` and the agent in /srv; return its path.

    packages : of Debian, beyond the few that debian.sh takes
    """
    root = folder / "root"
    if not (folder / "root.done").exists():
        shutil.rmtree(root, ignore_errors=True)
        root.mkdir(parents=True)
        words = ["sh", str(DEBIAN), architecture.name]
        tar = subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True)
        run("tar", "-C", root, "-xf", tar.stdout.strip())
        _add_packages(root, (f"linux-image-{architecture.name}", *packages))
        (folder / "root.done").touch()
    for path in files:
        shutil.copy(path, root / "srv" / path.name)
    shutil.copy(AGENT, root / "srv" / "agent.py")
    (root / "etc/systemd/system/agent.service").write_text(UNIT)
    (root / "etc/fstab").write_text("/dev/vda / ext4 defaults 0 1\n")
    (root / "etc/hostname").write_text("rig\n")
    (root / "etc/hosts").write_text("127.0.0.1 localhost\n127.0.1.1 rig\n")
    (root / "etc/modules-load.d/agent.conf").write_text("virtio_console\n")
    run("chroot", root, "systemctl", "enable", "--quiet", "agent.service")
    run("chroot", root, "systemctl", "mask", "--quiet", *UNNEEDED)
    return root


def make_disk(folder: Path) -> None:
    """Make disk.raw, vmlinuz and initrd.img of the tree in `folder`."""
    root = folder / "root"
    for name in ("vmlinuz", "initrd.img"):
        shutil.copy(root / name, folder / name)
    disk = folder / "disk.raw"
    disk.unlink(missing_ok=True)
    run("mkfs.ext4", "-q", "-d", root, disk, DISK)


def _add_packages(root: Path, packages: Sequence[str]) -> None:
    """Install Debian's kernel and others, and make an initrd of few modules: all take an hour, emulated."""
    settings = root / "etc/initramfs-tools"
    (settings / "conf.d").mkdir(parents=True)
    (settings / "conf.d/rig").write_text("MODULES=list\n")
    (settings / "modules").write_text("virtio_pci\nvirtio_blk\next4\n")
    shutil.copy("/etc/resolv.conf", root / "etc/resolv.conf")
    keep = ("-o", "Dpkg::Options::=--force-confold")
    run("mount", "-t", "proc", "proc", root / "proc")
    try:
        run("chroot", root, "apt-get", "update", "-qq")
        run("chroot", root, "apt-get", "install", "-y", "-qq", *keep, "--no-install-recommends", *packages)
        run("chroot", root, "apt-get", "clean")
    finally:
        run("umount", root / "proc")


class Machine:
    """The machine with its power off.

    port : pseudo-terminal at the other end of its serial adapter, None for a machine without one
    network : of qemu's `-nic`; memory : of qemu's `-m`
    """

    CUT = "the power is cut"

    def __init__(
        self,
        folder: Path,
        port: Path | None = None,
        architecture: MachineArchitecture = ARM64,
        network: str = "none",
        memory: str = "1G",
    ) -> None:
        self._folder, self._port, self._architecture = folder, port, architecture
        self._network, self._memory = network, memory
        self._numbers = itertools.count()
        self._processes: list[subprocess.Popen[bytes]] = []
        self._agent = socket.socket()
        self._received = b""

    def start(self) -> float:
        """Power on; returns when its agent answers. Returns : the time that it took [s]"""
        began, folder = time.monotonic(), self._folder
        for name in ("disk.sock", "agent.sock"):
            (folder / name).unlink(missing_ok=True)
        disk = ("nbdkit", "--foreground", "--unix", folder / "disk.sock")
        self._launch(*disk, "--filter=cache", "file", folder / "disk.raw")
        _connect(folder / "disk.sock").close()
        self._launch(*self._qemu())
        self._agent, self._received = _connect(folder / "agent.sock"), b""
        self._wait_for_agent(began + BOOT_MAX_S)
        return time.monotonic() - began

    def sh(self, command: str, patience_s: float = 300.0) -> str:
        """Run a shell command in the machine and return its output. Errors: ShellError; TimeoutError"""
        number = next(self._numbers)
        self._agent.sendall(json.dumps({"id": number, "sh": command}).encode() + b"\n")
        until = time.monotonic() + patience_s
        while (answer := json.loads(self._line(until)))["id"] != number:
            pass  # an answer that nobody waited for any longer
        if answer["code"]:
            raise ShellError(f"{command}: {answer['code']}: {answer['out']}")
        return str(answer["out"]).strip()

    def wait_for_flush(self) -> None:
        """Return as soon as the disk begins to write its cache down."""
        before = (self._folder / "disk.raw").stat().st_mtime_ns
        until = time.monotonic() + FLUSH_MAX_S
        while (self._folder / "disk.raw").stat().st_mtime_ns == before:
            if time.monotonic() > until:
                raise TimeoutError(f"nothing was written in {FLUSH_MAX_S:g} s")
            time.sleep(0.0005)

    def cut(self) -> None:
        """Cut the power: the disk first, so that nothing reaches it that it has not got."""
        for process in self._processes:
            process.kill()
        for process in self._processes:
            process.wait()
        self._processes.clear()
        self._agent.close()

    def _qemu(self) -> Sequence[object]:
        folder = self._folder
        board = ("-chardev", f"serial,id=board,path={self._port}", "-device", "usb-serial,chardev=board")
        return (
            *(*self._architecture.qemu, "-smp", "2", "-m", self._memory),
            *("-kernel", folder / "vmlinuz", "-initrd", folder / "initrd.img"),
            *("-append", f"root=/dev/vda rw console={self._architecture.console}"),
            *("-display", "none", "-nic", self._network, "-serial", f"file:{folder / 'console.log'}"),
            *("-drive", f"file=nbd+unix:///?socket={folder / 'disk.sock'},format=raw,if=virtio,id=disk"),
            *("-device", "qemu-xhci"),
            *(board if self._port else ()),
            *("-device", "virtio-serial-pci"),
            *("-chardev", f"socket,id=agent,path={folder / 'agent.sock'},server=on,wait=off"),
            *("-device", "virtserialport,chardev=agent,name=agent"),
        )

    def _launch(self, *words: object) -> None:
        with (self._folder / "machine.log").open("ab") as log:
            command = [str(word) for word in words]
            process = subprocess.Popen(command, stdout=log, stderr=log, preexec_fn=die_with_parent)
        self._processes.append(process)

    def _wait_for_agent(self, until: float) -> None:
        """Wait until the machine is up. Errors: TimeoutError"""
        while True:
            try:
                if self.sh("systemctl is-system-running || true", AGENT_S) in ("running", "degraded"):
                    return
            except TimeoutError:
                if time.monotonic() > until or any(process.poll() is not None for process in self._processes):
                    raise
            time.sleep(2.0)

    def _line(self, until: float) -> bytes:
        """Return the agent's next line. Errors: TimeoutError"""
        while b"\n" not in self._received:
            self._agent.settimeout(max(0.001, until - time.monotonic()))
            self._received += self._agent.recv(1 << 16)
        line, _, self._received = self._received.partition(b"\n")
        return line


def _connect(path: Path) -> socket.socket:
    """Connect to a program that was started just now. Errors: TimeoutError"""
    until = time.monotonic() + START_MAX_S
    while time.monotonic() < until:
        connection = socket.socket(socket.AF_UNIX)
        try:
            connection.connect(str(path))
            return connection
        except OSError:
            connection.close()
            time.sleep(0.05)
    raise TimeoutError(f"{path}: nobody listens; machine.log beside it may say why")
