"""The access list of the broker: each rig its own topics and no others."""

from collections.abc import Iterable

from edge.config.settings import MqttSettings
from edge.mqtt.topics import Topics
from fleet.machine.rig_papers import RigPaper

HEAD = "# Written by `greenhouse fleet`; a change by hand is lost.\n"
# The fleet sees all and gives orders. It also takes away what the broker has kept of a rig that is removed.
OF_FLEET = """
user fleet
topic read greenhouse/#
topic write greenhouse/+/set/+
topic write greenhouse/+/+
topic write homeassistant/device/+/config
"""


def access_list(papers: Iterable[RigPaper]) -> str:
    """Return the text of mosquitto's access list."""
    return HEAD + OF_FLEET + "".join(f"\n{of_rig(paper)}" for paper in papers)


def of_rig(paper: RigPaper) -> str:
    """Return a rig's part: it publishes what it knows and hears its own orders.

    mosquitto adds up the parts of one user: a site's certificate has those of all its rigs.
    """
    topics = Topics.of(MqttSettings(rig=paper.name))
    reads = (orders_of(paper.name), topics.home_assistant_status)
    lines = [f"topic write {topic}" for topic in written_by(paper.name)]
    lines += [f"topic read {topic}" for topic in reads]
    return "\n".join((f"user {paper.common_name}", *lines)) + "\n"


def written_by(rig: str) -> tuple[str, ...]:
    """Return all topics that a rig writes."""
    topics = Topics.of(MqttSettings(rig=rig))
    others = (topics.event, topics.proposal, topics.reply, f"{topics.root}/history/#")
    return (*sorted(topics.retained), *others)


def orders_of(rig: str) -> str:
    """Return the topics on which a rig hears orders."""
    return Topics.of(MqttSettings(rig=rig)).command("+")
