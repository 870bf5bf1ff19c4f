"""Units of systemd for the programs of a fleet. Run this module to write those of deploy/fleet/."""

import sys
from collections.abc import Iterable
from pathlib import Path

from edge.formats.atomic_file import write_atomically
from fleet.machine.engines import Engine, engines
from fleet.machine.places import DATA, FOLDER, FleetMachine, places_of

PREFIX = "greenhouse-fleet"
TARGET = f"{PREFIX}.target"
PYTHON = "/opt/greenhouse/venv/bin/python"  # of the units in deploy/fleet/
HEAD = "# Written by `greenhouse fleet up`; a change by hand is lost: use `systemctl edit`.\n"
FIRST = ("broker", "numbers")  # whom the others ask
SECRETS = ("ca.key", "rigs")  # that no engine reads


def unit_files(programs: Iterable[Engine], machine: FleetMachine, folder: Path) -> dict[str, str]:
    """Return the text of each unit by its file name. folder : of the settings"""
    found = {f"{PREFIX}-{engine.name}.service": _service(engine, machine, folder) for engine in programs}
    return {TARGET: _target(found), **found}


def _target(services: Iterable[str]) -> str:
    return f"""{HEAD}[Unit]
Description=Greenhouse fleet
Documentation=file:/usr/share/doc/greenhouse/README.md
Wants={" ".join(services)}

[Install]
WantedBy=multi-user.target
"""


def _service(engine: Engine, machine: FleetMachine, folder: Path) -> str:
    environment = "".join(f"Environment={name}={value}\n" for name, value in engine.environment.items())
    low = "CAP_NET_BIND_SERVICE" if engine.low_port else ""
    hidden = " ".join(f"-{folder}/{name}" for name in SECRETS)
    after = "" if engine.name in FIRST else "".join(f" {PREFIX}-{name}.service" for name in FIRST)
    reload = "ExecReload=/bin/kill -HUP $MAINPID\n" if engine.name == "broker" else ""
    return f"""{HEAD}[Unit]
Description=Greenhouse fleet: {engine.words}
After=network.target{after}
PartOf={TARGET}
StartLimitIntervalSec=0

[Service]
ExecStart={" ".join(engine.command)}
{reload}Restart=always
RestartSec=5
TimeoutStopSec=60
User={machine.user}
Group={machine.user}
UMask=0027
{environment}LimitNOFILE=1048576
ReadWritePaths={machine.data}
InaccessiblePaths={hidden}
AmbientCapabilities={low}
CapabilityBoundingSet={low}
DevicePolicy=closed
PrivateDevices=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6
ProtectSystem=strict
ProtectHome=yes
PrivateTmp=yes
ProtectProc=invisible
NoNewPrivileges=yes
LockPersonality=yes
PrivateIPC=yes
PrivateMounts=yes
ProtectClock=yes
ProtectControlGroups=yes
ProtectHostname=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
RemoveIPC=yes
RestrictNamespaces=yes
RestrictRealtime=yes
RestrictSUIDSGID=yes
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallFilter=~@privileged @resources
SystemCallErrorNumber=EPERM

[Install]
WantedBy={TARGET}
"""


def usual_units() -> dict[str, str]:
    """Return the units of a fleet in its usual places."""
    machine = FleetMachine(str(DATA), names=("fleet.example.org",))
    return unit_files(engines(places_of(FOLDER), machine, PYTHON), machine, FOLDER)


if __name__ == "__main__":
    for name, content in usual_units().items():
        write_atomically(Path(sys.argv[1]) / name, content)
