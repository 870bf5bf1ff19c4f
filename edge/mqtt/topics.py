"""Every topic of one rig."""

from dataclasses import dataclass

from edge.config.settings import MqttSettings


class Topic:
    """A topic under the root, called as its attribute. text : its description, for the manual"""

    def __init__(self, text: str) -> None:
        self.__doc__ = text

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, topics: "Topics", owner: type) -> str:
        return f"{topics.root}/{self._name}"


@dataclass(frozen=True, slots=True)
class Topics:
    """All under `root`, but for the two that Home Assistant prescribes."""

    root: str  # <prefix>/<rig>
    discovery: str  # Home Assistant's device discovery, retained
    home_assistant_status: str  # "online" when Home Assistant has started

    @classmethod
    def of(cls, settings: MqttSettings) -> "Topics":
        """Return the topics that the settings give."""
        return cls(
            root=f"{settings.topic_prefix}/{settings.rig}",
            discovery=f"{settings.discovery_prefix}/device/{settings.rig}/config",
            home_assistant_status=f"{settings.discovery_prefix}/status",
        )

    availability = Topic("`online` or `offline`, retained; `offline` is the last will.")
    state = Topic("The present state: one flat JSON object, retained.")
    forecast = Topic("Air temperature that the controller expects after each of the next steps, retained.")
    forecasts = Topic("Each predictor's forecast at each horizon, with its interval; retained.")
    skill = Topic("How well each predictor does at each horizon, retained.")
    drift = Topic(
        "The agreement of the running twin with the greenhouse, the begin of a drift and its place; retained."
    )
    commissioning = Topic("How far commissioning is, `phase` and `text`; retained.")
    twin = Topic("The twin of the active bundle, retained; nothing where that is the packaged one.")
    decision = Topic("The wanted command, the sent one, and the reason; retained.")
    event = Topic("One message per event.")
    proposal = Topic(
        "An operator's request at each of its stages, and the newest one again at each connection."
    )
    reply = Topic("Answer to each command.")

    @property
    def retained(self) -> tuple[str, ...]:
        """All that stays at the broker until it is taken away."""
        live = (self.state, self.decision, self.forecast, self.forecasts, self.skill, self.drift)
        return (self.discovery, self.availability, *live, self.commissioning, self.twin)

    def command(self, what: str) -> str:
        """Return the topic on which the command `what` is received; "+" for all."""
        return f"{self.root}/set/{what}"
