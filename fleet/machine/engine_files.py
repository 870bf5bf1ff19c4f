"""Files of settings for mosquitto and caddy, and `fleet.yaml` for our own two programs."""

from typing import Any

import yaml

from fleet.machine.places import LOCAL, FleetMachine, FleetPlaces
from fleet.page.routes import ALERTS
from fleet.rollout.archives import BUNDLES

HEAD = "# Written by `greenhouse fleet up`; a change by hand is lost.\n"
# Bytes; a tick has 4 to 6 kB, a rig's description for Home Assistant some 40.
MESSAGE_MAX = 256 << 10


def broker_file(places: FleetPlaces, machine: FleetMachine) -> str:
    """Return mosquitto.conf: who has no certificate of ours is nobody, and its name there is who it is."""
    data = f"{machine.data}/broker"
    return f"""{HEAD}user {machine.user}
listener {machine.ports.broker}{f" {machine.host}" if machine.host else ""}
cafile {places.authority}
certfile {places.certificate("server")}
keyfile {places.key("server")}
tls_version tlsv1.2
require_certificate true
use_identity_as_username true
allow_anonymous false
acl_file {places.rights}
pid_file {data}/mosquitto.pid

# Retained states and the queue of an ingest that is away survive a restart. What came since the last save is
# lost when the broker is killed: a gap in `seq`, which ingest asks the rig to fill.
persistence true
persistence_location {data}/
autosave_interval 60
persistent_client_expiration 30d
max_queued_messages 1000000
max_inflight_messages 0
max_packet_size {MESSAGE_MAX}
log_dest stderr
"""


def web_file(places: FleetPlaces, machine: FleetMachine) -> str:
    """Return the Caddyfile: https over TCP by our own certificate, and no way in for alarms."""
    bind = f"\tbind {machine.host}\n" if machine.host else ""
    return f"""{HEAD}{{
	admin off
	auto_https off
	servers {{
		protocols h1 h2
	}}
}}
https://:{machine.ports.web} {{
{bind}	tls {places.certificate("server")} {places.key("server")}
	respond {ALERTS} 404
	reverse_proxy {LOCAL}:{machine.ports.page}
}}
"""


def settings_file(places: FleetPlaces, machine: FleetMachine) -> str:
    """Return fleet.yaml as it is at first; it is yours to change."""
    ports = machine.ports
    values: dict[str, Any] = {
        "database": {"url": f"sqlite:///{machine.data}/fleet.db"},
        "numbers": {"url": f"http://{LOCAL}:{ports.numbers}"},
        "page": {
            "host": LOCAL,
            "port": ports.page,
            "names": [name for name in machine.names if name not in ("localhost", LOCAL)],
            "alert_token_file": str(places.alert_token),
        },
        "rollout": {
            "address": machine.address + BUNDLES,
            "trusted_keys": str(places.bundle_keys),
        },
        "mqtt": {
            "enabled": True,
            "host": LOCAL,
            "port": ports.broker,
            "tls": True,
            "ca": str(places.authority),
            "client_cert": str(places.certificate("fleet")),
            "client_key": str(places.key("fleet")),
            "rig": "fleet",
        },
    }
    head = "# Settings of the fleet's own programs, written once by `greenhouse fleet up`.\n"
    return head + yaml.safe_dump(values, sort_keys=False)
