"""The papers of a site: settings by which its broker is bridged to the fleet's, and its certificate."""

from collections.abc import Sequence

from fleet.machine.authority import Authority
from fleet.machine.engine_files import MESSAGE_MAX
from fleet.machine.places import FleetMachine, FleetPlaces
from fleet.machine.rig_papers import HOME, bundle_section
from fleet.machine.rights import orders_of, written_by

SITE_HOME = "/etc/mosquitto/greenhouse-fleet"  # of a site's papers, at its broker
BRIDGE_FILE = "/etc/mosquitto/conf.d/greenhouse-fleet.conf"
# Of each rig: a week of ticks at one a minute, more than a day at one every ten seconds, some 60 MB.
QUEUED_MAX = 10_000
HEAD = """\
# Bridge of the site {name} to its fleet, written by `greenhouse fleet site add` for mosquitto 2.

# What the fleet has not got is kept over a restart. The bound is that of each client of this broker; what
# goes beyond it is dropped, and the fleet asks the rig for it.
persistence true
max_queued_messages {queued}
"""
# The local id is the same after new papers: by it the broker finds what it had queued. The fleet refuses
# messages about the bridge, and ends a connection with a message that is too large, which would come again.
CONNECTION = """
# {words}
connection greenhouse-fleet-{name}-{way}
address {host}:{port}
bridge_cafile {home}/ca.crt
bridge_certfile {home}/site.crt
bridge_keyfile {home}/site.key
remote_clientid {common_name}-{way}
local_clientid greenhouse-fleet-{name}-{way}
cleansession {is_clean}
notifications_local_only true
bridge_max_packet_size {largest}
"""
OUT = "What rigs send; it waits while the fleet is away."
# A connection of its own: with `cleansession true` and `local_cleansession false` in one, mosquitto 2.0.11
# keeps what waits over a cut, but not over a restart of the site's broker.
IN = "Orders; none waits at the fleet while the site is away, for a late one must not act."
READ_ME = """Papers of the site {name} for the fleet at {host}.

Rigs: {rigs}.

The site has a mosquitto (2.0 or later) to which its rigs speak. On its machine, as root:

    mkdir -p {home} && tar -xzf {name}.tar.gz -C {home}
    chown -R root:mosquitto {home} && chmod 0750 {home} && chmod 0640 {home}/*
    cp {home}/bridge.conf {file}
    systemctl restart mosquitto

{key}

Each rig has the site's broker as its mqtt.host, its name above as mqtt.rig, and mqtt.topic_prefix as it is by
itself (greenhouse). If the fleet shall roll out models to a rig, copy ca.crt to {rig_home}/ca.crt there,
and put the two keys of bundle.yaml into the section bundle of its edge.yaml.

To see whether the bridge is connected (1) or not (0), ask the site's broker (package mosquitto-clients):

    mosquitto_sub -t '$SYS/broker/connection/{common_name}-out/state' -C 1

To end it:

    rm {file} && systemctl restart mosquitto
"""
NEW_KEY = "site.key is a secret: who has it can speak as each of these rigs, and as no other one."
OLD_KEY = "The certificate and its key stay those that the site has: they are not in this archive."


def site_files(
    places: FleetPlaces,
    machine: FleetMachine,
    name: str,
    common_name: str,
    rigs: Sequence[str],
    is_new: bool,
) -> dict[str, bytes]:
    """Return what the site takes with it; its key is made here where it is new, and stays nowhere else.

    common_name, rigs : of its certificate; all that it speaks for
    Errors : DataError, OSError
    """
    host = machine.names[0]
    out = [f"topic {topic} out 1" for rig in rigs for topic in written_by(rig)]
    orders = [f"topic {orders_of(rig)} in 1" for rig in rigs]
    bridge = HEAD.format(name=name, queued=QUEUED_MAX * len(rigs))
    for way, words, is_clean, topics in (("out", OUT, "false", out), ("in", IN, "true", orders)):
        bridge += CONNECTION.format(
            name=name,
            way=way,
            words=words,
            host=host,
            port=machine.ports.broker,
            home=SITE_HOME,
            common_name=common_name,
            is_clean=is_clean,
            largest=MESSAGE_MAX,
        )
        bridge += "\n".join(topics) + "\n"
    read_me = READ_ME.format(
        name=name,
        host=host,
        rigs=", ".join(rigs),
        home=SITE_HOME,
        file=BRIDGE_FILE,
        key=NEW_KEY if is_new else OLD_KEY,
        rig_home=HOME,
        common_name=common_name,
    )
    files = {
        "README.txt": read_me.encode(),
        "bridge.conf": bridge.encode(),
        "bundle.yaml": bundle_section(machine),
        "ca.crt": places.authority.read_bytes(),
    }
    if is_new:
        credential = Authority(places.authority, places.authority_key).for_client(common_name)
        files |= {"site.crt": credential.certificate, "site.key": credential.key}
    return files
